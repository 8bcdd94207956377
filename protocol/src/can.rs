//! Carries the messages of the binary protocol over classic CAN, in both directions.
//!
//! The bytes of each message (a [`Frame`](crate::frame) with preamble and checksum) are sent in CAN data frames with an
//! 11-bit identifier. Each frame holds eight bytes and the last one the remainder. There is no header, sequence number
//! or padding. A controller sends on identifier N and the gripper on N + 1; see [`Identifiers`].
//!
//! ```text
//! Grip Part, 16 bytes    [AA AA AA 25 08 00 p0 p1] [p2 p3 p4 p5 p6 p7 c0 c1]    two full frames
//! its reply, 10 bytes    [AA AA AA 25 02 00 s0 s1] [c0 c1]
//! Stop, 8 bytes          [AA AA AA 22 00 00 c0 c1]                              one full frame
//! ```
//!
//! The length of a CAN frame therefore does not mark the end of a message; only the size field does. But the size field
//! also determines the length of every CAN frame of the message, and CAN thereby adds redundancy to a weak checksum.
//! The [`Reassembler`] enforces it. A message begins at the start of a CAN frame and ends at the end of one, and all
//! its frames but the last are full. Anything else is rejected, regardless of its checksum.
//!
//! CAN guarantees intact frames, and their order within one identifier. It may lose a frame (receiver overrun) or
//! duplicate one (a sender that missed the end of its own frame). Either costs at most the messages that the frame
//! belongs to. A duplicated single-frame message cannot be distinguished from two messages. Only requests without
//! parameters are that short; none of them moves the fingers, and no reply is that short.
//!
//! Out of scope: the clock, the CAN controller and bus-off handling. Requires the feature `embedded-can`.

mod identifiers;
mod reassembler;
mod segmenter;

pub use identifiers::{Endpoint, Identifiers};
pub use reassembler::{HALF_MESSAGE_MS, Reassembler, ReassemblerCounters};
pub use segmenter::{Segment, Segmenter, Segments};

/// Data bytes of a full classic CAN frame.
pub const FULL: usize = 8;

/// Number of CAN frames of the longest message that grippers in the field send or accept.
pub const MAX_FRAMES: usize = crate::frame::MAX_MESSAGE_LEN / FULL;

const _: () = assert!(MAX_FRAMES * FULL == crate::frame::MAX_MESSAGE_LEN);
// The first CAN frame of every message is full and includes the size field, which determines all other lengths.
const _: () = assert!(crate::frame::OVERHEAD == FULL);

#[cfg(test)]
mod tests;
