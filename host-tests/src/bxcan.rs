//! Model of bxCAN, the STM32L4's CAN controller, per chapter 46 of ST's RM0351: its registers and its behaviour on a
//! bus.
//!
//! The bus of [`can_bus`](crate::can_bus) reports when a frame begins, ends or fails. The model rejects all options
//! that the board's driver does not use: test modes, wake-up, single transmission, automatic bus-off recovery, FIFO
//! 1, list filters and 16-bit filters. Accesses that the manual forbids and the hardware ignores are ignored, too,
//! and recorded in [`Bxcan::violations`].

mod faults;
mod fifo;
mod filters;
mod mailboxes;

use anyhow::{Result, bail, ensure};

use self::faults::Faults;
use self::fifo::Fifo;
use self::filters::Filters;
pub use self::mailboxes::MAILBOXES;
use self::mailboxes::Mailboxes;
use crate::can_controller::{
    BITS_TO_SYNCHRONISE, BitTiming, BusController, ErrorCode, RECOVERY, Transmission, count_sequences,
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

/// Length of the register block in bytes.
pub const LEN: u32 = 0x400;

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

/// Interrupt numbers of transmission and FIFO 0 (RM0351, table 58).
pub const LINES: [u8; 2] = [19, 20];

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
    /// Recessive bits since the last frame.
    recessive: u32,
    /// Activity while a frame of this or another station is on the bus.
    activity: Option<Activity>,
    mailboxes: Mailboxes,
    fifo: Fifo,
    filters: Filters,
    faults: Faults,
    accepted: Vec<WireFrame>,
    violations: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Activity {
    Transmitting,
    Receiving,
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
            recessive: 0,
            activity: None,
            mailboxes: Mailboxes::default(),
            fifo: Fifo::new(),
            filters: Filters::new(),
            faults: Faults::default(),
            accepted: Vec::new(),
            violations: Vec::new(),
        }
    }

    /// Returns all messages accepted by a filter since reset, including any lost in a FIFO.
    #[must_use]
    pub fn accepted(&self) -> &[WireFrame] {
        &self.accepted
    }

    /// Returns the driver's accesses that the manual forbids and the hardware ignores.
    #[must_use]
    pub fn violations(&self) -> &[String] {
        &self.violations
    }

    /// Returns the configured bit timing (46.7.7).
    #[must_use]
    pub fn bit_timing(&self) -> BitTiming {
        let field = |at: u32, bits: u32| (self.btr >> at & ((1 << bits) - 1)) + 1;
        BitTiming::new(self.clock_hz, field(0, 10), [1 + field(16, 4), field(20, 3)], field(24, 2))
    }

    /// Loads the register at this offset.
    ///
    /// # Errors
    /// Fails when no such register is modelled.
    pub fn load(&mut self, offset: u32) -> Result<u32> {
        Ok(match offset {
            MCR => self.mcr,
            MSR => self.msr(),
            TSR => self.mailboxes.tsr(),
            RF0R => self.fifo.rfr(),
            IER => self.ier,
            ESR => self.faults.esr(),
            BTR => self.btr,
            MAILBOX..FIFO_0 => self.mailboxes.load(offset - MAILBOX),
            FIFO_0..FIFO_0_END => self.fifo.load(offset - FIFO_0),
            FILTERS.. => self.filters.load(offset - FILTERS)?,
            _ => bail!("bxCAN: no register is modelled at {offset:#05X}"),
        })
    }

    /// Stores to the register at this offset.
    ///
    /// # Errors
    /// Fails when the register or the requested option is not modelled.
    pub fn store(&mut self, offset: u32, value: u32) -> Result<()> {
        match offset {
            MCR => self.store_mcr(value)?,
            TSR => self.mailboxes.store_tsr(value),
            RF0R => self.fifo.store_rfr(value),
            IER => {
                ensure!(value & !(TMEIE | FMPIE0) == 0, "IER {value:#X}: these interrupts are not modelled");
                self.ier = value;
            }
            BTR => self.store_btr(value)?,
            MAILBOX..FIFO_0 => {
                if !self.mailboxes.store(offset - MAILBOX, value)? {
                    self.forbidden(format!("46.9.3: write to a mailbox that is not empty, at {offset:#05X}"));
                }
            }
            FIFO_0..FIFO_0_END => self.forbidden(format!("46.9.3: write to a FIFO, at {offset:#05X}")),
            FILTERS.. => {
                if !self.filters.store(offset - FILTERS, value)? {
                    self.forbidden(format!("46.7.4: change of an active filter, at {offset:#05X}"));
                }
            }
            _ => bail!("bxCAN: no writable register is modelled at {offset:#05X}"),
        }
        Ok(())
    }

    /// Returns the interrupt levels in the order of [`LINES`] (46.8).
    #[must_use]
    pub fn interrupts(&self) -> [bool; 2] {
        [
            self.ier & TMEIE != 0 && self.mailboxes.any_request_completed(),
            self.ier & FMPIE0 != 0 && self.fifo.has_message(),
        ]
    }

    fn forbidden(&mut self, what: String) {
        self.violations.push(what);
    }

    fn msr(&self) -> u32 {
        let mode = match self.mode {
            Mode::Sleep => SLAK,
            Mode::Initialisation => INAK,
            Mode::Synchronising { from } => from,
            Mode::Normal => 0,
        };
        let activity = match self.activity {
            Some(Activity::Transmitting) => TXM,
            Some(Activity::Receiving) => RXM,
            None => 0,
        };
        mode | activity | RX_AND_SAMP
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
            self.forbidden("46.9.2: BTR can only be written in initialisation mode".into());
        }
        Ok(())
    }

    /// Enters the mode requested in MCR after the current frame, if any, has ended (46.4.1, 46.4.3).
    fn change_mode(&mut self) {
        if self.activity.is_some() {
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

    fn enter(&mut self, mode: Mode) {
        if let Mode::Synchronising { from } = mode {
            self.recessive = 0;
            if from == INAK {
                // 46.7.6: setting and clearing INRQ starts the recovery from bus-off.
                self.faults.confinement.begin_recovery(RECOVERY);
            }
        }
        self.mode = mode;
    }

    /// A frame ends with as many recessive bits as synchronisation requires.
    fn end_activity(&mut self) {
        self.activity = None;
        self.change_mode();
        self.recessive = 0;
        self.idle(BITS_TO_SYNCHRONISE);
    }
}

impl BusController for Bxcan {
    fn rate(&self) -> u32 {
        self.bit_timing().rate
    }

    fn takes_part(&self) -> bool {
        self.mode == Mode::Normal && !self.faults.confinement.is_off
    }

    fn next_transmission(&self) -> Option<Transmission> {
        if self.takes_part() { self.mailboxes.next() } else { None }
    }

    fn begin_transmission(&mut self, mailbox: usize) {
        self.activity = Some(Activity::Transmitting);
        self.mailboxes.begin(mailbox);
    }

    fn begin_reception(&mut self, lost: Option<usize>) {
        self.recessive = 0;
        if let Some(mailbox) = lost {
            self.mailboxes.lose(mailbox);
        }
        if self.takes_part() {
            self.activity = Some(Activity::Receiving);
        }
    }

    fn end_transmission(&mut self, mailbox: usize) {
        self.mailboxes.complete(mailbox);
        self.faults.transmitted();
        self.end_activity();
    }

    fn fail_transmission(&mut self, mailbox: usize, why: ErrorCode) {
        self.mailboxes.fail(mailbox);
        self.faults.transmit_error(why);
        self.end_activity();
    }

    fn end_reception(&mut self, frame: &WireFrame) {
        if self.activity == Some(Activity::Receiving) {
            self.faults.received();
            if let Some(filter) = self.filters.pass(frame) {
                self.fifo.put(frame, filter);
                self.accepted.push(*frame);
            }
        }
        self.end_activity();
    }

    fn fail_reception(&mut self, why: ErrorCode) {
        if self.activity == Some(Activity::Receiving) {
            self.faults.receive_error(why);
        }
        self.end_activity();
    }

    fn idle(&mut self, bits: u32) {
        let sequences = count_sequences(&mut self.recessive, bits);
        if let Mode::Synchronising { .. } = self.mode
            && self.recessive >= BITS_TO_SYNCHRONISE
        {
            self.enter(Mode::Normal);
        }
        if self.mode == Mode::Normal {
            self.faults.confinement.count_recessive(sequences);
        }
    }
}

#[cfg(test)]
mod tests;
