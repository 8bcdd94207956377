//! The known state of the gripper.

use crate::gcl::{Selected, Value};
use crate::types::{DeviceType, FirmwareVersion, GripperState, SystemFlags};

/// Values reported by the gripper. `None` means unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, crate::Format)]
pub struct Known {
    /// Product type of the gripper.
    pub device: Option<DeviceType>,
    /// Stroke of this model in mm, if its designation contains it.
    pub stroke: Option<f32>,
    /// Firmware version, if the binary protocol can represent it.
    pub firmware: Option<FirmwareVersion>,
    /// Serial number of the gripper.
    pub serial_number: Option<u32>,
    /// System state flags (SYSFLAGS), from answers and AUTOSEND.
    pub flags: Option<SystemFlags>,
    /// State of the gripping process.
    pub state: Option<GripperState>,
    /// Opening width in mm.
    pub width: Option<f32>,
    /// Finger speed in mm/s.
    pub speed: Option<f32>,
    /// Gripping force in N.
    pub force: Option<f32>,
    /// Temperature of the device in °C.
    pub temperature: Option<f32>,
    /// Part width tolerance of this connection in mm.
    pub part_width_tolerance: Option<f32>,
    /// Clamping travel of this connection in mm.
    pub clamping_travel: Option<f32>,
}

impl Known {
    /// The state before the first reply.
    pub const NOTHING: Self = Self {
        device: None,
        stroke: None,
        firmware: None,
        serial_number: None,
        flags: None,
        state: None,
        width: None,
        speed: None,
        force: None,
        temperature: None,
        part_width_tolerance: None,
        clamping_travel: None,
    };

    /// Returns whether the gripper reports moving fingers.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.flags.is_some_and(|flags| flags.contains(SystemFlags::MOVING))
            || self.state.is_some_and(GripperState::is_motion)
    }

    /// Stores a value if it is part of the known state. Returns whether the fingers move, if the value contains that.
    pub(super) fn learn(&mut self, value: &Value<'_>) -> Option<bool> {
        match *value {
            Value::Sysflags(Selected::All(flags)) => {
                self.flags = Some(flags);
                return Some(self.is_moving());
            }
            Value::Gripstate(state) => {
                self.state = Some(state);
                return Some(self.is_moving());
            }
            Value::Devtype(text) => {
                self.device = Some(text.device_type());
                self.stroke = text.stroke();
            }
            Value::Version(text) => self.firmware = text.firmware_version(),
            Value::Sn(number) => self.serial_number = Some(number),
            Value::Pos(width) => self.width = Some(width),
            Value::Speed(speed) => self.speed = Some(speed),
            Value::Force(force) => self.force = Some(force),
            Value::Temp(temperature) => self.temperature = Some(temperature),
            Value::Pwt(tolerance) => self.part_width_tolerance = Some(tolerance),
            Value::Clt(travel) => self.clamping_travel = Some(travel),
            _ => {}
        }
        None
    }
}
