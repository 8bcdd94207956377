//! Driver errors, grouped by cause.

use super::StopKind;
use crate::field::DecodeError;
use crate::limits::OutOfLimits;
use crate::session::RequestError;
use crate::types::Status;

/// The reason why a request to a gripper failed. `E` is the error type of the transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum Error<E> {
    /// Caller error: there is no connection (any more), and nothing was sent. Call `connect` to wait for one.
    NotConnected,
    /// Caller error: a motion is running or a finger supply is being switched on. Nothing was sent.
    MotionRunning,
    /// Caller error: a FAST STOP is not confirmed yet. Nothing was sent.
    FastStopRunning,
    /// Caller error: a parameter has a value that no gripper accepts. Nothing was sent.
    Invalid(DecodeError),
    /// Caller error: a parameter is outside the physical limits of this gripper (command set, 3.5.4), which the gripper
    /// would correct without an error or refuse. Nothing was changed.
    OutOfLimits(OutOfLimits),
    /// Caller error: a later motion was begun, so the result of this one is no longer available.
    Superseded,
    /// Caller error: the text protocol does not support the request (see `Gcl`). Nothing was sent.
    NotInGcl,
    /// Caller error: GCL sends the force limit with each grip, and `set_force_limit` was not called. Nothing was sent.
    NoForceLimit,
    /// Caller error: a `StopHandle` stopped the gripper during this call or since the last one. The request was
    /// withdrawn, or its motion ended. `fast_stop_pending` returns whether a FAST STOP is still unconfirmed.
    Stopped(StopKind),
    /// Capacity error: a frame of `needed` bytes does not fit the driver and was not sent; or a reply of `needed` bytes
    /// does not fit the caller's buffer, and the command was executed.
    TooLong {
        /// Buffer size required, in bytes.
        needed: usize,
    },
    /// Gripper error: it rejected the command. E_NOT_INITIALIZED: the fingers are not referenced. E_CMD_UNKNOWN: the id
    /// is not supported.
    ///
    /// E_ACCESS_DENIED usually means FAST STOP, until `acknowledge`. A TCP connection that ends without Disconnect
    /// Announcement leaves the gripper in FAST STOP for the next program; `with_connection` always sends the
    /// announcement. The gripper also denies `tare` while it holds a part, and everything after a Disconnect
    /// Announcement.
    Refused(Status),
    /// Gripper error: it rejected a motion with this status, and the force limit that was set for the motion could not be
    /// set back. Read it with `force_limit`.
    NotSetBack(Status),
    /// Gripper error: an obstacle blocked the fingers (E_AXIS_BLOCKED).
    Blocked,
    /// Gripper error: Stop, FAST STOP or another client ended the motion (E_CMD_ABORTED).
    Aborted,
    /// Gripper error: the motion began and ended with this status, for example E_TIMEOUT.
    Failed(Status),
    /// Gripper error: the returned value differs from the value sent (a setting that was read back, or loop data).
    Mismatch,
    /// Gripper or line error: the request was sent without a reply, so its outcome is unknown.
    Unanswered,
    /// Transport error: a read or write failed. Earlier requests may have been executed.
    Transport(E),
    /// Transport error: the peer closed the connection.
    Closed,
}

/// The party that can resolve an [`Error`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum Cause {
    /// The caller, whose request is invalid now or in general.
    Caller,
    /// The buffers, which are too small.
    Capacity,
    /// The gripper, or an obstacle between its fingers.
    Peer,
    /// The transport or the line.
    Transport,
}

impl<E> Error<E> {
    /// Returns which party can resolve the error.
    ///
    /// ```
    /// use wsg_protocol::driver::{Cause, Error};
    ///
    /// assert_eq!(Error::<()>::Blocked.cause(), Cause::Peer);
    /// ```
    #[must_use]
    pub const fn cause(&self) -> Cause {
        match self {
            Self::NotConnected
            | Self::MotionRunning
            | Self::FastStopRunning
            | Self::Invalid(_)
            | Self::OutOfLimits(_)
            | Self::Superseded
            | Self::NotInGcl
            | Self::NoForceLimit
            | Self::Stopped(_) => Cause::Caller,
            Self::TooLong { .. } => Cause::Capacity,
            Self::Refused(_)
            | Self::NotSetBack(_)
            | Self::Blocked
            | Self::Aborted
            | Self::Failed(_)
            | Self::Mismatch
            | Self::Unanswered => Cause::Peer,
            Self::Transport(_) | Self::Closed => Cause::Transport,
        }
    }
}

impl<E> From<RequestError> for Error<E> {
    fn from(error: RequestError) -> Self {
        match error {
            RequestError::NotConnected => Self::NotConnected,
            RequestError::FastStopRunning => Self::FastStopRunning,
            RequestError::Invalid(refusal) => Self::Invalid(refusal),
            // A driver makes one request at a time, so its queue is never full.
            RequestError::MotionRunning | RequestError::QueueFull => Self::MotionRunning,
        }
    }
}

impl<E> From<DecodeError> for Error<E> {
    fn from(refusal: DecodeError) -> Self {
        Self::Invalid(refusal)
    }
}

impl<E> From<OutOfLimits> for Error<E> {
    fn from(refusal: OutOfLimits) -> Self {
        Self::OutOfLimits(refusal)
    }
}

impl<E: core::fmt::Display> core::fmt::Display for Error<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotConnected => f.write_str("no connection to the gripper"),
            Self::MotionRunning => f.write_str("a motion is running"),
            Self::FastStopRunning => f.write_str("a FAST STOP is not confirmed yet"),
            Self::Invalid(refusal) => write!(f, "invalid parameter: {refusal}"),
            Self::OutOfLimits(refusal) => refusal.fmt(f),
            Self::Superseded => f.write_str("a later motion was begun, so this result is no longer available"),
            Self::NotInGcl => f.write_str("the text protocol (GCL) has no such request"),
            Self::NoForceLimit => f.write_str("no force limit is set; a grip over GCL needs one: call `set_force_limit` first"),
            Self::Stopped(kind) => write!(f, "a stop handle stopped the gripper: {kind}"),
            Self::TooLong { needed } => write!(f, "a buffer is too small: {needed} bytes are needed"),
            Self::Refused(Status::AccessDenied) => f.write_str(
                "refused: E_ACCESS_DENIED; the gripper is probably in FAST STOP, as after a TCP connection that ended \
                 without Disconnect Announcement: make sure that the fingers may move, then call `acknowledge`",
            ),
            Self::Refused(status) => write!(f, "refused: {status}"),
            Self::NotSetBack(status) => {
                write!(f, "refused: {status}; the force limit that was set before could not be set back")
            }
            Self::Blocked => f.write_str("the fingers are blocked"),
            Self::Aborted => f.write_str("the motion was aborted"),
            Self::Failed(status) => write!(f, "the motion failed: {status}"),
            Self::Mismatch => f.write_str("the value read back differs from the value sent"),
            Self::Unanswered => f.write_str("no answer; the outcome of the request is unknown"),
            Self::Transport(error) => write!(f, "transport: {error}"),
            Self::Closed => f.write_str("the transport is closed"),
        }
    }
}

/// The source of [`Transport`](Error::Transport) is the transport's error, which is also part of the text.
impl<E: core::error::Error + 'static> core::error::Error for Error<E> {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Transport(error) => Some(error),
            _ => None,
        }
    }
}
