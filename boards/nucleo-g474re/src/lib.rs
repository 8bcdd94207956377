//! The pins of the PLC's wires on the board NUCLEO-G474RE (STM32G474RE; ST UM2505, connectors CN7 and CN10).
//!
//! The firmware and the documents use these tables.
//!
//! Unused on purpose: the debug port on PA13 to PA15, PB3 and PB4; PB4 and PB6, which the USB-C dead battery logic pulls down
//! after a reset; PB8 (BOOT0); PC13 (button); PC14 and PC15 (32 kHz crystal).

#![no_std]
#![deny(unsafe_code)]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic))]

#[cfg(feature = "drivers")]
pub mod drivers;
pub mod message_ram;

use wsg_bridge_fw::io::{Inputs, Outputs};
pub use wsg_stm32::Port;
use wsg_stm32::{InputWire, OutputWire};

/// The board's name in reports.
pub const NAME: &str = "NUCLEO-G474RE";

/// The input wires, in the order of the bits of [`Inputs`].
pub const INPUTS: [InputWire; Inputs::COUNT] = [
    InputWire { signal: Inputs::GRIP, port: Port::A, pin: 0, connector: "CN7-28" },
    InputWire { signal: Inputs::RELEASE, port: Port::A, pin: 1, connector: "CN7-30" },
    InputWire { signal: Inputs::MOVE, port: Port::A, pin: 4, connector: "CN7-32" },
    InputWire { signal: Inputs::HOME, port: Port::B, pin: 0, connector: "CN7-34" },
    InputWire { signal: Inputs::STOP_ACK, port: Port::C, pin: 1, connector: "CN7-36" },
    InputWire { signal: Inputs::FAST_STOP_OK, port: Port::C, pin: 0, connector: "CN7-38" },
    InputWire { signal: Inputs::RECIPE0, port: Port::C, pin: 2, connector: "CN7-35" },
    InputWire { signal: Inputs::RECIPE1, port: Port::C, pin: 3, connector: "CN7-37" },
];

/// The port of all outputs, so that one write changes them simultaneously.
pub const OUTPUT_PORT: Port = Port::C;

/// The output wires, in the order of the bits of [`Outputs`].
pub const OUTPUTS: [OutputWire; Outputs::COUNT] = [
    OutputWire { signal: Outputs::READY, pin: 6, connector: "CN10-4" },
    OutputWire { signal: Outputs::BUSY, pin: 7, connector: "CN10-19" },
    OutputWire { signal: Outputs::HOLDING, pin: 8, connector: "CN10-2" },
    OutputWire { signal: Outputs::PART_FAULT, pin: 9, connector: "CN10-1" },
    OutputWire { signal: Outputs::ERROR, pin: 10, connector: "CN7-1" },
    OutputWire { signal: Outputs::REFERENCED, pin: 11, connector: "CN7-2" },
    OutputWire { signal: Outputs::LINK_OK, pin: 12, connector: "CN7-3" },
];

/// The pins of lines and buses: the pin on the board, the MCU's pin and its function, the connected part, and the part's pin.
pub const LINE_PINS: [[&str; 4]; 9] = [
    ["CN10-34", "PC4, USART1 TX", "RS-232 transceiver", "driver input"],
    ["CN10-6", "PC5, USART1 RX", "RS-232 transceiver", "receiver output"],
    ["CN10-25", "PB10, USART3 TX", "RS-485 transceiver", "driver input (DI)"],
    ["CN10-18", "PB11, USART3 RX", "RS-485 transceiver", "receiver output (RO)"],
    ["CN10-28", "PB14, USART3 DE", "RS-485 transceiver", "driver enable (DE)"],
    ["CN10-12", "PA12, FDCAN1 TX", "CAN transceiver", "driver input (TXD)"],
    ["CN10-14", "PA11, FDCAN1 RX", "CAN transceiver", "receiver output (RXD)"],
    ["USB", "PA2, USART2 TX", "computer", "via the ST-Link"],
    ["USB", "PA3, USART2 RX", "computer", "via the ST-Link"],
];

/// The port and pin of the board's green LD2, lit when high. It shows the bridge's
/// [`Indication`](wsg_bridge_fw::indicator::Indication).
pub const INDICATOR: (Port, u8) = (Port::A, 5);

#[cfg(test)]
mod tests {
    use super::*;

    /// The MCU's pins on the Morpho connectors, by connector pin (UM2505).
    const CN7: [(u8, char, u8); 21] = [
        (1, 'C', 10),
        (2, 'C', 11),
        (3, 'C', 12),
        (4, 'D', 2),
        (13, 'A', 13),
        (15, 'A', 14),
        (17, 'A', 15),
        (21, 'B', 7),
        (23, 'C', 13),
        (25, 'C', 14),
        (27, 'C', 15),
        (28, 'A', 0),
        (29, 'F', 0),
        (30, 'A', 1),
        (31, 'F', 1),
        (32, 'A', 4),
        (34, 'B', 0),
        (35, 'C', 2),
        (36, 'C', 1),
        (37, 'C', 3),
        (38, 'C', 0),
    ];
    const CN10: [(u8, char, u8); 8] = [
        (1, 'C', 9),
        (2, 'C', 8),
        (3, 'B', 8),
        (4, 'C', 6),
        (5, 'B', 9),
        (6, 'C', 5),
        (11, 'A', 5),
        (19, 'C', 7),
    ];

    fn is_there(connector: &str, port: Port, pin: u8) -> bool {
        let (connector, number) = connector.split_once('-').unwrap();
        let pins: &[_] = match connector {
            "CN7" => &CN7,
            "CN10" => &CN10,
            _ => panic!("unknown connector {connector}"),
        };
        pins.contains(&(number.parse().unwrap(), port.letter(), pin))
    }

    #[test]
    fn tables_follow_the_order_of_the_bits() {
        assert!(INPUTS.iter().map(|wire| wire.signal).eq(Inputs::all().iter()));
        assert!(OUTPUTS.iter().map(|wire| wire.signal).eq(Outputs::all().iter()));
    }

    #[test]
    fn each_pin_is_where_the_board_has_it() {
        for wire in INPUTS {
            assert!(is_there(wire.connector, wire.port, wire.pin), "{wire:?}");
        }
        for wire in OUTPUTS {
            assert!(is_there(wire.connector, OUTPUT_PORT, wire.pin), "{wire:?}");
        }
    }

    #[test]
    fn no_pin_is_used_twice() {
        // Pins with fixed functions: lines, CAN, debug port, BOOT0, button, crystals, and USB-C's pull-downs.
        let mut used = [
            1 << 2 | 1 << 3 | 0b1_1111 << 11,
            1 << 3 | 1 << 4 | 1 << 6 | 1 << 8 | 1 << 10 | 1 << 11 | 1 << 14,
            1 << 4 | 1 << 5 | 0b111u16 << 13,
        ];
        let wires = INPUTS.iter().map(|wire| (wire.port, wire.pin));
        let wires = wires.chain(OUTPUTS.iter().map(|wire| (OUTPUT_PORT, wire.pin)));
        for (port, pin) in wires.chain([INDICATOR]) {
            let taken = &mut used[port as usize];
            assert_eq!(*taken & 1 << pin, 0, "P{}{pin}", port.letter());
            *taken |= 1 << pin;
        }
    }
}
