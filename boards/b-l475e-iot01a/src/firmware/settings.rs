//! The settings that the image was delivered with. They lie in flash, where `cargo xtask build --set` and `flash --set`
//! change them in the image.

use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::Record;

/// Found by its name in the image.
#[used]
#[unsafe(no_mangle)]
static WSG_SETTINGS: Record = Config::DEFAULT.record();

/// Reads them.
pub(crate) fn delivered() -> Record {
    // Volatile: the compiler must not take them for what stands above.
    // SAFETY: a reference may be read through.
    unsafe { core::ptr::read_volatile(&raw const WSG_SETTINGS) }
}
