//! Tables of the PLC's wires, the lines and their pins, for drivers, test harness and documents.

use wsg_bridge_fw::io::{Inputs, Outputs};

/// A GPIO port of the chip.
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
    /// Returns the letter of the port.
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

/// A wire from the PLC and its input pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputWire {
    /// The signal, exactly one bit of [`Inputs`].
    pub signal: Inputs,
    /// The pin's port.
    pub port: Port,
    /// The pin's number in its port, 0 to 15.
    pub pin: u8,
    /// The pin's name on the board's connector.
    pub connector: &'static str,
}

/// A wire to the PLC and its output pin. All are on one port, so that one write changes them simultaneously.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputWire {
    /// The signal, exactly one bit of [`Outputs`].
    pub signal: Outputs,
    /// The pin's number in the port of the outputs, 0 to 15.
    pub pin: u8,
    /// The pin's name on the board's connector.
    pub connector: &'static str,
}

/// The pull resistor of a pin, with the values of its PUPDR field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pull {
    /// No pull resistor.
    None = 0b00,
    /// Pull-up. UART lines idle high and recessive CAN is high, so an open receiver input reads as idle.
    Up = 0b01,
    /// Pull-down. An open input reads low.
    Down = 0b10,
}

/// A pin that a peripheral uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinePin {
    /// The pin's port.
    pub port: Port,
    /// The pin's number in its port, 0 to 15.
    pub pin: u8,
    /// The number of the pin's alternate function (the chip's data sheet).
    pub function: u8,
    /// The pull resistor.
    pub pull: Pull,
}

/// Returns the pins of all wires as a mask of their port. Fails at compile time if two wires share a pin.
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

/// Returns the port levels for `outputs`; unused pins are 0.
#[inline]
#[must_use]
pub fn port_from_outputs(wires: &[OutputWire], outputs: Outputs) -> u16 {
    wires.iter().filter(|wire| outputs.contains(wire.signal)).fold(0, |levels, wire| levels | 1 << wire.pin)
}

/// Returns the outputs for the port levels.
#[must_use]
pub fn outputs_from_port(wires: &[OutputWire], levels: u16) -> Outputs {
    wires.iter().filter(|wire| levels & (1 << wire.pin) != 0).map(|wire| wire.signal).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places the wires on every second pin, the first signal on the highest.
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
