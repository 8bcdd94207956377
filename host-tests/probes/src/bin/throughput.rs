//! Measures the parsing throughput of the host in one run: our parser, a plain loop over the table in the command set's
//! appendix D, and the parser of another protocol, whose checksum consists of two sums without a table.
//!
//! Prints one line each, with name and GB/s (10⁹ bytes of whole frames per second). They take turns, so that other load affects
//! all of them. The best turn counts, because load only slows a turn down.

use std::hint::black_box;
use std::time::Instant;

use wsg_protocol::{Event, FrameEncoder, FrameParser, checksum};

const PAYLOAD: usize = 64;
const FRAMES: usize = 4_000;
const TURNS: usize = 60;

fn main() {
    let payload: [u8; PAYLOAD] = core::array::from_fn(|at| at as u8);
    let frames: Vec<u8> = (0..FRAMES).flat_map(|_| FrameEncoder::new(0x06, &payload[..])).collect();
    let table: [u16; 256] = core::array::from_fn(|index| checksum::update(0, index as u8));
    let ubx: Vec<u8> = (0..FRAMES).flat_map(|_| ubx_frame(&payload)).collect();
    let (mut bulk, mut bytewise) = (FrameParser::<PAYLOAD>::new(), FrameParser::<PAYLOAD>::new());
    let mut other = ublox::Parser::<_, ublox::proto23::Proto23>::new(ublox::FixedBuffer::<1024>::new());
    let mut other_bytewise =
        ublox::Parser::<_, ublox::proto23::Proto23>::new(ublox::FixedBuffer::<1024>::new());

    let mut readers: [Reader<'_>; 5] = [
        ("bulk-path", &frames, &mut |bytes| by_slices(&mut bulk, bytes)),
        ("table-loop", &frames, &mut |bytes| plain_loop(&table, bytes)),
        ("byte-path", &frames, &mut |bytes| by_bytes(&mut bytewise, bytes)),
        ("ublox-slices", &ubx, &mut |bytes| by_ublox(&mut other, bytes, 8 * (PAYLOAD + 8))),
        ("ublox-bytes", &ubx, &mut |bytes| by_ublox(&mut other_bytewise, bytes, 1)),
    ];
    let mut best = [f64::INFINITY; 5];
    for _ in 0..TURNS {
        for ((name, bytes, parse), best) in readers.iter_mut().zip(&mut best) {
            let begun = Instant::now();
            assert_eq!(parse(black_box(bytes)), FRAMES, "{name} must find every frame");
            *best = best.min(begun.elapsed().as_secs_f64());
        }
    }
    for ((name, bytes, _), best) in readers.iter().zip(best) {
        println!("{name} {:.3}", bytes.len() as f64 / best / 1e9);
    }
}

/// A name, the bytes to parse, and a function that parses them and returns the number of frames.
type Reader<'a> = (&'static str, &'a [u8], &'a mut dyn FnMut(&[u8]) -> usize);

fn by_slices(parser: &mut FrameParser<PAYLOAD>, bytes: &[u8]) -> usize {
    let (mut frames, mut rest) = (0, bytes);
    while let (taken, Some(event)) = parser.push_slice(rest) {
        frames += usize::from(matches!(black_box(event), Event::Frame(_)));
        rest = &rest[taken..];
    }
    frames
}

fn by_bytes(parser: &mut FrameParser<PAYLOAD>, bytes: &[u8]) -> usize {
    let is_frame = |byte: &&u8| matches!(black_box(parser.push(**byte)), Some(Event::Frame(_)));
    bytes.iter().filter(is_frame).count()
}

/// The minimal work of a byte-by-byte parser: copies each byte and looks it up, as in the appendix.
fn plain_loop(table: &[u16; 256], bytes: &[u8]) -> usize {
    let mut frame = [0; PAYLOAD + 8];
    let mut intact = 0;
    for bytes in bytes.chunks_exact(frame.len()) {
        let mut value = checksum::START;
        for (slot, &byte) in frame.iter_mut().zip(bytes) {
            *slot = byte;
            value = table[usize::from(value as u8 ^ byte)] ^ (value >> 8);
        }
        black_box(&frame);
        intact += usize::from(value == 0);
    }
    intact
}

fn by_ublox<B: ublox::UnderlyingBuffer, P: ublox::UbxProtocol>(
    parser: &mut ublox::Parser<B, P>,
    bytes: &[u8],
    at_a_time: usize,
) -> usize {
    let mut frames = 0;
    for chunk in bytes.chunks(at_a_time) {
        let mut found = parser.consume_ubx(chunk);
        while let Some(packet) = found.next() {
            frames += usize::from(black_box(packet).is_ok());
        }
    }
    frames
}

/// Returns a UBX frame with a message unknown to the crate, which therefore only deframes it.
fn ubx_frame(payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0xB5, 0x62, 0x77, 0x77];
    bytes.extend_from_slice(&(payload.len() as u16).to_le_bytes());
    bytes.extend_from_slice(payload);
    let (mut a, mut b) = (0_u8, 0_u8);
    for byte in &bytes[2..] {
        a = a.wrapping_add(*byte);
        b = b.wrapping_add(a);
    }
    bytes.extend([a, b]);
    bytes
}
