//! A client that speaks the Gripper Control Language (GCL): what each request does, and what is answered.
//!
//! The device is the one behind the binary protocol; requests become its commands where there are any. What is GCL's
//! alone is here and in `motion::gcl`: settings of the connection (VERBOSE, PWT, CLT, AUTOSEND), BYE, and the order of
//! `ACK`, `FIN` and `ERR`. What was decided where the manual is silent stands in `docs/gcl.md`.

mod autosend;

use crate::config::Config;
use crate::device::{Completion, Device};
use crate::finger::Jaw;
use crate::motion::{GripOrder, Request as Asked};
use crate::port::{FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, PortKind};
use crate::time::Time;
use crate::updates::Readings;
use autosend::Autosends;
use core::fmt::Write;
use heapless::{Deque, String};
use wsg_protocol::gcl::{
    Answer, CommandName, Description, FingerReading, Grip, LineEvent, LineReader, Named, Refused, Release,
    Request, Select, Selected, Setting, Tare, Text, Value, Vector,
};
use wsg_protocol::types::AckKey;
use wsg_protocol::{
    Command, CommandId, Counters, DeviceTag, FingerFlags, FingerType, Kind, PrePositionFlags, Status,
    SystemFlags, Value as Reading,
};

/// The longest line that is taken; the longest request is shorter, but for blanks.
const LINE_LEN: usize = 256;
/// Bytes of lines that wait for a client to read them.
const QUEUE_LEN: usize = 2_048;
/// Updates leave this much room for answers.
const RESERVED_FOR_ANSWERS: usize = 512;
/// Speed in mm/s of MOVE and GRIP when the request leaves it open. Assumed; a setting of the web interface.
const PRESET_SPEED: f32 = 100.0;
/// Distance in mm of RELEASE when the request leaves it open. Assumed; a setting of the web interface.
const PRESET_DISTANCE: f32 = 10.0;

/// A client.
#[derive(Clone, Debug)]
pub(crate) struct Client {
    pub(crate) reader: LineReader<LINE_LEN>,
    pub(crate) line: Line,
}

/// All of a client but what finds its lines.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    pub(crate) id: PortId,
    pub(crate) kind: PortKind,
    /// Whether the client has said BYE.
    pub(crate) announced: bool,
    verbose: bool,
    part_width_tolerance: f32,
    clamping_travel: f32,
    autosends: Autosends,
    queue: Deque<u8, QUEUE_LEN>,
    updates_lost: u32,
    replies_lost: u32,
}

/// What a request comes to.
enum Outcome<'a> {
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

impl Client {
    pub(crate) fn new(id: PortId, kind: PortKind, config: &Config) -> Self {
        Self {
            reader: LineReader::new(),
            line: Line {
                id,
                kind,
                announced: false,
                verbose: false,
                part_width_tolerance: config.part_width_tolerance,
                clamping_travel: config.clamping_travel,
                autosends: Autosends::default(),
                queue: Deque::new(),
                updates_lost: 0,
                replies_lost: 0,
            },
        }
    }

    pub(crate) const fn counters(&self) -> PortCounters {
        let lines = self.reader.counters();
        PortCounters {
            parser: Counters { dropped: lines.dropped, bad_checksum: 0, oversize: lines.too_long },
            updates_lost: self.line.updates_lost,
            replies_lost: self.line.replies_lost,
        }
    }
}

/// Carries out what a line asks for, and answers it.
pub(crate) fn hear(device: &mut Device, line: &mut Line, asked: Asked, event: LineEvent<'_>) {
    let request = match event {
        LineEvent::Line(text) => Request::parse(text),
        LineEvent::TooLong(start) => Err(Refused::too_long(start)),
    };
    let request = match request {
        Ok(request) => request,
        Err(refused) => {
            device.note_result(Kind::Motion, refused.mistake.status());
            let verbose = line.verbose;
            return line.answer(&refused.answer(verbose));
        }
    };
    let name = request.name();
    if line.announced {
        device.note_result(request.kind(), Status::AccessDenied);
        return line.fail(name.into(), Status::AccessDenied);
    }
    // Texts of an answer that the device does not keep.
    let mut text = String::new();
    let status = match device.carry_out(line, asked, request, &mut text) {
        Outcome::Value(value) => {
            line.answer(&Answer::Value(value));
            Status::Success
        }
        Outcome::Status(status @ (Status::Success | Status::CmdPending)) => {
            line.answer(&Answer::Ack(name));
            status
        }
        Outcome::Status(status) => {
            line.fail(name.into(), status);
            status
        }
    };
    // A subscription is a query of the binary protocol: what went wrong before it stays to be read.
    let is_subscription = matches!(request, Request::Autosend(_));
    device.note_result(if is_subscription { Kind::Query } else { request.kind() }, status);
    if line.announced {
        // Only once BYE is answered: what it ends is answered after it.
        device.abort_motion();
    }
}

impl Line {
    /// The second answer to a motion.
    pub(crate) fn complete(&mut self, done: Completion) {
        let name = match done.id {
            CommandId::Homing => CommandName::Home,
            CommandId::PrePosition => CommandName::Move,
            CommandId::GripPart => CommandName::Grip,
            CommandId::ReleasePart => CommandName::Release,
            // No request of GCL leads to another one.
            _ => return,
        };
        match done.status {
            Status::Success => self.answer(&Answer::Fin(name)),
            status => self.fail(name.into(), status),
        }
    }

    pub(crate) fn publish(&mut self, now: Time, readings: &Readings) {
        let Self { autosends, queue, updates_lost, .. } = self;
        autosends.publish(now, readings, |value| {
            let found_room = push(queue, &Answer::Update(value), QUEUE_LEN - RESERVED_FOR_ANSWERS);
            if !found_room {
                *updates_lost = updates_lost.saturating_add(1);
            }
            found_room
        });
    }

    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        self.autosends.next_due(now)
    }

    pub(crate) fn has_line(&self) -> bool {
        !self.queue.is_empty()
    }

    /// The oldest line, with its end.
    pub(crate) fn next_line<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let mut len = 0;
        while let Some(byte) = self.queue.pop_front() {
            *buffer.get_mut(len)? = byte;
            len += 1;
            if byte == b'\n' {
                return buffer.get(..len);
            }
        }
        None
    }

    fn fail(&mut self, name: Named<'_>, status: Status) {
        let description = self.verbose.then(|| Description::of(status));
        self.answer(&Answer::Err { name, status, description });
    }

    fn answer(&mut self, answer: &Answer<'_>) {
        if !push(&mut self.queue, answer, QUEUE_LEN) {
            self.replies_lost = self.replies_lost.saturating_add(1);
        }
    }

    const fn set(setting: &mut f32, value: f32) -> Status {
        if value < 0.0 {
            return Status::RangeError;
        }
        *setting = value;
        Status::Success
    }
}

/// Appends a line unless the queue would hold more than `limit` bytes; whether it did.
fn push(queue: &mut Deque<u8, QUEUE_LEN>, answer: &Answer<'_>, limit: usize) -> bool {
    let mut buffer = [0; MAX_FRAME_LEN];
    let Ok(len) = answer.write_line_into(&mut buffer) else { return false };
    if queue.len() + len > limit {
        return false;
    }
    buffer.iter().take(len).all(|byte| queue.push_back(*byte).is_ok())
}

/// Room for the texts of an answer.
type TextBuffer = String<32>;

impl Device {
    fn carry_out<'a>(
        &'a mut self,
        line: &mut Line,
        asked: Asked,
        request: Request,
        text: &'a mut TextBuffer,
    ) -> Outcome<'a> {
        let [one, two] = [Jaw::One, Jaw::Two];
        let command = match request {
            Request::Verbose(on) => {
                line.verbose = on;
                return Value::Verbose(on).into();
            }
            // Nobody can tell when a conversation by datagrams ends.
            Request::Bye if line.kind.is_datagram() => return Status::NotAvailable.into(),
            Request::Bye => {
                line.announced = true;
                line.autosends.clear();
                return Status::Success.into();
            }
            Request::Pwt(setting) => {
                let tolerance = &mut line.part_width_tolerance;
                return match setting {
                    Setting::Set(value) if Line::set(tolerance, value) != Status::Success => {
                        Status::RangeError.into()
                    }
                    _ => Value::Pwt(*tolerance).into(),
                };
            }
            Request::Clt(setting) => {
                let travel = &mut line.clamping_travel;
                return match setting {
                    Setting::Set(value) if Line::set(travel, value) != Status::Success => {
                        Status::RangeError.into()
                    }
                    _ => Value::Clt(*travel).into(),
                };
            }
            Request::Autosend(autosend) => {
                line.autosends.request(autosend, asked.now);
                return Status::Success.into();
            }

            Request::Home(direction) => Command::Homing { direction },
            Request::Move(to) => Command::PrePosition {
                flags: PrePositionFlags::STOP_ON_BLOCK,
                width: to.width,
                speed: to.speed.unwrap_or(PRESET_SPEED),
            },
            Request::Grip(grip) => return self.grip(line, asked, grip).into(),
            Request::Release(release) => {
                let fastest = self.parameters.limits.max_speed;
                let (distance, speed) = match release {
                    Release::Preset => (PRESET_DISTANCE, fastest),
                    Release::By { distance } => (distance, fastest),
                    Release::ByAtSpeed { distance, speed } => (distance, speed),
                };
                return self.start_release_by(asked, distance, speed).into();
            }
            Request::Stop => Command::Stop,
            Request::Faststop => Command::FastStop,
            Request::Fsack => Command::Acknowledge { key: AckKey },
            Request::Tare(Tare::All) => Command::TareForceSensor,
            Request::Tare(Tare::Finger(index)) => {
                return self.tare_finger(if index == 0 { one } else { two }).into();
            }

            Request::Pos => return Value::Pos(self.reported_width()).into(),
            Request::Speed => return Value::Speed(self.readings().speed).into(),
            Request::Force => return Value::Force(self.reported_force()).into(),
            Request::Gripstate => return Value::Gripstate(self.state).into(),
            Request::Temp => return Value::Temp(celsius(&self.readings())).into(),
            Request::Sysflags(select) => {
                let flags = self.flags();
                return Value::Sysflags(match select {
                    Select::All => Selected::All(flags),
                    Select::One(index) => Selected::One(index, flag(flags, index)),
                })
                .into();
            }
            Request::Gripstats(select) => {
                let counts = self.statistics;
                return Value::Gripstats(match select {
                    Select::All => Selected::All(counts),
                    Select::One(0) => Selected::One(0, counts.total),
                    Select::One(1) => Selected::One(1, counts.no_part.into()),
                    Select::One(index) => Selected::One(index, counts.part_lost.into()),
                })
                .into();
            }

            Request::Sn => return Value::Sn(self.config.serial_number).into(),
            Request::Tag => {
                return DeviceTag::new(self.tag.as_str())
                    .map_or(Status::NotAvailable.into(), |tag| Value::Tag(tag).into());
            }
            Request::Devtype => {
                let parameters = self.parameters;
                // Such as `WSG 32-068`: type and stroke.
                let _ = write!(text, "{}-{:03}", parameters.device, parameters.limits.stroke as u16);
                return Value::Devtype(text_of(text)).into();
            }
            Request::Version => {
                let _ = write!(text, "{}", self.info().firmware);
                return Value::Version(text_of(text)).into();
            }

            Request::Ftype(select) => {
                return Value::Ftype(match select {
                    Select::All => Selected::All([self.finger_type(one), self.finger_type(two)]),
                    Select::One(index) => Selected::One(index, self.finger_type(jaw(index))),
                })
                .into();
            }
            Request::Fflags(select) => {
                return Value::Fflags(match select {
                    Select::All => Selected::All([self.finger_flags(one), self.finger_flags(two)]),
                    Select::One(index) => Selected::One(index, self.finger_flags(jaw(index))),
                })
                .into();
            }
            Request::Fdata(select) => {
                return match select {
                    Select::All => {
                        let empty = FingerReading::Vector(Vector::EMPTY);
                        let mut of = |jaw| self.finger_reading(asked, jaw).unwrap_or(empty);
                        Value::Fdata(Selected::All([of(one), of(two)])).into()
                    }
                    Select::One(index) => match self.finger_reading(asked, jaw(index)) {
                        Ok(reading) => Value::Fdata(Selected::One(index, reading)).into(),
                        Err(status) => status.into(),
                    },
                };
            }
        };
        self.execute(asked, &command).status().into()
    }

    fn grip(&mut self, line: &Line, asked: Asked, grip: Grip) -> Status {
        let (force, width, speed) = match grip {
            Grip::Preset => (None, None, None),
            Grip::Force { force } => (Some(force), None, None),
            Grip::Part { force, width } => (Some(force), Some(width), None),
            Grip::PartAtSpeed { force, width, speed } => (Some(force), Some(width), Some(speed)),
        };
        let limits = self.parameters.limits;
        let greatest = self.greatest_force();
        self.start_grip_by(
            asked,
            GripOrder {
                // Of this grip alone: what the binary protocol has set stays.
                force: force.map_or(self.force_limit, |force| force.clamp(limits.min_force, greatest)),
                width,
                speed: speed.unwrap_or(PRESET_SPEED),
                tolerance: line.part_width_tolerance,
                clamping_travel: line.clamping_travel,
            },
        )
    }

    fn tare_finger(&mut self, jaw: Jaw) -> Status {
        if !self.finger(jaw).is_force_sensor() {
            return Status::NotAvailable;
        }
        if self.state == wsg_protocol::GripperState::Holding {
            return Status::AccessDenied;
        }
        let force = self.force_per_jaw();
        self.finger(jaw).zero_at(force);
        Status::Success
    }

    fn finger_type(&mut self, jaw: Jaw) -> Text<'static> {
        let name = match self.finger(jaw).info().finger {
            FingerType::Fmf => "WSG-FMF",
            FingerType::Dsa => "WSG-DSA",
            FingerType::Generic | FingerType::Unknown(_) => "",
        };
        text_of(name)
    }

    fn finger_flags(&mut self, jaw: Jaw) -> FingerFlags {
        self.finger(jaw).flags()
    }

    /// What the finger measures, as the binary protocol's frame has it: one number.
    fn finger_reading(&mut self, asked: Asked, jaw: Jaw) -> Result<FingerReading<'static>, Status> {
        let command = match jaw {
            Jaw::One => Command::GetFinger1Data,
            Jaw::Two => Command::GetFinger2Data,
        };
        let reply = self.execute(asked, &command);
        match reply.value() {
            Some(Reading::GetFinger1Data(data) | Reading::GetFinger2Data(data)) => {
                let bytes = data.bytes().first_chunk::<4>().copied().unwrap_or_default();
                Ok(FingerReading::Number(f32::from_le_bytes(bytes)))
            }
            _ => Err(reply.status()),
        }
    }
}

const fn jaw(index: u8) -> Jaw {
    if index == 0 { Jaw::One } else { Jaw::Two }
}

fn flag(flags: SystemFlags, index: u8) -> bool {
    flags.bits() >> index & 1 == 1
}

/// The temperature in °C.
fn celsius(readings: &Readings) -> f32 {
    f32::from(readings.temperature.0) / 10.0
}

/// A text of the gripper's own, which holds nothing that a text may not.
fn text_of(text: &str) -> Text<'_> {
    Text::new(text).unwrap_or_default()
}
