//! Events and errors reported by a session.

use core::hash::{Hash, Hasher};

use crate::field::DecodeError;

/// An event in the types of a dialect: names, replies and values.
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
#[non_exhaustive]
pub enum EventOf<N, A, V> {
    /// The gripper replies, and all subscribed values are known.
    Connected,
    /// The gripper does not reply. Its state is unknown from now on.
    Disconnected,
    /// A requested motion has begun (E_CMD_PENDING).
    Pending(N),
    /// The final reply to a request. [`MISMATCH`](super::MISMATCH) is created by the session itself.
    Answered(A),
    /// A request was sent, and its outcome is unknown.
    Unanswered(N),
    /// The reply to a Stop is late and the Stop is repeated: the fingers may still move.
    Late(N),
    /// A request was not sent and will not be sent.
    Withdrawn(N),
    /// The gripper reported a value.
    Reported(V),
}

/// The reason why a request was rejected. Nothing is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum RequestError<E = DecodeError> {
    /// Caller error: there is no connection. (Only FAST STOP and Stop are accepted then. FAST STOP is sent until
    /// confirmed, and Stop once.)
    NotConnected,
    /// Caller error: a motion is running.
    MotionRunning,
    /// Caller error: a FAST STOP is not confirmed yet.
    FastStopRunning,
    /// Caller error: a parameter has a value that no gripper accepts.
    Invalid(E),
    /// Capacity error: too many requests are queued.
    QueueFull,
}

/// Counters of unusable input, retries and disconnects. Each counter saturates at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct SessionCounters {
    /// Replies that were unsolicited or too late.
    pub unsolicited: u16,
    /// Messages whose content violates the manual.
    pub refused: u16,
    /// Requests sent again after a time-out.
    pub repeated: u16,
    /// Lost connections since the session was created; stops at its maximum.
    pub disconnects: u16,
}

/// Hashes nothing, so sessions that differ only in their counters are equal.
impl Hash for SessionCounters {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}
