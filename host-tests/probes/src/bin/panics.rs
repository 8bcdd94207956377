//! The control of the panic gate: a program that must not link, because its index may be past the end.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use wsg_probes::{bytes, opaque};

#[entry]
fn main() -> ! {
    loop {
        opaque(bytes()[opaque(0)]);
    }
}
