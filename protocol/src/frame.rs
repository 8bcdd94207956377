//! Frames: the packets that carry every request and reply (command set, 1.2.1).
//!
//! ```text
//! AA AA AA | id | size low, high | payload | checksum low, high
//! ```
//!
//! [`FrameParser`] turns bytes into frames and [`FrameEncoder`] turns a payload into bytes. Neither interprets the
//! payload: see [`command`](crate::command) and [`reply`](crate::reply).

mod encoder;
mod parser;

pub use encoder::{BufferTooSmall, FrameEncoder, Payload};
pub use parser::{Event, FrameCounters, FrameParser};

/// The value of all three preamble bytes.
pub const PREAMBLE_BYTE: u8 = 0xAA;

/// Length of the preamble, in bytes.
pub const PREAMBLE_LEN: usize = 3;

/// Bytes of a frame in addition to its payload: preamble, id, size and checksum.
pub const OVERHEAD: usize = 8;

/// Length of the longest message that grippers in the field send or accept, in bytes, including the overhead.
pub const MAX_MESSAGE_LEN: usize = 1024;

/// An intact frame: a command id and a view of the payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct Frame<'a> {
    /// The command id (command set, chapter 3).
    pub id: u8,
    /// The payload: the parameters of a request, or the status code and values of a reply.
    pub payload: &'a [u8],
}
