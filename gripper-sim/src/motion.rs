//! Motions: how they start, why they are refused, and how they end (command set, 3.2 and appendix C).
//!
//! Independent of sensor fingers and temperature; of a client it keeps only the port to answer.

mod gcl;
mod progress;

pub(crate) use gcl::GripOrder;

use crate::axis::{Axis, Direction, Travel};
use crate::config::Config;
use crate::model::Parameters;
use crate::port::{Completion, PortId, Request};
use crate::settings::Settings;
use crate::time::Time;
use wsg_protocol::{
    CommandId, GripperState, GrippingStatistics, HomingDirection, PrePositionFlags, Status, SystemFlags,
};

/// How far beyond the stroke homing searches for the end stop, in mm.
const BEYOND_THE_END: f64 = 10.0;
/// Fraction of the nominal force with which a pre-position clamps on a block (command set, 3.2.2).
const CLAMP_ON_BLOCK: f64 = 0.5;
/// A motion times out after this many times its nominal duration plus [`TIME_OUT_MS`]. Assumed.
const TIME_OUT_FACTOR: f64 = 2.0;
/// Shortest time-out of a motion, in ms. Assumed.
const TIME_OUT_MS: u64 = 1_000;
/// Tolerance in mm below which a distance counts as zero.
const NOTHING: f64 = 1e-6;
/// Distance in mm from a soft limit within which a width counts as at the limit.
const AT_LIMIT: f64 = 1e-6;

/// A motion command in progress.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    id: CommandId,
    port: PortId,
    task: Task,
    /// Time at which the motion times out; `None` in velocity mode.
    deadline: Option<Time>,
}

#[derive(Clone, Copy, Debug)]
enum Task {
    Homing(Direction, HomingPhase),
    PrePosition {
        stop_on_block: bool,
    },
    Grip(Grip),
    Release,
    /// Velocity mode of scripts, replaced by any other command.
    Run,
}

#[derive(Clone, Copy, Debug)]
enum HomingPhase {
    /// Towards the end stop.
    Seek,
    /// Backing off from it.
    BackOff,
    /// Towards it again, slowly.
    Return,
}

/// A grip. Widths are in mm, as the gripper counts them.
#[derive(Clone, Copy, Debug)]
struct Grip {
    direction: Direction,
    nominal: f64,
    /// End of the clamping travel, measured from the nominal width or from an earlier contact (GCL manual, 2.2.6).
    end: f64,
    met: bool,
    /// How far before the nominal width the part may be met, in mm.
    tolerance: f64,
    /// How far the grip may continue from there, in mm.
    clamping_travel: f64,
    early_block: EarlyBlock,
}

/// How a grip treats a block before its tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum EarlyBlock {
    /// No part was found (command set, 3.2.6).
    NoPart,
    /// The fingers have collided (GCL, 2.2.3).
    AxisBlocked,
}

/// The axis under the control of motion commands.
#[derive(Clone, Debug)]
pub(crate) struct MotionControl {
    parameters: &'static Parameters,
    homing_default: Direction,
    /// Speed of homing in mm/s.
    homing_speed: f64,
    /// Default clamping travel beyond the nominal width, in mm.
    clamping_travel: f64,
    /// Default distance before the nominal width at which a part may be met, in mm.
    part_width_tolerance: f64,
    time_scale: f64,
    settings: Settings,
    axis: Axis,
    /// Real opening width minus the width as the gripper counts it, in mm. Nonzero only if something other than an end
    /// stop ended the last homing.
    origin: f64,
    referenced: bool,
    state: GripperState,
    motion: Option<Motion>,
    /// Whether the drive has made no step since it was started.
    is_fresh: bool,
    /// The motion that ended last and has not been answered.
    ended: Option<Completion>,
    /// Direction of the last grip, as long as its outcome stands.
    grip_direction: Option<Direction>,
    statistics: GrippingStatistics,
    fast_stop_latched: bool,
    /// Whether a fault disables the drive until it ends.
    disabled: bool,
    axis_stopped: bool,
    target_reached: bool,
}

impl MotionControl {
    /// Returns the fingers half open and not referenced, at rest or homing as configured (fieldbus, 6.4).
    pub(crate) fn new(config: &Config) -> Self {
        let mut control = Self::at_rest(config);
        if config.homing_at_start {
            let request = Request { port: PortId::HAND, now: Time::ZERO };
            control.start_homing(request, HomingDirection::Default);
        }
        control
    }

    fn at_rest(config: &Config) -> Self {
        let parameters = config.model.parameters();
        let limits = &parameters.limits;
        let mut control = Self {
            parameters,
            homing_default: config.homing_default,
            homing_speed: 0.0,
            clamping_travel: 0.0,
            part_width_tolerance: 0.0,
            time_scale: 1.0,
            settings: Settings::new(config),
            axis: Axis::new(limits.stroke.into(), limits.max_speed.into(), config.part),
            origin: 0.0,
            referenced: false,
            state: GripperState::Idle,
            motion: None,
            is_fresh: false,
            ended: None,
            grip_direction: None,
            statistics: GrippingStatistics::default(),
            fast_stop_latched: false,
            disabled: false,
            axis_stopped: false,
            target_reached: false,
        };
        control.reconfigure(config);
        control
    }

    /// Takes over the settings of the following motions. Reference and state stay.
    pub(crate) fn reconfigure(&mut self, config: &Config) {
        let limits = &self.parameters.limits;
        let time_scale = config.time_scale.clamp(Config::MIN_TIME_SCALE, Config::MAX_TIME_SCALE);
        self.homing_default = config.homing_default;
        self.homing_speed = config
            .homing_speed
            .map_or(self.parameters.homing_speed, |speed| speed.max(limits.min_speed).min(limits.max_speed))
            .into();
        self.clamping_travel = config.clamping_travel.into();
        self.part_width_tolerance = config.part_width_tolerance.into();
        self.time_scale = time_scale.into();
    }

    /// Returns whether a motion command is in progress or the fingers move.
    pub(crate) fn is_running(&self) -> bool {
        self.motion.is_some() || self.axis.is_moving()
    }

    /// Returns whether the fingers move, or a motion is in progress that the next one cannot replace.
    pub(crate) fn is_busy(&self) -> bool {
        self.axis.is_moving() || (self.motion.is_some() && !self.runs())
    }

    pub(crate) const fn settings(&self) -> &Settings {
        &self.settings
    }

    pub(crate) const fn settings_mut(&mut self) -> &mut Settings {
        &mut self.settings
    }

    pub(crate) const fn state(&self) -> GripperState {
        self.state
    }

    pub(crate) const fn is_referenced(&self) -> bool {
        self.referenced
    }

    pub(crate) const fn is_fast_stopped(&self) -> bool {
        self.fast_stop_latched
    }

    pub(crate) const fn statistics(&self) -> GrippingStatistics {
        self.statistics
    }

    pub(crate) fn reset_statistics(&mut self) {
        self.statistics = GrippingStatistics::default();
    }

    /// The opening width as the gripper counts it, in mm.
    pub(crate) fn width(&self) -> f64 {
        self.axis.width() - self.origin
    }

    /// Returns the axis: the real opening width, its change, the force on the fingers, and the part.
    pub(crate) const fn axis(&self) -> &Axis {
        &self.axis
    }

    /// Returns the system state flags of the axis and its motions (command set, appendix B).
    pub(crate) fn flags(&self) -> SystemFlags {
        let blocked = self.axis.block().map(|block| block.direction);
        let (below, above) = match self.settings.soft_limits() {
            Some(limits) if self.referenced => (
                self.width() <= f64::from(limits.minus) + AT_LIMIT,
                self.width() >= f64::from(limits.plus) - AT_LIMIT,
            ),
            _ => (false, false),
        };
        let mut flags = SystemFlags::empty();
        for (flag, is_set) in [
            (SystemFlags::REFERENCED, self.referenced),
            (SystemFlags::MOVING, self.axis.is_moving()),
            (SystemFlags::BLOCKED_MINUS, blocked == Some(Direction::Minus)),
            (SystemFlags::BLOCKED_PLUS, blocked == Some(Direction::Plus)),
            (SystemFlags::SOFT_LIMIT_MINUS, below),
            (SystemFlags::SOFT_LIMIT_PLUS, above),
            (SystemFlags::AXIS_STOPPED, self.axis_stopped),
            (SystemFlags::TARGET_POS_REACHED, self.target_reached),
            (SystemFlags::OVERDRIVE_MODE, self.settings.is_overdrive()),
            (SystemFlags::FAST_STOP, self.fast_stop_latched),
        ] {
            flags.set(flag, is_set);
        }
        flags
    }

    /// Executes Homing (20h) and returns its first status.
    pub(crate) fn start_homing(&mut self, request: Request, direction: HomingDirection) -> Status {
        if let Err(refused) = self.may_move() {
            return refused;
        }
        let direction = match direction {
            HomingDirection::Default => self.homing_default,
            HomingDirection::Positive => Direction::Plus,
            HomingDirection::Negative => Direction::Minus,
        };
        self.referenced = false;
        // Without a reference the position is unknown, so the target lies a whole stroke and more ahead.
        let reach = self.stroke() + BEYOND_THE_END;
        let target = self.width() + direction.sign() * reach;
        let travel = self.homing_travel(target, self.homing_speed);
        let task = Task::Homing(direction, HomingPhase::Seek);
        self.start(request, CommandId::Homing, task, travel, GripperState::Positioning)
    }

    /// Executes Pre-position Fingers (21h).
    pub(crate) fn start_pre_position(
        &mut self,
        request: Request,
        flags: PrePositionFlags,
        width: f32,
        speed: f32,
    ) -> Status {
        // A pre-position neither grips nor releases a part (command set, 3.2.2; GCL, 2.2.2).
        if self.state == GripperState::Holding {
            return Status::AlreadyRunning;
        }
        let from = if flags.contains(PrePositionFlags::RELATIVE) { self.width() } else { 0.0 };
        let target = from + f64::from(width);
        if let Err(refused) = self.may_go_to(target) {
            return refused;
        }
        let target = target.max(0.0).min(self.stroke());
        let stop_on_block = flags.contains(PrePositionFlags::STOP_ON_BLOCK);
        let force = if stop_on_block {
            self.settings.force_limit().into()
        } else {
            f64::from(self.parameters.limits.nominal_force) * CLAMP_ON_BLOCK
        };
        let travel = self.travel(target, speed, force);
        let task = Task::PrePosition { stop_on_block };
        self.start(request, CommandId::PrePosition, task, travel, GripperState::Positioning)
    }

    /// Executes Grip Part (25h).
    pub(crate) fn start_grip(&mut self, request: Request, width: f32, speed: f32) -> Status {
        if let Err(refused) = self.may_go_to(width.into()) {
            return refused;
        }
        let nominal = f64::from(width).max(0.0).min(self.stroke());
        let clamping_travel = self.clamping_travel;
        let direction = match self.grip_direction {
            Some(direction) if self.lies_beyond(direction, nominal) => return Status::RangeError,
            Some(direction) => direction,
            None => Direction::of(nominal - self.width()),
        };
        let end = self.clamping_end(direction, nominal, clamping_travel);
        let travel = self.travel(end, speed, self.settings.force_limit().into());
        let grip = Grip {
            direction,
            nominal,
            end,
            met: false,
            tolerance: self.part_width_tolerance,
            clamping_travel,
            early_block: EarlyBlock::NoPart,
        };
        self.start_gripping(request, grip, travel)
    }

    /// Starts a grip and counts it.
    fn start_gripping(&mut self, request: Request, grip: Grip, travel: Travel) -> Status {
        let task = Task::Grip(grip);
        let status = self.start(request, CommandId::GripPart, task, travel, GripperState::Gripping);
        self.grip_direction = Some(grip.direction);
        self.statistics.total = self.statistics.total.saturating_add(1);
        status
    }

    /// Executes Release Part (26h).
    pub(crate) fn start_release(&mut self, request: Request, width: f32, speed: f32) -> Status {
        self.release_to(request, width.into(), speed)
    }

    /// Starts a release to this width in mm.
    fn release_to(&mut self, request: Request, target: f64, speed: f32) -> Status {
        if let Err(refused) = self.may_go_to(target) {
            return refused;
        }
        let travel = self.release_travel(target.max(0.0).min(self.stroke()), speed);
        self.start(request, CommandId::ReleasePart, Task::Release, travel, GripperState::Releasing)
    }

    /// Starts velocity mode of scripts at this speed in mm/s, negative to close the fingers. The fingers move until the
    /// next speed, 0 included, another command, or the end of the stroke or of a soft limit. They push against an
    /// obstacle with the force limit. It replaces a running motion and keeps the current speed if the direction stays the same.
    pub(crate) fn run_at(&mut self, request: Request, speed: f32) -> Status {
        if self.fast_stop_latched || self.disabled {
            return Status::AccessDenied;
        }
        if !self.referenced {
            return Status::NotInitialized;
        }
        let runs = self.runs();
        if speed == 0.0 || !speed.is_finite() {
            self.halt_motion(if runs { Status::Success } else { Status::CmdAborted });
            return Status::Success;
        }
        if !runs {
            self.end_motion(Status::CmdAborted);
        }
        let here = self.width();
        let (minus, plus) = match self.settings.soft_limits() {
            Some(limits) => (f64::from(limits.minus).min(here), f64::from(limits.plus).max(here)),
            None => (0.0, self.stroke()),
        };
        let target = if speed < 0.0 { minus } else { plus };
        let travel = self.travel(target, speed.abs(), self.settings.force_limit().into());
        let had = self.axis.speed();
        let status =
            self.start(request, CommandId::PrePosition, Task::Run, travel, GripperState::Positioning);
        self.axis.keep_speed(had);
        status
    }

    /// Sets the speed in mm/s at which a motion begins that replaces another one in the same direction.
    pub(crate) fn keep_speed(&mut self, speed: f64) {
        self.axis.keep_speed(speed);
    }

    /// Executes Stop (22h): ends any motion and the monitoring of a held part.
    pub(crate) fn stop(&mut self) {
        self.axis.halt();
        self.axis_stopped = true;
        if self.state != GripperState::Error {
            self.state = GripperState::Idle;
        }
        self.grip_direction = None;
        self.end_motion(Status::CmdAborted);
    }

    /// Executes FAST STOP (23h), or the same on a fault. A motion that it ends is answered with `status`.
    pub(crate) fn fast_stop(&mut self, status: Status) {
        self.axis.halt();
        self.fast_stop_latched = true;
        self.state = GripperState::Error;
        self.grip_direction = None;
        self.end_motion(status);
    }

    /// Disables or enables the drive. Disabling it ends a running motion and the force on a held part, without a FAST STOP;
    /// motion commands are refused until the drive is enabled (appendix B, D14 and D15).
    pub(crate) fn set_disabled(&mut self, on: bool) {
        if on && !self.disabled {
            if self.motion.is_some() || self.axis.is_moving() || self.axis.force() > 0.0 {
                self.state = GripperState::Error;
                self.grip_direction = None;
            }
            self.axis.halt();
            self.end_motion(Status::CmdAborted);
        }
        self.disabled = on;
    }

    /// Executes Acknowledge (24h): unlatches FAST STOP and leaves the error state.
    pub(crate) fn acknowledge(&mut self) {
        self.fast_stop_latched = false;
        if self.state == GripperState::Error {
            self.state = GripperState::Idle;
        }
    }

    /// Ends every finger movement and nothing else (Disconnect Announcement, command set 3.1.2): a running motion, or
    /// fingers that snap to their target once the part is removed.
    pub(crate) fn abort(&mut self) {
        if self.motion.is_none() && self.axis.is_moving() {
            self.axis.halt();
        }
        self.halt_motion(Status::CmdAborted);
    }

    fn halt_motion(&mut self, status: Status) {
        if self.motion.is_some() {
            self.axis.halt();
            self.state = GripperState::Idle;
            self.grip_direction = None;
            self.end_motion(status);
        }
    }

    /// Returns whether velocity mode is active.
    fn runs(&self) -> bool {
        self.motion.is_some_and(|motion| matches!(motion.task, Task::Run))
    }

    /// Starts a motion and returns E_CMD_PENDING.
    fn start(
        &mut self,
        request: Request,
        id: CommandId,
        task: Task,
        travel: Travel,
        state: GripperState,
    ) -> Status {
        let deadline = (!matches!(task, Task::Run)).then(|| self.deadline(request.now, &travel));
        self.motion = Some(Motion { id, port: request.port, task, deadline });
        self.drive(travel);
        self.state = state;
        self.grip_direction = None;
        self.axis_stopped = false;
        self.target_reached = false;
        Status::CmdPending
    }

    /// Starts the axis towards a target, given as the gripper counts widths.
    fn drive(&mut self, travel: Travel) {
        self.is_fresh = true;
        self.axis.start(Travel { target: travel.target + self.origin, ..travel });
    }

    /// Returns the time at which a travel that starts now times out. Time-outs do not shrink with the time scale, but
    /// they grow when it slows the fingers down.
    fn deadline(&self, now: Time, travel: &Travel) -> Time {
        let distance = (travel.target - self.width()).abs();
        let needed_s = distance / travel.speed + travel.speed / travel.acceleration;
        let slowness = 1.0 / self.time_scale.min(1.0);
        let needed_ms = (needed_s * slowness * TIME_OUT_FACTOR * 1_000.0) as u64;
        now.plus_millis(TIME_OUT_MS + needed_ms)
    }

    fn may_move(&self) -> Result<(), Status> {
        if self.fast_stop_latched || self.disabled {
            Err(Status::AccessDenied)
        } else if self.is_busy() && !self.runs() {
            Err(Status::AlreadyRunning)
        } else {
            Ok(())
        }
    }

    /// Returns why the fingers may not go to this width: "an error for every motion command whose target lies outside"
    /// the soft limits (command set, 3.3.5).
    fn may_go_to(&self, target: f64) -> Result<(), Status> {
        self.may_move()?;
        if !self.referenced {
            return Err(Status::NotInitialized);
        }
        // Also from outside the soft limits: only a target inside leads out of the restricted area.
        let is_allowed = self.settings.soft_limits().is_none_or(|limits| {
            target >= f64::from(limits.minus) - AT_LIMIT && target <= f64::from(limits.plus) + AT_LIMIT
        });
        if is_allowed { Ok(()) } else { Err(Status::RangeError) }
    }

    /// Returns whether a grip in this direction has already passed `nominal`.
    fn lies_beyond(&self, direction: Direction, nominal: f64) -> bool {
        let end = self.clamping_end(direction, nominal, self.clamping_travel);
        (end - self.width()) * direction.sign() < -NOTHING
    }

    /// Returns the end of the clamping travel that begins at `from`, kept within soft limits and end stops.
    fn clamping_end(&self, direction: Direction, from: f64, clamping_travel: f64) -> f64 {
        let end = from + direction.sign() * clamping_travel;
        let (minus, plus) = match self.settings.soft_limits() {
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
            speed: speed.max(limits.min_speed).min(limits.max_speed).into(),
            acceleration: self.settings.acceleration().into(),
            force,
            squeeze: force,
        }
    }

    /// A release pushes with the nominal force but does not squeeze the part (fieldbus, 6.3).
    fn release_travel(&self, target: f64, speed: f32) -> Travel {
        let limits = &self.parameters.limits;
        let nominal = limits.nominal_force.into();
        let squeeze = self.axis.force().max(limits.min_force.into()).min(nominal);
        Travel { squeeze, ..self.travel(target, speed, nominal) }
    }

    fn homing_travel(&self, target: f64, speed: f64) -> Travel {
        let force = self.parameters.limits.min_force.into();
        Travel { target, speed, acceleration: self.settings.acceleration().into(), force, squeeze: force }
    }

    fn stroke(&self) -> f64 {
        self.parameters.limits.stroke.into()
    }
}
