//! The contract between a device on a bus that exchanges images in cycles, and the owner of the image.

use bus_ethernetip::Status;
use bus_profinet::Stored;
use std::fmt;
use std::net::IpAddr;
use wsg_fieldbus::{InputImage, OutputImage};

/// The owner of the image, which the device serves to its controller.
pub trait Owner {
    /// Returns the inputs, or `None` without valid ones. Faults are in their system state. Without inputs, a PROFINET controller
    /// receives bad inputs and its diagnosis does not change, and an EtherNet/IP scanner receives an error.
    fn inputs(&self) -> Option<InputImage>;

    /// Takes outputs, changed or not. `before` has the previous ones, or is `None` for the first outputs after the controller
    /// enabled them: a set flag is then no edge.
    fn take_outputs(&self, outputs: &OutputImage, before: Option<&OutputImage>);

    /// Handles the end of the outputs: the controller is silent, has stopped or has left.
    fn end_outputs(&self);

    /// Logs an event.
    fn note(&self, what: fmt::Arguments<'_>);

    /// Returns, once for each pause of the computer, whether waiting frames are too old. The device then discards them and ends the
    /// connection to the controller, which may connect again.
    fn has_paused(&self) -> bool {
        false
    }

    /// Saves name, address and I&M data, which a controller or a tool has changed. PROFINET only.
    fn store(&self, _: &Stored) {}

    /// Records the address of the controller before its outputs are taken. EtherNet/IP only.
    fn note_controller(&self, _: IpAddr) {}

    /// Reads a register by the number of a Modbus function: 3 for holding registers, 4 for input registers. EtherNet/IP only.
    ///
    /// # Errors
    /// Returns the reason for a refusal.
    fn register(&self, _function: u16, _address: u16) -> Result<u16, Status> {
        Err(Status::NoInstance)
    }
}
