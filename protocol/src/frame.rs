//! Frames: the packets that carry every request and reply (command set, 1.2.1).
//!
//! ```text
//! AA AA AA | id | size low, high | payload | checksum low, high
//! ```
//!
//! The [`FrameParser`] takes bytes and gives frames; the [`FrameEncoder`] takes a payload and gives bytes. Neither
//! knows what a payload means: see [`command`](crate::command) and [`reply`](crate::reply).

mod encoder;
mod parser;

pub use encoder::{BufferTooSmall, FrameEncoder, Payload};
pub use parser::{Event, FrameCounters, FrameParser};

/// The three bytes that open a frame are all this one.
pub const PREAMBLE_BYTE: u8 = 0xAA;

/// Bytes of the preamble.
pub const PREAMBLE_LEN: usize = 3;

/// Bytes of a frame besides its payload: preamble, id, size, checksum.
pub const OVERHEAD: usize = 8;

/// The longest message that grippers in the field send or take, in bytes, all counted.
pub const MAX_MESSAGE_LEN: usize = 1024;

/// One intact frame: an id and a view of its payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct Frame<'a> {
    /// The command id (command set, chapter 3).
    pub id: u8,
    /// The payload: parameters of a request, or status code and values of a reply.
    pub payload: &'a [u8],
}
