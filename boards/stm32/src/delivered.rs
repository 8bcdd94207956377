//! The factory settings in flash. `cargo xtask build --set` and `flash --set` change them in the image.

use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{Record, SETTINGS};

/// Found in the image by its symbol.
#[used]
#[unsafe(no_mangle)]
static WSG_SETTINGS: Record = Config::DEFAULT.record();

/// Returns the factory settings.
pub(crate) fn settings() -> Record {
    let mut record = [0; SETTINGS.len()];
    // Copied one by one, because a copy of the whole table would be on the stack twice.
    for (value, delivered) in record.iter_mut().zip(&WSG_SETTINGS) {
        // Volatile, because the image may have been changed after compilation.
        // SAFETY: the pointer is derived from a valid reference.
        *value = unsafe { core::ptr::read_volatile(delivered) };
    }
    record
}
