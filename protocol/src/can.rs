//! The messages of the binary protocol over classic CAN, both directions.
//!
//! The gripper cuts the bytes of each message (a [`Frame`](crate::frame) with preamble and checksum) into CAN data frames
//! with an 11-bit identifier: eight bytes each, the last one what is left. There is no header, no sequence number and no
//! padding. A controller sends on identifier N and the gripper on N + 1; see [`Identifiers`].
//!
//! ```text
//! Grip Part, 16 bytes    [AA AA AA 25 08 00 p0 p1] [p2 p3 p4 p5 p6 p7 c0 c1]    two full frames
//! its reply, 10 bytes    [AA AA AA 25 02 00 s0 s1] [c0 c1]
//! Stop, 8 bytes          [AA AA AA 22 00 00 c0 c1]                              one full frame
//! ```
//!
//! So a short frame is no sign of a message's end and a full one none of its going on: only the size field tells. But
//! the size field also fixes how every message is cut, and that is the redundancy which CAN adds to a weak checksum. The
//! [`Reassembler`] holds a message to it: it begins at the start of a CAN frame, all its frames but the last are full,
//! and it ends at the end of one. What does not fit is no message, whatever its checksum says.
//!
//! CAN itself sees to intact frames and to their order within one identifier. It may lose a frame (a full receiver) and
//! double one (a sender that missed the end of its own frame). Either costs at most the messages that the frame belongs
//! to. A message of one frame that is doubled comes twice, and nothing on the wire tells that from two messages; but
//! only requests without parameters are that short, none of them moves fingers, and no reply is.
//!
//! Not here: a clock, a controller, bus-off. By the feature `embedded-can`.

mod identifiers;
mod reassembler;
mod segmenter;

pub use identifiers::{Endpoint, Identifiers};
pub use reassembler::{HALF_MESSAGE_MS, Reassembler, ReassemblerCounters};
pub use segmenter::{Segment, Segmenter, Segments};

/// Bytes of data in a full classic CAN frame.
pub const FULL: usize = 8;

/// CAN frames of the longest message that grippers in the field send or take.
pub const MAX_FRAMES: usize = crate::frame::MAX_MESSAGE_LEN / FULL;

const _: () = assert!(MAX_FRAMES * FULL == crate::frame::MAX_MESSAGE_LEN);
// The first CAN frame of every message is full, and shows all that is needed to know how the rest is cut.
const _: () = assert!(crate::frame::OVERHEAD == FULL);

#[cfg(test)]
mod tests;
