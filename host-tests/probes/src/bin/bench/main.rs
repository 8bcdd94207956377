//! Counts instructions in the emulator and prints them over semihosting, one line each with name and number.
//!
//! `cargo xtask bench` runs it with `-icount shift=10`: an instruction then takes 1024 ns of machine time, and SysTick at the
//! microcontroller's initial 4 MHz counts 4.096 ticks for it. The counts are therefore exact and repeatable. The machine's core
//! also executes programs for a Cortex-M0+, whose counts are measured in the same way.
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
// Links the panic handler.
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
