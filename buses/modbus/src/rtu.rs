//! RTU framing on a serial line (MODBUS over serial line specification V1.02).
//!
//! A frame consists of a unit's address, a PDU and a CRC, and ends with silence. Silence is an input, in microseconds;
//! the caller measures it.

mod counters;
mod receiver;
mod server;
mod timing;

pub use counters::Counters;
pub use receiver::{Character, Damage, Mode, Received, Receiver};
pub use server::{BROADCAST, Config, Event, Server, UNITS};
pub use timing::Timing;

use super::MAX_PDU_LEN;

/// Maximum length of a frame in bytes.
pub const MAX_FRAME_LEN: usize = 1 + MAX_PDU_LEN + CRC_LEN;

const CRC_LEN: usize = 2;

const CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_MODBUS);

/// Returns the checksum of a frame's address and PDU. It is sent low byte first.
///
/// ```
/// use bus_modbus::rtu::crc;
///
/// // The specification's example: address 2, function 7.
/// assert_eq!(crc(&[0x02, 0x07]).to_le_bytes(), [0x41, 0x12]);
/// ```
#[must_use]
pub fn crc(bytes: &[u8]) -> u16 {
    // A static keeps the table in flash; a constant would be copied to the stack.
    static TABLE: crc::Crc<u16> = CRC;
    TABLE.checksum(bytes)
}

#[cfg(test)]
mod tests;
