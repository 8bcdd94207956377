//! A queue of events, for a caller that processes them outside the callback.

use core::ffi::c_void;
use core::mem::MaybeUninit;
use core::ptr;

use crate::error::{DONE, Outcome, code, wsg_error};
use crate::event::{wsg_event, wsg_event_t, wsg_value};

/// A queue of events, owned by the caller, of which all members are private. Pass wsg_queue_push() as the callback and the
/// queue as its context: `wsg_init(&wsg, NULL, wsg_queue_push, &queue)`.
#[repr(C)]
#[derive(Debug)]
pub struct wsg_queue_t {
    /// Private.
    pub events: *mut wsg_event_t,
    /// Private.
    pub bytes: *mut u8,
    /// Private.
    pub bytes_size: usize,
    /// Private.
    pub capacity: u16,
    /// Private.
    pub count: u16,
    /// Private.
    pub lost: u16,
    /// Private.
    pub bytes_state: u8,
}

/// The bytes are unused; belong to a queued event; belong to the event returned last.
const FREE: u8 = 0;
const QUEUED: u8 = 1;
const RETURNED: u8 = 2;

impl wsg_queue_t {
    /// Returns the queued events and one free slot, if there is one.
    ///
    /// # Safety
    /// The events of `wsg_queue_init` are still valid.
    unsafe fn events(&mut self) -> &mut [wsg_event_t] {
        if self.events.is_null() {
            return &mut [];
        }
        let len = self.count.saturating_add(1).min(self.capacity);
        // SAFETY: `wsg_queue_init` has written an event to each slot.
        unsafe { core::slice::from_raw_parts_mut(self.events, len.into()) }
    }

    /// Removes the event at an index and returns it.
    ///
    /// # Safety
    /// As [`events`](Self::events).
    unsafe fn remove(&mut self, index: usize) -> Option<wsg_event_t> {
        let count = usize::from(self.count);
        // SAFETY: passed on to the caller.
        let events = unsafe { self.events() };
        let removed = events.get(..count)?.get(index).copied()?;
        for at in index.saturating_add(1)..count {
            if let Some(&next) = events.get(at)
                && let Some(slot) = events.get_mut(at.wrapping_sub(1))
            {
                *slot = next;
            }
        }
        self.count = self.count.saturating_sub(1);
        Some(removed)
    }

    /// Moves the bytes of an event, which end with the callback, to the caller's buffer, or drops them.
    ///
    /// # Safety
    /// The buffer of `wsg_queue_init` is still valid, and so are the bytes of the event.
    unsafe fn take_bytes(&mut self, event: &mut wsg_event_t) {
        if event.value_kind != wsg_value::Bytes as u8 {
            return;
        }
        // SAFETY: the kind selects this member.
        let value = unsafe { event.value.bytes };
        let length = usize::from(value.length);
        let mut kept = ptr::null();
        if length > 0 && self.bytes_state == FREE && length <= self.bytes_size && !value.data.is_null() {
            // SAFETY: both are at least that long, and the caller's buffer is not the library's memory.
            unsafe { ptr::copy_nonoverlapping(value.data, self.bytes, length) };
            self.bytes_state = QUEUED;
            kept = self.bytes.cast_const();
        } else if length > 0 {
            self.lost = self.lost.saturating_add(1);
        }
        event.value.bytes.data = kept;
    }
}

/// Initializes a queue for `capacity` events, at least 1. `bytes` holds the data of one event with WSG_VALUE_BYTES from the
/// time it is queued until the wsg_queue_pop() after the one that returned it; with a null pointer such events have no
/// data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_queue_init(
    queue: Option<&mut MaybeUninit<wsg_queue_t>>,
    events: *mut wsg_event_t,
    capacity: u16,
    bytes: *mut u8,
    bytes_size: usize,
) -> i32 {
    let init = || -> Outcome {
        let queue = queue.ok_or(wsg_error::NullPointer)?;
        if events.is_null() {
            return Err(wsg_error::NullPointer);
        }
        if capacity == 0 {
            return Err(wsg_error::Argument);
        }
        // SAFETY: the rules of the crate's documentation. All bytes 0 are a valid event.
        unsafe { ptr::write_bytes(events, 0, capacity.into()) };
        let bytes_size = if bytes.is_null() { 0 } else { bytes_size };
        let empty = wsg_queue_t { events, bytes, bytes_size, capacity, count: 0, lost: 0, bytes_state: FREE };
        queue.write(empty);
        DONE
    };
    code(init())
}

/// Appends an event; the callback for wsg_init(), with the queue as context. If the queue is full, the oldest
/// WSG_EVENT_REPORTED makes room, or else the new event is lost.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_queue_push(queue: *mut c_void, event: *const wsg_event_t) {
    // SAFETY: the context is the queue, and the event is valid during the callback.
    let (Some(queue), Some(&(mut event))) =
        (unsafe { (queue.cast::<wsg_queue_t>().as_mut(), event.as_ref()) })
    else {
        return;
    };
    // SAFETY: the rules of the crate's documentation.
    unsafe {
        if queue.count >= queue.capacity {
            queue.lost = queue.lost.saturating_add(1);
            let is_report = |queued: &wsg_event_t| queued.kind == wsg_event::Reported as u8;
            let Some(oldest) = queue.events().iter().position(is_report) else { return };
            queue.remove(oldest);
        }
        queue.take_bytes(&mut event);
        let at = usize::from(queue.count);
        if let Some(slot) = queue.events().get_mut(at) {
            *slot = event;
            queue.count = queue.count.saturating_add(1);
        }
    }
}

/// Removes the oldest event, writes it to `event` and returns 1. Returns 0 if the queue is empty.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_queue_pop(
    queue: Option<&mut wsg_queue_t>,
    event: Option<&mut MaybeUninit<wsg_event_t>>,
) -> i32 {
    let pop = || -> Outcome {
        let queue = queue.ok_or(wsg_error::NullPointer)?;
        let event = event.ok_or(wsg_error::NullPointer)?;
        if queue.bytes_state == RETURNED {
            queue.bytes_state = FREE;
        }
        // SAFETY: the rules of the crate's documentation.
        let Some(oldest) = (unsafe { queue.remove(0) }) else { return DONE };
        // SAFETY: the kind selects this member.
        let is_bytes =
            oldest.value_kind == wsg_value::Bytes as u8 && !unsafe { oldest.value.bytes }.data.is_null();
        if is_bytes {
            queue.bytes_state = RETURNED;
        }
        event.write(oldest);
        Ok(1)
    };
    code(pop())
}

/// Returns the number of events and of data of events that were lost, up to 65 535.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_queue_lost(queue: Option<&wsg_queue_t>) -> i32 {
    queue.map_or(wsg_error::NullPointer as i32, |queue| queue.lost.into())
}
