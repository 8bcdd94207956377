//! The temperature of the device, which rises with force and motion and falls towards that of the idle electronics, and the
//! thermal load of the motor, which rises and falls with the force alone.
//!
//! All figures are assumed, and chosen so that the nominal force may be held for ever and the overdrive force may not: a little
//! more than the nominal force overheats the electronics in minutes, and much more the motor before them.

use crate::time::Time;
use wsg_protocol::Temperature;

/// °C that the electronics alone come to.
const IDLE: f64 = 32.0;
/// °C more while the nominal force is held; grows with the square of the force.
const NOMINAL_FORCE_RISE: f64 = 30.0;
/// °C more while the fingers travel.
const TRAVEL_RISE: f64 = 8.0;
/// Seconds in which the distance to the final temperature falls to a third, about.
const TIME_CONSTANT: f64 = 120.0;
/// °C from which SF_TEMP_WARNING is set.
const WARNING: f64 = 70.0;
/// °C from which SF_TEMP_FAULT is set.
const CRITICAL: f64 = 80.0;
/// °C shown while over temperature is injected.
const INJECTED: f64 = CRITICAL + 5.0;
/// Seconds in which the distance to the motor's final load falls to a third, about.
const MOTOR_TIME_CONSTANT: f64 = 30.0;
/// Load of the motor from which SF_CURR_FAULT is set; the nominal force comes to 1.
const MOTOR_LIMIT: f64 = 2.0;
/// Load at which the motor has recovered.
const MOTOR_RECOVERED: f64 = 1.0;
/// A load that counts as none.
const MOTOR_SETTLED: f64 = 0.001;
/// Seconds from one step to the next.
const STEP_S: f64 = Thermal::STEP_MICROS as f64 / 1e6;
/// A distance in °C that counts as none, so that an idle gripper needs no steps.
const SETTLED: f64 = 0.01;

/// The thermal state.
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
    /// Microseconds from one step to the next.
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

    /// Takes the load from now on: the force in relation to the nominal one, and whether the fingers travel.
    pub(crate) fn load(&mut self, relative_force: f64, travels: bool) {
        let travel = if travels { TRAVEL_RISE } else { 0.0 };
        self.final_motor = relative_force * relative_force;
        self.final_temperature = IDLE + NOMINAL_FORCE_RISE * self.final_motor + travel;
    }

    /// One step of [`STEP_MICROS`](Self::STEP_MICROS).
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

    /// When the next step is due, if one changes anything.
    pub(crate) fn next_step(&self, now: Time) -> Option<Time> {
        let is_settled = self.temperature == self.final_temperature && self.motor == self.final_motor;
        (!is_settled).then(|| now.next_on_grid(Self::STEP_MICROS))
    }

    /// Whether steps to come may change a flag, so that a caller should not sleep through them.
    pub(crate) fn may_cross_a_limit(&self) -> bool {
        let motor = self.motor_fault || self.final_motor >= MOTOR_LIMIT;
        motor || self.temperature >= WARNING || self.final_temperature >= WARNING
    }

    /// Whether the motor has come to its greatest thermal load and has not recovered (command set, appendix B, D16).
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
