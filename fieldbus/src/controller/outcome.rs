//! Outcomes of commands: which motion or command an answer belongs to, and what it changes.

use super::fast_stop::FastStop;
use super::{Controller, Gstate, Informed, Motion, StatusRegister, Unseen};
use crate::Cause;
use wsg_protocol::command::{Command, CommandId, Kind};
use wsg_protocol::reply::{Reply, Value};
use wsg_protocol::session::{Event, Known, RequestError};
use wsg_protocol::types::{GripperState, Status, SystemFlags};

impl Controller {
    /// Counts the open commands of which the outcome matters.
    pub(super) fn note_outcome(&mut self, event: &Event<'_>) {
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
                    self.fast_stop = FastStop::Requested { again: false };
                    self.send(Command::FastStop);
                }
            }
            CommandId::SetForceLimit => self.force_limits_open = self.force_limits_open.saturating_sub(1),
            _ => {}
        }
    }

    /// Takes back a command that the session refused. `known` is the gripper's state at that time: GSTATE is ERROR until
    /// the gripper reports another one.
    pub fn refused(&mut self, id: CommandId, error: RequestError, known: &Known) {
        self.note_outcome(&Event::Withdrawn(id));
        if self.unseen == Unseen::Given {
            // An earlier motion may be the reason.
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
        Informed { own: self, known }.came_to_nothing(id, status, cause);
    }

    /// Returns whether this answer is the result of the motion.
    fn is_result_of_motion(&self, id: CommandId) -> bool {
        self.motion.is_some_and(|motion| motion.awaits.is_none() && id == motion.command.id())
    }

    /// Returns whether the outcome belongs to an earlier command: a motion of the same kind as one not sent yet, or a
    /// force limit whose motion was dropped.
    fn is_of_earlier_motion(&self, id: CommandId) -> bool {
        let is_unsent = |motion: Motion| motion.awaits.is_some() && id == motion.command.id();
        self.motion.is_some_and(is_unsent) || (id == CommandId::SetForceLimit && self.force_limits_open > 0)
    }
}

impl Informed<'_> {
    /// Tracks whether the reports cover the last motion.
    pub(super) fn note_motion(&mut self, event: &Event<'_>) {
        let is_motion = |id: CommandId| id.kind() == Kind::Motion;
        let is_begun = self.own.unseen == Unseen::Begun;
        let covers = |id| is_begun && matches!(id, CommandId::GetSystemState | CommandId::GetGripperState);
        self.own.unseen = match event {
            Event::Pending(id) if is_motion(*id) => Unseen::Begun,
            Event::Unanswered(id) if is_motion(*id) && !self.stands() => Unseen::Begun,
            Event::Withdrawn(id) if is_motion(*id) => Unseen::No,
            Event::Answered(reply) if is_motion(reply.id()) || covers(reply.id()) => Unseen::No,
            Event::Reported(value) if covers(value.id()) => Unseen::No,
            // The states were queried after the motion.
            Event::Connected => Unseen::No,
            _ => return,
        };
    }

    pub(super) fn answered(&mut self, reply: &Reply<'_>) {
        let (id, status) = (reply.id(), reply.status());
        if let Some(Value::GetSystemState(flags)) = reply.value() {
            self.own.supervise_fast_stop(flags);
            return self.show_held_back();
        }
        if self.own.is_of_earlier_motion(id) {
            return;
        }
        if let Some(motion) = self.own.motion.filter(|motion| motion.awaits == Some(id)) {
            if let Some(Value::GetSoftLimits(limits)) = reply.value() {
                self.jog_within(limits);
            } else if status == Status::Success {
                self.own.motion = Some(Motion { awaits: None, ..motion });
                self.own.send(motion.command);
            } else {
                self.came_to_nothing(id, status, Cause::Gripper);
            }
            return;
        }
        let ends_motion = id == CommandId::Stop || self.own.is_result_of_motion(id);
        if ends_motion
            && self.implied_state(id, status).is_some()
            && self.known.flags.unwrap_or_default().intersects(SystemFlags::MOVING)
        {
            self.own.held_back = Some((id, status));
        } else {
            self.show_outcome(id, status);
        }
    }

    pub(super) fn show_held_back(&mut self) {
        if let Some((id, status)) = self.own.held_back.take() {
            self.show_outcome(id, status);
        }
    }

    /// Shows the outcome of a command to the PLC.
    fn show_outcome(&mut self, id: CommandId, status: Status) {
        let implied = self.implied_state(id, status);
        let own = &mut *self.own;
        let (is_result, is_shown) = (own.is_result_of_motion(id), own.status.is_of(id));
        if is_result && own.jog_meets_soft_limit(status) {
            return;
        }
        // NO_PART is a result, not an error.
        if (is_result || is_shown) && (implied.is_none() || status == Status::CmdAborted) {
            own.note(Cause::Gripper, Some(id), status.code());
        }
        if is_result {
            if own.jog.is_on() {
                return own.end_jog(status);
            }
            own.motion = None;
            own.gstate = implied.map_or(Gstate::failed(self.known.state), Gstate::Result);
            own.status = StatusRegister::Ended(status);
            return;
        }
        // A Stop leaves every state except ERROR, and an acknowledgement leaves only ERROR (command set, appendix C). Another
        // party may have acknowledged earlier and started a motion since.
        let reported = self.known.state.filter(|_| own.gstate == Gstate::Reported);
        match (id, own.fast_stop) {
            _ if status != Status::Success => {}
            (CommandId::Stop, _)
                if reported != Some(GripperState::Error) || own.acknowledgements_open > 0 =>
            {
                own.gstate.stand();
            }
            (CommandId::FastStop, FastStop::Requested { .. }) => return own.fast_stop_answered(),
            // A FAST STOP requested in the meantime stays in effect, regardless of the order of the two answers.
            (CommandId::Acknowledge, FastStop::Acknowledged | FastStop::Clear) => {
                own.fast_stop = FastStop::Clear;
                if reported.is_none_or(|state| state == GripperState::Error) {
                    own.gstate.stand();
                }
            }
            _ => {}
        }
        if is_shown {
            own.status = StatusRegister::Ended(status);
        }
        self.jog_stopped(id, status);
    }

    /// Handles a command that was not carried out, or whose outcome is unknown.
    pub(super) fn came_to_nothing(&mut self, id: CommandId, status: Status, cause: Cause) {
        // The motion is over: a FAST STOP has ended it, or the gripper has reported fingers at rest since it began.
        let is_over = self.is_fast_stopped() || self.stands();
        let own = &mut *self.own;
        if own.is_of_earlier_motion(id) {
            return;
        }
        let of_motion =
            own.motion.is_some_and(|motion| id == motion.command.id() || motion.awaits == Some(id));
        if of_motion || own.status.is_of(id) {
            own.note(cause, Some(id), if cause == Cause::Gripper { status.code() } else { 0 });
            if of_motion && own.jog.is_on() {
                return own.end_jog(status);
            }
            own.status = StatusRegister::Ended(status);
        }
        if of_motion {
            own.motion = None;
            own.gstate = match cause {
                Cause::Unanswered if !is_over => Gstate::unknown(self.known.state),
                _ => Gstate::failed(self.known.state),
            };
        }
        self.jog_stopped(id, status);
    }

    /// Returns the gripper state that the end of a command implies; `None` if it failed.
    fn implied_state(&self, id: CommandId, status: Status) -> Option<GripperState> {
        match (id, status) {
            (CommandId::GripPart, Status::Success) => Some(GripperState::Holding),
            (CommandId::GripPart, Status::CmdFailed) => Some(GripperState::NoPart),
            (_, Status::Success) => Some(GripperState::Idle),
            // Another party's stop, unless the gripper has reported an error (GCL, 3.2.1).
            (_, Status::CmdAborted) if id.kind() == Kind::Motion => {
                Some(GripperState::Idle).filter(|_| self.known.state != Some(GripperState::Error))
            }
            _ => None,
        }
    }
}
