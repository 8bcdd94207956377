//! Drivers that present a gripper as an object: blocking over `embedded-io`, and async over `embedded-io-async`.
//!
//! | module | over | feature |
//! |---|---|---|
//! | `blocking` | a `Transport` (`embedded_io::{Read, ReadReady, Write}` and a way to wait) and a [`Clock`] | `embedded-io` |
//! | `asynch` | `embedded_io_async::{Read, Write}` and a [`Timer`] | `embedded-io-async` |
//! | `host` | `blocking` on a PC: TCP, UDP, serial ports and a clock | `std` |
//! | `stream` | set-points at a fixed rate from a worker thread, with state feedback, over `blocking` | `std` |
//! | `tokio` | `asynch` on tokio: TCP, UDP, serial ports and a timer | `tokio` |
//!
//! Both drivers have the same methods, and both are thin. A [`Session`](crate::session::Session) decides what to send
//! and interprets the replies, and a [`FrameParser`](crate::FrameParser) finds the frames.
//!
//! Both support both protocols: `Gripper` uses the [binary](Binary) protocol and `GclGripper` the text protocol, GCL
//! (feature `gcl`). Methods, results and errors are identical, so a program selects the protocol by the type it
//! imports:
//!
//! ```
//! # #[cfg(all(feature = "embedded-io", feature = "gcl"))]
//! use wsg_protocol::driver::blocking::GclGripper as Gripper; // or: use wsg_protocol::driver::blocking::Gripper;
//! ```
//!
//! A request that GCL does not support returns [`Error::NotInGcl`] before anything is sent; `Gcl` lists them. The
//! drivers add:
//!
//! - **Typed results.** [`Grip`] distinguishes a held part from no part, and [`Error`] identifies the cause.
//! - **Two-step motions.** `begin_grip` returns a [`Pending`] after E_CMD_PENDING. Other requests are possible
//!   meanwhile, and `wait` or `poll` returns the result.
//! - **One write per frame**, so over TCP each frame is one segment, as clients and grippers in the field expect.
//! - **No late requests.** Unsent requests of a dropped future or a failed call are withdrawn. Requests already sent
//!   are awaited before the next one, so replies are never mixed up. Only Stop and FAST STOP are sent in any case.
//! - **No idle waits.** Due messages are sent before any wait, and a wait ends with the first received byte. A query
//!   over loopback TCP takes about 1.2 times as long as over a bare socket with the same bytes.
//! - **Stop from any thread** (feature `std`): a `StopHandle` writes Stop or FAST STOP directly to the socket, during a
//!   call or between calls. The program is notified by [`Error::Stopped`].
//! - **Orderly disconnect.** Dropping a gripper announces the end of its TCP connection, so that it does not enter FAST
//!   STOP. `with_connection` runs a closure that may return early with `?`, and also waits for the confirmation.
//!
//! - **Records** (feature `log`): the crate `log` gets rare events under the target `wsg_protocol`, and nothing per request or
//!   sample. Level info: connected, disconnect announced, stream ended by the program. Level warn: connection lost, FAST STOP
//!   requested, an answer of a stream more than 100 ms late, stream ended otherwise. `set_log_name` names the gripper. No
//!   record delays a stop: it is made after sending, and a stop handle waits for no logger of the driver's thread.
//!
//! There is no background task: the driver receives only while one of its methods is called. An idle program must call
//! `next_update` several times a second, so that the transport's buffer does not overflow.

#[cfg(feature = "embedded-io-async")]
pub mod asynch;
mod binary;
#[cfg(feature = "embedded-io")]
pub mod blocking;
mod engine;
mod error;
#[cfg(feature = "std")]
mod farewell;
mod gate;
#[cfg(feature = "gcl")]
mod gcl;
#[cfg(feature = "std")]
pub mod host;
mod journal;
mod link;
// GCL follows the binary protocol, so that the documentation begins with the latter.
#[macro_use]
mod methods;
#[cfg(feature = "gcl")]
mod methods_of_gcl;
mod motion;
#[cfg(feature = "std")]
mod readiness;
#[cfg(feature = "std")]
mod received;
#[cfg(feature = "std")]
mod second;
#[cfg(feature = "std")]
mod stop;
#[cfg(feature = "std")]
pub mod stream;
#[cfg(feature = "tokio")]
pub mod tokio;
#[cfg(feature = "std")]
mod udp;
mod units;

pub use binary::Binary;
pub use error::{Cause, Error};
#[cfg(feature = "gcl")]
pub use gcl::{GCL_LINE_LEN, Gcl};
pub use link::Protocol;
pub use motion::{MotionResult, Pending};
#[cfg(feature = "std")]
pub use stop::{StopHandle, StopLine, Stoppable};
pub use units::{Mm, MmPerS, N};

use crate::command::Command;
use crate::reply::Value;
use crate::time::Instant;
use crate::types::{GripperState, LoopData, PrePositionFlags, SystemFlags};
use crate::{frame, session};

/// The caller's clock.
///
/// Implemented by closures:
///
/// ```
/// use wsg_protocol::Instant;
/// use wsg_protocol::driver::Clock;
///
/// let start = std::time::Instant::now();
/// let mut clock = move || Instant::from_millis(start.elapsed().as_millis() as u32);
/// assert!(clock.now().as_millis() < 1_000);
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a driver clock",
    label = "this needs `wsg_protocol::driver::Clock`",
    note = "a closure that returns a `wsg_protocol::Instant` implements it"
)]
pub trait Clock {
    /// Returns the current time.
    fn now(&mut self) -> Instant;
}

#[diagnostic::do_not_recommend]
impl<F: FnMut() -> Instant> Clock for F {
    fn now(&mut self) -> Instant {
        self()
    }
}

/// A clock that can wake a task.
///
/// ```
/// use wsg_protocol::Instant;
/// use wsg_protocol::driver::{Clock, Timer};
///
/// struct EmbassyTimer;
///
/// impl Clock for EmbassyTimer {
///     fn now(&mut self) -> Instant {
///         Instant::from_millis(embassy_time::Instant::now().as_millis() as u32)
///     }
/// }
///
/// impl Timer for EmbassyTimer {
///     async fn wait_until(&mut self, moment: Instant) {
///         embassy_time::Timer::after_millis(moment.since(self.now()).into()).await;
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a timer for the async driver",
    label = "this needs `wsg_protocol::driver::Timer`",
    note = "see the documentation of `Timer` for embassy; a closure is a clock but cannot wake a task"
)]
pub trait Timer: Clock {
    /// Completes at this instant or soon after it. The future is dropped if something else happens first.
    fn wait_until(&mut self, moment: Instant) -> impl Future<Output = ()>;
}

/// Settings of a driver: time-outs, checks and subscriptions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct Config {
    /// Time-outs, subscriptions and read-back.
    pub session: session::Config,
    /// Time-out between the bytes of an incomplete frame, which is then discarded, in milliseconds.
    pub half_frame_ms: u32,
    /// Time-out of `connect`, in milliseconds.
    pub connect_timeout_ms: u32,
}

impl Config {
    /// The session's defaults with read-back of settings. An incomplete frame is discarded after 20 ms, which is the
    /// time of about 230 bytes at 115 200 bit/s. `connect` times out after 3 s.
    pub const DEFAULT: Self = Self {
        session: session::Config { verify_settings: true, ..session::Config::DEFAULT },
        half_frame_ms: 20,
        connect_timeout_ms: 3_000,
    };

    /// Returns the time-out for the confirmation of a FAST STOP, in milliseconds.
    fn confirmation_ms(&self) -> u32 {
        self.session.reply_timeout_ms.saturating_mul(u32::from(self.session.attempts).saturating_add(1))
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The result of a grip (command set, 3.2.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum Grip {
    /// A part is held with the gripping force.
    Held,
    /// The fingers closed without finding a part or without building up the force (E_CMD_FAILED).
    NoPart,
}

/// The reaction of Pre-position Fingers to an obstacle (command set, 3.2.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub enum OnBlock {
    /// The motor is turned off at the obstacle.
    #[default]
    Stop,
    /// The fingers clamp with half of the nominal force, and continue when the obstacle is gone.
    Clamp,
}

impl OnBlock {
    const fn flags(self) -> PrePositionFlags {
        match self {
            Self::Stop => PrePositionFlags::STOP_ON_BLOCK,
            Self::Clamp => PrePositionFlags::empty(),
        }
    }
}

/// The kind of stop. FAST STOP is ordered above Stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, crate::Format)]
pub enum StopKind {
    /// Stop: the next motion is possible immediately (command set, 3.2.3).
    Stop,
    /// FAST STOP: the fingers are locked until acknowledged (command set, 3.2.4).
    FastStop,
}

impl StopKind {
    const fn command(self) -> Command<'static> {
        match self {
            Self::Stop => Command::Stop,
            Self::FastStop => Command::FastStop,
        }
    }
}

/// A stop requested by a stop handle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct StopRequest {
    kind: StopKind,
    /// Whether the handle has already sent it.
    is_sent: bool,
}

/// Length of the longest stop message, `FASTSTOP()` and a line feed, in bytes.
#[cfg(feature = "std")]
const MAX_STOP_LEN: usize = 11;

impl core::fmt::Display for StopKind {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Stop => "Stop",
            Self::FastStop => "FAST STOP",
        })
    }
}

/// One of the two finger ports (command set, 3.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum Finger {
    /// The finger at port 1.
    One,
    /// The finger at port 2.
    Two,
}

/// A value from an automatic update or from periodic polling.
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
#[non_exhaustive]
pub enum Update {
    /// The system state flags.
    SystemState(SystemFlags),
    /// The gripper state changed (41h).
    GripperState(GripperState),
    /// The opening width in mm.
    Width(f32),
    /// The finger speed in mm/s.
    Speed(f32),
    /// The gripping force in N, summed over both fingers.
    Force(f32),
}

impl Update {
    fn of(value: &Value<'_>) -> Option<Self> {
        Some(match *value {
            Value::GetSystemState(flags) => Self::SystemState(flags),
            Value::GetGripperState(state) => Self::GripperState(state),
            Value::GetOpeningWidth(width) => Self::Width(width),
            Value::GetSpeed(speed) => Self::Speed(speed),
            Value::GetForce(force) => Self::Force(force),
            _ => return None,
        })
    }
}

/// Counters of input that a driver could not use. Each counter saturates at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct DriverCounters {
    /// Errors on the line, below the frame level.
    pub line: frame::FrameCounters,
    /// Errors in frames and requests.
    pub session: session::SessionCounters,
    /// Updates replaced by newer ones because `next_update` was not called often enough, or discarded with a lost connection.
    pub updates_lost: u16,
}

/// Default limit for the payload of a reply, in bytes: Loop with the maximum amount of data. Finger data may be longer.
pub const MAX_REPLY_LEN: usize = LoopData::MAX_LEN + 2;

/// Default limit for a sent frame, in bytes: Loop with the maximum amount of data.
pub const MAX_FRAME_LEN: usize = LoopData::MAX_LEN + frame::OVERHEAD;

/// Number of updates queued for `next_update`. If the queue is full, the oldest update is discarded so that a slow
/// program sees current values. [`DriverCounters::updates_lost`] counts discarded updates.
pub const UPDATES_LEN: usize = 8;

#[cfg(all(test, feature = "embedded-io", feature = "embedded-io-async"))]
mod tests;
