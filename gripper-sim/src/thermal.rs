//! The temperature of the device and the thermal load of the motor. The temperature rises with force and motion and
//! falls towards that of the idle electronics. The motor load depends on the force alone.
//!
//! All figures are assumed. They are chosen so that the nominal force can be held indefinitely and the overdrive force
//! cannot. Slightly more than the nominal force overheats the electronics within minutes; with much more, the motor
//! reaches its limit first.

use crate::time::Time;
use wsg_protocol::Temperature;

/// Final temperature of the idle electronics, in °C.
const IDLE: f64 = 32.0;
/// Temperature rise in °C while the nominal force is held; proportional to the square of the force.
const NOMINAL_FORCE_RISE: f64 = 30.0;
/// Temperature rise in °C while the fingers travel.
const TRAVEL_RISE: f64 = 8.0;
/// Seconds in which the difference to the final temperature falls to about a third.
const TIME_CONSTANT: f64 = 120.0;
/// Temperature in °C from which SF_TEMP_WARNING is set.
const WARNING: f64 = 70.0;
/// Temperature in °C from which SF_TEMP_FAULT is set.
const CRITICAL: f64 = 80.0;
/// Temperature in °C reported while the over-temperature fault is injected.
const INJECTED: f64 = CRITICAL + 5.0;
/// Seconds in which the difference to the motor's final load falls to about a third.
const MOTOR_TIME_CONSTANT: f64 = 30.0;
/// Motor load from which SF_CURR_FAULT is set; the nominal force corresponds to 1.
const MOTOR_LIMIT: f64 = 2.0;
/// Motor load at which the motor has recovered.
const MOTOR_RECOVERED: f64 = 1.0;
/// Difference in motor load that counts as zero.
const MOTOR_SETTLED: f64 = 0.001;
/// Interval between two steps, in seconds.
const STEP_S: f64 = Thermal::STEP_MICROS as f64 / 1e6;
/// Difference in °C that counts as zero, so that an idle gripper needs no steps.
const SETTLED: f64 = 0.01;

/// The thermal state of electronics and motor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Thermal {
    temperature: f64,
    final_temperature: f64,
    injected: bool,
    motor: f64,
    final_motor: f64,
    motor_fault: bool,
}

impl Thermal {
    /// Interval between two steps, in microseconds.
    pub(crate) const STEP_MICROS: u64 = 100_000;

    pub(crate) const fn new() -> Self {
        Self {
            temperature: IDLE,
            final_temperature: IDLE,
            injected: false,
            motor: 0.0,
            final_motor: 0.0,
            motor_fault: false,
        }
    }

    /// Sets the load: the force relative to the nominal force, and whether the fingers travel.
    pub(crate) fn load(&mut self, relative_force: f64, travels: bool) {
        let travel = if travels { TRAVEL_RISE } else { 0.0 };
        self.final_motor = relative_force * relative_force;
        self.final_temperature = IDLE + NOMINAL_FORCE_RISE * self.final_motor + travel;
    }

    /// Executes one step of [`STEP_MICROS`](Self::STEP_MICROS).
    pub(crate) fn step(&mut self) {
        self.temperature += (self.final_temperature - self.temperature) * (STEP_S / TIME_CONSTANT);
        if self.is_settled() {
            self.temperature = self.final_temperature;
        }
        self.motor += (self.final_motor - self.motor) * (STEP_S / MOTOR_TIME_CONSTANT);
        if (self.final_motor - self.motor).abs() < MOTOR_SETTLED {
            self.motor = self.final_motor;
        }
        self.motor_fault = self.motor >= if self.motor_fault { MOTOR_RECOVERED } else { MOTOR_LIMIT };
    }

    /// Returns when the next step is due, if one changes anything.
    pub(crate) fn next_step(&self, now: Time) -> Option<Time> {
        let is_settled = self.temperature == self.final_temperature && self.motor == self.final_motor;
        (!is_settled).then(|| now.next_on_grid(Self::STEP_MICROS))
    }

    /// Returns whether a later step may change a flag, so that the caller must stay awake for it.
    pub(crate) fn may_cross_a_limit(&self) -> bool {
        let motor = self.motor_fault || self.final_motor >= MOTOR_LIMIT;
        motor || self.temperature >= WARNING || self.final_temperature >= WARNING
    }

    /// Returns whether the motor has reached its maximum thermal load and has not recovered (command set, appendix B, D16).
    pub(crate) const fn has_motor_fault(&self) -> bool {
        self.motor_fault
    }

    pub(crate) const fn inject_over_temperature(&mut self, on: bool) {
        self.injected = on;
    }

    pub(crate) fn reading(&self) -> Temperature {
        Temperature((self.shown() * 10.0) as i16)
    }

    pub(crate) fn has_warning(&self) -> bool {
        self.shown() >= WARNING
    }

    pub(crate) fn has_fault(&self) -> bool {
        self.shown() >= CRITICAL
    }

    fn is_settled(&self) -> bool {
        (self.final_temperature - self.temperature).abs() < SETTLED
    }

    fn shown(&self) -> f64 {
        if self.injected { self.temperature.max(INJECTED) } else { self.temperature }
    }
}
