//! A gripper as an object with methods: blocking over `embedded-io`, async over `embedded-io-async`.
//!
//! | module | over | feature |
//! |---|---|---|
//! | `blocking` | a `Transport` (`embedded_io::{Read, ReadReady, Write}` and a way to wait) and a [`Clock`] | `embedded-io` |
//! | `asynch` | `embedded_io_async::{Read, Write}` and a [`Timer`] | `embedded-io-async` |
//! | `host` | `blocking` on a computer: TCP, UDP, serial ports, the clock | `std` |
//! | `stream` | set-points at a fixed rate from a worker thread, and a feed of the state, over `blocking` | `std` |
//! | `tokio` | `asynch` on tokio: the same | `tokio` |
//!
//! Both have the same methods, and both are thin: a [`Session`](crate::session::Session) decides what is sent and what an
//! answer means, a [`FrameParser`](crate::FrameParser) finds the frames.
//!
//! Both speak either protocol: `Gripper` the [binary](Binary) one, `GclGripper` the text protocol, GCL (feature
//! `gcl`). Methods,
//! results and errors are the same, so that a program changes the protocol where it says which gripper it means:
//!
//! ```
//! # #[cfg(all(feature = "embedded-io", feature = "gcl"))]
//! use wsg_protocol::driver::blocking::GclGripper as Gripper; // or: use wsg_protocol::driver::blocking::Gripper;
//! ```
//!
//! What GCL cannot say is [`Error::NotInGcl`], before anything is sent; `Gcl` lists it. What the drivers add:
//!
//! - **Typed results.** [`Grip`] tells a part from none; [`Error`] tells whose fault it is.
//! - **Two steps for a motion, if wanted.** `begin_grip` comes back with E_CMD_PENDING and a [`Pending`]; meanwhile
//!   anything may be asked, and `wait` or `poll` has the result.
//! - **One write for a frame**, so that over TCP a frame is one segment, as clients and grippers in the field expect.
//! - **Nothing leaves late.** What a dropped future (or a call that failed half way) had asked for and was not sent is
//!   taken back; what was sent is awaited before the next request, so that no answer is taken for another's. Only Stop
//!   and FAST STOP leave in any case.
//! - **No idle waits.** What is due is sent before anything is waited for, and the wait ends with the first byte. A query over
//!   loopback TCP takes about 1.2 times as long as a bare socket with the same bytes.
//! - **Stop from any thread**, by feature `std`: a `StopHandle` writes Stop or FAST STOP to the socket itself, while a call
//!   waits or between calls, and the program learns of it by [`Error::Stopped`].
//! - **A proper end.** A gripper that is dropped announces the end of its TCP connection, so that it does not enter FAST STOP.
//!   `with_connection` runs a program that may leave by `?`, and also waits for the confirmation.
//!
//! Nothing runs by itself: the driver receives only while one of its methods is called. A program without a request calls
//! `next_update` several times a second, so that the buffer of the transport does not overflow.

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
mod link;
// GCL after the binary protocol, so that the documentation begins with the latter.
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
pub use error::{Culprit, Error};
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
/// A closure is one:
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
    message = "`{Self}` is no clock of a driver",
    label = "this needs `wsg_protocol::driver::Clock`",
    note = "a closure that returns a `wsg_protocol::Instant` is one"
)]
pub trait Clock {
    /// This moment.
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
    message = "`{Self}` is no timer of the async driver",
    label = "this needs `wsg_protocol::driver::Timer`",
    note = "the documentation of `Timer` has one for embassy; a closure is a clock, but cannot wake a task"
)]
pub trait Timer: Clock {
    /// Is ready at this moment, or soon after it. It is dropped when something else happens first.
    fn wait_until(&mut self, moment: Instant) -> impl Future<Output = ()>;
}

/// What can be set about a driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct Config {
    /// Time-outs, subscriptions and read-back.
    pub session: session::Config,
    /// After how long without a byte half a frame is given up, in milliseconds.
    pub half_frame_ms: u32,
    /// How long `connect` tries, in milliseconds.
    pub connect_timeout_ms: u32,
}

impl Config {
    /// The session's defaults, with settings read back; half a frame is waited for for 20 ms, which is some 230 bytes at
    /// 115 200 bit/s; a gripper is looked for for 3 s.
    pub const DEFAULT: Self = Self {
        session: session::Config { verify_settings: true, ..session::Config::DEFAULT },
        half_frame_ms: 20,
        connect_timeout_ms: 3_000,
    };

    /// How long the confirmation of a FAST STOP is waited for.
    fn confirmation_ms(&self) -> u32 {
        self.session.reply_timeout_ms.saturating_mul(u32::from(self.session.attempts).saturating_add(1))
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What a grip came to (command set, 3.2.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum Grip {
    /// A part is held with the gripping force.
    Held,
    /// The fingers closed and found no part, or did not build up the force (E_CMD_FAILED).
    NoPart,
}

/// What Pre-position Fingers does when something is in the way (command set, 3.2.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub enum OnBlock {
    /// The motor is turned off.
    #[default]
    Stop,
    /// The fingers clamp with half of the nominal force, and move on when the way is free.
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

/// How the fingers are stopped; FAST STOP is the greater one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, crate::Format)]
pub enum StopKind {
    /// Stop: the next motion is possible at once (command set, 3.2.3).
    Stop,
    /// FAST STOP: the fingers are locked until it is acknowledged (command set, 3.2.4).
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

/// What a stop handle has requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct StopRequest {
    kind: StopKind,
    /// The handle has sent it, too.
    is_sent: bool,
}

/// The longest message of a stop: `FASTSTOP()` and a line feed.
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
    /// Finger 1.
    One,
    /// Finger 2.
    Two,
}

/// A value that the gripper sent by itself, or that was asked for again in its turn.
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
#[non_exhaustive]
pub enum Update {
    /// The system state flags.
    SystemState(SystemFlags),
    /// The gripper state.
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

/// What a driver has met that it could not use; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct DriverCounters {
    /// On the line, below frames.
    pub line: frame::FrameCounters,
    /// In frames and requests.
    pub session: session::SessionCounters,
    /// Updates that were replaced by newer ones because `next_update` was not called often enough.
    pub updates_lost: u16,
}

/// The longest payload of a reply that a driver takes when nothing else is said: Loop with all its data. Finger data may
/// be longer.
pub const MAX_REPLY_LEN: usize = LoopData::MAX_LEN + 2;

/// The longest frame that a driver sends when nothing else is said: Loop with all its data.
pub const MAX_FRAME_LEN: usize = LoopData::MAX_LEN + frame::OVERHEAD;

/// How many updates are kept until `next_update` returns them. The oldest gives way, so that a program which falls behind
/// sees the present; [`DriverCounters::updates_lost`] counts it.
pub const UPDATES_LEN: usize = 8;

#[cfg(all(test, feature = "embedded-io", feature = "embedded-io-async"))]
mod tests;
