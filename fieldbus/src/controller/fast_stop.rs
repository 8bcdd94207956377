//! FAST STOP, its confirmation and its acknowledgement (fieldbus, 6.6).

use super::{Controller, Gstate, Informed, StatusRegister};
use crate::{Cause, CommandFlags, OutputImage};
use wsg_protocol::command::{Command, CommandId, Kind};
use wsg_protocol::types::{AutoUpdate, GripperState, Status, SystemFlags};

/// The controller's own record of a FAST STOP, in addition to the gripper's flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum FastStop {
    /// None, or acknowledged.
    Clear,
    /// Requested and not answered yet. If it was requested again in the meantime, the answer may precede that request,
    /// with a third party's acknowledgement in between, so another FAST STOP follows the answer.
    Requested { again: bool },
    /// Answered while an acknowledgement was open, which may have undone it. Sent again after the acknowledgement's outcome.
    Undone,
    /// Answered, but not yet shown by the system flags.
    Answered,
    /// Confirmed; awaits STOP/ACK.
    Latched,
    /// Confirmed, and an acknowledgement was sent.
    Acknowledged,
}

impl Controller {
    pub(super) fn fast_stop(&mut self, cause: Cause, value: u16) {
        self.note(cause, self.motion.map(|motion| motion.command.id()), value);
        let again = matches!(self.fast_stop, FastStop::Requested { .. });
        self.give_fast_stop();
        self.fast_stop = FastStop::Requested { again };
    }

    /// Sends a FAST STOP, for the first time or again.
    pub(super) fn give_fast_stop(&mut self) {
        self.fast_stop = FastStop::Requested { again: false };
        self.jog.end(self.image.as_ref());
        self.send_alone(Command::FastStop);
    }

    /// Refuses a motion that the session has not received: it must not start when another party has acknowledged the
    /// gripper's FAST STOP. The session withdraws the motions that it has not sent.
    fn drop_unsent_motion(&mut self) {
        let awaits = self.motion.is_some_and(|motion| motion.awaits.is_some());
        if awaits || self.outgoing.iter().any(|command| command.id().kind() == Kind::Motion) {
            self.jog.end(self.image.as_ref());
            self.motion = None;
            self.clear_outgoing();
            self.show(Status::AccessDenied, Cause::FastStopLasts);
        }
    }

    /// Compares the gripper's system flags with the FAST STOP that it answered.
    pub(super) fn supervise_fast_stop(&mut self, flags: SystemFlags) {
        let is_stopped = flags.contains(SystemFlags::FAST_STOP);
        if is_stopped {
            self.drop_unsent_motion();
            // It ends the last result, which must not reappear after an acknowledgement by a third party.
            self.gstate = Gstate::Result(GripperState::Idle);
        }
        let is_held = self.holds(CommandFlags::FASTSTOP);
        match (self.fast_stop, is_stopped) {
            // A third party acknowledged it, or the gripper restarted.
            (FastStop::Latched, false) if is_held => self.fast_stop(Cause::Flag, 0),
            // The same, before an earlier acknowledgement has its outcome.
            (FastStop::Undone, false) if is_held => self.give_fast_stop(),
            (FastStop::Latched, false) => self.fast_stop = FastStop::Clear,
            // The answer belonged to an earlier FAST STOP.
            (FastStop::Answered, false) => self.give_fast_stop(),
            (FastStop::Answered, true) => {
                self.fast_stop = FastStop::Latched;
                if self.status.is_of(CommandId::FastStop) {
                    self.status = StatusRegister::Ended(Status::Success);
                }
            }
            // It was acknowledged, but the answer was lost or damaged.
            (FastStop::Acknowledged, false) if self.acknowledgements_open == 0 => {
                self.fast_stop = FastStop::Clear
            }
            _ => {}
        }
    }

    /// Handles the answer to a FAST STOP, which may be an earlier one. The flags decide.
    pub(super) fn fast_stop_answered(&mut self) {
        if self.acknowledgements_open > 0 {
            self.fast_stop = FastStop::Undone;
        } else if self.fast_stop == (FastStop::Requested { again: true }) {
            self.fast_stop = FastStop::Requested { again: false };
            self.send(Command::FastStop);
        } else {
            self.fast_stop = FastStop::Answered;
            self.send(Command::GetSystemState { update: AutoUpdate::once() });
        }
    }

    /// Returns whether a FAST STOP requested by the controller is in effect.
    #[must_use]
    pub fn asks_fast_stop(&self) -> bool {
        self.fast_stop != FastStop::Clear
    }
}

impl Informed<'_> {
    pub(super) fn stop_or_acknowledge(&mut self) {
        if matches!(self.own.fast_stop, FastStop::Requested { .. } | FastStop::Undone | FastStop::Answered) {
            // The gripper has not confirmed it yet. The pending FAST STOP would undo an acknowledgement sent now.
            self.own.show(Status::AccessDenied, Cause::FastStopLasts);
        } else if !self.own.connected {
            self.own.show(Status::IoError, Cause::NotConnected);
        } else if self.is_fast_stopped() {
            if self.own.fast_stop == FastStop::Latched {
                self.own.fast_stop = FastStop::Acknowledged;
            }
            // The gripper's own FAST STOP has ended the jog, even if the jog's answer is late or lost.
            self.own.jog.end(self.own.image.as_ref());
            self.own.send_alone(Command::ACKNOWLEDGE);
        } else {
            let failed = self.own.gstate.is_failed()
                || self.own.gstate == Gstate::FailedJog
                || self.known.state == Some(GripperState::Error);
            self.own.stop();
            if failed {
                // A Stop does not change the state; Acknowledge leads to IDLE (command set, 3.2.5 and appendix C).
                self.own.send(Command::ACKNOWLEDGE);
            }
        }
    }

    // Not inlined: it has many callers.
    #[inline(never)]
    pub(super) fn is_fast_stopped(&self) -> bool {
        self.own.asks_fast_stop() || self.known.flags.unwrap_or_default().intersects(SystemFlags::FAST_STOP)
    }

    /// Requests the FAST STOP for SPEED or FORCELIMIT outside the limits, and records the value at fault.
    pub(super) fn outside_limits(&mut self, image: &OutputImage) {
        let least_force = self.known.limits.map_or(0.0, |limits| limits.min_force);
        let is_force = self.within_limits(image.speed_mm_s(), least_force);
        let value = if is_force { image.force_limit.cast_unsigned() } else { image.speed };
        self.own.fast_stop(Cause::OutsideLimits, value);
    }
}
