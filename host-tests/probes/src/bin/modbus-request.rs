//! Counts what a MODBUS request for eight registers costs the server on a serial line, in the emulator: from the first
//! character to the answer with its checksum. Says `modbus-request INSTRUCTIONS REQUESTS` over semihosting.
//!
//! `cargo xtask modbus` runs it with `-icount shift=10`: an instruction then takes 1024 ns of the machine's time, and
//! SysTick, at the 4 MHz that the microcontroller starts with, counts 4.096 ticks for each.
#![no_std]
#![no_main]

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
// For its vectors alone.
use stm32_metapac as _;
use wsg_probes::opaque;
use wsg_protocol::modbus::rtu::{Character, Config, Event, Mode, Server, Timing, crc};
use wsg_protocol::modbus::{Bits, Device, Exception, Identification, Words};

const UNIT: u8 = 1;
const REGISTERS: usize = 8;
const REQUESTS: u32 = 64;

/// Ticks for 1000 instructions.
const TICKS_PER_1000: u64 = 4_096;

/// Registers and nothing else.
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

#[entry]
fn main() -> ! {
    let config = Config { unit: UNIT, mode: Mode::Strict, broadcast: false };
    let timing = opaque(Timing::of(115_200, 11));
    let mut server = Server::new(config, timing);
    let mut device = Registers(opaque([0x1234; REGISTERS]));
    let mut request = [UNIT, 3, 0, 0, 0, REGISTERS as u8, 0, 0];
    let sum = crc(&request[..6]).to_le_bytes();
    request[6..].copy_from_slice(&sum);
    let request = opaque(request);
    let [first, rest @ ..] = request;

    let Some(mut core) = cortex_m::Peripherals::take() else { end(false) };
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(0x00FF_FFFF);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    // What is known first, so that a machine with another clock gives no figure at all.
    let loops = ticks(|| {
        let mut left = 100_u32;
        // SAFETY: it changes nothing but its own register and the flags.
        unsafe { core::arch::asm!("2: subs {0}, #1", "bne 2b", inout(reg) left) };
        opaque(left);
    });
    if !(800..=860).contains(&loops) {
        hprintln!("SysTick counts {} ticks instead of 820 for 200 instructions", loops);
        end(false);
    }

    let mut counted = 0;
    for _ in 0..REQUESTS {
        counted += u64::from(ticks(|| {
            let _ = server.push(Character::Byte(first), timing.t3_5_us, &mut device);
            for byte in rest {
                let _ = server.push(Character::Byte(byte), 0, &mut device);
            }
            let answer = server.silence(timing.t3_5_us, &mut device);
            opaque(matches!(answer, Some(Event::Answer(_))));
        }));
    }
    // Not only timed but right.
    for byte in request {
        let _ = server.push(Character::Byte(byte), 0, &mut device);
    }
    let answer = server.silence(timing.t3_5_us, &mut device);
    let is_right = matches!(answer, Some(Event::Answer([UNIT, 3, 16, 0x12, 0x34, .., 0x12, 0x34, _, _])));
    hprintln!("modbus-request {} {}", counted * 1_000 / TICKS_PER_1000, REQUESTS);
    end(is_right && server.counters().server_messages as u32 == REQUESTS + 1)
}

/// The ticks that this takes.
#[inline(always)]
fn ticks(work: impl FnOnce()) -> u32 {
    let before = SYST::get_current();
    work();
    // It counts down, in 24 bits.
    before.wrapping_sub(SYST::get_current()) & 0x00FF_FFFF
}

fn end(is_right: bool) -> ! {
    debug::exit(if is_right { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::nop();
    }
}
