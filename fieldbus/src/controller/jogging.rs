//! JOG as commands (fieldbus, 6.7): the force limit, a Pre-position to the end of the stroke or a soft limit, and a Stop.

use super::{Controller, Gstate, Informed, Motion, StatusRegister, force_unit};
use crate::jog::{Direction, Drive, Stage};
use crate::{Cause, CommandFlags, GripperFlags, OutputImage};
use wsg_protocol::command::{Command, CommandId};
use wsg_protocol::types::{GripperState, PrePositionFlags, SoftLimits, Status};

impl Controller {
    /// Sends a Stop. A jog is over once the gripper has answered both the Stop and the motion.
    pub(super) fn stop(&mut self) {
        if self.jog.is_on() {
            let unsent = self.outgoing.iter().any(|command| command.id() == CommandId::PrePosition);
            let ended = self.held_back.is_some_and(|(id, _)| id == CommandId::PrePosition);
            let motion_open = match self.jog.stage {
                Stage::Stops { motion_open, .. } => motion_open,
                _ => !unsent && !ended && self.motion.is_some_and(|motion| motion.awaits.is_none()),
            };
            self.jog.stage = Stage::Stops { stop_open: true, motion_open };
        }
        self.send_alone(Command::Stop);
    }

    /// Queries the soft limits if they may be why the gripper refused a jog. Returns whether it sends the query.
    pub(super) fn jog_meets_soft_limit(&mut self, status: Status) -> bool {
        let Some(motion) = &mut self.motion else { return false };
        let runs = matches!(self.jog.stage, Stage::Runs(_));
        if !runs || self.jog.soft_limits.is_some() || status != Status::RangeError {
            return false;
        }
        motion.awaits = Some(CommandId::GetSoftLimits);
        self.send(Command::GetSoftLimits);
        true
    }

    fn end_jog_at_limit(&mut self) {
        self.note(Cause::Gripper, Some(CommandId::PrePosition), Status::RangeError.code());
        self.end_jog(Status::RangeError);
    }

    /// Ends a jog that finished by itself or did not start. GSTATE is IDLE, even after an error (fieldbus, 6.7).
    #[inline(never)]
    pub(super) fn end_jog(&mut self, status: Status) {
        self.jog.end(self.image.as_ref());
        self.motion = None;
        self.gstate = match status {
            Status::Success => Gstate::Result(GripperState::Idle),
            _ => Gstate::FailedJog,
        };
        self.status = StatusRegister::Ended(status);
    }
}

impl Informed<'_> {
    /// Starts, changes or stops the jog according to the flags.
    pub(super) fn follow_jog(&mut self) {
        let asked = self.own.jog.asked(self.own.image.as_ref());
        match (self.own.jog.stage, asked) {
            (Stage::Off, None) | (Stage::Stops { .. }, _) => {}
            (Stage::Off, Some(drive)) => self.begin_jog(drive),
            (Stage::Runs(running), Some(drive)) if running == drive => {}
            (Stage::Runs(_), Some(drive)) if self.jog_command(drive).is_none() => {
                self.jog_outside_limits(drive);
            }
            (Stage::Runs(_), _) => self.own.stop(),
        }
    }

    fn begin_jog(&mut self, drive: Drive) {
        let flags = self.own.image.unwrap_or_default().flags.intersection(CommandFlags::JOG);
        if !self.refuses(flags) {
            if self.own.state(self.known.state) == GripperFlags::HOLDING {
                self.own.show(Status::AccessDenied, Cause::PartHeld);
            } else if !self.has_room(drive) {
                self.own.end_jog_at_limit();
            } else if let Some((command, force)) = self.jog_command(drive) {
                self.begin_motion(command, Some(force));
                self.own.jog.stage = Stage::Runs(drive);
                return;
            } else {
                self.jog_outside_limits(drive);
            }
        }
        self.own.jog.disarm(self.own.image.as_ref());
    }

    fn jog_outside_limits(&mut self, drive: Drive) {
        // SPEED 0 selects the minimum speed.
        let least = self.known.limits.map_or(0, |limits| (limits.min_speed * 100.0) as u16);
        let speed = if drive.speed == 0 { least } else { drive.speed };
        self.outside_limits(&OutputImage { speed, force_limit: drive.force_limit, ..OutputImage::ZERO });
    }

    /// Sends the jog to the soft limit in its direction, unless the fingers are at or beyond it.
    pub(super) fn jog_within(&mut self, limits: SoftLimits) {
        self.own.jog.soft_limits = Some(limits);
        let Stage::Runs(drive) = self.own.jog.stage else { return };
        match self.jog_command(drive) {
            Some((command, _)) if self.has_room(drive) => {
                self.own.motion = Some(Motion { command, awaits: None });
                self.own.send(command);
            }
            _ => self.own.end_jog_at_limit(),
        }
    }

    /// Returns whether the fingers may still move in the jog's direction. Beyond a soft limit, a Pre-position to that
    /// limit would reverse the direction.
    fn has_room(&self, drive: Drive) -> bool {
        let Some(limits) = self.own.jog.soft_limits else { return true };
        self.known.width.is_some_and(|width| match drive.direction {
            Direction::Plus => width < limits.plus,
            Direction::Minus => width > limits.minus,
        })
    }

    /// Returns the jog's Pre-position and force limit in N, or `None` if they are outside the gripper's limits.
    fn jog_command(&self, drive: Drive) -> Option<(Command<'static>, f32)> {
        let image = OutputImage { speed: drive.speed, force_limit: drive.force_limit, ..OutputImage::ZERO };
        let limits = self.known.limits?;
        let speed = if drive.speed == 0 { limits.min_speed } else { image.speed_mm_s() };
        let force = image.force_limit_n(force_unit(self.known));
        let width = match (drive.direction, self.own.jog.soft_limits) {
            (Direction::Plus, Some(soft)) => soft.plus,
            (Direction::Plus, None) => limits.stroke,
            (Direction::Minus, Some(soft)) => soft.minus,
            (Direction::Minus, None) => 0.0,
        };
        let command = Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed };
        self.within_limits(speed, force).then_some((command, force))
    }

    /// Handles the answer to a jog's Stop, or to the stopped motion. A Stop that failed leaves the fingers moving,
    /// which requires a FAST STOP.
    pub(super) fn jog_stopped(&mut self, id: CommandId, status: Status) {
        let Stage::Stops { mut stop_open, mut motion_open } = self.own.jog.stage else { return };
        match id {
            CommandId::Stop if status != Status::Success && !self.stands() => {
                return self.own.fast_stop(Cause::StopFailed, status.code());
            }
            CommandId::Stop => stop_open = false,
            CommandId::PrePosition => motion_open = false,
            _ => return,
        }
        if stop_open || motion_open {
            self.own.jog.stage = Stage::Stops { stop_open, motion_open };
        } else {
            self.own.jog.stage = Stage::Off;
            self.follow_jog();
        }
    }
}
