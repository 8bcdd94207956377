//! Every public function of `wsg_protocol::modbus`: the server, on a serial line, on TCP and without a line.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use wsg_probes::gripper::Gripper;
use wsg_probes::{bytes, keep, opaque};
use wsg_protocol::fieldbus::InputImage;
use wsg_protocol::modbus::rtu::{Character, Config, Mode, Receiver, Server, Timing, crc};
use wsg_protocol::modbus::{
    Bits, Exception, Function, INPUT_REGISTERS, Images, MAX_PDU_LEN, Words, serve, tcp,
};

const CONFIG: Config = Config { unit: 1, mode: Mode::Strict, broadcast: true };
const TIMING: Timing = Timing::of(19_200, 11);

#[entry]
fn main() -> ! {
    static mut GRIPPER: Gripper = Gripper(Images::new(false));
    static mut SERVER: Server = Server::new(CONFIG, TIMING);
    static mut RECEIVER: Receiver = Receiver::new(1, Mode::Strict, TIMING);
    static mut TCP: tcp::Receiver = tcp::Receiver::new();
    static mut RESPONSE: [u8; MAX_PDU_LEN] = [0; MAX_PDU_LEN];
    loop {
        keep(&serve(bytes(), opaque(&mut *GRIPPER), opaque(&mut *RESPONSE)));
        images(opaque(&mut GRIPPER.0));
        line(opaque(&mut *SERVER), opaque(&mut *GRIPPER));
        receiver(opaque(&mut *RECEIVER));
        tcp(opaque(&mut *TCP));
        tables();
    }
}

#[inline(never)]
fn images(images: &mut Images) {
    images.set_swap_bytes(opaque(false));
    images.set_input(&opaque(InputImage::from_bytes(opaque([0; InputImage::LEN]))));
    keep(&(images.output(), images.take_written()));
    keep(&(images.coil(opaque(0)), images.discrete_input(opaque(0))));
    keep(&(images.holding_register(opaque(0)), images.input_register(opaque(0))));
    let (bits, words) = (Bits::new(bytes(), opaque(0)), Words::new(bytes()));
    keep(&(bits.len(), bits.is_empty(), words.len(), words.is_empty()));
    keep(&images.write_coils(opaque(0), bits));
    keep(&images.write_registers(opaque(0), words));
    bits.iter().for_each(|bit| keep(&bit));
    words.iter().for_each(|word| keep(&word));
}

#[inline(never)]
fn line(server: &mut Server, gripper: &mut Gripper) {
    server.configure(opaque(CONFIG));
    keep(&server.push(opaque(Character::Byte(0)), opaque(0), gripper));
    keep(&server.silence(opaque(0), gripper));
    keep(&(server.counters(), server.is_listen_only(), server.is_idle()));
}

#[inline(never)]
fn receiver(receiver: &mut Receiver) {
    *receiver = Receiver::new(opaque(1), opaque(Mode::Strict), Timing::of(opaque(0), opaque(0)));
    receiver.configure(opaque(1), opaque(Mode::Strict));
    keep(&receiver.push(opaque(Character::Damaged), opaque(0)));
    keep(&receiver.silence(opaque(0)));
    keep(&receiver.is_idle());
    receiver.reset();
    keep(&crc(bytes()));
}

#[inline(never)]
fn tcp(receiver: &mut tcp::Receiver) {
    let mut frame = [0; tcp::MAX_FRAME_LEN];
    keep(&receiver.push(opaque(0)));
    if let (_, Some(tcp::Event::Request(request))) = receiver.push_slice(bytes()) {
        keep(
            request.answer(opaque(&mut frame), |pdu, response| opaque(pdu).len().min(opaque(response).len())),
        );
    }
    keep(&receiver.is_lost());
}

#[inline(never)]
fn tables() {
    if let Some(function) = opaque(Function::from_code(opaque(0))) {
        keep(&(function.code(), function.may_be_broadcast()));
    }
    keep(&opaque(Exception::IllegalFunction).code());
    keep(&opaque(&INPUT_REGISTERS).iter().filter(|register| register.content.is_number()).count());
}
