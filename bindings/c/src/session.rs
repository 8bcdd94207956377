//! The session: bytes and time in, events and bytes out.

use core::ffi::c_void;
use core::mem::MaybeUninit;
use core::ptr;

use wsg_protocol::session::{Event, Session};
use wsg_protocol::{Command, FrameEncoder, FrameParser, Instant, frame};

use crate::config::wsg_config_t;
use crate::error::{DONE, Outcome, code, length, wsg_error};
use crate::event::wsg_event_t;
use crate::memory::{self, give};

/// Maximum payload of a received frame in bytes: a status and a device tag. The protocol permits 65 535: longer replies, which
/// only scripts, fingers and Loop have, are not received. They are counted as `oversize` in wsg_counters_t, and their request
/// ends with WSG_EVENT_UNANSWERED after its time-out.
pub const WSG_MAX_PAYLOAD: usize = 66;

/// Buffer length for wsg_transmit() that holds every request without caller-owned data.
pub const WSG_TRANSMIT_LEN: usize = 32;

/// Number of 64-bit words of a session.
/// cbindgen:ignore
pub const WSG_WORDS: usize = if cfg!(target_pointer_width = "64") { 104 } else { 80 };

const _: () = assert!(size_of::<Inner>() <= size_of::<wsg_t>() && align_of::<Inner>() <= align_of::<wsg_t>());
const _: () = assert!(frame::OVERHEAD + Command::MAX_FIXED_LEN <= WSG_TRANSMIT_LEN);

/// A session with one gripper, owned by the caller. Initialize it with wsg_init().
///
/// It contains no pointer to itself: it may lie anywhere, and a copy of it is a second session.
#[repr(C)]
#[derive(Debug)]
pub struct wsg_t {
    /// Private.
    pub opaque: [MaybeUninit<u64>; WSG_WORDS],
}

/// Receives each event. `event` is valid until the function returns.
///
/// The function may make requests, which the next wsg_tick() and wsg_transmit() send, and read the known state. Functions
/// that receive, tick, transmit or disconnect return WSG_ERROR_IN_CALLBACK.
pub type wsg_callback_t = Option<unsafe extern "C" fn(context: *mut c_void, event: *const wsg_event_t)>;

/// Length of the status at the start of a reply.
pub(crate) const STATUS_LEN: usize = 2;

/// Marks initialized storage.
const READY: u32 = 0x4757_5357;

/// The contents of [`wsg_t`].
#[derive(Debug)]
pub(crate) struct Inner {
    ready: u32,
    pub(crate) parser: FrameParser<WSG_MAX_PAYLOAD>,
    pub(crate) session: Session,
    pub(crate) kept: Option<Kept>,
    received_at: Instant,
    hook: Option<Hook>,
    callback: wsg_callback_t,
    context: *mut c_void,
    frame_timeout_ms: u16,
    is_calling: bool,
}

/// A part of the library that sees every event and, without one, every tick. Returns the caller's callback and its context.
pub(crate) type Hook =
    unsafe fn(*mut c_void, Option<&Event<'_>>, &mut Session) -> (wsg_callback_t, *mut c_void);

/// A request whose payload the caller keeps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kept {
    id: u8,
    data: ptr::NonNull<u8>,
    length: u8,
}

impl Kept {
    /// Returns the request.
    ///
    /// # Safety
    /// The data is still valid, as the request's documentation demands.
    unsafe fn command<'a>(self) -> Option<Command<'a>> {
        // SAFETY: passed on to the caller.
        let payload = unsafe { memory::bytes(self.data.as_ptr(), self.length.into()) }.ok()?;
        Some(Command::Unknown { id: self.id, payload })
    }
}

impl wsg_t {
    /// Returns the contents of initialized storage.
    pub(crate) fn open(wsg: Option<&mut Self>) -> Result<&mut Inner, wsg_error> {
        let inner = Inner::at(wsg.map_or(ptr::null_mut(), ptr::from_mut))?;
        // SAFETY: initialized, and borrowed from the caller.
        Ok(unsafe { &mut *inner })
    }

    /// Returns the contents of initialized storage for reading.
    pub(crate) fn look(wsg: Option<&Self>) -> Result<&Inner, wsg_error> {
        let inner = Inner::at(wsg.map_or(ptr::null_mut(), |wsg| ptr::from_ref(wsg).cast_mut()))?;
        // SAFETY: initialized, and borrowed from the caller.
        Ok(unsafe { &*inner })
    }
}

impl Inner {
    /// Returns the place of initialized contents. Parts of it are borrowed one by one, because an event borrows the
    /// parser while the session is used.
    fn at(wsg: *mut wsg_t) -> Result<*mut Self, wsg_error> {
        if wsg.is_null() {
            return Err(wsg_error::NullPointer);
        }
        let inner: *mut Self = wsg.cast();
        // SAFETY: `wsg_t` is as large and as aligned as `Inner`. The mark is read as an integer, because only storage
        // that `wsg_init` has filled holds an `Inner`.
        let ready = unsafe { (&raw const (*inner).ready).read() };
        if ready == READY { Ok(inner) } else { Err(wsg_error::NotInitialized) }
    }

    /// As [`at`](Self::at), for functions that the callback must not call.
    pub(crate) fn outside_callback(wsg: *mut wsg_t) -> Result<*mut Self, wsg_error> {
        let inner = Self::at(wsg)?;
        // SAFETY: initialized.
        if unsafe { (*inner).is_calling } { Err(wsg_error::InCallback) } else { Ok(inner) }
    }

    /// Lets a hook see every event and every tick. It is called with the callback's context, and returns the callback.
    pub(crate) fn set_hook(&mut self, hook: Hook, context: *mut c_void) -> (wsg_callback_t, *mut c_void) {
        self.hook = Some(hook);
        (self.callback.take(), core::mem::replace(&mut self.context, context))
    }

    pub(crate) const fn has_hook(&self) -> bool {
        self.hook.is_some()
    }

    /// Requests a command whose payload the caller keeps until the final event.
    pub(crate) fn keep(&mut self, id: u8, data: &[u8]) -> Outcome {
        if data.len() > WSG_MAX_PAYLOAD.saturating_sub(2) {
            return Err(wsg_error::TooLong);
        }
        if self.kept.is_some() {
            return Err(wsg_error::QueueFull);
        }
        self.session.request_borrowed(&Command::Unknown { id, payload: data })?;
        self.kept = Some(Kept { id, data: ptr::NonNull::from(data).cast(), length: data.len() as u8 });
        DONE
    }
}

/// Handles an event of the parser, and passes the resulting event to the callback.
///
/// # Safety
/// `inner` is initialized, and no reference to it exists except in `found`.
#[inline(never)]
pub(crate) unsafe fn feed(inner: *mut Inner, now: Instant, found: &frame::Event<'_>) {
    // SAFETY: a part that `found` does not borrow.
    let session = unsafe { &mut (*inner).session };
    if let Some(event) = session.handle(now, found) {
        // SAFETY: passed on to the caller.
        unsafe { deliver(inner, &event, Some(found)) };
    }
}

/// Passes an event to hook and callback.
///
/// # Safety
/// As [`feed`]; `event` and `found` may borrow the parser.
unsafe fn deliver(inner: *mut Inner, event: &Event<'_>, found: Option<&frame::Event<'_>>) {
    let payload = match found {
        Some(frame::Event::Frame(frame)) => frame.payload.get(STATUS_LEN..).unwrap_or(&[]),
        _ => &[],
    };
    let plain = wsg_event_t::of(event, payload);
    let ends = matches!(event, Event::Answered(_) | Event::Unanswered(_) | Event::Withdrawn(_));
    // SAFETY: parts that the event does not borrow. The caller of `wsg_init` guarantees that the callback may be called. No
    // reference exists during the callback, so that it may use the session.
    unsafe {
        if ends && (*inner).kept.is_some_and(|kept| kept.id == plain.command) {
            (*inner).kept = None;
        }
        let (mut callback, mut context) = ((*inner).callback, (*inner).context);
        if let Some(hook) = (*inner).hook {
            (callback, context) = hook(context, Some(event), &mut (*inner).session);
        }
        let Some(callback) = callback else { return };
        (*inner).is_calling = true;
        callback(context, &raw const plain);
        (*inner).is_calling = false;
    }
}

/// Initializes a session, which begins to connect with the first wsg_tick(). `config` may be null for the defaults.
/// `callback` receives all events and may be null; `context` is passed to it.
///
/// Initializing a session again discards it without an event.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_init(
    wsg: Option<&mut MaybeUninit<wsg_t>>,
    config: Option<&wsg_config_t>,
    callback: wsg_callback_t,
    context: *mut c_void,
) -> i32 {
    let init = || -> Outcome {
        let wsg = wsg.ok_or(wsg_error::NullPointer)?;
        let config = config.unwrap_or(&wsg_config_t::DEFAULT);
        let inner = Inner {
            ready: READY,
            parser: FrameParser::new(),
            session: Session::new(config.session()?),
            kept: None,
            received_at: Instant::from_millis(0),
            hook: None,
            callback,
            context,
            frame_timeout_ms: config.frame_timeout_ms,
            is_calling: false,
        };
        // SAFETY: `Inner` fits into `wsg_t`, see the assertion above.
        unsafe { wsg.as_mut_ptr().cast::<Inner>().write(inner) };
        DONE
    };
    code(init())
}

/// Takes bytes from the gripper and passes each resulting event to the callback. Call it with any number of bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_receive(wsg: *mut wsg_t, now_ms: u32, bytes: *const u8, length: usize) -> i32 {
    let receive = || -> Outcome {
        let now = Instant::from_millis(now_ms);
        let inner = Inner::outside_callback(wsg)?;
        // SAFETY: the rules of the crate's documentation.
        let mut rest = unsafe { memory::bytes(bytes, length) }?;
        loop {
            // SAFETY: initialized; only the parser is borrowed while its event is in use.
            unsafe {
                if !rest.is_empty() {
                    (*inner).received_at = now;
                }
                let (taken, found) = (*inner).parser.push_slice(rest);
                rest = rest.get(taken..).unwrap_or(&[]);
                let Some(found) = found else { return DONE };
                feed(inner, now, &found);
            }
        }
    };
    code(receive())
}

/// Processes time-outs, opens the next request, and passes each resulting event to the callback. Call it after
/// wsg_receive(), after requests, and at the latest when wsg_next_deadline() expires.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_tick(wsg: *mut wsg_t, now_ms: u32) -> i32 {
    let tick = || -> Outcome {
        let now = Instant::from_millis(now_ms);
        let inner = Inner::outside_callback(wsg)?;
        // SAFETY: initialized; each borrow of a part ends before the next one begins.
        unsafe {
            if (*inner).parser.is_mid_frame()
                && now.since((*inner).received_at) >= (*inner).frame_timeout_ms.into()
            {
                expire(inner, now);
            }
            if let Some(hook) = (*inner).hook {
                hook((*inner).context, None, &mut (*inner).session);
                tick_session(inner, now);
                // What it has requested because of these events.
                hook((*inner).context, None, &mut (*inner).session);
            }
            tick_session(inner, now);
        }
        DONE
    };
    code(tick())
}

/// Processes everything that is due in the session.
///
/// # Safety
/// `inner` is initialized, and no reference to it exists.
#[inline(never)]
unsafe fn tick_session(inner: *mut Inner, now: Instant) {
    // SAFETY: passed on to the caller. The events of a tick borrow nothing.
    unsafe {
        while let Some(event) = (*inner).session.tick(now) {
            deliver(inner, &event, None);
        }
    }
}

/// Ends an incomplete frame at once, for a caller that knows that the line is idle. wsg_tick() does so after the time-out
/// of the configuration.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_expire(wsg: *mut wsg_t, now_ms: u32) -> i32 {
    let end = || -> Outcome {
        let inner = Inner::outside_callback(wsg)?;
        // SAFETY: initialized, and not borrowed.
        unsafe { expire(inner, Instant::from_millis(now_ms)) };
        DONE
    };
    code(end())
}

/// Ends an incomplete frame, whose bytes may contain another one.
///
/// # Safety
/// As [`tick_session`].
#[inline(never)]
unsafe fn expire(inner: *mut Inner, now: Instant) {
    // SAFETY: passed on to the caller; only the parser is borrowed while its event is in use.
    unsafe {
        while let Some(found) = (*inner).parser.expire() {
            feed(inner, now, &found);
        }
    }
}

/// Writes the next message to `buffer` and returns its length, or 0 if there is nothing to send. The message counts as
/// sent. Call it after wsg_tick() until it returns 0, and send all messages in order.
///
/// `size` must be at least WSG_TRANSMIT_LEN, and at least 8 bytes more than the caller-owned data of an open request.
/// Otherwise the result is WSG_ERROR_BUFFER_TOO_SMALL, and the message remains to be sent.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_transmit(wsg: *mut wsg_t, now_ms: u32, buffer: *mut u8, size: usize) -> i32 {
    let transmit = || -> Outcome {
        // SAFETY: the rules of the crate's documentation. No callback is called.
        let (inner, buffer) = unsafe { (&mut *Inner::outside_callback(wsg)?, memory::buffer(buffer, size)?) };
        let kept_len = inner.kept.map_or(0, |kept| frame::OVERHEAD.saturating_add(kept.length.into()));
        if buffer.len() < kept_len.max(WSG_TRANSMIT_LEN) {
            return Err(wsg_error::BufferTooSmall);
        }
        // SAFETY: the documentation of each such request demands that its data stays valid.
        let kept = inner.kept.and_then(|kept| unsafe { kept.command() });
        let Some(command) = inner.session.poll_transmit_borrowed(Instant::from_millis(now_ms), kept) else {
            return DONE;
        };
        let encoder = FrameEncoder::new(command.id().code(), command);
        length(encoder.write_into(buffer).map_err(|_| wsg_error::BufferTooSmall)?)
    };
    code(transmit())
}

/// Writes the time until the next call of wsg_tick() is due, in milliseconds, and returns 1. Returns 0 if no call is due
/// unless something else happens. After a request, call wsg_tick() at once.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_next_deadline(
    wsg: Option<&wsg_t>,
    now_ms: u32,
    delay_ms: Option<&mut MaybeUninit<u32>>,
) -> i32 {
    let next = || -> Outcome {
        let inner = wsg_t::look(wsg)?;
        let now = Instant::from_millis(now_ms);
        let half_frame =
            inner.parser.is_mid_frame().then(|| inner.received_at.plus(inner.frame_timeout_ms.into()));
        let due = [half_frame, inner.session.poll_timeout()].into_iter().flatten();
        let due = due.reduce(Instant::earlier_of);
        give(delay_ms, due.map_or(u32::MAX, |due| due.since(now)))?;
        Ok(due.is_some().into())
    };
    code(next())
}

/// Closes the connection because the caller has lost or reopened the line. The next wsg_tick() reports the outcome of open
/// requests, then the session reconnects. An unconfirmed FAST STOP is sent again.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_disconnect(wsg: Option<&mut wsg_t>) -> i32 {
    let disconnect = || -> Outcome {
        let inner = wsg_t::open(wsg)?;
        if inner.is_calling {
            return Err(wsg_error::InCallback);
        }
        inner.session.disconnect();
        DONE
    };
    code(disconnect())
}

/// Cancels every unsent request without an event, and releases caller-owned data. Stop and FAST STOP are kept.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_withdraw(wsg: Option<&mut wsg_t>) -> i32 {
    let withdraw = || -> Outcome {
        let inner = wsg_t::open(wsg)?;
        inner.session.withdraw();
        inner.kept = None;
        DONE
    };
    code(withdraw())
}
