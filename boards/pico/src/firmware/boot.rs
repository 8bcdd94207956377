//! The boot loader of the Raspberry Pi Pico: its start, and the jump to the image in slot A.

#![no_std]
#![no_main]
#![deny(
    clippy::undocumented_unsafe_blocks,
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic
)]
#![allow(dead_code, reason = "the modules serve the firmware, too")]

mod clock;
mod faults;
mod flash;
mod pins;
mod registers;
mod watchdog;

use core::ptr::with_exposed_provenance;

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use rp2040_hal::pac;
use wsg_boot::{Blocking, Flash, Stopped};
use wsg_update::{Keys, Target};

use crate::flash::slots::{self, SLOT_A_AT};

/// The second boot stage, which makes flash readable as memory. The boot ROM runs it.
#[unsafe(link_section = ".boot2")]
#[unsafe(no_mangle)]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

/// For the firmware, at a fixed address.
#[unsafe(link_section = ".verify")]
#[used]
static VERIFY: wsg_boot::Verify = wsg_boot::verify;

/// Duration of each phase of the LED in the safe state, in cycles of the running clock.
const BLINK: u32 = clock::SYS_HZ / 8;

#[entry]
fn main() -> ! {
    // Started before any wait, so that a failed start resets the MCU.
    watchdog::start();
    watchdog::wait_for_flash();
    // SAFETY: `main` runs once, and no other code takes the peripherals.
    let peripherals = unsafe { pac::Peripherals::steal() };
    // Outputs are low from here until the image sets them.
    let (_wires, mut led) = pins::init(peripherals);
    // Without the crystal, a check takes longer than the watchdog waits. The image could not run either.
    let _ = clock::start();
    let mut flash = Flash {
        a: Blocking(slots::a()),
        b: Blocking(slots::b()),
        state: slots::state(),
        trust: slots::trust(),
    };
    match flash.start(const { Target::of(slots::ID) }, Keys::BUILT_IN, &watchdog::wait_for_flash) {
        Ok(_) => start_slot_a(),
        Err(Stopped::NoImage(_)) => {
            let mut is_lit = false;
            loop {
                is_lit = !is_lit;
                led.indicate(is_lit);
                watchdog::wait_for_flash();
                cortex_m::asm::delay(BLINK);
            }
        }
        // The watchdog resets the MCU, and the next start tries again.
        Err(Stopped::Flash) => loop {
            cortex_m::asm::nop();
        },
    }
}

/// Jumps to the image in slot A. It starts its clock again, and the watchdog runs.
fn start_slot_a() -> ! {
    // SAFETY: slot A starts with the vector table of a signed image for this board. No interrupt is enabled, so the vector
    // table may change, and nothing of this program is used again.
    unsafe {
        (*SCB::PTR).vtor.write(SLOT_A_AT as u32);
        cortex_m::asm::bootload(with_exposed_provenance(SLOT_A_AT))
    }
}
