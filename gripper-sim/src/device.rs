//! The gripper without its connections: settings, states, flags, and what they are made of.
//!
//! How motions start and end is in [`motion`](crate::motion), what the commands do in [`commands`](crate::commands).

use crate::axis::{Axis, Direction, Part};
use crate::config::{Config, Tag};
use crate::faults::Fault;
use crate::finger::{FingerPort, Jaw};
use crate::model::Parameters;
use crate::motion::Motion;
use crate::port::PortId;
use crate::thermal::Thermal;
use crate::time::Time;
use crate::updates::Readings;
use wsg_protocol::{CommandId, GripperState, GrippingStatistics, SoftLimits, Status, SystemFlags};

/// Microseconds from one step of the axis to the next.
const STEP_MICROS: u64 = 1_000;
/// The longest stretch of travel, in seconds, that is calculated at one go.
const LONGEST_STRETCH_S: f64 = 0.001;
/// How close in mm a width must be to a soft limit to count as at it.
const AT_LIMIT: f64 = 1e-6;
/// Time from switching a finger's supply on to its being ready (command set, 3.6.3).
const FINGER_START_UP_MS: u64 = 500;
/// How many fingers may be starting up at a time.
const MAX_STARTING_FINGERS: usize = 8;

/// The second answer to a command.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Completion {
    pub(crate) port: PortId,
    pub(crate) id: CommandId,
    pub(crate) status: Status,
}

/// The gripper without its connections.
#[derive(Clone, Debug)]
pub(crate) struct Device {
    pub(crate) config: Config,
    pub(crate) parameters: &'static Parameters,
    pub(crate) axis: Axis,
    /// How much wider the fingers really are than the gripper believes, in mm: 0 unless something other than an end
    /// stop ended the last homing.
    pub(crate) origin: f64,
    pub(crate) referenced: bool,
    pub(crate) state: GripperState,
    pub(crate) motion: Option<Motion>,
    /// Where the last grip went, as long as its outcome stands.
    pub(crate) grip_direction: Option<Direction>,
    pub(crate) acceleration: f32,
    pub(crate) force_limit: f32,
    pub(crate) overdrive: bool,
    pub(crate) soft_limits: Option<SoftLimits>,
    pub(crate) statistics: GrippingStatistics,
    pub(crate) tag: Tag,
    pub(crate) fingers: [FingerPort; 2],
    pub(crate) thermal: Thermal,
    pub(crate) fast_stop_latched: bool,
    pub(crate) axis_stopped: bool,
    pub(crate) target_reached: bool,
    pub(crate) command_failure: bool,
    supply_fault: bool,
    motor_fault: bool,
    /// The motion that ended last, to be answered.
    pub(crate) ended_motion: Option<Completion>,
    starting_fingers: heapless::Deque<(Time, PortId, CommandId), MAX_STARTING_FINGERS>,
    /// The data frame of a finger that is being answered with.
    pub(crate) finger_data: [u8; 4],
    /// Stretches of travel in one step, and the seconds of travel in each.
    stretches: u32,
    stretch_s: f64,
}

impl Device {
    pub(crate) fn new(config: Config) -> Self {
        let parameters = config.model.parameters();
        let scale =
            f64::from(config.time_scale).clamp(Config::MIN_TIME_SCALE.into(), Config::MAX_TIME_SCALE.into());
        let step_s = STEP_MICROS as f64 / 1e6 * scale;
        let whole = (step_s / LONGEST_STRETCH_S) as u32;
        let stretches = if step_s > f64::from(whole) * LONGEST_STRETCH_S { whole + 1 } else { whole };
        let limits = &parameters.limits;
        Self {
            axis: Axis::new(limits.stroke.into(), limits.max_speed.into(), config.part),
            origin: 0.0,
            referenced: false,
            state: GripperState::Idle,
            motion: None,
            grip_direction: None,
            acceleration: parameters.default_acceleration,
            force_limit: parameters.default_force,
            overdrive: false,
            soft_limits: None,
            statistics: GrippingStatistics::default(),
            tag: config.tag,
            fingers: config.fingers.map(FingerPort::new),
            thermal: Thermal::new(),
            fast_stop_latched: false,
            axis_stopped: false,
            target_reached: false,
            command_failure: false,
            supply_fault: false,
            motor_fault: false,
            ended_motion: None,
            starting_fingers: heapless::Deque::new(),
            finger_data: [0; 4],
            stretches,
            stretch_s: step_s / f64::from(stretches),
            config: Config { time_scale: scale as f32, ..config },
            parameters,
        }
    }

    /// The opening width that the gripper believes in, in mm.
    pub(crate) fn width(&self) -> f64 {
        self.axis.width() - self.origin
    }

    /// What Get Opening Width answers, in mm: 0 while the fingers are not referenced (command set, 3.4.4).
    pub(crate) fn reported_width(&self) -> f32 {
        if self.referenced { self.width() as f32 } else { 0.0 }
    }

    /// What Get Force answers, in N: as the force sensors see it, if there are any.
    pub(crate) fn reported_force(&self) -> f32 {
        let per_jaw = self.axis.force() / 2.0;
        let seen = |finger: &FingerPort| {
            if finger.measures_force() { finger.measured(per_jaw) } else { per_jaw }
        };
        self.fingers.iter().map(seen).sum::<f64>() as f32
    }

    /// Whether a fault lasts that no acknowledgement can overcome.
    pub(crate) fn has_lasting_fault(&self) -> bool {
        self.supply_fault || self.motor_fault || self.thermal.has_fault()
    }

    /// Whether a force sensor controls the force now.
    pub(crate) fn controls_force(&self) -> bool {
        self.state == GripperState::Holding && self.fingers.iter().any(FingerPort::measures_force)
    }

    /// The system state flags (command set, appendix B).
    pub(crate) fn flags(&self) -> SystemFlags {
        let blocked = self.axis.block().map(|block| block.direction);
        let (below, above) = match self.soft_limits {
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
            (SystemFlags::OVERDRIVE_MODE, self.overdrive),
            (SystemFlags::FORCECNTL_MODE, self.controls_force()),
            (SystemFlags::FAST_STOP, self.fast_stop_latched),
            (SystemFlags::TEMP_WARNING, self.thermal.has_warning()),
            (SystemFlags::TEMP_FAULT, self.thermal.has_fault()),
            (SystemFlags::POWER_FAULT, self.supply_fault),
            (SystemFlags::CURR_FAULT, self.motor_fault),
            (SystemFlags::FINGER_FAULT, self.fingers.iter().any(FingerPort::has_fault)),
            (SystemFlags::CMD_FAILURE, self.command_failure),
        ] {
            flags.set(flag, is_set);
        }
        flags
    }

    /// The values that updates carry.
    pub(crate) fn readings(&self) -> Readings {
        Readings {
            flags: self.flags(),
            state: self.state,
            width: self.reported_width(),
            speed: self.axis.speed() as f32,
            force: self.reported_force(),
            referenced: self.referenced,
            temperature: self.thermal.reading(),
        }
    }

    pub(crate) fn finger(&mut self, jaw: Jaw) -> &mut FingerPort {
        let [one, two] = &mut self.fingers;
        match jaw {
            Jaw::One => one,
            Jaw::Two => two,
        }
    }

    /// The force on each jaw in N.
    pub(crate) fn force_per_jaw(&self) -> f64 {
        self.axis.force() / 2.0
    }

    /// The part comes or goes.
    pub(crate) fn set_part(&mut self, part: Option<Part>) {
        self.axis.set_part(part);
        self.watch_part();
    }

    pub(crate) fn set_fault(&mut self, fault: Fault, on: bool) {
        match fault {
            Fault::AxisBlocked => self.axis.set_jammed(on),
            Fault::OverTemperature => self.thermal.inject_over_temperature(on),
            Fault::SupplyOutOfRange => self.supply_fault = on,
            Fault::MotorCurrent => self.motor_fault = on,
            Fault::FingerShortCircuit(jaw) => self.finger(jaw).set_short_circuit(on),
            Fault::FingerCommunication(jaw) => self.finger(jaw).set_communication_fault(on),
        }
        self.watch_part();
        self.stop_on_lasting_fault();
    }

    /// When something happens by itself, and whether a caller must be awake for it.
    pub(crate) fn next_event(&self, now: Time) -> NextEvent {
        let step = self.needs_step().then(|| now.next_on_grid(STEP_MICROS));
        let deadline = self.motion.map(|motion| motion.deadline);
        let finger = self.starting_fingers.front().map(|(at, ..)| *at);
        let thermal = self.thermal.next_step(now);
        let awake = [step, deadline, finger].into_iter().flatten().min();
        if self.thermal.may_cross_a_limit() {
            NextEvent { any: earlier(awake, thermal), awake: earlier(awake, thermal) }
        } else {
            NextEvent { any: earlier(awake, thermal), awake }
        }
    }

    /// Whether a step of the axis changes anything; a motion to where the fingers are ends in one step.
    fn needs_step(&self) -> bool {
        self.axis.is_active() || (self.motion.is_some() && self.axis.has_arrived())
    }

    /// Lets happen what is due at `now`; `before` is the moment up to which everything has happened.
    pub(crate) fn run_due(&mut self, before: Time, now: Time) {
        if self.needs_step() && before.next_on_grid(STEP_MICROS) <= now {
            self.step_axis();
        }
        if self.motion.is_some_and(|motion| motion.deadline <= now) {
            self.time_out();
        }
        self.note_load();
        if self.thermal.next_step(before).is_some_and(|at| at <= now) {
            self.thermal.step();
            self.stop_on_lasting_fault();
        }
    }

    /// The next second answer that is due at `now`. It counts as the last command's result.
    pub(crate) fn take_completion(&mut self, now: Time) -> Option<Completion> {
        let completion = match self.ended_motion.take() {
            Some(completion) => completion,
            None => {
                let (at, port, id) = *self.starting_fingers.front()?;
                if at > now {
                    return None;
                }
                self.starting_fingers.pop_front();
                Completion { port, id, status: Status::Success }
            }
        };
        self.command_failure = completion.status != Status::Success;
        Some(completion)
    }

    /// Whether there is room to remember one more finger that starts up.
    pub(crate) fn may_start_finger(&self) -> bool {
        !self.starting_fingers.is_full()
    }

    /// Remembers that a finger starts up, to be answered when it is ready. Ask
    /// [`may_start_finger`](Self::may_start_finger) before.
    pub(crate) fn answer_when_started(&mut self, port: PortId, id: CommandId, now: Time) {
        // Refused only when full.
        let _ = self.starting_fingers.push_back((now.plus_millis(FINGER_START_UP_MS), port, id));
    }

    fn step_axis(&mut self) {
        for _ in 0..self.stretches {
            let before = self.width();
            self.axis.step(self.stretch_s);
            self.follow_motion(before);
            if !self.axis.is_active() {
                break;
            }
        }
    }

    /// Tells the thermal model what the drive does.
    pub(crate) fn note_load(&mut self) {
        let relative = self.axis.force() / f64::from(self.parameters.limits.nominal_force);
        self.thermal.load(relative, self.axis.is_moving());
    }

    fn stop_on_lasting_fault(&mut self) {
        if self.has_lasting_fault() && !self.fast_stop_latched {
            self.fast_stop(Status::CmdAborted);
        }
    }
}

/// When something happens next.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NextEvent {
    /// Anything at all.
    pub(crate) any: Option<Time>,
    /// Something that may show on a line.
    pub(crate) awake: Option<Time>,
}

/// The earlier of two moments, where there are any.
pub(crate) fn earlier(one: Option<Time>, other: Option<Time>) -> Option<Time> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (moment, None) | (None, moment) => moment,
    }
}
