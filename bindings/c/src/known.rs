//! The known state of the gripper, and counters.

use core::mem::MaybeUninit;

use crate::error::{DONE, Outcome, code, wsg_error};
use crate::event::{wsg_system_info_t, wsg_system_limits_t};
use crate::memory::give;
use crate::session::wsg_t;

/// Bit of `valid`: `info` is known.
pub const WSG_KNOWN_INFO: u8 = 1;
/// Bit of `valid`: `limits` are known.
pub const WSG_KNOWN_LIMITS: u8 = 2;
/// Bit of `valid`: `flags` are known.
pub const WSG_KNOWN_FLAGS: u8 = 4;
/// Bit of `valid`: `state` is known.
pub const WSG_KNOWN_STATE: u8 = 8;
/// Bit of `valid`: `width` is known.
pub const WSG_KNOWN_WIDTH: u8 = 16;
/// Bit of `valid`: `speed` is known.
pub const WSG_KNOWN_SPEED: u8 = 32;
/// Bit of `valid`: `force` is known.
pub const WSG_KNOWN_FORCE: u8 = 64;
/// Bit of `valid`: `force_limit` is known.
pub const WSG_KNOWN_FORCE_LIMIT: u8 = 128;

/// The known state of the gripper. Nothing is known without a connection.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct wsg_known_t {
    /// System state flags: WSG_FLAG_...
    pub flags: u32,
    /// Opening width in mm.
    pub width: f32,
    /// Finger speed in mm/s.
    pub speed: f32,
    /// Gripping force in N, summed over both fingers.
    pub force: f32,
    /// Force limit in N, known after it was set and read back (`verify_settings`).
    pub force_limit: f32,
    /// Device type, versions and serial number.
    pub info: wsg_system_info_t,
    /// Physical limits of the gripper (53h).
    pub limits: wsg_system_limits_t,
    /// The known values: WSG_KNOWN_... Unknown values are 0.
    pub valid: u8,
    /// Gripper state: WSG_STATE_...
    pub state: u8,
    /// 1 while the gripper is connected.
    pub connected: u8,
    /// WSG_COMMAND_... of the requested motion whose result is outstanding, or 0.
    pub motion: u8,
    /// 1 while a request is queued, or its first reply is outstanding.
    pub busy: u8,
    /// 1 while a FAST STOP was requested and is not confirmed.
    pub fast_stop_pending: u8,
}

/// Counters of rejected input, retries and disconnects. Each saturates at 65 535.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct wsg_counters_t {
    /// Received bytes that were not part of an intact frame.
    pub dropped: u16,
    /// Frames with a wrong checksum.
    pub bad_checksum: u16,
    /// Frames with more than WSG_MAX_PAYLOAD bytes of payload.
    pub oversize: u16,
    /// Replies that were unsolicited or too late.
    pub unsolicited: u16,
    /// Frames whose content violates the manual.
    pub refused: u16,
    /// Requests sent again after a time-out.
    pub repeated: u16,
    /// Lost connections since wsg_init; stops at 65535.
    pub disconnects: u16,
}

/// Writes the known state of the gripper.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_known(wsg: Option<&wsg_t>, known: Option<&mut MaybeUninit<wsg_known_t>>) -> i32 {
    let fill = || -> Outcome {
        let session = &wsg_t::look(wsg)?.session;
        // Filled in place: a copy of it on the stack takes more flash.
        let plain = known.ok_or(wsg_error::NullPointer)?.write(wsg_known_t::default());
        let its = session.known();
        if let Some(flags) = its.flags {
            plain.valid |= WSG_KNOWN_FLAGS;
            plain.flags = flags.bits();
        }
        if let Some(state) = its.state {
            plain.valid |= WSG_KNOWN_STATE;
            plain.state = state.code();
        }
        if let Some(info) = &its.info {
            plain.valid |= WSG_KNOWN_INFO;
            plain.info = info.into();
        }
        if let Some(limits) = &its.limits {
            plain.valid |= WSG_KNOWN_LIMITS;
            plain.limits = limits.into();
        }
        let numbers = [
            (&mut plain.width, its.width, WSG_KNOWN_WIDTH),
            (&mut plain.speed, its.speed, WSG_KNOWN_SPEED),
            (&mut plain.force, its.force, WSG_KNOWN_FORCE),
            (&mut plain.force_limit, its.force_limit, WSG_KNOWN_FORCE_LIMIT),
        ];
        for (plain_number, number, bit) in numbers {
            if let Some(number) = number {
                plain.valid |= bit;
                *plain_number = number;
            }
        }
        plain.connected = session.is_connected().into();
        plain.motion = session.motion().map_or(0, wsg_protocol::CommandId::code);
        plain.busy = session.is_busy().into();
        plain.fast_stop_pending = session.fast_stop_pending().into();
        DONE
    };
    code(fill())
}

/// Writes the counters of parser and session.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_counters(
    wsg: Option<&wsg_t>,
    counters: Option<&mut MaybeUninit<wsg_counters_t>>,
) -> i32 {
    let fill = || -> Outcome {
        let inner = wsg_t::look(wsg)?;
        let (line, session) = (inner.parser.counters(), inner.session.counters());
        give(
            counters,
            wsg_counters_t {
                dropped: line.dropped,
                bad_checksum: line.bad_checksum,
                oversize: line.oversize,
                unsolicited: session.unsolicited,
                refused: session.refused,
                repeated: session.repeated,
                disconnects: session.disconnects,
            },
        )?;
        DONE
    };
    code(fill())
}
