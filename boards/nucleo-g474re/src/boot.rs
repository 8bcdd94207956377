//! The boot loader of the board.

#![no_std]
#![no_main]

use cortex_m_rt::entry;

use wsg_nucleo_g474re::drivers::Nucleo;

#[entry]
fn main() -> ! {
    wsg_stm32::boot::<Nucleo>()
}
