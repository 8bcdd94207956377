//! One function per request of the command set manual, chapter 3.
//!
//! Each returns 0 if the session has accepted the request, and a negative [`wsg_error`] if it was rejected and will never be
//! sent. The outcome is reported as an event with the command's id.
//!
//! Widths, speeds, accelerations and forces outside the limits of the connected gripper are rejected, because the gripper
//! would correct some of them without an error. See [`wsg_protocol::limits`].

use core::ffi::c_char;

use wsg_protocol::session::{Known, Topic};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, DeviceTag, HomingDirection, PrePositionFlags, SoftLimits,
};

use crate::error::{DONE, Outcome, code, wsg_error};
use crate::memory;
use crate::session::wsg_t;

/// Direction of wsg_homing(): as configured in the gripper.
pub const WSG_HOMING_DEFAULT: u8 = 0;
/// Direction of wsg_homing(): outward, the fingers open.
pub const WSG_HOMING_POSITIVE: u8 = 1;
/// Direction of wsg_homing(): inward, the fingers close.
pub const WSG_HOMING_NEGATIVE: u8 = 2;

/// Flag of wsg_pre_position(): the width is an offset to the current one.
pub const WSG_RELATIVE: u8 = 1;
/// Flag of wsg_pre_position(): the motor is turned off if the fingers are blocked. Without it they clamp.
pub const WSG_STOP_ON_BLOCK: u8 = 2;

fn send(wsg: Option<&mut wsg_t>, command: Command<'static>) -> i32 {
    let send = || -> Outcome {
        let inner = wsg_t::open(wsg)?;
        command.check().map_err(wsg_error::of_argument)?;
        if let Known { limits: Some(limits), flags, width, .. } = inner.session.known() {
            let checked = command.check_limits(limits, flags.unwrap_or_default(), *width);
            checked.map_err(|_| wsg_error::OutOfLimits)?;
        }
        inner.session.request(command)?;
        DONE
    };
    code(send())
}

/// A switch of C, where any integer may arrive.
fn switch(value: u8) -> Result<bool, wsg_error> {
    match value {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(wsg_error::Argument),
    }
}

/// Sends a request whose arguments must be checked first.
fn send_checked(wsg: Option<&mut wsg_t>, command: Result<Command<'static>, wsg_error>) -> i32 {
    match command {
        Ok(command) => send(wsg, command),
        Err(error) => error as i32,
    }
}

/// Loop (06h): the gripper echoes `length` bytes, at most 64.
///
/// The data must stay valid and unchanged until the final event of the request, or until wsg_withdraw() or wsg_init(). At
/// most one request with such data is open at a time; a further one returns WSG_ERROR_QUEUE_FULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_loop(wsg: Option<&mut wsg_t>, data: *const u8, length: usize) -> i32 {
    // SAFETY: passed on to the caller.
    unsafe { send_kept(wsg, CommandId::Loop.code(), data, length) }
}

/// Disconnect Announcement (07h): announces the end of a TCP connection, so that it does not cause a FAST STOP.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_disconnect_announcement(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::DisconnectAnnouncement)
}

/// Homing (20h): references the fingers at an end stop. `direction` is WSG_HOMING_...
#[unsafe(no_mangle)]
pub extern "C" fn wsg_homing(wsg: Option<&mut wsg_t>, direction: u8) -> i32 {
    let direction = HomingDirection::from_code(direction).ok_or(wsg_error::Argument);
    send_checked(wsg, direction.map(|direction| Command::Homing { direction }))
}

/// Pre-position Fingers (21h): moves to an opening width in mm, or by an offset, at `speed` in mm/s. `flags` is 0 or a
/// combination of WSG_RELATIVE and WSG_STOP_ON_BLOCK.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_pre_position(wsg: Option<&mut wsg_t>, flags: u8, width: f32, speed: f32) -> i32 {
    let flags = PrePositionFlags::from_bits(flags).ok_or(wsg_error::Argument);
    send_checked(wsg, flags.map(|flags| Command::PrePosition { flags, width, speed }))
}

/// Stop (22h): stops any finger movement. Overtakes and withdraws all queued requests. Without a connection it is sent
/// once, immediately.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_stop(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::Stop)
}

/// FAST STOP (23h): stops any finger movement as fast as possible and locks motion until wsg_acknowledge(). It is sent
/// before everything else and repeated until the gripper confirms it, even across a reconnect.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_fast_stop(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::FastStop)
}

/// Acknowledge FAST STOP (24h): acknowledges a FAST STOP or a fault and unlocks motion.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_acknowledge(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::ACKNOWLEDGE)
}

/// Grip Part (25h): grips a part of a nominal `width` in mm at `speed` in mm/s with the current force limit.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_grip_part(wsg: Option<&mut wsg_t>, width: f32, speed: f32) -> i32 {
    send(wsg, Command::GripPart { width, speed })
}

/// Release Part (26h): opens the fingers to `width` in mm at `speed` in mm/s.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_release_part(wsg: Option<&mut wsg_t>, width: f32, speed: f32) -> i32 {
    send(wsg, Command::ReleasePart { width, speed })
}

/// Set Acceleration (30h), in mm/s².
#[unsafe(no_mangle)]
pub extern "C" fn wsg_set_acceleration(wsg: Option<&mut wsg_t>, acceleration: f32) -> i32 {
    send(wsg, Command::SetAcceleration { acceleration })
}

/// Get Acceleration (31h): WSG_VALUE_NUMBER in mm/s².
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_acceleration(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetAcceleration)
}

/// Set Force Limit (32h), in N, summed over both fingers.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_set_force_limit(wsg: Option<&mut wsg_t>, force: f32) -> i32 {
    send(wsg, Command::SetForceLimit { force })
}

/// Get Force Limit (33h): WSG_VALUE_NUMBER in N.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_force_limit(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetForceLimit)
}

/// Set Soft Limits (34h): the permitted range of the opening width in mm.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_set_soft_limits(wsg: Option<&mut wsg_t>, minus: f32, plus: f32) -> i32 {
    send(wsg, Command::SetSoftLimits { limits: SoftLimits { minus, plus } })
}

/// Get Soft Limits (35h): WSG_VALUE_SOFT_LIMITS.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_soft_limits(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetSoftLimits)
}

/// Clear Soft Limits (36h).
#[unsafe(no_mangle)]
pub extern "C" fn wsg_clear_soft_limits(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::ClearSoftLimits)
}

/// Overdrive Mode (37h): 1 permits forces up to the overdrive limit, 0 up to the nominal force.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_overdrive_mode(wsg: Option<&mut wsg_t>, enabled: u8) -> i32 {
    send_checked(wsg, switch(enabled).map(|enabled| Command::OverdriveMode { enabled }))
}

/// Tare Force Sensor (38h): zeroes the force sensor.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_tare_force_sensor(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::TareForceSensor)
}

/// Get System State (40h): WSG_VALUE_FLAGS. The session polls it anyway; see wsg_known().
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_system_state(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetSystemState { update: AutoUpdate::once() })
}

/// Get Gripper State (41h): WSG_VALUE_STATE. The session polls it anyway; see wsg_known().
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_gripper_state(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetGripperState { update: AutoUpdate::once() })
}

/// Get Gripping Statistics (42h): WSG_VALUE_STATISTICS. `reset` of 1 resets the counters, 0 keeps them.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_gripping_statistics(wsg: Option<&mut wsg_t>, reset: u8) -> i32 {
    send_checked(wsg, switch(reset).map(|reset| Command::GetGrippingStatistics { reset }))
}

/// Get Opening Width (43h): WSG_VALUE_NUMBER in mm.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_opening_width(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetOpeningWidth { update: AutoUpdate::once() })
}

/// Get Speed (44h): WSG_VALUE_NUMBER in mm/s.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_speed(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetSpeed { update: AutoUpdate::once() })
}

/// Get Force (45h): WSG_VALUE_NUMBER in N, summed over both fingers.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_force(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetForce { update: AutoUpdate::once() })
}

/// Get Temperature (46h): WSG_VALUE_TEMPERATURE.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_temperature(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetTemperature)
}

/// Get System Information (50h): WSG_VALUE_INFO. The session queries it when it connects; see wsg_known().
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_system_info(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetSystemInfo)
}

/// Set Device Tag (51h): up to 64 printable ASCII characters, NUL-terminated. The text must stay valid as described at
/// wsg_loop().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_set_device_tag(wsg: Option<&mut wsg_t>, tag: *const c_char) -> i32 {
    let set = || -> Outcome {
        let inner = wsg_t::open(wsg)?;
        // SAFETY: the rules of the crate's documentation.
        let tag = unsafe { memory::text(tag, DeviceTag::MAX_LEN) }?;
        if tag.iter().any(|character| !(b' '..=b'~').contains(character)) {
            return Err(wsg_error::Character);
        }
        inner.keep(CommandId::SetDeviceTag.code(), tag)
    };
    code(set())
}

/// Get Device Tag (52h): WSG_VALUE_BYTES.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_device_tag(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetDeviceTag)
}

/// Get System Limits (53h): WSG_VALUE_LIMITS. The session queries them when it connects; see wsg_known().
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_system_limits(wsg: Option<&mut wsg_t>) -> i32 {
    send(wsg, Command::GetSystemLimits)
}

/// Selects the request for finger 1 or 2.
fn of_finger(wsg: Option<&mut wsg_t>, finger: u8, [first, second]: [Command<'static>; 2]) -> i32 {
    send_checked(
        wsg,
        match finger {
            1 => Ok(first),
            2 => Ok(second),
            _ => Err(wsg_error::Argument),
        },
    )
}

/// Get Finger Info (60h, 70h) of `finger` 1 or 2: WSG_VALUE_FINGER.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_finger_info(wsg: Option<&mut wsg_t>, finger: u8) -> i32 {
    of_finger(wsg, finger, [Command::GetFinger1Info, Command::GetFinger2Info])
}

/// Get Finger Flags (61h, 71h) of `finger` 1 or 2: WSG_VALUE_FLAGS.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_finger_flags(wsg: Option<&mut wsg_t>, finger: u8) -> i32 {
    of_finger(wsg, finger, [Command::GetFinger1Flags, Command::GetFinger2Flags])
}

/// Finger Power Control (62h, 72h): switches the supply of `finger` 1 or 2 on (1) or off (0).
#[unsafe(no_mangle)]
pub extern "C" fn wsg_finger_power(wsg: Option<&mut wsg_t>, finger: u8, enabled: u8) -> i32 {
    match switch(enabled) {
        Ok(enabled) => {
            of_finger(wsg, finger, [Command::Finger1Power { enabled }, Command::Finger2Power { enabled }])
        }
        Err(error) => error as i32,
    }
}

/// Get Finger Data (63h, 73h) of `finger` 1 or 2: WSG_VALUE_BYTES. Data frames of more than 64 bytes are not received; see
/// WSG_MAX_PAYLOAD.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_get_finger_data(wsg: Option<&mut wsg_t>, finger: u8) -> i32 {
    of_finger(wsg, finger, [Command::GetFinger1Data, Command::GetFinger2Data])
}

/// A command of a script on the gripper, with up to 64 bytes of payload: WSG_VALUE_BYTES. The session treats it as a motion
/// and never repeats it. The data must stay valid as described at wsg_loop().
///
/// Returns WSG_ERROR_ARGUMENT for the id of a command of the manual, and WSG_ERROR_TOO_LONG for more data. A reply with more
/// than 64 bytes after its status is not received; see WSG_MAX_PAYLOAD.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_custom(wsg: Option<&mut wsg_t>, id: u8, data: *const u8, length: usize) -> i32 {
    match CommandId::from_code(id) {
        // SAFETY: passed on to the caller.
        CommandId::Unknown(_) => unsafe { send_kept(wsg, id, data, length) },
        _ => wsg_error::Argument as i32,
    }
}

/// Sends a request whose payload the caller keeps.
///
/// # Safety
/// As [`memory::bytes`].
unsafe fn send_kept(wsg: Option<&mut wsg_t>, id: u8, data: *const u8, length: usize) -> i32 {
    let keep = || -> Outcome {
        let inner = wsg_t::open(wsg)?;
        // SAFETY: passed on to the caller.
        inner.keep(id, unsafe { memory::bytes(data, length) }?)
    };
    code(keep())
}

/// Subscribes to a value: WSG_COMMAND_GET_SYSTEM_STATE, _GRIPPER_STATE, _OPENING_WIDTH, _SPEED or _FORCE. The gripper reports
/// it every `period_ms` milliseconds (at least 10), or with `on_change` of 1 on a change only. A period of 0 ends the
/// subscription. The session restores subscriptions after a reconnect.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_subscribe(wsg: Option<&mut wsg_t>, command: u8, period_ms: u16, on_change: u8) -> i32 {
    let subscribe = || -> Outcome {
        let inner = wsg_t::open(wsg)?;
        let topic = match CommandId::from_code(command) {
            CommandId::GetSystemState => Topic::SystemState,
            CommandId::GetGripperState => Topic::GripperState,
            CommandId::GetOpeningWidth => Topic::Width,
            CommandId::GetSpeed => Topic::Speed,
            CommandId::GetForce => Topic::Force,
            _ => return Err(wsg_error::Argument),
        };
        let update = match (period_ms, switch(on_change)?) {
            (0, _) => AutoUpdate::once(),
            (1..AutoUpdate::MIN_PERIOD_MS, _) => return Err(wsg_error::Argument),
            (_, false) => AutoUpdate::every(period_ms),
            (_, true) => AutoUpdate::on_change(period_ms),
        };
        inner.session.subscribe(topic, update);
        DONE
    };
    code(subscribe())
}
