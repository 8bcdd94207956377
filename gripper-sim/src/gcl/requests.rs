//! Execution of the requests of the text protocol. Most become commands of the binary protocol. Only the settings of
//! the connection (VERBOSE, PWT, CLT, AUTOSEND), BYE, GRIP and RELEASE are implemented here.

use super::{Line, celsius};
use crate::config::Config;
use crate::device::Device;
use crate::finger::Jaw;
use crate::motion::GripOrder;
use crate::port::Request as Asked;
use crate::time::Time;
use core::fmt::Write;
use heapless::String;
use wsg_protocol::gcl::{
    FingerReading, Grip, Release, Request, Select, Selected, Setting, Tare, Text, Value, Vector,
};
use wsg_protocol::types::AckKey;
use wsg_protocol::{Command, DeviceTag, FingerType, PrePositionFlags, Status, SystemFlags, Value as Reading};

/// The result of a request.
pub(super) enum Outcome<'a> {
    Status(Status),
    Value(Value<'a>),
}

impl<'a> From<Status> for Outcome<'a> {
    fn from(status: Status) -> Self {
        Self::Status(status)
    }
}

impl<'a> From<Value<'a>> for Outcome<'a> {
    fn from(value: Value<'a>) -> Self {
        Self::Value(value)
    }
}

/// Buffer for the texts of an answer.
type TextBuffer = String<32>;

/// Executes a request and returns its immediate answer.
pub(super) fn carry_out<'a>(
    device: &'a mut Device,
    line: &mut Line,
    now: Time,
    request: Request,
    text: &'a mut TextBuffer,
) -> Outcome<'a> {
    let asked = Asked { port: line.id, now };
    let [one, two] = [Jaw::One, Jaw::Two];
    let command = match request {
        Request::Verbose(on) => {
            line.verbose = on;
            return Value::Verbose(on).into();
        }
        // The end of a UDP conversation cannot be detected.
        Request::Bye if line.kind.is_datagram() => return Status::NotAvailable.into(),
        Request::Bye => {
            line.announced = true;
            line.autosends.clear();
            return Status::Success.into();
        }
        Request::Pwt(setting) => {
            return read_or_set(&mut line.part_width_tolerance, setting)
                .map_or_else(Outcome::from, |value| Value::Pwt(value).into());
        }
        Request::Clt(setting) => {
            return read_or_set(&mut line.clamping_travel, setting)
                .map_or_else(Outcome::from, |value| Value::Clt(value).into());
        }
        Request::Autosend(autosend) => {
            line.autosends.request(autosend, now);
            return Status::Success.into();
        }

        Request::Home(direction) => Command::Homing { direction },
        Request::Move(to) => Command::PrePosition {
            flags: PrePositionFlags::STOP_ON_BLOCK,
            width: to.width,
            speed: to.speed.unwrap_or(device.config().speed),
        },
        Request::Grip(grip) => return start_grip(device, line, asked, grip).into(),
        Request::Release(release) => {
            let Config { release_distance, release_speed, .. } = *device.config();
            let preset = release_speed.unwrap_or(device.limits().max_speed);
            let (distance, speed) = match release {
                Release::Preset => (release_distance, preset),
                Release::By { distance } => (distance, preset),
                Release::ByAtSpeed { distance, speed } => (distance, speed),
            };
            return device.release_by(asked, distance, speed).into();
        }
        Request::Stop => Command::Stop,
        Request::Faststop => Command::FastStop,
        Request::Fsack => Command::Acknowledge { key: AckKey },
        Request::Tare(Tare::All) => Command::TareForceSensor,
        Request::Tare(Tare::Finger(index)) => {
            return device.tare_finger(jaw(index)).into();
        }

        Request::Pos => return Value::Pos(device.reported_width()).into(),
        Request::Speed => return Value::Speed(device.readings().speed).into(),
        Request::Force => return Value::Force(device.reported_force()).into(),
        Request::Gripstate => return Value::Gripstate(device.state()).into(),
        Request::Temp => return Value::Temp(celsius(&device.readings())).into(),
        Request::Sysflags(select) => {
            let flags = device.flags();
            return Value::Sysflags(match select {
                Select::All => Selected::All(flags),
                Select::One(index) => Selected::One(index, flag(flags, index)),
            })
            .into();
        }
        Request::Gripstats(select) => {
            let counts = device.statistics();
            return Value::Gripstats(match select {
                Select::All => Selected::All(counts),
                Select::One(0) => Selected::One(0, counts.total),
                Select::One(1) => Selected::One(1, counts.no_part.into()),
                Select::One(index) => Selected::One(index, counts.part_lost.into()),
            })
            .into();
        }

        Request::Sn => return Value::Sn(device.config().serial_number).into(),
        Request::Tag => {
            return DeviceTag::new(device.tag().as_str())
                .map_or(Status::NotAvailable.into(), |tag| Value::Tag(tag).into());
        }
        Request::Devtype => {
            // For example `WSG 32-068`: type and stroke.
            let _ = write!(text, "{}-{:03}", device.info().device, device.limits().stroke as u16);
            return Value::Devtype(text_of(text)).into();
        }
        Request::Version => {
            let _ = write!(text, "{}", device.info().firmware);
            return Value::Version(text_of(text)).into();
        }

        Request::Ftype(select) => {
            return Value::Ftype(match select {
                Select::All => Selected::All([finger_type(device, one), finger_type(device, two)]),
                Select::One(index) => Selected::One(index, finger_type(device, jaw(index))),
            })
            .into();
        }
        Request::Fflags(select) => {
            return Value::Fflags(match select {
                Select::All => Selected::All([device.finger(one).flags(), device.finger(two).flags()]),
                Select::One(index) => Selected::One(index, device.finger(jaw(index)).flags()),
            })
            .into();
        }
        Request::Fdata(select) => {
            return match select {
                Select::All => {
                    let empty = FingerReading::Vector(Vector::EMPTY);
                    let mut of = |jaw| finger_reading(device, asked, jaw).unwrap_or(empty);
                    Value::Fdata(Selected::All([of(one), of(two)])).into()
                }
                Select::One(index) => match finger_reading(device, asked, jaw(index)) {
                    Ok(reading) => Value::Fdata(Selected::One(index, reading)).into(),
                    Err(status) => status.into(),
                },
            };
        }
    };
    device.execute(asked, &command).status().into()
}

fn start_grip(device: &mut Device, line: &Line, asked: Asked, grip: Grip) -> Status {
    let (force, width, speed) = match grip {
        Grip::Preset => (None, None, None),
        Grip::Force { force } => (Some(force), None, None),
        Grip::Part { force, width } => (Some(force), Some(width), None),
        Grip::PartAtSpeed { force, width, speed } => (Some(force), Some(width), Some(speed)),
    };
    let order = GripOrder {
        // The force applies to this grip only; the force limit of the binary protocol is unchanged.
        force: force.map_or(device.force_limit(), |force| device.possible_force(force)),
        width,
        speed: speed.unwrap_or(device.config().speed),
        tolerance: line.part_width_tolerance,
        clamping_travel: line.clamping_travel,
    };
    device.grip_by(asked, order)
}

fn finger_type(device: &Device, jaw: Jaw) -> Text<'static> {
    let name = match device.finger(jaw).info().finger {
        FingerType::Fmf => "WSG-FMF",
        FingerType::Dsa => "WSG-DSA",
        FingerType::Generic | FingerType::Unknown(_) => "",
    };
    text_of(name)
}

/// Returns the reading of the finger, one number as in the frame of the binary protocol.
fn finger_reading(device: &mut Device, asked: Asked, jaw: Jaw) -> Result<FingerReading<'static>, Status> {
    let command = match jaw {
        Jaw::One => Command::GetFinger1Data,
        Jaw::Two => Command::GetFinger2Data,
    };
    let reply = device.execute(asked, &command);
    match reply.value() {
        Some(Reading::GetFinger1Data(data) | Reading::GetFinger2Data(data)) => {
            let bytes = data.bytes().first_chunk::<4>().copied().unwrap_or_default();
            Ok(FingerReading::Number(f32::from_le_bytes(bytes)))
        }
        _ => Err(reply.status()),
    }
}

const fn jaw(index: u8) -> Jaw {
    if index == 0 { Jaw::One } else { Jaw::Two }
}

fn flag(flags: SystemFlags, index: u8) -> bool {
    flags.bits() >> index & 1 == 1
}

/// Converts a text of the gripper's own, which contains only permitted characters.
fn text_of(text: &str) -> Text<'_> {
    Text::new(text).unwrap_or_default()
}

/// Reads or sets a setting of the connection, in mm. Rejects negative values.
fn read_or_set(kept: &mut f32, setting: Setting) -> Result<f32, Status> {
    match setting {
        Setting::Set(value) if value < 0.0 => return Err(Status::RangeError),
        Setting::Set(value) => *kept = value,
        Setting::Ask => {}
    }
    Ok(*kept)
}
