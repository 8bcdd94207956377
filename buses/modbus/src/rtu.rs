//! RTU framing on a serial line (MODBUS over serial line specification V1.02).
//!
//! A frame is a unit's address, a PDU and a CRC, ended by silence. Silence is an input here, in microseconds: who
//! measures it is the caller's business.

mod counters;
mod receiver;
mod server;
mod timing;

pub use counters::Counters;
pub use receiver::{Character, Damage, Mode, Received, Receiver};
pub use server::{BROADCAST, Config, Event, Server, UNITS};
pub use timing::Timing;

use super::MAX_PDU_LEN;

/// Bytes of the longest frame.
pub const MAX_FRAME_LEN: usize = 1 + MAX_PDU_LEN + CRC_LEN;

const CRC_LEN: usize = 2;

const CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_MODBUS);

/// The checksum of a frame's address and PDU; it is sent low byte first.
///
/// ```
/// use bus_modbus::rtu::crc;
///
/// // The specification's example: address 2, function 7.
/// assert_eq!(crc(&[0x02, 0x07]).to_le_bytes(), [0x41, 0x12]);
/// ```
#[must_use]
pub fn crc(bytes: &[u8]) -> u16 {
    // A table in flash, not a copy of it on the stack.
    static TABLE: crc::Crc<u16> = CRC;
    TABLE.checksum(bytes)
}

#[cfg(test)]
mod tests;
