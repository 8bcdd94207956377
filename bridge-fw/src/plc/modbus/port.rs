//! Interface between a board and the bus's line.

use crate::plc::side::NoBus;
use bus_modbus::rtu::Character;

/// A half-duplex line for Modbus RTU that measures silences.
///
/// The board switches the driver of an RS-485 transceiver, and suppresses the echo of sent bytes.
pub trait BusPort {
    /// Returns the oldest received character, and the silence before it in microseconds.
    fn receive(&mut self) -> Option<(Character, u32)>;

    /// Returns the silence since the last character, in microseconds. Called when no character is left.
    fn silence_us(&mut self) -> u32;

    /// Sends a frame without waiting. Discards it while another one is being sent.
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
