//! Parser and encoder alone, for a caller that needs frames but no session.

use core::mem::MaybeUninit;

use wsg_protocol::{Event, FrameEncoder, FrameParser, Reply};

use crate::error::{DONE, Outcome, code, length, wsg_error};
use crate::event::wsg_event_t;
use crate::memory::{self, give};
use crate::session::{STATUS_LEN, WSG_MAX_PAYLOAD};

/// Number of 64-bit words of a parser.
/// cbindgen:ignore
pub const WSG_PARSER_WORDS: usize = 11;

type Parser = FrameParser<WSG_MAX_PAYLOAD>;

const _: () = assert!(
    size_of::<Parser>() <= size_of::<wsg_parser_t>() && align_of::<Parser>() <= align_of::<wsg_parser_t>()
);

/// A parser for frames with up to WSG_MAX_PAYLOAD bytes of payload, owned by the caller. All bytes 0 are an initialized
/// parser.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct wsg_parser_t {
    /// Private.
    pub opaque: [u64; WSG_PARSER_WORDS],
}

/// Kind of wsg_frame_t: an intact frame.
pub const WSG_FRAME_INTACT: u8 = 1;
/// Kind of wsg_frame_t: a frame with a wrong checksum. Its bytes are scanned again for frames.
pub const WSG_FRAME_BAD_CHECKSUM: u8 = 2;
/// Kind of wsg_frame_t: the head of a frame that is too long. Its bytes are scanned again for frames.
pub const WSG_FRAME_OVERSIZE: u8 = 3;

/// A frame found by a parser.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct wsg_frame_t {
    /// The payload of an intact frame, valid until the next call with the same parser; otherwise null.
    pub payload: *const u8,
    /// Length of the payload in bytes.
    pub length: u16,
    /// Command id.
    pub id: u8,
    /// WSG_FRAME_...
    pub kind: u8,
}

impl From<Event<'_>> for wsg_frame_t {
    fn from(event: Event<'_>) -> Self {
        let (id, length, payload, kind) = match event {
            Event::Frame(frame) => {
                (frame.id, frame.payload.len() as u16, frame.payload.as_ptr(), WSG_FRAME_INTACT)
            }
            Event::BadChecksum { id, size } => (id, size, core::ptr::null(), WSG_FRAME_BAD_CHECKSUM),
            Event::Oversize { id, size } => (id, size, core::ptr::null(), WSG_FRAME_OVERSIZE),
        };
        Self { payload, length, id, kind }
    }
}

impl wsg_parser_t {
    fn open(parser: Option<&mut Self>) -> Result<&mut Parser, wsg_error> {
        let parser: *mut Parser = core::ptr::from_mut(parser.ok_or(wsg_error::NullPointer)?).cast();
        // SAFETY: large and aligned enough, see the assertion above. A parser consists of integers, for which any value is
        // valid; it has no invariants that safety relies on, because it contains no unsafe code.
        Ok(unsafe { &mut *parser })
    }
}

/// Initializes a parser, or resets one that holds part of a frame.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_parser_init(parser: Option<&mut MaybeUninit<wsg_parser_t>>) -> i32 {
    let init = || -> Outcome {
        give(parser, wsg_parser_t::default())?;
        DONE
    };
    code(init())
}

/// Takes bytes up to the first frame. Writes the number of bytes taken to `taken`, and the frame to `frame`. Returns 1 if there is
/// a frame. Call it with the remaining bytes until it returns 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_parser_push(
    parser: Option<&mut wsg_parser_t>,
    bytes: *const u8,
    length: usize,
    taken: Option<&mut MaybeUninit<usize>>,
    frame: Option<&mut MaybeUninit<wsg_frame_t>>,
) -> i32 {
    let push = || -> Outcome {
        let parser = wsg_parser_t::open(parser)?;
        let (taken, frame) = (taken.ok_or(wsg_error::NullPointer)?, frame.ok_or(wsg_error::NullPointer)?);
        // SAFETY: the rules of the crate's documentation.
        let (count, event) = parser.push_slice(unsafe { memory::bytes(bytes, length) }?);
        taken.write(count);
        let Some(event) = event else { return DONE };
        frame.write(event.into());
        Ok(1)
    };
    code(push())
}

/// Ends an incomplete frame after a time-out. Returns 1 if its bytes contain another frame, which is written to `frame`. Call
/// it until it returns 0.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_parser_expire(
    parser: Option<&mut wsg_parser_t>,
    frame: Option<&mut MaybeUninit<wsg_frame_t>>,
) -> i32 {
    let expire = || -> Outcome {
        let parser = wsg_parser_t::open(parser)?;
        let frame = frame.ok_or(wsg_error::NullPointer)?;
        let Some(event) = parser.expire() else { return DONE };
        frame.write(event.into());
        Ok(1)
    };
    code(expire())
}

/// Encodes a frame with this command id and payload into `buffer`. Returns its length: 8 bytes more than the payload.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_frame_encode(
    id: u8,
    payload: *const u8,
    payload_length: usize,
    buffer: *mut u8,
    size: usize,
) -> i32 {
    let encode = || -> Outcome {
        // SAFETY: the rules of the crate's documentation.
        let (payload, buffer) =
            unsafe { (memory::bytes(payload, payload_length)?, memory::buffer(buffer, size)?) };
        if payload.len() > u16::MAX.into() {
            return Err(wsg_error::TooLong);
        }
        length(FrameEncoder::new(id, payload).write_into(buffer).map_err(|_| wsg_error::BufferTooSmall)?)
    };
    code(encode())
}

/// Decodes an intact frame as a reply of a gripper: writes a WSG_EVENT_ANSWERED whose bytes are in the frame's payload.
/// Returns WSG_ERROR_MALFORMED if the frame violates the manual.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_reply_decode(
    frame: Option<&wsg_frame_t>,
    event: Option<&mut MaybeUninit<wsg_event_t>>,
) -> i32 {
    let decode = || -> Outcome {
        let frame = frame.ok_or(wsg_error::NullPointer)?;
        if frame.kind != WSG_FRAME_INTACT {
            return Err(wsg_error::Argument);
        }
        // SAFETY: the rules of the crate's documentation.
        let payload = unsafe { memory::bytes(frame.payload, frame.length.into()) }?;
        let reply = Reply::decode(&wsg_protocol::Frame { id: frame.id, payload });
        let value = payload.get(STATUS_LEN..).unwrap_or(&[]);
        give(event, wsg_event_t::answered(&reply.map_err(|_| wsg_error::Malformed)?, value))?;
        DONE
    };
    code(decode())
}
