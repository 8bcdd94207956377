//! What a board tells the drivers.

use wsg_bridge_fw::io::{Inputs, Outputs};

use crate::gpio::LinePin;
use crate::uart::Uart;
use crate::{Divider, InputWire, OutputWire, Port};

/// A board with an STM32: its pins, clocks and UARTs. One unit type per board implements it.
pub trait Stm32Board {
    /// The input wires, in the order of the bits of [`Inputs`].
    const INPUTS: [InputWire; Inputs::COUNT];
    /// The port of all output wires.
    const OUTPUT_PORT: Port;
    /// The output wires, in the order of the bits of [`Outputs`].
    const OUTPUTS: [OutputWire; Outputs::COUNT];
    /// The port and pin of the LED, lit when high.
    const INDICATOR: (Port, u8);
    /// The pins of the lines and of CAN.
    const LINES: &'static [LinePin];

    /// Clock of the core and, undivided, of all buses and timers, in Hz.
    const HCLK_HZ: u32;

    /// The UART to the gripper.
    type GripperUart: Uart;
    /// The UART of the PLC's bus, in DE mode.
    type BusUart: Uart;
    /// The UART of the service port.
    type ServiceUart: Uart;

    /// How long the driver of the bus is on before and after the bits, in the units of DEAT and DEDT.
    const DRIVER_TIME: u8;

    /// Selects the clock of the bus's UART, which is off, for a rate in bit/s. Returns the divider, or none for a rate that the board
    /// does not support.
    fn select_bus_clock(baud: u32) -> Option<Divider>;

    /// Returns milliseconds since the start.
    fn now_ms() -> u32;

    /// Returns microseconds since the start. Also for interrupt handlers.
    fn now_us() -> u32;
}
