//! The gripper without its clients: motions, sensor fingers, temperature and faults as one device.
//!
//! [`motion`](crate::motion) implements the start and end of motions; [`commands`] implements the commands.

mod commands;

use crate::axis::Part;
use crate::config::{Config, Tag};
use crate::faults::Fault;
use crate::finger::{Finger, FingerPort, Jaw};
use crate::journal::Cause;
use crate::motion::MotionControl;
use crate::port::{Completion, PortId};
use crate::script::{ScriptCommands, ScriptState};
use crate::thermal::Thermal;
use crate::time::{Time, earlier};
use crate::updates::Readings;
use wsg_protocol::{CommandId, GripperState, Kind, Status, SystemFlags, SystemLimits, Temperature};

/// Start-up time of a finger after its supply is switched on, in ms (command set, 3.6.3).
const FINGER_START_UP_MS: u64 = 500;
/// How many fingers may start up at the same time.
const MAX_STARTING_FINGERS: usize = 8;

/// The gripper without its clients.
#[derive(Clone, Debug)]
pub(crate) struct Device {
    config: Config,
    motion: MotionControl,
    fingers: [FingerPort; 2],
    starting_fingers: heapless::Deque<(Time, PortId, CommandId), MAX_STARTING_FINGERS>,
    /// Storage for the data frame of the finger being queried.
    finger_data: [u8; 4],
    thermal: Thermal,
    supply_fault: bool,
    motor_fault: bool,
    command_failure: bool,
    /// Whether the last command was a Stop or FAST STOP. A motion that it ended has not failed.
    was_stopped: bool,
    /// The cause of the latest change, for the system log.
    cause: Cause,
    tag: Tag,
    script: ScriptCommands,
}

impl Device {
    pub(crate) fn new(config: Config) -> Self {
        Self {
            motion: MotionControl::new(&config),
            fingers: config.fingers.map(FingerPort::new),
            starting_fingers: heapless::Deque::new(),
            finger_data: [0; 4],
            thermal: Thermal::new(),
            supply_fault: false,
            motor_fault: false,
            command_failure: false,
            was_stopped: false,
            cause: Cause::default(),
            tag: config.tag,
            script: ScriptCommands::default(),
            config,
        }
    }

    /// Returns the settings made before power-up. The tag may have changed since; see [`tag`](Self::tag).
    pub(crate) const fn config(&self) -> &Config {
        &self.config
    }

    /// Takes over the settings. Returns false, and changes nothing, while a motion runs whose settings would change.
    pub(crate) fn reconfigure(&mut self, config: Config) -> bool {
        let before = self.config;
        if before.moves_differently(&config) {
            if self.motion.is_running() {
                return false;
            }
            self.motion.reconfigure(&config);
        }
        self.config = config;
        if before.part != config.part {
            self.set_part(config.part);
        }
        if before.tag != config.tag {
            self.tag = config.tag;
        }
        true
    }

    /// Returns the motions, with their settings, their state and the axis.
    pub(crate) const fn motion(&self) -> &MotionControl {
        &self.motion
    }

    /// Returns the motions, for a request that concerns nothing else of the device.
    pub(crate) const fn motion_mut(&mut self) -> &mut MotionControl {
        &mut self.motion
    }

    pub(crate) const fn limits(&self) -> &SystemLimits {
        self.motion.settings().system_limits()
    }

    pub(crate) const fn tag(&self) -> &Tag {
        &self.tag
    }

    /// Returns the answer to Get Opening Width, in mm: 0 while the fingers are not referenced (command set, 3.4.4).
    pub(crate) fn reported_width(&self) -> f32 {
        if self.motion.is_referenced() { self.motion.width() as f32 } else { 0.0 }
    }

    /// Returns the answer to Get Force, in N, measured by the force sensors if there are any.
    pub(crate) fn reported_force(&self) -> f32 {
        let per_jaw = self.force_per_jaw();
        let seen = |finger: &FingerPort| {
            if finger.measures_force() { finger.measured(per_jaw) } else { per_jaw }
        };
        self.fingers.iter().map(seen).sum::<f64>() as f32
    }

    /// Sets the force limit in N, within the permitted forces.
    #[cfg(feature = "control")]
    pub(crate) const fn set_force_limit(&mut self, force: f32) {
        self.motion.settings_mut().set_force_limit(force);
    }

    pub(crate) fn temperature(&self) -> Temperature {
        self.thermal.reading()
    }

    pub(crate) const fn finger(&self, jaw: Jaw) -> &FingerPort {
        let [one, two] = &self.fingers;
        match jaw {
            Jaw::One => one,
            Jaw::Two => two,
        }
    }

    /// Returns the kind of finger on this jaw and the force in N that it measures.
    pub(crate) fn finger_reading(&self, jaw: Jaw) -> (Finger, Option<f32>) {
        let finger = self.finger(jaw);
        let force = finger.measures_force().then(|| finger.measured(self.force_per_jaw()) as f32);
        (finger.kind(), force)
    }

    /// Returns the system state flags (command set, appendix B).
    pub(crate) fn flags(&self) -> SystemFlags {
        let mut flags = self.motion.flags();
        for (flag, is_set) in [
            (SystemFlags::FORCECNTL_MODE, self.controls_force()),
            (SystemFlags::TEMP_WARNING, self.thermal.has_warning()),
            (SystemFlags::TEMP_FAULT, self.thermal.has_fault()),
            (SystemFlags::POWER_FAULT, self.supply_fault),
            (SystemFlags::CURR_FAULT, self.has_motor_fault()),
            (SystemFlags::FINGER_FAULT, self.fingers.iter().any(FingerPort::has_fault)),
            (SystemFlags::CMD_FAILURE, self.command_failure),
            (SystemFlags::SCRIPT_RUNNING, self.script.state() == ScriptState::Running),
            (SystemFlags::SCRIPT_FAILURE, self.script.state() == ScriptState::Failed),
        ] {
            flags.set(flag, is_set);
        }
        flags
    }

    /// Returns the values that updates carry.
    pub(crate) fn readings(&self) -> Readings {
        Readings {
            flags: self.flags(),
            state: self.motion.state(),
            width: self.reported_width(),
            speed: self.motion.axis().speed() as f32,
            force: self.reported_force(),
            referenced: self.motion.is_referenced(),
            temperature: self.temperature(),
        }
    }

    /// Updates SF_CMD_FAILURE. A successful query does not clear an earlier failure.
    pub(crate) fn note_result(&mut self, kind: Kind, status: Status) {
        let failed = !matches!(status, Status::Success | Status::CmdPending);
        if failed || kind != Kind::Query {
            self.command_failure = failed;
        }
        if kind != Kind::Query {
            self.was_stopped = kind == Kind::Stop;
        }
    }

    /// Sets the state of the script. The interfaces that it has opened close when it ends.
    pub(crate) fn set_script_state(&mut self, state: ScriptState) {
        self.script.set_state(state);
        if state != ScriptState::Running {
            self.fingers.iter_mut().for_each(|finger| finger.set_interface(false));
        }
    }

    /// Opens the interface of a finger for the script.
    pub(crate) const fn open_finger_interface(&mut self, jaw: Jaw) {
        self.finger_mut(jaw).set_interface(true);
    }

    pub(crate) const fn script_mut(&mut self) -> &mut ScriptCommands {
        &mut self.script
    }

    /// Returns the cause of the latest change.
    pub(crate) const fn cause(&self) -> Cause {
        self.cause
    }

    /// Executes FAST STOP, or the same on a fault. A motion that it ends is answered with E_CMD_ABORTED.
    pub(crate) fn fast_stop(&mut self, cause: Cause) {
        self.cause = cause;
        self.motion.fast_stop(Status::CmdAborted);
    }

    /// Places or removes the part.
    pub(crate) fn set_part(&mut self, part: Option<Part>) {
        self.motion.set_part(part);
    }

    pub(crate) fn set_fault(&mut self, fault: Fault, on: bool) {
        self.cause = Cause::Fault;
        match fault {
            Fault::AxisBlocked => self.motion.set_jammed(on),
            Fault::OverTemperature => self.thermal.inject_over_temperature(on),
            Fault::SupplyOutOfRange => self.supply_fault = on,
            Fault::MotorCurrent => self.motor_fault = on,
            Fault::FingerShortCircuit(jaw) => self.finger_mut(jaw).set_short_circuit(on),
            Fault::FingerCommunication(jaw) => self.finger_mut(jaw).set_communication_fault(on),
        }
        self.react_to_faults();
    }

    /// Returns the time of the next event, and whether it requires the caller to be awake.
    pub(crate) fn next_event(&self, now: Time) -> NextEvent {
        let finger = self.starting_fingers.front().map(|(at, ..)| *at);
        let thermal = self.thermal.next_step(now);
        let awake = earlier(self.motion.next_due(now), finger);
        if self.thermal.may_cross_a_limit() {
            NextEvent { any: earlier(awake, thermal), awake: earlier(awake, thermal) }
        } else {
            NextEvent { any: earlier(awake, thermal), awake }
        }
    }

    /// Processes the events due at `now`; `before` is the time up to which all events have been processed.
    pub(crate) fn run_due(&mut self, before: Time, now: Time) {
        // The only change that a motion causes by itself.
        self.cause = Cause::SoftLimit;
        self.motion.run_due(before, now);
        self.note_load();
        if self.thermal.next_step(before).is_some_and(|at| at <= now) {
            self.thermal.step();
            self.react_to_faults();
        }
    }

    /// Takes the next second answer due at `now` and records it as the result of the last command.
    pub(crate) fn take_completion(&mut self, now: Time) -> Option<Completion> {
        let completion = match self.motion.take_completion() {
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
        let was_ended = self.was_stopped && completion.status == Status::CmdAborted;
        self.command_failure = completion.status != Status::Success && !was_ended;
        Some(completion)
    }

    /// Passes the load of the drive to the thermal model.
    pub(crate) fn note_load(&mut self) {
        let relative = self.motion.axis().force() / f64::from(self.limits().nominal_force);
        self.thermal.load(relative, self.motion.axis().is_moving());
    }

    const fn finger_mut(&mut self, jaw: Jaw) -> &mut FingerPort {
        let [one, two] = &mut self.fingers;
        match jaw {
            Jaw::One => one,
            Jaw::Two => two,
        }
    }

    /// Returns the force on each jaw in N.
    fn force_per_jaw(&self) -> f64 {
        self.motion.axis().force() / 2.0
    }

    /// Returns whether a force sensor controls the force.
    fn controls_force(&self) -> bool {
        self.motion.state() == GripperState::Holding && self.fingers.iter().any(FingerPort::measures_force)
    }

    fn has_motor_fault(&self) -> bool {
        self.motor_fault || self.thermal.has_motor_fault()
    }

    /// Disables motion while the temperature or the supply is out of range, and latches FAST STOP while the motor is
    /// overloaded (command set, appendix B, D14 to D16).
    fn react_to_faults(&mut self) {
        self.motion.set_disabled(self.supply_fault || self.thermal.has_fault());
        if self.has_motor_fault() && !self.motion.is_fast_stopped() {
            self.fast_stop(Cause::Fault);
        }
    }
}

/// The times of the next events.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NextEvent {
    /// The next event of any kind.
    pub(crate) any: Option<Time>,
    /// The next event that may affect a line.
    pub(crate) awake: Option<Time>,
}
