//! The boot loader of the board.

#![no_std]
#![no_main]

use cortex_m_rt::entry;

use wsg_b_l475e_iot01a::drivers::Iot01a;

#[entry]
fn main() -> ! {
    wsg_stm32::boot::<Iot01a>()
}
