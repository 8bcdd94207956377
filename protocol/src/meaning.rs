//! Frames in words, for logs: which way they go decides whether they are requests or replies.

use core::fmt::{Display, Formatter, Result};

use crate::command::{Command, CommandId};
use crate::frame::Frame;
use crate::reply::Reply;

/// Which way a frame goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
pub enum Direction {
    /// A request.
    ToGripper,
    /// A reply.
    FromGripper,
}

impl Display for Direction {
    /// `->` to the gripper, `<-` from it.
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        f.write_str(match self {
            Self::ToGripper => "->",
            Self::FromGripper => "<-",
        })
    }
}

/// What a frame says, as a person reads it in a log: the request or the reply; or, of one that the manual forbids, its command and
/// why it is refused.
///
/// ```
/// use wsg_protocol::{Direction, Frame, Meaning};
///
/// let payload = [0x00, 0x00, 0xA0, 0x41, 0x00, 0x00, 0x48, 0x42];
/// let request = Meaning { direction: Direction::ToGripper, frame: Frame { id: 0x25, payload: &payload } };
/// assert_eq!(request.to_string(), "25h Grip Part 20.0 mm 50.0 mm/s");
/// let reply = Meaning { direction: Direction::FromGripper, frame: Frame { id: 0x25, payload: &[26, 0] } };
/// assert_eq!(reply.to_string(), "25h Grip Part E_CMD_PENDING");
/// let neither = Meaning { direction: Direction::FromGripper, frame: Frame { id: 0x25, payload: &[26] } };
/// assert_eq!(neither.to_string(), "25h Grip Part: payload too short");
/// // Answers of a script have no form.
/// let script = Meaning { direction: Direction::FromGripper, frame: Frame { id: 0xA0, payload: &[1, 0, 7] } };
/// assert_eq!(script.to_string(), "A0h script command 3 bytes");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Meaning<'a> {
    /// Which way it goes.
    pub direction: Direction,
    /// The frame.
    pub frame: Frame<'a>,
}

impl Display for Meaning<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let refusal = match self.direction {
            Direction::ToGripper => match Command::decode(&self.frame) {
                Ok(command) => return command.fmt(f),
                Err(refusal) => refusal,
            },
            Direction::FromGripper => match Reply::decode(&self.frame) {
                Ok(reply) => return reply.fmt(f),
                Err(refusal) => refusal,
            },
        };
        let id = CommandId::from_code(self.frame.id);
        match id {
            // A script answers as it likes.
            CommandId::Unknown(0xA0..=0xBF) => write!(f, "{id} {} bytes", self.frame.payload.len()),
            _ => write!(f, "{id}: {refusal}"),
        }
    }
}
