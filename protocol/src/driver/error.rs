//! Why a request came to nothing, by culprit.

use super::StopKind;
use crate::field::DecodeError;
use crate::session::RequestError;
use crate::types::Status;

/// Why a request to a gripper came to nothing. `E` is the transport's own error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum Error<E> {
    /// The caller's: there is no connection (any more), and nothing was sent. `connect` finds out when there is one.
    NotConnected,
    /// The caller's: a motion is running (or a supply is being switched on); nothing was sent.
    MotionRunning,
    /// The caller's: a FAST STOP is not confirmed yet; nothing was sent.
    FastStopRunning,
    /// The caller's: a parameter is none that a gripper may take; nothing was sent.
    Invalid(DecodeError),
    /// The caller's: another motion was begun after this one, so its result is not kept any more.
    Superseded,
    /// The caller's: the text protocol cannot say this; nothing was sent (`Gcl` lists what it cannot say).
    NotInGcl,
    /// The caller's: GCL states the force with each grip, and `set_force_limit` was not called yet; nothing was sent.
    NoForceLimit,
    /// The caller's: a `StopHandle` stopped the gripper during this call, or since the last one. What the call was to do was
    /// withdrawn or ended. `fast_stop_pending` returns whether the gripper has yet to confirm a FAST STOP.
    Stopped(StopKind),
    /// Capacity: a frame of `needed` bytes does not fit the driver, and nothing was sent; or an answer of `needed` bytes
    /// does not fit the caller's buffer, and the command was carried out.
    TooLong {
        /// The bytes that there should be room for.
        needed: usize,
    },
    /// The gripper's: it refused the command. E_NOT_INITIALIZED: not referenced; E_CMD_UNKNOWN: an id that nothing
    /// serves.
    ///
    /// E_ACCESS_DENIED: mostly in FAST STOP, until `acknowledge`. A TCP connection that ended without Disconnect
    /// Announcement leaves the gripper there, so the next program meets it: `with_connection` announces in any case.
    /// `tare` is denied while a part is held, and everything after a Disconnect Announcement.
    Refused(Status),
    /// The gripper's: something was in the way of the fingers (E_AXIS_BLOCKED).
    Blocked,
    /// The gripper's: the motion was ended, by Stop, FAST STOP or another client (E_CMD_ABORTED).
    Aborted,
    /// The gripper's: the motion began and ended with this status, E_TIMEOUT for example.
    Failed(Status),
    /// The gripper's: what came back is not what was sent: a setting that was read back, or loop data.
    Mismatch,
    /// The gripper's, or the line's: it was sent and no answer came, so what became of it is not known.
    Unanswered,
    /// The transport's: it failed. What was sent before may have been carried out.
    Transport(E),
    /// The transport's: the other end has closed it.
    Closed,
}

/// Who can do something about an [`Error`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum Culprit {
    /// The caller, who asked for something that cannot be, now or at all.
    Caller,
    /// The buffers are too small.
    Capacity,
    /// The gripper, or what it has between its fingers.
    Peer,
    /// The line.
    Transport,
}

impl<E> Error<E> {
    /// Who can do something about it.
    ///
    /// ```
    /// use wsg_protocol::driver::{Culprit, Error};
    ///
    /// assert_eq!(Error::<()>::Blocked.culprit(), Culprit::Peer);
    /// ```
    #[must_use]
    pub const fn culprit(&self) -> Culprit {
        match self {
            Self::NotConnected
            | Self::MotionRunning
            | Self::FastStopRunning
            | Self::Invalid(_)
            | Self::Superseded
            | Self::NotInGcl
            | Self::NoForceLimit
            | Self::Stopped(_) => Culprit::Caller,
            Self::TooLong { .. } => Culprit::Capacity,
            Self::Refused(_)
            | Self::Blocked
            | Self::Aborted
            | Self::Failed(_)
            | Self::Mismatch
            | Self::Unanswered => Culprit::Peer,
            Self::Transport(_) | Self::Closed => Culprit::Transport,
        }
    }
}

impl<E> From<RequestError> for Error<E> {
    fn from(error: RequestError) -> Self {
        match error {
            RequestError::NotConnected => Self::NotConnected,
            RequestError::FastStopRunning => Self::FastStopRunning,
            RequestError::Invalid(refusal) => Self::Invalid(refusal),
            // A driver asks for one thing at a time, so its queue is never full.
            RequestError::MotionRunning | RequestError::QueueFull => Self::MotionRunning,
        }
    }
}

impl<E> From<DecodeError> for Error<E> {
    fn from(refusal: DecodeError) -> Self {
        Self::Invalid(refusal)
    }
}

impl<E: core::fmt::Display> core::fmt::Display for Error<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotConnected => f.write_str("no connection to the gripper"),
            Self::MotionRunning => f.write_str("a motion is running"),
            Self::FastStopRunning => f.write_str("a FAST STOP is not confirmed yet"),
            Self::Invalid(refusal) => write!(f, "invalid parameter: {refusal}"),
            Self::Superseded => f.write_str("another motion was begun since"),
            Self::NotInGcl => f.write_str("the text protocol (GCL) cannot say this"),
            Self::NoForceLimit => f.write_str("no force limit is set, and a grip over GCL states one"),
            Self::Stopped(kind) => write!(f, "a stop handle stopped the gripper: {kind}"),
            Self::TooLong { needed } => write!(f, "no room for {needed} bytes"),
            Self::Refused(Status::AccessDenied) => f.write_str(
                "refused: E_ACCESS_DENIED; the gripper is probably in FAST STOP, as after a TCP connection that ended \
                 without Disconnect Announcement: make sure that the fingers may move, then call `acknowledge`",
            ),
            Self::Refused(status) => write!(f, "refused: {status}"),
            Self::Blocked => f.write_str("the fingers are blocked"),
            Self::Aborted => f.write_str("the motion was aborted"),
            Self::Failed(status) => write!(f, "the motion failed: {status}"),
            Self::Mismatch => f.write_str("what was read back is not what was sent"),
            Self::Unanswered => f.write_str("no answer; what became of the request is not known"),
            Self::Transport(error) => write!(f, "transport: {error}"),
            Self::Closed => f.write_str("the transport is closed"),
        }
    }
}

/// The source of [`Transport`](Error::Transport) is the transport's own error, which the text has as well.
impl<E: core::error::Error + 'static> core::error::Error for Error<E> {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Transport(error) => Some(error),
            _ => None,
        }
    }
}
