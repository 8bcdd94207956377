//! A subscription to width, speed and force (command set, 3.4): its updates, its newest reading, and its end.

use std::mem;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use wsg_protocol::driver::blocking::GripperOver;
use wsg_protocol::driver::{Error, Protocol, UPDATES_LEN, Update};
use wsg_protocol::session::Topic;
use wsg_protocol::{AutoUpdate, SystemFlags};

use crate::error::Failure;
use crate::interpreter::unix_now;
use crate::line::{Clock, Line};
use crate::number::shortest;

type Gripper<P> = GripperOver<Line, Clock, P>;

/// The values of a reading, in its order.
const TOPICS: [Topic; 3] = [Topic::Width, Topic::Speed, Topic::Force];
/// Longest wait for an update before the thread checks for the end of the subscription, in ms.
const WAIT_MS: u32 = 50;
/// Maximum number of updates before other requests pass.
const MAX_UPDATES: usize = 4 * UPDATES_LEN;
/// Longest time without a reading in addition to the interval. The driver also polls each value twice a second.
const SILENCE: Duration = Duration::from_secs(1);

/// Received time as a value of `time.time()`, width in mm, speed in mm/s, force in N, gripper state, system flags.
pub(crate) type Row = (f64, Option<f64>, Option<f64>, Option<f64>, u8, u32);

/// A subscription, shared by its thread and its reader.
pub(crate) struct Feed {
    state: Mutex<State>,
    changed: Condvar,
    wanted: [bool; 3],
    period_ms: u16,
    /// Whether the reader receives the updates itself, as in virtual time.
    pub(crate) is_pulled: bool,
}

struct State {
    /// The newest reading, until the reader takes it.
    newest: Option<Row>,
    /// Which values are new since the last reading.
    fresh: [bool; 3],
    has_begun: bool,
    /// Whether the fingers were referenced at the last update of the flags; unknown before the first one.
    is_referenced: Option<bool>,
    /// Time without a reading.
    silent: Duration,
    stage: Stage,
    failure: Option<Arc<Failure>>,
}

/// How far a subscription is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stage {
    Running,
    /// Its reader has closed it, or its connection is being closed.
    Closing,
    /// No updates are received any more.
    Over,
}

impl Feed {
    pub(crate) const fn new(wanted: [bool; 3], period_ms: u16, is_pulled: bool) -> Self {
        let state = State {
            newest: None,
            fresh: [false; 3],
            has_begun: false,
            is_referenced: None,
            silent: Duration::ZERO,
            stage: Stage::Running,
            failure: None,
        };
        Self { state: Mutex::new(state), changed: Condvar::new(), wanted, period_ms, is_pulled }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn subscribe<P: Protocol>(&self, gripper: &mut Gripper<P>, update: AutoUpdate) {
        let topics = TOPICS.into_iter().zip(self.wanted).filter(|(_, is_wanted)| *is_wanted);
        topics.for_each(|(topic, _)| gripper.subscribe(topic, update));
    }

    /// Receives updates for a moment. Subscribes first if necessary.
    pub(crate) fn receive<P: Protocol>(&self, gripper: &mut Gripper<P>) -> Result<(), Failure> {
        let has_begun = mem::replace(&mut self.lock().has_begun, true);
        if !has_begun {
            // Updates of an earlier subscription are old.
            for _ in 0..UPDATES_LEN {
                next_update(gripper, 0)?;
            }
            self.subscribe(gripper, AutoUpdate::every(self.period_ms));
            // Flags that do not show referenced fingers may be from before the homing.
            self.lock().is_referenced =
                gripper.known().flags.filter(|flags| is_referenced(*flags)).map(|_| true);
        }
        let begun_at = Instant::now();
        let (mut fresh, mut was_referenced) = {
            let state = self.lock();
            (state.fresh, state.is_referenced)
        };
        let mut received = 0;
        while received < MAX_UPDATES {
            match next_update(gripper, if received == 0 { WAIT_MS } else { 0 })? {
                // There is no width before homing.
                Some(Update::Width(_)) => fresh[0] = was_referenced == Some(true),
                Some(Update::Speed(_)) => fresh[1] = true,
                Some(Update::Force(_)) => fresh[2] = true,
                Some(Update::SystemState(flags)) => {
                    was_referenced = Some(is_referenced(flags));
                    fresh[0] &= is_referenced(flags);
                }
                Some(_) => {}
                None => break,
            }
            received += 1;
        }
        let known = *gripper.known();
        let (true, Some(flags), Some(state)) = (gripper.is_connected(), known.flags, known.state) else {
            return Err(Error::NotConnected);
        };
        let [width, speed, force] = self.wanted;
        let required = [width && was_referenced == Some(true), speed, force];
        let ages = TOPICS.into_iter().zip(required).filter(|(_, is_required)| *is_required);
        let age_ms = ages.filter_map(|(topic, _)| gripper.age_ms(topic)).max().unwrap_or(0);
        let mut shared = self.lock();
        (shared.fresh, shared.is_referenced) = (fresh, was_referenced);
        // A pause of this program is no silence of the gripper.
        shared.silent += begun_at.elapsed().min(Duration::from_millis(WAIT_MS.into()));
        let are_fresh = required.iter().zip(fresh).all(|(is_required, is_fresh)| is_fresh || !is_required);
        // The driver polls the flags twice a second.
        if are_fresh && (!width || was_referenced == Some(is_referenced(flags))) {
            let values = [known.width, known.speed, known.force];
            let value = |place: usize| values[place].filter(|_| required[place]).map(shortest);
            let received = unix_now() - f64::from(age_ms) / 1e3;
            shared.newest = Some((received, value(0), value(1), value(2), state.code(), flags.bits()));
            (shared.fresh, shared.silent) = ([false; 3], Duration::ZERO);
        }
        let is_silent = shared.silent > SILENCE + Duration::from_millis(self.period_ms.into());
        drop(shared);
        self.changed.notify_all();
        if is_silent { Err(Error::Unanswered) } else { Ok(()) }
    }

    /// Makes the gripper send no more updates. Failures have no effect, because the connection is then lost.
    pub(crate) fn unsubscribe<P: Protocol>(&self, gripper: &mut Gripper<P>) -> Result<(), Failure> {
        self.subscribe(gripper, AutoUpdate::once());
        // The queries send the change at once.
        gripper.width()?;
        gripper.speed()?;
        gripper.force().map(drop)
    }

    /// Returns the stage, and takes the newest reading; with the failure that has ended the subscription.
    pub(crate) fn take(&self) -> (Stage, Option<Row>, Option<Arc<Failure>>) {
        let mut state = self.lock();
        (state.stage, mem::take(&mut state.newest), state.failure.clone())
    }

    pub(crate) fn is_running(&self) -> bool {
        self.lock().stage == Stage::Running
    }

    pub(crate) fn is_over(&self) -> bool {
        self.lock().stage == Stage::Over
    }

    /// Ends the subscription at its reader, or with a failure.
    pub(crate) fn end(&self, failure: Option<Failure>) {
        let mut state = self.lock();
        if state.stage == Stage::Running {
            (state.stage, state.failure) = (Stage::Closing, failure.map(Arc::new));
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Records that no more updates are received.
    pub(crate) fn set_over(&self) {
        self.lock().stage = Stage::Over;
        self.changed.notify_all();
    }

    /// Waits until no more updates are received.
    pub(crate) fn wait_for_end(&self) {
        let waited = self.changed.wait_while(self.lock(), |state| state.stage != Stage::Over);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }

    /// Waits until there is a reading or the end, for at most this time.
    pub(crate) fn wait(&self, within: Duration) {
        let is_idle = |state: &mut State| state.newest.is_none() && state.stage == Stage::Running;
        let waited = self.changed.wait_timeout_while(self.lock(), within, is_idle);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

const fn is_referenced(flags: SystemFlags) -> bool {
    flags.contains(SystemFlags::REFERENCED)
}

/// Returns the next update. A stop of this program ends motions, not the updates.
fn next_update<P: Protocol>(gripper: &mut Gripper<P>, within_ms: u32) -> Result<Option<Update>, Failure> {
    match gripper.next_update(within_ms) {
        Err(Error::Stopped(_)) => Ok(None),
        update => update,
    }
}
