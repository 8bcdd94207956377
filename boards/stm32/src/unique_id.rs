//! The serial number: the MCU's unique ID, reduced to 32 bits (RM0351, 49.1; RM0440, "Unique device ID register").

use stm32_metapac::{DBGMCU, UID};

use crate::chip::DEVICE_ID;

/// Reads the serial number. Returns 0 in an emulator without the unique ID, where reading it would be a fault. Such an
/// emulator also lacks the chip's device ID (DBGMCU_IDCODE).
pub(crate) fn serial_number() -> u32 {
    if DBGMCU.idcode().read().dev_id() != DEVICE_ID {
        return 0;
    }
    // Wafer coordinates, wafer number with a part of the lot number, and the rest of the lot number.
    let words = [UID.uid(0).read(), UID.uid(1).read(), UID.uid(2).read()];
    words.into_iter().fold(0, |number: u32, word| number.rotate_left(11) ^ word)
}
