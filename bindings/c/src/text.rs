//! Texts for logs, NUL-terminated and valid for ever.

use core::ffi::{CStr, c_char};

use wsg_protocol::{CommandId, Status};

use crate::error::wsg_error;

/// Texts joined with their NUL characters, and where each begins.
struct Texts<const COUNT: usize, const SIZE: usize> {
    joined: [u8; SIZE],
    begins: [u16; COUNT],
}

impl<const COUNT: usize, const SIZE: usize> Texts<COUNT, SIZE> {
    fn at(&self, index: usize) -> Option<*const c_char> {
        let begin = *self.begins.get(index)?;
        Some(self.joined.get(usize::from(begin)..)?.as_ptr().cast())
    }
}

/// Defines a table of the texts that a method returns for all values of a table of the protocol.
macro_rules! texts {
    ($name:ident, $values:expr, $text:ident) => {
        // Evaluated by the compiler: an index out of range would be an error there.
        #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects)]
        mod $name {
            use super::*;

            const COUNT: usize = $values.len();

            const SIZE: usize = {
                let (mut size, mut item) = (0, 0);
                while item < COUNT {
                    size += $values[item].$text().len() + 1;
                    item += 1;
                }
                size
            };

            pub(super) static TEXTS: Texts<COUNT, SIZE> = {
                let (mut joined, mut begins) = ([0; SIZE], [0; COUNT]);
                let (mut at, mut item) = (0, 0);
                while item < COUNT {
                    let text = $values[item].$text().as_bytes();
                    begins[item] = at as u16;
                    let mut byte = 0;
                    while byte < text.len() {
                        joined[at] = text[byte];
                        at += 1;
                        byte += 1;
                    }
                    at += 1;
                    item += 1;
                }
                Texts { joined, begins }
            };
        }
    };
}

texts!(symbols, Status::ALL, symbol);
texts!(meanings, Status::ALL, meaning);
texts!(commands, CommandId::ALL, name);

/// Returns the manual's name of a status, such as "E_CMD_PENDING", or "E_?".
#[unsafe(no_mangle)]
pub extern "C" fn wsg_status_name(status: u16) -> *const c_char {
    // The status codes are the indices of the table.
    symbols::TEXTS.at(status.into()).unwrap_or(c"E_?".as_ptr())
}

/// Returns the meaning of a status.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_status_text(status: u16) -> *const c_char {
    meanings::TEXTS.at(status.into()).unwrap_or(c"a status that the manual does not list".as_ptr())
}

/// Returns the manual's name of a command, such as "Grip Part", or "unknown command".
#[unsafe(no_mangle)]
pub extern "C" fn wsg_command_name(command: u8) -> *const c_char {
    let index = CommandId::ALL.iter().position(|id| id.code() == command);
    index.and_then(|index| commands::TEXTS.at(index)).unwrap_or(c"unknown command".as_ptr())
}

/// Returns the meaning of a return value.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_error_text(error: i32) -> *const c_char {
    let known = wsg_error::ALL.into_iter().find(|known| *known as i32 == error);
    meaning(if error > 0 { wsg_error::None } else { known.unwrap_or(wsg_error::Other) }).as_ptr()
}

const fn meaning(error: wsg_error) -> &'static CStr {
    match error {
        wsg_error::None => c"no error",
        wsg_error::NullPointer => c"null pointer",
        wsg_error::NotInitialized => c"not initialized; call wsg_init()",
        wsg_error::Config => c"a value of the configuration is outside its range",
        wsg_error::InCallback => c"not permitted in the event callback",
        wsg_error::BufferTooSmall => c"buffer too small",
        wsg_error::Argument => c"argument outside its range",
        wsg_error::TooLong => c"too long",
        wsg_error::NotFinite => c"number not finite",
        wsg_error::Character => c"control or non-ASCII character",
        wsg_error::NotConnected => c"not connected to a gripper",
        wsg_error::MotionRunning => c"a motion is running",
        wsg_error::FastStopRunning => c"a FAST STOP is not confirmed yet",
        wsg_error::QueueFull => c"too many requests are queued",
        wsg_error::Malformed => c"the payload violates the manual",
        wsg_error::OutOfLimits => c"outside the limits of the gripper",
        wsg_error::Other => c"unknown error",
    }
}

/// Returns the version of the library, such as "0.1.0".
#[unsafe(no_mangle)]
pub extern "C" fn wsg_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
