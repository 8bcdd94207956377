//! The bus's line as a board hands it over.

use crate::plc::side::NoBus;
use bus_modbus::rtu::Character;

/// A half-duplex line for Modbus RTU that measures its silences.
///
/// The board switches the driver of an RS-485 transceiver by itself, and does not hand over what it sends.
pub trait BusPort {
    /// The character that waits longest, and for how long none came before it, in microseconds.
    fn receive(&mut self) -> Option<(Character, u32)>;

    /// For how long no character has come, in microseconds; looked at when none waits.
    fn silence_us(&mut self) -> u32;

    /// Sends a frame. Does not wait; while another is being sent, this one is dropped.
    fn send(&mut self, frame: &[u8]);
}

impl BusPort for NoBus {
    fn receive(&mut self) -> Option<(Character, u32)> {
        None
    }

    fn silence_us(&mut self) -> u32 {
        u32::MAX
    }

    fn send(&mut self, _: &[u8]) {}
}
