//! The boot loader of an STM32 board: its start, and the jump to the image in slot A.

use core::ptr::with_exposed_provenance;

use cortex_m::peripheral::SCB;
use wsg_boot::{Blocking, Flash, Stopped};
use wsg_update::{Keys, Target};

use crate::board::Stm32Board;
use crate::flash::slot::{A, B, SLOT_A, STATE, TRUST};
use crate::{chip, gpio, watchdog};

/// For the firmware, at a fixed address.
#[unsafe(link_section = ".verify")]
#[used]
static VERIFY: wsg_boot::Verify = wsg_boot::verify;

/// At a clock of 16 MHz, the checks take about 0.6 s, so the image alone starts a faster one.
const STARTS_CLOCK: bool = chip::RESET_HZ < 16_000_000;

/// Clock of the boot loader in Hz.
const fn clock_hz<Board: Stm32Board>() -> u32 {
    if STARTS_CLOCK { Board::HCLK_HZ } else { chip::RESET_HZ }
}

/// Starts the image in slot A after its checks. Without any acceptable image, stays in the safe state: outputs low, LED blinking.
pub fn boot<Board: Stm32Board>() -> ! {
    // Outputs are low from here until the image sets them.
    let (_wires, mut led) = gpio::init::<Board>();
    let watchdog = watchdog::start_for_boot();
    if STARTS_CLOCK {
        let _ = Board::start_clock();
    }
    let mut flash = Flash { a: Blocking(A), b: Blocking(B), state: STATE, trust: TRUST };
    match flash.start(const { Target::of(Board::ID) }, Keys::BUILT_IN, &|| watchdog.feed()) {
        Ok(_) => {
            chip::stop_clock();
            start_slot_a()
        }
        Err(Stopped::NoImage(_)) => {
            let mut is_lit = false;
            loop {
                is_lit = !is_lit;
                led.indicate(is_lit);
                watchdog.feed();
                cortex_m::asm::delay(const { clock_hz::<Board>() / 8 });
            }
        }
        // The watchdog resets the MCU, and the next start tries again.
        Err(Stopped::Flash) => loop {
            cortex_m::asm::nop();
        },
    }
}

/// Jumps to the image in slot A. The watchdog keeps running.
fn start_slot_a() -> ! {
    // SAFETY: slot A starts with the vector table of a signed image for this board. No interrupt is enabled, so the vector
    // table may change, and nothing of this program is used again.
    unsafe {
        (*SCB::PTR).vtor.write(SLOT_A as u32);
        cortex_m::asm::bootload(with_exposed_provenance(SLOT_A))
    }
}
