//! Cost of one request of a MODBUS master and its answer on a serial line.

use core::hint::black_box;

use bus_modbus::rtu::{Character, Config, Event, MAX_FRAME_LEN, Mode, Server, Timing, crc};
use bus_modbus::{Bits, Device, Exception, Identification, Words};
use cortex_m_semihosting::hprintln;
use wsg_fieldbus::Images;
use wsg_probes::gripper::Gripper;

use crate::counting::Counter;

const UNIT: u8 = 1;
const REGISTERS: usize = 8;

/// Requests of a typical PLC cycle: a read of all input registers, and a write of all holding registers.
const REQUESTS: [(&str, &[u8]); 2] = [
    ("modbus-read-input", &[UNIT, 0x04, 0, 0, 0, 6]),
    ("modbus-write-output", &[UNIT, 0x10, 0, 0, 0, 4, 8, 1, 0, 0x13, 0x88, 0x07, 0xD0, 0x0F, 0xA0]),
];

/// A device with plain registers.
struct Registers([u16; REGISTERS]);

impl Device for Registers {
    fn coil(&self, _: u16) -> Result<bool, Exception> {
        Err(Exception::IllegalDataAddress)
    }

    fn discrete_input(&self, _: u16) -> Result<bool, Exception> {
        Err(Exception::IllegalDataAddress)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        self.0.get(usize::from(address)).copied().ok_or(Exception::IllegalDataAddress)
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        self.holding_register(address)
    }

    fn write_coils(&mut self, _: u16, _: Bits<'_>) -> Result<(), Exception> {
        Err(Exception::IllegalDataAddress)
    }

    fn write_registers(&mut self, _: u16, _: Words<'_>) -> Result<(), Exception> {
        Err(Exception::IllegalDataAddress)
    }

    fn identification(&self) -> Identification {
        Identification { vendor_name: "", product_code: "", revision: "", regular: None }
    }
}

/// Counts requests to the gripper, and a request for eight registers, which has a limit.
// Not inlined, so that register allocation is independent of the other measurements.
#[inline(never)]
pub(crate) fn count(counter: &Counter) {
    let mut gripper = Gripper(Images::new(false));
    for (name, request) in REQUESTS {
        let answered = one(counter, name, request, &mut gripper);
        assert!(answered > 5, "an answer without an exception");
    }
    let mut registers = Registers(black_box([0x1234; REGISTERS]));
    let answered = one(counter, "modbus-8-registers", &[UNIT, 3, 0, 0, 0, REGISTERS as u8], &mut registers);
    assert!(answered == 5 + 2 * REGISTERS, "an answer with eight registers");
}

/// Counts from the first byte of a request to its sealed answer, without transmission. Returns the answer's length.
fn one(counter: &Counter, name: &str, request: &[u8], device: &mut impl Device) -> usize {
    let timing = black_box(Timing::of(115_200, 11));
    let mut server = Server::new(Config { unit: UNIT, mode: Mode::Strict, broadcast: false }, timing);
    let device = black_box(device);
    // The master calculates this checksum, so it is not counted.
    let mut sealed = heapless::Vec::<u8, MAX_FRAME_LEN>::new();
    let fits = sealed
        .extend_from_slice(request)
        .and_then(|()| sealed.extend_from_slice(&crc(request).to_le_bytes()));
    assert!(fits.is_ok(), "a request must fit a frame");
    let frame = black_box(sealed.as_slice());
    let mut answered = 0;
    let instructions = counter.of(|| {
        for &byte in frame {
            let _ = server.push(Character::Byte(byte), 0, device);
        }
        if let Some(Event::Answer(answer)) = server.silence(timing.t3_5_us, device) {
            answered = black_box(answer).len();
        }
    });
    hprintln!("{} {} 1", name, instructions);
    answered
}
