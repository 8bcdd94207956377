//! The serial number: what of the MCU's unique identification fits into 32 bits (RM0351, 49.1; RM0440, "Unique device ID register").

use stm32_metapac::{DBGMCU, UID};

use crate::chip::DEVICE_ID;

/// Reads the serial number. Returns 0 in an emulator without the identification: there the chip's own number (DBGMCU_IDCODE) is
/// missing, too, and reading the identification would be a fault.
pub(crate) fn serial_number() -> u32 {
    if DBGMCU.idcode().read().dev_id() != DEVICE_ID {
        return 0;
    }
    // The place on the wafer, the wafer with a part of the lot, and the rest of the lot.
    let words = [UID.uid(0).read(), UID.uid(1).read(), UID.uid(2).read()];
    words.into_iter().fold(0, |number: u32, word| number.rotate_left(11) ^ word)
}
