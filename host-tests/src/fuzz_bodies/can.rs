//! Messages in CAN frames against a naive reader, and the same frames as SLCAN lines.

use bus_slcan::{self as slcan, ClassicFrame, Line};
use embedded_can::{Frame as _, StandardId};
use wsg_protocol::can::{FULL, HALF_MESSAGE_MS, Reassembler, Segments};
use wsg_protocol::{FrameEncoder, Instant, checksum};

use super::frames::Seen;
use super::input::Input;

/// Reassembler capacity in CAN frames; small, so that messages often exceed it.
const LIMIT: usize = 5;

const OURS: Option<StandardId> = StandardId::new(0x21);
const FOREIGN: Option<StandardId> = StandardId::new(0x20);

/// Each op is a byte with parameter bytes: a message with a fault of its frames, or any frame.
pub fn can(data: &[u8]) {
    let mut input = Input::new(data);
    let mut capture: Vec<Vec<u8>> = Vec::new();
    while !input.is_empty() {
        let op = input.byte();
        let count = usize::from(input.byte());
        if op & 1 == 0 {
            capture.push(input.bytes(count % FULL + 1).to_vec());
            continue;
        }
        let message: Vec<u8> = FrameEncoder::new(input.byte(), input.bytes(count % 48)).collect();
        capture.extend(frames_with(&message, op >> 1 & 7, usize::from(op >> 4)));
    }
    capture.retain(|frame| !frame.is_empty());
    reassembled(&capture);
    lines(&capture);
    // Arbitrary bytes from a serial adapter must not cause a panic.
    let mut decoder = slcan::Decoder::new();
    for byte in data {
        let _ = decoder.push::<ClassicFrame>(*byte);
    }
}

/// Returns the frames of a message with a fault of the one at this index: lost (0), doubled (1), short (2), wrong (3), or
/// none.
pub(super) fn frames_with(message: &[u8], fault: u8, at: usize) -> Vec<Vec<u8>> {
    let segments = Segments::new(message.iter().copied());
    let mut frames: Vec<Vec<u8>> = segments.map(|segment| segment.data().to_vec()).collect();
    assert!(frames.iter().flatten().eq(message), "segments contain exactly the message");
    let at = at % frames.len();
    match fault {
        0 => drop(frames.remove(at)),
        1 => frames.insert(at, frames[at].clone()),
        2 => frames[at].truncate(3),
        3 => frames[at][0] ^= 0x10,
        _ => {}
    }
    frames
}

/// Compares the reassembler with a reader of the whole capture. Interleaved foreign frames have no effect.
fn reassembled(capture: &[Vec<u8>]) {
    let (Some(ours), Some(foreign)) = (OURS, FOREIGN) else { unreachable!("both have 11 bits") };
    let mut reassembler = Reassembler::<LIMIT>::new(ours, HALF_MESSAGE_MS);
    let mut seen: Vec<Seen> = Vec::new();
    let now = Instant::from_millis(0);
    for data in capture {
        for id in [foreign, ours] {
            let Some(frame) = ClassicFrame::new(id, data) else { unreachable!("a frame has up to 8 bytes") };
            reassembler.receive(now, &frame, |event| seen.push(event.into()));
        }
    }
    if let Some(at) = reassembler.poll_timeout() {
        reassembler.handle_timeout(at, |event| seen.push(event.into()));
    }
    assert_eq!(reassembler.poll_timeout(), None, "nothing is held after silence");
    let (expected, dropped) = read_all(capture);
    assert_eq!(seen, expected);
    let counters = reassembler.counters();
    assert_eq!((usize::from(counters.dropped), usize::from(counters.foreign)), (dropped, capture.len()));
}

/// Parses the whole capture naively: a message at the first frame, or from the next frame on. Also returns the number
/// of dropped frames.
fn read_all(capture: &[Vec<u8>]) -> (Vec<Seen>, usize) {
    let (mut seen, mut dropped, mut at) = (Vec::new(), 0, 0);
    while let Some(rest) = capture.get(at..).filter(|rest| !rest.is_empty()) {
        let (found, frames) = found_at(rest);
        seen.extend(found);
        dropped += usize::from(frames == 0);
        at += frames.max(1);
    }
    (seen, dropped)
}

/// Returns the event at the first frame, and the number of frames used by a message.
fn found_at(rest: &[Vec<u8>]) -> (Option<Seen>, usize) {
    let first = &rest[0];
    if first.len() != FULL || !first.starts_with(&[0xAA; 3]) {
        return (None, 0);
    }
    let (id, size) = (first[3], u16::from_le_bytes([first[4], first[5]]));
    let length = usize::from(size) + 8;
    let frames = length.div_ceil(FULL);
    if frames > LIMIT {
        return (Some(Seen::Oversize(id, size)), 0);
    }
    let cut = |frame: usize| if frame + 1 == frames { length - frame * FULL } else { FULL };
    if rest.len() < frames || (0..frames).any(|frame| rest[frame].len() != cut(frame)) {
        return (None, 0);
    }
    let bytes = rest[..frames].concat();
    let (covered, received) = bytes.split_at(length - 2);
    if checksum::of(covered).to_le_bytes() != received {
        return (Some(Seen::BadChecksum(id, size)), 0);
    }
    (Some(Seen::Frame(id, covered[6..].to_vec())), frames)
}

/// Checks that a frame survives encoding as an SLCAN line.
fn lines(capture: &[Vec<u8>]) {
    let Some(id) = OURS else { unreachable!("it has 11 bits") };
    let mut decoder = slcan::Decoder::new();
    for frame in capture.iter().filter_map(|data| ClassicFrame::new(id, data)) {
        let line = slcan::encode(&frame);
        let read: Vec<Line<ClassicFrame>> =
            line.as_bytes().iter().filter_map(|&byte| decoder.push(byte)).collect();
        assert_eq!(read, [Line::Frame(frame)]);
    }
}
