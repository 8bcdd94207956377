//! CAN: an MCP2515 with a crystal of 16 MHz on SPI0 (RP2040, 4.4), GP16 to GP19, and its INT on GP20.
//!
//! The handler of its interrupt takes what it receives; all else is done in the main loop. Both use SPI0: the handler waits until the
//! main loop's transaction is over.

use bus_slcan::ClassicFrame;
use cortex_m::peripheral::NVIC;
use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::can::{CanConfig, Mcp2515, Mcp2515Buffers};

use crate::clock::SYS_HZ;
use crate::registers::{peripheral, reset, reset_bit, write};

/// The controller.
pub(crate) type Can = Mcp2515<MainLoopSpi, ClassicFrame>;

/// What it has received.
pub(crate) static BUFFERS: Mcp2515Buffers = Mcp2515Buffers::new();

/// Its crystal.
const CRYSTAL_HZ: u32 = 16_000_000;

/// What it takes at the most, and what it gets: the clock divided by an even number, and by another.
const SPI_MAX_HZ: u32 = 10_000_000;
const PRESCALER: u32 = 2;
const DIVIDER: u32 = 7;
const _: () = assert!(SYS_HZ / PRESCALER / DIVIDER <= SPI_MAX_HZ);

/// SSPCR0: frames of eight bits, mode 0. SSPCR1: on.
const EIGHT_BITS: u32 = 7;
const SSE: u32 = 1 << 1;
/// SSPSR: a frame was received.
const RNE: u32 = 1 << 2;

/// Frames that the receiver holds.
const FIFO_LEN: u32 = 8;

/// Looks at a byte that is under way: it takes 112 cycles of the clock, and a look takes 4 at the least.
const MAX_LOOKS: u32 = 1_000;

/// Pins that this module switches itself, by the registers of SIO and IO_BANK0.
const CHIP_SELECT: u32 = 1 << 17;
const INT: u32 = 20;
/// The four bits of a pin in PROC0_INTE, of which the first is a low level.
const INT_LOW: u32 = 1 << (4 * (INT % 8));
const INT_WORD: usize = (INT / 8) as usize;

/// The priority of its handler, which takes 26 µs for a frame: the lowest. No UART waits for it.
const PRIORITY: u8 = 0xC0;

/// Bytes for which a received frame waits at the most: the main loop's longest transaction, which loads a frame; then the
/// handler's look and read.
const BYTES_BEFORE_TAKEN: u32 = 14 + 2 + 14;
/// Cycles of a byte: as many again as SPI takes are more than the instructions around it do.
const BYTE_CYCLES: u32 = 2 * 8 * PRESCALER * DIVIDER;
/// The shortest frame, of no data, without stuff bits, at 1 Mbit/s. Two buffers are full until a third one ends.
const SHORTEST_FRAME_US: u32 = 47;
const _: () = assert!(BYTES_BEFORE_TAKEN * BYTE_CYCLES < 2 * SHORTEST_FRAME_US * (SYS_HZ / 1_000_000));

/// The one that was not started. To be asked for once.
pub(crate) const fn controller() -> Can {
    Mcp2515::new(MainLoopSpi(()), CRYSTAL_HZ, &BUFFERS)
}

/// Starts the controller. The clock runs, the pins are set up.
pub(crate) fn start(controller: &mut Can, config: &CanConfig, nvic: &mut NVIC) {
    // Should it not come out of reset, every exchange fails, which is a controller that is not there.
    let _ = reset(reset_bit::SPI0);
    let spi = peripheral!(SPI0);
    write(spi.sspcpsr(), PRESCALER);
    write(spi.sspcr0(), (DIVIDER - 1) << 8 | EIGHT_BITS);
    write(spi.sspcr1(), SSE);
    controller.start(config);
    write(peripheral!(IO_BANK0).proc0_inte(INT_WORD), INT_LOW);
    // SAFETY: it is still masked, and no critical section is by priority.
    unsafe { nvic.set_priority(INTERRUPT, PRIORITY) };
    rearm();
}

/// Lets the handler run again, behind each turn of the main loop: it may have masked itself.
pub(crate) fn rearm() {
    // SAFETY: the main loop's transactions depend on it being masked, and this is behind them; the handler shares only atomics.
    unsafe { NVIC::unmask(INTERRUPT) };
}

const INTERRUPT: Interrupt = Interrupt::IO_IRQ_BANK0;

#[interrupt]
fn IO_IRQ_BANK0() {
    if !BUFFERS.serve(&mut Spi(())) {
        NVIC::mask(INTERRUPT);
    }
}

/// The main loop's SPI0: the handler does not run during a transaction.
#[derive(Debug)]
pub(crate) struct MainLoopSpi(());

impl ErrorType for MainLoopSpi {
    type Error = Stuck;
}

impl SpiDevice for MainLoopSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Stuck> {
        let was_unmasked = NVIC::is_enabled(INTERRUPT);
        NVIC::mask(INTERRUPT);
        // From here on it does not begin any more (ARMv6-M, B3.4.3).
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        let result = Spi(()).transaction(operations);
        if was_unmasked {
            rearm();
        }
        result
    }
}

/// SPI0 and the chip select, of whoever runs.
#[derive(Debug)]
pub(crate) struct Spi(());

/// A byte did not come back.
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
        // What came after it had been given up.
        let spi = peripheral!(SPI0);
        for _ in 0..FIFO_LEN {
            if spi.sspsr().read().bits() & RNE != 0 {
                let _ = spi.sspdr().read();
            }
        }
        write(peripheral!(SIO).gpio_out_clr(), CHIP_SELECT);
        let result = operations.iter_mut().try_for_each(run);
        write(peripheral!(SIO).gpio_out_set(), CHIP_SELECT);
        // It is to be high for 50 ns; the next one is farther away than these six cycles.
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
            // The longer one's rest is filled up, or dropped.
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

/// One byte each way.
fn exchange(byte: u8) -> Result<u8, Stuck> {
    let spi = peripheral!(SPI0);
    write(spi.sspdr(), byte.into());
    if (0..MAX_LOOKS).any(|_| spi.sspsr().read().bits() & RNE != 0) {
        Ok((spi.sspdr().read().bits() & 0xFF) as u8)
    } else {
        Err(Stuck)
    }
}
