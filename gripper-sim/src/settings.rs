//! Settings that clients make for later motions (command set, 3.3).

use crate::config::Config;
use wsg_protocol::{SoftLimits, Status, SystemLimits};

/// The motion settings, always within the limits of the model. Setters return the status of their command.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    system_limits: SystemLimits,
    acceleration: f32,
    force_limit: f32,
    overdrive: bool,
    soft_limits: Option<SoftLimits>,
}

impl Settings {
    /// Returns the settings after power-up.
    pub(crate) fn new(config: &Config) -> Self {
        let parameters = config.model.parameters();
        let mut system_limits = parameters.limits;
        if !config.overdrive {
            system_limits.overdrive_force = system_limits.nominal_force;
        }
        let mut settings =
            Self { system_limits, acceleration: 0.0, force_limit: 0.0, overdrive: false, soft_limits: None };
        if let Some(limits) = config.soft_limits {
            settings.set_soft_limits(limits);
        }
        settings.set_acceleration(config.acceleration.unwrap_or(parameters.default_acceleration));
        settings.set_force_limit(config.force_limit.unwrap_or(parameters.default_force));
        settings
    }

    /// Returns the limits of the gripper, without an overdrive force if it has no overdrive mode.
    pub(crate) const fn system_limits(&self) -> &SystemLimits {
        &self.system_limits
    }

    /// Returns the acceleration in mm/s².
    pub(crate) const fn acceleration(&self) -> f32 {
        self.acceleration
    }

    pub(crate) const fn set_acceleration(&mut self, acceleration: f32) -> Status {
        let limits = &self.system_limits;
        self.acceleration = acceleration.max(limits.min_acceleration).min(limits.max_acceleration);
        Status::Success
    }

    /// Returns the force limit in N, summed over both fingers.
    pub(crate) const fn force_limit(&self) -> f32 {
        self.force_limit
    }

    pub(crate) const fn set_force_limit(&mut self, force: f32) -> Status {
        self.force_limit = self.possible_force(force);
        Status::Success
    }

    /// Returns the permitted force in N that is closest to `force`.
    pub(crate) const fn possible_force(&self, force: f32) -> f32 {
        force.max(self.system_limits.min_force).min(self.greatest_force())
    }

    pub(crate) const fn is_overdrive(&self) -> bool {
        self.overdrive
    }

    pub(crate) const fn set_overdrive(&mut self, enabled: bool) -> Status {
        // The manual lists no status for a gripper without overdrive mode.
        self.overdrive = enabled && self.system_limits.overdrive_force > self.system_limits.nominal_force;
        self.force_limit = self.force_limit.min(self.greatest_force());
        Status::Success
    }

    pub(crate) const fn soft_limits(&self) -> Option<SoftLimits> {
        self.soft_limits
    }

    pub(crate) fn set_soft_limits(&mut self, limits: SoftLimits) -> Status {
        if limits.minus > limits.plus {
            return Status::CmdFormatError;
        }
        self.soft_limits = Some(limits);
        Status::Success
    }

    pub(crate) const fn clear_soft_limits(&mut self) -> Status {
        self.soft_limits = None;
        Status::Success
    }

    const fn greatest_force(&self) -> f32 {
        if self.overdrive { self.system_limits.overdrive_force } else { self.system_limits.nominal_force }
    }
}
