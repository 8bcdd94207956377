//! Execution of the commands and their answers (command set, chapter 3).

use super::{Device, FINGER_START_UP_MS};
use crate::config::Tag;
use crate::finger::{Jaw, NoData, PowerOutcome};
use crate::journal::Cause;
use crate::port::Request;
use crate::updates::Quantity;
use wsg_protocol::{
    Command, CommandId, DeviceTag, FingerData, FirmwareVersion, GripperState, Reply, Status, SystemInfo,
    Value,
};

/// The firmware version that the manual describes.
const FIRMWARE: FirmwareVersion = FirmwareVersion::new(4, 0, 0, 0);
/// The hardware revision to report. Assumed.
const HARDWARE_REVISION: u8 = 1;

impl Device {
    /// Executes a command and returns its first answer.
    pub(crate) fn execute<'a>(&'a mut self, request: Request, command: &Command<'a>) -> Reply<'a> {
        let id = command.id();
        let [one, two] = [Jaw::One, Jaw::Two];
        self.cause = Cause::of(request.port);
        let status = match *command {
            Command::Loop { data } => return Reply::success(Value::Loop(data)),
            // Connections handle this command; it does not concern the device.
            Command::DisconnectAnnouncement => Status::NotAvailable,

            Command::Homing { direction } => self.motion.start_homing(request, direction),
            Command::PrePosition { flags, width, speed } => {
                self.motion.start_pre_position(request, flags, width, speed)
            }
            Command::Stop => {
                self.motion.stop();
                Status::Success
            }
            Command::FastStop => {
                self.fast_stop(Cause::of(request.port));
                Status::Success
            }
            Command::Acknowledge { .. } => self.acknowledge(),
            Command::GripPart { width, speed } => self.motion.start_grip(request, width, speed),
            Command::ReleasePart { width, speed } => self.motion.start_release(request, width, speed),

            Command::SetAcceleration { acceleration } => {
                self.motion.settings_mut().set_acceleration(acceleration)
            }
            Command::GetAcceleration => {
                return Reply::success(Value::GetAcceleration(self.motion.settings().acceleration()));
            }
            Command::SetForceLimit { force } => self.motion.settings_mut().set_force_limit(force),
            Command::GetForceLimit => {
                return Reply::success(Value::GetForceLimit(self.motion.settings().force_limit()));
            }
            Command::SetSoftLimits { limits } => self.motion.settings_mut().set_soft_limits(limits),
            Command::GetSoftLimits => match self.motion.settings().soft_limits() {
                Some(limits) => return Reply::success(Value::GetSoftLimits(limits)),
                None => Status::NotAvailable,
            },
            Command::ClearSoftLimits => self.motion.settings_mut().clear_soft_limits(),
            Command::OverdriveMode { enabled } => self.motion.settings_mut().set_overdrive(enabled),
            Command::TareForceSensor => self.tare(&[one, two]),

            Command::GetSystemState { .. } => return self.reading(Quantity::SystemState),
            Command::GetGripperState { .. } => return self.reading(Quantity::GripperState),
            Command::GetGrippingStatistics { reset } => return self.take_statistics(reset),
            Command::GetOpeningWidth { .. } => return self.reading(Quantity::Width),
            Command::GetSpeed { .. } => return self.reading(Quantity::Speed),
            Command::GetForce { .. } => return self.reading(Quantity::Force),
            Command::GetTemperature => return Reply::success(Value::GetTemperature(self.temperature())),

            Command::GetSystemInfo => return Reply::success(Value::GetSystemInfo(self.info())),
            Command::SetDeviceTag { tag } => {
                self.tag = Tag::from(tag);
                Status::Success
            }
            Command::GetDeviceTag => match DeviceTag::new(self.tag.as_str()) {
                Ok(tag) if !tag.as_str().is_empty() => return Reply::success(Value::GetDeviceTag(tag)),
                _ => Status::NotAvailable,
            },
            Command::GetSystemLimits => return Reply::success(Value::GetSystemLimits(*self.limits())),

            Command::GetFinger1Info => return Reply::success(Value::GetFinger1Info(self.finger(one).info())),
            Command::GetFinger1Flags => {
                return Reply::success(Value::GetFinger1Flags(self.finger(one).flags()));
            }
            Command::Finger1Power { enabled } => self.switch_finger(request, one, id, enabled),
            Command::GetFinger1Data => return self.finger_data(one, id, Value::GetFinger1Data),
            Command::GetFinger2Info => return Reply::success(Value::GetFinger2Info(self.finger(two).info())),
            Command::GetFinger2Flags => {
                return Reply::success(Value::GetFinger2Flags(self.finger(two).flags()));
            }
            Command::Finger2Power { enabled } => self.switch_finger(request, two, id, enabled),
            Command::GetFinger2Data => return self.finger_data(two, id, Value::GetFinger2Data),

            Command::Unknown { .. } => Status::CmdUnknown,
        };
        Reply::status_only(id, status)
    }

    fn reading(&self, quantity: Quantity) -> Reply<'static> {
        Reply::success(quantity.value(&self.readings()))
    }

    fn take_statistics(&mut self, reset: bool) -> Reply<'static> {
        let reply = Reply::success(Value::GetGrippingStatistics(self.motion.statistics()));
        if reset {
            self.motion.reset_statistics();
        }
        reply
    }

    /// Executes Acknowledge (24h). A FAST STOP stays latched while its cause persists (appendix B, D16).
    fn acknowledge(&mut self) -> Status {
        if !self.has_motor_fault() {
            self.motion.acknowledge();
        }
        Status::Success
    }

    /// Tares the force sensors of these fingers. Only the text protocol tares a single finger.
    pub(crate) fn tare(&mut self, jaws: &[Jaw]) -> Status {
        if !jaws.iter().any(|jaw| self.finger(*jaw).is_force_sensor()) {
            return Status::NotAvailable;
        }
        if self.motion.state() == GripperState::Holding {
            return Status::AccessDenied;
        }
        let force = self.force_per_jaw();
        for jaw in jaws {
            self.finger_mut(*jaw).zero_at(force);
        }
        Status::Success
    }

    pub(crate) const fn info(&self) -> SystemInfo {
        SystemInfo {
            device: self.config.model.parameters().device,
            hardware_revision: HARDWARE_REVISION,
            firmware: FIRMWARE,
            serial_number: self.config.serial_number,
        }
    }

    fn switch_finger(&mut self, request: Request, jaw: Jaw, id: CommandId, on: bool) -> Status {
        if on && self.starting_fingers.is_full() {
            return Status::CmdFailed;
        }
        match self.finger_mut(jaw).switch(on) {
            PowerOutcome::Off => Status::Success,
            PowerOutcome::Failed => Status::CmdFailed,
            PowerOutcome::StartingUp => {
                let ready_at = request.now.plus_millis(FINGER_START_UP_MS);
                // There is room, as checked above.
                let _ = self.starting_fingers.push_back((ready_at, request.port, id));
                Status::CmdPending
            }
        }
    }

    fn finger_data<'a>(
        &'a mut self,
        jaw: Jaw,
        id: CommandId,
        value: fn(FingerData<'a>) -> Value<'a>,
    ) -> Reply<'a> {
        let force = self.force_per_jaw();
        match self.finger(jaw).data(force) {
            Ok(data) => {
                self.finger_data = data;
                match FingerData::new(&self.finger_data) {
                    Ok(data) => Reply::success(value(data)),
                    Err(refusal) => Reply::status_only(id, id.status_of(refusal)),
                }
            }
            Err(NoData::Communication) => Reply::status_only(id, Status::IoError),
            Err(NoData::Unsupported) => Reply::status_only(id, Status::NotAvailable),
        }
    }
}
