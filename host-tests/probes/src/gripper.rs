//! The MODBUS device of the probes, which consists only of the two images.

use bus_modbus::{Bits, Device, Exception, Identification, Words};
use wsg_fieldbus::Images;

use core::hint::black_box as opaque;

/// A device with the images as its registers.
#[derive(Debug)]
pub struct Gripper(pub Images);

impl Device for Gripper {
    fn coil(&self, address: u16) -> Result<bool, Exception> {
        self.0.coil(address)
    }

    fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        self.0.discrete_input(address)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        self.0.holding_register(address)
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        self.0.input_register(address)
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        self.0.write_coils(first, values)
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        self.0.write_registers(first, values)
    }

    fn identification(&self) -> Identification {
        Identification {
            vendor_name: opaque("V"),
            product_code: opaque("P"),
            revision: opaque("R"),
            regular: opaque(None),
        }
    }
}
