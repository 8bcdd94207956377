//! CAN: an MCP2515 with a 16 MHz crystal on SPI0 (RP2040, 4.4), GP16 to GP19, and its INT on GP20.
//!
//! The interrupt handler reads received frames; the main loop does everything else. Both use SPI0: the handler is masked
//! during a transaction of the main loop.

use bus_slcan::ClassicFrame;
use cortex_m::peripheral::NVIC;
use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::can::{CanConfig, Mcp2515, Mcp2515Buffers};

use crate::clock::SYS_HZ;
use crate::registers::{peripheral, reset, reset_bit, write};

pub(crate) type Can = Mcp2515<MainLoopSpi, ClassicFrame>;

pub(crate) static BUFFERS: Mcp2515Buffers = Mcp2515Buffers::new();

/// The MCP2515's crystal.
const CRYSTAL_HZ: u32 = 16_000_000;

/// The maximum SPI clock of the MCP2515, and the dividers for the actual one.
const SPI_MAX_HZ: u32 = 10_000_000;
const PRESCALER: u32 = 2;
const DIVIDER: u32 = 7;
const _: () = assert!(SYS_HZ / PRESCALER / DIVIDER <= SPI_MAX_HZ);

/// SSPCR0: 8-bit frames, mode 0. SSPCR1: enable.
const EIGHT_BITS: u32 = 7;
const SSE: u32 = 1 << 1;
/// SSPSR: receive FIFO not empty.
const RNE: u32 = 1 << 2;

/// Capacity of the receive FIFO in frames.
const FIFO_LEN: u32 = 8;

/// Maximum number of status reads for a byte, which takes 112 clock cycles; a read takes at least 4.
const MAX_LOOKS: u32 = 1_000;

/// Pins that this module controls by the registers of SIO and IO_BANK0.
const CHIP_SELECT: u32 = 1 << 17;
const INT: u32 = 20;
/// The four bits of a pin in PROC0_INTE; the first is the low level.
const INT_LOW: u32 = 1 << (4 * (INT % 8));
const INT_WORD: usize = (INT / 8) as usize;

/// The handler's priority is the lowest, because it takes 26 µs per frame. It never delays a UART.
const PRIORITY: u8 = 0xC0;

/// Maximum number of SPI bytes before a received frame is read: the main loop's longest transaction, which loads a frame, then
/// the handler's status query and read.
const BYTES_BEFORE_TAKEN: u32 = 14 + 2 + 14;
/// Cycles per byte: twice the SPI time, to cover the instructions in between.
const BYTE_CYCLES: u32 = 2 * 8 * PRESCALER * DIVIDER;
/// The shortest frame, without data and stuff bits, at 1 Mbit/s. Two full buffers overflow at the end of a third frame.
const SHORTEST_FRAME_US: u32 = 47;
const _: () = assert!(BYTES_BEFORE_TAKEN * BYTE_CYCLES < 2 * SHORTEST_FRAME_US * (SYS_HZ / 1_000_000));

/// Returns the controller, not started. Call it once.
pub(crate) const fn controller() -> Can {
    Mcp2515::new(MainLoopSpi(()), CRYSTAL_HZ, &BUFFERS)
}

/// Starts the controller. The clock must run and the pins must be set up.
pub(crate) fn start(controller: &mut Can, config: &CanConfig, nvic: &mut NVIC) {
    // If it stays in reset, every exchange fails, like with a missing controller.
    let _ = reset(reset_bit::SPI0);
    let spi = peripheral!(SPI0);
    write(spi.sspcpsr(), PRESCALER);
    write(spi.sspcr0(), (DIVIDER - 1) << 8 | EIGHT_BITS);
    write(spi.sspcr1(), SSE);
    controller.start(config);
    write(peripheral!(IO_BANK0).proc0_inte(INT_WORD), INT_LOW);
    // SAFETY: the interrupt is still masked, and no critical section depends on priorities.
    unsafe { nvic.set_priority(INTERRUPT, PRIORITY) };
    rearm();
}

/// Unmasks the handler, which may mask itself. Call it after each iteration of the main loop.
pub(crate) fn rearm() {
    // SAFETY: only the main loop's transactions depend on the mask, and none is running. The handler shares only atomics.
    unsafe { NVIC::unmask(INTERRUPT) };
}

const INTERRUPT: Interrupt = Interrupt::IO_IRQ_BANK0;

#[interrupt]
fn IO_IRQ_BANK0() {
    if !BUFFERS.serve(&mut Spi(())) {
        NVIC::mask(INTERRUPT);
    }
}

/// SPI0 for the main loop, with the handler masked during a transaction.
#[derive(Debug)]
pub(crate) struct MainLoopSpi(());

impl ErrorType for MainLoopSpi {
    type Error = Stuck;
}

impl SpiDevice for MainLoopSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Stuck> {
        let was_unmasked = NVIC::is_enabled(INTERRUPT);
        NVIC::mask(INTERRUPT);
        // The handler cannot start after these barriers (ARMv6-M, B3.4.3).
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        let result = Spi(()).transaction(operations);
        if was_unmasked {
            rearm();
        }
        result
    }
}

/// SPI0 and the chip select, for the handler or the main loop.
#[derive(Debug)]
pub(crate) struct Spi(());

/// A byte was not received in time.
#[derive(Debug)]
pub(crate) struct Stuck;

impl Error for Stuck {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for Spi {
    type Error = Stuck;
}

impl SpiDevice for Spi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Stuck> {
        // Discard bytes received after a time-out.
        let spi = peripheral!(SPI0);
        for _ in 0..FIFO_LEN {
            if spi.sspsr().read().bits() & RNE != 0 {
                let _ = spi.sspdr().read();
            }
        }
        write(peripheral!(SIO).gpio_out_clr(), CHIP_SELECT);
        let result = operations.iter_mut().try_for_each(run);
        write(peripheral!(SIO).gpio_out_set(), CHIP_SELECT);
        // The chip select must be high for 50 ns; the next transaction starts later than these six cycles.
        result
    }
}

fn run(operation: &mut Operation<'_, u8>) -> Result<(), Stuck> {
    match operation {
        Operation::Write(bytes) => bytes.iter().try_for_each(|byte| exchange(*byte).map(drop)),
        Operation::Read(bytes) => bytes.iter_mut().try_for_each(|place| {
            *place = exchange(0)?;
            Ok(())
        }),
        Operation::TransferInPlace(bytes) => bytes.iter_mut().try_for_each(|place| {
            *place = exchange(*place)?;
            Ok(())
        }),
        Operation::Transfer(read, written) => {
            // If one buffer is longer, its rest is filled with zeros or dropped.
            let mut written = written.iter().copied();
            for place in read.iter_mut() {
                *place = exchange(written.next().unwrap_or(0))?;
            }
            written.try_for_each(|byte| exchange(byte).map(drop))
        }
        Operation::DelayNs(ns) => {
            cortex_m::asm::delay(ns.div_ceil(1_000_000_000 / SYS_HZ));
            Ok(())
        }
    }
}

fn exchange(byte: u8) -> Result<u8, Stuck> {
    let spi = peripheral!(SPI0);
    write(spi.sspdr(), byte.into());
    if (0..MAX_LOOKS).any(|_| spi.sspsr().read().bits() & RNE != 0) {
        Ok((spi.sspdr().read().bits() & 0xFF) as u8)
    } else {
        Err(Stuck)
    }
}
