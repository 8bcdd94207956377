//! Prints the frames in a stream of SLCAN lines: `cargo run -p bus-slcan --example decode < capture.txt`, or `... <
//! /dev/ttyACM0` for an adapter with an open channel.

use std::io::{self, BufRead, Write};

use bus_slcan::{ClassicFrame, Decoder, Line};
use embedded_can::{Frame, Id};

fn main() -> io::Result<()> {
    let mut input = io::stdin().lock();
    let mut output = io::stdout().lock();
    let mut decoder = Decoder::new();
    loop {
        let bytes = input.fill_buf()?;
        if bytes.is_empty() {
            return Ok(());
        }
        for &byte in bytes {
            match decoder.push::<ClassicFrame>(byte) {
                Some(Line::Frame(frame)) => print(&mut output, &frame)?,
                Some(Line::Malformed) => writeln!(output, "malformed")?,
                Some(Line::Command(..) | Line::Taken(_) | Line::Done | Line::Refused) | None => {}
            }
        }
        let taken = bytes.len();
        input.consume(taken);
    }
}

fn print(output: &mut impl Write, frame: &ClassicFrame) -> io::Result<()> {
    match frame.id() {
        Id::Standard(id) => write!(output, "{:>8X}", id.as_raw())?,
        Id::Extended(id) => write!(output, "{:08X}", id.as_raw())?,
    }
    if frame.is_remote_frame() {
        writeln!(output, " remote {}", frame.dlc())
    } else {
        writeln!(output, " {:02X?}", frame.data())
    }
}
