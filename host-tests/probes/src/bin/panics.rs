//! Negative control of the panic gate: its index may be out of range, so it must not link.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use wsg_probes::on_target::{bytes, opaque};

#[entry]
fn main() -> ! {
    loop {
        opaque(bytes()[opaque(0)]);
    }
}
