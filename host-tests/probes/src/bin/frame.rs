//! Every function of parser and encoder: the size of a program that handles only frames.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use wsg_probes::on_target::{bytes, opaque};
use wsg_protocol::{FrameEncoder, FrameParser};

#[entry]
fn main() -> ! {
    static mut PARSER: FrameParser<64> = FrameParser::new();
    let parser: &mut FrameParser<64> = opaque(&mut *PARSER);
    loop {
        opaque(&parser.push(opaque(0)));
        opaque(&parser.push_slice(bytes()));
        opaque(&parser.poll());
        opaque(&parser.expire());
        parser.reset();
        opaque(parser.counters().dropped);
        opaque(parser.is_mid_frame());
        let encoder = FrameEncoder::new(opaque(0), bytes());
        for byte in encoder {
            opaque(byte);
        }
    }
}
