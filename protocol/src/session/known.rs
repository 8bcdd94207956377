//! What the session knows of the gripper.

use core::hash::{Hash, Hasher};

use crate::reply::Value;
use crate::types::{GripperState, SystemFlags, SystemInfo, SystemLimits};

/// The flags that change with motions. Behind a change of any other the force limit may be another one: the gripper was
/// restarted, left overdrive mode, began a script.
const OF_MOTIONS: SystemFlags = SystemFlags::MOVING
    .union(SystemFlags::BLOCKED_MINUS)
    .union(SystemFlags::BLOCKED_PLUS)
    .union(SystemFlags::SOFT_LIMIT_MINUS)
    .union(SystemFlags::SOFT_LIMIT_PLUS)
    .union(SystemFlags::AXIS_STOPPED)
    .union(SystemFlags::TARGET_POS_REACHED);

/// What the gripper has told since the connection stands; `None` is not known.
#[derive(Clone, Copy, Debug, Default, PartialEq, crate::Format)]
pub struct Known {
    /// Device, versions, serial number.
    pub info: Option<SystemInfo>,
    /// Physical limits.
    pub limits: Option<SystemLimits>,
    /// System state.
    pub flags: Option<SystemFlags>,
    /// Gripper state.
    pub state: Option<GripperState>,
    /// Opening width in mm.
    pub width: Option<f32>,
    /// Finger speed in mm/s.
    pub speed: Option<f32>,
    /// Gripping force in N, summed over both fingers.
    pub force: Option<f32>,
    /// Force limit in N: set over this connection and read back, and read again within
    /// [`refresh_ms`](super::Config::refresh_ms). Not known as soon as anything may have changed it. Only with
    /// [`verify_settings`](super::Config::verify_settings).
    pub force_limit: Option<f32>,
}

impl Hash for Known {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { info, limits, flags, state: gripper, width, speed, force, force_limit } = self;
        let measured = [width, speed, force, force_limit].map(|value| value.map(f32::to_bits));
        (info, limits, flags, gripper, measured).hash(state);
    }
}

impl Known {
    /// Nothing is known.
    pub const NOTHING: Self = Self {
        info: None,
        limits: None,
        flags: None,
        state: None,
        width: None,
        speed: None,
        force: None,
        force_limit: None,
    };

    /// Whether the gripper reports that the fingers move.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.flags.is_some_and(|flags| flags.contains(SystemFlags::MOVING))
            || self.state.is_some_and(GripperState::is_motion)
    }

    /// Keeps the force limit that was read back, unless a script runs, which may change it at any time.
    pub(super) fn confirm_force_limit(&mut self, read: f32) {
        if !self.flags.unwrap_or_default().contains(SystemFlags::SCRIPT_RUNNING) {
            self.force_limit = Some(read);
        }
    }

    /// Keeps a value, if it is one that is kept. Returns whether the fingers move, if the value tells.
    pub(super) fn learn(&mut self, value: &Value<'_>) -> Option<bool> {
        match *value {
            Value::GetSystemState(flags) => {
                let changed = self.flags.replace(flags).unwrap_or_default() ^ flags;
                if !OF_MOTIONS.contains(changed) {
                    self.force_limit = None;
                }
                return Some(self.is_moving());
            }
            Value::GetGripperState(state) => {
                self.state = Some(state);
                return Some(self.is_moving());
            }
            Value::GetSystemInfo(info) => self.info = Some(info),
            Value::GetSystemLimits(limits) => self.limits = Some(limits),
            Value::GetOpeningWidth(width) => self.width = Some(width),
            Value::GetSpeed(speed) => self.speed = Some(speed),
            Value::GetForce(force) => self.force = Some(force),
            Value::GetForceLimit(read) => self.force_limit = self.force_limit.filter(|known| *known == read),
            _ => {}
        }
        None
    }
}
