//! One request of a MODBUS master and its answer, on the serial line.

use core::hint::black_box;

use cortex_m_semihosting::hprintln;
use wsg_protocol::modbus::rtu::{Character, Config, Event, Mode, Server, Timing, crc};
use wsg_protocol::modbus::{Bits, Device, Exception, Identification, Images, Words};

use crate::counting::Counter;

/// The two images and nothing else.
struct Gripper(Images);

impl Device for Gripper {
    fn coil(&self, address: u16) -> Result<bool, Exception> {
        self.0.coil(address)
    }

    fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        self.0.discrete_input(address)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        self.0.holding_register(address)
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        self.0.input_register(address)
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        self.0.write_coils(first, values)
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        self.0.write_registers(first, values)
    }

    fn identification(&self) -> Identification {
        Identification { vendor_name: "", product_code: "", revision: "", regular: None }
    }
}

const UNIT: u8 = 1;

/// What a PLC asks in every cycle: all input registers; and all holding registers written.
const REQUESTS: [(&str, &[u8]); 2] = [
    ("modbus-read-input", &[UNIT, 0x04, 0, 0, 0, 6]),
    ("modbus-write-output", &[UNIT, 0x10, 0, 0, 0, 4, 8, 1, 0, 0x13, 0x88, 0x07, 0xD0, 0x0F, 0xA0]),
];

/// Counts from the first byte of a request to its sealed answer, all but the bytes' way.
pub(crate) fn count(counter: &Counter) {
    let timing = Timing::of(19_200, 11);
    let mut server = Server::new(Config { unit: UNIT, mode: Mode::Strict, broadcast: false }, timing);
    let mut gripper = Gripper(Images::new(false));
    for (name, request) in REQUESTS {
        let request = black_box(request);
        let (server, gripper) = (black_box(&mut server), black_box(&mut gripper));
        let mut answered = 0;
        let instructions = counter.of(|| {
            for &byte in request.iter().chain(&crc(request).to_le_bytes()) {
                black_box(server.push(Character::Byte(byte), 0, gripper).is_none());
            }
            if let Some(Event::Answer(answer)) = server.silence(timing.t3_5_us, gripper) {
                answered = black_box(answer).len();
            }
        });
        assert!(answered > 5, "an answer, and no exception");
        hprintln!("{} {} 1", name, instructions);
    }
}
