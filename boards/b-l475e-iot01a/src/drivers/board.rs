//! The board for the shared drivers: UART4 to the gripper, LPUART1 to the PLC's bus, and USART1 to the ST-Link, which bridges
//! the service port to USB.

use cortex_m::peripheral::SYST;
use wsg_bridge_fw::NoClock;
use wsg_bridge_fw::can::CanConfig;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_stm32::board::Stm32Board;
use wsg_stm32::pac::rcc::vals::Lpuart1sel;
use wsg_stm32::pac::{PWR, RCC, interrupt};
use wsg_stm32::tick::SysTick;
use wsg_stm32::uart::{Lpuart1, Uart4, Usart1};
use wsg_stm32::{Divider, InputWire, LinePin, OutputWire, Port, Pull, gripper_line};

use super::can1::{self, Can1};
use super::clock::{self, HCLK_HZ};
use crate::{BusClock, INDICATOR, INPUTS, NAME, OUTPUT_PORT, OUTPUTS};

/// Alternate functions of the pins (data sheet of the STM32L475).
const AF_USART1: u8 = 7;
const AF_UART4: u8 = 8;
const AF_LPUART1: u8 = 8;
const AF_CAN1: u8 = 9;

/// The clock of the board, counted by SysTick.
pub static TICK: SysTick<{ HCLK_HZ / 1_000 }> = SysTick::new();

/// The board B-L475E-IOT01A.
pub enum Iot01a {}

impl Stm32Board for Iot01a {
    const NAME: &'static str = NAME;
    const ID: &'static str = "b-l475e-iot01a";

    const INPUTS: [InputWire; Inputs::COUNT] = INPUTS;
    const OUTPUT_PORT: Port = OUTPUT_PORT;
    const OUTPUTS: [OutputWire; Outputs::COUNT] = OUTPUTS;
    const INDICATOR: (Port, u8) = INDICATOR;
    const LINES: &'static [LinePin] = &[
        // UART4: transmitter, receiver.
        LinePin { port: Port::A, pin: 0, function: AF_UART4, pull: Pull::None },
        LinePin { port: Port::A, pin: 1, function: AF_UART4, pull: Pull::Up },
        // LPUART1: transmitter, receiver, driver enable with a pull-down that keeps the driver off during reset.
        LinePin { port: Port::C, pin: 1, function: AF_LPUART1, pull: Pull::Up },
        LinePin { port: Port::C, pin: 0, function: AF_LPUART1, pull: Pull::Up },
        LinePin { port: Port::B, pin: 1, function: AF_LPUART1, pull: Pull::Down },
        // USART1: transmitter, receiver.
        LinePin { port: Port::B, pin: 6, function: AF_USART1, pull: Pull::Up },
        LinePin { port: Port::B, pin: 7, function: AF_USART1, pull: Pull::Up },
        // CAN1: receiver, transmitter.
        LinePin { port: Port::B, pin: 8, function: AF_CAN1, pull: Pull::Up },
        LinePin { port: Port::B, pin: 9, function: AF_CAN1, pull: Pull::Up },
    ];

    const HCLK_HZ: u32 = HCLK_HZ;

    type GripperUart = Uart4;
    type BusUart = Lpuart1;
    type ServiceUart = Usart1;
    type Can = Can1;

    /// In cycles of LPUART1's clock: 1 µs of HSI16, a third of a bit at 1.5 Mbit/s.
    const DRIVER_TIME: u8 = 16;

    fn start_clock() -> Result<(), NoClock> {
        clock::start()
    }

    fn select_bus_clock(baud: u32) -> Option<Divider> {
        let (clock, brr) = BusClock::for_rate(baud)?;
        let select = match clock {
            BusClock::Lse => {
                start_lse();
                Lpuart1sel::LSE
            }
            // HSI16 already runs for the PLL.
            BusClock::Hsi16 => Lpuart1sel::HSI,
            BusClock::Pclk1 => Lpuart1sel::PCLK1,
        };
        RCC.ccipr().modify(|w| w.set_lpuart1sel(select));
        Some(Divider { is_halved: false, brr })
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

    fn start_can(can: &mut Can1, config: &CanConfig) {
        can.start(config);
    }

    fn rearm_can(can: &mut Can1) {
        can.rearm();
    }

    fn can_has_received() -> bool {
        can1::has_received()
    }
}

/// Switches the 32.768 kHz crystal on without waiting. It takes up to 2 s to start; the bus does not respond until then.
fn start_lse() {
    RCC.apb1enr1().modify(|w| w.set_pwren(true));
    let _ = RCC.apb1enr1().read();
    // The register is in the backup domain, which is write-protected after a reset.
    PWR.cr1().modify(|w| w.set_dbp(true));
    // The protection is lifted within a few cycles. An emulator without PWR never reports it.
    let _ = (0..16).any(|_| PWR.cr1().read().dbp());
    RCC.bdcr().modify(|w| w.set_lseon(true));
}

#[interrupt]
fn UART4() {
    gripper_line::on_interrupt::<Iot01a>();
}
