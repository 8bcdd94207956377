//! Progress of running motions, step by step, and their end (command set, 3.2 and appendix C).

use super::{EarlyBlock, Grip, HomingPhase, Motion, MotionControl, NOTHING, Task};
use crate::axis::{Block, Direction, Obstacle, Part};
use crate::port::Completion;
use crate::time::{Time, earlier};
use wsg_protocol::{CommandId, GripperState, Status};

/// Interval between two steps of the axis, in microseconds.
const STEP_MICROS: u64 = 1_000;
/// Longest travel time calculated in one piece, in seconds.
const LONGEST_STRETCH_S: f64 = 0.001;
/// Distance by which the fingers back off from the reference point while homing, in mm. Assumed.
const BACK_OFF: f64 = 1.0;
/// Speed of backing off and returning, in mm/s. Assumed.
const BACK_OFF_SPEED: f64 = 20.0;

impl MotionControl {
    /// Takes the ended motion that has not been answered.
    pub(crate) const fn take_completion(&mut self) -> Option<Completion> {
        self.ended.take()
    }

    /// Returns the time of the next step or time-out.
    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        let step = self.needs_step().then(|| now.next_on_grid(STEP_MICROS));
        earlier(step, self.times_out_at())
    }

    /// Processes the events due at `now`; `before` is the time up to which all events have been processed.
    pub(crate) fn run_due(&mut self, before: Time, now: Time) {
        if self.needs_step() && before.next_on_grid(STEP_MICROS) <= now {
            self.step_axis();
        }
        if self.times_out_at().is_some_and(|deadline| deadline <= now) {
            self.fail(Status::Timeout);
        }
    }

    fn times_out_at(&self) -> Option<Time> {
        self.motion?.deadline
    }

    /// Places or removes the part.
    pub(crate) fn set_part(&mut self, part: Option<Part>) {
        self.axis.set_part(part);
        self.watch_part();
    }

    /// Jams or frees the axis.
    pub(crate) fn set_jammed(&mut self, on: bool) {
        self.axis.set_jammed(on);
        self.watch_part();
    }

    /// Returns whether a step of the axis changes anything. A motion to the current position, or against an obstacle,
    /// ends after one step.
    fn needs_step(&self) -> bool {
        self.axis.is_active() || (self.motion.is_some() && (self.is_fresh || self.axis.has_arrived()))
    }

    fn step_axis(&mut self) {
        let step_s = STEP_MICROS as f64 / 1e6 * self.time_scale;
        let whole = (step_s / LONGEST_STRETCH_S) as u32;
        let stretches = if step_s > f64::from(whole) * LONGEST_STRETCH_S { whole + 1 } else { whole };
        let stretch_s = step_s / f64::from(stretches);
        for _ in 0..stretches {
            let before = self.width();
            self.is_fresh = false;
            self.axis.step(stretch_s);
            self.follow_motion(before);
            if !self.axis.is_active() {
                break;
            }
        }
    }

    /// Advances the motion after a step of the axis; `before` is the width before the step.
    fn follow_motion(&mut self, before: f64) {
        if self.entered_restricted_area(before) {
            return;
        }
        let Some(motion) = self.motion else {
            self.watch_part();
            // Fingers that clamped on a part reach their target once the part is removed (command set, 3.2.2 and appendix B).
            self.target_reached |= self.axis.has_arrived();
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
                // The drive keeps pushing, and continues to its target if the path clears.
                Some(_) => self.end_in(GripperState::Error, Status::AxisBlocked),
                None => self.succeed_on_arrival(),
            },
            Task::Grip(grip) => self.follow_grip(grip, motion),
            // The obstacle may give way; otherwise only the time-out ends a release.
            Task::Release => self.succeed_on_arrival(),
            // The drive keeps pushing against an obstacle with the force limit.
            Task::Run => self.succeed_on_arrival(),
        }
    }

    /// Detects the loss of a held part.
    fn watch_part(&mut self) {
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
            // Grip Part (25h) has no tolerance parameter. A clamping travel of at least the stroke accepts a part anywhere.
            let is_anywhere = block.obstacle == Obstacle::Part
                && grip.early_block == EarlyBlock::NoPart
                && grip.clamping_travel >= self.stroke();
            if self.axis.builds_up() {
                // A part counts as gripped only once the force is established.
            } else if is_anywhere || past(grip.nominal - sign * grip.tolerance) {
                self.state = GripperState::Holding;
                self.end_motion(Status::Success);
            } else if grip.early_block == EarlyBlock::AxisBlocked {
                self.axis.switch_off();
                self.end_in(GripperState::Error, Status::AxisBlocked);
            } else if block.obstacle == Obstacle::Part {
                self.find_no_part();
            }
            // A jammed axis does not indicate a part: the fingers keep pushing until the time-out.
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

    /// Executes a FAST STOP if the last step moved the fingers out of the soft limits, or further out.
    fn entered_restricted_area(&mut self, before: f64) -> bool {
        let is_homing = self.motion.is_some_and(|motion| matches!(motion.task, Task::Homing(..)));
        let Some(limits) = self.settings.soft_limits().filter(|_| self.referenced && !is_homing) else {
            return false;
        };
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

    pub(super) fn end_motion(&mut self, status: Status) {
        if let Some(motion) = self.motion.take() {
            self.ended = Some(Completion { port: motion.port, id: motion.id, status });
        }
    }
}
