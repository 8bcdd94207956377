//! What docs/wiring.md, docs/registers.md and the README promise, told from outside the bridge: from the wires and the bus on
//! one side, and from the commands that leave and the gripper on the other.
//!
//! Edges ask for motions. This module keeps its own account of which motion may still leave, and so notices one that leaves
//! without an edge, twice, or after something has withdrawn it.

use std::hash::{Hash, Hasher};

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{Command, CommandId, Instant, Kind, Status, SystemFlags};

use crate::gripper_states::{Answer, STROKE, States};

/// A promise that can be broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Promise {
    /// A motion leaves only for an edge of its own.
    MotionHasItsEdge,
    /// A motion leaves only once for an edge.
    MotionLeavesOnce,
    /// An edge while READY is low starts nothing.
    EdgeWhileNotReadyStartsNothing,
    /// STOP/ACK withdraws every motion that was asked for before it.
    StopAckWithdraws,
    /// FAST STOP withdraws every motion that was asked for before it.
    FastStopWithdraws,
    /// A bus that falls silent withdraws the motion that it asked for.
    SilenceWithdraws,
    /// A lost connection withdraws every motion that was asked for before it.
    ReconnectWithdraws,
    /// A reset of the bridge withdraws every motion that was asked for before it.
    ResetWithdraws,
    /// No motion leaves from FAST STOP until its acknowledgement is answered.
    NoMotionInFastStop,
    /// No setting leaves from FAST STOP until its acknowledgement is answered.
    NoSettingInFastStop,
    /// Nothing but FAST STOP leaves until the gripper has taken it.
    OnlyFastStopUntilTaken,
    /// A force limit leaves only for a GRIP or a jog that may still leave.
    ForceLimitHasItsMotion,
    /// GRIP leaves only while the gripper has the force limit of that edge.
    GripHasItsForce,
    /// An acknowledgement leaves only for an edge of STOP/ACK.
    AcknowledgementHasItsEdge,
    /// An acknowledgement leaves only after the gripper has taken the FAST STOP.
    AcknowledgementFollowsFastStop,
    /// FAST STOP leaves in the turn in which it is asked for, or in the next one a millisecond later.
    FastStopLeavesAtOnce,
    /// FAST STOP leaves again within a second until the gripper has taken it.
    FastStopIsRepeated,
    /// A gripper that leaves FAST STOP while the PLC asserts it is sent another one within a second.
    FastStopIsALevel,
    /// A motion that goes on 250 ms after STOP/ACK, the end of a jog or a silent bus has been sent a FAST STOP.
    UnheardStopBecomesFastStop,
    /// A gripper that moves at power-up is stopped as soon as that is known.
    MotionAtPowerUpIsStopped,
    /// A gripper that moves at power-up raises ERROR.
    MotionAtPowerUpShowsError,
    /// READY and BUSY are never both high.
    NotReadyAndBusy,
    /// HOLDING and PART_FAULT are never both high.
    NotHoldingAndPartFault,
    /// Without LINK_OK only ERROR can be high.
    OnlyErrorWithoutLink,
    /// ERROR is high from FAST STOP until its acknowledgement is answered.
    FastStopShowsError,
    /// READY is low from FAST STOP until its acknowledgement is answered.
    NotReadyInFastStop,
    /// READY is low while STOP_ACK is high or FAST_STOP_OK is low.
    NotReadyWhileStopped,
    /// Moving, referenced and in FAST STOP: with LINK_OK, the outputs show what the gripper reported last.
    OutputsShowTheReport,
    /// LINK_OK goes low within a second of the last intact frame.
    LinkOkGoesLow,
    /// A command that rises while READY is high is taken.
    ReadyCommandIsTaken,
    /// A command that rises while READY is high shows BUSY for 50 ms, taken or refused.
    ReadyEdgeShowsBusy,
    /// A command that rises while READY is low raises ERROR.
    RefusedCommandShowsError,
    /// Question and answer come to an end within a second when the line delivers everything.
    ConversationEnds,
}

/// A motion that can be asked for.
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

    /// Its force limit in hundredths of a newton.
    const fn force(self) -> u32 {
        if matches!(self, Self::GripGently) { 10_00 } else { 40_00 }
    }

    /// The motions that this command can be for. Only a jog goes to the end of the stroke.
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

/// Whether motions are locked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Lock {
    /// They are not.
    Open,
    /// By FAST STOP. `untaken` while the gripper has not taken it: when a frame left last, or when it was asked for.
    FastStop { untaken: Option<Instant> },
    /// By FAST STOP, and an acknowledgement is not answered yet.
    Acknowledged,
}

/// Whether the bridge may find a motion that it has not begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum PowerUp {
    /// It has not been connected yet.
    New { stop_left: bool },
    /// It has been connected, or has found one.
    Over,
}

/// What has been asked for and promised so far.
#[derive(Clone, Debug)]
pub(super) struct Promises {
    /// The motions of which one may leave, as [`Motion::bit`]s.
    wanted: u8,
    /// Edges of STOP/ACK for which an acknowledgement may leave.
    acknowledgements: u8,
    lock: Lock,
    power_up: PowerUp,
    /// The last motion that left was a jog.
    jogs: bool,
    /// When a motion that still runs was to be stopped.
    stop_given: Option<Instant>,
    /// When the gripper left a FAST STOP that the bridge did not acknowledge: by a third party, or by a restart. Beside
    /// [`Lock::Open`] the bridge was told so before the end of its handshake, and may give the FAST STOP again.
    left_elsewhere: Option<Instant>,
    /// The bridge was told so while the PLC asserted FAST STOP.
    left_is_known: bool,
    /// The PLC asserts FAST STOP.
    holds_fast_stop: bool,
    /// LINK_OK was high at the end of the last turn. Not part of the key: the outputs are.
    is_connected: bool,
    /// When the last command rose while READY was high.
    edge: Option<Instant>,
    /// In this turn.
    fast_stop_left: bool,
    /// In this turn, a gripper that moves was reported last.
    found_moving: bool,
    /// Names the promise that a motion without an edge breaks. Not part of the key: it changes no judgement.
    withdrawn_by: Promise,
    /// When the last intact frame arrived. Not part of the key, or few states would be equal.
    heard: Instant,
    /// The flags that were reported last. Not part of the key: the bridge keeps them.
    reported: SystemFlags,
}

impl Hash for Promises {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { wanted, acknowledgements, lock, power_up, jogs, stop_given, .. } = self;
        (wanted, acknowledgements, lock, power_up, jogs, stop_given).hash(state);
        (self.left_elsewhere, self.left_is_known, self.edge).hash(state);
    }
}

pub(super) type Kept = Result<(), Promise>;

/// An error if the promise is not kept.
pub(super) fn keep(promise: Promise, is_kept: bool) -> Kept {
    if is_kept { Ok(()) } else { Err(promise) }
}

/// The longest that a motion may go on after it was to be stopped, in milliseconds.
const STOP_MS: u32 = 250;
/// The longest time between two FAST STOPs, and from the last frame until LINK_OK goes low, in milliseconds.
const SECOND_MS: u32 = 1_000;
/// How long BUSY is high after a command at READY, in milliseconds.
const BUSY_MS: u32 = 50;

impl Promises {
    /// Those of a bridge that has just been switched on.
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
            heard: now,
            reported: SystemFlags::empty(),
        }
    }

    /// Starts again, with a bridge that was reset.
    pub(super) const fn reset(&mut self, now: Instant) {
        *self = Self::new(now);
        self.withdrawn_by = Promise::ResetWithdraws;
    }

    /// Whether no FAST STOP locks motions.
    pub(super) fn is_open(&self) -> bool {
        self.lock == Lock::Open
    }

    /// Whether the last motion that left was a jog.
    pub(super) const fn jogs(&self) -> bool {
        self.jogs
    }

    /// Takes an edge that replaces all before it.
    pub(super) const fn want(&mut self, motion: Motion) {
        self.wanted = motion.bit();
    }

    /// Takes an edge of the bus during another motion: it may be refused, and the one before it leave.
    pub(super) const fn may_want(&mut self, motion: Motion) {
        self.wanted |= motion.bit();
    }

    /// Takes an edge of a wire while READY is low.
    pub(super) const fn refuse(&mut self) {
        self.withdrawn_by = Promise::EdgeWhileNotReadyStartsNothing;
    }

    /// Takes an edge of STOP/ACK.
    pub(super) const fn stop(&mut self) {
        self.withdraw(Promise::StopAckWithdraws);
        self.acknowledgements += 1;
    }

    /// Expects the motion that runs to end.
    pub(super) fn expect_standstill(&mut self, now: Instant, gripper: &States) {
        if gripper.motion.is_some() {
            self.stop_given = self.stop_given.or(Some(now));
        }
    }

    /// Takes a JOG flag that goes.
    pub(super) fn end_jog(&mut self, now: Instant, gripper: &States) {
        self.wanted &= !Motion::Jog.bit();
        if self.is_open() && self.jogs {
            self.expect_standstill(now, gripper);
        }
    }

    /// Takes the silence of a bus that gave the last command.
    pub(super) fn fall_silent(&mut self, now: Instant, gripper: &States) {
        self.withdraw(Promise::SilenceWithdraws);
        if self.is_open() {
            self.expect_standstill(now, gripper);
        }
    }

    /// Takes a FAST STOP. Whether a frame has to leave for it: none is on its way.
    pub(super) fn fast_stop(&mut self, now: Instant) -> bool {
        self.withdraw(Promise::FastStopWithdraws);
        self.acknowledgements = 0;
        self.stop_given = None;
        // One that the PLC asserted already by its other way gives no edge.
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

    /// Takes a message that arrives at the bridge intact.
    pub(super) fn hear(&mut self, now: Instant, answer: &Answer) {
        self.heard = now;
        let is_acknowledged = (answer.id, answer.status) == (CommandId::Acknowledge, Status::Success);
        if self.lock == Lock::Acknowledged && is_acknowledged {
            self.lock = Lock::Open;
        }
        if let Some(flags) = answer.flags() {
            let has_left = self.left_elsewhere.is_some() && !flags.contains(SystemFlags::FAST_STOP);
            if has_left && !self.holds_fast_stop {
                self.lock = Lock::Open;
                self.left_elsewhere = self.left_elsewhere.filter(|_| !self.is_connected);
                // An earlier report may have been requested before the gripper took the FAST STOP.
                self.left_is_known = false;
            }
            self.left_is_known |= has_left && self.holds_fast_stop;
            self.reported = flags;
            self.found_moving = flags.contains(SystemFlags::MOVING);
        }
    }

    /// Begins a turn. `holds_fast_stop`: the PLC asserts FAST STOP.
    pub(super) const fn begin_turn(&mut self, holds_fast_stop: bool) {
        self.fast_stop_left = false;
        self.holds_fast_stop = holds_fast_stop;
    }

    /// Judges what the bridge has sent once the line has delivered everything. `is_pending`: it is not connected, or
    /// still awaits the answer to a FAST STOP.
    pub(super) fn delivered(&self, gripper: &States, is_pending: bool) -> Kept {
        keep(Promise::FastStopIsALevel, !self.left_is_known || gripper.fast_stop() || is_pending)
    }

    /// Takes a command that rises while READY is high.
    pub(super) const fn expect_busy(&mut self, now: Instant) {
        self.edge = Some(now);
    }

    /// Takes a FAST STOP that ends without an acknowledgement of the bridge's.
    pub(super) fn leave_elsewhere(&mut self, now: Instant) {
        if matches!(self.lock, Lock::FastStop { untaken: None }) {
            self.left_elsewhere = Some(now);
        }
    }

    /// Takes a command that leaves. The gripper has not taken it yet, and will if it `arrives`.
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
        // A gripper that was restarted has forgotten its limit, and refuses to grip.
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

    /// Ends a turn.
    pub(super) fn end_turn(&mut self, now: Instant, outputs: Outputs, gripper: &States) -> Kept {
        let shows = |output| outputs.contains(output);
        let connected = shows(Outputs::LINK_OK);
        self.is_connected = connected;
        keep(Promise::NotReadyAndBusy, !shows(Outputs::READY | Outputs::BUSY))?;
        keep(Promise::NotHoldingAndPartFault, !shows(Outputs::HOLDING | Outputs::PART_FAULT))?;
        keep(Promise::OnlyErrorWithoutLink, connected || Outputs::ERROR.contains(outputs))?;
        keep(Promise::FastStopShowsError, self.is_open() || shows(Outputs::ERROR))?;
        keep(Promise::NotReadyInFastStop, self.is_open() || !shows(Outputs::READY))?;
        keep(Promise::LinkOkGoesLow, !connected || now.since(self.heard) <= SECOND_MS)?;
        keep(Promise::OutputsShowTheReport, !connected || self.shows_report(outputs))?;
        self.end_power_up(outputs)?;
        if !connected {
            self.withdraw(Promise::ReconnectWithdraws);
        } else if shows(Outputs::READY) {
            // Another command would be taken, so what was asked for has come to nothing.
            self.withdraw(Promise::MotionHasItsEdge);
        }
        if gripper.motion.is_none() {
            self.stop_given = None;
        }
        let is_late = self.stop_given.is_some_and(|given| now.since(given) > STOP_MS);
        keep(Promise::UnheardStopBecomesFastStop, !is_late)?;
        // Without a connection the bridge cannot know: it is told by the handshake.
        let is_free = connected
            && self.holds_fast_stop
            && !gripper.fast_stop()
            && self.left_elsewhere.is_some_and(|left| now.since(left) > SECOND_MS);
        keep(Promise::FastStopIsALevel, !is_free)?;
        // What locks the gripper ends BUSY, and keeps READY low.
        let is_locked = !self.is_open() || self.reported.intersects(SystemFlags::LOCKS);
        self.edge = self.edge.filter(|edge| connected && !is_locked && now.since(*edge) < BUSY_MS);
        keep(Promise::ReadyEdgeShowsBusy, self.edge.is_none_or(|_| shows(Outputs::BUSY)))?;
        let is_away = match self.lock {
            Lock::FastStop { untaken: Some(left) } => now.since(left) > SECOND_MS,
            _ => false,
        };
        keep(Promise::FastStopIsRepeated, !is_away || gripper.fast_stop())
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

    /// Whether a FAST STOP left in this turn.
    pub(super) const fn has_fast_stop_left(&self) -> bool {
        self.fast_stop_left
    }

    /// Judges the outputs once all wires count.
    pub(super) fn settled(&self, wires: Inputs, outputs: Outputs) -> Kept {
        let stopped = wires.contains(Inputs::STOP_ACK) || !wires.contains(Inputs::FAST_STOP_OK);
        keep(Promise::NotReadyWhileStopped, !(stopped && outputs.contains(Outputs::READY)))
    }

    /// No motion may leave. One that does all the same breaks this promise.
    const fn withdraw(&mut self, by: Promise) {
        if self.wanted != 0 {
            self.wanted = 0;
            self.withdrawn_by = by;
        }
    }
}
