//! The board for the shared drivers: USART1 to the gripper, USART3 to the PLC's bus, and USART2 to the ST-LINK, which bridges
//! the service port to USB.

use cortex_m::peripheral::SYST;
use wsg_bridge_fw::NoClock;
use wsg_bridge_fw::can::CanConfig;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_stm32::board::Stm32Board;
use wsg_stm32::pac::interrupt;
use wsg_stm32::tick::SysTick;
use wsg_stm32::uart::{Usart1, Usart2, Usart3};
use wsg_stm32::{Divider, InputWire, LinePin, OutputWire, Port, Pull, gripper_line};

use super::can::{self, Can};
use super::clock::{self, HCLK_HZ};
use crate::{INDICATOR, INPUTS, NAME, OUTPUT_PORT, OUTPUTS};

/// Alternate functions of the USARTs and of FDCAN1 (data sheet DS12288).
const AF_USART: u8 = 7;
const AF_FDCAN1: u8 = 9;

/// The clock of the board, counted by SysTick.
pub static TICK: SysTick<{ HCLK_HZ / 1_000 }> = SysTick::new();

/// The board NUCLEO-G474RE.
pub enum Nucleo {}

impl Stm32Board for Nucleo {
    const NAME: &'static str = NAME;
    const ID: &'static str = "nucleo-g474re";

    const INPUTS: [InputWire; Inputs::COUNT] = INPUTS;
    const OUTPUT_PORT: Port = OUTPUT_PORT;
    const OUTPUTS: [OutputWire; Outputs::COUNT] = OUTPUTS;
    const INDICATOR: (Port, u8) = INDICATOR;
    const LINES: &'static [LinePin] = &[
        // USART1: transmitter, receiver.
        LinePin { port: Port::C, pin: 4, function: AF_USART, pull: Pull::None },
        LinePin { port: Port::C, pin: 5, function: AF_USART, pull: Pull::Up },
        // USART3: transmitter, receiver, driver enable with a pull-down that keeps the driver off during reset.
        LinePin { port: Port::B, pin: 10, function: AF_USART, pull: Pull::Up },
        LinePin { port: Port::B, pin: 11, function: AF_USART, pull: Pull::Up },
        LinePin { port: Port::B, pin: 14, function: AF_USART, pull: Pull::Down },
        // USART2: transmitter, receiver.
        LinePin { port: Port::A, pin: 2, function: AF_USART, pull: Pull::Up },
        LinePin { port: Port::A, pin: 3, function: AF_USART, pull: Pull::Up },
        // FDCAN1: receiver, transmitter.
        LinePin { port: Port::A, pin: 11, function: AF_FDCAN1, pull: Pull::Up },
        LinePin { port: Port::A, pin: 12, function: AF_FDCAN1, pull: Pull::Up },
    ];

    const HCLK_HZ: u32 = HCLK_HZ;

    type GripperUart = Usart1;
    type BusUart = Usart3;
    type ServiceUart = Usart2;
    type Can = Can;

    /// Half a bit, in sixteenths.
    const DRIVER_TIME: u8 = 8;

    fn start_clock() -> Result<(), NoClock> {
        clock::start()
    }

    fn select_bus_clock(baud: u32) -> Option<Divider> {
        Divider::for_rate(HCLK_HZ, baud)
    }

    fn start_time(systick: &mut SYST) {
        TICK.start(systick);
    }

    fn now_ms() -> u32 {
        TICK.now_ms()
    }

    fn now_us() -> u32 {
        TICK.now_us()
    }

    fn start_can(can: &mut Can, config: &CanConfig) {
        can.start(config);
    }

    fn can_has_received() -> bool {
        can::has_received()
    }
}

#[interrupt]
fn USART1() {
    gripper_line::on_interrupt::<Nucleo>();
}
