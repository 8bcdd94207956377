//! Events of a session and values of replies as plain structures.

use core::ptr;

use wsg_protocol::session::Event;
use wsg_protocol::{CommandId, Reply, Status};

/// Kinds of events.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum wsg_event {
    /// The gripper replies, and all subscribed values are known.
    Connected = 1,
    /// The gripper does not reply, and its state is unknown from now on. Discard unsent bytes, except a FAST STOP.
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
    /// Product type: 0 unknown, 1 WSG 50, 2 WSG 32, 3 KMS 40, 4 WTS, 5 WSG 25, 6 WSG 70.
    pub device: u8,
    /// Hardware revision.
    pub hardware_revision: u8,
    /// Firmware version: four bits each of major, minor 1, minor 2 and release candidate (0 for a release).
    pub firmware: u16,
    /// Serial number.
    pub serial_number: u32,
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
    /// Always 0.
    pub reserved: u8,
    /// Type of the finger: 0 generic or none, 1 WSG-FMF, 2 WSG-DSA.
    pub finger: u8,
    /// Length of one data frame in bytes; 0 if the finger provides no data.
    pub data_len: u16,
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
    /// Private.
    pub payload: [u8; 32],
}

/// The longest value but bytes.
/// cbindgen:ignore
const PAYLOAD_LEN: usize = 32;

// Values are copied from the payload of the reply as they are.
const _: () = assert!(cfg!(target_endian = "little") && size_of::<wsg_value_t>() == PAYLOAD_LEN);

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
        Self { kind: kind as u8, command, status: 0, value_kind: wsg_value::None as u8, value: NO_VALUE }
    }

    /// Takes the value from the payload of its reply, without the status.
    fn with_value(mut self, id: CommandId, payload: &[u8]) -> Self {
        let kind = kind_of(id);
        self.value_kind = kind as u8;
        match kind {
            wsg_value::None => {}
            wsg_value::Bytes => {
                let data = if payload.is_empty() { ptr::null() } else { payload.as_ptr() };
                self.value.bytes = wsg_bytes_t { data, length: payload.len() as u16 };
            }
            _ => {
                let mut copy = [0; PAYLOAD_LEN];
                // The one value that does not begin at an aligned byte.
                let skipped = usize::from(kind == wsg_value::Finger);
                for (slot, byte) in copy.iter_mut().skip(skipped).zip(payload) {
                    *slot = *byte;
                }
                self.value.payload = copy;
            }
        }
        self
    }

    /// Returns the event of a reply and its payload.
    pub(crate) fn answered(reply: &Reply<'_>, payload: &[u8]) -> Self {
        let event =
            Self { status: reply.status().code(), ..Self::new(wsg_event::Answered, reply.id().code()) };
        if reply.value().is_some() { event.with_value(reply.id(), payload) } else { event }
    }

    /// Returns the plain form of an event. `payload` is the payload, without the status, of the frame that caused it.
    pub(crate) fn of(event: &Event<'_>, payload: &[u8]) -> Self {
        let (kind, id) = match event {
            Event::Connected => return Self::new(wsg_event::Connected, 0),
            Event::Disconnected => return Self::new(wsg_event::Disconnected, 0),
            Event::Answered(reply) => return Self::answered(reply, payload),
            Event::Reported(value) => {
                let id = value.id();
                return Self::new(wsg_event::Reported, id.code()).with_value(id, payload);
            }
            Event::Pending(id) => (wsg_event::Pending, id),
            Event::Unanswered(id) => (wsg_event::Unanswered, id),
            Event::Late(id) => (wsg_event::Late, id),
            Event::Withdrawn(id) => (wsg_event::Withdrawn, id),
            // The enumeration is not exhaustive. A new kind of event extends this library, too.
            _ => return Self::new(wsg_event::Reported, 0),
        };
        let status = if matches!(kind, wsg_event::Pending) { Status::CmdPending.code() } else { 0 };
        Self { status, ..Self::new(kind, id.code()) }
    }
}

/// Fills the largest member, so that no byte of the union is uninitialized.
const NO_VALUE: wsg_value_t = wsg_value_t { payload: [0; PAYLOAD_LEN] };

/// Returns the kind of a command's value.
const fn kind_of(id: CommandId) -> wsg_value {
    match id {
        CommandId::GetAcceleration
        | CommandId::GetForceLimit
        | CommandId::GetOpeningWidth
        | CommandId::GetSpeed
        | CommandId::GetForce => wsg_value::Number,
        CommandId::GetSystemState | CommandId::GetFinger1Flags | CommandId::GetFinger2Flags => {
            wsg_value::Flags
        }
        CommandId::GetGripperState => wsg_value::State,
        CommandId::GetSoftLimits => wsg_value::SoftLimits,
        CommandId::GetGrippingStatistics => wsg_value::Statistics,
        CommandId::GetTemperature => wsg_value::Temperature,
        CommandId::GetSystemInfo => wsg_value::Info,
        CommandId::GetSystemLimits => wsg_value::Limits,
        CommandId::GetFinger1Info | CommandId::GetFinger2Info => wsg_value::Finger,
        CommandId::Loop
        | CommandId::GetDeviceTag
        | CommandId::GetFinger1Data
        | CommandId::GetFinger2Data
        | CommandId::Unknown(_) => wsg_value::Bytes,
        _ => wsg_value::None,
    }
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
