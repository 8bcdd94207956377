//! The description of an STM32 board that the drivers need.

use cortex_m::peripheral::SYST;
use wsg_bridge_fw::NoClock;
use wsg_bridge_fw::can::{CanConfig, CanController};
use wsg_bridge_fw::io::{Inputs, Outputs};

use crate::uart::Uart;
use crate::{Divider, InputWire, LinePin, OutputWire, Port};

/// A board with an STM32: its pins, clocks, UARTs and CAN. Each board implements it for one type without values.
pub trait Stm32Board: Sized {
    /// The board's name in reports.
    const NAME: &'static str;
    /// The board's name in the workspace, whose images alone its boot loader accepts.
    const ID: &'static str;

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
    /// The controller on the CAN bus of gripper or PLC.
    type Can: CanController;

    /// Driver enable time of the bus before and after the bits, in units of DEAT and DEDT.
    const DRIVER_TIME: u8;

    /// Switches from the reset clock to [`HCLK_HZ`](Self::HCLK_HZ).
    ///
    /// # Errors
    /// [`NoClock`], after a bounded wait.
    fn start_clock() -> Result<(), NoClock>;

    /// Selects the clock of the bus's UART, which must be disabled, for a rate in bit/s. Returns the divider, or `None` for an
    /// unsupported rate.
    fn select_bus_clock(baud: u32) -> Option<Divider>;

    /// Starts the millisecond and microsecond counters.
    fn start_time(systick: &mut SYST);

    /// Returns milliseconds since [`start_time`](Self::start_time).
    fn now_ms() -> u32;

    /// Returns microseconds since [`start_time`](Self::start_time). Also for interrupt handlers.
    fn now_us() -> u32;

    /// Starts the CAN controller.
    fn start_can(can: &mut Self::Can, config: &CanConfig);

    /// Unmasks the CAN controller's interrupts if their handlers mask them.
    fn rearm_can(_can: &mut Self::Can) {}

    /// Returns whether the CAN controller has received a frame. Call it only after the start of the controller.
    fn can_has_received() -> bool;
}
