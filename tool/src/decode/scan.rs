//! Divides a recording into frames and other bytes, with their positions and the reason why bytes belong to no frame.
//!
//! It finds the same frames as [`FrameParser`](wsg_protocol::FrameParser), which does not report positions: it tries to parse a
//! frame at each byte, and advances by one byte if that fails.

use std::ops::Range;

use wsg_protocol::checksum;
use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};

/// Length in bytes of preamble, id and size.
const HEAD_LEN: usize = 6;
/// Length of the checksum in bytes.
const CHECKSUM_LEN: usize = 2;
/// Maximum payload length of a message in bytes.
pub(crate) const MAX_PAYLOAD_LEN: usize = MAX_MESSAGE_LEN - OVERHEAD;

/// A run of bytes of one kind.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Run {
    /// Position in the recording.
    pub(crate) range: Range<usize>,
    pub(crate) kind: Kind,
}

/// The kind of a run of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Frame,
    /// A whole frame with a wrong checksum, and the expected one.
    BadChecksum([u8; CHECKSUM_LEN]),
    /// A preamble followed by a payload size above the maximum.
    TooLong(u16),
    /// A truncated frame, and the least number of missing bytes.
    Incomplete(usize),
    /// Bytes without a preamble.
    Noise,
}

/// Divides a recording into runs, which cover all of its bytes.
pub(crate) fn scan(bytes: &[u8]) -> Vec<Run> {
    let mut runs = Vec::new();
    // Start of the bytes dropped so far, and the false frames among them.
    let mut dropped_from = 0;
    let mut false_frames: Vec<Run> = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        match judge(bytes.get(at..).unwrap_or(&[])) {
            Some((Kind::Frame, len)) => {
                drop_up_to(at, dropped_from, &mut false_frames, &mut runs);
                runs.push(Run { range: at..at + len, kind: Kind::Frame });
                at += len;
                dropped_from = at;
                continue;
            }
            // A false frame inside another one adds no information.
            Some((kind, len)) if false_frames.last().is_none_or(|last| last.range.end <= at) => {
                false_frames.push(Run { range: at..at + len, kind });
            }
            _ => {}
        }
        at += 1;
    }
    drop_up_to(bytes.len(), dropped_from, &mut false_frames, &mut runs);
    runs
}

/// Classifies the bytes at the start and returns their length, or `None` if they are not a preamble.
fn judge(bytes: &[u8]) -> Option<(Kind, usize)> {
    let [PREAMBLE_BYTE, PREAMBLE_BYTE, PREAMBLE_BYTE, rest @ ..] = bytes else { return None };
    let [_, low, high, ..] = rest else {
        return Some((Kind::Incomplete(HEAD_LEN - PREAMBLE_LEN - rest.len() + CHECKSUM_LEN), bytes.len()));
    };
    let size = u16::from_le_bytes([*low, *high]);
    if usize::from(size) > MAX_PAYLOAD_LEN {
        return Some((Kind::TooLong(size), HEAD_LEN));
    }
    let len = OVERHEAD + usize::from(size);
    let Some((covered, came)) = bytes.get(..len).and_then(|frame| frame.split_last_chunk()) else {
        return Some((Kind::Incomplete(len - bytes.len()), bytes.len()));
    };
    let expected = checksum::of(covered).to_le_bytes();
    let kind = if *came == expected { Kind::Frame } else { Kind::BadChecksum(expected) };
    Some((kind, len))
}

/// Adds the bytes dropped up to `end` as runs.
fn drop_up_to(end: usize, from: usize, false_frames: &mut Vec<Run>, runs: &mut Vec<Run>) {
    let mut at = from;
    for Run { range, kind } in false_frames.drain(..) {
        if at < range.start {
            push_dropped(Run { range: at..range.start, kind: Kind::Noise }, runs);
        }
        at = range.end.min(end);
        push_dropped(Run { range: range.start..at, kind }, runs);
    }
    if at < end {
        push_dropped(Run { range: at..end, kind: Kind::Noise }, runs);
    }
}

/// Adds a dropped run. Noise after an oversized frame is merged into the run of that frame.
fn push_dropped(run: Run, runs: &mut Vec<Run>) {
    if matches!(run.kind, Kind::Noise | Kind::TooLong(_))
        && let Some(last) = runs.last_mut()
        && matches!(last.kind, Kind::TooLong(_))
    {
        last.range.end = run.range.end;
    } else {
        runs.push(run);
    }
}

#[cfg(test)]
mod tests;
