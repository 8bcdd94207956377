//! Parser and encoder, every function of both: what a program takes that speaks frames and nothing else.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use wsg_probes::{bytes, opaque};
use wsg_protocol::{FrameEncoder, FrameParser};

#[entry]
fn main() -> ! {
    static mut PARSER: FrameParser<64> = FrameParser::new();
    loop {
        let parser: &mut FrameParser<64> = opaque(&mut *PARSER);
        for &byte in bytes() {
            opaque(parser.push(byte));
        }
        opaque(parser.push_slice(bytes()));
        opaque(parser.poll());
        opaque(parser.expire());
        opaque(parser.counters());
        opaque(parser.is_mid_frame());
        parser.reset();
        let mut encoder = FrameEncoder::new(opaque(0), bytes());
        while let Some(byte) = encoder.next() {
            opaque(byte);
        }
    }
}
