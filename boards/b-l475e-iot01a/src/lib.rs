//! The pins of the PLC's wires on the board B-L475E-IOT01A (ST UM2153, Arduino connectors CN1 to CN4).
//!
//! The firmware, the test harness, which plays the PLC in the emulator, and the documents use these tables.

#![no_std]
#![deny(unsafe_code)]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod bus_clock;
#[cfg(feature = "drivers")]
pub mod drivers;
pub mod transmit_status;

pub use bus_clock::BusClock;

use wsg_bridge_fw::io::{Inputs, Outputs};
pub use wsg_stm32::Port;
use wsg_stm32::{InputWire, OutputWire};

/// The board's name in reports.
pub const NAME: &str = "B-L475E-IOT01A";

/// The input wires, in the order of the bits of [`Inputs`].
pub const INPUTS: [InputWire; Inputs::COUNT] = [
    InputWire { signal: Inputs::GRIP, port: Port::C, pin: 5, connector: "A0" },
    InputWire { signal: Inputs::RELEASE, port: Port::C, pin: 4, connector: "A1" },
    InputWire { signal: Inputs::MOVE, port: Port::C, pin: 3, connector: "A2" },
    InputWire { signal: Inputs::HOME, port: Port::C, pin: 2, connector: "A3" },
    InputWire { signal: Inputs::STOP_ACK, port: Port::D, pin: 14, connector: "D2" },
    InputWire { signal: Inputs::FAST_STOP_OK, port: Port::B, pin: 0, connector: "D3" },
    InputWire { signal: Inputs::RECIPE0, port: Port::B, pin: 4, connector: "D5" },
    InputWire { signal: Inputs::RECIPE1, port: Port::B, pin: 2, connector: "D8" },
];

/// The port of all outputs, so that one write changes them simultaneously.
pub const OUTPUT_PORT: Port = Port::A;

/// The output wires, in the order of the bits of [`Outputs`].
pub const OUTPUTS: [OutputWire; Outputs::COUNT] = [
    OutputWire { signal: Outputs::READY, pin: 2, connector: "D10" },
    OutputWire { signal: Outputs::BUSY, pin: 3, connector: "D4" },
    OutputWire { signal: Outputs::HOLDING, pin: 4, connector: "D7" },
    OutputWire { signal: Outputs::PART_FAULT, pin: 6, connector: "D12" },
    OutputWire { signal: Outputs::ERROR, pin: 7, connector: "D11" },
    // JTDI until the firmware reconfigures it, with an internal pull-up of at least 25 kΩ. The wire needs a stronger external
    // pull-down, otherwise it is high during reset.
    OutputWire { signal: Outputs::REFERENCED, pin: 15, connector: "D9" },
    // Also drives the board's green LED1.
    OutputWire { signal: Outputs::LINK_OK, pin: 5, connector: "D13" },
];

/// The pins of lines and buses: the pin on the board, the MCU's pin and its function, the connected part, and the part's pin.
pub const LINE_PINS: [[&str; 4]; 9] = [
    ["D1", "PA0, UART4 TX", "RS-232 transceiver", "driver input"],
    ["D0", "PA1, UART4 RX", "RS-232 transceiver", "receiver output"],
    ["A4", "PC1, LPUART1 TX", "RS-485 transceiver", "driver input (DI)"],
    ["A5", "PC0, LPUART1 RX", "RS-485 transceiver", "receiver output (RO)"],
    ["D6", "PB1, LPUART1 DE", "RS-485 transceiver", "driver enable (DE)"],
    ["D14", "PB9, CAN1 TX", "CAN transceiver", "driver input (TXD)"],
    ["D15", "PB8, CAN1 RX", "CAN transceiver", "receiver output (RXD)"],
    ["USB", "PB6, USART1 TX", "computer", "via the ST-Link"],
    ["USB", "PB7, USART1 RX", "computer", "via the ST-Link"],
];

/// The port and pin of the board's green LED2, lit when high. It shows the bridge's
/// [`Indication`](wsg_bridge_fw::indicator::Indication).
pub const INDICATOR: (Port, u8) = (Port::B, 14);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_follow_the_order_of_the_bits() {
        assert!(INPUTS.iter().map(|wire| wire.signal).eq(Inputs::all().iter()));
        assert!(OUTPUTS.iter().map(|wire| wire.signal).eq(Outputs::all().iter()));
    }

    #[test]
    fn no_pin_is_used_twice() {
        assert_ne!(INDICATOR.0, OUTPUT_PORT);
        for (n, wire) in INPUTS.iter().enumerate() {
            assert_ne!((wire.port, wire.pin), INDICATOR);
            assert!(INPUTS.iter().skip(n + 1).all(|other| (wire.port, wire.pin) != (other.port, other.pin)));
            assert!(wire.port != OUTPUT_PORT || wsg_stm32::output_pins(&OUTPUTS) & (1 << wire.pin) == 0);
        }
    }
}
