//! Motions: how they start, what they are refused for, and how they end (command set, 3.2 and appendix C).

mod gcl;

pub(crate) use gcl::GripOrder;

use crate::axis::{Block, Direction, Obstacle, Travel};
use crate::device::{Completion, Device};
use crate::port::PortId;
use crate::time::Time;
use wsg_protocol::{CommandId, GripperState, HomingDirection, PrePositionFlags, Status};

/// How far beyond a reference point the fingers back off while homing, in mm. Assumed.
const BACK_OFF: f64 = 1.0;
/// Speed of backing off, in mm/s. Assumed.
const BACK_OFF_SPEED: f64 = 20.0;
/// How much further than the stroke homing looks for the end stop, in mm.
const BEYOND_THE_END: f64 = 10.0;
/// Part of the nominal force with which a pre-position clamps on a block (command set, 3.2.2).
const CLAMP_ON_BLOCK: f64 = 0.5;
/// A motion times out after this many times the time it needs, and [`TIME_OUT_MS`]. Assumed.
const TIME_OUT_FACTOR: f64 = 2.0;
/// What a motion may last at least, in ms. Assumed.
const TIME_OUT_MS: u64 = 1_000;
/// A distance in mm that counts as none.
const NOTHING: f64 = 1e-6;

/// A motion command that is being carried out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    id: CommandId,
    port: PortId,
    task: Task,
    pub(crate) deadline: Time,
}

#[derive(Clone, Copy, Debug)]
enum Task {
    Homing(Direction, HomingPhase),
    PrePosition { stop_on_block: bool },
    Grip(Grip),
    Release,
}

#[derive(Clone, Copy, Debug)]
enum HomingPhase {
    /// To the end stop.
    Seek,
    /// A little away from it.
    BackOff,
    /// And to it again.
    Return,
}

/// A grip: widths in mm as the gripper believes in them.
#[derive(Clone, Copy, Debug)]
struct Grip {
    direction: Direction,
    nominal: f64,
    /// Where the clamping travel ends: from the nominal width, or from where a part was met before (GCL manual, 2.2.6).
    end: f64,
    met: bool,
    /// How much before the nominal width a part may be met, in mm.
    tolerance: f64,
    /// How far the grip may go on from there, in mm.
    clamping_travel: f64,
    early_block: EarlyBlock,
}

/// What a grip makes of a block before its tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum EarlyBlock {
    /// It is no part (command set, 3.2.6).
    NoPart,
    /// It is a collision (GCL, 2.2.3).
    AxisBlocked,
}

/// Who asked for a motion, and when.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Request {
    pub(crate) port: PortId,
    pub(crate) now: Time,
}

impl Device {
    /// Homing (20h).
    pub(crate) fn start_homing(&mut self, request: Request, direction: HomingDirection) -> Status {
        if let Err(refused) = self.may_move() {
            return refused;
        }
        let direction = match direction {
            HomingDirection::Default => self.config.homing_default,
            HomingDirection::Positive => Direction::Plus,
            HomingDirection::Negative => Direction::Minus,
        };
        self.referenced = false;
        // Without a reference the gripper believes in nothing; the whole stroke and more lies ahead of it.
        let reach = self.stroke() + BEYOND_THE_END;
        let target = self.width() + direction.sign() * reach;
        let travel = self.homing_travel(target, self.parameters.homing_speed.into());
        let task = Task::Homing(direction, HomingPhase::Seek);
        self.start(request, CommandId::Homing, task, travel, GripperState::Positioning)
    }

    /// Pre-position Fingers (21h).
    pub(crate) fn start_pre_position(
        &mut self,
        request: Request,
        flags: PrePositionFlags,
        width: f32,
        speed: f32,
    ) -> Status {
        let from = if flags.contains(PrePositionFlags::RELATIVE) { self.width() } else { 0.0 };
        let target = (from + f64::from(width)).clamp(0.0, self.stroke());
        if let Err(refused) = self.may_go_to(target) {
            return refused;
        }
        let stop_on_block = flags.contains(PrePositionFlags::STOP_ON_BLOCK);
        let force = if stop_on_block {
            self.force_limit.into()
        } else {
            f64::from(self.parameters.limits.nominal_force) * CLAMP_ON_BLOCK
        };
        let travel = self.travel(target, speed, force);
        let task = Task::PrePosition { stop_on_block };
        self.start(request, CommandId::PrePosition, task, travel, GripperState::Positioning)
    }

    /// Grip Part (25h).
    pub(crate) fn start_grip(&mut self, request: Request, width: f32, speed: f32) -> Status {
        let nominal = f64::from(width).clamp(0.0, self.stroke());
        if let Err(refused) = self.may_go_to(nominal) {
            return refused;
        }
        let clamping_travel = f64::from(self.config.clamping_travel);
        let direction = match self.grip_direction {
            Some(direction) if self.lies_behind(direction, nominal) => return Status::RangeError,
            Some(direction) => direction,
            None => Direction::of(nominal - self.width()),
        };
        let end = self.clamping_end(direction, nominal, clamping_travel);
        let travel = self.travel(end, speed, self.force_limit.into());
        let task = Task::Grip(Grip {
            direction,
            nominal,
            end,
            met: false,
            tolerance: self.config.part_width_tolerance.into(),
            clamping_travel,
            early_block: EarlyBlock::NoPart,
        });
        let status = self.start(request, CommandId::GripPart, task, travel, GripperState::Gripping);
        self.grip_direction = Some(direction);
        self.statistics.total = self.statistics.total.saturating_add(1);
        status
    }

    /// Release Part (26h).
    pub(crate) fn start_release(&mut self, request: Request, width: f32, speed: f32) -> Status {
        let target = f64::from(width).clamp(0.0, self.stroke());
        if let Err(refused) = self.may_go_to(target) {
            return refused;
        }
        let travel = self.travel(target, speed, self.force_limit.into());
        self.start(request, CommandId::ReleasePart, Task::Release, travel, GripperState::Releasing)
    }

    /// Stop (22h): ends any motion, and the monitoring of a part that is held.
    pub(crate) fn stop(&mut self) {
        self.axis.halt();
        self.axis_stopped = true;
        if self.state != GripperState::Error {
            self.state = GripperState::Idle;
        }
        self.grip_direction = None;
        self.end_motion(Status::CmdAborted);
    }

    /// FAST STOP (23h), or what a fault causes. A motion that it ends is answered with `status`.
    pub(crate) fn fast_stop(&mut self, status: Status) {
        self.axis.halt();
        self.fast_stop_latched = true;
        self.state = GripperState::Error;
        self.grip_direction = None;
        self.end_motion(status);
    }

    /// Acknowledge (24h). A FAST STOP stays as long as its cause lasts (appendix B, D16).
    pub(crate) fn acknowledge(&mut self) {
        if self.has_lasting_fault() {
            return;
        }
        self.fast_stop_latched = false;
        if self.state == GripperState::Error {
            self.state = GripperState::Idle;
        }
    }

    /// Ends a running motion and nothing else (Disconnect Announcement, command set 3.1.2).
    pub(crate) fn abort_motion(&mut self) {
        if self.motion.is_some() {
            self.axis.halt();
            self.state = GripperState::Idle;
            self.grip_direction = None;
            self.end_motion(Status::CmdAborted);
        }
    }

    /// A motion has lasted too long.
    pub(crate) fn time_out(&mut self) {
        self.fail(Status::Timeout);
    }

    /// Follows the motion after a step of the axis; `before` is the width before it.
    pub(crate) fn follow_motion(&mut self, before: f64) {
        if self.entered_restricted_area(before) {
            return;
        }
        let Some(motion) = self.motion else {
            self.watch_part();
            return;
        };
        match motion.task {
            Task::Homing(direction, phase) => self.follow_homing(direction, phase),
            Task::PrePosition { stop_on_block } => match self.axis.block() {
                Some(Block { obstacle: Obstacle::EndStop, .. }) => self.fail(Status::RangeError),
                Some(_) if stop_on_block => {
                    self.axis.switch_off();
                    self.end_in(GripperState::Error, Status::AxisBlocked);
                }
                // The drive goes on pushing, and goes on to its target if the way becomes free.
                Some(_) => self.end_in(GripperState::Error, Status::AxisBlocked),
                None => self.succeed_on_arrival(),
            },
            Task::Grip(grip) => self.follow_grip(grip, motion),
            // What blocks a release may give way; there is no answer for it but the time-out.
            Task::Release => self.succeed_on_arrival(),
        }
    }

    /// Notices that a held part is gone.
    pub(crate) fn watch_part(&mut self) {
        if self.state == GripperState::Holding && self.motion.is_none() && self.axis.block().is_none() {
            self.axis.halt();
            self.state = GripperState::PartLost;
            self.statistics.part_lost = self.statistics.part_lost.saturating_add(1);
        }
    }

    fn follow_homing(&mut self, direction: Direction, phase: HomingPhase) {
        let reference = match direction {
            Direction::Plus => self.stroke(),
            Direction::Minus => 0.0,
        };
        let blocked = self.axis.block().is_some();
        let arrived = self.axis.has_arrived();
        match phase {
            HomingPhase::Seek if blocked => {
                self.origin = self.axis.width() - reference;
                let away = reference - direction.sign() * BACK_OFF;
                self.continue_homing(direction, HomingPhase::BackOff, away);
            }
            HomingPhase::BackOff if blocked => self.fail(Status::AxisBlocked),
            HomingPhase::BackOff if arrived => {
                self.continue_homing(direction, HomingPhase::Return, reference);
            }
            HomingPhase::Return if blocked || arrived => {
                self.referenced = true;
                self.succeed();
            }
            HomingPhase::Seek | HomingPhase::BackOff | HomingPhase::Return => {}
        }
    }

    fn continue_homing(&mut self, direction: Direction, phase: HomingPhase, target: f64) {
        self.drive(self.homing_travel(target, BACK_OFF_SPEED));
        if let Some(motion) = &mut self.motion {
            motion.task = Task::Homing(direction, phase);
        }
    }

    fn follow_grip(&mut self, mut grip: Grip, motion: Motion) {
        let width = self.width();
        let sign = grip.direction.sign();
        let past = |mark: f64| (width - mark) * sign >= -NOTHING;
        if let Some(block) = self.axis.block() {
            if past(grip.nominal - sign * grip.tolerance) {
                self.state = GripperState::Holding;
                self.end_motion(Status::Success);
            } else if grip.early_block == EarlyBlock::AxisBlocked {
                self.axis.switch_off();
                self.end_in(GripperState::Error, Status::AxisBlocked);
            } else if block.obstacle == Obstacle::Part {
                self.find_no_part();
            }
            // A jammed axis shows no part at all: the fingers go on pushing until the time-out.
            return;
        }
        if !grip.met && self.axis.penetration() > 0.0 {
            grip.met = true;
            let contact = width - sign * self.axis.penetration();
            if (contact - grip.nominal) * sign < 0.0 {
                grip.end = self.clamping_end(grip.direction, contact, grip.clamping_travel);
                self.axis.retarget(grip.end + self.origin);
            }
            self.motion = Some(Motion { task: Task::Grip(grip), ..motion });
        }
        if past(grip.end) {
            self.find_no_part();
        }
    }

    fn find_no_part(&mut self) {
        self.axis.halt();
        self.statistics.no_part = self.statistics.no_part.saturating_add(1);
        self.end_in(GripperState::NoPart, Status::CmdFailed);
    }

    /// FAST STOP when the last step took the fingers out of the soft limits, or further out.
    fn entered_restricted_area(&mut self, before: f64) -> bool {
        let is_homing = self.motion.is_some_and(|motion| matches!(motion.task, Task::Homing(..)));
        let Some(limits) = self.soft_limits.filter(|_| self.referenced && !is_homing) else { return false };
        let (width, speed) = (self.width(), self.axis.speed());
        let (minus, plus) = (f64::from(limits.minus), f64::from(limits.plus));
        let (limit, was_inside) = if width < minus - NOTHING && speed < 0.0 {
            (minus, before >= minus - NOTHING)
        } else if width > plus + NOTHING && speed > 0.0 {
            (plus, before <= plus + NOTHING)
        } else {
            return false;
        };
        if was_inside {
            self.axis.halt_at(limit + self.origin);
        }
        let is_pre_position = self.motion.is_some_and(|motion| motion.id == CommandId::PrePosition);
        self.fast_stop(if is_pre_position { Status::RangeError } else { Status::CmdAborted });
        true
    }

    fn succeed_on_arrival(&mut self) {
        if self.axis.has_arrived() {
            self.succeed();
        }
    }

    fn succeed(&mut self) {
        self.target_reached = true;
        self.end_in(GripperState::Idle, Status::Success);
    }

    fn fail(&mut self, status: Status) {
        self.axis.switch_off();
        self.end_in(GripperState::Error, status);
        self.grip_direction = None;
    }

    fn end_in(&mut self, state: GripperState, status: Status) {
        self.state = state;
        self.end_motion(status);
    }

    fn end_motion(&mut self, status: Status) {
        if let Some(motion) = self.motion.take() {
            self.ended_motion = Some(Completion { port: motion.port, id: motion.id, status });
        }
    }

    /// Sets the fingers in motion: E_CMD_PENDING.
    fn start(
        &mut self,
        request: Request,
        id: CommandId,
        task: Task,
        travel: Travel,
        state: GripperState,
    ) -> Status {
        self.motion =
            Some(Motion { id, port: request.port, task, deadline: self.deadline(request.now, &travel) });
        self.drive(travel);
        self.state = state;
        self.grip_direction = None;
        self.axis_stopped = false;
        self.target_reached = false;
        Status::CmdPending
    }

    /// Starts the axis towards a target in the widths that the gripper believes in.
    fn drive(&mut self, travel: Travel) {
        self.axis.start(Travel { target: travel.target + self.origin, ..travel });
    }

    /// When a travel that starts now has lasted too long. Time-outs do not shrink with the time scale, but they grow
    /// when the fingers are slowed down.
    fn deadline(&self, now: Time, travel: &Travel) -> Time {
        let distance = (travel.target - self.width()).abs();
        let needed_s = distance / travel.speed + travel.speed / travel.acceleration;
        let slowness = 1.0 / f64::from(self.config.time_scale.min(1.0));
        let needed_ms = (needed_s * slowness * TIME_OUT_FACTOR * 1_000.0) as u64;
        now.plus_millis(TIME_OUT_MS + needed_ms)
    }

    fn may_move(&self) -> Result<(), Status> {
        if self.fast_stop_latched || self.has_lasting_fault() {
            Err(Status::AccessDenied)
        } else if self.motion.is_some() || self.axis.is_moving() {
            Err(Status::AlreadyRunning)
        } else {
            Ok(())
        }
    }

    fn may_go_to(&self, target: f64) -> Result<(), Status> {
        self.may_move()?;
        if !self.referenced {
            return Err(Status::NotInitialized);
        }
        let Some(limits) = self.soft_limits else { return Ok(()) };
        let here = self.width();
        let (minus, plus) = (f64::from(limits.minus), f64::from(limits.plus));
        // Whoever is outside may go towards the limits (command set, 3.3.5), all the way or a part of it.
        let allowed = (minus.min(here)..=plus.max(here)).contains(&target);
        if allowed { Ok(()) } else { Err(Status::RangeError) }
    }

    /// Whether a grip in this direction cannot get at `nominal` any more.
    fn lies_behind(&self, direction: Direction, nominal: f64) -> bool {
        let end = self.clamping_end(direction, nominal, self.config.clamping_travel.into());
        (end - self.width()) * direction.sign() < -NOTHING
    }

    /// Where the clamping travel ends that begins at `from`; it stays clear of soft limits and end stops.
    fn clamping_end(&self, direction: Direction, from: f64, clamping_travel: f64) -> f64 {
        let end = from + direction.sign() * clamping_travel;
        let (minus, plus) = match self.soft_limits {
            Some(limits) => (f64::from(limits.minus).max(0.0), f64::from(limits.plus).min(self.stroke())),
            None => (0.0, self.stroke()),
        };
        match direction {
            Direction::Minus => end.max(minus),
            Direction::Plus => end.min(plus),
        }
    }

    fn travel(&self, target: f64, speed: f32, force: f64) -> Travel {
        let limits = &self.parameters.limits;
        Travel {
            target,
            speed: speed.clamp(limits.min_speed, limits.max_speed).into(),
            acceleration: self.acceleration.into(),
            force,
        }
    }

    fn homing_travel(&self, target: f64, speed: f64) -> Travel {
        let limits = &self.parameters.limits;
        Travel { target, speed, acceleration: self.acceleration.into(), force: limits.min_force.into() }
    }

    fn stroke(&self) -> f64 {
        self.parameters.limits.stroke.into()
    }
}
