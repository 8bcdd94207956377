//! Set-points for the fingers at a fixed rate, from a worker thread, with state feedback (feature `std`).
//!
//! A [`SetPointStream`] owns a connected gripper. Its worker sends the commanded position once per period and records
//! the reported state. The caller sets targets and reads the state without waiting for the line. In the repository,
//! `docs/python.md` explains the script upload, and `docs/models.md` has the message layout.
//!
//! | back-end | condition | set-points | state |
//! |---|---|---|---|
//! | [`Backend::Script`] | `wsg_stream.lua` runs on the gripper | replaced during the motion, without a stop | with each set-point, with the gripper's time |
//! | [`Backend::UmiScript`] | UMI's `cmd_measure.lua` or a compatible script runs | as above; no watchdog | with each set-point |
//! | [`Backend::PrePosition`] | neither script replies | a Pre-position (21h) per 100 ms of travel; the fingers stop in between | by automatic updates, 40 per second |
//!
//! **Start.** Nothing moves before the first set-point.
//!
//! **No further set-points.** The fingers move to the last one and hold it.
//!
//! **Gap.** An answer that is more than 100 ms late is a gap, which [`gaps`](SetPointStream::gaps) reports. The fingers
//! hold, or finish the running segment. They continue when the gripper answers within the time-out of the link
//! ([`attempts`](crate::session::Config::attempts) times
//! [`reply_timeout_ms`](crate::session::Config::reply_timeout_ms)) and after at most [`MAX_GAP_MS`]: from where they are
//! to the next set-point, or else to the last one, within the speed limit. A longer gap ends the stream.
//!
//! **Contact.** With a script, the fingers push against a part with the force limit. With Pre-position, contact turns
//! the motor off (command set, 3.2.2) and the force ends. The fingers stay there until the set-point moves away from
//! the part. To hold a part without a script, end the stream and call [`grip`](super::blocking::GripperOver::grip).
//!
//! **End.** The worker ends after a FAST STOP, a Stop by another client, a script error, a lost connection or the end
//! of the `SetPointStream`. It sends Stop if the line permits it, and [`ended`](SetPointStream::ended) returns the
//! [`Cause`]. Nothing resumes automatically. After a FAST STOP, [`acknowledge`](SetPointStream::acknowledge) begins the stream
//! again, without set-points.
//!
//! ```no_run
//! use wsg_protocol::HomingDirection;
//! use wsg_protocol::driver::stream::{Cause, Config, SetPointStream};
//! use wsg_protocol::driver::{Mm, MmPerS, N, host};
//!
//! let mut gripper = host::connect("192.168.1.20:1000")?;
//! gripper.home(HomingDirection::Positive)?;
//!
//! let stream = SetPointStream::start(gripper, Config::default())?;
//! stream.set_speed_limit(MmPerS(200.0))?;
//! stream.set_force_limit(N(20.0))?;
//! let now = stream.now();
//! stream.schedule(Mm(100.0), now.plus(100))?;
//! stream.schedule(Mm(90.0), now.plus(200))?;
//! while stream.latest()?.position > 90.5 {
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

use super::blocking::{Gripper, Transport};
use super::{Clock, Error, Mm, MmPerS, N, StopHandle, StopKind, Stoppable};
use crate::limits::{OutOfLimits, Quantity};
use crate::time::Instant;
use crate::types::{HomingDirection, Status, SystemFlags, SystemLimits};
use embedded_io::ErrorType;
use line::Exchanges;
use script::{Measured, Order};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use std::vec::Vec;
use std::{io, panic};
use trajectory::{Ahead, Trajectory};
use worker::Worker;

/// The source of the project's script, `wsg_stream.lua`, for upload to a gripper.
pub const SCRIPT: &str = include_str!("../../scripts/wsg_stream.lua");

/// Number of samples in [`SetPointStream::history`]: 10 s at 100 Hz.
pub const HISTORY_LEN: usize = 1_024;

/// Number of gaps in [`SetPointStream::gaps`].
pub const GAPS_LEN: usize = 64;

/// How far ahead of now a set-point may be scheduled, in milliseconds: one hour. A time beyond it, in the future or in
/// the past, is rejected because it is a mistake, such as another unit or another clock.
pub const HORIZON_MS: u32 = 3_600_000;

/// The longest gap after which a stream continues, in milliseconds. No set-point is executed later than this.
pub const MAX_GAP_MS: u32 = 1_000;

/// Settings of a stream, fixed at its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// Set-points per second, 1 to 500. Each request is sent after the previous reply, so a line with a longer round
    /// trip lowers the rate.
    pub rate_hz: u16,
    /// Maximum number of queued set-points, 1 to [`MAX_QUEUE_LEN`](Self::MAX_QUEUE_LEN).
    pub queue_len: usize,
}

impl Config {
    /// 100 set-points per second, and a queue of 1 024 set-points.
    pub const DEFAULT: Self = Self { rate_hz: 100, queue_len: 1_024 };

    /// The longest queue.
    pub const MAX_QUEUE_LEN: usize = 4_096;

    /// Returns whether both values are within their limits.
    #[must_use]
    pub const fn is_valid(&self) -> bool {
        matches!(self.rate_hz, 1..=500) && matches!(self.queue_len, 1..=Self::MAX_QUEUE_LEN)
    }
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
    /// UMI's script, `cmd_measure.lua`. It has no watchdog and keeps the last speed until the next set-point or a Stop.
    /// The worker sends Stop in a gap, unless the fingers push against a part.
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
    /// from the estimated latency. Later than that of the sample before.
    pub measured_at: Instant,
    /// Time at which the worker received the sample. Later than that of the sample before.
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

impl Sample {
    /// Returns the time since the measurement at `now`, in milliseconds.
    #[must_use]
    pub const fn age_ms(&self, now: Instant) -> u32 {
        now.since(self.measured_at)
    }
}

/// A time without answers from the gripper, during which the fingers held or finished the running segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Time at which the first missing answer was due.
    pub begun_at: Instant,
    /// Time until the next answer, in milliseconds.
    pub length_ms: u32,
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
    /// The set-points paused for more than [`MAX_GAP_MS`], because this program or the line paused. The script has stopped
    /// the fingers.
    Watchdog,
    /// The gripper rejected a set-point or a setting with this status: E_NOT_INITIALIZED before homing, E_RANGE_ERROR
    /// outside the soft limits, E_ALREADY_RUNNING while it holds a part, [`MISMATCH`](crate::session::MISMATCH) if it did
    /// not apply the force limit.
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
            Self::Watchdog => f.write_str("no set-point reached the gripper for more than 1 s"),
            Self::Refused(status) => write!(f, "the gripper refused a set-point: {status}"),
            Self::Unanswered => f.write_str("no answer from the gripper"),
            Self::Closed => f.write_str("the gripper closed the connection"),
            Self::Transport(kind) => write!(f, "transport: {kind}"),
        }
    }
}

impl core::error::Error for Cause {}

impl Cause {
    /// Returns whether the gripper is in FAST STOP.
    const fn is_fast_stop(self) -> bool {
        matches!(self, Self::FastStop | Self::Stopped(StopKind::FastStop))
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
    /// The position is outside the stroke, or the limit outside the limits of the gripper.
    OutOfLimits(OutOfLimits),
    /// The time is more than [`HORIZON_MS`] ahead, or in the past if negative.
    BeyondHorizon {
        /// The distance from now in ms.
        ahead_ms: i32,
    },
    /// As many earlier set-points are queued as [`Config::queue_len`] permits.
    Full {
        /// The length of the queue.
        queue_len: usize,
    },
    /// An earlier [`home`](SetPointStream::home) or [`acknowledge`](SetPointStream::acknowledge) has not ended.
    Busy,
    /// The stream has ended.
    Ended(Cause),
}

impl core::fmt::Display for Rejected {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::OutOfLimits(refused) => refused.fmt(f),
            Self::BeyondHorizon { ahead_ms } => {
                let (seconds, side) =
                    (ahead_ms.unsigned_abs() / 1_000, if *ahead_ms < 0 { "in the past" } else { "ahead" });
                write!(f, "the time is {seconds} s {side}; ")?;
                write!(f, "expected milliseconds of the stream's clock, at most 3600 s {side}")
            }
            Self::Full { queue_len } => {
                write!(f, "the queue is full: {queue_len} earlier set-points are waiting")
            }
            Self::Busy => f.write_str("a homing or an acknowledgement has not ended"),
            Self::Ended(cause) => write!(f, "the stream has ended: {cause}"),
        }
    }
}

impl core::error::Error for Rejected {}

/// The reason why a stream did not start. The gripper is dropped.
#[derive(Debug)]
pub enum StartError<E> {
    /// A value of the [`Config`] is outside its limits. Nothing was sent.
    Config,
    /// A request of the driver failed.
    Driver(Error<E>),
    /// The operating system has no thread or no descriptor left.
    System(io::Error),
}

impl<E: core::fmt::Display> core::fmt::Display for StartError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Config => {
                let most = Config::MAX_QUEUE_LEN;
                write!(f, "expected 1 to 500 set-points per second and a queue of 1 to {most} set-points")
            }
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

/// Receives the result of a request to a stream. It is disconnected if the stream ends first.
pub type Outcome<E> = mpsc::Receiver<Result<(), Error<E>>>;

/// A request to the worker. There is at most one at a time.
#[derive(Debug)]
struct Request<E> {
    /// The direction of a homing, or `None` to acknowledge.
    home: Option<HomingDirection>,
    /// Number of stops before the request. It has no effect after a later one.
    stops: u32,
    result: mpsc::Sender<Result<(), Error<E>>>,
}

/// A gripper that follows set-points; see the [module](self).
///
/// Its methods lock a mutex that the worker holds for microseconds, never while it waits for the line. Dropping it
/// stops the fingers and waits for the worker to end.
#[derive(Debug)]
pub struct SetPointStream<IO: ErrorType, C> {
    shared: Arc<Mutex<Shared>>,
    clock: C,
    backend: Backend,
    handle: StopHandle,
    requests: mpsc::Sender<Request<IO::Error>>,
    /// `None` only during drop.
    worker: Option<JoinHandle<Gripper<IO, C>>>,
}

impl<IO, C> SetPointStream<IO, C>
where
    IO: Transport<Error: Send> + Stoppable + Send + 'static,
    C: Clock + Clone + Send + 'static,
{
    /// Detects the back-end, measures once, and starts the worker. Waits for about ten replies.
    ///
    /// The gripper must be connected, and no motion of this driver may be running. [`Backend::PrePosition`] replaces
    /// the subscriptions to width, speed and force, and ends them with the stream.
    ///
    /// # Errors
    /// - [`StartError::Config`]: a value of the configuration is outside its limits.
    /// - [`StartError::Driver`]: a reply was missing or the line failed. FAST STOP and missing homing are not errors
    ///   here. The former ends the stream immediately, the latter with the first set-point.
    /// - [`StartError::System`]: the system has no thread, or no descriptor for a [`StopHandle`].
    pub fn start(mut gripper: Gripper<IO, C>, config: Config) -> Result<Self, StartError<IO::Error>> {
        if !config.is_valid() {
            return Err(StartError::Config);
        }
        let handle = gripper.stop_handle()?;
        let clock = gripper.clock().clone();
        let (requests, received) = mpsc::channel();
        let worker = Worker::new(gripper, config, received, handle.clone())?;
        let (shared, backend) = (Arc::clone(worker.shared()), worker.backend());
        let thread = thread::Builder::new().name("wsg set-points".into());
        let worker = thread.spawn(move || worker.run())?;
        Ok(Self { shared, clock, backend, handle, requests, worker: Some(worker) })
    }
}

impl<IO: ErrorType, C: Clock + Clone> SetPointStream<IO, C> {
    /// Returns the driver's time, for [`schedule`](Self::schedule).
    #[must_use]
    pub fn now(&self) -> Instant {
        self.clock.clone().now()
    }

    /// Schedules a position for the time `at` on the driver's clock. The path is a straight line from the preceding
    /// set-point or the commanded position.
    ///
    /// Replaces all set-points at the same or a later time. A time in the past is equal to
    /// [`set_target`](Self::set_target). The speed limit takes precedence over `at`.
    ///
    /// # Errors
    /// Returns [`Rejected`], and nothing changes: the position is outside the stroke, or the time is more than
    /// [`HORIZON_MS`] from now in either direction.
    pub fn schedule(&self, position: Mm, at: Instant) -> Result<(), Rejected> {
        let now = self.now();
        let ahead = Ahead::of(now, at)?;
        self.plan(position, |trajectory, position, speed_limit| {
            trajectory.schedule(now, position, ahead, speed_limit)
        })
    }

    /// Moves the fingers to the position at the speed limit. Replaces all set-points.
    ///
    /// # Errors
    /// Returns [`Rejected`], and nothing changes: the position is outside the stroke.
    pub fn set_target(&self, position: Mm) -> Result<(), Rejected> {
        let now = self.now();
        self.plan(position, |trajectory, position, speed_limit| {
            trajectory.set_target(now, position, speed_limit);
            Ok(())
        })
    }

    fn plan(
        &self,
        position: Mm,
        change: impl FnOnce(&mut Trajectory, f32, f32) -> Result<(), Rejected>,
    ) -> Result<(), Rejected> {
        let mut shared = self.open()?;
        shared.check(Quantity::Width, position.0)?;
        if shared.is_busy {
            return Err(Rejected::Busy);
        }
        let Shared { speed_limit, latest, queue_len, .. } = *shared;
        let here = shared.within_stroke(latest.position);
        let begin = || Trajectory::at(here, self.clock.clone().now(), queue_len);
        let trajectory = shared.trajectory.get_or_insert_with(begin);
        change(trajectory, position.0, speed_limit)
    }

    /// Limits the speed from now on. The initial limit is the gripper's maximum speed.
    ///
    /// # Errors
    /// Returns [`Rejected`], and nothing changes: the value is outside the gripper's limits.
    pub fn set_speed_limit(&self, speed: MmPerS) -> Result<(), Rejected> {
        let mut shared = self.open()?;
        shared.check(Quantity::Speed, speed.0)?;
        shared.speed_limit = speed.0;
        Ok(())
    }

    /// Limits the force on contact. The initial limit is the gripper's current one. With [`Backend::PrePosition`] it
    /// applies from the next motion on.
    ///
    /// # Errors
    /// Returns [`Rejected`], and nothing changes: the value is less than the minimum force, or greater than the nominal
    /// force, or in overdrive mode than the overdrive force.
    pub fn set_force_limit(&self, force: N) -> Result<(), Rejected> {
        let mut shared = self.open()?;
        shared.check(Quantity::Force, force.0)?;
        shared.force_limit = force.0;
        Ok(())
    }

    /// References the fingers at an end stop (command set, 3.2.1). All set-points are dropped, the fingers stop and then move to
    /// the end stop. Afterwards they stay there until the next set-point. The result is the one of
    /// [`home`](super::blocking::GripperOver::home), and an error leaves the stream without set-points.
    ///
    /// # Errors
    /// Returns [`Rejected`], and nothing changes: an earlier request has not ended, or the stream has ended.
    pub fn home(&self, direction: HomingDirection) -> Result<Outcome<IO::Error>, Rejected> {
        self.request(self.open()?, Some(direction))
    }

    /// Acknowledges a FAST STOP or a fault (command set, 3.2.5). Make sure that the fingers may move.
    ///
    /// All set-points are dropped and the fingers stop, so that nothing moves before the next one. A stream that a FAST STOP
    /// has ended begins again.
    ///
    /// # Errors
    /// Returns [`Rejected`], and nothing changes: an earlier request has not ended, or the stream has ended for another
    /// reason.
    pub fn acknowledge(&self) -> Result<Outcome<IO::Error>, Rejected> {
        let shared = lock(&self.shared);
        match shared.cause {
            Some(cause) if !cause.is_fast_stop() => Err(Rejected::Ended(cause)),
            _ => self.request(shared, None),
        }
    }

    /// Passes a request to the worker under the lock, under which the worker rejects requests at the end of the stream.
    fn request(
        &self,
        mut shared: MutexGuard<'_, Shared>,
        home: Option<HomingDirection>,
    ) -> Result<Outcome<IO::Error>, Rejected> {
        if shared.is_busy {
            return Err(Rejected::Busy);
        }
        (shared.is_busy, shared.trajectory) = (true, None);
        let (result, outcome) = mpsc::channel();
        // Without a worker, the outcome is disconnected.
        let _ = self.requests.send(Request { home, stops: self.handle.count(), result });
        Ok(outcome)
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

impl<IO: ErrorType, C> SetPointStream<IO, C> {
    /// Returns the detected back-end.
    #[must_use]
    pub const fn backend(&self) -> Backend {
        self.backend
    }

    /// Returns the latest sample. [`Sample::age_ms`] is less than the time-out of the link while the stream runs.
    ///
    /// # Errors
    /// Returns the reason for the end of the stream, from then on. [`history`](Self::history) keeps the samples.
    pub fn latest(&self) -> Result<Sample, Cause> {
        let shared = lock(&self.shared);
        shared.cause.map_or(Ok(shared.latest), Err)
    }

    /// Returns the last [`HISTORY_LEN`] samples, oldest first, also after the end of the stream.
    #[must_use]
    pub fn history(&self) -> Vec<Sample> {
        lock(&self.shared).history.iter().copied().collect()
    }

    /// Returns a reader of the samples after this moment.
    #[must_use]
    pub fn samples(&self) -> Samples {
        Samples { shared: Arc::clone(&self.shared), last: lock(&self.shared).latest.number }
    }

    /// Returns the last [`GAPS_LEN`] gaps, oldest first, also after the end of the stream.
    #[must_use]
    pub fn gaps(&self) -> Vec<Gap> {
        lock(&self.shared).gaps.iter().copied().collect()
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
        shared.is_end_requested = true;
        if shared.cause.is_none() {
            // Also wakes the worker, which ends by its flag if the line accepts no Stop.
            let _ = self.handle.stop();
        }
        drop(shared);
        let joined = worker.join();
        let end = lock(&self.shared).end.unwrap_or(End { cause: Cause::Requested, is_stop_confirmed: false });
        Some(joined.map(|gripper| (gripper, end)))
    }
}

impl<IO: ErrorType, C> Drop for SetPointStream<IO, C> {
    fn drop(&mut self) {
        let _ = self.join();
    }
}

/// Waits for new samples of a stream, from any thread.
#[derive(Clone, Debug)]
pub struct Samples {
    shared: Arc<Mutex<Shared>>,
    /// Number of the last returned sample.
    last: u32,
}

impl Samples {
    /// Waits for a sample after the last returned one for at most `within`, and returns the latest, or `None` if none arrives.
    ///
    /// # Errors
    /// Returns the reason for the end of the stream, from then on.
    pub fn next_within(&mut self, within: Duration) -> Result<Option<Sample>, Cause> {
        let shared = lock(&self.shared);
        let recorded = Arc::clone(&shared.recorded);
        let is_idle = |shared: &mut Shared| shared.latest.number == self.last && shared.cause.is_none();
        let waited = recorded.wait_timeout_while(shared, within, is_idle);
        let (shared, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if let Some(cause) = shared.cause {
            return Err(cause);
        }
        let is_new = shared.latest.number != self.last;
        self.last = shared.latest.number;
        Ok(is_new.then_some(shared.latest))
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
    queue_len: usize,
    latest: Sample,
    history: VecDeque<Sample>,
    /// Notified of each sample and of the end.
    recorded: Arc<Condvar>,
    gaps: VecDeque<Gap>,
    exchanges: Exchanges,
    is_end_requested: bool,
    /// Whether a [`Request`] has not ended. Set-points are rejected meanwhile.
    is_busy: bool,
    /// The reason why the worker ends. From then on, a stop has no effect on it.
    cause: Option<Cause>,
    end: Option<End>,
}

impl Shared {
    /// Checks a value against the limits of the gripper.
    fn check(&self, quantity: Quantity, value: f32) -> Result<(), Rejected> {
        self.limits.check(quantity, value, self.latest.flags).map_err(Rejected::OutOfLimits)
    }

    /// Returns the position within the stroke. A measured one may be slightly outside.
    const fn within_stroke(&self, position: f32) -> f32 {
        position.max(0.0).min(self.limits.stroke)
    }

    /// Returns the order at `now`, or `None` before the first set-point.
    fn order(&mut self, now: Instant) -> Option<Order> {
        let Self { speed_limit, force_limit, .. } = *self;
        let position = self.trajectory.as_mut()?.advance(now, speed_limit);
        Some(Order { position, speed_limit, force_limit })
    }

    /// Returns the position to command at a future instant, if nothing changes.
    fn position_at(&self, moment: Instant) -> Option<f32> {
        Some(self.trajectory.as_ref()?.position_at(moment, self.speed_limit))
    }

    fn record(&mut self, received_at: Instant, measured: &Measured, set_point: Option<f32>) {
        let Measured { flags, position, speed, force, measured_ms } = *measured;
        self.latest = Sample { position, speed, force, flags, set_point, ..self.latest };
        if received_at.signed_since(self.latest.received_at) > 0 {
            self.latest.number = self.latest.number.wrapping_add(1);
            self.latest.received_at = received_at;
            // The estimate of the latency changes, so the estimated time may be earlier than that of the sample before.
            let next = self.latest.measured_at.plus(1);
            let estimated = self.exchanges.estimate().measured_at(received_at, measured_ms);
            self.latest.measured_at = if estimated.has_reached(next) { estimated } else { next };
        } else {
            // Replaces the sample of the same millisecond, because the times of samples must increase.
            self.history.pop_back();
        }
        keep(&mut self.history, self.latest, HISTORY_LEN);
        self.recorded.notify_all();
    }
}

/// Appends to a history of limited length.
fn keep<T>(history: &mut VecDeque<T>, latest: T, most: usize) {
    if history.len() >= most {
        history.pop_front();
    }
    history.push_back(latest);
}

/// A poisoned lock is safe to use: a panic leaves no change half done.
fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
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
            (Cause::Watchdog, "more than 1 s"),
            (Cause::Refused(Status::RangeError), "E_RANGE_ERROR"),
            (Cause::Unanswered, "no answer"),
            (Cause::Closed, "closed the connection"),
            (Cause::Transport(embedded_io::ErrorKind::BrokenPipe), "transport: BrokenPipe"),
        ];
        for (cause, text) in causes {
            let rejected = Rejected::Ended(cause).to_string();
            assert!(rejected.contains("the stream has ended") && rejected.contains(text), "{rejected}");
        }
        assert!(Rejected::Busy.to_string().contains("homing"));
        assert!(Rejected::Full { queue_len: 17 }.to_string().contains("17 earlier"));
        for (ahead_ms, text) in [(4_000_000, "4000 s ahead"), (i32::MIN, "2147483 s in the past")] {
            let rejected = Rejected::BeyondHorizon { ahead_ms }.to_string();
            assert!(rejected.contains(text) && rejected.contains("at most 3600 s"), "{rejected}");
        }
        assert!(StartError::<Cause>::Config.to_string().contains("1 to 4096"));
        let driver = StartError::<Cause>::Driver(Error::NotConnected);
        assert_eq!(driver.to_string(), Error::<Cause>::NotConnected.to_string());
        let system = || io::Error::from(io::ErrorKind::OutOfMemory);
        assert_eq!(StartError::<Cause>::System(system()).to_string(), system().to_string());
    }
}
