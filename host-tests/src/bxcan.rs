//! Model of bxCAN, the STM32L4's CAN controller, per chapter 46 of ST's RM0351: its registers and its behaviour on a
//! bus.
//!
//! The bus of [`can_bus`](crate::can_bus) reports when a frame begins, ends or fails. The model rejects all options
//! that the board's driver does not use: test modes, wake-up, single transmission, automatic bus-off recovery, FIFO
//! 1, list filters and 16-bit filters. Accesses that the manual forbids and the hardware ignores are ignored, too,
//! and recorded in [`violations`](BusController::violations).

mod fifo;
mod filters;
mod mailboxes;

use anyhow::{Result, bail, ensure};

use self::fifo::Fifo;
use self::filters::Filters;
pub use self::mailboxes::MAILBOXES;
use self::mailboxes::Mailboxes;
use crate::can_controller::{
    Activity, Attempt, BitTiming, BusController, Confinement, MappedController, Node, RECOVERY, Transmission,
};
use crate::can_wire::WireFrame;

/// Register offsets (46.9.2 to 46.9.4).
const MCR: u32 = 0x00;
const MSR: u32 = 0x04;
const TSR: u32 = 0x08;
const RF0R: u32 = 0x0C;
const IER: u32 = 0x14;
const ESR: u32 = 0x18;
const BTR: u32 = 0x1C;
const MAILBOX: u32 = 0x180;
const FIFO_0: u32 = 0x1B0;
const FIFO_0_END: u32 = 0x1C0;
const FILTERS: u32 = 0x200;

/// Modelled bits of MCR (46.9.2).
const INRQ: u32 = 1 << 0;
const SLEEP: u32 = 1 << 1;
const DBF: u32 = 1 << 16;
const MCR_BITS: u32 = INRQ | SLEEP | DBF;

/// Bits of MSR.
const INAK: u32 = 1 << 0;
const SLAK: u32 = 1 << 1;
const TXM: u32 = 1 << 8;
const RXM: u32 = 1 << 9;
/// The line is recessive, now and at the last sample point.
const RX_AND_SAMP: u32 = 0b11 << 10;

/// Modelled bits of IER: mailbox empty, and message pending in FIFO 0.
const TMEIE: u32 = 1 << 0;
const FMPIE0: u32 = 1 << 1;

/// Bits of BTR: the timing and the two test modes.
const TIMING: u32 = 0x037F_03FF;
const TEST_MODES: u32 = 0b11 << 30;

/// Bits of ESR, and the position of LEC in it (46.9.2).
const EWGF: u32 = 1 << 0;
const EPVF: u32 = 1 << 1;
const BOFF: u32 = 1 << 2;
const LEC_AT: u32 = 4;

/// Operating mode (46.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// The mode after reset.
    Sleep,
    Initialisation,
    /// On the way to normal mode; until then MSR shows the previous mode.
    Synchronising {
        from: u32,
    },
    Normal,
}

/// The bxCAN controller.
#[derive(Clone, Debug)]
pub struct Bxcan {
    clock_hz: u32,
    mcr: u32,
    ier: u32,
    btr: u32,
    mode: Mode,
    node: Node,
    mailboxes: Mailboxes,
    fifo: Fifo,
    filters: Filters,
}

impl Bxcan {
    /// Creates a controller after reset with this bus clock in Hz.
    #[must_use]
    pub fn new(clock_hz: u32) -> Self {
        Self {
            clock_hz,
            mcr: DBF | SLEEP,
            ier: 0,
            btr: 0x0123_0000,
            mode: Mode::Sleep,
            node: Node::default(),
            mailboxes: Mailboxes::default(),
            fifo: Fifo::default(),
            filters: Filters::new(),
        }
    }

    fn msr(&self) -> u32 {
        let mode = match self.mode {
            Mode::Sleep => SLAK,
            Mode::Initialisation => INAK,
            Mode::Synchronising { from } => from,
            Mode::Normal => 0,
        };
        let activity = match self.node.activity {
            Activity::Transmitting => TXM,
            Activity::Receiving => RXM,
            Activity::Synchronising | Activity::Idle => 0,
        };
        mode | activity | RX_AND_SAMP
    }

    /// Returns ESR. TEC holds the lower 8 of 9 bits, so it shows 0 when 256 causes bus-off.
    fn esr(&self) -> u32 {
        let Confinement { transmit, receive, .. } = self.node.faults;
        let states = self.node.faults.states([EWGF, EPVF, BOFF]);
        states | self.node.last_error << LEC_AT | u32::from(transmit as u8) << 16 | u32::from(receive) << 24
    }

    fn store_mcr(&mut self, value: u32) -> Result<()> {
        ensure!(value & !MCR_BITS == 0, "MCR {value:#X}: these modes are not modelled");
        self.mcr = value;
        self.change_mode();
        Ok(())
    }

    fn store_btr(&mut self, value: u32) -> Result<()> {
        ensure!(value & TEST_MODES == 0, "loop back and silent mode are not modelled");
        if self.mode == Mode::Initialisation {
            self.btr = value & TIMING;
        } else {
            self.node.forbidden("46.9.2: BTR can only be written in initialisation mode");
        }
        Ok(())
    }

    fn enter(&mut self, mode: Mode) {
        self.node.synchronise();
        if mode == (Mode::Synchronising { from: INAK }) {
            // 46.7.6: setting and clearing INRQ starts the recovery from bus-off.
            self.node.faults.begin_recovery(RECOVERY);
        }
        self.mode = mode;
    }
}

impl BusController for Bxcan {
    fn node(&self) -> &Node {
        &self.node
    }

    fn node_mut(&mut self) -> &mut Node {
        &mut self.node
    }

    /// 46.7.7
    fn bit_timing(&self) -> BitTiming {
        let field = |at: u32, bits: u32| (self.btr >> at & ((1 << bits) - 1)) + 1;
        BitTiming::new(self.clock_hz, field(0, 10), [1 + field(16, 4), field(20, 3)], field(24, 2))
    }

    fn next_request(&self) -> Option<Transmission> {
        self.mailboxes.next()
    }

    fn attempt_ended(&mut self, mailbox: usize, attempt: Attempt) {
        self.mailboxes.attempt_ended(mailbox, attempt);
    }

    fn accept(&mut self, frame: &WireFrame) -> bool {
        let filter = self.filters.pass(frame);
        if let Some(filter) = filter {
            self.fifo.put(frame, filter);
        }
        filter.is_some()
    }

    /// Enters the mode requested in MCR after the current frame, if any, has ended (46.4.1, 46.4.3).
    fn change_mode(&mut self) {
        if matches!(self.node.activity, Activity::Transmitting | Activity::Receiving) {
            return;
        }
        let asked = (self.mcr & INRQ != 0, self.mcr & SLEEP != 0);
        match (self.mode, asked) {
            // 46.4.3: sleep mode ends only when SLEEP is cleared.
            (Mode::Sleep, (_, true)) | (Mode::Initialisation, (true, _)) => {}
            (_, (true, false)) => self.enter(Mode::Initialisation),
            (_, (_, true)) => self.enter(Mode::Sleep),
            (Mode::Sleep, (false, false)) => self.enter(Mode::Synchronising { from: SLAK }),
            (Mode::Initialisation, (false, false)) => self.enter(Mode::Synchronising { from: INAK }),
            (Mode::Synchronising { .. } | Mode::Normal, (false, false)) => {}
        }
    }

    fn idle(&mut self, bits: u32) {
        if matches!(self.mode, Mode::Synchronising { .. } | Mode::Normal) && self.node.idle(bits) {
            self.mode = Mode::Normal;
        }
    }
}

impl MappedController for Bxcan {
    /// Transmission and FIFO 0 (RM0351, table 58).
    const LINES: [u8; 2] = [19, 20];

    fn load(&mut self, offset: u32) -> Result<u32> {
        Ok(match offset {
            MCR => self.mcr,
            MSR => self.msr(),
            TSR => self.mailboxes.tsr(),
            RF0R => self.fifo.rfr(),
            IER => self.ier,
            ESR => self.esr(),
            BTR => self.btr,
            MAILBOX..FIFO_0 => self.mailboxes.load(offset - MAILBOX),
            FIFO_0..FIFO_0_END => self.fifo.load(offset - FIFO_0),
            FILTERS.. => self.filters.load(offset - FILTERS)?,
            _ => bail!("bxCAN: no register is modelled at {offset:#05X}"),
        })
    }

    fn store(&mut self, offset: u32, value: u32) -> Result<()> {
        match offset {
            MCR => self.store_mcr(value)?,
            TSR => self.mailboxes.store_tsr(value, |mailbox| self.node.is_sending(mailbox)),
            RF0R => self.fifo.store_rfr(value),
            IER => {
                ensure!(value & !(TMEIE | FMPIE0) == 0, "IER {value:#X}: these interrupts are not modelled");
                self.ier = value;
            }
            BTR => self.store_btr(value)?,
            MAILBOX..FIFO_0 => {
                if !self.mailboxes.store(offset - MAILBOX, value)? {
                    self.node
                        .forbidden(format!("46.9.3: write to a mailbox that is not empty, at {offset:#05X}"));
                }
            }
            FIFO_0..FIFO_0_END => self.node.forbidden(format!("46.9.3: write to a FIFO, at {offset:#05X}")),
            FILTERS.. => {
                if !self.filters.store(offset - FILTERS, value)? {
                    self.node.forbidden(format!("46.7.4: change of an active filter, at {offset:#05X}"));
                }
            }
            _ => bail!("bxCAN: no writable register is modelled at {offset:#05X}"),
        }
        Ok(())
    }

    /// 46.8
    fn interrupts(&self) -> [bool; 2] {
        [
            self.ier & TMEIE != 0 && self.mailboxes.any_request_completed(),
            self.ier & FMPIE0 != 0 && self.fifo.has_message(),
        ]
    }

    fn reset(&mut self) {
        *self = Self::new(self.clock_hz);
    }
}

#[cfg(test)]
mod tests;
