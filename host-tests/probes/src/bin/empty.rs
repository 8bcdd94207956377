//! An empty program, the baseline of all other probes.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use wsg_probes::on_target::{bytes, opaque};

#[entry]
fn main() -> ! {
    loop {
        opaque(bytes());
    }
}
