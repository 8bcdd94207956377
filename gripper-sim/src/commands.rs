//! What each command does and answers (command set, chapter 3).

use crate::config::Tag;
use crate::device::Device;
use crate::finger::{Jaw, NoData, PowerOutcome};
use crate::motion::Request;
use crate::port::{Line, PortKind};
use crate::updates::Quantity;
use wsg_protocol::{
    AutoUpdate, Command, CommandId, DeviceTag, FingerData, FirmwareVersion, Frame, GripperState,
    GrippingStatistics, Kind, Reply, SoftLimits, Status, SystemInfo, Value,
};

/// The firmware that the manual describes.
const FIRMWARE: FirmwareVersion = FirmwareVersion::new(4, 0, 0, 0);
/// Assumed.
const HARDWARE_REVISION: u8 = 1;

/// Carries out the request in a frame and answers it.
pub(crate) fn answer(device: &mut Device, line: &mut Line, request: Request, frame: &Frame<'_>) {
    let id = CommandId::from_code(frame.id);
    if line.announced {
        refuse(device, line, id, Status::AccessDenied);
        return;
    }
    // A FAST STOP is obeyed whatever comes with it.
    let frame = if id == CommandId::FastStop { &Frame { id: frame.id, payload: &[] } } else { frame };
    let command = match Command::decode(frame) {
        Ok(command) => command,
        Err(refusal) => return refuse(device, line, id, id.status_of(refusal)),
    };
    if command == Command::DisconnectAnnouncement {
        return announce_disconnection(device, line);
    }
    let reply = device.execute(request, &command);
    let status = reply.status();
    line.reply(reply);
    if let Some(update) = update_of(&command) {
        line.subscriptions.request(id, update, request.now, device.readings());
    }
    device.note_result(id.kind(), status);
}

fn refuse(device: &mut Device, line: &mut Line, id: CommandId, status: Status) {
    line.reply(Reply::status_only(id, status));
    device.note_result(id.kind(), status);
}

fn announce_disconnection(device: &mut Device, line: &mut Line) {
    let id = CommandId::DisconnectAnnouncement;
    if line.kind != PortKind::Tcp {
        return refuse(device, line, id, Status::NotAvailable);
    }
    line.announced = true;
    line.subscriptions.clear();
    line.reply(Reply::status_only(id, Status::Success));
    device.note_result(id.kind(), Status::Success);
    device.abort_motion();
}

const fn update_of(command: &Command<'_>) -> Option<AutoUpdate> {
    match command {
        Command::GetSystemState { update }
        | Command::GetGripperState { update }
        | Command::GetOpeningWidth { update }
        | Command::GetSpeed { update }
        | Command::GetForce { update } => Some(*update),
        _ => None,
    }
}

impl Device {
    /// Carries out a command; its first answer.
    pub(crate) fn execute<'a>(&'a mut self, request: Request, command: &Command<'a>) -> Reply<'a> {
        let id = command.id();
        let limits = self.parameters.limits;
        let status = match *command {
            Command::Loop { data } => return Reply::success(Value::Loop(data)),
            // A matter of connections, not of the device.
            Command::DisconnectAnnouncement => Status::NotAvailable,

            Command::Homing { direction } => self.start_homing(request, direction),
            Command::PrePosition { flags, width, speed } => {
                self.start_pre_position(request, flags, width, speed)
            }
            Command::Stop => {
                self.stop();
                Status::Success
            }
            Command::FastStop => {
                self.fast_stop(Status::CmdAborted);
                Status::Success
            }
            Command::Acknowledge { .. } => {
                self.acknowledge();
                Status::Success
            }
            Command::GripPart { width, speed } => self.start_grip(request, width, speed),
            Command::ReleasePart { width, speed } => self.start_release(request, width, speed),

            Command::SetAcceleration { acceleration } => {
                self.acceleration = acceleration.clamp(limits.min_acceleration, limits.max_acceleration);
                Status::Success
            }
            Command::GetAcceleration => return Reply::success(Value::GetAcceleration(self.acceleration)),
            Command::SetForceLimit { force } => {
                self.force_limit = force.clamp(limits.min_force, self.greatest_force());
                Status::Success
            }
            Command::GetForceLimit => return Reply::success(Value::GetForceLimit(self.force_limit)),
            Command::SetSoftLimits { limits } => self.set_soft_limits(limits),
            Command::GetSoftLimits => match self.soft_limits {
                Some(limits) => return Reply::success(Value::GetSoftLimits(limits)),
                None => Status::NotAvailable,
            },
            Command::ClearSoftLimits => {
                self.soft_limits = None;
                Status::Success
            }
            Command::OverdriveMode { enabled } => {
                self.overdrive = enabled;
                self.force_limit = self.force_limit.min(self.greatest_force());
                Status::Success
            }
            Command::TareForceSensor => self.tare(),

            Command::GetSystemState { .. } => return self.reading(Quantity::SystemState),
            Command::GetGripperState { .. } => return self.reading(Quantity::GripperState),
            Command::GetGrippingStatistics { reset } => {
                let statistics = self.statistics;
                if reset {
                    self.statistics = GrippingStatistics::default();
                }
                return Reply::success(Value::GetGrippingStatistics(statistics));
            }
            Command::GetOpeningWidth { .. } => return self.reading(Quantity::Width),
            Command::GetSpeed { .. } => return self.reading(Quantity::Speed),
            Command::GetForce { .. } => return self.reading(Quantity::Force),
            Command::GetTemperature => return Reply::success(Value::GetTemperature(self.thermal.reading())),

            Command::GetSystemInfo => return Reply::success(Value::GetSystemInfo(self.info())),
            Command::SetDeviceTag { tag } => {
                self.tag = Tag::from(tag);
                Status::Success
            }
            Command::GetDeviceTag => match DeviceTag::new(self.tag.as_str()) {
                Ok(tag) if !tag.as_str().is_empty() => return Reply::success(Value::GetDeviceTag(tag)),
                _ => Status::NotAvailable,
            },
            Command::GetSystemLimits => return Reply::success(Value::GetSystemLimits(limits)),

            Command::GetFinger1Info => {
                return Reply::success(Value::GetFinger1Info(self.finger(Jaw::One).info()));
            }
            Command::GetFinger1Flags => {
                return Reply::success(Value::GetFinger1Flags(self.finger(Jaw::One).flags()));
            }
            Command::Finger1Power { enabled } => self.switch_finger(request, Jaw::One, id, enabled),
            Command::GetFinger1Data => return self.finger_data(Jaw::One, id, Value::GetFinger1Data),
            Command::GetFinger2Info => {
                return Reply::success(Value::GetFinger2Info(self.finger(Jaw::Two).info()));
            }
            Command::GetFinger2Flags => {
                return Reply::success(Value::GetFinger2Flags(self.finger(Jaw::Two).flags()));
            }
            Command::Finger2Power { enabled } => self.switch_finger(request, Jaw::Two, id, enabled),
            Command::GetFinger2Data => return self.finger_data(Jaw::Two, id, Value::GetFinger2Data),

            Command::Unknown { .. } => Status::CmdUnknown,
        };
        Reply::status_only(id, status)
    }

    /// Keeps SF_CMD_FAILURE: a query that succeeds does not hide what went wrong before it.
    pub(crate) fn note_result(&mut self, kind: Kind, status: Status) {
        let failed = !matches!(status, Status::Success | Status::CmdPending);
        if failed || kind != Kind::Query {
            self.command_failure = failed;
        }
    }

    fn reading(&self, quantity: Quantity) -> Reply<'static> {
        Reply::success(quantity.value(&self.readings()))
    }

    /// The greatest force limit that may be set now, in N.
    pub(crate) const fn greatest_force(&self) -> f32 {
        let limits = &self.parameters.limits;
        if self.overdrive { limits.overdrive_force } else { limits.nominal_force }
    }

    fn set_soft_limits(&mut self, limits: SoftLimits) -> Status {
        if limits.minus > limits.plus {
            return Status::CmdFormatError;
        }
        self.soft_limits = Some(limits);
        Status::Success
    }

    fn tare(&mut self) -> Status {
        if !self.fingers.iter().any(|finger| finger.is_force_sensor()) {
            return Status::NotAvailable;
        }
        if self.state == GripperState::Holding {
            return Status::AccessDenied;
        }
        let force = self.force_per_jaw();
        for finger in &mut self.fingers {
            finger.zero_at(force);
        }
        Status::Success
    }

    pub(crate) const fn info(&self) -> SystemInfo {
        SystemInfo {
            device: self.parameters.device,
            hardware_revision: HARDWARE_REVISION,
            firmware: FIRMWARE,
            serial_number: self.config.serial_number,
        }
    }

    fn switch_finger(&mut self, request: Request, jaw: Jaw, id: CommandId, on: bool) -> Status {
        if on && !self.may_start_finger() {
            return Status::CmdFailed;
        }
        match self.finger(jaw).switch(on) {
            PowerOutcome::Off => Status::Success,
            PowerOutcome::Failed => Status::CmdFailed,
            PowerOutcome::StartingUp => {
                self.answer_when_started(request.port, id, request.now);
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
