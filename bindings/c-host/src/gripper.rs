//! A connected gripper: motions, settings and queries.

use std::ffi::{CStr, c_char};
use std::io;
use std::mem::MaybeUninit;

use wsg::event::{wsg_system_info_t, wsg_system_limits_t};
use wsg_protocol::HomingDirection;
use wsg_protocol::driver::blocking::Gripper;
use wsg_protocol::driver::host::{StdClock, Tcp, Udp};
use wsg_protocol::driver::{Error, Grip, Mm, MmPerS, N, OnBlock};

use crate::error::{Outcome, code, of, wsg_host_error};
use crate::line::Line;

/// A gripper that the library has opened. Close it with wsg_host_close().
pub struct wsg_host_t {
    pub(crate) driver: Gripper<Line, StdClock>,
}

/// Default TCP port of a gripper.
pub const WSG_HOST_TCP_PORT: u16 = 1000;
/// Default UDP port of a gripper.
pub const WSG_HOST_UDP_PORT: u16 = 1500;
/// Default port to which a gripper replies over UDP.
pub const WSG_HOST_UDP_REPLY_PORT: u16 = 1501;

/// Returns a text of C.
///
/// # Safety
/// `text` is null or points to a NUL-terminated text that lives during `'a`.
unsafe fn text<'a>(text: *const c_char) -> Result<&'a str, i32> {
    if text.is_null() {
        return Err(wsg_host_error::NullPointer.into());
    }
    // SAFETY: passed on to the caller.
    unsafe { CStr::from_ptr(text) }.to_str().map_err(|_| wsg_host_error::Argument.into())
}

/// Connects over an opened line and gives the gripper to the caller.
fn open(
    line: impl FnOnce() -> Result<io::Result<Line>, i32>,
    gripper: Option<&mut MaybeUninit<*mut wsg_host_t>>,
) -> i32 {
    let open = || -> Outcome {
        let gripper = gripper.ok_or(wsg_host_error::NullPointer)?.write(std::ptr::null_mut());
        let line = line()?.map_err(|_| wsg_host_error::Line)?;
        let mut driver = Gripper::new(line, StdClock::new());
        driver.connect().map_err(of)?;
        *gripper = Box::into_raw(Box::new(wsg_host_t { driver }));
        Ok(())
    };
    code(open())
}

/// Connects to a gripper over TCP. `host` is a name or an address. On success `gripper` is set, otherwise it is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_host_open_tcp(
    host: *const c_char,
    port: u16,
    gripper: Option<&mut MaybeUninit<*mut wsg_host_t>>,
) -> i32 {
    // SAFETY: the rules of the crate's documentation.
    open(|| unsafe { text(host) }.map(|host| Tcp::connect((host, port)).map(Line::new)), gripper)
}

/// Connects over UDP. The gripper replies to `reply_port` of this computer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_host_open_udp(
    host: *const c_char,
    port: u16,
    reply_port: u16,
    gripper: Option<&mut MaybeUninit<*mut wsg_host_t>>,
) -> i32 {
    // SAFETY: the rules of the crate's documentation.
    open(|| unsafe { text(host) }.map(|host| Udp::connect((host, port), reply_port).map(Line::new)), gripper)
}

/// Connects over a serial port, such as /dev/ttyUSB0 or COM3, at `rate` in bit/s (115200 by default).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_host_open_serial(
    device: *const c_char,
    rate: u32,
    gripper: Option<&mut MaybeUninit<*mut wsg_host_t>>,
) -> i32 {
    // SAFETY: the rules of the crate's documentation.
    open(|| unsafe { text(device) }.map(|device| Line::serial(device, rate)), gripper)
}

/// Closes a gripper. Over TCP it announces the end of the connection, which otherwise causes a FAST STOP. Null is accepted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_host_close(gripper: *mut wsg_host_t) {
    if !gripper.is_null() {
        // SAFETY: created by `open`, and not used any more.
        drop(unsafe { Box::from_raw(gripper) });
    }
}

/// Runs a request of the driver.
fn run(
    gripper: Option<&mut wsg_host_t>,
    request: impl FnOnce(&mut Gripper<Line, StdClock>) -> Result<(), Error<io::Error>>,
) -> i32 {
    let run = || -> Outcome { request(&mut gripper.ok_or(wsg_host_error::NullPointer)?.driver).map_err(of) };
    code(run())
}

/// Runs a query of the driver and gives its value to the caller.
fn ask<T>(
    gripper: Option<&mut wsg_host_t>,
    value: Option<&mut MaybeUninit<T>>,
    query: impl FnOnce(&mut Gripper<Line, StdClock>) -> Result<T, Error<io::Error>>,
) -> i32 {
    let ask = || -> Outcome {
        let value = value.ok_or(wsg_host_error::NullPointer)?;
        let gripper = gripper.ok_or(wsg_host_error::NullPointer)?;
        value.write(query(&mut gripper.driver).map_err(of)?);
        Ok(())
    };
    code(ask())
}

/// References the fingers at an end stop and waits for the end of the motion. `direction` is WSG_HOMING_...
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_home(gripper: Option<&mut wsg_host_t>, direction: u8) -> i32 {
    let Some(direction) = HomingDirection::from_code(direction) else {
        return wsg_host_error::Argument.into();
    };
    run(gripper, |driver| driver.home(direction))
}

/// Moves the fingers to `width` in mm at `speed` in mm/s and waits for the end of the motion. Blocked fingers are an error
/// (WSG_E_AXIS_BLOCKED), and the motor is off then.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_move(gripper: Option<&mut wsg_host_t>, width: f32, speed: f32) -> i32 {
    run(gripper, |driver| driver.move_to(Mm(width), MmPerS(speed), OnBlock::Stop))
}

/// Grips a part of `width` in mm at `speed` in mm/s and waits for the result: `held` is 1 if a part is held and 0 if there was none.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_grip(
    gripper: Option<&mut wsg_host_t>,
    width: f32,
    speed: f32,
    held: Option<&mut MaybeUninit<u8>>,
) -> i32 {
    ask(gripper, held, |driver| driver.grip(Mm(width), MmPerS(speed)).map(|grip| (grip == Grip::Held).into()))
}

/// Opens the fingers to `width` in mm at `speed` in mm/s and waits for the end of the motion.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_release(gripper: Option<&mut wsg_host_t>, width: f32, speed: f32) -> i32 {
    run(gripper, |driver| driver.release(Mm(width), MmPerS(speed)))
}

/// Stops the fingers. To stop them during another call, use wsg_host_stop_handle().
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stop(gripper: Option<&mut wsg_host_t>) -> i32 {
    run(gripper, |driver| driver.stop())
}

/// Stops the fingers as fast as possible and locks motion until wsg_host_acknowledge().
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_fast_stop(gripper: Option<&mut wsg_host_t>) -> i32 {
    run(gripper, |driver| driver.fast_stop())
}

/// Acknowledges a FAST STOP or a fault and unlocks motion.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_acknowledge(gripper: Option<&mut wsg_host_t>) -> i32 {
    run(gripper, |driver| driver.acknowledge())
}

/// Sets the force limit in N, summed over both fingers.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_set_force_limit(gripper: Option<&mut wsg_host_t>, force: f32) -> i32 {
    run(gripper, |driver| driver.set_force_limit(N(force)))
}

/// Sets the acceleration in mm/s².
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_set_acceleration(gripper: Option<&mut wsg_host_t>, acceleration: f32) -> i32 {
    run(gripper, |driver| driver.set_acceleration(acceleration))
}

/// Queries the opening width in mm.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_width(
    gripper: Option<&mut wsg_host_t>,
    width: Option<&mut MaybeUninit<f32>>,
) -> i32 {
    ask(gripper, width, |driver| driver.width().map(|width| width.0))
}

/// Queries the finger speed in mm/s.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_speed(
    gripper: Option<&mut wsg_host_t>,
    speed: Option<&mut MaybeUninit<f32>>,
) -> i32 {
    ask(gripper, speed, |driver| driver.speed().map(|speed| speed.0))
}

/// Queries the gripping force in N, summed over both fingers.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_force(
    gripper: Option<&mut wsg_host_t>,
    force: Option<&mut MaybeUninit<f32>>,
) -> i32 {
    ask(gripper, force, |driver| driver.force().map(|force| force.0))
}

/// Queries the gripper state: WSG_STATE_...
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_state(
    gripper: Option<&mut wsg_host_t>,
    state: Option<&mut MaybeUninit<u8>>,
) -> i32 {
    ask(gripper, state, |driver| driver.gripper_state().map(|state| state.code()))
}

/// Queries the system state flags: WSG_FLAG_...
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_flags(
    gripper: Option<&mut wsg_host_t>,
    flags: Option<&mut MaybeUninit<u32>>,
) -> i32 {
    ask(gripper, flags, |driver| driver.system_state().map(|flags| flags.bits()))
}

/// Queries the physical limits.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_limits(
    gripper: Option<&mut wsg_host_t>,
    limits: Option<&mut MaybeUninit<wsg_system_limits_t>>,
) -> i32 {
    ask(gripper, limits, |driver| driver.limits().map(|limits| (&limits).into()))
}

/// Queries device type, versions and serial number.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_info(
    gripper: Option<&mut wsg_host_t>,
    info: Option<&mut MaybeUninit<wsg_system_info_t>>,
) -> i32 {
    ask(gripper, info, |driver| driver.system_info().map(|info| (&info).into()))
}

/// Sends any command with a payload, and waits for its final reply. Writes the payload of the reply after its status to `reply`,
/// and its length to `reply_length`, which holds the size of `reply` before. The lengths may be 0.
///
/// WSG_HOST_ERROR_TOO_LONG: `payload` has more than 256 bytes, or the reply does not fit into `reply`. A reply with more than 256
/// bytes after its status is not received: WSG_HOST_ERROR_UNANSWERED, as without a reply.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_host_raw(
    gripper: Option<&mut wsg_host_t>,
    command: u8,
    payload: *const u8,
    payload_length: usize,
    reply: *mut u8,
    reply_length: Option<&mut usize>,
) -> i32 {
    let send = || -> Outcome {
        let null = wsg_host_error::NullPointer;
        let (gripper, size) = (gripper.ok_or(null)?, reply_length.ok_or(null)?);
        // SAFETY: the rules of the crate's documentation.
        let payload = unsafe { wsg::memory::bytes(payload, payload_length) }.map_err(|error| error as i32)?;
        let buffer = match *size {
            0 => &mut [],
            // SAFETY: as above.
            size => unsafe { wsg::memory::buffer(reply, size) }.map_err(|error| error as i32)?,
        };
        *size = gripper.driver.raw(command, payload, buffer).map_err(of)?.len();
        Ok(())
    };
    code(send())
}
