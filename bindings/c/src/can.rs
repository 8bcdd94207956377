//! The messages of a session over classic CAN, with the frames of any CAN controller.
//!
//! A message from wsg_transmit() is split into frames, and received frames go to the session. There is no header or padding; see
//! the module `can` of the protocol.

use core::mem::MaybeUninit;

use embedded_can::{ExtendedId, Frame, Id, StandardId};
use wsg_protocol::Instant;
use wsg_protocol::can::{HALF_MESSAGE_MS, Identifiers, Reassembler, Segmenter};

use crate::error::{DONE, Outcome, code, length, wsg_error};
use crate::memory::{self, give};
use crate::session::{Inner, WSG_MAX_PAYLOAD, feed, wsg_t};

/// Identifier of requests by default. The gripper replies on the next one.
pub const WSG_CAN_DEFAULT_ID: u16 = 0x120;

/// Number of CAN frames of the longest message that is sent or received.
pub const WSG_CAN_MAX_FRAMES: usize = 10;

const _: () = assert!((WSG_MAX_PAYLOAD + wsg_protocol::frame::OVERHEAD).div_ceil(8) == WSG_CAN_MAX_FRAMES);
const _: () = assert!(WSG_CAN_DEFAULT_ID == Identifiers::DEFAULT.base());

/// Number of 64-bit words of a reassembler.
/// cbindgen:ignore
pub const WSG_CAN_WORDS: usize = 16;

const _: () = assert!(
    size_of::<Contents>() <= size_of::<wsg_can_t>() && align_of::<Contents>() <= align_of::<wsg_can_t>()
);

/// A classic CAN data frame with an 11-bit identifier.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct wsg_can_frame_t {
    /// Identifier, 11 bits.
    pub id: u16,
    /// Number of data bytes, up to 8.
    pub length: u8,
    /// Data bytes; only the first `length` are sent.
    pub data: [u8; 8],
}

impl Frame for wsg_can_frame_t {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let Id::Standard(id) = id.into() else { return None };
        let mut frame = Self { id: id.as_raw(), length: u8::try_from(data.len()).ok()?, data: [0; 8] };
        frame.data.get_mut(..data.len())?.iter_mut().zip(data).for_each(|(slot, byte)| *slot = *byte);
        Some(frame)
    }

    fn new_remote(_: impl Into<Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        matches!(self.id(), Id::Extended(_))
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> Id {
        // An identifier of more than 11 bits belongs to no gripper.
        StandardId::new(self.id).map_or(Id::Extended(ExtendedId::MAX), Id::Standard)
    }

    fn dlc(&self) -> usize {
        self.length.into()
    }

    fn data(&self) -> &[u8] {
        self.data.get(..self.length.into()).unwrap_or(&[])
    }
}

/// Reassembles messages from CAN frames, owned by the caller. Initialize it with wsg_can_init().
#[repr(C)]
#[derive(Debug)]
pub struct wsg_can_t {
    /// Private.
    pub opaque: [MaybeUninit<u64>; WSG_CAN_WORDS],
}

/// Marks initialized storage.
const READY: u32 = 0x4E41_4357;

struct Contents {
    ready: u32,
    reassembler: Reassembler<WSG_CAN_MAX_FRAMES>,
}

/// Counters of rejected CAN frames and messages. Each saturates at 65 535.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct wsg_can_counters_t {
    /// Frames that cannot be part of a reply: other identifiers, or no data.
    pub foreign: u16,
    /// Frames that were not part of an intact message.
    pub dropped: u16,
    /// Messages with a frame whose length contradicts the size field: a frame was lost or duplicated.
    pub miscut: u16,
    /// Messages with a wrong checksum.
    pub bad_checksum: u16,
    /// Messages of more than WSG_CAN_MAX_FRAMES frames.
    pub oversize: u16,
    /// Incomplete messages discarded after the time-out of 50 ms.
    pub expired: u16,
}

/// Returns the place of initialized contents.
fn at(can: *mut wsg_can_t) -> Result<*mut Contents, wsg_error> {
    if can.is_null() {
        return Err(wsg_error::NullPointer);
    }
    let contents: *mut Contents = can.cast();
    // SAFETY: `wsg_can_t` is as large and as aligned as the contents; the mark is read as an integer.
    let ready = unsafe { (&raw const (*contents).ready).read() };
    if ready == READY { Ok(contents) } else { Err(wsg_error::NotInitialized) }
}

/// Initializes a reassembler for the gripper that receives requests on `id` (WSG_CAN_DEFAULT_ID unless configured) and replies
/// on `id` + 1, up to 0x7FE.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_can_init(can: Option<&mut MaybeUninit<wsg_can_t>>, id: u16) -> i32 {
    let init = || -> Outcome {
        let can = can.ok_or(wsg_error::NullPointer)?;
        let reply = Identifiers::from_base(id).ok_or(wsg_error::Argument)?.controller().receive;
        let contents = Contents { ready: READY, reassembler: Reassembler::new(reply, HALF_MESSAGE_MS) };
        // SAFETY: the contents fit, see the assertion above.
        unsafe { can.as_mut_ptr().cast::<Contents>().write(contents) };
        DONE
    };
    code(init())
}

/// Splits a message from wsg_transmit() into CAN frames with identifier `id`, and returns their number, up to
/// WSG_CAN_MAX_FRAMES. Send all of them in order before the frames of the next message.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_can_split(
    id: u16,
    message: *const u8,
    message_length: usize,
    frames: *mut wsg_can_frame_t,
    capacity: usize,
) -> i32 {
    let split = || -> Outcome {
        let id = StandardId::new(id).ok_or(wsg_error::Argument)?;
        if frames.is_null() {
            return Err(wsg_error::NullPointer);
        }
        // SAFETY: the rules of the crate's documentation.
        let message = unsafe { memory::bytes(message, message_length) }?;
        if message_length.div_ceil(8) > capacity {
            return Err(wsg_error::BufferTooSmall);
        }
        let (mut segmenter, mut count) = (Segmenter::new(), 0usize);
        for segment in message.iter().filter_map(|byte| segmenter.push(*byte)) {
            let Some(frame) = segment.frame(id) else { return Err(wsg_error::Other) };
            // SAFETY: every frame but the last has eight bytes, so there are no more than the capacity.
            unsafe { frames.add(count).write(frame) };
            count = count.saturating_add(1);
        }
        if segmenter.is_mid_message() { Err(wsg_error::Malformed) } else { length(count) }
    };
    code(split())
}

/// Takes a CAN frame with any identifier, and passes each resulting event to the callback of the session. The
/// callback must not use the reassembler.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_can_receive(
    can: *mut wsg_can_t,
    wsg: *mut wsg_t,
    now_ms: u32,
    frame: Option<&wsg_can_frame_t>,
) -> i32 {
    let receive = || -> Outcome {
        let (contents, inner) = (at(can)?, Inner::outside_callback(wsg)?);
        let frame = frame.ok_or(wsg_error::NullPointer)?;
        if frame.length > 8 {
            return Err(wsg_error::Argument);
        }
        let now = Instant::from_millis(now_ms);
        // SAFETY: initialized. The events borrow the reassembler, which is no part of the session.
        unsafe { (*contents).reassembler.receive(now, frame, |found| feed(inner, now, &found)) };
        DONE
    };
    code(receive())
}

/// Discards an incomplete message after its time-out. Call it with each wsg_tick().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_can_tick(can: *mut wsg_can_t, wsg: *mut wsg_t, now_ms: u32) -> i32 {
    let tick = || -> Outcome {
        let (contents, inner) = (at(can)?, Inner::outside_callback(wsg)?);
        let now = Instant::from_millis(now_ms);
        // SAFETY: as in `wsg_can_receive`.
        unsafe { (*contents).reassembler.handle_timeout(now, |found| feed(inner, now, &found)) };
        DONE
    };
    code(tick())
}

/// Writes the counters of discarded frames and messages.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_can_counters(
    can: *mut wsg_can_t,
    counters: Option<&mut MaybeUninit<wsg_can_counters_t>>,
) -> i32 {
    let fill = || -> Outcome {
        // SAFETY: initialized.
        let its = unsafe { (*at(can)?).reassembler.counters() };
        give(
            counters,
            wsg_can_counters_t {
                foreign: its.foreign,
                dropped: its.dropped,
                miscut: its.miscut,
                bad_checksum: its.bad_checksum,
                oversize: its.oversize,
                expired: its.expired,
            },
        )?;
        DONE
    };
    code(fill())
}
