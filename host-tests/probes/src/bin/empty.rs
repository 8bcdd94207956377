//! The program that every other probe is measured beside.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use wsg_probes::{bytes, opaque};

#[entry]
fn main() -> ! {
    loop {
        opaque(bytes());
    }
}
