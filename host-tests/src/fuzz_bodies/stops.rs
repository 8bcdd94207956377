//! Deadlines of stops: a requested FAST STOP until the gripper confirms it, a FAST STOP after an unanswered Stop, and
//! a Stop for a gripper that is already moving on the first connection.

use wsg_bridge_fw::io::Outputs;
use wsg_protocol::session::FastStopPattern;
use wsg_protocol::{CommandId, SystemFlags};

use super::reported::Reported;
use super::requested::Requested;

const PATTERN: FastStopPattern = FastStopPattern::DEFAULT;

/// Maximum time without an answer to Stop while the fingers may be moving, in milliseconds.
const STOP_MS: u32 = 100;

/// Progress of a FAST STOP.
#[derive(Clone, Copy)]
enum FastStop {
    /// Confirmed, or none requested.
    Answered,
    /// To be sent, since this time.
    Due(u32),
    /// Sent once, at this time.
    Once(u32),
    /// Number of frames of a burst sent so far, and the time of the last.
    Burst(u16, u32),
    /// Pause after a burst, since this time.
    Pause(u32),
    /// The last frames may be lost.
    Unknown,
}

/// Stops owed to the gripper.
pub(super) struct Stops {
    fast_stop: FastStop,
    /// Time since which a Stop is due, and of the last unanswered Stop.
    stop_due_ms: Option<u32>,
    stop_ms: Option<u32>,
    /// Whether an acknowledgement is unanswered; until then STOP/ACK causes no Stop.
    acknowledges: bool,
    /// Time since which the fingers move without a command.
    runaway_ms: Option<u32>,
    /// Time since which the gripper reports moving fingers.
    moves_since_ms: Option<u32>,
    /// Whether the fingers were reported at rest since the unanswered Stop.
    has_stood: bool,
    /// Whether the gripper was connected, or was stopped on the first connection.
    is_acquainted: bool,
    /// Whether a third party ended a FAST STOP of which the bridge may still await the report.
    may_be_stopped: bool,
}

impl Stops {
    pub(super) const fn new() -> Self {
        Self {
            fast_stop: FastStop::Answered,
            stop_due_ms: None,
            stop_ms: None,
            acknowledges: false,
            runaway_ms: None,
            moves_since_ms: None,
            has_stood: false,
            is_acquainted: false,
            may_be_stopped: false,
        }
    }

    /// Returns whether every FAST STOP is confirmed.
    pub(super) const fn is_answered(&self) -> bool {
        matches!(self.fast_stop, FastStop::Answered)
    }

    /// Requires another FAST STOP, because the gripper has left one that the PLC still asserts.
    pub(super) const fn owe_fast_stop(&mut self, now_ms: u32) {
        self.fast_stop = FastStop::Due(now_ms);
    }

    /// Records that the gripper has left a FAST STOP that the PLC no longer asserts.
    pub(super) const fn leave_fast_stop(&mut self) {
        self.may_be_stopped = true;
    }

    /// Processes the inputs of this turn, before any command is sent.
    pub(super) fn begin_turn(&mut self, now_ms: u32, reported: &Reported, requested: &Requested) {
        self.has_stood |= reported.stands();
        self.moves_since_ms = reported.moves().then(|| self.moves_since_ms.unwrap_or(now_ms));
        let was_sent = !matches!(self.fast_stop, FastStop::Answered | FastStop::Due(_));
        if was_sent && reported.is_answered(CommandId::FastStop) {
            self.fast_stop = FastStop::Answered;
        }
        if requested.asks_fast_stop && matches!(self.fast_stop, FastStop::Answered) {
            self.fast_stop = FastStop::Due(now_ms);
        }
        if reported.is_answered(CommandId::Stop) {
            self.stop_ms = None;
        }
        self.acknowledges &= !reported.is_answered(CommandId::Acknowledge);
        let is_stopped = requested.stopped_ms.is_some()
            || self.may_be_stopped
            || reported.flags.is_some_and(|flags| flags.contains(SystemFlags::FAST_STOP));
        let must_stop = requested.asks_stop || requested.ends_jog && !reported.stands();
        if must_stop && !is_stopped && !self.acknowledges && self.stop_ms.is_none() {
            self.stop_due_ms = Some(now_ms);
        }
        if !self.is_acquainted && reported.moves() && !is_stopped {
            self.is_acquainted = true;
            self.runaway_ms = Some(now_ms);
        }
    }

    /// Checks a command, which may be delayed by up to `max_delay_ms`, if known.
    pub(super) fn leaves(
        &mut self,
        now_ms: u32,
        id: CommandId,
        reported: &Reported,
        max_delay_ms: Option<u32>,
    ) {
        let is_query_of_state = matches!(id, CommandId::GetSystemState | CommandId::GetGripperState);
        let is_stop = matches!(id, CommandId::Stop | CommandId::FastStop);
        let knows_states = reported.flags.is_some() && reported.state.is_some();
        assert!(knows_states || is_query_of_state || is_stop, "{id} before the states are known");
        if is_stop {
            (self.runaway_ms, self.stop_due_ms) = (None, None);
        }
        self.acknowledges |= id == CommandId::Acknowledge;
        if id == CommandId::FastStop {
            self.stop_ms = None;
            return self.fast_stop = self.fast_stop.leaves(now_ms, max_delay_ms);
        }
        let is_alone = matches!(self.fast_stop, FastStop::Answered | FastStop::Unknown);
        assert!(is_alone, "{id} before the answer to a FAST STOP");
        if id == CommandId::Stop {
            // The repetition may have been queued before the fingers began to move.
            let is_late = self.moves_since_ms.is_some_and(|since_ms| {
                self.has_stood && max_delay_ms.is_none_or(|max_delay_ms| now_ms - since_ms <= max_delay_ms)
            });
            let is_first = self.stop_ms.is_none();
            assert!(is_first || is_late || reported.stands(), "a repeated Stop while the fingers move");
            self.has_stood &= !is_first;
            self.stop_ms = Some(now_ms);
        }
    }

    /// Checks the deadlines at the end of a turn.
    pub(super) fn end_turn(
        &mut self,
        now_ms: u32,
        outputs: Outputs,
        reported: &Reported,
        max_delay_ms: Option<u32>,
    ) {
        self.may_be_stopped &= !outputs.contains(Outputs::READY);
        if outputs.contains(Outputs::LINK_OK) {
            self.is_acquainted = true;
        } else {
            (self.stop_due_ms, self.acknowledges) = (None, false);
        }
        let Some(max_delay_ms) = max_delay_ms else {
            // The gripper is unreachable, so deadlines are deferred.
            for moment in
                [&mut self.stop_due_ms, &mut self.stop_ms, &mut self.runaway_ms].into_iter().flatten()
            {
                *moment = now_ms;
            }
            self.fast_stop = match self.fast_stop {
                FastStop::Due(_) => FastStop::Due(now_ms),
                FastStop::Answered => FastStop::Answered,
                _ => FastStop::Unknown,
            };
            return;
        };
        let latest_ms = match self.fast_stop {
            FastStop::Answered | FastStop::Unknown => now_ms,
            FastStop::Due(since_ms) => since_ms,
            FastStop::Once(left_ms) => left_ms + PATTERN.answer_ms,
            FastStop::Burst(_, left_ms) => left_ms,
            FastStop::Pause(since_ms) => since_ms + PATTERN.pause_ms,
        };
        assert!(now_ms <= latest_ms + max_delay_ms, "FAST STOP was not sent in time");
        assert!(
            self.stop_due_ms.is_none_or(|since_ms| now_ms <= since_ms + max_delay_ms),
            "Stop was not sent in time"
        );
        if let Some(since_ms) = self.runaway_ms {
            assert!(outputs.contains(Outputs::ERROR), "the fingers move without ERROR");
            assert!(now_ms <= since_ms + max_delay_ms, "no Stop for fingers that move at power-up");
        }
        if let Some(left_ms) = self.stop_ms
            && now_ms >= left_ms + STOP_MS
        {
            if reported.stands() {
                self.stop_ms = None;
            } else {
                assert!(now_ms <= left_ms + STOP_MS + max_delay_ms, "no FAST STOP after an unanswered Stop");
            }
        }
    }
}

impl FastStop {
    /// Advances after sending a frame.
    fn leaves(self, now_ms: u32, max_delay_ms: Option<u32>) -> Self {
        let silence_of = |left_ms: u32| now_ms - left_ms;
        let max_delay_ms = max_delay_ms.unwrap_or(u32::MAX);
        match self {
            Self::Answered | Self::Due(_) => Self::Once(now_ms),
            // After an unanswered Stop the burst comes first.
            Self::Once(left_ms) if silence_of(left_ms) <= max_delay_ms => Self::Burst(2, now_ms),
            Self::Once(left_ms) => {
                assert!(
                    silence_of(left_ms) >= PATTERN.answer_ms,
                    "FAST STOP repeated before its answer can arrive"
                );
                Self::Burst(1, now_ms)
            }
            Self::Burst(count, _) if count + 1 == PATTERN.burst_frames => Self::Pause(now_ms),
            Self::Burst(count, _) => Self::Burst(count + 1, now_ms),
            Self::Pause(since_ms) => {
                assert!(
                    silence_of(since_ms) >= PATTERN.pause_ms,
                    "FAST STOP sent during the pause after a burst"
                );
                Self::Burst(1, now_ms)
            }
            Self::Unknown => Self::Unknown,
        }
    }
}
