//! Execution of the requests of the text protocol. Most become commands of the binary protocol. Only the settings of
//! the connection (VERBOSE, PWT, CLT, AUTOSEND), BYE, GRIP and RELEASE are implemented here.

use super::{TextSession, celsius};
use crate::config::Config;
use crate::device::Device;
use crate::finger::Jaw;
use crate::motion::GripOrder;
use crate::port::Request as Requester;
use crate::time::Time;
use core::fmt::Write;
use heapless::String;
use wsg_protocol::gcl::{
    FingerReading, Grip, Release, Request, Select, Selected, Setting, Tare, Text, Value, Vector,
};
use wsg_protocol::{
    Command, DeviceTag, FingerType, GrippingStatistics, PrePositionFlags, Status, SystemFlags,
    Value as Reading,
};

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

impl<'a> From<Result<Value<'a>, Status>> for Outcome<'a> {
    fn from(result: Result<Value<'a>, Status>) -> Self {
        result.map_or_else(Self::Status, Self::Value)
    }
}

type FingerReadings = Selected<[FingerReading<'static>; 2], FingerReading<'static>, 2>;

/// Buffer for the texts of an answer.
type TextBuffer = String<32>;

/// Executes a request and returns its immediate answer.
pub(super) fn carry_out<'a>(
    device: &'a mut Device,
    line: &mut TextSession,
    now: Time,
    request: Request,
    text: &'a mut TextBuffer,
) -> Outcome<'a> {
    let requester = Requester { port: line.id, now };
    let jaws = [Jaw::One, Jaw::Two];
    match request {
        Request::Verbose(on) => {
            line.verbose = on;
            Value::Verbose(on).into()
        }
        // The end of a UDP conversation cannot be detected.
        Request::Bye if line.kind.is_datagram() => Status::NotAvailable.into(),
        Request::Bye => {
            line.announced = true;
            line.autosends.clear();
            Status::Success.into()
        }
        Request::Pwt(setting) => read_or_set(&mut line.part_width_tolerance, setting).map(Value::Pwt).into(),
        Request::Clt(setting) => read_or_set(&mut line.clamping_travel, setting).map(Value::Clt).into(),
        Request::Autosend(autosend) => {
            line.autosends.subscribe(autosend, now);
            Status::Success.into()
        }

        Request::Home(direction) => device.execute(requester, &Command::Homing { direction }).status().into(),
        Request::Move(to) => {
            let flags = PrePositionFlags::STOP_ON_BLOCK;
            let speed = to.speed.unwrap_or(device.config().speed);
            device.execute(requester, &Command::PrePosition { flags, width: to.width, speed }).status().into()
        }
        Request::Grip(grip) => start_grip(device, line, requester, grip).into(),
        Request::Release(release) => start_release(device, requester, release).into(),
        Request::Stop => device.execute(requester, &Command::Stop).status().into(),
        Request::Faststop => device.execute(requester, &Command::FastStop).status().into(),
        Request::Fsack => device.execute(requester, &Command::ACKNOWLEDGE).status().into(),
        Request::Tare(Tare::All) => device.execute(requester, &Command::TareForceSensor).status().into(),
        Request::Tare(Tare::Finger(index)) => device.tare(&[jaw(index)]).into(),

        Request::Pos => Value::Pos(device.reported_width()).into(),
        Request::Speed => Value::Speed(device.readings().speed).into(),
        Request::Force => Value::Force(device.reported_force()).into(),
        Request::Gripstate => Value::Gripstate(device.motion().state()).into(),
        Request::Temp => Value::Temp(celsius(&device.readings())).into(),
        Request::Sysflags(select) => {
            Value::Sysflags(selected(select, device.flags(), |index| flag(device.flags(), index))).into()
        }
        Request::Gripstats(select) => {
            let counts = device.motion().statistics();
            Value::Gripstats(selected(select, counts, |index| count(counts, index))).into()
        }

        Request::Sn => Value::Sn(device.config().serial_number).into(),
        Request::Tag => {
            DeviceTag::new(device.tag().as_str()).map(Value::Tag).map_err(|_| Status::NotAvailable).into()
        }
        Request::Devtype => {
            // For example `WSG 32-068`: type and stroke.
            let _ = write!(text, "{}-{:03}", device.info().device, device.limits().stroke as u16);
            Value::Devtype(text_of(text)).into()
        }
        Request::Version => {
            let _ = write!(text, "{}", device.info().firmware);
            Value::Version(text_of(text)).into()
        }

        Request::Ftype(select) => {
            let of = |jaw| finger_type(device, jaw);
            Value::Ftype(selected(select, jaws.map(of), |index| of(jaw(index)))).into()
        }
        Request::Fflags(select) => {
            let of = |jaw| device.finger(jaw).flags();
            Value::Fflags(selected(select, jaws.map(of), |index| of(jaw(index)))).into()
        }
        Request::Fdata(select) => finger_readings(device, requester, select).map(Value::Fdata).into(),
    }
}

/// Returns all of a vector, or the selected element.
fn selected<All, One, const LEN: u8>(
    select: Select<LEN>,
    all: All,
    one: impl FnOnce(u8) -> One,
) -> Selected<All, One, LEN> {
    match select {
        Select::All => Selected::All(all),
        Select::One(index) => Selected::One(index, one(index)),
    }
}

fn start_release(device: &mut Device, requester: Requester, release: Release) -> Status {
    let Config { release_distance, release_speed, .. } = *device.config();
    let preset = release_speed.unwrap_or(device.limits().max_speed);
    let (distance, speed) = match release {
        Release::Preset => (release_distance, preset),
        Release::By { distance } => (distance, preset),
        Release::ByAtSpeed { distance, speed } => (distance, speed),
    };
    device.motion_mut().start_release_by(requester, distance, speed)
}

fn start_grip(device: &mut Device, line: &TextSession, requester: Requester, grip: Grip) -> Status {
    let (force, width, speed) = match grip {
        Grip::Preset => (None, None, None),
        Grip::Force { force } => (Some(force), None, None),
        Grip::Part { force, width } => (Some(force), Some(width), None),
        Grip::PartAtSpeed { force, width, speed } => (Some(force), Some(width), Some(speed)),
    };
    let settings = device.motion().settings();
    let order = GripOrder {
        // The force applies to this grip only; the force limit of the binary protocol is unchanged.
        force: force.map_or(settings.force_limit(), |force| settings.possible_force(force)),
        width,
        speed: speed.unwrap_or(device.config().speed),
        tolerance: line.part_width_tolerance,
        clamping_travel: line.clamping_travel,
    };
    device.motion_mut().start_grip_by(requester, order)
}

fn finger_type(device: &Device, jaw: Jaw) -> Text<'static> {
    let name = match device.finger(jaw).info().finger {
        FingerType::Fmf => "WSG-FMF",
        FingerType::Dsa => "WSG-DSA",
        FingerType::Generic | FingerType::Unknown(_) => "",
    };
    text_of(name)
}

/// Returns the readings of the selected fingers. Of two, a missing one is an empty vector.
fn finger_readings(
    device: &mut Device,
    requester: Requester,
    select: Select<2>,
) -> Result<FingerReadings, Status> {
    Ok(match select {
        Select::All => Selected::All([Jaw::One, Jaw::Two].map(|jaw| {
            finger_reading(device, requester, jaw).unwrap_or(FingerReading::Vector(Vector::EMPTY))
        })),
        Select::One(index) => Selected::One(index, finger_reading(device, requester, jaw(index))?),
    })
}

/// Returns the reading of the finger, one number as in the frame of the binary protocol.
fn finger_reading(
    device: &mut Device,
    requester: Requester,
    jaw: Jaw,
) -> Result<FingerReading<'static>, Status> {
    let command = match jaw {
        Jaw::One => Command::GetFinger1Data,
        Jaw::Two => Command::GetFinger2Data,
    };
    let reply = device.execute(requester, &command);
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

fn count(counts: GrippingStatistics, index: u8) -> u32 {
    match index {
        0 => counts.total,
        1 => counts.no_part.into(),
        _ => counts.part_lost.into(),
    }
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
