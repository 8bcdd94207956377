//! A handle that stops the fingers from any thread, even while another call waits.

use std::mem::MaybeUninit;

use wsg_protocol::driver::StopHandle;

use crate::error::{Outcome, code, wsg_host_error};
use crate::gripper::wsg_host_t;

/// A handle that stops the fingers. Free it with wsg_host_stop_free(). It may outlive the gripper, and then returns an error.
pub struct wsg_host_stop_t {
    pub(crate) handle: StopHandle,
}

/// Gives a handle to the caller.
pub(crate) fn give(handle: StopHandle, target: Option<&mut MaybeUninit<*mut wsg_host_stop_t>>) -> Outcome {
    target.ok_or(wsg_host_error::NullPointer)?.write(Box::into_raw(Box::new(wsg_host_stop_t { handle })));
    Ok(())
}

/// Creates a handle for a gripper.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stop_handle(
    gripper: Option<&mut wsg_host_t>,
    handle: Option<&mut MaybeUninit<*mut wsg_host_stop_t>>,
) -> i32 {
    let create = || -> Outcome {
        let gripper = gripper.ok_or(wsg_host_error::NullPointer)?;
        give(gripper.driver.stop_handle().map_err(|_| wsg_host_error::System)?, handle)
    };
    code(create())
}

/// Stops the fingers now, from any thread. `fast` of 1 is a FAST STOP. The running call of the gripper, or else the next one, returns
/// WSG_HOST_ERROR_STOPPED or WSG_HOST_ERROR_FAST_STOPPED.
///
/// WSG_HOST_ERROR_LINE: the line accepts no bytes; the running call sends the stop as soon as possible.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_host_stop_now(handle: Option<&wsg_host_stop_t>, fast: u8) -> i32 {
    let stop = || -> Outcome {
        let handle = &handle.ok_or(wsg_host_error::NullPointer)?.handle;
        let stopped = match fast {
            0 => handle.stop(),
            1 => handle.fast_stop(),
            _ => return Err(wsg_host_error::Argument.into()),
        };
        stopped.map_err(|error| match error.kind() {
            std::io::ErrorKind::NotConnected => wsg_host_error::NotConnected.into(),
            _ => wsg_host_error::Line.into(),
        })
    };
    code(stop())
}

/// Frees a handle. Null is accepted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_host_stop_free(handle: *mut wsg_host_stop_t) {
    if !handle.is_null() {
        // SAFETY: created by `give`, and not used any more.
        drop(unsafe { Box::from_raw(handle) });
    }
}
