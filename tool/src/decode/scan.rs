//! Frames in a recording, with what stands between them: where each begins, and why a byte belongs to none.
//!
//! It finds the frames that [`FrameParser`](wsg_protocol::FrameParser) finds, which tells no places: try a frame at the first byte;
//! when it proves false go on one byte further.

use std::ops::Range;

use wsg_protocol::checksum;
use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};

/// Preamble, id, size.
const HEAD_LEN: usize = 6;
/// Bytes of the checksum.
const CHECKSUM_LEN: usize = 2;
/// The longest payload of a message.
pub(crate) const MAX_PAYLOAD_LEN: usize = MAX_MESSAGE_LEN - OVERHEAD;

/// A run of bytes.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Run {
    /// Which bytes of the recording.
    pub(crate) range: Range<usize>,
    pub(crate) kind: Kind,
}

/// What a run of bytes is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// An intact frame.
    Frame,
    /// A whole frame whose checksum should be this one.
    BadChecksum([u8; CHECKSUM_LEN]),
    /// A preamble, behind which a frame announces so many bytes of payload.
    TooLong(u16),
    /// A frame of which so many bytes do not come.
    Incomplete(usize),
    /// There is no preamble.
    Noise,
}

/// The runs of a recording: together they are all of it.
pub(crate) fn scan(bytes: &[u8]) -> Vec<Run> {
    let mut runs = Vec::new();
    // What is no frame, up to here: from where, and what false frames there are in it.
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
            // One inside another false one says nothing more.
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

/// What a recording begins with, and how long that is; `None` where it is no preamble.
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

/// The dropped bytes up to here as runs.
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

/// What announces too much is one run with what is dropped behind it.
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
