//! Promises of docs/wiring.md, docs/registers.md and the README, checked from outside the bridge: wires and bus on
//! one side, transmitted commands and gripper state on the other.
//!
//! Edges request motions. This module independently tracks which motions may still be sent. It detects a motion that
//! is sent without an edge, twice, or after its withdrawal.

use std::hash::{Hash, Hasher};

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_fieldbus::InputImage;
use wsg_protocol::{Command, CommandId, Instant, Kind, Status, SystemFlags};

use crate::gripper_states::{Answer, STROKE, States};
use crate::gstate_rule::GstateRule;

/// A verifiable promise of the bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Promise {
    /// A motion is sent only for its own edge.
    MotionHasItsEdge,
    /// A motion is sent only once per edge.
    MotionLeavesOnce,
    /// An edge while READY is low starts nothing.
    EdgeWhileNotReadyStartsNothing,
    /// STOP/ACK withdraws all motions requested before it.
    StopAckWithdraws,
    /// FAST STOP withdraws all motions requested before it.
    FastStopWithdraws,
    /// A silent bus withdraws the motion that it requested.
    SilenceWithdraws,
    /// A lost connection withdraws all motions requested before it.
    ReconnectWithdraws,
    /// A reset of the bridge withdraws all motions requested before it.
    ResetWithdraws,
    /// No motion is sent from FAST STOP until its acknowledgement is confirmed.
    NoMotionInFastStop,
    /// No setting is sent from FAST STOP until its acknowledgement is confirmed.
    NoSettingInFastStop,
    /// Only FAST STOP is sent until the gripper has executed it.
    OnlyFastStopUntilTaken,
    /// A force limit is sent only for a GRIP or a jog that may still be sent.
    ForceLimitHasItsMotion,
    /// GRIP is sent only while the gripper has the force limit of that edge.
    GripHasItsForce,
    /// An acknowledgement is sent only for an edge of STOP/ACK.
    AcknowledgementHasItsEdge,
    /// An acknowledgement is sent only after the gripper has executed the FAST STOP.
    AcknowledgementFollowsFastStop,
    /// FAST STOP is sent in the turn in which it is requested, or in the next one a millisecond later.
    FastStopLeavesAtOnce,
    /// FAST STOP is repeated within a second until the gripper has executed it.
    FastStopIsRepeated,
    /// A gripper that leaves FAST STOP while the PLC asserts it receives another one within a second.
    FastStopIsALevel,
    /// A motion that continues 250 ms after STOP/ACK, the end of a jog or a silent bus receives a FAST STOP.
    UnheardStopBecomesFastStop,
    /// A gripper that moves at power-up is stopped as soon as the motion is detected.
    MotionAtPowerUpIsStopped,
    /// A gripper that moves at power-up raises ERROR.
    MotionAtPowerUpShowsError,
    /// READY and BUSY are never both high.
    NotReadyAndBusy,
    /// HOLDING and PART_FAULT are never both high.
    NotHoldingAndPartFault,
    /// Without LINK_OK only ERROR can be high.
    OnlyErrorWithoutLink,
    /// ERROR is high from FAST STOP until its acknowledgement is confirmed.
    FastStopShowsError,
    /// READY is low from FAST STOP until its acknowledgement is confirmed.
    NotReadyInFastStop,
    /// READY is low while STOP_ACK is high or FAST_STOP_OK is low.
    NotReadyWhileStopped,
    /// With LINK_OK, the outputs match the last reported state: moving, referenced and FAST STOP.
    OutputsShowTheReport,
    /// GSTATE is the state reported last, whoever caused it, except ERROR after a failed motion of the PLC.
    GstateFollowsTheGripper,
    /// LINK_OK goes low within a second of the last intact frame.
    LinkOkGoesLow,
    /// A command that rises while READY is high is accepted.
    ReadyCommandIsTaken,
    /// A command that rises while READY is high sets BUSY for 50 ms, whether accepted or rejected.
    ReadyEdgeShowsBusy,
    /// A command that rises while READY is low raises ERROR.
    RefusedCommandShowsError,
    /// Requests and replies end within a second when the line delivers everything.
    ConversationEnds,
}

/// A motion that can be requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Motion {
    Move,
    /// With 40 N.
    Grip,
    /// With 10 N.
    GripGently,
    Release,
    Home,
    Jog,
}

impl Motion {
    const fn bit(self) -> u8 {
        1 << self as u8
    }

    /// Returns the force limit in hundredths of a newton.
    const fn force(self) -> u32 {
        if matches!(self, Self::GripGently) { 10_00 } else { 40_00 }
    }

    /// Returns the motions that may have caused this command. Only a jog moves to the end of the stroke.
    const fn of(command: &Command<'_>) -> &'static [Self] {
        match *command {
            Command::PrePosition { width: STROKE, .. } => &[Self::Jog],
            Command::PrePosition { .. } => &[Self::Move],
            Command::GripPart { .. } => &[Self::Grip, Self::GripGently],
            Command::ReleasePart { .. } => &[Self::Release],
            Command::Homing { .. } => &[Self::Home],
            _ => &[],
        }
    }
}

/// State of the lock on motions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Lock {
    /// Motions are permitted.
    Open,
    /// Locked by FAST STOP. `untaken`: time of the request or last frame, until the gripper executes it.
    FastStop { untaken: Option<Instant> },
    /// Locked by FAST STOP, with an unconfirmed acknowledgement.
    Acknowledged,
}

/// Whether the bridge may encounter a motion that it has not started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum PowerUp {
    /// The bridge has not been connected.
    New { stop_left: bool },
    /// The bridge has been connected, or has encountered such a motion.
    Over,
}

/// Requests and obligations so far.
#[derive(Clone, Debug)]
pub(super) struct Promises {
    /// Motions of which one may be sent, as [`Motion::bit`]s.
    wanted: u8,
    /// Edges of STOP/ACK for which an acknowledgement may be sent.
    acknowledgements: u8,
    lock: Lock,
    power_up: PowerUp,
    /// Whether the last motion sent was a jog.
    jogs: bool,
    /// Time at which a motion that is still running should have been stopped.
    stop_given: Option<Instant>,
    /// Time at which the gripper left FAST STOP without the bridge's acknowledgement: by a third party or a restart.
    /// With [`Lock::Open`], the bridge learnt of it during its handshake and may repeat the FAST STOP.
    left_elsewhere: Option<Instant>,
    /// Whether the bridge received that report while the PLC asserted FAST STOP.
    left_is_known: bool,
    /// Whether the PLC asserts FAST STOP.
    holds_fast_stop: bool,
    /// LINK_OK at the end of the last turn. Excluded from the key, which contains the outputs.
    is_connected: bool,
    /// Time of the last command edge while READY was high.
    edge: Option<Instant>,
    /// Whether FAST STOP was sent in this turn.
    fast_stop_left: bool,
    /// Whether the last report in this turn was of a moving gripper.
    found_moving: bool,
    /// The promise broken by a motion without an edge. Excluded from the key, because it only names the failure.
    withdrawn_by: Promise,
    /// Arrival of the last intact frame. Excluded from the key, or few states would be equal.
    received: Instant,
    gstate: GstateRule,
    /// Last reported flags. Excluded from the key, because the bridge also stores them.
    reported: SystemFlags,
}

impl Hash for Promises {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { wanted, acknowledgements, lock, power_up, jogs, stop_given, .. } = self;
        (wanted, acknowledgements, lock, power_up, jogs, stop_given).hash(state);
        (self.left_elsewhere, self.left_is_known, self.edge, &self.gstate).hash(state);
    }
}

pub(super) type Kept = Result<(), Promise>;

/// Returns an error unless the promise is kept.
pub(super) fn keep(promise: Promise, is_kept: bool) -> Kept {
    if is_kept { Ok(()) } else { Err(promise) }
}

/// Longest time that a motion may continue after its stop, in milliseconds.
const STOP_MS: u32 = 250;
/// Longest time between two FAST STOPs, and from the last frame to LINK_OK low, in milliseconds.
const SECOND_MS: u32 = 1_000;
/// Duration of BUSY after a command at READY, in milliseconds.
const BUSY_MS: u32 = 50;

impl Promises {
    /// Creates the state of a bridge after power-up.
    pub(super) const fn new(now: Instant) -> Self {
        Self {
            wanted: 0,
            acknowledgements: 0,
            lock: Lock::Open,
            power_up: PowerUp::New { stop_left: false },
            jogs: false,
            stop_given: None,
            left_elsewhere: None,
            left_is_known: false,
            holds_fast_stop: false,
            is_connected: false,
            edge: None,
            fast_stop_left: false,
            found_moving: false,
            withdrawn_by: Promise::MotionHasItsEdge,
            received: now,
            gstate: GstateRule::new(),
            reported: SystemFlags::empty(),
        }
    }

    /// Restarts after a reset of the bridge.
    pub(super) const fn reset(&mut self, now: Instant) {
        *self = Self::new(now);
        self.withdrawn_by = Promise::ResetWithdraws;
    }

    /// Returns whether motions are permitted.
    pub(super) fn is_open(&self) -> bool {
        self.lock == Lock::Open
    }

    /// Returns whether the last motion sent was a jog.
    pub(super) const fn jogs(&self) -> bool {
        self.jogs
    }

    /// Records an edge that replaces all earlier requests.
    pub(super) const fn want(&mut self, motion: Motion) {
        self.wanted = motion.bit();
    }

    /// Records a bus edge during another motion: either request may be sent.
    pub(super) const fn may_want(&mut self, motion: Motion) {
        self.wanted |= motion.bit();
    }

    /// Records a wire edge while READY is low.
    pub(super) const fn refuse(&mut self) {
        self.withdrawn_by = Promise::EdgeWhileNotReadyStartsNothing;
    }

    /// Records an edge of STOP/ACK.
    pub(super) const fn stop(&mut self) {
        self.withdraw(Promise::StopAckWithdraws);
        self.acknowledgements += 1;
    }

    /// Requires the running motion to stop in time.
    pub(super) fn expect_standstill(&mut self, now: Instant, gripper: &States) {
        if gripper.motion.is_some() && !gripper.is_foreign {
            self.stop_given = self.stop_given.or(Some(now));
        }
    }

    /// Records that the motion of the PLC has ended.
    pub(super) const fn stand(&mut self) {
        self.stop_given = None;
    }

    /// Records the end of a JOG flag.
    pub(super) fn end_jog(&mut self, now: Instant, gripper: &States) {
        self.wanted &= !Motion::Jog.bit();
        if self.is_open() && self.jogs {
            self.expect_standstill(now, gripper);
        }
    }

    /// Records the silence of a bus that issued the last command.
    pub(super) fn fall_silent(&mut self, now: Instant, gripper: &States) {
        self.withdraw(Promise::SilenceWithdraws);
        if self.is_open() {
            self.expect_standstill(now, gripper);
        }
    }

    /// Records a FAST STOP request. Returns whether a frame must be sent for it.
    pub(super) fn fast_stop(&mut self, now: Instant) -> bool {
        self.withdraw(Promise::FastStopWithdraws);
        self.acknowledgements = 0;
        self.stop_given = None;
        // A PLC that already asserts FAST STOP by its other input causes no new edge.
        let is_told_early = self.is_open() && self.left_elsewhere.is_some();
        if !self.holds_fast_stop && !is_told_early {
            self.left_elsewhere = None;
            self.left_is_known = false;
        }
        let is_new = match self.lock {
            Lock::FastStop { .. } => false,
            Lock::Open => self.left_elsewhere.is_none(),
            _ => true,
        };
        if is_new {
            self.lock = Lock::FastStop { untaken: Some(now) };
        }
        is_new
    }

    /// Records a message that reaches the bridge intact.
    pub(super) fn receive(&mut self, now: Instant, answer: &Answer) {
        self.received = now;
        let is_acknowledged = (answer.id, answer.status) == (CommandId::Acknowledge, Status::Success);
        if self.lock == Lock::Acknowledged && is_acknowledged {
            self.lock = Lock::Open;
        }
        match answer.state() {
            Some(state) => self.gstate.report(state),
            None => self.gstate.answer(answer.id, answer.status),
        }
        if let Some(flags) = answer.flags() {
            let has_left = self.left_elsewhere.is_some() && !flags.contains(SystemFlags::FAST_STOP);
            if has_left && !self.holds_fast_stop {
                self.lock = Lock::Open;
                self.left_elsewhere = self.left_elsewhere.filter(|_| !self.is_connected);
                // An earlier report may have been requested before the gripper executed the FAST STOP.
                self.left_is_known = false;
            }
            self.left_is_known |= has_left && self.holds_fast_stop;
            self.reported = flags;
            self.found_moving = flags.contains(SystemFlags::MOVING);
        }
    }

    /// Starts a turn. `holds_fast_stop` is whether the PLC asserts FAST STOP.
    pub(super) const fn begin_turn(&mut self, holds_fast_stop: bool) {
        self.fast_stop_left = false;
        self.holds_fast_stop = holds_fast_stop;
    }

    /// Checks the commands sent once the line has delivered everything. `is_pending` is whether the bridge is
    /// disconnected or awaits the reply to a FAST STOP.
    pub(super) fn delivered(&self, gripper: &States, is_pending: bool) -> Kept {
        keep(Promise::FastStopIsALevel, !self.left_is_known || gripper.fast_stop() || is_pending)
    }

    /// Records a command edge while READY is high.
    pub(super) const fn expect_busy(&mut self, now: Instant) {
        self.edge = Some(now);
    }

    /// Records a FAST STOP that ends without the bridge's acknowledgement.
    pub(super) fn leave_elsewhere(&mut self, now: Instant) {
        if matches!(self.lock, Lock::FastStop { untaken: None }) {
            self.left_elsewhere = Some(now);
        }
    }

    /// Checks a command as it is sent, before the gripper executes it. `arrives` is whether it reaches the gripper.
    pub(super) fn leave(
        &mut self,
        now: Instant,
        command: &Command<'_>,
        gripper: &States,
        arrives: bool,
    ) -> Kept {
        let is_untaken = matches!(self.lock, Lock::FastStop { untaken: Some(_) });
        keep(Promise::OnlyFastStopUntilTaken, !is_untaken || command.id() == CommandId::FastStop)?;
        match command.id().kind() {
            Kind::Motion => self.leave_motion(command, gripper),
            Kind::Acknowledge => self.leave_acknowledgement(gripper),
            Kind::Setting => {
                keep(Promise::NoSettingInFastStop, self.is_open())?;
                keep(Promise::ForceLimitHasItsMotion, self.wanted != 0)
            }
            Kind::Stop => {
                if let PowerUp::New { stop_left } = &mut self.power_up {
                    *stop_left = true;
                }
                if command.id() == CommandId::FastStop {
                    let is_level = self.left_elsewhere.is_some() && !arrives;
                    let was_taken = matches!(self.lock, Lock::FastStop { untaken: None });
                    self.fast_stop(now);
                    self.left_elsewhere = is_level.then_some(now);
                    self.left_is_known = false;
                    self.fast_stop_left = true;
                    let untaken = if arrives || was_taken { None } else { Some(now) };
                    self.lock = Lock::FastStop { untaken };
                }
                Ok(())
            }
            Kind::Query | Kind::Connection => Ok(()),
        }
    }

    fn leave_motion(&mut self, command: &Command<'_>, gripper: &States) -> Kept {
        keep(Promise::NoMotionInFastStop, self.is_open())?;
        let may_leave = |motion: &&Motion| self.wanted & motion.bit() != 0;
        let mut motions = Motion::of(command).iter().filter(may_leave).peekable();
        let motion = **motions.peek().ok_or(self.withdrawn_by)?;
        let has_force = motions.any(|motion| gripper.force_limit == motion.force());
        self.jogs = motion == Motion::Jog;
        self.withdraw(Promise::MotionLeavesOnce);
        // A restarted gripper has lost its limit, and rejects GRIP.
        let needs_force = matches!(motion, Motion::Grip | Motion::GripGently) && gripper.referenced();
        keep(Promise::GripHasItsForce, has_force || !needs_force)
    }

    fn leave_acknowledgement(&mut self, gripper: &States) -> Kept {
        keep(Promise::AcknowledgementHasItsEdge, self.acknowledgements > 0)?;
        self.acknowledgements -= 1;
        if let Lock::FastStop { untaken } = self.lock {
            let has_stopped = untaken.is_none() || gripper.fast_stop();
            keep(Promise::AcknowledgementFollowsFastStop, has_stopped)?;
            self.lock = Lock::Acknowledged;
        }
        Ok(())
    }

    /// Checks all promises at the end of a turn.
    pub(super) fn end_turn(&mut self, now: Instant, outputs: Outputs, gripper: &States) -> Kept {
        let shows = |output| outputs.contains(output);
        let connected = shows(Outputs::LINK_OK);
        self.is_connected = connected;
        keep(Promise::NotReadyAndBusy, !shows(Outputs::READY | Outputs::BUSY))?;
        keep(Promise::NotHoldingAndPartFault, !shows(Outputs::HOLDING | Outputs::PART_FAULT))?;
        keep(Promise::OnlyErrorWithoutLink, connected || Outputs::ERROR.contains(outputs))?;
        keep(Promise::FastStopShowsError, self.is_open() || shows(Outputs::ERROR))?;
        keep(Promise::NotReadyInFastStop, self.is_open() || !shows(Outputs::READY))?;
        keep(Promise::LinkOkGoesLow, !connected || now.since(self.received) <= SECOND_MS)?;
        keep(Promise::OutputsShowTheReport, !connected || self.shows_report(outputs))?;
        self.end_power_up(outputs)?;
        if !connected {
            self.withdraw(Promise::ReconnectWithdraws);
        } else if shows(Outputs::READY) {
            // Another command would be accepted, so the earlier request is void.
            self.withdraw(Promise::MotionHasItsEdge);
        }
        if gripper.motion.is_none() {
            self.stop_given = None;
        }
        let is_late = self.stop_given.is_some_and(|given| now.since(given) > STOP_MS);
        keep(Promise::UnheardStopBecomesFastStop, !is_late)?;
        // Without a connection the bridge learns of it only during the handshake.
        let is_free = connected
            && self.holds_fast_stop
            && !gripper.fast_stop()
            && self.left_elsewhere.is_some_and(|left| now.since(left) > SECOND_MS);
        keep(Promise::FastStopIsALevel, !is_free)?;
        // A locked gripper ends BUSY and keeps READY low.
        let is_locked = !self.is_open() || self.reported.intersects(SystemFlags::LOCKS);
        self.edge = self.edge.filter(|edge| connected && !is_locked && now.since(*edge) < BUSY_MS);
        keep(Promise::ReadyEdgeShowsBusy, self.edge.is_none_or(|_| shows(Outputs::BUSY)))?;
        let is_away = match self.lock {
            Lock::FastStop { untaken: Some(left) } => now.since(left) > SECOND_MS,
            _ => false,
        };
        keep(Promise::FastStopIsRepeated, !is_away || gripper.fast_stop())
    }

    /// Checks the input image at the end of a turn.
    pub(super) fn shows_state(&mut self, image: &InputImage, motion_is_open: bool) -> Kept {
        if !self.is_connected {
            self.gstate.disconnect();
        }
        keep(Promise::GstateFollowsTheGripper, self.gstate.is_kept(image, motion_is_open))
    }

    fn shows_report(&self, outputs: Outputs) -> bool {
        let shows = |output| outputs.contains(output);
        let reports = |flag| self.reported.contains(flag);
        shows(Outputs::REFERENCED) == reports(SystemFlags::REFERENCED)
            && (shows(Outputs::BUSY) || !reports(SystemFlags::MOVING))
            && (shows(Outputs::ERROR) && !shows(Outputs::READY) || !reports(SystemFlags::FAST_STOP))
    }

    fn end_power_up(&mut self, outputs: Outputs) -> Kept {
        let found_moving = std::mem::take(&mut self.found_moving);
        let PowerUp::New { stop_left } = self.power_up else { return Ok(()) };
        if found_moving {
            keep(Promise::MotionAtPowerUpIsStopped, stop_left)?;
            keep(Promise::MotionAtPowerUpShowsError, outputs.contains(Outputs::ERROR))?;
        }
        if found_moving || outputs.contains(Outputs::LINK_OK) {
            self.power_up = PowerUp::Over;
        }
        Ok(())
    }

    /// Returns whether FAST STOP was sent in this turn.
    pub(super) const fn has_fast_stop_left(&self) -> bool {
        self.fast_stop_left
    }

    /// Checks the outputs once all wires have taken effect.
    pub(super) fn settled(&self, wires: Inputs, outputs: Outputs) -> Kept {
        let stopped = wires.contains(Inputs::STOP_ACK) || !wires.contains(Inputs::FAST_STOP_OK);
        keep(Promise::NotReadyWhileStopped, !(stopped && outputs.contains(Outputs::READY)))
    }

    /// Withdraws all motions. One sent regardless breaks this promise.
    const fn withdraw(&mut self, by: Promise) {
        if self.wanted != 0 {
            self.wanted = 0;
            self.withdrawn_by = by;
        }
    }
}
