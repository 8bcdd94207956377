//! From edges in the output image to commands, and from the gripper's answers to the input image (fieldbus,
//! chapter 6).

mod jogging;

use super::image::to_register;
use super::jog::{Jog, Stage};
use super::{Cause, CommandFlags, ForceUnit, GripperFlags, Incident, InputImage, OutputImage};
use wsg_protocol::command::{Command, CommandId, Kind};
use wsg_protocol::queue::Queue;
use wsg_protocol::reply::{Reply, Value};
use wsg_protocol::session::{Event, Known, RequestError};
use wsg_protocol::types::{
    AutoUpdate, GripperState, HomingDirection, PrePositionFlags, Status, SystemFlags, SystemLimits,
};

/// Commands that may wait to be fetched: a FAST STOP replaces all others, so one motion's two at the most.
const OUTGOING_LEN: usize = 2;

/// Incidents that may wait to be fetched: one event or image makes two at the most, a FAST STOP and what it ends; and there may be
/// two of them between two looks.
const INCIDENTS_LEN: usize = 4;

/// The register interface of a gripper, whatever carries the images.
///
/// Sans-IO, beside a [`Session`](wsg_protocol::session::Session): give it each image by [`set_output`](Self::set_output) and
/// each event of the session by [`handle`](Self::handle), then fetch commands by
/// [`poll_command`](Self::poll_command) and show the PLC [`input`](Self::input).
///
/// The rules, beside those that the manual states at each flag:
/// - The first image gives no edge: what is 1 at power-up starts nothing. FASTSTOP acts on its level there.
/// - When several motions rise at once only the lowest bit runs; while STOP/ACK or FASTSTOP is 1 none does, and its
///   edge is lost.
/// - WIDTH, SPEED or FORCELIMIT changed while the fingers move: FAST STOP. So is SPEED or FORCELIMIT outside the
///   limits with MOVE, GRIP or RELEASE; HOMING has no parameters.
/// - FASTSTOP is a level (fieldbus, 6.6). While it is 1, a gripper whose flags stop showing FAST STOP is sent another one,
///   whether a third party acknowledged it or the gripper was restarted.
/// - A FAST STOP ends only while FASTSTOP is 0 and after the gripper has confirmed it: by E_SUCCESS, then by system flags
///   that show it. A rising edge of STOP/ACK acknowledges it; so may a third party, after which the flag is gone.
/// - STOP/ACK withdraws every motion that was asked for before it.
/// - A Stop that is not answered in time, while the fingers are not known to stand, becomes a FAST STOP.
/// - GRIP leaves only behind the answer to its own force limit, or at once while the gripper is known to have that limit
///   ([`Known::force_limit`]). Let the session read settings back
///   ([`Config::verify_settings`](wsg_protocol::session::Config::verify_settings)).
/// - MOVE begins only when GSTATE is IDLE (fieldbus, 6.1). While a part is held, or behind one that was not found or got lost,
///   RELEASE is the way to open; behind an error STOP/ACK comes first.
/// - MOVE stops on a block: fingers that clamp and later snap to the target would move without a command.
/// - Without a connection a motion is refused, never kept for later.
/// - A motion that is asked for while another runs is refused: the status is E_ALREADY_RUNNING while its flag is 1, and that of the
///   running motion again behind that.
///
/// JOG (fieldbus, 6.7) has no command of its own in the binary command set. It runs as the force limit and a
/// Pre-position to the end of the stroke, with a Stop when its flag goes:
/// - The flags count by their level, once both have been 0: a level that is there at power-up starts nothing. Both at
///   once stop. SPEED 0 is the least speed.
/// - SPEED and FORCELIMIT may follow a dial: the fingers are stopped and go on with the new values, because a force
///   limit holds for consecutive motions (command set, 3.3.3). Outside the limits they are a FAST STOP here as well.
/// - A jog that reached the end, failed, was refused, or was ended by STOP/ACK, FASTSTOP or the loss of the connection
///   begins again only after both flags were 0. It is refused while a part is held.
/// - When the connection goes while the fingers may be moving, a FAST STOP is the first thing that the gripper hears
///   when it comes back: nobody could stop them in the meantime.
/// - A gripper with soft limits refuses the end of the stroke (E_RANGE_ERROR). The controller then queries the limits and
///   runs the jog to the one in its direction. At that limit, or beyond it, the jog ends with E_RANGE_ERROR.
#[derive(Clone, Debug, Hash)]
pub struct Controller {
    /// The last image; none before the first.
    image: Option<OutputImage>,
    connected: bool,
    /// The gripper's flags have been seen once since power-up, and it was connected.
    is_acquainted: bool,
    fast_stop: FastStop,
    /// Acknowledgements without an outcome so far: what is answered before that may be an earlier FAST STOP, which they undo.
    acknowledgements_open: u8,
    /// Set Force Limit commands without an outcome so far.
    force_limits_open: u8,
    /// The motion whose result is awaited.
    motion: Option<Motion>,
    /// A motion that the gripper's reports say nothing of yet, be it stopped meanwhile.
    unseen: Unseen,
    /// The command whose outcome the status register shows.
    shown: Option<CommandId>,
    status: Status,
    /// A motion was asked for while this command is pending, and refused: those of its flags that are still 1.
    refused: Option<CommandFlags>,
    /// The last command failed, or its outcome is not known.
    failed: bool,
    /// The state that the last result implies, until the gripper reports one.
    settled: Option<GripperState>,
    /// A success that is shown once the gripper reports that its fingers stand: the PLC sees the end of a motion, its
    /// result and the flags that belong to it at one and the same time.
    held_back: Option<(CommandId, Status)>,
    jog: Jog,
    /// OF, for the input image.
    user_outputs: u8,
    outgoing: Queue<Command<'static>, OUTGOING_LEN>,
    incidents: Queue<Incident, INCIDENTS_LEN>,
}

/// The controller's own memory of a FAST STOP, beside the gripper's flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum FastStop {
    /// None, or acknowledged.
    Clear,
    /// Requested; the gripper has not answered.
    Asked,
    /// Requested once more before the gripper answered. The answer may be from before the second request, and a third party
    /// may have acknowledged in between: the next FAST STOP follows the answer.
    AskedTwice,
    /// Answered while an acknowledgement was open, which may have undone it: given again after the acknowledgement's outcome.
    Undone,
    /// Answered; its system flags do not show it yet.
    Answered,
    /// Confirmed; awaits STOP/ACK.
    Latched,
    /// The same, and an acknowledgement was sent since.
    Acknowledged,
}

/// A motion that may have begun since the gripper told its states: that the fingers stood then says nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Unseen {
    /// There is none.
    No,
    /// Given to the session; reports that come now may be older.
    Given,
    /// Begun, or not answered: the next report knows of it.
    Begun,
}

/// What becomes of the fingers when the PLC that commands them falls silent.
///
/// A jog ends in any case: nobody holds its button any more.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SilenceReaction {
    /// What runs goes on.
    Hold,
    /// A motion is stopped; a part that is held stays held.
    #[default]
    Stop,
    /// FAST STOP, which must be acknowledged.
    FastStop,
}

/// A motion on its way.
#[derive(Clone, Copy, Debug, Hash)]
struct Motion {
    command: Command<'static>,
    /// The command that must be answered before the motion is sent: Set Force Limit, or Get Soft Limits for a jog.
    awaits: Option<CommandId>,
}

impl Controller {
    /// A controller that has seen no image and no gripper.
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
            shown: None,
            status: Status::Success,
            refused: None,
            failed: false,
            settled: None,
            held_back: None,
            jog: Jog::new(),
            user_outputs: 0,
            outgoing: Queue::new(),
            incidents: Queue::new(),
        }
    }

    /// Takes an image that the PLC wrote, complete and at once.
    pub fn set_output(&mut self, image: &OutputImage, known: &Known) {
        self.take_output(image, known, true);
    }

    /// As [`set_output`](Self::set_output), for a PLC that has been told not to give commands now: a motion whose flag rises
    /// is refused even if the gripper would take it.
    pub fn set_output_refusing_motions(&mut self, image: &OutputImage, known: &Known) {
        self.take_output(image, known, false);
    }

    fn take_output(&mut self, image: &OutputImage, known: &Known, may_begin: bool) {
        let previous = self.image.replace(*image);
        let rising =
            previous.map_or(CommandFlags::empty(), |previous| image.flags.difference(previous.flags));
        self.jog.see(image);
        self.refused = self.refused.map(|refused| refused.intersection(image.flags));
        if image.flags.contains(CommandFlags::FASTSTOP) {
            if previous.is_none() || rising.contains(CommandFlags::FASTSTOP) {
                self.fast_stop(Cause::Flag, 0);
            }
            return;
        }
        let changed = previous.is_some_and(|previous| {
            // A jog follows its dial; the width is none of its parameters.
            if self.jog.is_on() { image.width != previous.width } else { image.parameters_differ(&previous) }
        });
        if changed && self.is_moving(known) {
            let before = previous.unwrap_or_default();
            let value = if image.width != before.width {
                image.width.cast_unsigned()
            } else if image.speed != before.speed {
                image.speed
            } else {
                image.force_limit.cast_unsigned()
            };
            self.fast_stop(Cause::ParameterChanged, value);
        } else if rising.contains(CommandFlags::STOP_ACK) {
            self.stop_or_acknowledge(known);
        } else {
            if !image.flags.contains(CommandFlags::STOP_ACK) {
                self.begin_lowest(rising.intersection(CommandFlags::MOTIONS), image, known, may_begin);
            }
            self.follow_jog(known);
        }
    }

    /// Takes note that the PLC is not heard any more, for a bus that tells.
    ///
    /// The image stays as it is, so that its flags give no edge when the PLC is back; JOG counts again after both of its
    /// flags were 0.
    pub fn silence(&mut self, reaction: SilenceReaction, known: &Known) {
        self.jog.disarm(self.image.as_ref());
        match reaction {
            SilenceReaction::FastStop => self.fast_stop(Cause::PlcSilent, 0),
            SilenceReaction::Stop
                if self.connected && self.is_moving(known) && !self.is_fast_stopped(known) =>
            {
                self.stop();
            }
            // A motion that the gripper was not heard to end goes on behind a line that is cut: a Stop now would be lost.
            SilenceReaction::Stop if !self.connected && self.unseen != Unseen::No => {
                self.fast_stop(Cause::PlcSilent, 0);
            }
            SilenceReaction::Stop | SilenceReaction::Hold => self.follow_jog(known),
        }
    }

    /// IF as the PLC wrote it last: user flags IF1 (bit 0) to IF8, for a script on the gripper.
    #[must_use]
    pub fn user_inputs(&self) -> u8 {
        self.image.map_or(0, |image| image.user)
    }

    /// Sets OF: user flags OF1 (bit 0) to OF8, from a script on the gripper to the PLC.
    pub const fn set_user_outputs(&mut self, flags: u8) {
        self.user_outputs = flags;
    }

    /// Looks at what is known while the first connection after power-up is made. A gripper that moves then moves for a
    /// command of before a reset, which nobody can end any more: it is stopped, and the PLC sees E_CMD_ABORTED. A part that
    /// is held stays held. Call it whenever something new may be known; later calls do nothing.
    // Nearly always there is nothing to do.
    #[inline(always)]
    pub fn get_acquainted(&mut self, known: &Known) {
        if !self.is_acquainted {
            self.make_acquaintance(known);
        }
    }

    #[inline(never)]
    fn make_acquaintance(&mut self, known: &Known) {
        self.is_acquainted = self.connected;
        if known.is_moving() && !self.is_fast_stopped(known) {
            self.is_acquainted = true;
            self.stop();
            self.failed = true;
            self.show(Status::CmdAborted, Cause::MovedAtStart);
        }
    }

    /// Takes what the session noticed, with what it knows since.
    pub fn handle(&mut self, event: &Event<'_>, known: &Known) {
        self.note_outcome(event);
        self.note_motion(event, known);
        match event {
            Event::Connected => {
                self.connected = true;
                // They were asked for behind a FAST STOP that was answered before.
                if let Some(flags) = known.flags {
                    self.supervise_fast_stop(flags);
                }
            }
            Event::Disconnected => {
                self.show_held_back(known);
                self.connected = false;
                self.settled = None;
                self.jog.disarm(self.image.as_ref());
                let is_answered = match self.fast_stop {
                    FastStop::Clear | FastStop::Asked | FastStop::AskedTwice => false,
                    FastStop::Undone | FastStop::Answered | FastStop::Latched | FastStop::Acknowledged => {
                        true
                    }
                };
                if is_answered {
                    // The gripper may be restarted and forget it: it shall be the first thing that it hears.
                    self.give_fast_stop();
                } else if self.jog.is_on() {
                    self.fast_stop(Cause::ConnectionLost, 0);
                }
            }
            Event::Answered(reply) => self.answered(reply, known),
            Event::Late(CommandId::Stop) | Event::Unanswered(CommandId::Stop) if !self.stands(known) => {
                self.fast_stop(Cause::StopFailed, Status::Timeout.code());
            }
            Event::Unanswered(id) if self.jog_may_move(*id, known) => {
                self.fast_stop(Cause::ConnectionLost, 0)
            }
            Event::Unanswered(id) => self.came_to_nothing(*id, Status::Timeout, Cause::Unanswered, known),
            Event::Withdrawn(id) => self.came_to_nothing(*id, Status::CmdAborted, Cause::Withdrawn, known),
            // A jog ends idle, whatever the gripper makes of its error (fieldbus, 6.7).
            Event::Reported(Value::GetGripperState(GripperState::Error)) if self.jog.failed => {}
            Event::Reported(Value::GetGripperState(_)) => self.settled = None,
            Event::Reported(Value::GetSystemState(flags)) => {
                self.supervise_fast_stop(*flags);
                self.show_held_back(known);
            }
            // Pending answers, late ones, and reports of values that are only shown.
            _ => {}
        }
    }

    /// Keeps count of what is open at the gripper.
    fn note_outcome(&mut self, event: &Event<'_>) {
        let id = match event {
            Event::Answered(reply) => reply.id(),
            Event::Unanswered(id) | Event::Withdrawn(id) => *id,
            Event::Disconnected => {
                self.acknowledgements_open = 0;
                self.force_limits_open = 0;
                return;
            }
            _ => return,
        };
        match id {
            CommandId::Acknowledge => {
                self.acknowledgements_open = self.acknowledgements_open.saturating_sub(1);
                if self.acknowledgements_open == 0 && self.fast_stop == FastStop::Undone {
                    self.fast_stop = FastStop::Asked;
                    self.send(Command::FastStop);
                }
            }
            CommandId::SetForceLimit => self.force_limits_open = self.force_limits_open.saturating_sub(1),
            _ => {}
        }
    }

    /// Keeps track of whether the reports know of the last motion.
    fn note_motion(&mut self, event: &Event<'_>, known: &Known) {
        let is_motion = |id: CommandId| id.kind() == Kind::Motion;
        let tells_states = |id| matches!(id, CommandId::GetSystemState | CommandId::GetGripperState);
        self.unseen = match event {
            Event::Pending(id) if is_motion(*id) => Unseen::Begun,
            Event::Unanswered(id) if is_motion(*id) && !self.stands(known) => Unseen::Begun,
            Event::Withdrawn(id) if is_motion(*id) => Unseen::No,
            Event::Answered(reply) if is_motion(reply.id()) => Unseen::No,
            Event::Answered(reply) if self.unseen == Unseen::Begun && tells_states(reply.id()) => Unseen::No,
            Event::Reported(value) if self.unseen == Unseen::Begun && tells_states(value.id()) => Unseen::No,
            // Its states were asked for since.
            Event::Connected => Unseen::No,
            _ => return,
        };
    }

    /// Whether the gripper has reported that its fingers stand, and was given no motion since.
    fn stands(&self, known: &Known) -> bool {
        self.unseen == Unseen::No && known.flags.is_some() && !known.is_moving()
    }

    /// Compares the gripper's system flags with the FAST STOP that it has answered.
    fn supervise_fast_stop(&mut self, flags: SystemFlags) {
        match (self.fast_stop, flags.contains(SystemFlags::FAST_STOP)) {
            // A third party has acknowledged it, or the gripper was restarted.
            (FastStop::Latched, false) if self.holds(CommandFlags::FASTSTOP) => {
                self.fast_stop(Cause::Flag, 0)
            }
            // The same, before an earlier acknowledgement has its outcome.
            (FastStop::Undone, false) if self.holds(CommandFlags::FASTSTOP) => self.give_fast_stop(),
            (FastStop::Latched, false) => self.fast_stop = FastStop::Clear,
            // The answer was to an earlier one.
            (FastStop::Answered, false) => self.give_fast_stop(),
            (FastStop::Answered, true) => {
                self.fast_stop = FastStop::Latched;
                if self.shown == Some(CommandId::FastStop) {
                    self.status = Status::Success;
                }
            }
            // It was acknowledged, and the answer that said so was lost or damaged.
            (FastStop::Acknowledged, false) if self.acknowledgements_open == 0 => {
                self.fast_stop = FastStop::Clear
            }
            _ => {}
        }
    }

    /// Whether one of these flags is 1 in the last image.
    fn holds(&self, any_of: CommandFlags) -> bool {
        self.image.is_some_and(|image| image.flags.intersects(any_of))
    }

    /// Whether a FAST STOP that the controller asked for lasts.
    #[must_use]
    pub fn asks_fast_stop(&self) -> bool {
        self.fast_stop != FastStop::Clear
    }

    /// Takes back a command that the session did not take.
    pub fn refused(&mut self, id: CommandId, error: RequestError) {
        self.note_outcome(&Event::Withdrawn(id));
        if self.unseen == Unseen::Given {
            // An earlier one may be the reason.
            self.unseen = Unseen::Begun;
        }
        let (status, cause) = match error {
            RequestError::NotConnected => (Status::IoError, Cause::NotConnected),
            RequestError::MotionRunning => (Status::AlreadyRunning, Cause::MotionRuns),
            RequestError::FastStopRunning => (Status::AccessDenied, Cause::FastStopLasts),
            RequestError::Invalid(_) => (Status::InvalidParameter, Cause::OutsideLimits),
            // The session's queue is full.
            _ => (Status::InsufficientResources, Cause::Withdrawn),
        };
        // What is known matters to a Stop alone, and a session that refuses one has no connection.
        self.came_to_nothing(id, status, cause, &Known::NOTHING);
    }

    /// The next thing that went wrong, for those who keep a record. What is not fetched gives way to what comes later.
    pub fn poll_incident(&mut self) -> Option<Incident> {
        self.incidents.pop_front()
    }

    /// The next command to send.
    pub fn poll_command(&mut self) -> Option<Command<'static>> {
        self.outgoing.pop_front()
    }

    /// The image that the PLC reads.
    #[must_use]
    pub fn input(&self, known: &Known) -> InputImage {
        let unit = force_unit(known);
        let mut system = known.flags.unwrap_or_default();
        system.set(SystemFlags::FAST_STOP, self.is_fast_stopped(known));
        // Without a connection nothing is known, and an image of zeros would pass for a gripper at rest.
        let (state, status) = if self.connected {
            (self.state(known), self.shown_status())
        } else {
            (GripperFlags::ERROR, Status::IoError)
        };
        InputImage {
            state,
            user: self.user_outputs,
            system,
            width: to_register(known.width.unwrap_or(0.0), 100.0),
            force: to_register(known.force.unwrap_or(0.0), unit.per_newton()),
            status,
        }
    }

    /// What is pending, until it is done; E_ALREADY_RUNNING for as long as a flag is 1 that was refused meanwhile.
    fn shown_status(&self) -> Status {
        match self.refused {
            Some(refused) if self.status == Status::CmdPending && !refused.is_empty() => {
                Status::AlreadyRunning
            }
            _ => self.status,
        }
    }

    /// Whether a motion was refused because of the command that is pending now. Its flag may have been taken back meanwhile.
    #[must_use]
    pub fn has_refused_meanwhile(&self) -> bool {
        self.status == Status::CmdPending && self.refused.is_some()
    }

    /// Refuses the motions or jog of these flags, for a caller that does not let them reach the controller.
    pub fn refuse(&mut self, flags: CommandFlags) {
        if self.status == Status::CmdPending {
            self.refuse_beside_motion(flags);
        } else {
            self.show(Status::AccessDenied, Cause::NotReady);
        }
    }

    /// A motion or jog that is asked for while the fingers move.
    fn refuse_beside_motion(&mut self, flags: CommandFlags) {
        self.note(Cause::MotionRuns, self.motion.map(|motion| motion.command.id()), 0);
        if self.status == Status::CmdPending {
            self.refused = Some(flags.union(self.refused.unwrap_or_default()));
        } else {
            // They move for another reason, of which the status register tells nothing.
            self.status = Status::AlreadyRunning;
        }
    }

    /// GSTATE of a gripper that answers: FAST STOP shows as IDLE (SYSSTATE has the flag), a motion from its edge on, a failure
    /// as ERROR; no bit before it has told its state.
    fn state(&self, known: &Known) -> GripperFlags {
        if self.is_fast_stopped(known) {
            return GripperFlags::IDLE;
        }
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
        match self.settled.or(known.state) {
            // That a part is held matters more than that a command failed, which the status register says.
            Some(GripperState::Holding) => GripperFlags::HOLDING,
            _ if self.failed => GripperFlags::ERROR,
            Some(state) => state.into(),
            None => GripperFlags::empty(),
        }
    }

    // Asked in many places: once in the image.
    #[inline(never)]
    fn is_fast_stopped(&self, known: &Known) -> bool {
        self.fast_stop != FastStop::Clear || has_flag(known, SystemFlags::FAST_STOP)
    }

    /// Whether a motion is carried out, or the fingers move for another reason: what is refused or ends in a FAST STOP
    /// then.
    #[must_use]
    pub fn is_moving(&self, known: &Known) -> bool {
        // A result overtakes the report of the state that it ends.
        let state = self.settled.or(known.state);
        self.motion.is_some()
            || self.jog.is_on()
            || has_flag(known, SystemFlags::MOVING)
            || state.is_some_and(GripperState::is_motion)
    }

    /// Whether a motion flag that rises now comes to nothing: the fingers move, or STOP/ACK or FASTSTOP is 1.
    #[must_use]
    pub fn ignores_motions(&self, known: &Known) -> bool {
        let held = CommandFlags::STOP_ACK.union(CommandFlags::FASTSTOP);
        self.is_moving(known) || self.holds(held)
    }

    fn fast_stop(&mut self, cause: Cause, value: u16) {
        self.note(cause, self.motion.map(|motion| motion.command.id()), value);
        let is_open = matches!(self.fast_stop, FastStop::Asked | FastStop::AskedTwice);
        self.give_fast_stop();
        if is_open {
            self.fast_stop = FastStop::AskedTwice;
        }
    }

    /// Gives one, be it again.
    fn give_fast_stop(&mut self) {
        self.fast_stop = FastStop::Asked;
        self.jog.stage = Stage::Off;
        self.jog.disarm(self.image.as_ref());
        self.send_alone(Command::FastStop);
    }

    fn stop_or_acknowledge(&mut self, known: &Known) {
        let is_confirmed =
            matches!(self.fast_stop, FastStop::Clear | FastStop::Latched | FastStop::Acknowledged);
        if !is_confirmed {
            // The gripper has not heard of it yet: an acknowledgement now would be undone by the FAST STOP behind it.
            self.show(Status::AccessDenied, Cause::FastStopLasts);
        } else if !self.connected {
            self.show(Status::IoError, Cause::NotConnected);
        } else if self.is_fast_stopped(known) {
            if self.fast_stop == FastStop::Latched {
                self.fast_stop = FastStop::Acknowledged;
            }
            self.send_alone(Command::ACKNOWLEDGE);
        } else {
            let failed = self.failed || known.state == Some(GripperState::Error);
            self.stop();
            if failed {
                // A Stop leaves the state as it is; Acknowledge is the way to IDLE (command set, 3.2.5 and appendix C).
                self.send(Command::ACKNOWLEDGE);
            }
        }
    }

    /// Sends a command that ends or overrules a motion; what the motion still answers no longer matters.
    // Done in many places: once in the image.
    #[inline(never)]
    fn send_alone(&mut self, command: Command<'static>) {
        self.motion = None;
        self.held_back = None;
        self.failed = false;
        // These will have no outcome: the session has not been given them.
        while let Some(unsent) = self.outgoing.pop_front() {
            self.note_outcome(&Event::Withdrawn(unsent.id()));
            // What is known matters to what was sent.
            self.note_motion(&Event::Withdrawn(unsent.id()), &Known::NOTHING);
        }
        self.send(command);
        self.shown = Some(command.id());
        (self.status, self.refused) = (Status::CmdPending, None);
    }

    fn begin_lowest(&mut self, rising: CommandFlags, image: &OutputImage, known: &Known, may_begin: bool) {
        let Some(lowest) = rising.lowest() else { return };
        if !self.jog.is_on() {
            // JOG has the highest bits of all.
            self.jog.disarm(Some(image));
        }
        if !self.connected {
            self.show(Status::IoError, Cause::NotConnected);
        } else if self.is_fast_stopped(known) {
            self.show(Status::AccessDenied, Cause::FastStopLasts);
        } else if self.is_moving(known) {
            self.refuse_beside_motion(lowest);
        } else if !may_begin {
            let is_locked = has_flag(known, SystemFlags::LOCKS);
            let status = if is_locked { Status::AccessDenied } else { Status::AlreadyRunning };
            self.show(status, Cause::NotReady);
        } else if lowest == CommandFlags::MOVE && self.state(known) != GripperFlags::IDLE {
            let is_held = self.state(known) == GripperFlags::HOLDING;
            self.show(Status::AccessDenied, if is_held { Cause::PartHeld } else { Cause::NotIdle });
        } else if lowest != CommandFlags::HOMING
            && !within_limits(image.speed_mm_s(), image.force_limit_n(force_unit(known)), known)
        {
            self.outside_limits(image, known);
        } else {
            self.begin(lowest, image, known);
        }
    }

    fn begin(&mut self, flag: CommandFlags, image: &OutputImage, known: &Known) {
        let (width, speed) = (image.width_mm(), image.speed_mm_s());
        let command = match flag {
            CommandFlags::MOVE => {
                Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed }
            }
            CommandFlags::GRIP => Command::GripPart { width, speed },
            CommandFlags::RELEASE => Command::ReleasePart { width, speed },
            _ => Command::Homing { direction: HomingDirection::Default },
        };
        let force = (flag == CommandFlags::GRIP).then(|| image.force_limit_n(force_unit(known)));
        self.begin_motion(command, force, known);
    }

    /// Sends a motion, its force limit first if it has one that the gripper is not known to have. What waits may change it.
    fn begin_motion(&mut self, command: Command<'static>, force: Option<f32>, known: &Known) {
        let force = force.filter(|_| known.force_limit != force || !self.outgoing.is_empty());
        if force.is_some() {
            self.force_limits_open = self.force_limits_open.saturating_add(1);
        }
        self.send(force.map_or(command, |force| Command::SetForceLimit { force }));
        self.motion = Some(Motion { command, awaits: force.map(|_| CommandId::SetForceLimit) });
        self.shown = Some(command.id());
        (self.status, self.refused) = (Status::CmdPending, None);
        self.failed = false;
        self.jog.failed = false;
        self.settled = None;
    }

    #[inline(never)]
    fn send(&mut self, command: Command<'static>) {
        match command.id().kind() {
            Kind::Motion => self.unseen = Unseen::Given,
            Kind::Acknowledge => self.acknowledgements_open = self.acknowledgements_open.saturating_add(1),
            _ => {}
        }
        // There is room: a motion only begins when none runs, and all else clears the queue first.
        let _ = self.outgoing.push_back(command);
    }

    /// A status of the PLC's own doing, with no command behind it.
    // Done in many places: once in the image.
    #[inline(never)]
    fn show(&mut self, status: Status, cause: Cause) {
        self.note(cause, None, 0);
        self.shown = None;
        self.status = status;
    }

    #[inline(never)]
    fn note(&mut self, cause: Cause, command: Option<CommandId>, value: u16) {
        if self.incidents.is_full() {
            let _ = self.incidents.pop_front();
        }
        let _ = self.incidents.push_back(Incident { cause, command, value });
    }

    /// SPEED or FORCELIMIT cannot be: the FAST STOP of that, with the one that it is.
    fn outside_limits(&mut self, image: &OutputImage, known: &Known) {
        let least_force = known.limits.map_or(0.0, |limits| limits.min_force);
        let is_force = within_limits(image.speed_mm_s(), least_force, known);
        let value = if is_force { image.force_limit.cast_unsigned() } else { image.speed };
        self.fast_stop(Cause::OutsideLimits, value);
    }

    fn answered(&mut self, reply: &Reply<'_>, known: &Known) {
        let (id, status) = (reply.id(), reply.status());
        if let Some(Value::GetSystemState(flags)) = reply.value() {
            self.supervise_fast_stop(flags);
            return self.show_held_back(known);
        }
        if self.is_of_earlier_motion(id) {
            return;
        }
        if let Some(motion) = self.motion.filter(|motion| motion.awaits == Some(id)) {
            if let Some(Value::GetSoftLimits(limits)) = reply.value() {
                self.jog_within(limits, known);
            } else if status == Status::Success {
                self.motion = Some(Motion { awaits: None, ..motion });
                self.send(motion.command);
            } else {
                self.came_to_nothing(id, status, Cause::Gripper, known);
            }
            return;
        }
        let ends_motion = id == CommandId::Stop || self.is_result_of_motion(id);
        if ends_motion && implied_state(id, status).is_some() && has_flag(known, SystemFlags::MOVING) {
            self.held_back = Some((id, status));
        } else {
            self.show_outcome(id, status, known);
        }
    }

    /// Whether this is the result of the motion.
    fn is_result_of_motion(&self, id: CommandId) -> bool {
        self.motion.is_some_and(|motion| motion.awaits.is_none() && id == motion.command.id())
    }

    /// Whether this is the outcome of something earlier: of a motion like the one that is not sent yet, or of a force limit
    /// whose motion was dropped.
    fn is_of_earlier_motion(&self, id: CommandId) -> bool {
        let is_unsent = |motion: Motion| motion.awaits.is_some() && id == motion.command.id();
        self.motion.is_some_and(is_unsent) || (id == CommandId::SetForceLimit && self.force_limits_open > 0)
    }

    fn show_held_back(&mut self, known: &Known) {
        if let Some((id, status)) = self.held_back.take() {
            self.show_outcome(id, status, known);
        }
    }

    /// The outcome of a command, for the PLC to see.
    fn show_outcome(&mut self, id: CommandId, status: Status, known: &Known) {
        let is_result = self.is_result_of_motion(id);
        if is_result && self.jog_meets_soft_limit(status) {
            return;
        }
        // That no part was found is a result.
        if (is_result || self.shown == Some(id)) && implied_state(id, status).is_none() {
            self.note(Cause::Gripper, Some(id), status.code());
        }
        if is_result {
            if self.jog.is_on() {
                return self.end_jog(status);
            }
            self.motion = None;
            self.settled = implied_state(id, status);
            self.failed = self.settled.is_none();
            self.status = status;
            return;
        }
        match (id, status, self.fast_stop) {
            (CommandId::Stop, Status::Success, _) => self.settled = implied_state(id, status),
            (CommandId::FastStop, Status::Success, FastStop::Asked | FastStop::AskedTwice) => {
                return self.fast_stop_answered();
            }
            // A FAST STOP that was asked for in the meantime stays, in whatever order the two are answered.
            (CommandId::Acknowledge, Status::Success, FastStop::Acknowledged | FastStop::Clear) => {
                self.fast_stop = FastStop::Clear;
                self.settled = implied_state(id, status);
            }
            _ => {}
        }
        if self.shown == Some(id) {
            self.status = status;
        }
        self.jog_stopped(id, status, known);
    }

    /// The gripper has answered a FAST STOP: maybe an earlier one. Its flags tell.
    fn fast_stop_answered(&mut self) {
        if self.acknowledgements_open > 0 {
            self.fast_stop = FastStop::Undone;
        } else if self.fast_stop == FastStop::AskedTwice {
            self.fast_stop = FastStop::Asked;
            self.send(Command::FastStop);
        } else {
            self.fast_stop = FastStop::Answered;
            self.send(Command::GetSystemState { update: AutoUpdate::once() });
        }
    }

    /// A command that was not carried out, or of which that is not known.
    fn came_to_nothing(&mut self, id: CommandId, status: Status, cause: Cause, known: &Known) {
        if self.is_of_earlier_motion(id) {
            return;
        }
        let of_motion =
            self.motion.is_some_and(|motion| id == motion.command.id() || motion.awaits == Some(id));
        if of_motion || self.shown == Some(id) {
            self.note(cause, Some(id), if cause == Cause::Gripper { status.code() } else { 0 });
        }
        if of_motion && self.jog.is_on() {
            return self.end_jog(status);
        }
        if of_motion {
            self.motion = None;
            self.failed = true;
        }
        if of_motion || self.shown == Some(id) {
            self.status = status;
        }
        self.jog_stopped(id, status, known);
    }
}

impl Default for Controller {
    fn default() -> Self {
        Self::new()
    }
}

/// The gripper state that the end of a command implies; `None` when it failed.
const fn implied_state(id: CommandId, status: Status) -> Option<GripperState> {
    match (id, status) {
        (CommandId::GripPart, Status::Success) => Some(GripperState::Holding),
        (CommandId::GripPart, Status::CmdFailed) => Some(GripperState::NoPart),
        (_, Status::Success) => Some(GripperState::Idle),
        _ => None,
    }
}

fn force_unit(known: &Known) -> ForceUnit {
    known.info.map_or(ForceUnit::default(), |info| ForceUnit::of(info.device))
}

// Asked in many places: once in the image.
#[inline(never)]
fn has_flag(known: &Known, any_of: SystemFlags) -> bool {
    known.flags.is_some_and(|flags| flags.intersects(any_of))
}

/// Whether a speed in mm/s and a force in N are inside the gripper's limits; unknown limits allow nothing.
fn within_limits(speed: f32, force: f32, known: &Known) -> bool {
    let Some(SystemLimits { min_speed, max_speed, min_force, nominal_force, overdrive_force, .. }) =
        known.limits
    else {
        return false;
    };
    let overdrive = has_flag(known, SystemFlags::OVERDRIVE_MODE);
    let max_force = if overdrive { overdrive_force } else { nominal_force };
    // A limit is met by the register value nearest to it.
    let inside =
        |value: f32, from: f32, to: f32, half_step: f32| value >= from - half_step && value <= to + half_step;
    inside(speed, min_speed, max_speed, 0.005)
        && inside(force, min_force, max_force, 0.5 / force_unit(known).per_newton())
}

#[cfg(test)]
mod tests;
