//! The register interface of the fieldbus manual on top of a session, for a gateway with a bus of its own.
//!
//! The PLC's output image has 8 bytes and its input image 12 (fieldbus manual, chapter 5).

use core::ffi::c_void;
use core::mem::MaybeUninit;

use wsg_fieldbus::{Controller, InputImage, OutputImage, SilenceReaction};
use wsg_protocol::AutoUpdate;
use wsg_protocol::session::{Event, Session, Topic};

use crate::error::{DONE, Outcome, code, length, wsg_error};
use crate::memory;
use crate::session::{wsg_callback_t, wsg_t};

/// Length of the output image, from the PLC.
pub const WSG_FIELDBUS_OUTPUT_LEN: usize = 8;
/// Length of the input image, to the PLC.
pub const WSG_FIELDBUS_INPUT_LEN: usize = 12;

const _: () =
    assert!(OutputImage::LEN == WSG_FIELDBUS_OUTPUT_LEN && InputImage::LEN == WSG_FIELDBUS_INPUT_LEN);

/// Reaction of wsg_fieldbus_silence(): the motion in progress continues.
pub const WSG_SILENCE_HOLD: u8 = 0;
/// Reaction of wsg_fieldbus_silence(): a motion is stopped, a held part stays held.
pub const WSG_SILENCE_STOP: u8 = 1;
/// Reaction of wsg_fieldbus_silence(): FAST STOP.
pub const WSG_SILENCE_FAST_STOP: u8 = 2;

/// Number of 64-bit words of a controller.
/// cbindgen:ignore
pub const WSG_FIELDBUS_WORDS: usize = if cfg!(target_pointer_width = "64") { 40 } else { 32 };

const _: () = assert!(
    size_of::<Contents>() <= size_of::<wsg_fieldbus_t>()
        && align_of::<Contents>() <= align_of::<wsg_fieldbus_t>()
);

/// The controller of the register interface, owned by the caller. Attach it to a session with wsg_fieldbus_attach().
#[repr(C)]
#[derive(Debug)]
pub struct wsg_fieldbus_t {
    /// Private.
    pub opaque: [MaybeUninit<u64>; WSG_FIELDBUS_WORDS],
}

/// Marks initialized storage.
const READY: u32 = 0x4246_5357;

struct Contents {
    ready: u32,
    controller: Controller,
    callback: wsg_callback_t,
    context: *mut c_void,
}

/// Returns the place of initialized contents. The session has its address, so it is borrowed for a single call only.
fn at(fieldbus: *mut wsg_fieldbus_t) -> Result<*mut Contents, wsg_error> {
    if fieldbus.is_null() {
        return Err(wsg_error::NullPointer);
    }
    let contents: *mut Contents = fieldbus.cast();
    // SAFETY: `wsg_fieldbus_t` is as large and as aligned as the contents; the mark is read as an integer.
    let ready = unsafe { (&raw const (*contents).ready).read() };
    if ready == READY { Ok(contents) } else { Err(wsg_error::NotInitialized) }
}

/// Passes events to the controller, and its commands to the session.
///
/// # Safety
/// `context` is the address of contents, which only this call uses.
unsafe fn follow(
    context: *mut c_void,
    event: Option<&Event<'_>>,
    session: &mut Session,
) -> (wsg_callback_t, *mut c_void) {
    // SAFETY: passed on to the caller.
    let contents = unsafe { &mut *context.cast::<Contents>() };
    let controller = &mut contents.controller;
    if let Some(event) = event {
        controller.handle(event, session.known());
    } else {
        controller.adopt_known(session.known());
        while let Some(command) = controller.poll_command() {
            if let Err(error) = session.request(command) {
                controller.refused(command.id(), error, session.known());
            }
        }
    }
    (contents.callback, contents.context)
}

/// Initializes a controller and attaches it to a session, after wsg_init() and before the first wsg_tick(). It receives every
/// event before the callback, and subscribes to width and force. Initialize the session with `verify_settings` of 1.
///
/// The controller must stay at its place as long as the session is used. Do not send motions of your own.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_fieldbus_attach(fieldbus: *mut wsg_fieldbus_t, wsg: Option<&mut wsg_t>) -> i32 {
    let attach = || -> Outcome {
        let inner = wsg_t::open(wsg)?;
        if fieldbus.is_null() {
            return Err(wsg_error::NullPointer);
        }
        let contents: *mut Contents = fieldbus.cast();
        if inner.has_hook() || inner.session.is_connected() {
            return Err(wsg_error::Argument);
        }
        for topic in [Topic::Width, Topic::Force] {
            inner.session.subscribe(topic, AutoUpdate::on_change(AutoUpdate::MIN_PERIOD_MS));
        }
        let (callback, context) = inner.set_hook(follow, contents.cast());
        let attached = Contents { ready: READY, controller: Controller::new(), callback, context };
        // SAFETY: the contents fit, see the assertion above.
        unsafe { contents.write(attached) };
        DONE
    };
    code(attach())
}

/// Takes an output image that the PLC wrote, complete: exactly WSG_FIELDBUS_OUTPUT_LEN bytes. Call it for each image, so that
/// no edge is lost; the next wsg_tick() requests the commands.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_fieldbus_write(
    fieldbus: *mut wsg_fieldbus_t,
    wsg: Option<&wsg_t>,
    image: *const u8,
    image_length: usize,
) -> i32 {
    let write = || -> Outcome {
        let (contents, inner) = (at(fieldbus)?, wsg_t::look(wsg)?);
        // SAFETY: the rules of the crate's documentation.
        let image = unsafe { memory::bytes(image, image_length) }?;
        let image = OutputImage::from_bytes(image.try_into().map_err(|_| wsg_error::Argument)?);
        // SAFETY: initialized.
        unsafe { (*contents).controller.set_output(&image, inner.session.known()) };
        DONE
    };
    code(write())
}

/// Writes the input image for the PLC to `image` and returns its length, WSG_FIELDBUS_INPUT_LEN.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_fieldbus_read(
    fieldbus: *mut wsg_fieldbus_t,
    wsg: Option<&wsg_t>,
    image: *mut u8,
    size: usize,
) -> i32 {
    let read = || -> Outcome {
        let (contents, inner) = (at(fieldbus)?, wsg_t::look(wsg)?);
        // SAFETY: the rules of the crate's documentation.
        let buffer = unsafe { memory::buffer(image, size) }?;
        // SAFETY: initialized.
        let bytes = unsafe { (*contents).controller.input(inner.session.known()) }.to_bytes();
        let target = buffer.get_mut(..bytes.len()).ok_or(wsg_error::BufferTooSmall)?;
        target.iter_mut().zip(bytes).for_each(|(slot, byte)| *slot = byte);
        length(bytes.len())
    };
    code(read())
}

/// Reports that the PLC has become silent. `reaction` is WSG_SILENCE_... A jog ends in any case.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn wsg_fieldbus_silence(
    fieldbus: *mut wsg_fieldbus_t,
    wsg: Option<&wsg_t>,
    reaction: u8,
) -> i32 {
    let silence = || -> Outcome {
        let (contents, inner) = (at(fieldbus)?, wsg_t::look(wsg)?);
        let reaction = match reaction {
            WSG_SILENCE_HOLD => SilenceReaction::Hold,
            WSG_SILENCE_STOP => SilenceReaction::Stop,
            WSG_SILENCE_FAST_STOP => SilenceReaction::FastStop,
            _ => return Err(wsg_error::Argument),
        };
        // SAFETY: initialized.
        unsafe { (*contents).controller.silence(reaction, inner.session.known()) };
        DONE
    };
    code(silence())
}
