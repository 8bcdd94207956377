//! Set-points for the fingers at a fixed rate, from a worker thread, with state feedback (feature `std`).
//!
//! A [`SetPointStream`] owns a connected gripper. Its worker sends the commanded position once per period and records
//! the reported state. The caller sets targets and reads the state without waiting for the line. See
//! `docs/streaming.md` in the repository for the script upload and the message layout.
//!
//! | back-end | condition | set-points | state |
//! |---|---|---|---|
//! | [`Backend::Script`] | `wsg_stream.lua` runs on the gripper | replaced during the motion, without a stop | with each set-point, with the gripper's time |
//! | [`Backend::UmiScript`] | UMI's `cmd_measure.lua` or a compatible script runs | as above; no watchdog | with each set-point |
//! | [`Backend::PrePosition`] | neither script replies | a Pre-position (21h) per 100 ms of travel; the fingers stop in between | by automatic updates, 40 per second |
//!
//! **Start.** Nothing moves before the first set-point.
//!
//! **Gap.** Without new set-points, the fingers move to the last one and hold it.
//!
//! **Contact.** With a script, the fingers push against a part with the force limit. With Pre-position, contact turns
//! the motor off (command set, 3.2.2) and the force ends. The fingers stay there until the set-point moves away from
//! the part. To hold a part without a script, end the stream and call [`grip`](super::blocking::GripperOver::grip).
//!
//! **End.** The worker ends after a FAST STOP, a Stop by another client, a script error, a lost connection or the end
//! of the `SetPointStream`. It sends Stop if the line permits it, and [`ended`](SetPointStream::ended) returns the
//! [`Cause`]. Nothing resumes automatically.
//!
//! ```
//! # use wsg_sim::{Config as Sim, server::{Lines, ServerThread}};
//! # let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
//! # let server = ServerThread::start(Sim::default(), &lines, None).unwrap();
//! # let address = server.tcp_address().unwrap();
//! use wsg_protocol::HomingDirection;
//! use wsg_protocol::driver::stream::{Cause, Config, SetPointStream};
//! use wsg_protocol::driver::{Mm, MmPerS, N, host};
//!
//! // Address of a real gripper: "192.168.1.20:1000".
//! let mut gripper = host::connect(address)?;
//! gripper.home(HomingDirection::Positive)?;
//!
//! let stream = SetPointStream::start(gripper, Config::default())?;
//! stream.set_speed_limit(MmPerS(200.0))?;
//! stream.set_force_limit(N(20.0))?;
//! let now = stream.now();
//! stream.schedule(Mm(100.0), now.plus(100))?;
//! stream.schedule(Mm(90.0), now.plus(200))?;
//! while stream.ended().is_none() && stream.latest().position > 90.5 {
//!     std::thread::sleep(std::time::Duration::from_millis(5));
//! }
//! let (_gripper, end) = stream.end();
//! assert_eq!(end.cause, Cause::Requested);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod line;
mod pace;
mod script;
mod trajectory;
mod worker;

pub use line::LineEstimate;
pub use trajectory::MAX_SET_POINTS;

use super::blocking::{Gripper, Transport};
use super::{Clock, Error, Mm, MmPerS, N, StopHandle, StopKind, Stoppable};
use crate::time::Instant;
use crate::types::{Status, SystemFlags, SystemLimits};
use line::Exchanges;
use script::{Measured, Order};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::vec::Vec;
use std::{io, panic};
use trajectory::Trajectory;
use worker::Worker;

/// The source of the project's script, `wsg_stream.lua`, for upload to a gripper.
pub const SCRIPT: &str = include_str!("../../scripts/wsg_stream.lua");

/// Number of samples in [`SetPointStream::history`]: 10 s at 100 Hz.
pub const HISTORY_LEN: usize = 1_024;

/// Settings of a stream, fixed at its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// Set-points per second, 1 to 500. Each request is sent after the previous reply, so a line with a longer round
    /// trip lowers the rate.
    pub rate_hz: u16,
}

impl Config {
    /// The default rate: 100 set-points per second.
    pub const DEFAULT: Self = Self { rate_hz: 100 };
}

impl Default for Config {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The method that moves the fingers to the set-points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// The project's script, `wsg_stream.lua`.
    Script,
    /// UMI's script, `cmd_measure.lua`. It has no watchdog and follows the last set-point until the next one or a Stop.
    UmiScript,
    /// Pre-position (21h) and automatic updates.
    PrePosition,
}

/// The state of the gripper at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Sample number, counted from 0 modulo 2³².
    pub number: u32,
    /// Time of the measurement on the driver's clock: from the gripper's own time with [`Backend::Script`], otherwise
    /// from the estimated latency.
    pub measured_at: Instant,
    /// Time at which the worker received the sample.
    pub received_at: Instant,
    /// The opening width in mm.
    pub position: f32,
    /// The finger speed in mm/s; closing is negative.
    pub speed: f32,
    /// The gripping force in N, summed over both fingers.
    pub force: f32,
    /// The system state flags.
    pub flags: SystemFlags,
    /// The last commanded position in mm. `None` before the first set-point.
    pub set_point: Option<f32>,
}

/// The reason why a stream ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Cause {
    /// The caller ended or dropped the stream.
    Requested,
    /// A [`StopHandle`] stopped the gripper.
    Stopped(StopKind),
    /// The gripper is in FAST STOP, caused by another client or a fault, or since before the stream began.
    FastStop,
    /// Another client stopped the fingers.
    StoppedByOther,
    /// The script ended, reported an error, or sent a reply of another layout.
    Script,
    /// The script received no set-point for 500 ms and stopped the fingers.
    Watchdog,
    /// The gripper rejected a set-point or a setting with this status: E_NOT_INITIALIZED before homing, E_RANGE_ERROR
    /// outside the soft limits, E_ALREADY_RUNNING while it holds a part.
    Refused(Status),
    /// There was no reply in time from the line or the script.
    Unanswered,
    /// The gripper closed the connection.
    Closed,
    /// The transport failed; the fingers may move until the gripper notices the loss.
    Transport(embedded_io::ErrorKind),
}

impl core::fmt::Display for Cause {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Requested => f.write_str("the caller ended the stream"),
            Self::Stopped(kind) => write!(f, "a stop handle stopped the gripper: {kind}"),
            Self::FastStop => {
                f.write_str("the gripper is in FAST STOP; acknowledge it before the next stream")
            }
            Self::StoppedByOther => f.write_str("another client stopped the fingers"),
            Self::Script => f.write_str("the script on the gripper failed; see the gripper's log"),
            Self::Watchdog => f.write_str("no set-point reached the script for 500 ms"),
            Self::Refused(status) => write!(f, "the gripper refused a set-point: {status}"),
            Self::Unanswered => f.write_str("no answer from the gripper"),
            Self::Closed => f.write_str("the gripper closed the connection"),
            Self::Transport(kind) => write!(f, "transport: {kind}"),
        }
    }
}

/// The end of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct End {
    /// The reason for the end.
    pub cause: Cause,
    /// Whether the gripper confirmed the final Stop. If not, the fingers are stopped by the script's watchdog, by the
    /// FAST STOP after a lost TCP connection, or at the end of the last Pre-position.
    pub is_stop_confirmed: bool,
}

/// The reason why a set-point or a limit was rejected. Nothing changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejected {
    /// The number is not finite, or a limit is not greater than 0.
    Invalid,
    /// [`MAX_SET_POINTS`] earlier set-points are queued.
    Full,
    /// The stream has ended.
    Ended(Cause),
}

impl core::fmt::Display for Rejected {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Invalid => {
                f.write_str("invalid value: positions must be finite, and limits finite and greater than 0")
            }
            Self::Full => write!(f, "the queue is full: {MAX_SET_POINTS} earlier set-points are waiting"),
            Self::Ended(cause) => write!(f, "the stream has ended: {cause}"),
        }
    }
}

impl core::error::Error for Rejected {}

/// The reason why a stream did not start. The gripper is dropped.
#[derive(Debug)]
pub enum StartError<E> {
    /// A request of the driver failed.
    Driver(Error<E>),
    /// The operating system has no thread or no descriptor left.
    System(io::Error),
}

impl<E: core::fmt::Display> core::fmt::Display for StartError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Driver(error) => error.fmt(f),
            Self::System(error) => error.fmt(f),
        }
    }
}

impl<E: core::fmt::Debug + core::fmt::Display> core::error::Error for StartError<E> {}

impl<E> From<Error<E>> for StartError<E> {
    fn from(error: Error<E>) -> Self {
        Self::Driver(error)
    }
}

impl<E> From<io::Error> for StartError<E> {
    fn from(error: io::Error) -> Self {
        Self::System(error)
    }
}

/// A gripper that follows set-points; see the [module](self).
///
/// Its methods lock a mutex that the worker holds for microseconds, never while it waits for the line. Dropping it
/// stops the fingers and waits for the worker to end.
#[derive(Debug)]
pub struct SetPointStream<IO, C> {
    shared: Arc<Mutex<Shared>>,
    clock: C,
    backend: Backend,
    handle: StopHandle,
    /// `None` only during drop.
    worker: Option<JoinHandle<Gripper<IO, C>>>,
}

impl<IO, C> SetPointStream<IO, C>
where
    IO: Transport + Stoppable + Send + 'static,
    C: Clock + Clone + Send + 'static,
{
    /// Detects the back-end, measures once, and starts the worker. Waits for about ten replies.
    ///
    /// The gripper must be connected, and no motion of this driver may be running. [`Backend::PrePosition`] replaces
    /// the subscriptions to width, speed and force, and ends them with the stream.
    ///
    /// # Errors
    /// - [`StartError::Driver`]: a reply was missing or the line failed. FAST STOP and missing homing are not errors
    ///   here. The former ends the stream immediately, the latter with the first set-point.
    /// - [`StartError::System`]: the system has no thread, or no descriptor for a [`StopHandle`].
    pub fn start(mut gripper: Gripper<IO, C>, config: Config) -> Result<Self, StartError<IO::Error>> {
        let handle = gripper.stop_handle()?;
        let clock = gripper.clock().clone();
        let worker = Worker::new(gripper, config)?;
        let (shared, backend) = (Arc::clone(worker.shared()), worker.backend());
        let thread = thread::Builder::new().name("wsg set-points".into());
        let worker = thread.spawn(move || worker.run())?;
        Ok(Self { shared, clock, backend, handle, worker: Some(worker) })
    }
}

impl<IO, C: Clock + Clone> SetPointStream<IO, C> {
    /// Returns the driver's time, for [`schedule`](Self::schedule).
    #[must_use]
    pub fn now(&self) -> Instant {
        self.clock.clone().now()
    }

    /// Schedules a position for the time `at` on the driver's clock. The path is a straight line from the preceding
    /// set-point or the commanded position.
    ///
    /// Replaces all set-points at the same or a later time. A time in the past is equal to
    /// [`set_target`](Self::set_target). Positions are clamped to the stroke, and the speed limit takes precedence over
    /// `at`.
    ///
    /// # Errors
    /// Returns [`Rejected`]; nothing changes.
    pub fn schedule(&self, position: Mm, at: Instant) -> Result<(), Rejected> {
        let now = self.now();
        self.plan(position, |trajectory, position, speed_limit| {
            trajectory.schedule(now, position, at, speed_limit)
        })
    }

    /// Moves the fingers to the position at the speed limit. Replaces all set-points. Positions are clamped to the
    /// stroke.
    ///
    /// # Errors
    /// Returns [`Rejected`]; nothing changes.
    pub fn set_target(&self, position: Mm) -> Result<(), Rejected> {
        let now = self.now();
        self.plan(position, |trajectory, position, speed_limit| {
            trajectory.set_target(now, position, speed_limit);
            true
        })
    }

    fn plan(
        &self,
        position: Mm,
        change: impl FnOnce(&mut Trajectory, f32, f32) -> bool,
    ) -> Result<(), Rejected> {
        let mut shared = self.open()?;
        let Shared { limits, speed_limit, latest, .. } = *shared;
        if !position.0.is_finite() {
            return Err(Rejected::Invalid);
        }
        let begin = || Trajectory::at(latest.position, self.clock.clone().now());
        let trajectory = shared.trajectory.get_or_insert_with(begin);
        let position = position.0.max(0.0).min(limits.stroke);
        if change(trajectory, position, speed_limit) { Ok(()) } else { Err(Rejected::Full) }
    }

    /// Limits the speed from now on, clamped to the gripper's limits. The initial limit is the gripper's maximum speed.
    ///
    /// # Errors
    /// Returns [`Rejected`]; nothing changes.
    pub fn set_speed_limit(&self, speed: MmPerS) -> Result<(), Rejected> {
        let mut shared = self.open()?;
        let SystemLimits { min_speed, max_speed, .. } = shared.limits;
        shared.speed_limit = limit(speed.0, min_speed, max_speed)?;
        Ok(())
    }

    /// Limits the force on contact, clamped to the gripper's minimum and nominal force. The initial limit is the
    /// gripper's current one. With [`Backend::PrePosition`] it applies from the next motion on.
    ///
    /// # Errors
    /// Returns [`Rejected`]; nothing changes.
    pub fn set_force_limit(&self, force: N) -> Result<(), Rejected> {
        let mut shared = self.open()?;
        let SystemLimits { min_force, nominal_force, .. } = shared.limits;
        shared.force_limit = limit(force.0, min_force, nominal_force)?;
        Ok(())
    }

    /// Locks the shared state, unless the stream has ended.
    fn open(&self) -> Result<MutexGuard<'_, Shared>, Rejected> {
        let shared = lock(&self.shared);
        match shared.cause {
            Some(cause) => Err(Rejected::Ended(cause)),
            None => Ok(shared),
        }
    }
}

impl<IO, C> SetPointStream<IO, C> {
    /// Returns the detected back-end.
    #[must_use]
    pub const fn backend(&self) -> Backend {
        self.backend
    }

    /// Returns the latest sample.
    #[must_use]
    pub fn latest(&self) -> Sample {
        lock(&self.shared).latest
    }

    /// Returns the last [`HISTORY_LEN`] samples, oldest first.
    #[must_use]
    pub fn history(&self) -> Vec<Sample> {
        lock(&self.shared).history.iter().copied().collect()
    }

    /// Returns the estimated latency and clock offset.
    #[must_use]
    pub fn line(&self) -> LineEstimate {
        lock(&self.shared).exchanges.estimate()
    }

    /// Returns how the stream ended. `None` while it is running, and until the final Stop is confirmed or abandoned.
    #[must_use]
    pub fn ended(&self) -> Option<End> {
        lock(&self.shared).end
    }

    /// Returns a handle that stops the gripper from any thread, which ends the stream.
    #[must_use]
    pub fn stop_handle(&self) -> StopHandle {
        self.handle.clone()
    }

    /// Stops the fingers, waits for the worker, and returns the gripper and how the stream ended.
    ///
    /// # Panics
    /// Panics if the worker panicked.
    #[must_use]
    pub fn end(mut self) -> (Gripper<IO, C>, End) {
        match self.join() {
            Some(Ok((gripper, end))) => (gripper, end),
            Some(Err(panicked)) => panic::resume_unwind(panicked),
            None => unreachable!("only `end` and `drop` take the worker, and each takes the stream"),
        }
    }

    fn join(&mut self) -> Option<thread::Result<(Gripper<IO, C>, End)>> {
        let worker = self.worker.take()?;
        let mut shared = lock(&self.shared);
        if shared.cause.is_none() {
            shared.is_end_requested = true;
            // Also wakes the worker, which ends by its flag if the line accepts no Stop.
            let _ = self.handle.stop();
        }
        drop(shared);
        let joined = worker.join();
        let end = lock(&self.shared).end.unwrap_or(End { cause: Cause::Requested, is_stop_confirmed: false });
        Some(joined.map(|gripper| (gripper, end)))
    }
}

impl<IO, C> Drop for SetPointStream<IO, C> {
    fn drop(&mut self) {
        let _ = self.join();
    }
}

/// State shared by caller and worker.
#[derive(Debug)]
struct Shared {
    limits: SystemLimits,
    /// `None` before the first set-point.
    trajectory: Option<Trajectory>,
    speed_limit: f32,
    force_limit: f32,
    latest: Sample,
    history: VecDeque<Sample>,
    exchanges: Exchanges,
    is_end_requested: bool,
    /// The reason why the worker ends. From then on, a stop has no effect on it.
    cause: Option<Cause>,
    end: Option<End>,
}

impl Shared {
    /// Returns the order at `now`, or `None` before the first set-point.
    fn order(&mut self, now: Instant) -> Option<Order> {
        let Self { speed_limit, force_limit, .. } = *self;
        let position = self.trajectory.as_mut()?.advance(now, speed_limit);
        Some(Order { position, speed_limit, force_limit })
    }

    /// Returns the position to command at a future instant, if nothing changes.
    fn position_at(&self, moment: Instant) -> Option<f32> {
        Some(self.trajectory.clone()?.advance(moment, self.speed_limit))
    }

    fn record(&mut self, received_at: Instant, measured: &Measured, set_point: Option<f32>) {
        let Measured { flags, position, speed, force, measured_ms } = *measured;
        let measured_at = self.exchanges.estimate().measured_at(received_at, measured_ms);
        let number = self.latest.number.wrapping_add(1);
        self.latest = Sample { number, measured_at, received_at, position, speed, force, flags, set_point };
        if self.history.len() == HISTORY_LEN {
            self.history.pop_front();
        }
        self.history.push_back(self.latest);
    }
}

/// A poisoned lock is safe to use: a panic leaves no change half done.
fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Validates a limit and clamps it to the gripper's range.
fn limit(value: f32, least: f32, greatest: f32) -> Result<f32, Rejected> {
    if value.is_finite() && value > 0.0 { Ok(value.max(least).min(greatest)) } else { Err(Rejected::Invalid) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn each_end_and_each_refusal_has_its_own_text() {
        let causes = [
            (Cause::Requested, "the caller ended"),
            (Cause::Stopped(StopKind::FastStop), "a stop handle stopped the gripper: FAST STOP"),
            (Cause::FastStop, "acknowledge it"),
            (Cause::StoppedByOther, "another client"),
            (Cause::Script, "the gripper's log"),
            (Cause::Watchdog, "500 ms"),
            (Cause::Refused(Status::RangeError), "E_RANGE_ERROR"),
            (Cause::Unanswered, "no answer"),
            (Cause::Closed, "closed the connection"),
            (Cause::Transport(embedded_io::ErrorKind::BrokenPipe), "transport: BrokenPipe"),
        ];
        for (cause, text) in causes {
            let rejected = Rejected::Ended(cause).to_string();
            assert!(rejected.contains("the stream has ended") && rejected.contains(text), "{rejected}");
        }
        assert!(Rejected::Invalid.to_string().contains("finite"));
        assert!(Rejected::Full.to_string().contains(&MAX_SET_POINTS.to_string()));
        let driver = StartError::<Cause>::Driver(Error::NotConnected);
        assert_eq!(driver.to_string(), Error::<Cause>::NotConnected.to_string());
        let system = || io::Error::from(io::ErrorKind::OutOfMemory);
        assert_eq!(StartError::<Cause>::System(system()).to_string(), system().to_string());
    }
}
