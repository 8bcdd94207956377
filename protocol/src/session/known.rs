//! The known state of the gripper.

use core::hash::{Hash, Hasher};

use crate::reply::Value;
use crate::types::{GripperState, SystemFlags, SystemInfo, SystemLimits};

/// Flags that change with motions. A change of any other flag may coincide with a new force limit: the gripper was
/// restarted, left overdrive mode or began a script.
const OF_MOTIONS: SystemFlags = SystemFlags::MOVING
    .union(SystemFlags::BLOCKED_MINUS)
    .union(SystemFlags::BLOCKED_PLUS)
    .union(SystemFlags::SOFT_LIMIT_MINUS)
    .union(SystemFlags::SOFT_LIMIT_PLUS)
    .union(SystemFlags::AXIS_STOPPED)
    .union(SystemFlags::TARGET_POS_REACHED);

/// Values reported by the gripper since the connection was established. `None` means unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, crate::Format)]
pub struct Known {
    /// Device type, versions and serial number.
    pub info: Option<SystemInfo>,
    /// Physical limits of the gripper.
    pub limits: Option<SystemLimits>,
    /// System state flags (40h), from answers and updates.
    pub flags: Option<SystemFlags>,
    /// Gripper state (41h), from answers and updates.
    pub state: Option<GripperState>,
    /// Opening width in mm.
    pub width: Option<f32>,
    /// Finger speed in mm/s.
    pub speed: Option<f32>,
    /// Gripping force in N, summed over both fingers.
    pub force: Option<f32>,
    /// Force limit in N. It is known after it was set and read back over this connection, and is read again within
    /// [`refresh_ms`](super::Config::refresh_ms). It becomes unknown as soon as anything may have changed it. Requires
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
    /// The state before the first reply.
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

    /// Returns whether the gripper reports moving fingers.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.flags.is_some_and(|flags| flags.contains(SystemFlags::MOVING))
            || self.state.is_some_and(GripperState::is_motion)
    }

    /// Stores the force limit that was read back, unless a script is running, which may change it at any time.
    pub(super) fn confirm_force_limit(&mut self, read: f32) {
        if !self.flags.unwrap_or_default().contains(SystemFlags::SCRIPT_RUNNING) {
            self.force_limit = Some(read);
        }
    }

    /// Stores a value if it is part of the known state. Returns whether the fingers move, if the value contains that.
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
