//! Size of formatting commands and replies as readable text with `core::fmt`, floating point included.
#![no_std]
#![no_main]

use core::fmt::Write;

use cortex_m_rt::entry;
use wsg_probes::on_target::{bytes, opaque};
use wsg_protocol::{Command, Frame, Reply};

struct Sink;

impl Write for Sink {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        opaque(text);
        Ok(())
    }
}

#[entry]
fn main() -> ! {
    loop {
        let frame = Frame { id: opaque(0), payload: bytes() };
        if let Ok(command) = Command::decode(&frame) {
            let _ = opaque(write!(Sink, "{command}"));
        }
        if let Ok(reply) = Reply::decode(&frame) {
            let _ = opaque(write!(Sink, "{reply}"));
        }
    }
}
