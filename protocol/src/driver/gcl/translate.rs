//! Translates commands to GCL requests, and GCL replies to binary replies.

use crate::command::{Command, CommandId};
use crate::driver::Error;
use crate::field::DecodeError;
use crate::gcl::session::{self as lines, Event as GclEvent};
use crate::gcl::{
    Answer, Autosend, CommandName, FingerReading, Grip, Move, Release, Request, Select, Selected, Tare,
    Topic as LineTopic, Value as LineValue,
};
use crate::reply::{Reply, Value};
use crate::session::{self, Event, Known, Topic};
use crate::types::{
    AutoUpdate, DeviceType, FingerData, FingerInfo, FingerType, FirmwareVersion, PrePositionFlags, Status,
    SystemInfo, SystemLimits, Temperature, UpdateFlags,
};

/// State needed for the translation in addition to the current line.
#[derive(Debug)]
pub(super) struct Terms {
    /// The force limit in N, summed over both fingers.
    pub(super) force: Option<f32>,
    /// Whether the last grip that began moved outward.
    outward: bool,
    /// Whether the last requested grip moves outward.
    asked_outward: bool,
    /// Whether the last requested finger is the second one.
    second_finger: bool,
}

impl Terms {
    pub(super) const NONE: Self =
        Self { force: None, outward: false, asked_outward: false, second_finger: false };

    /// Returns whether the translation of this command needs the current opening width.
    pub(super) fn wants_width(&self, command: &Command<'_>) -> bool {
        match command {
            Command::PrePosition { flags, .. } => {
                flags.contains(PrePositionFlags::RELATIVE | PrePositionFlags::STOP_ON_BLOCK)
            }
            Command::GripPart { .. } => self.force.is_some(),
            Command::ReleasePart { .. } => true,
            _ => false,
        }
    }

    /// Returns the GCL request for a command. `width` is the current opening width, if it was needed.
    pub(super) fn request<E>(&self, command: &Command<'_>, width: Option<f32>) -> Result<Request, Error<E>> {
        let current = width.ok_or(Error::NotInGcl);
        Ok(match *command {
            Command::DisconnectAnnouncement => Request::Bye,
            Command::Homing { direction } => Request::Home(direction),
            Command::PrePosition { flags, width, speed } => {
                if !flags.contains(PrePositionFlags::STOP_ON_BLOCK) {
                    return Err(Error::NotInGcl);
                }
                let is_relative = flags.contains(PrePositionFlags::RELATIVE);
                let target = if is_relative { current? + width } else { width };
                Request::Move(Move { width: target, speed: Some(speed) })
            }
            Command::GripPart { width, speed } => {
                let force = self.force.ok_or(Error::NoForceLimit)?;
                Request::Grip(Grip::PartAtSpeed { force, width, speed })
            }
            Command::ReleasePart { width, speed } => {
                let opening = width - current?;
                let distance = if self.outward { -opening } else { opening };
                if !distance.is_finite() {
                    return Err(Error::Invalid(DecodeError::NotFinite));
                }
                if distance < 0.0 {
                    return Err(Error::NotInGcl);
                }
                Request::Release(Release::ByAtSpeed { distance, speed })
            }
            Command::Stop => Request::Stop,
            Command::FastStop => Request::Faststop,
            Command::Acknowledge { .. } => Request::Fsack,
            Command::TareForceSensor => Request::Tare(Tare::All),
            Command::GetSystemState { .. } => Request::Sysflags(Select::All),
            Command::GetGripperState { .. } => Request::Gripstate,
            Command::GetGrippingStatistics { reset: false } => Request::Gripstats(Select::All),
            Command::GetOpeningWidth { .. } => Request::Pos,
            Command::GetSpeed { .. } => Request::Speed,
            Command::GetForce { .. } => Request::Force,
            Command::GetTemperature => Request::Temp,
            // Device type and firmware version are known since connecting.
            Command::GetSystemInfo => Request::Sn,
            Command::GetDeviceTag => Request::Tag,
            Command::GetFinger1Info => Request::Ftype(Select::One(0)),
            Command::GetFinger2Info => Request::Ftype(Select::One(1)),
            Command::GetFinger1Flags => Request::Fflags(Select::One(0)),
            Command::GetFinger2Flags => Request::Fflags(Select::One(1)),
            Command::GetFinger1Data => Request::Fdata(Select::One(0)),
            Command::GetFinger2Data => Request::Fdata(Select::One(1)),
            _ => return Err(Error::NotInGcl),
        })
    }

    /// Records a command that was accepted and will be sent.
    pub(super) fn asked(&mut self, command: &Command<'_>, current: Option<f32>) {
        match *command {
            Command::GripPart { width, .. } => {
                self.asked_outward = current.is_some_and(|current| width > current);
            }
            Command::GetFinger1Info | Command::GetFinger1Flags | Command::GetFinger1Data => {
                self.second_finger = false;
            }
            Command::GetFinger2Info | Command::GetFinger2Flags | Command::GetFinger2Data => {
                self.second_finger = true;
            }
            _ => {}
        }
    }

    /// Returns the command that corresponds to a request of this name.
    pub(super) const fn id(&self, name: CommandName) -> Option<CommandId> {
        Some(match name {
            CommandName::Bye => CommandId::DisconnectAnnouncement,
            CommandName::Home => CommandId::Homing,
            CommandName::Move => CommandId::PrePosition,
            CommandName::Grip => CommandId::GripPart,
            CommandName::Release => CommandId::ReleasePart,
            CommandName::Stop => CommandId::Stop,
            CommandName::Faststop => CommandId::FastStop,
            CommandName::Fsack => CommandId::Acknowledge,
            CommandName::Tare => CommandId::TareForceSensor,
            CommandName::Sysflags => CommandId::GetSystemState,
            CommandName::Gripstate => CommandId::GetGripperState,
            CommandName::Gripstats => CommandId::GetGrippingStatistics,
            CommandName::Pos => CommandId::GetOpeningWidth,
            CommandName::Speed => CommandId::GetSpeed,
            CommandName::Force => CommandId::GetForce,
            CommandName::Temp => CommandId::GetTemperature,
            CommandName::Sn => CommandId::GetSystemInfo,
            CommandName::Tag => CommandId::GetDeviceTag,
            CommandName::Ftype if self.second_finger => CommandId::GetFinger2Info,
            CommandName::Ftype => CommandId::GetFinger1Info,
            CommandName::Fflags if self.second_finger => CommandId::GetFinger2Flags,
            CommandName::Fflags => CommandId::GetFinger1Flags,
            CommandName::Fdata if self.second_finger => CommandId::GetFinger2Data,
            CommandName::Fdata => CommandId::GetFinger1Data,
            CommandName::Verbose
            | CommandName::Autosend
            | CommandName::Devtype
            | CommandName::Version
            | CommandName::Pwt
            | CommandName::Clt => return None,
        })
    }

    /// Calls `note` with the translated event, if the binary protocol has an equivalent.
    pub(super) fn report(&mut self, event: &GclEvent<'_>, known: &Known, note: &mut impl FnMut(&Event<'_>)) {
        match event {
            GclEvent::Answered(answer) => self.report_answer(answer, known, note),
            GclEvent::Reported(value) => self.with_value(value, known, |value| {
                if let Some(value) = value {
                    note(&Event::Reported(value));
                }
            }),
            other => {
                if let Some(event) = self.of_time(other) {
                    note(&event);
                }
            }
        }
    }

    /// Translates an event that carries no reply.
    pub(super) fn of_time(&mut self, event: &GclEvent<'_>) -> Option<Event<'static>> {
        match *event {
            GclEvent::Connected => Some(Event::Connected),
            GclEvent::Disconnected => Some(Event::Disconnected),
            GclEvent::Pending(name) => {
                if name == CommandName::Grip {
                    self.outward = self.asked_outward;
                }
                self.id(name).map(Event::Pending)
            }
            GclEvent::Unanswered(name) => self.id(name).map(Event::Unanswered),
            GclEvent::Late(name) => self.id(name).map(Event::Late),
            GclEvent::Withdrawn(name) => self.id(name).map(Event::Withdrawn),
            GclEvent::Answered(_) | GclEvent::Reported(_) => None,
        }
    }

    fn report_answer(&self, answer: &Answer<'_>, known: &Known, note: &mut impl FnMut(&Event<'_>)) {
        let Some(id) = answer.name().command().and_then(|name| self.id(name)) else { return };
        match answer {
            Answer::Value(value) => self.with_value(value, known, |value| {
                // Replies without a binary equivalent, such as the data of a tactile finger.
                let unsaid = Reply::status_only(id, Status::NotAvailable);
                note(&Event::Answered(value.map_or(unsaid, Reply::success)));
            }),
            _ => note(&Event::Answered(Reply::status_only(id, answer.status()))),
        }
    }

    /// Calls `look` with the binary protocol's value, if there is one.
    fn with_value(&self, value: &LineValue<'_>, known: &Known, look: impl FnOnce(Option<Value<'_>>)) {
        let bytes;
        let value = match *value {
            LineValue::Sysflags(Selected::All(flags)) => Some(Value::GetSystemState(flags)),
            LineValue::Gripstate(state) => Some(Value::GetGripperState(state)),
            LineValue::Gripstats(Selected::All(statistics)) => Some(Value::GetGrippingStatistics(statistics)),
            LineValue::Pos(width) => Some(Value::GetOpeningWidth(width)),
            LineValue::Speed(speed) => Some(Value::GetSpeed(speed)),
            LineValue::Force(force) => Some(Value::GetForce(force)),
            LineValue::Temp(celsius) => Some(Value::GetTemperature(tenths(celsius))),
            LineValue::Sn(serial_number) => {
                let info = known.info.unwrap_or(UNKNOWN_DEVICE);
                Some(Value::GetSystemInfo(SystemInfo { serial_number, ..info }))
            }
            // An unset tag is an empty text in GCL and E_NOT_AVAILABLE in the binary protocol.
            LineValue::Tag(tag) => (!tag.as_str().is_empty()).then_some(Value::GetDeviceTag(tag)),
            LineValue::Ftype(Selected::One(_, text)) => {
                let finger = text.finger_type();
                let data_len = if finger == FingerType::Fmf { FMF_LEN } else { 0 };
                let info = FingerInfo { finger, data_len };
                let second = self.second_finger;
                Some(if second { Value::GetFinger2Info(info) } else { Value::GetFinger1Info(info) })
            }
            LineValue::Fflags(Selected::One(_, flags)) => {
                let second = self.second_finger;
                Some(if second { Value::GetFinger2Flags(flags) } else { Value::GetFinger1Flags(flags) })
            }
            LineValue::Fdata(Selected::One(_, FingerReading::Number(force))) => {
                bytes = force.to_le_bytes();
                let of = if self.second_finger { Value::GetFinger2Data } else { Value::GetFinger1Data };
                FingerData::new(&bytes).ok().map(of)
            }
            _ => None,
        };
        look(value);
    }
}

/// Length of the data of a WSG-FMF in bytes: one `f32`.
const FMF_LEN: u16 = 4;

/// Device information that GCL does not provide.
const UNKNOWN_DEVICE: SystemInfo = SystemInfo {
    device: DeviceType::Unspecified,
    hardware_revision: 0,
    firmware: FirmwareVersion::from_bits(0),
    serial_number: 0,
};

/// Rounds to the nearest tenth of a degree and saturates out of range.
fn tenths(celsius: f32) -> Temperature {
    let half = if celsius < 0.0 { -0.5 } else { 0.5 };
    Temperature((celsius * 10.0 + half) as i16)
}

/// Translates the known state to the terms of the binary protocol.
pub(super) fn known(lines: &lines::Known, limits: Option<SystemLimits>) -> Known {
    let info = lines.device.map(|device| SystemInfo {
        device,
        firmware: lines.firmware.unwrap_or(UNKNOWN_DEVICE.firmware),
        serial_number: lines.serial_number.unwrap_or(0),
        ..UNKNOWN_DEVICE
    });
    Known {
        info,
        limits,
        flags: lines.flags,
        state: lines.state,
        width: lines.width,
        speed: lines.speed,
        force: lines.force,
        force_limit: None,
    }
}

/// Translates the settings, as far as GCL supports them.
pub(super) const fn session_config(config: &session::Config) -> lines::Config {
    lines::Config {
        reply_timeout_ms: config.reply_timeout_ms,
        attempts: config.attempts,
        refresh_ms: config.refresh_ms,
        reconnect_ms: config.reconnect_ms,
        motion_timeout_ms: config.motion_timeout_ms,
        result_grace_ms: config.result_grace_ms,
        interval_ms: config.update_period_ms as u32,
        width: config.width,
        speed: config.speed,
        force: config.force,
        ..lines::Config::DEFAULT
    }
}

pub(super) const fn autosend(topic: Topic, update: AutoUpdate) -> Autosend {
    let topic = match topic {
        Topic::SystemState => LineTopic::Sysflags,
        Topic::GripperState => LineTopic::Gripstate,
        Topic::Width => LineTopic::Pos,
        Topic::Speed => LineTopic::Speed,
        Topic::Force => LineTopic::Force,
    };
    let interval_ms = if (update.period_ms as u32) < Autosend::MIN_INTERVAL_MS {
        Autosend::MIN_INTERVAL_MS
    } else {
        update.period_ms as u32
    };
    if !update.flags.contains(UpdateFlags::AUTOMATIC) {
        Autosend::off(topic)
    } else if update.flags.contains(UpdateFlags::ON_CHANGE) {
        Autosend::on_change(topic, interval_ms)
    } else {
        Autosend::every(topic, interval_ms)
    }
}

#[cfg(test)]
mod tests;
