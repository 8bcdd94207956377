//! Automatic updates of width, speed and force (command set, 3.4): a thread receives them, and a reader takes the newest.

use std::collections::VecDeque;
use std::mem;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use pyo3::exceptions::PyStopIteration;
use pyo3::prelude::*;
use wsg_protocol::driver::blocking::GripperOver;
use wsg_protocol::driver::stream::HISTORY_LEN;
use wsg_protocol::driver::{Error, Protocol, UPDATES_LEN, Update};
use wsg_protocol::session::{Known, Topic};
use wsg_protocol::{AutoUpdate, GripperState, SystemFlags};

use crate::core::{Core, Failed};
use crate::driver::NOTHING;
use crate::error::{self, Failure};
use crate::interpreter::{detach, try_attach};
use crate::line::{Clock, Line};
use crate::number::shortest;
use crate::queue::{Queue, Reply, Ticket};
use crate::stream::unix_now;

/// The values of a reading, in its order.
const TOPICS: [Topic; 3] = [Topic::Width, Topic::Speed, Topic::Force];
/// Longest wait for an update before the thread checks for the end of the subscription, in ms.
const WAIT_MS: u32 = 50;
/// Maximum number of updates before other requests pass.
const MAX_UPDATES: usize = 4 * UPDATES_LEN;
/// Shortest mean time between two values, in ms. In field reports, real grippers send up to 140 values per second. If more are
/// requested, they delay all answers, until the connection counts as lost.
const SHORTEST_MS: u16 = 8;
/// Longest interval, in s.
const LONGEST: f64 = 10.0;
/// Longest time without a reading in addition to the interval. The driver also polls each value twice a second.
const SILENCE: Duration = Duration::from_millis(1_000);
/// Interval at which a waiting reader handles Python's signals.
pub(crate) const SIGNALS: Duration = Duration::from_millis(50);

/// One new value of each wanted quantity, in mm, mm/s and N.
struct Reading {
    /// A value of `time.time()`.
    received: f64,
    values: [Option<f32>; 3],
    state: GripperState,
    flags: SystemFlags,
}

/// Received time as a value of `time.time()`, width, speed, force, gripper state, system flags.
type Row = (f64, Option<f64>, Option<f64>, Option<f64>, u8, u32);

/// The readings on their way to the reader.
pub(crate) struct Feed {
    shared: Mutex<Shared>,
    changed: Condvar,
    wanted: [bool; 3],
    period_ms: u16,
    /// Maximum number of readings that wait for the reader.
    capacity: usize,
    /// Whether the reader receives the updates itself, as in virtual time.
    pub(crate) is_pulled: bool,
}

struct Shared {
    waiting: VecDeque<Reading>,
    /// Values received since the last reading.
    fresh: [Option<f32>; 3],
    /// The states at the time of the next update.
    flags: Option<SystemFlags>,
    state: Option<GripperState>,
    /// Time without a reading.
    silent: Duration,
    /// Received time of the last reading.
    last_received: f64,
    dropped: u64,
    /// The driver's count of lost updates, or `None` before the gripper was requested to send any.
    lost: Option<u16>,
    stage: Stage,
    failure: Option<Failure>,
}

impl Shared {
    /// Records an update. Returns the reading that it completes.
    fn note(&mut self, update: Update, wanted: [bool; 3]) -> Option<Reading> {
        let (place, value) = match update {
            Update::Width(width) => (0, width),
            Update::Speed(speed) => (1, speed),
            Update::Force(force) => (2, force),
            Update::SystemState(flags) => {
                self.flags = Some(flags);
                return None;
            }
            Update::GripperState(state) => {
                self.state = Some(state);
                return None;
            }
            _ => return None,
        };
        let (flags, state) = (self.flags?, self.state?);
        let is_referenced = flags.contains(SystemFlags::REFERENCED);
        // There is no width before homing, and the gripper sends none.
        *self.fresh.get_mut(place)? = Some(value).filter(|_| place > 0 || is_referenced);
        let required = [wanted[0] && is_referenced, wanted[1], wanted[2]];
        if required.iter().zip(self.fresh).any(|(is_required, value)| *is_required && value.is_none()) {
            return None;
        }
        let fresh = mem::take(&mut self.fresh);
        let values = [0, 1, 2].map(|place| fresh[place].filter(|_| required[place]));
        Some(Reading { received: 0.0, values, state, flags })
    }
}

/// How far a subscription is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Running,
    /// Its reader has closed it, or its connection is being closed.
    Closing,
    /// No updates are received any more.
    Over,
}

impl Feed {
    fn new(wanted: [bool; 3], period_ms: u16, capacity: usize, is_pulled: bool) -> Self {
        let shared = Shared {
            waiting: VecDeque::new(),
            fresh: [None; 3],
            flags: None,
            state: None,
            silent: Duration::ZERO,
            last_received: 0.0,
            dropped: 0,
            lost: None,
            stage: Stage::Running,
            failure: None,
        };
        Self { shared: Mutex::new(shared), changed: Condvar::new(), wanted, period_ms, capacity, is_pulled }
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn topics(&self) -> impl Iterator<Item = Topic> {
        TOPICS.into_iter().zip(self.wanted).filter_map(|(topic, is_wanted)| is_wanted.then_some(topic))
    }

    /// Receives updates for a moment. Subscribes first if necessary.
    pub(crate) fn receive<P: Protocol>(
        &self,
        gripper: &mut GripperOver<Line, Clock, P>,
    ) -> Result<(), Failure> {
        if self.lock().lost.is_none() {
            // Values of an earlier subscription are old.
            for _ in 0..UPDATES_LEN {
                unless_stopped(gripper.next_update(0).map(drop))?;
            }
            self.topics().for_each(|topic| gripper.subscribe(topic, AutoUpdate::every(self.period_ms)));
            let mut shared = self.lock();
            shared.lost = Some(gripper.counters().updates_lost);
            (shared.flags, shared.state) = (gripper.known().flags, gripper.known().state);
        }
        let begun = Instant::now();
        let mut updates = Vec::new();
        let mut end = Ok(());
        for turn in 0..MAX_UPDATES {
            match gripper.next_update(if turn == 0 { WAIT_MS } else { 0 }) {
                Ok(Some(update)) => updates.push(update),
                Ok(None) => break,
                Err(failure) => {
                    end = unless_stopped(Err(failure));
                    break;
                }
            }
        }
        let age_ms = self.topics().filter_map(|topic| gripper.age_ms(topic)).max().unwrap_or(0);
        self.pass(&updates, *gripper.known(), age_ms, gripper.counters().updates_lost);
        end?;
        if !gripper.is_connected() {
            return Err(Error::NotConnected);
        }
        let mut shared = self.lock();
        // A pause of this program is no silence of the gripper.
        shared.silent += begun.elapsed().min(Duration::from_millis(WAIT_MS.into()));
        let is_silent = shared.silent > SILENCE + Duration::from_millis(self.period_ms.into());
        if is_silent { Err(Error::Unanswered) } else { Ok(()) }
    }

    /// Passes the readings of some updates to the reader. `age_ms` is the age of the last reading. The gripper sent the others
    /// one period apart.
    fn pass(&self, updates: &[Update], known: Known, age_ms: u32, lost: u16) {
        let now = unix_now();
        let mut shared = self.lock();
        let missed = lost.saturating_sub(shared.lost.replace(lost).unwrap_or(lost));
        let mut received = Vec::new();
        if missed == 0 {
            received.extend(updates.iter().filter_map(|update| shared.note(*update, self.wanted)));
        } else {
            // The states at the time of the remaining updates are unknown.
            shared.fresh = [None; 3];
            let kinds = self.topics().count().max(1) as u64;
            shared.dropped += (u64::from(missed) + updates.len() as u64).div_ceil(kinds);
        }
        (shared.flags, shared.state) = (known.flags, known.state);
        let later = (0..received.len() as u32).rev();
        for (mut reading, later) in received.into_iter().zip(later) {
            let age_ms = f64::from(age_ms) + f64::from(later) * f64::from(self.period_ms);
            reading.received = now - age_ms / 1e3;
            // The times increase, unless the system clock was set.
            let back = shared.last_received - reading.received;
            if (0.0..1.0).contains(&back) {
                reading.received = shared.last_received + 1e-6;
            }
            (shared.silent, shared.last_received) = (Duration::ZERO, reading.received);
            if shared.waiting.len() >= self.capacity {
                shared.waiting.pop_front();
                shared.dropped += 1;
            }
            shared.waiting.push_back(reading);
        }
        drop(shared);
        self.changed.notify_all();
    }

    /// Makes the gripper send no more updates. Failures have no effect, because the connection is then lost.
    pub(crate) fn unsubscribe<P: Protocol>(
        &self,
        gripper: &mut GripperOver<Line, Clock, P>,
    ) -> Result<(), Failure> {
        self.topics().for_each(|topic| gripper.subscribe(topic, AutoUpdate::once()));
        // A query sends the change at once.
        for topic in self.topics().filter(|_| gripper.is_connected()).collect::<Vec<_>>() {
            match topic {
                Topic::Width => drop(gripper.width()),
                Topic::Speed => drop(gripper.speed()),
                _ => drop(gripper.force()),
            }
        }
        Ok(())
    }

    pub(crate) fn is_running(&self) -> bool {
        self.lock().stage == Stage::Running
    }

    pub(crate) fn is_over(&self) -> bool {
        self.lock().stage == Stage::Over
    }

    /// Ends the subscription at its reader, or with a failure.
    pub(crate) fn end(&self, failure: Option<Failure>) {
        let mut shared = self.lock();
        if shared.stage == Stage::Running {
            (shared.stage, shared.failure) = (Stage::Closing, failure);
        }
        drop(shared);
        self.changed.notify_all();
    }

    /// Records that no more updates are received.
    pub(crate) fn set_over(&self) {
        self.lock().stage = Stage::Over;
        self.changed.notify_all();
    }

    /// Waits until no more updates are received.
    pub(crate) fn wait_for_end(&self) {
        let waited = self.changed.wait_while(self.lock(), |shared| shared.stage != Stage::Over);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }

    /// Waits until there is a reading or the end, for at most this time.
    fn wait(&self, within: Duration) {
        let is_idle = |shared: &mut Shared| shared.waiting.is_empty() && shared.stage == Stage::Running;
        let waited = self.changed.wait_timeout_while(self.lock(), within, is_idle);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

/// A stop of this program ends motions, not the updates.
fn unless_stopped(result: Result<(), Failure>) -> Result<(), Failure> {
    if matches!(result, Err(Error::Stopped(_))) { Ok(()) } else { result }
}

/// The reader's end of a subscription.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Updates {
    core: Arc<Core>,
    feed: Arc<Feed>,
    /// The queue of waits of an event loop.
    waits: Queue,
}

impl Updates {
    /// Begins automatic updates at an interval in s, by default at the shortest.
    pub(crate) fn begin(
        py: Python<'_>,
        core: &Arc<Core>,
        interval: Option<f64>,
        wanted: [bool; 3],
        buffer: usize,
        is_pulled: bool,
    ) -> PyResult<Self> {
        let invalid = |text: &str| Err(error::exception(py, "InvalidError", text, None));
        let values = wanted.iter().filter(|is_wanted| **is_wanted).count() as u16;
        let shortest = f64::from((SHORTEST_MS * values).max(AutoUpdate::MIN_PERIOD_MS)) / 1e3;
        let interval = interval.unwrap_or(shortest);
        if !(shortest..=LONGEST).contains(&interval) {
            let text =
                format!("interval is {interval} s; expected {shortest} to {LONGEST} s for {values} values");
            return invalid(&text);
        }
        check_buffer(py, buffer)?;
        if wanted == [false; 3] {
            return invalid("no value to subscribe to; expected width, speed or force");
        }
        let feed = Feed::new(wanted, (interval * 1e3).round() as u16, buffer, is_pulled);
        let feed = Arc::new(feed);
        let begun = detach(py, || core.begin_updates(&feed)).map_err(|failed| failed.into_exception(py))?;
        if !begun {
            let text = "the connection has a subscription: close it first";
            return Err(error::exception(py, "BusyError", text, None));
        }
        if !is_pulled {
            let (core, received) = (Arc::clone(core), Arc::clone(&feed));
            let spawned = thread::Builder::new().name("wsg updates".to_owned()).spawn(move || {
                while core.receive_updates(&received) {}
                core.unsubscribe(&received);
                // The connection may end here, before the reader's `close` returns.
                drop(core);
                received.set_over();
            });
            if let Err(failure) = spawned {
                feed.set_over();
                return Err(failure.into());
            }
        }
        Ok(Self { core: Arc::clone(core), feed, waits: Queue::default() })
    }

    fn is_foreign(&self) -> bool {
        self.core.is_foreign()
    }
}

/// Checks the buffer of a reader. A stream keeps as many samples.
pub(crate) fn check_buffer(py: Python<'_>, buffer: usize) -> PyResult<()> {
    if (1..=HISTORY_LEN).contains(&buffer) {
        return Ok(());
    }
    let text = format!("buffer is {buffer}; expected 1 to {HISTORY_LEN}");
    Err(error::exception(py, "InvalidError", &text, None))
}

#[pymethods]
impl Updates {
    /// Returns the next reading, or None if it has not arrived. Raises StopIteration after `close`, and the cause of another end.
    fn take(&self, py: Python<'_>) -> PyResult<Option<Row>> {
        if self.is_foreign() {
            return Err(Failed::from(Error::NotConnected).into_exception(py));
        }
        let mut shared = self.feed.lock();
        let Some(reading) = shared.waiting.pop_front() else {
            return match (&shared.failure, shared.stage) {
                (Some(failure), _) => Err(error::of_driver(py, failure)),
                (None, Stage::Running) => Ok(None),
                (None, _) => Err(PyStopIteration::new_err(())),
            };
        };
        drop(shared);
        let Reading { received, values, state, flags } = reading;
        let [width, speed, force] = values.map(|value| value.map(shortest));
        Ok(Some((received, width, speed, force, state.code(), flags.bits())))
    }

    /// Waits for the next reading.
    fn next(&self, py: Python<'_>) -> PyResult<Row> {
        loop {
            if let Some(row) = self.take(py)? {
                return Ok(row);
            }
            detach(py, || {
                if self.feed.is_pulled {
                    self.core.receive_updates(&self.feed);
                } else {
                    self.feed.wait(SIGNALS);
                }
            });
            py.check_signals()?;
        }
    }

    /// Passes None to `reply` when `take` has a result. The wait is bounded, because silence ends the subscription.
    fn wait(&self, py: Python<'_>, reply: Reply) -> PyResult<Ticket> {
        let feed = Arc::clone(&self.feed);
        self.waits.push(py, reply, &self.core, false, move |_| {
            feed.wait(Duration::from_secs(60));
            Ok(NOTHING)
        })
    }

    /// Returns the number of readings that the reader has missed.
    fn dropped(&self) -> u64 {
        self.feed.lock().dropped
    }

    /// Ends the updates.
    fn close(&self, py: Python<'_>) {
        if !self.is_foreign() {
            detach(py, || self.core.end_updates(&self.feed, None));
        }
    }
}

impl Drop for Updates {
    fn drop(&mut self) {
        if !self.is_foreign() {
            // Without the interpreter lock, which another user of the driver may need before it yields the driver.
            try_attach(|py| py.detach(|| self.core.end_updates(&self.feed, None)));
        }
    }
}
