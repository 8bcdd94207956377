//! The service port: none yet.

use bus_modbus::rtu::Character;
use wsg_bridge_fw::plc::BusPort;

/// A line on which nothing comes.
pub(crate) struct ServiceLine;

/// The end of the service port. To be asked for once.
pub(crate) const fn service_line() -> ServiceLine {
    ServiceLine
}

impl BusPort for ServiceLine {
    fn receive(&mut self) -> Option<(Character, u32)> {
        None
    }

    fn silence_us(&mut self) -> u32 {
        0
    }

    fn send(&mut self, _: &[u8]) {}
}
