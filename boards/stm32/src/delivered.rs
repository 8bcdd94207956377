//! The settings that the image was delivered with. They are in flash, where `cargo xtask build --set` and `flash --set` change them
//! in the image.

use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::Record;

/// Found by its name in the image.
#[used]
#[unsafe(no_mangle)]
static WSG_SETTINGS: Record = Config::DEFAULT.record();

/// Reads them.
pub(crate) fn settings() -> Record {
    let mut record = [0; _];
    // One by one: read as a whole they would be on the stack twice.
    for (value, delivered) in record.iter_mut().zip(&WSG_SETTINGS) {
        // Volatile: the compiler must not take them for what stands above.
        // SAFETY: a reference may be read through.
        *value = unsafe { core::ptr::read_volatile(delivered) };
    }
    record
}
