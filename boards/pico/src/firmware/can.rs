//! CAN: none yet.

use bus_slcan::ClassicFrame;
use wsg_bridge_fw::can::{CanController, Health};

/// No controller: as good as bus-off.
#[derive(Debug)]
pub(crate) struct Can;

impl Can {
    pub(crate) const fn new() -> Self {
        Self
    }
}

impl embedded_can::nb::Can for Can {
    type Frame = ClassicFrame;
    type Error = embedded_can::ErrorKind;

    fn transmit(&mut self, _: &ClassicFrame) -> nb::Result<Option<ClassicFrame>, Self::Error> {
        Err(nb::Error::WouldBlock)
    }

    fn receive(&mut self) -> nb::Result<ClassicFrame, Self::Error> {
        Err(nb::Error::WouldBlock)
    }
}

impl CanController for Can {
    fn health(&mut self) -> Health {
        Health { is_off: true, ..Health::default() }
    }

    fn abort(&mut self) {}

    fn recover(&mut self) {}
}
