//! Deadlines of stops: a requested FAST STOP until the gripper confirms it, a FAST STOP after an unanswered Stop, and
//! a Stop for a gripper that is already moving on the first connection.

use std::hash::{Hash, Hasher};

use wsg_bridge_fw::io::Outputs;
use wsg_protocol::session::FastStopPattern;
use wsg_protocol::{CommandId, Instant, SystemFlags};

use super::reports::Reports;
use super::requests::Requests;
use super::{Kept, Promise, Turn, keep};

const PATTERN: FastStopPattern = FastStopPattern::DEFAULT;

/// Maximum time without an answer to Stop while the fingers may be moving, in milliseconds.
const STOP_MS: u32 = 100;

/// Progress of a FAST STOP.
#[derive(Clone, Copy, Debug, Hash)]
enum FastStop {
    /// Confirmed, or none requested.
    Answered,
    /// To be sent, since this time.
    Due(Instant),
    /// Sent once, at this time.
    Once(Instant),
    /// Number of frames of a burst sent so far, and the time of the last.
    Burst(u16, Instant),
    /// Pause after a burst, since this time.
    Pause(Instant),
    /// The last frames may be lost.
    Unknown,
}

/// Stops owed to the gripper.
#[derive(Clone, Debug)]
pub(super) struct Stops {
    fast_stop: FastStop,
    /// Time since which a Stop is due, and of the last unanswered Stop.
    stop_due: Option<Instant>,
    stop: Option<Instant>,
    /// Whether an acknowledgement is unanswered; until then STOP/ACK causes no Stop.
    acknowledges: bool,
    /// Time since which the fingers move without a command.
    runaway: Option<Instant>,
    /// Time since which the gripper reports moving fingers.
    moves_since: Option<Instant>,
    /// Whether the fingers were reported at rest since the unanswered Stop.
    has_stood: bool,
    /// Whether the gripper was connected, or was stopped on the first connection.
    is_acquainted: bool,
    /// Whether a third party ended a FAST STOP of which the bridge may still await the report.
    may_be_stopped: bool,
}

impl Hash for Stops {
    /// Ignores what only concerns an unanswered Stop without one.
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { fast_stop, stop_due, stop, acknowledges, runaway, is_acquainted, may_be_stopped, .. } =
            self;
        (fast_stop, stop_due, stop, acknowledges, runaway, is_acquainted, may_be_stopped).hash(state);
        stop.map(|_| (self.moves_since, self.has_stood)).hash(state);
    }
}

impl Stops {
    pub(super) const fn new() -> Self {
        Self {
            fast_stop: FastStop::Answered,
            stop_due: None,
            stop: None,
            acknowledges: false,
            runaway: None,
            moves_since: None,
            has_stood: false,
            is_acquainted: false,
            may_be_stopped: false,
        }
    }

    /// Returns whether every FAST STOP is confirmed.
    pub(super) const fn is_answered(&self) -> bool {
        matches!(self.fast_stop, FastStop::Answered)
    }

    /// Returns whether a FAST STOP that was requested has not been sent.
    pub(super) const fn owes_fast_stop(&self) -> bool {
        matches!(self.fast_stop, FastStop::Due(_))
    }

    /// Requires another FAST STOP, because the gripper has left one that the PLC still asserts.
    pub(super) const fn owe_fast_stop(&mut self, now: Instant) {
        self.fast_stop = FastStop::Due(now);
    }

    /// Records that the gripper has left a FAST STOP that the PLC no longer asserts.
    pub(super) const fn leave_fast_stop(&mut self) {
        self.may_be_stopped = true;
    }

    /// Processes the inputs of this turn, before any command is sent.
    pub(super) fn begin_turn(&mut self, now: Instant, reports: &Reports, requests: &Requests) {
        self.has_stood |= reports.stands();
        self.moves_since = reports.moves().then(|| self.moves_since.unwrap_or(now));
        let was_sent = !matches!(self.fast_stop, FastStop::Answered | FastStop::Due(_));
        if was_sent && reports.is_answered(CommandId::FastStop) {
            self.fast_stop = FastStop::Answered;
        }
        if requests.asks_fast_stop && self.is_answered() {
            self.fast_stop = FastStop::Due(now);
        }
        if reports.is_answered(CommandId::Stop) {
            self.stop = None;
        }
        self.acknowledges &= !reports.is_answered(CommandId::Acknowledge);
        let is_stopped = requests.stopped.is_some()
            || self.may_be_stopped
            || reports.flags.is_some_and(|flags| flags.contains(SystemFlags::FAST_STOP));
        let must_stop = requests.asks_stop
            || requests.ends_jog && !reports.stands()
            || requests.bus_is_silent
                && reports.flags.is_some_and(|flags| flags.contains(SystemFlags::MOVING));
        if must_stop && !is_stopped && !self.acknowledges && self.stop.is_none() {
            self.stop_due = Some(now);
        }
        if !self.is_acquainted && reports.moves() && !is_stopped {
            self.is_acquainted = true;
            self.runaway = Some(now);
        }
    }

    /// Checks a command, which may be sent later than it was requested.
    pub(super) fn send(&mut self, id: CommandId, reports: &Reports, turn: &Turn) -> Kept {
        let is_query_of_state = matches!(id, CommandId::GetSystemState | CommandId::GetGripperState);
        let is_stop = matches!(id, CommandId::Stop | CommandId::FastStop);
        let knows_states = reports.flags.is_some() && reports.state.is_some();
        keep(Promise::StatesAreKnownFirst, knows_states || is_query_of_state || is_stop)?;
        if is_stop {
            (self.runaway, self.stop_due) = (None, None);
        }
        self.acknowledges |= id == CommandId::Acknowledge;
        if id == CommandId::FastStop {
            self.stop = None;
            self.fast_stop = self.fast_stop.after_frame(turn)?;
            return Ok(());
        }
        let is_alone = matches!(self.fast_stop, FastStop::Answered | FastStop::Unknown);
        keep(Promise::OnlyFastStopUntilAnswered, is_alone)?;
        if id == CommandId::Stop {
            // The repetition may have been queued before the fingers began to move.
            let is_late = self.moves_since.is_some_and(|since| {
                let is_recent = |most_ms| turn.now.since(since) <= most_ms;
                self.has_stood && turn.lateness_ms().is_none_or(is_recent)
            });
            let is_first = self.stop.is_none();
            keep(Promise::StopIsNotRepeated, is_first || is_late || reports.stands())?;
            self.has_stood &= !is_first;
            self.stop = Some(turn.now);
        }
        Ok(())
    }

    /// Checks the deadlines at the end of a turn.
    pub(super) fn end_turn(&mut self, turn: &Turn, outputs: Outputs, reports: &Reports) -> Kept {
        let now = turn.now;
        self.may_be_stopped &= !outputs.contains(Outputs::READY);
        if outputs.contains(Outputs::LINK_OK) {
            self.is_acquainted = true;
        } else {
            (self.stop_due, self.acknowledges) = (None, false);
        }
        let Some(lateness_ms) = turn.lateness_ms() else {
            // The gripper is unreachable, so deadlines are deferred.
            for moment in [&mut self.stop_due, &mut self.stop, &mut self.runaway].into_iter().flatten() {
                *moment = now;
            }
            self.fast_stop = match self.fast_stop {
                FastStop::Due(_) => FastStop::Due(now),
                FastStop::Answered => FastStop::Answered,
                _ => FastStop::Unknown,
            };
            return Ok(());
        };
        let is_in_time = |due: Instant| now.since(due) <= lateness_ms;
        let is_sent = self.fast_stop.due().is_none_or(is_in_time);
        keep(Promise::FastStopLeavesAtOnce, is_sent)?;
        keep(Promise::StopLeavesAtOnce, self.stop_due.is_none_or(is_in_time))?;
        if let Some(since) = self.runaway {
            keep(Promise::MotionAtPowerUpShowsError, outputs.contains(Outputs::ERROR))?;
            keep(Promise::MotionAtPowerUpIsStopped, is_in_time(since))?;
        }
        if self.stop.is_some_and(|sent| now.has_reached(sent.plus(STOP_MS)) && reports.stands()) {
            self.stop = None;
        }
        let is_followed = self.stop.is_none_or(|sent| is_in_time(sent.plus(STOP_MS)));
        keep(Promise::UnansweredStopBecomesFastStop, is_followed)
    }
}

impl FastStop {
    /// Returns when the next frame is due.
    fn due(self) -> Option<Instant> {
        match self {
            Self::Answered | Self::Unknown => None,
            Self::Due(since) => Some(since),
            Self::Once(sent) => Some(sent.plus(PATTERN.answer_ms)),
            Self::Burst(_, sent) => Some(sent),
            Self::Pause(since) => Some(since.plus(PATTERN.pause_ms)),
        }
    }

    /// Advances after sending a frame.
    fn after_frame(self, turn: &Turn) -> Result<Self, Promise> {
        let now = turn.now;
        let is_next = |sent: Instant| now.since(sent) <= turn.max_delay_ms.unwrap_or(u32::MAX);
        Ok(match self {
            Self::Answered | Self::Due(_) => Self::Once(now),
            // After an unanswered Stop the burst comes first.
            Self::Once(sent) if is_next(sent) => Self::Burst(2, now),
            Self::Burst(count, _) if count + 1 == PATTERN.burst_frames => Self::Pause(now),
            Self::Burst(count, _) => Self::Burst(count + 1, now),
            Self::Once(_) | Self::Pause(_) => {
                let is_due = self.due().is_some_and(|due| now.has_reached(due));
                keep(Promise::FastStopKeepsItsPattern, is_due)?;
                Self::Burst(1, now)
            }
            Self::Unknown => Self::Unknown,
        })
    }
}
