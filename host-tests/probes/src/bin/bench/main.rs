//! Counts instructions, in the emulator, and says the counts over semihosting: a line each, name and number.
//!
//! `cargo xtask bench` runs it with `-icount shift=10`: an instruction then takes 1024 ns of the machine's time, and
//! SysTick, at the 4 MHz that the microcontroller starts with, counts 4.096 ticks for each. So no instruction is missed,
//! and every run gives the same counts. There are as many of a Cortex-M0+'s program on that machine, whose core takes it.
#![no_std]
#![no_main]

mod counting;
#[cfg(feature = "edges")]
mod edge;
mod frames;
mod modbus;
mod profibus;
mod round_trip;

use cortex_m_rt::entry;
use cortex_m_semihosting::debug;
use counting::Counter;
// The panic handler.
use wsg_probes as _;

#[entry]
fn main() -> ! {
    if let Some(core) = cortex_m::Peripherals::take() {
        let counter = Counter::start(core.SYST);
        counter.check();
        frames::count(&counter);
        round_trip::count(&counter);
        modbus::count(&counter);
        profibus::count(&counter);
        #[cfg(feature = "edges")]
        edge::count(&counter);
        debug::exit(debug::EXIT_SUCCESS);
    }
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}
