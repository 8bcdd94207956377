//! The STM32 boards on QEMU's machine: where their firmware's lines and wires are, and what must be served in addition.

use std::path::Path;

use object::{Object, ObjectSymbol};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_stm32::{InputWire, OutputWire, Port};

use crate::flash_controller::Layout;

/// A board that runs on QEMU's `b-l475e-iot01a`, whose peripherals its firmware finds at the same addresses.
#[derive(Debug)]
pub struct StmBoard {
    /// Part of the mangled name of the firmware's millisecond counter, by which an image shows its board.
    counter: &'static str,
    pub(super) inputs: &'static [InputWire; Inputs::COUNT],
    /// The port of the output wires.
    pub output_port: Port,
    /// The output wires.
    pub outputs: &'static [OutputWire; Outputs::COUNT],
    /// The lines of gripper, bus and service port, as numbers in QEMU's order: USART1 to USART3, UART4, UART5, LPUART1.
    pub(super) serial: [usize; 3],
    /// Options of QEMU.
    pub options: &'static [&'static str],
    /// FLASH_ACR is served, because QEMU reads it as 0, and the firmware waits for what it wrote.
    pub(super) reads_acr: bool,
    /// Words to store after a reset of the machine.
    pub(super) after_reset: &'static [(u32, u32)],
    /// Base address of the gripper's UART.
    pub gripper_uart: u32,
    /// Base address of the bus' UART.
    pub bus_uart: u32,
    /// The board's status LED.
    pub indicator: (Port, u8),
    /// Its clocks.
    pub clocks: Clocks,
    /// The flash interface and the pages of the settings.
    pub flash: Layout,
}

/// Clocks of a board's core and lines, which its firmware configures.
#[derive(Debug)]
pub struct Clocks {
    /// Frequency of the oscillator that feeds the PLL, in Hz.
    pub oscillator_hz: u32,
    /// Value of PLLSRC for this oscillator.
    pub pll_source: u32,
    /// Frequency of the core and of the buses of the UARTs, in Hz.
    pub core_hz: u32,
    /// The fields of CCIPR for the UARTs of gripper and bus, as a mask, and their values.
    pub selection: (u32, u32),
    /// The dividend of the bus' UART in Hz: BRR is this divided by the rate.
    pub bus_hz: u32,
    /// DEAT and DEDT of the bus' UART.
    pub driver_time: u32,
}

/// The default board.
pub static B_L475E_IOT01A: StmBoard = StmBoard {
    counter: "b_l475e_iot01a7drivers5board4TICK",
    inputs: &wsg_b_l475e_iot01a::INPUTS,
    output_port: wsg_b_l475e_iot01a::OUTPUT_PORT,
    outputs: &wsg_b_l475e_iot01a::OUTPUTS,
    serial: [3, 5, 0],
    options: &[],
    reads_acr: false,
    after_reset: &[],
    gripper_uart: 0x4000_4C00,
    bus_uart: 0x4000_8000,
    indicator: wsg_b_l475e_iot01a::INDICATOR,
    // HSI16 (RM0351, 6.2.2), and the bus on LPUART1, which multiplies its clock by 256 (41.4.5). 16 cycles are 1 us.
    clocks: Clocks {
        oscillator_hz: 16_000_000,
        pll_source: 0b10,
        core_hz: 80_000_000,
        selection: (0b11 << 6 | 0b11 << 10, 0b10 << 10),
        bus_hz: 256 * 16_000_000,
        driver_time: 16,
    },
    flash: Layout::STM32L475,
};

/// The board with an STM32G474, which has the STM32L475's memory map for all that its firmware uses.
pub static NUCLEO_G474RE: StmBoard = StmBoard {
    counter: "nucleo_g474re7drivers5board4TICK",
    inputs: &wsg_nucleo_g474re::INPUTS,
    output_port: wsg_nucleo_g474re::OUTPUT_PORT,
    outputs: &wsg_nucleo_g474re::OUTPUTS,
    serial: [0, 2, 1],
    // The board's crystal. QEMU's has twice this frequency.
    options: &["-global", "stm32l4x5-rcc.hse_frequency=24000000"],
    reads_acr: true,
    // PLLCFGR: HSI16 is the source. While HSE is the source, QEMU never reports it ready again.
    after_reset: &[(0x4002_100C, 0x1002)],
    gripper_uart: 0x4001_3800,
    bus_uart: 0x4000_4800,
    indicator: wsg_nucleo_g474re::INDICATOR,
    // The crystal, and the bus on USART3. The driver time is half a bit, in sixteenths.
    clocks: Clocks {
        oscillator_hz: 24_000_000,
        pll_source: 0b11,
        core_hz: 144_000_000,
        selection: (0b11 | 0b11 << 4, 0),
        bus_hz: 144_000_000,
        driver_time: 8,
    },
    flash: Layout::STM32G474,
};

impl StmBoard {
    /// Returns the divider of the bus' UART for a rate in bit/s. Of an LPUART's, QEMU keeps the lowest 16 bits.
    #[must_use]
    pub fn bus_divider(&self, rate: u32) -> u32 {
        ((self.clocks.bus_hz + rate / 2) / rate) & 0xFFFF
    }

    /// Returns the board of an image, and the address of its millisecond counter. An image without symbols is taken for one of
    /// the default board.
    pub(super) fn of(elf: &Path) -> (&'static Self, Option<u32>) {
        let found = || {
            let image = std::fs::read(elf).ok()?;
            let image = object::File::parse(&*image).ok()?;
            [&B_L475E_IOT01A, &NUCLEO_G474RE].into_iter().find_map(|board| {
                let is_counter = |name: &str| name.contains(board.counter);
                let counter = image.symbols().find(|symbol| symbol.name().is_ok_and(is_counter))?;
                Some((board, Some(u32::try_from(counter.address()).ok()?)))
            })
        };
        found().unwrap_or((&B_L475E_IOT01A, None))
    }
}
