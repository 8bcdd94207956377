//! The PLC's wires, the lines, and the pins that they end on, as tables: for drivers, harness and documents.

use wsg_bridge_fw::io::{Inputs, Outputs};

/// A GPIO port that wires are on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Port {
    /// GPIOA.
    A,
    /// GPIOB.
    B,
    /// GPIOC.
    C,
    /// GPIOD.
    D,
}

impl Port {
    /// Returns the letter in the port's name.
    #[must_use]
    pub const fn letter(self) -> char {
        match self {
            Port::A => 'A',
            Port::B => 'B',
            Port::C => 'C',
            Port::D => 'D',
        }
    }
}

/// A wire from the PLC and the pin that it ends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputWire {
    /// The one bit of [`Inputs`] that this wire is.
    pub signal: Inputs,
    /// The pin's port.
    pub port: Port,
    /// The pin's number in its port, 0 to 15.
    pub pin: u8,
    /// The pin's name on the board's connector.
    pub connector: &'static str,
}

/// A wire to the PLC and the pin that it starts from. All of them are on one port, so that one write changes them together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputWire {
    /// The one bit of [`Outputs`] that this wire is.
    pub signal: Outputs,
    /// The pin's number in the port of the outputs, 0 to 15.
    pub pin: u8,
    /// The pin's name on the board's connector.
    pub connector: &'static str,
}

/// The level that a pin is pulled to while nobody drives it; the values of its field in PUPDR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pull {
    /// None.
    None = 0b00,
    /// High. A line idles high, and recessive is high: without a transceiver the receiver hears silence, not noise.
    Up = 0b01,
    /// Low.
    Down = 0b10,
}

/// A pin that a peripheral takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinePin {
    /// The pin's port.
    pub port: Port,
    /// The pin's number in its port, 0 to 15.
    pub pin: u8,
    /// The peripheral's number among the pin's alternate functions (the chip's data sheet).
    pub function: u8,
    /// What it is pulled to.
    pub pull: Pull,
}

/// Returns the pins of all wires as a mask of their port. Fails to evaluate where two wires are on one pin.
#[must_use]
pub const fn output_pins(wires: &[OutputWire; Outputs::COUNT]) -> u16 {
    let mut mask = 0u16;
    let mut wire = 0;
    while wire < wires.len() {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            mask |= 1 << wires[wire].pin;
        }
        wire += 1;
    }
    assert!(mask.count_ones() as usize == Outputs::COUNT);
    mask
}

/// Returns the levels of the port that show `outputs`; unused pins are 0.
#[inline]
#[must_use]
pub fn port_from_outputs(wires: &[OutputWire], outputs: Outputs) -> u16 {
    wires.iter().filter(|wire| outputs.contains(wire.signal)).fold(0, |levels, wire| levels | 1 << wire.pin)
}

/// Returns the outputs that the levels of the port show.
#[must_use]
pub fn outputs_from_port(wires: &[OutputWire], levels: u16) -> Outputs {
    wires.iter().filter(|wire| levels & (1 << wire.pin) != 0).map(|wire| wire.signal).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// On every other pin, the first signal on the highest.
    fn wires() -> [OutputWire; Outputs::COUNT] {
        let mut pins = (0..16).rev().step_by(2);
        let mut signals = Outputs::all().iter();
        [(); Outputs::COUNT].map(|()| OutputWire {
            signal: signals.next().unwrap(),
            pin: pins.next().unwrap(),
            connector: "",
        })
    }

    #[test]
    fn every_set_of_outputs_survives_the_port() {
        let wires = wires();
        for bits in 0..=Outputs::all().bits() {
            let outputs = Outputs::from_bits_retain(bits);
            assert_eq!(outputs_from_port(&wires, port_from_outputs(&wires, outputs)), outputs);
        }
    }

    #[test]
    fn each_output_is_shown_at_its_pin_alone() {
        let wires = wires();
        for wire in wires {
            assert_eq!(port_from_outputs(&wires, wire.signal), 1 << wire.pin);
        }
        assert_eq!(port_from_outputs(&wires, Outputs::all()), output_pins(&wires));
        assert_eq!(port_from_outputs(&wires, Outputs::empty()), 0);
    }
}
