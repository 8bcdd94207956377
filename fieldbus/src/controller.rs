//! Converts edges in the output image to commands, and the gripper's answers to the input image (fieldbus, chapter 6).

mod fast_stop;
mod gstate;
mod jogging;
mod outcome;
mod status;

use self::fast_stop::FastStop;
use self::gstate::Gstate;
use self::status::StatusRegister;
use super::image::to_register;
use super::jog::Jog;
use super::{Cause, CommandFlags, ForceUnit, GripperFlags, Incident, InputImage, OutputImage};
use wsg_protocol::command::{Command, CommandId, Kind};
use wsg_protocol::queue::Queue;
use wsg_protocol::reply::Value;
use wsg_protocol::session::{Event, Known};
use wsg_protocol::types::{GripperState, HomingDirection, PrePositionFlags, Status, SystemFlags};

/// Capacity for commands to fetch. A FAST STOP replaces all others, so the maximum is the two commands of one motion.
const OUTGOING_LEN: usize = 2;

/// Capacity for incidents to fetch. One event or image causes two at most, a FAST STOP and the motion that it ends,
/// and two may occur between polls.
const INCIDENTS_LEN: usize = 4;

/// The register interface of a gripper, independent of the PLC's bus.
///
/// Sans-IO, used with a [`Session`](wsg_protocol::session::Session): pass each image to
/// [`set_output`](Self::set_output) and each session event to [`handle`](Self::handle). Then fetch commands by
/// [`poll_command`](Self::poll_command) and show the PLC [`input`](Self::input).
///
/// Rules in addition to the manual's definition of each flag:
/// - The first image gives no edge, so flags that are 1 at power-up start nothing. FASTSTOP acts on its level there.
/// - When several motion flags rise at once, only the lowest bit runs. While STOP/ACK or FASTSTOP is 1, a motion's
///   edge is lost.
/// - A change of WIDTH, SPEED or FORCELIMIT while the fingers move is a FAST STOP. So is SPEED or FORCELIMIT outside
///   the limits with MOVE, GRIP or RELEASE. HOMING has no parameters.
/// - FASTSTOP is a level (fieldbus, 6.6). If the gripper's FAST STOP flag disappears while FASTSTOP is 1, another
///   FAST STOP is sent. The reason, a third party's acknowledgement or a restart, makes no difference.
/// - A FAST STOP ends only while FASTSTOP is 0 and after the gripper has confirmed it, first by E_SUCCESS and then by its
///   system flags. A rising edge of STOP/ACK acknowledges it. A third party may acknowledge it too; then the flag is gone.
/// - STOP/ACK withdraws every motion requested before it.
/// - A Stop that times out becomes a FAST STOP unless the fingers are known to be at rest.
/// - GRIP is sent only after the answer to its own force limit, or at once if the gripper is known to have that limit
///   ([`Known::force_limit`]). Configure the session to read settings back
///   ([`Config::verify_settings`](wsg_protocol::session::Config::verify_settings)).
/// - MOVE starts only when GSTATE is IDLE (fieldbus, 6.1). Use RELEASE to open while a part is held, after NO_PART
///   and after PART_LOST. After an error, use STOP/ACK first.
/// - MOVE stops on a block. Otherwise blocked fingers could later snap to the target without a command.
/// - GSTATE is the state that the gripper reported last, with two exceptions. A motion shows from its edge on, and its
///   result from the gripper's answer on. After a motion that failed, GSTATE is ERROR until the next command or
///   until the gripper reports another state, which a third party's motion, stop or acknowledgement causes. If the
///   outcome of the motion is unknown, the fingers may still be moving: then only a later motion or result counts.
/// - A motion that a third party stops ends in IDLE, with E_CMD_ABORTED.
/// - Without a connection a motion is refused and never kept for later.
/// - A motion requested while another runs is refused. The status is E_ALREADY_RUNNING while its flag is 1, then the
///   running motion's status again.
///
/// The binary command set has no command for JOG (fieldbus, 6.7). The controller sends the force limit and a
/// Pre-position to the end of the stroke, and a Stop when the flag falls:
/// - The flags act on their level, after both have been 0, so a flag that is 1 at power-up starts nothing. Both at
///   once stop. SPEED 0 selects the minimum speed.
/// - SPEED and FORCELIMIT may follow a dial. The fingers stop and continue with the new values, because a force limit
///   applies to subsequent motions (command set, 3.3.3). Values outside the limits are a FAST STOP here too.
/// - A jog that reached the end, failed, was refused, or was ended by STOP/ACK, FASTSTOP or a lost connection
///   restarts only after both flags were 0. A jog is refused while a part is held.
/// - If the connection is lost while the fingers may be moving, the gripper receives a FAST STOP first after the
///   reconnect, because no Stop could reach it in the meantime.
/// - A gripper with soft limits refuses the end of the stroke (E_RANGE_ERROR). The controller then queries the limits
///   and jogs to the limit in that direction. At or beyond that limit, the jog ends with E_RANGE_ERROR.
#[derive(Clone, Debug, Hash)]
pub struct Controller {
    /// The last image; `None` before the first.
    image: Option<OutputImage>,
    connected: bool,
    /// The gripper's flags have been received while connected, at least once since power-up.
    is_acquainted: bool,
    fast_stop: FastStop,
    /// Acknowledgements without an outcome. A FAST STOP answered before the outcome may precede them and be undone by them.
    acknowledgements_open: u8,
    /// Set Force Limit commands without an outcome.
    force_limits_open: u8,
    /// The motion that has no result yet.
    motion: Option<Motion>,
    /// Whether the gripper's reports already cover the last motion, including one that was stopped since.
    unseen: Unseen,
    status: StatusRegister,
    gstate: Gstate,
    /// An end that is withheld until the gripper reports that its fingers are at rest. The PLC thus sees the end
    /// of a motion, its result and its flags together.
    held_back: Option<(CommandId, Status)>,
    jog: Jog,
    /// OF of the input image.
    user_outputs: u8,
    outgoing: Queue<Command<'static>, OUTGOING_LEN>,
    incidents: Queue<Incident, INCIDENTS_LEN>,
}

/// A controller with the known state of its gripper, for the duration of one call.
struct Informed<'a> {
    own: &'a mut Controller,
    known: &'a Known,
}

/// Whether a motion may have started since the last report. Until then, a report of fingers at rest proves nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Unseen {
    /// No such motion.
    No,
    /// Passed to the session. Reports received now may precede it.
    Given,
    /// Started, or unanswered. The next report covers it.
    Begun,
}

/// The reaction to the silence of the PLC that controls the fingers.
///
/// A jog always ends, because its flag can no longer be released.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SilenceReaction {
    /// A running motion continues.
    Hold,
    /// Stops a motion. A held part stays held.
    #[default]
    Stop,
    /// Sends a FAST STOP, which must be acknowledged.
    FastStop,
}

/// A motion that was requested and has no result yet.
#[derive(Clone, Copy, Debug, Hash)]
struct Motion {
    command: Command<'static>,
    /// The command whose answer the motion awaits: Set Force Limit, or Get Soft Limits for a jog.
    awaits: Option<CommandId>,
}

impl Controller {
    /// Returns a controller that has received neither an image nor data from a gripper.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            image: None,
            connected: false,
            is_acquainted: false,
            fast_stop: FastStop::Clear,
            acknowledgements_open: 0,
            force_limits_open: 0,
            motion: None,
            unseen: Unseen::No,
            status: StatusRegister::Ended(Status::Success),
            gstate: Gstate::Reported,
            held_back: None,
            jog: Jog::new(),
            user_outputs: 0,
            outgoing: Queue::new(),
            incidents: Queue::new(),
        }
    }

    /// Takes a complete image that the PLC wrote.
    pub fn set_output(&mut self, image: &OutputImage, known: &Known) {
        Informed { own: self, known }.take_output(image, true);
    }

    /// Takes an image like [`set_output`](Self::set_output), but refuses every motion whose flag rises. Use it while
    /// the PLC sees READY low, even if the gripper would accept the motion.
    pub fn set_output_refusing_motions(&mut self, image: &OutputImage, known: &Known) {
        Informed { own: self, known }.take_output(image, false);
    }

    /// Reports that the PLC no longer communicates, for a bus that detects this.
    ///
    /// The image is kept, so its flags give no edge when the PLC returns. JOG becomes effective after both of its
    /// flags were 0.
    pub fn silence(&mut self, reaction: SilenceReaction, known: &Known) {
        Informed { own: self, known }.silence(reaction);
    }

    /// Returns IF as last written by the PLC: user flags IF1 (bit 0) to IF8, for a script on the gripper.
    #[must_use]
    pub fn user_inputs(&self) -> u8 {
        self.image.map_or(0, |image| image.user)
    }

    /// Sets OF: user flags OF1 (bit 0) to OF8, from a script on the gripper to the PLC.
    pub const fn set_user_outputs(&mut self, flags: u8) {
        self.user_outputs = flags;
    }

    /// Checks the gripper's state on the first connection after power-up. Fingers that move then follow a command
    /// from before a reset, so they are stopped and the PLC sees E_CMD_ABORTED. A held part stays held. Call this
    /// whenever new data may be known; later calls do nothing.
    #[inline(always)]
    pub fn adopt_known(&mut self, known: &Known) {
        if !self.is_acquainted {
            Informed { own: self, known }.make_acquaintance();
        }
    }

    /// Takes an event of the session, and the gripper data known after it.
    pub fn handle(&mut self, event: &Event<'_>, known: &Known) {
        Informed { own: self, known }.handle(event);
    }

    /// Returns the oldest incident. When the queue is full, a new incident replaces the oldest.
    pub fn poll_incident(&mut self) -> Option<Incident> {
        self.incidents.pop_front()
    }

    /// Returns the next command to send.
    pub fn poll_command(&mut self) -> Option<Command<'static>> {
        self.outgoing.pop_front()
    }

    /// Returns the image that the PLC reads.
    #[must_use]
    pub fn input(&self, known: &Known) -> InputImage {
        let unit = force_unit(known);
        let mut system = known.flags.unwrap_or_default();
        if self.asks_fast_stop() {
            system.insert(SystemFlags::FAST_STOP);
        }
        let is_stopped = system.contains(SystemFlags::FAST_STOP);
        let state = if is_stopped { GripperFlags::IDLE } else { self.state(known.state) };
        // Without a connection, an image of zeros would look like a gripper at rest.
        let not_connected = (GripperFlags::ERROR, Status::IoError);
        let (state, status) = if self.connected { (state, self.status.shown()) } else { not_connected };
        InputImage {
            state,
            user: self.user_outputs,
            system,
            width: to_register(known.width.unwrap_or(0.0), 100.0),
            force: to_register(known.force.unwrap_or(0.0), unit.per_newton()),
            status,
        }
    }

    /// Returns GSTATE of a connected gripper without FAST STOP, which shows as IDLE (SYSSTATE has the flag): a motion
    /// from its edge on, a failure as ERROR. No bit is set before the gripper has reported its state.
    fn state(&self, reported: Option<GripperState>) -> GripperFlags {
        if self.jog.is_on() {
            return GripperFlags::RELEASING;
        }
        if let Some(motion) = &self.motion {
            return GripperFlags::from(match motion.command.id() {
                CommandId::GripPart => GripperState::Gripping,
                CommandId::ReleasePart => GripperState::Releasing,
                _ => GripperState::Positioning,
            });
        }
        self.gstate.shown(reported)
    }

    /// Returns whether a motion was refused because of the command now pending, even if its flag has fallen since.
    #[must_use]
    pub fn has_refused_meanwhile(&self) -> bool {
        matches!(self.status, StatusRegister::Pending { refused: Some(_), .. })
    }

    /// Refuses the motions or jog of these flags, for a caller that withholds them from the controller.
    pub fn refuse(&mut self, flags: CommandFlags) {
        if matches!(self.status, StatusRegister::Pending { .. }) {
            self.refuse_beside_motion(flags);
        } else {
            self.show(Status::AccessDenied, Cause::NotReady);
        }
    }

    /// Refuses a motion or jog that was requested while the fingers move.
    fn refuse_beside_motion(&mut self, flags: CommandFlags) {
        self.note(Cause::MotionRuns, self.motion.map(|motion| motion.command.id()), 0);
        match &mut self.status {
            StatusRegister::Pending { refused, .. } => *refused = Some(flags | refused.unwrap_or_default()),
            // They move for another reason, which the status register does not show.
            ended => *ended = StatusRegister::Ended(Status::AlreadyRunning),
        }
    }

    /// Returns whether a motion runs or the fingers move for another reason. Then motions are refused and parameter
    /// changes are a FAST STOP.
    #[must_use]
    pub fn is_moving(&self, known: &Known) -> bool {
        // A result arrives before the report of the state that it ends.
        let state = self.gstate.implied().or(known.state);
        self.motion.is_some()
            || self.jog.is_on()
            || known.flags.unwrap_or_default().intersects(SystemFlags::MOVING)
            || state.is_some_and(GripperState::is_motion)
    }

    /// Returns whether a motion flag that rises now has no effect: the fingers move, or STOP/ACK or FASTSTOP is 1.
    #[must_use]
    pub fn ignores_motions(&self, known: &Known) -> bool {
        self.is_moving(known) || self.holds(CommandFlags::STOP_ACK.union(CommandFlags::FASTSTOP))
    }

    /// Returns whether one of these flags is 1 in the last image.
    fn holds(&self, any_of: CommandFlags) -> bool {
        self.image.is_some_and(|image| image.flags.intersects(any_of))
    }

    /// Sends a command that ends or overrides a motion. Later answers to that motion are ignored.
    // Not inlined: it has many callers.
    #[inline(never)]
    fn send_alone(&mut self, command: Command<'static>) {
        self.motion = None;
        self.held_back = None;
        self.gstate.end_failure();
        self.clear_outgoing();
        self.send(command);
        self.status = StatusRegister::pending(command.id());
    }

    /// Drops the commands that the session never received, so they have no outcome.
    fn clear_outgoing(&mut self) {
        while let Some(unsent) = self.outgoing.pop_front() {
            self.note_outcome(&Event::Withdrawn(unsent.id()));
            if unsent.id().kind() == Kind::Motion {
                self.unseen = Unseen::No;
            }
        }
    }

    #[inline(never)]
    fn send(&mut self, command: Command<'static>) {
        match command.id().kind() {
            Kind::Motion => self.unseen = Unseen::Given,
            Kind::Acknowledge => self.acknowledgements_open = self.acknowledgements_open.saturating_add(1),
            _ => {}
        }
        // There is room: a motion starts only when none runs, and every other command clears the queue first.
        let _ = self.outgoing.push_back(command);
    }

    /// Shows a status caused by the PLC itself, without a command to the gripper.
    // Not inlined: it has many callers.
    #[inline(never)]
    fn show(&mut self, status: Status, cause: Cause) {
        self.note(cause, None, 0);
        self.status = StatusRegister::Ended(status);
    }

    #[inline(never)]
    fn note(&mut self, cause: Cause, command: Option<CommandId>, value: u16) {
        if self.incidents.is_full() {
            let _ = self.incidents.pop_front();
        }
        let _ = self.incidents.push_back(Incident { cause, command, value });
    }
}

impl Default for Controller {
    fn default() -> Self {
        Self::new()
    }
}

impl Informed<'_> {
    fn take_output(&mut self, image: &OutputImage, may_begin: bool) {
        let previous = self.own.image.replace(*image);
        let before = previous.unwrap_or(*image);
        let rising = image.flags.difference(before.flags);
        self.own.jog.see(image);
        self.own.status.see(image.flags);
        if image.flags.contains(CommandFlags::FASTSTOP) {
            if previous.is_none() || rising.contains(CommandFlags::FASTSTOP) {
                self.own.fast_stop(Cause::Flag, 0);
            }
            return;
        }
        // A jog follows its dial. WIDTH is not one of its parameters.
        let follows = self.own.jog.is_on() && image.width == before.width;
        if image.parameters_differ(&before) && !follows && self.own.is_moving(self.known) {
            let value = if image.width != before.width {
                image.width.cast_unsigned()
            } else if image.speed != before.speed {
                image.speed
            } else {
                image.force_limit.cast_unsigned()
            };
            self.own.fast_stop(Cause::ParameterChanged, value);
        } else if rising.contains(CommandFlags::STOP_ACK) {
            self.stop_or_acknowledge();
        } else {
            if !image.flags.contains(CommandFlags::STOP_ACK) {
                self.begin_lowest(rising.intersection(CommandFlags::MOTIONS), image, may_begin);
            }
            self.follow_jog();
        }
    }

    fn silence(&mut self, reaction: SilenceReaction) {
        let Self { own, known } = self;
        own.jog.disarm(own.image.as_ref());
        let stops = reaction == SilenceReaction::Stop;
        // Without a connection, an unfinished motion continues and a Stop would be lost.
        let is_unstoppable = stops && !own.connected && own.unseen != Unseen::No;
        if reaction == SilenceReaction::FastStop || is_unstoppable {
            own.fast_stop(Cause::PlcSilent, 0);
        } else if stops && own.connected && own.is_moving(known) && !self.is_fast_stopped() {
            self.own.stop();
        } else {
            self.follow_jog();
        }
    }

    #[inline(never)]
    fn make_acquaintance(&mut self) {
        let stops = self.known.is_moving() && !self.is_fast_stopped();
        self.own.is_acquainted = self.own.connected || stops;
        if stops {
            self.own.stop();
            self.own.gstate = Gstate::unknown(self.known.state);
            self.own.show(Status::CmdAborted, Cause::MovedAtStart);
        }
    }

    fn handle(&mut self, event: &Event<'_>) {
        self.own.note_outcome(event);
        self.note_motion(event);
        match event {
            Event::Connected => {
                self.own.connected = true;
                if let Some(state) = self.known.state {
                    self.own.gstate.report(state);
                }
                // The flags were requested after a FAST STOP that was answered earlier.
                if let Some(flags) = self.known.flags {
                    self.own.supervise_fast_stop(flags);
                }
            }
            Event::Disconnected => {
                self.show_held_back();
                self.own.connected = false;
                self.own.gstate.end_result();
                self.own.jog.disarm(self.own.image.as_ref());
                if !matches!(self.own.fast_stop, FastStop::Clear | FastStop::Requested { .. }) {
                    // The gripper may restart and lose the FAST STOP, so send it first after a reconnect.
                    self.own.give_fast_stop();
                } else if self.own.jog.is_on() {
                    self.own.fast_stop(Cause::ConnectionLost, 0);
                }
            }
            Event::Answered(reply) => self.answered(reply),
            Event::Late(CommandId::Stop) | Event::Unanswered(CommandId::Stop) if !self.stands() => {
                self.own.fast_stop(Cause::StopFailed, Status::Timeout.code());
            }
            Event::Unanswered(CommandId::PrePosition) if self.own.jog.is_on() && !self.stands() => {
                self.own.fast_stop(Cause::ConnectionLost, 0);
            }
            Event::Unanswered(id) => self.came_to_nothing(*id, Status::Timeout, Cause::Unanswered),
            Event::Withdrawn(id) => self.came_to_nothing(*id, Status::CmdAborted, Cause::Withdrawn),
            Event::Reported(Value::GetGripperState(state)) => {
                if state.is_motion() {
                    // Another party's motion has begun. It must not delay the end of the PLC's.
                    self.show_held_back();
                }
                self.own.gstate.report(*state);
            }
            Event::Reported(Value::GetSystemState(flags)) => {
                self.own.supervise_fast_stop(*flags);
                self.show_held_back();
            }
            // Pending and late answers, and reports of values that are only displayed.
            _ => {}
        }
    }

    /// Returns whether the gripper has reported its fingers at rest and has received no motion since.
    fn stands(&self) -> bool {
        self.own.unseen == Unseen::No && self.known.flags.is_some() && !self.known.is_moving()
    }

    fn begin_lowest(&mut self, rising: CommandFlags, image: &OutputImage, may_begin: bool) {
        let Some(lowest) = rising.lowest() else { return };
        if !self.own.jog.is_on() {
            // The JOG flags have the highest bits and lose against any motion.
            self.own.jog.disarm(self.own.image.as_ref());
        }
        if self.refuses(lowest) {
            return;
        }
        if !may_begin {
            let is_locked = self.known.flags.unwrap_or_default().intersects(SystemFlags::LOCKS);
            let status = if is_locked { Status::AccessDenied } else { Status::AlreadyRunning };
            return self.own.show(status, Cause::NotReady);
        }
        if lowest == CommandFlags::HOMING {
            return self.begin_motion(Command::Homing { direction: HomingDirection::Default }, None);
        }
        let (width, speed) = (image.width_mm(), image.speed_mm_s());
        let force = image.force_limit_n(force_unit(self.known));
        if lowest == CommandFlags::MOVE && self.own.state(self.known.state) != GripperFlags::IDLE {
            let is_held = self.own.state(self.known.state) == GripperFlags::HOLDING;
            self.own.show(Status::AccessDenied, if is_held { Cause::PartHeld } else { Cause::NotIdle });
        } else if !self.within_limits(speed, force) {
            self.outside_limits(image);
        } else {
            let command = match lowest {
                CommandFlags::GRIP => Command::GripPart { width, speed },
                CommandFlags::RELEASE => Command::ReleasePart { width, speed },
                _ => Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed },
            };
            self.begin_motion(command, (lowest == CommandFlags::GRIP).then_some(force));
        }
    }

    /// Refuses a motion or jog that cannot start now. Returns whether it does.
    fn refuses(&mut self, flags: CommandFlags) -> bool {
        if !self.own.connected {
            self.own.show(Status::IoError, Cause::NotConnected);
        } else if self.is_fast_stopped() {
            self.own.show(Status::AccessDenied, Cause::FastStopLasts);
        } else if self.own.is_moving(self.known) {
            self.own.refuse_beside_motion(flags);
        } else {
            return false;
        }
        true
    }

    /// Sends a motion, after its force limit unless the gripper is known to have it. A queued command may change the limit.
    fn begin_motion(&mut self, command: Command<'static>, force: Option<f32>) {
        let force = force.filter(|_| self.known.force_limit != force || !self.own.outgoing.is_empty());
        let own = &mut *self.own;
        if force.is_some() {
            own.force_limits_open = own.force_limits_open.saturating_add(1);
        }
        own.send(force.map_or(command, |force| Command::SetForceLimit { force }));
        own.motion = Some(Motion { command, awaits: force.map(|_| CommandId::SetForceLimit) });
        own.status = StatusRegister::pending(command.id());
        own.gstate = Gstate::Awaited;
    }

    /// Returns whether a speed in mm/s and a force in N are inside the gripper's limits. Unknown limits permit nothing.
    fn within_limits(&self, speed: f32, force: f32) -> bool {
        let Some(limits) = self.known.limits else { return false };
        let overdrive = self.known.flags.unwrap_or_default().intersects(SystemFlags::OVERDRIVE_MODE);
        let max_force = if overdrive { limits.overdrive_force } else { limits.nominal_force };
        // The register value nearest to a limit is inside.
        let inside = |value, from: f32, to: f32, half| (from - half..=to + half).contains(&value);
        inside(speed, limits.min_speed, limits.max_speed, 0.005)
            && inside(force, limits.min_force, max_force, 0.5 / force_unit(self.known).per_newton())
    }
}

fn force_unit(known: &Known) -> ForceUnit {
    known.info.map_or(ForceUnit::default(), |info| ForceUnit::of(info.device))
}

#[cfg(test)]
mod tests;
