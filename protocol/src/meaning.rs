//! Frames as readable text, for logs. The direction determines whether a frame is decoded as a request or a reply.

use core::fmt::{Display, Formatter, Result};

use crate::command::{Command, CommandId};
use crate::frame::Frame;
use crate::reply::Reply;

/// The direction of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
pub enum Direction {
    /// A request to the gripper.
    ToGripper,
    /// A reply from the gripper.
    FromGripper,
}

impl Display for Direction {
    /// Formats `->` for frames to the gripper and `<-` for frames from it.
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        f.write_str(match self {
            Self::ToGripper => "->",
            Self::FromGripper => "<-",
        })
    }
}

/// Formats a frame as readable text for a log: the decoded request or reply, or the command and the error if the frame
/// violates the manual.
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
/// // Replies of a script have no defined format.
/// let script = Meaning { direction: Direction::FromGripper, frame: Frame { id: 0xA0, payload: &[1, 0, 7] } };
/// assert_eq!(script.to_string(), "A0h script command 3 bytes");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Meaning<'a> {
    /// The direction of the frame.
    pub direction: Direction,
    /// The frame to describe.
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
            // The format of a script's reply is unknown.
            CommandId::Unknown(0xA0..=0xBF) => write!(f, "{id} {} bytes", self.frame.payload.len()),
            _ => write!(f, "{id}: {refusal}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    #[test]
    fn frame_is_decoded_by_direction_and_refusal_shows_its_reason() {
        let meaning =
            |direction, id, payload| Meaning { direction, frame: Frame { id, payload } }.to_string();
        let (to, from) = (Direction::ToGripper, Direction::FromGripper);
        assert_eq!((to.to_string().as_str(), from.to_string().as_str()), ("->", "<-"));
        assert_eq!(meaning(to, 0x22, &[]), "22h Stop");
        assert_eq!(meaning(from, 0x22, &[0, 0]), "22h Stop E_SUCCESS");
        assert_eq!(meaning(from, 0x22, &[0]), "22h Stop: payload too short");
        for (id, len_is_shown) in [(0x9F, false), (0xA0, true), (0xBF, true), (0xC0, false)] {
            assert_eq!(meaning(from, id, &[1, 0, 7]).ends_with(" 3 bytes"), len_is_shown, "{id:02X}h");
        }
    }
}
