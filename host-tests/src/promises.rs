//! The promises of the bridge, judged from outside: wires and bus on one side, the gripper's line on the other.
//!
//! [`Promises`] sees the inputs and outputs of every turn, and names the first [`Promise`] that is broken. The exploration
//! and the whole-bridge fuzz bodies share it, so a rule is written once.
//!
//! | module | content |
//! |---|---|
//! | `requests` | requests of the PLC |
//! | `reports` | reports of the gripper |
//! | `stops` | deadlines of stops |
//! | `outputs` | levels of the wires to the PLC |
//! | `gstate` | the rule of GSTATE |
//! | `reach` | whether a FAST STOP has reached the gripper |

mod gstate;
mod outputs;
mod reach;
mod reports;
mod requests;
mod stops;

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Bridge, Config};
use wsg_protocol::{Command, CommandId, Instant, Kind, SystemFlags};

use outputs::Levels;
pub(crate) use reach::Reach;
use reports::Reports;
pub(crate) use requests::MOTIONS;
use requests::Requests;
use stops::Stops;

/// A promise of docs/wiring.md (W) or docs/registers.md (R), with its section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Promise {
    /// A motion is sent only for its own edge (W, Inputs; R, Who commands).
    MotionHasItsEdge,
    /// A motion is sent only once per edge (W, Inputs).
    MotionLeavesOnce,
    /// A motion has the parameters of its edge, from the recipe or from the image (W, Recipes; R, Who commands).
    MotionHasItsParameters,
    /// An edge while READY is low starts nothing (W, Inputs).
    EdgeWhileNotReadyStartsNothing,
    /// STOP/ACK withdraws all motions requested before it (W, Inputs).
    StopAckWithdraws,
    /// FAST STOP withdraws all motions requested before it (W, Inputs).
    FastStopWithdraws,
    /// A silent bus withdraws the motion that it requested (R, Silent master).
    SilenceWithdraws,
    /// A lost connection withdraws all motions requested before it (W, Faults).
    ReconnectWithdraws,
    /// A reset of the bridge withdraws all motions requested before it (W, Faults).
    ResetWithdraws,
    /// No motion is sent from FAST STOP until its acknowledgement (W, Inputs).
    NoMotionInFastStop,
    /// No setting is sent from FAST STOP until its acknowledgement (W, Inputs).
    NoSettingInFastStop,
    /// While the stored settings are rejected, no motion is sent (R, Settings that take effect at a restart).
    RefusedSettingsMoveNothing,
    /// Of the settings of a gripper, the bridge changes only the force limit (W, Recipes).
    OnlyForceLimitIsSet,
    /// A force limit is sent only for a GRIP or a jog that may still be sent (W, Recipes).
    ForceLimitHasItsMotion,
    /// GRIP and a jog are sent only while the gripper has the force limit of their edge (W, Recipes).
    GripHasItsForce,
    /// An acknowledgement is sent only for an edge of STOP/ACK (W, Power-up).
    AcknowledgementHasItsEdge,
    /// Before the gripper's states are known, only queries of them and stops are sent (W, Power-up).
    StatesAreKnownFirst,
    /// Only FAST STOP is sent until the gripper has confirmed it (W, Faults).
    OnlyFastStopUntilAnswered,
    /// A Stop is not repeated while the fingers move; a FAST STOP follows instead (W, Faults).
    StopIsNotRepeated,
    /// A FAST STOP is repeated only after the time of its answer, and after the pause that follows a burst.
    FastStopKeepsItsPattern,
    /// FAST STOP is sent at once, and repeated according to its pattern (W, Faults).
    FastStopLeavesAtOnce,
    /// FAST STOP reaches a gripper that receives, also one that leaves it while the PLC asserts it (W, Inputs).
    FastStopReachesTheGripper,
    /// Stop is sent at once after STOP/ACK, the end of a jog, and the silence of the bus that commands a motion (W, Inputs;
    /// R, Silent master).
    StopLeavesAtOnce,
    /// A FAST STOP follows an unanswered Stop while the fingers may move (W, Faults).
    UnansweredStopBecomesFastStop,
    /// A gripper that moves at power-up is stopped as soon as the motion is detected (W, Faults).
    MotionAtPowerUpIsStopped,
    /// A gripper that moves at power-up raises ERROR (W, Faults).
    MotionAtPowerUpShowsError,
    /// Without LINK_OK only ERROR can be high (W, Outputs).
    OnlyErrorWithoutLink,
    /// LINK_OK is high only while the gripper's states are known (W, Outputs).
    LinkOkKnowsTheStates,
    /// LINK_OK goes low within a second of the last intact frame (W, Faults).
    LinkOkGoesLow,
    /// ERROR is high in FAST STOP, during a fault, and after a refused edge of a wire (W, Outputs).
    FaultShowsError,
    /// READY is high exactly while a command would be accepted, and low beside BUSY (W, Outputs).
    ReadyIsTrue,
    /// BUSY is high while the fingers move (W, Outputs).
    BusyIsTrue,
    /// BUSY is high for its minimum time, unless ERROR is high (W, Outputs).
    BusyLasts,
    /// An edge while READY is high sets BUSY for its minimum time, whether accepted or refused (W, Inputs).
    ReadyEdgeShowsBusy,
    /// HOLDING is high only after a successful grip, and PART_FAULT low then (W, Outputs).
    HoldingIsTrue,
    /// PART_FAULT is high only after a grip without a part, or after its loss (W, Outputs).
    PartFaultIsTrue,
    /// REFERENCED is the gripper's report (W, Outputs).
    ReferencedIsTrue,
    /// GSTATE is the state reported last, whoever caused it, except ERROR after a failed motion of the PLC (R, Input
    /// registers).
    GstateFollowsTheGripper,
    /// A command that rises while READY is high is accepted (W, Exits from each state).
    ReadyCommandIsTaken,
    /// A command that is refused raises ERROR (W, Inputs).
    RefusedCommandShowsError,
    /// Requests and replies end within a second when the line delivers everything.
    ConversationEnds,
}

pub(crate) type Kept = Result<(), Promise>;

/// Returns an error unless the promise is kept.
pub(crate) const fn keep(promise: Promise, is_kept: bool) -> Kept {
    if is_kept { Ok(()) } else { Err(promise) }
}

/// All requests, reports and stops so far.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Promises {
    pub(crate) requests: Requests,
    pub(crate) reports: Reports,
    pub(crate) levels: Levels,
    stops: Stops,
    /// Whether the gripper has confirmed a FAST STOP that is not acknowledged.
    is_latched: bool,
    turn: Turn,
}

/// Times of a turn. They have no effect on later ones, so all are equal in a key.
#[derive(Clone, Copy, Debug)]
struct Turn {
    now: Instant,
    /// Time since the previous turn, in milliseconds.
    since_previous_ms: u32,
    /// Maximum wait of a frame for the previous one, in milliseconds; `None` while the gripper is unreachable.
    max_delay_ms: Option<u32>,
}

impl std::hash::Hash for Turn {
    fn hash<H: std::hash::Hasher>(&self, _: &mut H) {}
}

impl Turn {
    /// Returns how much later than its deadline a frame may be sent: a turn, or the wait for the previous frame.
    fn lateness_ms(&self) -> Option<u32> {
        self.max_delay_ms.map(|max_delay_ms| max_delay_ms.max(self.since_previous_ms))
    }
}

impl Promises {
    /// Creates the state at power-up of a bridge with these settings.
    pub(crate) fn new(now: Instant, config: &Config) -> Self {
        Self {
            requests: Requests::new(now, config.wires.debounce_ms),
            reports: Reports::new(now, config.half_frame_ms),
            levels: Levels::new(config.wires.min_busy_ms),
            stops: Stops::new(),
            is_latched: false,
            turn: Turn { now, since_previous_ms: 0, max_delay_ms: None },
        }
    }

    /// Returns whether a FAST STOP that was requested has not been sent.
    pub(crate) const fn owes_fast_stop(&self) -> bool {
        self.stops.owes_fast_stop()
    }

    /// Starts a turn with the gripper's messages, which `report` passes on, and with the levels of the wires. Images of the
    /// bus follow.
    pub(crate) fn begin_turn(&mut self, now: Instant, wires: Inputs, report: impl FnOnce(&mut Reports)) {
        self.turn = Turn { now, since_previous_ms: now.since(self.turn.now), max_delay_ms: None };
        self.reports.begin_turn(now);
        report(&mut self.reports);
        // A third party's acknowledgement or a restart (fieldbus, 6.6), also before the connection is established.
        let may_be_latched = self.stops.is_answered() || self.reports.is_answered(CommandId::FastStop);
        if self.reports.has_left_fast_stop && may_be_latched {
            if !self.requests.holds_fast_stop() {
                self.requests.stopped = None;
                self.stops.leave_fast_stop();
            } else if self.is_latched {
                self.stops.owe_fast_stop(now);
            }
        }
        if self.reports.is_answered(CommandId::PrePosition) {
            self.requests.jogs = false;
        }
        self.requests.read_wires(now, wires);
    }

    /// Ends the inputs of this turn; commands follow. `max_delay_ms` is the maximum wait of a frame for the previous one;
    /// `None` while the gripper is unreachable.
    pub(crate) fn end_inputs(&mut self, max_delay_ms: Option<u32>) {
        self.turn.max_delay_ms = max_delay_ms;
        self.stops.begin_turn(self.turn.now, &self.reports, &self.requests);
    }

    /// Checks a command to the gripper. `command` is `None` while only its id is known; `force_limit` is the gripper's, in
    /// hundredths of a newton, if the bridge can know it.
    pub(crate) fn send(
        &mut self,
        id: CommandId,
        command: Option<&Command<'_>>,
        force_limit: Option<i32>,
    ) -> Kept {
        self.stops.send(id, &self.reports, &self.turn)?;
        self.requests.send(id, command, force_limit)?;
        if id.kind() == Kind::Motion {
            self.reports.grip = None;
        }
        Ok(())
    }

    /// Ends the turn of this bridge with these outputs.
    pub(crate) fn end_turn(&mut self, bridge: &Bridge, outputs: Outputs, reach: &Reach) -> Kept {
        let Self { requests, reports, levels, stops, turn, .. } = self;
        let motion_is_open = bridge.motion_is_open();
        let keeps_gstate = reports.gstate.is_kept(&bridge.input_image(), motion_is_open);
        keep(Promise::GstateFollowsTheGripper, keeps_gstate || reach.is_forged)?;
        let is_connected = outputs.contains(Outputs::LINK_OK);
        if !is_connected {
            requests.lose_gripper();
        }
        if levels.outputs.contains(Outputs::LINK_OK) && !is_connected {
            reports.forget();
        }
        levels.show(turn.now, outputs, reports, requests, motion_is_open)?;
        requests.show_ready(outputs.contains(Outputs::READY));
        stops.end_turn(turn, outputs, reports)?;
        if let Some(since) = requests.stopped {
            let has_stopped = reach.has_stopped(turn.now, since, levels.unlinked, requests.holds_fast_stop());
            keep(Promise::FastStopReachesTheGripper, has_stopped)?;
        }
        let is_reported = reports.flags.is_some_and(|flags| flags.contains(SystemFlags::FAST_STOP));
        let is_answered = stops.is_answered() && requests.stopped.is_some();
        self.is_latched = is_connected && is_answered && is_reported;
        Ok(())
    }
}
