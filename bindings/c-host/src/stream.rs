//! Timed set-points, and the state while the fingers follow them.

use std::mem::MaybeUninit;

use wsg_protocol::Instant;
use wsg_protocol::driver::host::StdClock;
use wsg_protocol::driver::stream::{Cause, Config, Rejected, SetPointStream, StartError};
use wsg_protocol::driver::{Mm, MmPerS, N, StopKind};

use crate::error::{Outcome, code, of, wsg_host_error};
use crate::gripper::wsg_host_t;
use crate::line::Line;
use crate::stop::{self, wsg_host_stop_t};

/// A gripper that follows set-points. End it with wsg_host_stream_end().
pub struct wsg_host_stream_t {
    stream: SetPointStream<Line, StdClock>,
}

/// The state of the gripper at one instant.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct wsg_host_sample_t {
    /// Sample number, which may wrap.
    pub number: u32,
    /// Time of the measurement in milliseconds, on the clock of wsg_host_stream_now().
    pub measured_at: u32,
    /// Time of the reception.
    pub received_at: u32,
    /// Opening width in mm.
    pub position: f32,
    /// Finger speed in mm/s; closing is negative.
    pub speed: f32,
    /// Gripping force in N, summed over both fingers.
    pub force: f32,
    /// System state flags: WSG_FLAG_...
    pub flags: u32,
    /// The last commanded position in mm, or NaN before the first set-point.
    pub set_point: f32,
}

/// Returns the code of the reason for the end of a stream.
fn of_cause(cause: Cause) -> i32 {
    let error = match cause {
        Cause::Requested => wsg_host_error::None,
        Cause::Stopped(StopKind::Stop) | Cause::StoppedByOther => wsg_host_error::Stopped,
        Cause::Stopped(StopKind::FastStop) | Cause::FastStop => wsg_host_error::FastStopped,
        Cause::Refused(status) => return i32::from(status.code()),
        Cause::Unanswered | Cause::Watchdog => wsg_host_error::Unanswered,
        Cause::Closed => wsg_host_error::Closed,
        Cause::Transport(_) => wsg_host_error::Line,
        _ => wsg_host_error::Other,
    };
    error.into()
}

fn of_rejected(rejected: Rejected) -> i32 {
    match rejected {
        Rejected::OutOfLimits(_) => wsg_host_error::OutOfLimits.into(),
        Rejected::BeyondHorizon { .. } => wsg_host_error::Argument.into(),
        Rejected::Full { .. } => wsg_host_error::QueueFull.into(),
        Rejected::Busy => wsg_host_error::MotionRunning.into(),
        Rejected::Ended(_) => wsg_host_error::Ended.into(),
    }
}

/// Starts to stream at `rate_hz` set-points per second, 1 to 500. The fingers must be referenced. The stream takes over the
/// gripper, which must not be used any more, even after an error; wsg_host_stream_end() gives it back.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_host_stream_start(
    gripper: *mut wsg_host_t,
    rate_hz: u16,
    stream: Option<&mut MaybeUninit<*mut wsg_host_stream_t>>,
) -> i32 {
    let start = || -> Outcome {
        if gripper.is_null() {
            return Err(wsg_host_error::NullPointer.into());
        }
        // SAFETY: created by the library; the caller does not use it any more.
        let gripper = unsafe { Box::from_raw(gripper) };
        let target = stream.ok_or(wsg_host_error::NullPointer)?.write(std::ptr::null_mut());
        let config = Config { rate_hz, ..Config::DEFAULT };
        let stream = SetPointStream::start(gripper.driver, config).map_err(|error| match error {
            StartError::Config => wsg_host_error::Argument.into(),
            StartError::Driver(error) => of(error),
            StartError::System(_) => wsg_host_error::System.into(),
        })?;
        *target = Box::into_raw(Box::new(wsg_host_stream_t { stream }));
        Ok(())
    };
    code(start())
}

fn with(
    stream: Option<&wsg_host_stream_t>,
    change: impl FnOnce(&SetPointStream<Line, StdClock>) -> Result<(), Rejected>,
) -> i32 {
    let change =
        || -> Outcome { change(&stream.ok_or(wsg_host_error::NullPointer)?.stream).map_err(of_rejected) };
    code(change())
}

/// Sets the position in mm to move to at once, within the speed limit. It must be inside the stroke. Does not wait.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stream_set_target(stream: Option<&wsg_host_stream_t>, position: f32) -> i32 {
    with(stream, |stream| stream.set_target(Mm(position)))
}

/// Schedules a position in mm for the time `at_ms` on the clock of wsg_host_stream_now(), and replaces later ones. The position
/// must be inside the stroke, and the time at most one hour from now. A time in the past counts as now. Does not wait.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stream_schedule(
    stream: Option<&wsg_host_stream_t>,
    position: f32,
    at_ms: u32,
) -> i32 {
    with(stream, |stream| stream.schedule(Mm(position), Instant::from_millis(at_ms)))
}

/// Limits the speed in mm/s. A value outside the gripper's limits is refused.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stream_set_speed_limit(stream: Option<&wsg_host_stream_t>, speed: f32) -> i32 {
    with(stream, |stream| stream.set_speed_limit(MmPerS(speed)))
}

/// Limits the force in N. A value outside the gripper's limits is refused.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stream_set_force_limit(stream: Option<&wsg_host_stream_t>, force: f32) -> i32 {
    with(stream, |stream| stream.set_force_limit(N(force)))
}

/// Writes the time of the stream's clock in milliseconds.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stream_now(
    stream: Option<&wsg_host_stream_t>,
    now_ms: Option<&mut MaybeUninit<u32>>,
) -> i32 {
    let now = || -> Outcome {
        let stream = &stream.ok_or(wsg_host_error::NullPointer)?.stream;
        now_ms.ok_or(wsg_host_error::NullPointer)?.write(stream.now().as_millis());
        Ok(())
    };
    code(now())
}

/// Writes the latest sample. Its age is the time of wsg_host_stream_now() minus `measured_at`. Does not wait. After the end of
/// the stream it returns WSG_HOST_ERROR_ENDED and writes nothing.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stream_latest(
    stream: Option<&wsg_host_stream_t>,
    sample: Option<&mut MaybeUninit<wsg_host_sample_t>>,
) -> i32 {
    let latest = || -> Outcome {
        let latest = stream.ok_or(wsg_host_error::NullPointer)?.stream.latest();
        let latest = latest.map_err(|_| wsg_host_error::Ended)?;
        sample.ok_or(wsg_host_error::NullPointer)?.write(wsg_host_sample_t {
            number: latest.number,
            measured_at: latest.measured_at.as_millis(),
            received_at: latest.received_at.as_millis(),
            position: latest.position,
            speed: latest.speed,
            force: latest.force,
            flags: latest.flags.bits(),
            set_point: latest.set_point.unwrap_or(f32::NAN),
        });
        Ok(())
    };
    code(latest())
}

/// Creates a handle that stops the fingers and ends the stream.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stream_stop_handle(
    stream: Option<&wsg_host_stream_t>,
    handle: Option<&mut MaybeUninit<*mut wsg_host_stop_t>>,
) -> i32 {
    let create =
        || -> Outcome { stop::give(stream.ok_or(wsg_host_error::NullPointer)?.stream.stop_handle(), handle) };
    code(create())
}

/// Stops the fingers, ends the stream and gives the gripper back. `gripper` may be null: it is closed then. Returns 0 if the stream
/// ran until this call, and otherwise why it ended; the gripper is given back in either case.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_host_stream_end(
    stream: *mut wsg_host_stream_t,
    gripper: Option<&mut MaybeUninit<*mut wsg_host_t>>,
) -> i32 {
    if stream.is_null() {
        return wsg_host_error::NullPointer.into();
    }
    // SAFETY: created by `wsg_host_stream_start`, and not used any more.
    let stream = unsafe { Box::from_raw(stream) };
    let (driver, end) = stream.stream.end();
    if let Some(gripper) = gripper {
        gripper.write(Box::into_raw(Box::new(wsg_host_t { driver })));
    }
    of_cause(end.cause)
}
