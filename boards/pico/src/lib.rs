//! The pins of the PLC's wires on the Raspberry Pi Pico (RP2040; data sheet of the Pico, figure 2).
//!
//! The firmware, the test harness, which plays the PLC in the emulator, and the documents use these tables.

#![no_std]
#![forbid(unsafe_code)]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use wsg_bridge_fw::io::{Inputs, Outputs};

/// The board's name in reports.
pub const NAME: &str = "Raspberry Pi Pico";

/// A wire from the PLC and its input pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputWire {
    /// The signal, exactly one bit of [`Inputs`].
    pub signal: Inputs,
    /// The number of the GPIO, as in `GP7`.
    pub gpio: u8,
    /// The pin's number on the board's edge, 1 to 40.
    pub pin: u8,
}

/// A wire to the PLC and its output pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputWire {
    /// The signal, exactly one bit of [`Outputs`].
    pub signal: Outputs,
    /// The number of the GPIO, as in `GP2`.
    pub gpio: u8,
    /// The pin's number on the board's edge, 1 to 40.
    pub pin: u8,
}

/// The input wires, in the order of the bits of [`Inputs`].
pub const INPUTS: [InputWire; Inputs::COUNT] = [
    InputWire { signal: Inputs::GRIP, gpio: 7, pin: 10 },
    InputWire { signal: Inputs::RELEASE, gpio: 8, pin: 11 },
    InputWire { signal: Inputs::MOVE, gpio: 9, pin: 12 },
    InputWire { signal: Inputs::HOME, gpio: 10, pin: 14 },
    InputWire { signal: Inputs::STOP_ACK, gpio: 11, pin: 15 },
    InputWire { signal: Inputs::FAST_STOP_OK, gpio: 12, pin: 16 },
    InputWire { signal: Inputs::RECIPE0, gpio: 13, pin: 17 },
    InputWire { signal: Inputs::RECIPE1, gpio: 14, pin: 19 },
];

/// The output wires, in the order of the bits of [`Outputs`].
pub const OUTPUTS: [OutputWire; Outputs::COUNT] = [
    OutputWire { signal: Outputs::READY, gpio: 2, pin: 4 },
    OutputWire { signal: Outputs::BUSY, gpio: 3, pin: 5 },
    OutputWire { signal: Outputs::HOLDING, gpio: 15, pin: 20 },
    OutputWire { signal: Outputs::PART_FAULT, gpio: 21, pin: 27 },
    OutputWire { signal: Outputs::ERROR, gpio: 22, pin: 29 },
    OutputWire { signal: Outputs::REFERENCED, gpio: 26, pin: 31 },
    OutputWire { signal: Outputs::LINK_OK, gpio: 27, pin: 32 },
];

/// The pins of lines and buses: the pin on the board, the MCU's pin and its function, the connected part, and the part's pin.
pub const LINE_PINS: [[&str; 4]; 11] = [
    ["1", "GP0, UART0 TX", "RS-232 transceiver", "driver input"],
    ["2", "GP1, UART0 RX", "RS-232 transceiver", "receiver output"],
    ["6", "GP4, UART1 TX", "RS-485 transceiver", "driver input (DI)"],
    ["7", "GP5, UART1 RX", "RS-485 transceiver", "receiver output (RO)"],
    ["9", "GP6", "RS-485 transceiver", "driver enable (DE)"],
    ["21", "GP16, SPI0 RX", "MCP2515", "SO"],
    ["22", "GP17", "MCP2515", "CS"],
    ["24", "GP18, SPI0 SCK", "MCP2515", "SCK"],
    ["25", "GP19, SPI0 TX", "MCP2515", "SI"],
    ["26", "GP20", "MCP2515", "INT"],
    ["USB", "USB device", "computer", "CDC ACM"],
];

/// The GPIO of the LED on the board, lit when high. It shows the bridge's
/// [`Indication`](wsg_bridge_fw::indicator::Indication).
pub const INDICATOR: u8 = 25;

/// The GPIO that enables the driver of the bus's transceiver while it is high.
pub const BUS_DRIVER_ENABLE: u8 = 6;

/// Returns the outputs for the levels of all GPIOs; bit 0 is GP0.
#[must_use]
pub fn outputs_from_gpios(levels: u32) -> Outputs {
    OUTPUTS.iter().filter(|wire| levels & (1 << wire.gpio) != 0).map(|wire| wire.signal).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a GPIO's pin on the board's edge. A ground pin follows GP1 and then every fourth GPIO.
    fn pin_of(gpio: u8) -> u8 {
        match gpio {
            0..=1 => gpio + 1,
            2..=5 => gpio + 2,
            6..=9 => gpio + 3,
            10..=13 => gpio + 4,
            14..=17 => gpio + 5,
            18..=21 => gpio + 6,
            22 => 29,
            26..=27 => gpio + 5,
            28 => 34,
            _ => panic!("GP{gpio} is not on the edge"),
        }
    }

    #[test]
    fn tables_follow_the_order_of_the_bits() {
        assert!(INPUTS.iter().map(|wire| wire.signal).eq(Inputs::all().iter()));
        assert!(OUTPUTS.iter().map(|wire| wire.signal).eq(Outputs::all().iter()));
    }

    #[test]
    fn no_pin_is_used_twice_and_each_is_where_the_board_has_it() {
        // Pins with fixed functions: both lines, the bus's driver and the MCP2515.
        let mut used = 0b111_0011 | 0b1_1111u32 << 16;
        assert_ne!(used & 1 << BUS_DRIVER_ENABLE, 0);
        let wires = INPUTS.iter().map(|wire| (wire.gpio, wire.pin));
        for (gpio, pin) in wires.chain(OUTPUTS.iter().map(|wire| (wire.gpio, wire.pin))) {
            assert_eq!(used & 1 << gpio, 0, "GP{gpio}");
            used |= 1 << gpio;
            assert_eq!(pin, pin_of(gpio));
        }
        assert_eq!(used & 1 << INDICATOR, 0);
    }

    #[test]
    fn each_output_is_seen_at_its_gpio() {
        for wire in OUTPUTS {
            assert_eq!(outputs_from_gpios(1 << wire.gpio), wire.signal);
            assert_eq!(outputs_from_gpios(!(1 << wire.gpio)), !wire.signal);
        }
    }
}
