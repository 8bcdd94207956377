//! Driver for the CAN controller MCP2515 (Microchip DS20001801) over any HAL's SPI, for boards without a CAN controller.
//!
//! The crate `mcp2515` reports neither error counters nor overflows, cannot withdraw frames, and may reorder two frames with
//! the same identifier. In this driver every wait is bounded, and a missing MCP2515 is reported as bus-off.
//!
//! The interrupt handler reads received frames, through [`Mcp2515Buffers`]. The main loop does everything else.

mod buffers;

pub use buffers::Mcp2515Buffers;

use core::marker::PhantomData;

use embedded_can::{ErrorKind, ExtendedId, Frame, Id, StandardId};
use embedded_hal::spi::{Operation, SpiDevice};

use self::buffers::{RawFrame, read_status};
use super::{CanConfig, CanController, Health, TransmitBuffers, Withdrawal};

/// Instructions (12.0).
const RESET: u8 = 0xC0;
const READ: u8 = 0x03;
const WRITE: u8 = 0x02;
const BIT_MODIFY: u8 = 0x05;
const LOAD_TX: [u8; 3] = [0x40, 0x42, 0x44];
const RTS: [u8; 3] = [0x81, 0x82, 0x84];

/// Registers (11.0). Filters, masks and buffers have four registers for an identifier.
const RXF: [u8; 6] = [0x00, 0x04, 0x08, 0x10, 0x14, 0x18];
const CANSTAT: u8 = 0x0E;
const CANCTRL: u8 = 0x0F;
const TEC: u8 = 0x1C;
const RXM: [u8; 2] = [0x20, 0x24];
const CNF3: u8 = 0x28;
const CANINTE: u8 = 0x2B;
const CANINTF: u8 = 0x2C;
const EFLG: u8 = 0x2D;
const TXBCTRL: [u8; 3] = [0x30, 0x40, 0x50];
const RXBCTRL: [u8; 2] = [0x60, 0x70];

/// CANSTAT and CANCTRL: the mode.
const MODE: u8 = 0b111 << 5;
const NORMAL: u8 = 0;
const CONFIGURATION: u8 = 0b100 << 5;
/// CANCTRL: abort all transmissions, and start none while it is set (3.6).
const ABAT: u8 = 1 << 4;
/// CANINTF: a buffer's frame was sent.
const TXIF: [u8; 3] = [1 << 2, 1 << 3, 1 << 4];
/// CNF2: CNF3 sets PHSEG2.
const BTLMODE: u8 = 1 << 7;
/// CANINTE: a frame is in either buffer.
const RX_INTERRUPTS: u8 = 0b11;
/// RXB0CTRL: a frame for a full first buffer rolls over to the second.
const BUKT: u8 = 1 << 2;
/// TXBnCTRL: transmit request; highest priority.
const TXREQ: u8 = 1 << 3;
const TXP_HIGHEST: u8 = 0b11;
/// EFLG.
const TXBO: u8 = 1 << 5;
const PASSIVE: u8 = 0b11 << 3;
const OVERFLOWS: u8 = 0b11 << 6;
/// READ STATUS: TXREQ and TXnIF of each buffer.
const TXREQS: [u8; 3] = [1 << 2, 1 << 4, 1 << 6];
const TXIFS: [u8; 3] = [1 << 3, 1 << 5, 1 << 7];

/// Second identifier register: extended identifier; received standard remote frame. Length register: remote frame.
const EXIDE: u8 = 1 << 3;
const SRR: u8 = 1 << 4;
const RTR: u8 = 1 << 6;

/// Maximum data bytes in a frame. The length field ranges up to 15, and values above 8 also mean 8 (ISO 11898-1).
const MAX_DATA_LEN: u8 = 8;

/// Maximum polls for the end of the reset, which takes 128 cycles of the crystal. A poll takes 24 cycles of SPI.
const MAX_LOOKS: u32 = 100;

/// Bit timing registers (5.0).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct BitTiming {
    /// CNF3, CNF2 and CNF1, in the order of their addresses.
    registers: [u8; 3],
}

impl BitTiming {
    /// Returns the timing for a crystal in Hz and a rate in kbit/s. A bit has 16 time quanta, sampled at 87.5 % (CiA 301,
    /// table 1), or 8 for a slow crystal, sampled at 75 %. Returns `None` if the crystal does not divide to the rate.
    const fn for_rate(crystal_hz: u32, kbit_rate: u16) -> Option<Self> {
        // Time quanta of the propagation segment and of phase segment 1. Phase segment 2 has the minimum of two, so the jump
        // width is one.
        const FINE: [u32; 2] = [5, 8];
        const COARSE: [u32; 2] = [2, 3];
        match Self::with(crystal_hz, kbit_rate, FINE) {
            None => Self::with(crystal_hz, kbit_rate, COARSE),
            fine => fine,
        }
    }

    const fn with(crystal_hz: u32, kbit_rate: u16, [propagation, phase_1]: [u32; 2]) -> Option<Self> {
        const PHASE_2: u32 = 2;
        let quanta = 1 + propagation + phase_1 + PHASE_2;
        // A time quantum has at least two cycles of the crystal.
        let cycles = 2 * quanta * kbit_rate as u32 * 1_000;
        if cycles == 0 || !crystal_hz.is_multiple_of(cycles) {
            return None;
        }
        let prescaler = crystal_hz / cycles;
        if prescaler > 1 << 6 {
            return None;
        }
        let cnf1 = (prescaler - 1) as u8;
        let cnf2 = BTLMODE | ((phase_1 - 1) as u8) << 3 | (propagation - 1) as u8;
        Some(Self { registers: [(PHASE_2 - 1) as u8, cnf2, cnf1] })
    }
}

/// Error: a frame was lost, because both buffers were full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overrun;

impl embedded_can::Error for Overrun {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Overrun
    }
}

/// An MCP2515 on SPI in mode 0, at up to 10 MHz. The handler of its interrupt must not interrupt a transaction: mask only
/// that interrupt during each.
///
/// The chip leaves bus-off by itself after 128 times 11 recessive bits. Until [`recover`](CanController::recover), the driver
/// sends nothing and discards received frames.
#[derive(Debug)]
pub struct Mcp2515<S, F> {
    spi: S,
    received: &'static Mcp2515Buffers,
    crystal_hz: u32,
    config: Option<CanConfig>,
    /// Timing and filters are in the registers.
    is_set_up: bool,
    /// The chip was bus-off, and `recover` has not been called since.
    is_off: bool,
    /// Frames were lost, which has not been reported yet.
    has_overrun: bool,
    transmit: TransmitBuffers,
    /// Status before the undecided withdrawal.
    before_withdrawal: u8,
    frames: PhantomData<fn() -> F>,
}

impl<S: SpiDevice, F: Frame> Mcp2515<S, F> {
    /// Creates a driver before its start, with the crystal's frequency in Hz and the buffers of the handler.
    pub const fn new(spi: S, crystal_hz: u32, received: &'static Mcp2515Buffers) -> Self {
        Self {
            spi,
            received,
            crystal_hz,
            config: None,
            is_set_up: false,
            is_off: false,
            has_overrun: false,
            transmit: TransmitBuffers::new(),
            before_withdrawal: 0,
            frames: PhantomData,
        }
    }

    /// Starts the chip over working SPI. The filters accept little more than the frames for the bridge.
    pub fn start(&mut self, config: &CanConfig) {
        self.config = Some(*config);
        self.join();
    }

    fn join(&mut self) {
        self.received.close();
        self.has_overrun = false;
        self.is_set_up = self.config.is_some_and(|config| self.set_up(&config).unwrap_or(false));
        self.is_off = false;
        if self.is_set_up {
            self.received.open();
        }
    }

    /// Sets up the chip. Returns whether it responds and supports the rate.
    fn set_up(&mut self, config: &CanConfig) -> Result<bool, S::Error> {
        self.transmit.start(config);
        let Some(timing) = BitTiming::for_rate(self.crystal_hz, config.kbit_rate) else { return Ok(false) };
        self.spi.write(&[RESET])?;
        let mut is_reset = false;
        for _ in 0..MAX_LOOKS {
            is_reset = self.read::<1>(CANSTAT)?[0] & MODE == CONFIGURATION;
            if is_reset {
                break;
            }
        }
        if !is_reset {
            return Ok(false);
        }
        self.write(CNF3, &timing.registers)?;
        // First buffer: the gripper with adjacent identifiers, and heartbeats. Second buffer: frames to this node, NMT and
        // SYNC. A mask applies to the whole buffer, so each receiver compares the complete identifier.
        let gripper = config.gripper.controller().receive.as_raw();
        let node = u16::from(config.node.node);
        self.write(RXM[0], &id_registers(Id::Standard(standard(0x780))))?;
        self.write(RXM[1], &id_registers(Id::Standard(standard(0x07F))))?;
        for (filter, id) in RXF.into_iter().zip([gripper, 0x700, node, 0, node, 0]) {
            self.write(filter, &id_registers(Id::Standard(standard(id))))?;
        }
        self.write(RXBCTRL[0], &[BUKT])?;
        self.write(RXBCTRL[1], &[0])?;
        self.write(CANINTE, &[RX_INTERRUPTS])?;
        // The chip synchronises to the bus on its own. The first frames wait for that.
        self.write(CANCTRL, &[NORMAL])?;
        // Floating lines read arbitrary values. A reset chip never has these.
        Ok(self.read::<3>(CNF3)? == timing.registers)
    }

    fn read<const N: usize>(&mut self, register: u8) -> Result<[u8; N], S::Error> {
        let mut values = [0; N];
        self.spi.transaction(&mut [Operation::Write(&[READ, register]), Operation::Read(&mut values)])?;
        Ok(values)
    }

    fn write(&mut self, register: u8, values: &[u8]) -> Result<(), S::Error> {
        self.spi.transaction(&mut [Operation::Write(&[WRITE, register]), Operation::Write(values)])
    }

    fn modify(&mut self, register: u8, mask: u8, value: u8) -> Result<(), S::Error> {
        self.spi.write(&[BIT_MODIFY, register, mask, value])
    }

    fn send(&mut self, frame: &F) -> Result<bool, S::Error> {
        if self.transmit.withdrawing().is_some() {
            return Ok(false);
        }
        let is_empty = are_empty(read_status(&mut self.spi)?);
        let Some(buffer) = self.transmit.take(frame.id(), is_empty) else { return Ok(false) };
        let (Some(load), Some(rts), Some(&was_sent)) =
            (LOAD_TX.get(buffer), RTS.get(buffer), TXIF.get(buffer))
        else {
            return Ok(false);
        };
        // From now on, the flag applies to this frame. `withdraw` depends on it.
        self.modify(CANINTF, was_sent, 0)?;
        let [a, b, c, d] = id_registers(frame.id());
        let len = frame.dlc() as u8 | if frame.is_remote_frame() { RTR } else { 0 };
        self.spi.transaction(&mut [
            Operation::Write(&[*load, a, b, c, d, len]),
            Operation::Write(frame.data()),
        ])?;
        if buffer == 0 {
            // The other buffers keep the lowest priority from the reset.
            self.write(TXBCTRL[0], &[TXREQ | TXP_HIGHEST])?;
        } else {
            self.spi.write(&[*rts])?;
        }
        Ok(true)
    }

    fn look(&mut self) -> Result<Health, S::Error> {
        let [control] = self.read(CANCTRL)?;
        let [transmit_errors, receive_errors] = self.read(TEC)?;
        let [flags] = self.read(EFLG)?;
        if control & MODE != NORMAL {
            // The chip has lost its supply, or is missing.
            self.is_set_up = false;
        }
        if flags & OVERFLOWS != 0 {
            self.modify(EFLG, OVERFLOWS, 0)?;
            self.has_overrun = true;
        }
        self.is_off |= flags & TXBO != 0;
        if self.is_off {
            // Frames received during bus-off would be outdated after the recovery.
            self.received.clear();
        }
        Ok(Health {
            is_off: self.is_off,
            is_passive: flags & PASSIVE != 0,
            transmit_errors: if flags & TXBO != 0 { u8::MAX } else { transmit_errors },
            receive_errors,
        })
    }

    /// Aborts all buffers, and requests the others again. With ABAT, TXREQ stays set until the end of a frame on the bus
    /// (3.6). Clearing TXREQ of a single buffer would not show that end.
    fn withdraw_frame(&mut self, id: Id) -> Result<Withdrawal, S::Error> {
        let mut status = read_status(&mut self.spi)?;
        let buffer = match self.transmit.withdrawing() {
            Some(buffer) => buffer,
            None => {
                let Some(buffer) = self.transmit.withdraw(id, are_empty(status)) else {
                    return Ok(Withdrawal::TooLate);
                };
                self.before_withdrawal = status;
                self.modify(CANCTRL, ABAT, ABAT)?;
                status = read_status(&mut self.spi)?;
                buffer
            }
        };
        if are_empty(status) != [true; TransmitBuffers::COUNT] {
            return Ok(Withdrawal::Undecided);
        }
        self.modify(CANCTRL, ABAT, 0)?;
        let mut was_sent = false;
        for (n, ((waits, sent), rts)) in TXREQS.into_iter().zip(TXIFS).zip(RTS).enumerate() {
            if n == buffer {
                was_sent = status & sent != 0;
            } else if self.before_withdrawal & waits != 0 && status & sent == 0 {
                self.spi.write(&[rts])?;
            }
        }
        Ok(self.transmit.decide(Withdrawal::of(false, was_sent)))
    }

    fn forget_all(&mut self) -> Result<(), S::Error> {
        TXBCTRL.into_iter().try_for_each(|control| self.modify(control, TXREQ, 0))?;
        if self.transmit.withdrawing().is_some() {
            self.transmit.decide(Withdrawal::Withdrawn);
            self.modify(CANCTRL, ABAT, 0)?;
        }
        Ok(())
    }

    /// Returns the result of SPI. An error counts as a missing controller.
    fn unless_lost<T>(&mut self, result: Result<T, S::Error>) -> Option<T> {
        self.is_set_up &= result.is_ok();
        result.ok()
    }
}

impl<S: SpiDevice, F: Frame> embedded_can::nb::Can for Mcp2515<S, F> {
    type Frame = F;
    type Error = Overrun;

    fn transmit(&mut self, frame: &F) -> nb::Result<Option<F>, Overrun> {
        if self.is_set_up && !self.is_off {
            let result = self.send(frame);
            if self.unless_lost(result) == Some(true) {
                return Ok(None);
            }
        }
        Err(nb::Error::WouldBlock)
    }

    fn receive(&mut self) -> nb::Result<F, Overrun> {
        if core::mem::take(&mut self.has_overrun) {
            return Err(nb::Error::Other(Overrun));
        }
        let raw = if self.is_set_up && !self.is_off { self.received.pop() } else { None };
        raw.and_then(frame).ok_or(nb::Error::WouldBlock)
    }
}

impl<S: SpiDevice, F: Frame + Clone> CanController for Mcp2515<S, F> {
    /// A chip without set-up is reported as bus-off, so that the bus-off policy tries again.
    fn health(&mut self) -> Health {
        let health = if self.is_set_up {
            let result = self.look();
            self.unless_lost(result)
        } else {
            None
        };
        match health {
            Some(health) if self.is_set_up => health,
            _ => {
                self.received.close();
                Health { is_off: true, ..Health::default() }
            }
        }
    }

    fn withdraw(&mut self, id: Id) -> Withdrawal {
        if !self.is_set_up || self.is_off {
            return Withdrawal::TooLate;
        }
        let result = self.withdraw_frame(id);
        self.unless_lost(result).unwrap_or(Withdrawal::TooLate)
    }

    /// A frame that is being sent is completed.
    fn abort(&mut self) {
        let result = self.forget_all();
        self.unless_lost(result);
    }

    /// The chip's own recovery began at bus-off, so it only needs to be accepted.
    fn recover(&mut self) {
        if self.is_set_up {
            self.is_off = false;
        } else {
            self.join();
        }
    }
}

/// Returns which transmit buffers are free.
fn are_empty(status: u8) -> [bool; TransmitBuffers::COUNT] {
    TXREQS.map(|waits| status & waits == 0)
}

/// Encodes an identifier for the registers of a buffer, filter or mask.
fn id_registers(id: Id) -> [u8; 4] {
    match id {
        Id::Standard(id) => [(id.as_raw() >> 3) as u8, (id.as_raw() << 5) as u8, 0, 0],
        Id::Extended(id) => {
            let [_, _, e8, e0] = id.as_raw().to_be_bytes();
            let low = ((id.as_raw() >> 18 & 0b111) << 5) as u8 | EXIDE | (id.as_raw() >> 16 & 0b11) as u8;
            [(id.as_raw() >> 21) as u8, low, e8, e0]
        }
    }
}

/// Decodes a frame from the registers of a receive buffer.
fn frame<F: Frame>([high, low, e8, e0, len, data @ ..]: RawFrame) -> Option<F> {
    let is_extended = low & EXIDE != 0;
    let count = (len & 0xF).min(MAX_DATA_LEN).into();
    let id = if is_extended {
        let top = u32::from(high) << 21 | u32::from(low >> 5) << 18 | u32::from(low & 0b11) << 16;
        let id = top | u32::from(u16::from_be_bytes([e8, e0]));
        Id::Extended(ExtendedId::new(id).unwrap_or(ExtendedId::MAX))
    } else {
        Id::Standard(standard(u16::from(high) << 3 | u16::from(low >> 5)))
    };
    let is_remote = if is_extended { len & RTR != 0 } else { low & SRR != 0 };
    if is_remote { F::new_remote(id, count) } else { F::new(id, data.get(..count).unwrap_or_default()) }
}

fn standard(id: u16) -> StandardId {
    StandardId::new(id).unwrap_or(StandardId::MAX)
}

#[cfg(test)]
mod tests;
