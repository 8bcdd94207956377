//! Error codes.

use std::ffi::{CStr, c_char};
use std::io;

use wsg_protocol::driver::{Error, StopKind};
use wsg_protocol::{DecodeError, Status};

/// Return values of all functions: 0 on success. A positive value is the status with which the gripper rejected or ended the
/// command (WSG_E_...), for wsg_status_text(). For negative values there is wsg_host_error_text().
///
/// A later version may return further negative values. Treat every value but 0 as an error.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum wsg_host_error {
    /// No error.
    None = 0,
    /// A pointer is null.
    NullPointer = -1,
    /// An argument is outside its range, or a text is not UTF-8.
    Argument = -6,
    /// Data does not fit the message or the buffer.
    TooLong = -7,
    /// There is no connection to the gripper.
    NotConnected = -10,
    /// A motion is running.
    MotionRunning = -11,
    /// A FAST STOP is not confirmed yet.
    FastStopRunning = -12,
    /// A width, speed, acceleration or force is outside the limits of the gripper, which wsg_host_limits() returns. Nothing was
    /// changed.
    OutOfLimits = -15,
    /// The line cannot be opened, or failed.
    Line = -20,
    /// The gripper closed the connection.
    Closed = -21,
    /// The request was sent without a reply, so its outcome is unknown.
    Unanswered = -22,
    /// A handle has stopped the fingers during this call or since the last one.
    Stopped = -23,
    /// A handle has stopped the fingers by FAST STOP.
    FastStopped = -24,
    /// The gripper confirmed a setting but did not apply it.
    Mismatch = -25,
    /// The system has no thread or descriptor left.
    System = -26,
    /// Too many set-points are queued.
    QueueFull = -27,
    /// The stream has ended.
    Ended = -28,
    /// Any other error.
    Other = -100,
}

impl wsg_host_error {
    const ALL: [Self; 18] = [
        Self::None,
        Self::NullPointer,
        Self::Argument,
        Self::TooLong,
        Self::NotConnected,
        Self::MotionRunning,
        Self::FastStopRunning,
        Self::OutOfLimits,
        Self::Line,
        Self::Closed,
        Self::Unanswered,
        Self::Stopped,
        Self::FastStopped,
        Self::Mismatch,
        Self::System,
        Self::QueueFull,
        Self::Ended,
        Self::Other,
    ];

    const fn text(self) -> &'static CStr {
        match self {
            Self::None => c"no error",
            Self::NullPointer => c"null pointer",
            Self::Argument => c"argument outside its range",
            Self::TooLong => c"too long",
            Self::NotConnected => c"not connected to a gripper",
            Self::MotionRunning => c"a motion is running",
            Self::FastStopRunning => c"a FAST STOP is not confirmed yet",
            Self::OutOfLimits => c"outside the limits of the gripper",
            Self::Line => c"the line cannot be opened, or failed",
            Self::Closed => c"the gripper closed the connection",
            Self::Unanswered => c"no reply; the outcome is unknown",
            Self::Stopped => c"stopped by a handle",
            Self::FastStopped => c"stopped by a handle, with FAST STOP",
            Self::Mismatch => c"the gripper did not apply the setting",
            Self::System => c"no thread or descriptor left",
            Self::QueueFull => c"too many set-points are queued",
            Self::Ended => c"the stream has ended",
            Self::Other => c"unknown error",
        }
    }
}

/// A result before it is returned to C: the code of an error or status.
pub(crate) type Outcome = Result<(), i32>;

/// Returns the code of a result.
pub(crate) const fn code(outcome: Outcome) -> i32 {
    match outcome {
        Ok(()) => 0,
        Err(code) => code,
    }
}

impl From<wsg_host_error> for i32 {
    fn from(error: wsg_host_error) -> Self {
        error as Self
    }
}

/// Returns the code of a driver's error.
pub(crate) fn of(error: Error<io::Error>) -> i32 {
    let error = match error {
        Error::Refused(status) | Error::NotSetBack(status) | Error::Failed(status) => {
            return i32::from(status.code());
        }
        Error::Blocked => return i32::from(Status::AxisBlocked.code()),
        Error::Aborted => return i32::from(Status::CmdAborted.code()),
        Error::NotConnected => wsg_host_error::NotConnected,
        Error::MotionRunning => wsg_host_error::MotionRunning,
        Error::FastStopRunning => wsg_host_error::FastStopRunning,
        Error::Invalid(DecodeError::TooLong | DecodeError::TagTooLong) | Error::TooLong { .. } => {
            wsg_host_error::TooLong
        }
        Error::Invalid(_) => wsg_host_error::Argument,
        Error::OutOfLimits(_) => wsg_host_error::OutOfLimits,
        Error::Stopped(StopKind::Stop) => wsg_host_error::Stopped,
        Error::Stopped(StopKind::FastStop) => wsg_host_error::FastStopped,
        Error::Mismatch => wsg_host_error::Mismatch,
        Error::Unanswered => wsg_host_error::Unanswered,
        Error::Transport(_) => wsg_host_error::Line,
        Error::Closed => wsg_host_error::Closed,
        _ => wsg_host_error::Other,
    };
    error.into()
}

/// Returns the meaning of a return value: an error, or a status of the gripper.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_error_text(error: i32) -> *const c_char {
    if let Ok(status @ 1..) = u16::try_from(error) {
        return wsg::text::wsg_status_text(status);
    }
    let known = wsg_host_error::ALL.into_iter().find(|known| *known as i32 == error);
    known.unwrap_or(wsg_host_error::Other).text().as_ptr()
}
