//! The serial number: what of the MCU's unique identification fits into 32 bits (RM0351, 49.1).

use stm32_metapac::{DBGMCU, UID};

/// What the MCU says of itself (DBGMCU_IDCODE, RM0351, 48.6.1).
const STM32L475: u16 = 0x415;

/// Reads it; 0 of an MCU that is none: an emulator that has no such register has no identification either, and faults where it
/// would be.
pub(crate) fn read() -> u32 {
    if DBGMCU.idcode().read().dev_id() != STM32L475 {
        return 0;
    }
    // The place on the wafer, the wafer with a part of the lot, and the rest of the lot.
    let words = [UID.uid(0).read(), UID.uid(1).read(), UID.uid(2).read()];
    words.into_iter().fold(0, |number: u32, word| number.rotate_left(11) ^ word)
}
