//! What a session tells its caller.

use core::hash::{Hash, Hasher};

use crate::field::DecodeError;

/// What happened, in the terms of a dialect: names, answers, values.
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
#[non_exhaustive]
pub enum EventOf<N, A, V> {
    /// The gripper answers, and all that is subscribed to is known.
    Connected,
    /// The gripper is silent: nothing is known of it any more.
    Disconnected,
    /// A requested motion has begun (E_CMD_PENDING).
    Pending(N),
    /// The final answer to a request; [`MISMATCH`](super::MISMATCH) is the session's own.
    Answered(A),
    /// A request was sent, and its outcome is not known.
    Unanswered(N),
    /// A Stop was not answered in time and is sent again: the fingers may still move.
    Late(N),
    /// A request was not sent, and will not be.
    Withdrawn(N),
    /// The gripper reported a value.
    Reported(V),
}

/// Why a request was not taken. Nothing of it will be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum RequestError<E = DecodeError> {
    /// The caller's: there is no connection. (Only FAST STOP is taken then, and sent until it is confirmed; and Stop,
    /// which is sent once.)
    NotConnected,
    /// The caller's: a motion is running.
    MotionRunning,
    /// The caller's: a FAST STOP is not confirmed yet.
    FastStopRunning,
    /// The caller's: a parameter is none that a gripper may take.
    Invalid(E),
    /// Capacity: too many requests wait.
    QueueFull,
}

/// What the session has seen that it could not use; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct SessionCounters {
    /// Answers that were not asked for, or came too late.
    pub unsolicited: u16,
    /// Messages whose content the manual forbids.
    pub refused: u16,
    /// Requests that were sent again.
    pub repeated: u16,
    /// Connections lost.
    pub disconnects: u16,
}

/// Adds nothing: sessions that differ in their counts alone behave alike.
impl Hash for SessionCounters {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}
