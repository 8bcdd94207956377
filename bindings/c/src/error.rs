//! Error codes.

use wsg_protocol::DecodeError;
use wsg_protocol::session::RequestError;

/// Return values of all functions. Positive values are results: a length, a count, or 1 for "yes".
///
/// A later version may return further negative values. Treat every negative value as an error.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum wsg_error {
    /// No error.
    None = 0,
    /// A pointer is null.
    NullPointer = -1,
    /// The storage was not initialized by wsg_init().
    NotInitialized = -2,
    /// A value of the configuration is outside its range.
    Config = -3,
    /// The function must not be called from the event callback.
    InCallback = -4,
    /// The buffer is too short. Nothing was written.
    BufferTooSmall = -5,
    /// An argument is outside its range.
    Argument = -6,
    /// Data is too long for the message or the library.
    TooLong = -7,
    /// A floating-point argument is infinite or NaN.
    NotFinite = -8,
    /// A text contains a control character or a non-ASCII character.
    Character = -9,
    /// There is no connection. Only Stop and FAST STOP are accepted.
    NotConnected = -10,
    /// A motion is running.
    MotionRunning = -11,
    /// A FAST STOP is not confirmed yet.
    FastStopRunning = -12,
    /// Too many requests are queued, or one with caller-owned data is still open.
    QueueFull = -13,
    /// The payload of a frame violates the manual.
    Malformed = -14,
    /// A width, speed, acceleration or force is outside the limits of the connected gripper, which wsg_known() has. Nothing was
    /// sent.
    OutOfLimits = -15,
    /// Any other error.
    Other = -100,
}

impl wsg_error {
    /// All errors.
    /// cbindgen:ignore
    pub(crate) const ALL: [Self; 17] = [
        Self::None,
        Self::NullPointer,
        Self::NotInitialized,
        Self::Config,
        Self::InCallback,
        Self::BufferTooSmall,
        Self::Argument,
        Self::TooLong,
        Self::NotFinite,
        Self::Character,
        Self::NotConnected,
        Self::MotionRunning,
        Self::FastStopRunning,
        Self::QueueFull,
        Self::Malformed,
        Self::OutOfLimits,
        Self::Other,
    ];
}

/// The result of a function before it is returned to C.
pub(crate) type Outcome = Result<i32, wsg_error>;

/// No error and nothing to report.
pub(crate) const DONE: Outcome = Ok(0);

/// Returns the code of a result.
pub(crate) const fn code(outcome: Outcome) -> i32 {
    match outcome {
        Ok(value) => value,
        Err(error) => error as i32,
    }
}

/// Returns a length as a result. Every length of this library is far below the limit.
pub(crate) fn length(value: usize) -> Outcome {
    i32::try_from(value).map_err(|_| wsg_error::TooLong)
}

impl From<RequestError> for wsg_error {
    fn from(error: RequestError) -> Self {
        match error {
            RequestError::NotConnected => Self::NotConnected,
            RequestError::MotionRunning => Self::MotionRunning,
            RequestError::FastStopRunning => Self::FastStopRunning,
            RequestError::QueueFull => Self::QueueFull,
            RequestError::Invalid(invalid) => Self::of_argument(invalid),
            _ => Self::Other,
        }
    }
}

impl wsg_error {
    /// Returns the error for an argument that the protocol rejects.
    pub(crate) const fn of_argument(invalid: DecodeError) -> Self {
        match invalid {
            DecodeError::NotFinite => Self::NotFinite,
            DecodeError::TooLong | DecodeError::TagTooLong => Self::TooLong,
            DecodeError::Character => Self::Character,
            _ => Self::Argument,
        }
    }
}
