//! Events of a session and values of replies as plain structures.

use core::ptr;

use wsg_protocol::session::Event;
use wsg_protocol::{Reply, Value};

/// Kinds of events.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum wsg_event {
    /// The gripper replies, and all subscribed values are known.
    Connected = 1,
    /// The gripper does not reply, and its state is unknown from now on. Discard bytes that are not sent yet.
    Disconnected = 2,
    /// A requested motion has begun.
    Pending = 3,
    /// The final reply to a request: `status`, and on WSG_E_SUCCESS the value.
    Answered = 4,
    /// A request was sent, and its outcome is unknown.
    Unanswered = 5,
    /// The reply to a Stop is late and the Stop is repeated: the fingers may still move.
    Late = 6,
    /// A request was not sent and will not be sent.
    Withdrawn = 7,
    /// The gripper reported a value of its own accord.
    Reported = 8,
}

/// Kinds of values: the member of wsg_value_t to read.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum wsg_value {
    /// No value.
    None = 0,
    /// `number`, in mm, mm/s, mm/s² or N, depending on the command.
    Number = 1,
    /// `flags`: system state flags (WSG_FLAG_...), or finger flags (WSG_FINGER_FLAG_...) for Get Finger Flags.
    Flags = 2,
    /// `state`: WSG_STATE_...
    State = 3,
    /// `soft_limits`.
    SoftLimits = 4,
    /// `statistics`.
    Statistics = 5,
    /// `temperature`.
    Temperature = 6,
    /// `info`.
    Info = 7,
    /// `limits`.
    Limits = 8,
    /// `finger`.
    Finger = 9,
    /// `bytes`: echoed data, a device tag, finger data, or the reply to a custom request.
    Bytes = 10,
}

/// Device type, versions and serial number (command set, 3.5.1).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct wsg_system_info_t {
    /// Serial number.
    pub serial_number: u32,
    /// Firmware version: four bits each of major, minor 1, minor 2 and release candidate (0 for a release).
    pub firmware: u16,
    /// Product type: 0 unknown, 1 WSG 50, 2 WSG 32, 3 KMS 40, 4 WTS, 5 WSG 25, 6 WSG 70.
    pub device: u8,
    /// Hardware revision.
    pub hardware_revision: u8,
}

/// Physical limits (command set, 3.5.4). Forces are the sum over both fingers.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct wsg_system_limits_t {
    /// Maximum stroke in mm.
    pub stroke: f32,
    /// Minimum speed in mm/s.
    pub min_speed: f32,
    /// Maximum speed in mm/s.
    pub max_speed: f32,
    /// Minimum acceleration in mm/s².
    pub min_acceleration: f32,
    /// Maximum acceleration in mm/s².
    pub max_acceleration: f32,
    /// Minimum gripping force in N.
    pub min_force: f32,
    /// Nominal gripping force in N, at a duty cycle of 100 %.
    pub nominal_force: f32,
    /// Maximum gripping force in overdrive mode, in N.
    pub overdrive_force: f32,
}

/// Permitted range of the opening width (command set, 3.3.6).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct wsg_soft_limits_t {
    /// Minimum opening width in mm.
    pub minus: f32,
    /// Maximum opening width in mm.
    pub plus: f32,
}

/// Grip counters (command set, 3.4.3).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct wsg_statistics_t {
    /// Total number of grips.
    pub total: u32,
    /// Number of grips that found no part.
    pub no_part: u16,
    /// Number of grips whose part was lost before release.
    pub part_lost: u16,
}

/// The device at a finger's sensor port (command set, 3.6.1).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct wsg_finger_info_t {
    /// Length of one data frame in bytes; 0 if the finger provides no data.
    pub data_len: u16,
    /// Type of the finger: 0 generic or none, 1 WSG-FMF, 2 WSG-DSA.
    pub finger: u8,
}

/// Bytes in the memory of the library. They are valid until the event callback returns.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct wsg_bytes_t {
    /// The first byte. Not NUL-terminated, and null if a queue could not keep the bytes.
    pub data: *const u8,
    /// Number of bytes.
    pub length: u16,
}

/// The value of a reply or report. `value_kind` of the event selects the member.
#[repr(C)]
#[derive(Clone, Copy)]
pub union wsg_value_t {
    /// WSG_VALUE_NUMBER.
    pub number: f32,
    /// WSG_VALUE_FLAGS.
    pub flags: u32,
    /// WSG_VALUE_STATE.
    pub state: u8,
    /// WSG_VALUE_TEMPERATURE: in 0.1 °C.
    pub temperature: i16,
    /// WSG_VALUE_SOFT_LIMITS.
    pub soft_limits: wsg_soft_limits_t,
    /// WSG_VALUE_STATISTICS.
    pub statistics: wsg_statistics_t,
    /// WSG_VALUE_INFO.
    pub info: wsg_system_info_t,
    /// WSG_VALUE_LIMITS.
    pub limits: wsg_system_limits_t,
    /// WSG_VALUE_FINGER.
    pub finger: wsg_finger_info_t,
    /// WSG_VALUE_BYTES.
    pub bytes: wsg_bytes_t,
}

/// An event of a session.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct wsg_event_t {
    /// WSG_EVENT_...
    pub kind: u8,
    /// WSG_COMMAND_... of the request or value; 0 for WSG_EVENT_CONNECTED and WSG_EVENT_DISCONNECTED.
    pub command: u8,
    /// WSG_E_... of WSG_EVENT_ANSWERED. WSG_E_CMD_PENDING of WSG_EVENT_PENDING. Otherwise 0.
    pub status: u16,
    /// WSG_VALUE_...: the member of `value`.
    pub value_kind: u8,
    /// The value, if there is one.
    pub value: wsg_value_t,
}

impl wsg_event_t {
    const fn new(kind: wsg_event, command: u8) -> Self {
        Self {
            kind: kind as u8,
            command,
            status: 0,
            value_kind: wsg_value::None as u8,
            value: wsg_value_t { limits: NO_VALUE },
        }
    }

    fn with_value(self, value: Option<Value<'_>>) -> Self {
        let (value_kind, value) = value.map_or((wsg_value::None, self.value), |value| plain(&value));
        Self { value_kind: value_kind as u8, value, ..self }
    }

    /// Returns the event of a reply.
    pub(crate) fn answered(reply: &Reply<'_>) -> Self {
        let event = Self::new(wsg_event::Answered, reply.id().code());
        Self { status: reply.status().code(), ..event }.with_value(reply.value())
    }
}

impl From<&Event<'_>> for wsg_event_t {
    fn from(event: &Event<'_>) -> Self {
        match event {
            Event::Connected => Self::new(wsg_event::Connected, 0),
            Event::Disconnected => Self::new(wsg_event::Disconnected, 0),
            Event::Pending(id) => Self {
                status: wsg_protocol::Status::CmdPending.code(),
                ..Self::new(wsg_event::Pending, id.code())
            },
            Event::Answered(reply) => Self::answered(reply),
            Event::Unanswered(id) => Self::new(wsg_event::Unanswered, id.code()),
            Event::Late(id) => Self::new(wsg_event::Late, id.code()),
            Event::Withdrawn(id) => Self::new(wsg_event::Withdrawn, id.code()),
            Event::Reported(value) => {
                Self::new(wsg_event::Reported, value.id().code()).with_value(Some(*value))
            }
            // The enumeration is not exhaustive. A new kind of event extends this library, too.
            _ => Self::new(wsg_event::Reported, 0),
        }
    }
}

/// Fills the largest member, so that no byte of the union is uninitialized.
const NO_VALUE: wsg_system_limits_t = wsg_system_limits_t {
    stroke: 0.0,
    min_speed: 0.0,
    max_speed: 0.0,
    min_acceleration: 0.0,
    max_acceleration: 0.0,
    min_force: 0.0,
    nominal_force: 0.0,
    overdrive_force: 0.0,
};

fn plain(value: &Value<'_>) -> (wsg_value, wsg_value_t) {
    let mut plain = wsg_value_t { limits: NO_VALUE };
    let kind = match *value {
        Value::GetAcceleration(number)
        | Value::GetForceLimit(number)
        | Value::GetOpeningWidth(number)
        | Value::GetSpeed(number)
        | Value::GetForce(number) => {
            plain.number = number;
            wsg_value::Number
        }
        Value::GetSystemState(flags) => {
            plain.flags = flags.bits();
            wsg_value::Flags
        }
        Value::GetFinger1Flags(flags) | Value::GetFinger2Flags(flags) => {
            plain.flags = flags.bits().into();
            wsg_value::Flags
        }
        Value::GetGripperState(state) => {
            plain.state = state.code();
            wsg_value::State
        }
        Value::GetSoftLimits(limits) => {
            plain.soft_limits = wsg_soft_limits_t { minus: limits.minus, plus: limits.plus };
            wsg_value::SoftLimits
        }
        Value::GetGrippingStatistics(counts) => {
            let wsg_protocol::GrippingStatistics { total, no_part, part_lost } = counts;
            plain.statistics = wsg_statistics_t { total, no_part, part_lost };
            wsg_value::Statistics
        }
        Value::GetTemperature(temperature) => {
            plain.temperature = temperature.0;
            wsg_value::Temperature
        }
        Value::GetSystemInfo(info) => {
            plain.info = (&info).into();
            wsg_value::Info
        }
        Value::GetSystemLimits(limits) => {
            plain.limits = (&limits).into();
            wsg_value::Limits
        }
        Value::GetFinger1Info(info) | Value::GetFinger2Info(info) => {
            plain.finger = wsg_finger_info_t { data_len: info.data_len, finger: info.finger.code() };
            wsg_value::Finger
        }
        Value::Loop(data) => bytes(&mut plain, data.bytes()),
        Value::GetDeviceTag(tag) => bytes(&mut plain, tag.as_str().as_bytes()),
        Value::GetFinger1Data(data) | Value::GetFinger2Data(data) => bytes(&mut plain, data.bytes()),
        Value::Unknown { parameters, .. } => bytes(&mut plain, parameters),
        // A reply without values.
        _ => wsg_value::None,
    };
    (kind, plain)
}

fn bytes(plain: &mut wsg_value_t, bytes: &[u8]) -> wsg_value {
    let data = if bytes.is_empty() { ptr::null() } else { bytes.as_ptr() };
    plain.bytes = wsg_bytes_t { data, length: u16::try_from(bytes.len()).unwrap_or(u16::MAX) };
    wsg_value::Bytes
}

impl From<&wsg_protocol::SystemInfo> for wsg_system_info_t {
    fn from(info: &wsg_protocol::SystemInfo) -> Self {
        Self {
            serial_number: info.serial_number,
            firmware: info.firmware.bits(),
            device: info.device.code(),
            hardware_revision: info.hardware_revision,
        }
    }
}

impl From<&wsg_protocol::SystemLimits> for wsg_system_limits_t {
    fn from(limits: &wsg_protocol::SystemLimits) -> Self {
        let wsg_protocol::SystemLimits {
            stroke,
            min_speed,
            max_speed,
            min_acceleration,
            max_acceleration,
            min_force,
            nominal_force,
            overdrive_force,
        } = *limits;
        Self {
            stroke,
            min_speed,
            max_speed,
            min_acceleration,
            max_acceleration,
            min_force,
            nominal_force,
            overdrive_force,
        }
    }
}
