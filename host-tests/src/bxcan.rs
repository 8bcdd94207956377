//! The CAN controller of the STM32L4, bxCAN, as ST's RM0351 describes it in chapter 46: what the core sees in its
//! registers, and what it does on a bus.
//!
//! The bus is [`can_bus`](crate::can_bus)'s; it says when a frame begins, ends, or fails. Loop back, silent mode and time
//! triggered communication are refused. What the manual forbids a driver and the hardware ignores, this ignores too, and
//! keeps in [`Bxcan::violations`].

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
use crate::can_controller::{BusController, ErrorCode, Transmission};
use crate::can_wire::WireFrame;

/// Offsets of registers (46.9.2 to 46.9.4).
const MCR: u32 = 0x00;
const MSR: u32 = 0x04;
const TSR: u32 = 0x08;
const RF0R: u32 = 0x0C;
const RF1R: u32 = 0x10;
const IER: u32 = 0x14;
const ESR: u32 = 0x18;
const BTR: u32 = 0x1C;
const MAILBOX: u32 = 0x180;
const FIFO_0: u32 = 0x1B0;
const FIFO_1: u32 = 0x1C0;
const FILTERS: u32 = 0x200;

/// How many bytes its registers take.
pub const LEN: u32 = 0x400;

/// Bits of MCR (46.9.2).
const INRQ: u32 = 1 << 0;
const SLEEP: u32 = 1 << 1;
const TXFP: u32 = 1 << 2;
const RFLM: u32 = 1 << 3;
const NART: u32 = 1 << 4;
const AWUM: u32 = 1 << 5;
const ABOM: u32 = 1 << 6;
const TTCM: u32 = 1 << 7;
const RESET: u32 = 1 << 15;
const DBF: u32 = 1 << 16;
const MCR_BITS: u32 = INRQ | SLEEP | TXFP | RFLM | NART | AWUM | ABOM | TTCM | DBF;

/// Bits of MSR.
const INAK: u32 = 1 << 0;
const SLAK: u32 = 1 << 1;
const ERRI: u32 = 1 << 2;
const WKUI: u32 = 1 << 3;
const SLAKI: u32 = 1 << 4;
const TXM: u32 = 1 << 8;
const RXM: u32 = 1 << 9;
/// The line is recessive, now and at the last sample point.
const RX_AND_SAMP: u32 = 0b11 << 10;

/// Bits of IER.
const TMEIE: u32 = 1 << 0;
const ERRIE: u32 = 1 << 15;
const WKUIE: u32 = 1 << 16;
const SLKIE: u32 = 1 << 17;
const IER_BITS: u32 = 0x0003_8F7F;

/// Bits of BTR: all of the timing, and the two test modes.
const TIMING: u32 = 0x037F_03FF;
const TEST_MODES: u32 = 0b11 << 30;

/// Recessive bits in a row that a controller waits for before it takes part (46.4.2).
const BITS_TO_SYNCHRONISE: u32 = 11;

/// Interrupt lines, by their numbers at the core (RM0351, table 58).
pub const LINES: [u8; 4] = [19, 20, 21, 22];

/// Which mode it is in (46.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// The one after reset.
    Sleep,
    Initialisation,
    /// On the way to normal mode; what it comes from shows in MSR until it is there.
    Synchronising {
        from: u32,
    },
    Normal,
}

/// The times of a bit (46.7.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Bits a second.
    pub rate: u32,
    /// Where the bit is sampled, in thousandths of it.
    pub sample_point: u32,
    /// By how many time quanta it may be made longer or shorter.
    pub jump: u32,
    /// Time quanta of a bit.
    pub quanta: u32,
}

/// The controller.
#[derive(Clone, Debug)]
pub struct Bxcan {
    clock_hz: u32,
    mcr: u32,
    /// ERRI, WKUI and SLAKI.
    flags: u32,
    ier: u32,
    btr: u32,
    mode: Mode,
    /// Recessive bits since the last frame.
    recessive: u32,
    /// A frame is on the bus, of this or another.
    activity: Option<Activity>,
    mailboxes: Mailboxes,
    fifos: [Fifo; 2],
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
    /// As reset leaves it, on a bus clock of so many Hz.
    #[must_use]
    pub fn new(clock_hz: u32) -> Self {
        Self {
            clock_hz,
            mcr: DBF | SLEEP,
            flags: 0,
            ier: 0,
            btr: 0x0123_0000,
            mode: Mode::Sleep,
            recessive: 0,
            activity: None,
            mailboxes: Mailboxes::new(),
            fifos: [Fifo::new(), Fifo::new()],
            filters: Filters::new(),
            faults: Faults::new(),
            accepted: Vec::new(),
            violations: Vec::new(),
        }
    }

    /// What has passed its filters since reset, lost in a FIFO or not.
    #[must_use]
    pub fn accepted(&self) -> &[WireFrame] {
        &self.accepted
    }

    /// What the driver did that the manual forbids and the hardware ignores.
    #[must_use]
    pub fn violations(&self) -> &[String] {
        &self.violations
    }

    /// The times of a bit as they are set up.
    #[must_use]
    pub fn bit_timing(&self) -> BitTiming {
        let field = |at: u32, bits: u32| (self.btr >> at & ((1 << bits) - 1)) + 1;
        let (before, behind) = (1 + field(16, 4), field(20, 3));
        let quanta = before + behind;
        BitTiming {
            rate: self.clock_hz / (field(0, 10) * quanta),
            sample_point: 1_000 * before / quanta,
            jump: field(24, 2),
            quanta,
        }
    }

    /// The register at this offset, as the core loads it.
    ///
    /// # Errors
    /// When there is none.
    pub fn load(&mut self, offset: u32) -> Result<u32> {
        Ok(match offset {
            MCR => self.mcr,
            MSR => self.msr(),
            TSR => self.mailboxes.tsr(self.by_request()),
            RF0R => self.fifos[0].rfr(),
            RF1R => self.fifos[1].rfr(),
            IER => self.ier,
            ESR => self.faults.esr(),
            BTR => self.btr,
            MAILBOX..FIFO_0 => self.mailboxes.load(offset - MAILBOX),
            FIFO_0..FIFO_1 => self.fifos[0].load(offset - FIFO_0),
            FIFO_1..0x1D0 => self.fifos[1].load(offset - FIFO_1),
            FILTERS.. => self.filters.load(offset - FILTERS)?,
            _ => bail!("bxCAN has no register at {offset:#05X}"),
        })
    }

    /// The core stores to the register at this offset.
    ///
    /// # Errors
    /// When there is none, or what is asked for is not modelled.
    pub fn store(&mut self, offset: u32, value: u32) -> Result<()> {
        match offset {
            MCR => self.store_mcr(value)?,
            // 46.9.2: each is cleared by a 1.
            MSR => self.flags &= !value,
            TSR => self.mailboxes.store_tsr(value),
            RF0R => self.fifos[0].store_rfr(value),
            RF1R => self.fifos[1].store_rfr(value),
            IER => self.ier = value & IER_BITS,
            ESR => self.faults.store_esr(value),
            BTR => self.store_btr(value)?,
            MAILBOX..FIFO_0 => {
                if !self.mailboxes.store(offset - MAILBOX, value)? {
                    self.forbidden(format!(
                        "46.9.3: a mailbox that is not empty was written to, at {offset:#05X}"
                    ));
                }
            }
            FIFO_0..0x1D0 => self.forbidden(format!("46.9.3: a FIFO was written to, at {offset:#05X}")),
            FILTERS.. => {
                if !self.filters.store(offset - FILTERS, value)? {
                    self.forbidden(format!("46.7.4: a filter that is in use was changed, at {offset:#05X}"));
                }
            }
            _ => bail!("bxCAN has no register at {offset:#05X}"),
        }
        Ok(())
    }

    /// The lines to the core, in the order of [`LINES`]: transmit, FIFO 0, FIFO 1, status change and errors (46.8).
    #[must_use]
    pub fn interrupts(&self) -> [bool; 4] {
        let fifo = |number: usize| {
            // FMPIE, FFIE and FOVIE of FIFO 0 are bits 1 to 3, those of FIFO 1 bits 4 to 6.
            let enabled = self.ier >> (1 + 3 * number) & 0b111;
            enabled & self.fifos[number].events() != 0
        };
        let status = [(ERRIE, ERRI), (WKUIE, WKUI), (SLKIE, SLAKI)];
        [
            self.ier & TMEIE != 0 && self.mailboxes.any_request_completed(),
            fifo(0),
            fifo(1),
            status.iter().any(|(enable, flag)| self.ier & enable != 0 && self.flags & flag != 0),
        ]
    }

    fn forbidden(&mut self, what: String) {
        self.violations.push(what);
    }

    /// Whether messages go in the order in which they were asked for, not by their identifiers (46.7.1).
    fn by_request(&self) -> bool {
        self.mcr & TXFP != 0
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
        mode | self.flags | activity | RX_AND_SAMP
    }

    fn store_mcr(&mut self, value: u32) -> Result<()> {
        if value & RESET != 0 {
            // 46.9.2: as after reset; the filters stay.
            let filters = self.filters.clone();
            let violations = std::mem::take(&mut self.violations);
            *self = Self { filters, violations, ..Self::new(self.clock_hz) };
            return Ok(());
        }
        ensure!(value & TTCM == 0, "time triggered communication is not modelled");
        self.mcr = value & MCR_BITS;
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

    /// Enters the mode that MCR asks for, unless a frame is under way: that goes on to its end (46.4.1, 46.4.3).
    fn change_mode(&mut self) {
        if self.activity.is_some() {
            return;
        }
        let asked = (self.mcr & INRQ != 0, self.mcr & SLEEP != 0);
        match (self.mode, asked) {
            // 46.4.3: sleep is left only when SLEEP is cleared.
            (Mode::Sleep, (_, true)) | (Mode::Initialisation, (true, _)) => {}
            (_, (true, false)) => self.enter(Mode::Initialisation),
            (_, (_, true)) => self.enter(Mode::Sleep),
            (Mode::Sleep, (false, false)) => self.enter(Mode::Synchronising { from: SLAK }),
            (Mode::Initialisation, (false, false)) => self.enter(Mode::Synchronising { from: INAK }),
            (Mode::Synchronising { .. } | Mode::Normal, (false, false)) => {}
        }
    }

    fn enter(&mut self, mode: Mode) {
        match mode {
            Mode::Sleep => {
                if self.ier & SLKIE != 0 {
                    self.flags |= SLAKI;
                }
            }
            Mode::Initialisation => self.flags &= !SLAKI,
            Mode::Synchronising { from } => {
                self.recessive = 0;
                if from == INAK {
                    // 46.7.6: set and cleared, INRQ starts the way out of bus-off.
                    self.faults.begin_recovery();
                }
            }
            Mode::Normal => self.flags &= !SLAKI,
        }
        self.mode = mode;
    }

    /// A frame ends with as many recessive bits as a controller synchronises to.
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
        self.mode == Mode::Normal && !self.faults.is_off()
    }

    fn next_transmission(&self) -> Option<Transmission> {
        if self.takes_part() { self.mailboxes.next(self.by_request()) } else { None }
    }

    fn begin_transmission(&mut self, mailbox: usize) {
        self.activity = Some(Activity::Transmitting);
        self.mailboxes.begin(mailbox);
    }

    fn begin_reception(&mut self, lost: Option<usize>) {
        self.recessive = 0;
        if let Some(mailbox) = lost {
            let is_once = self.mcr & NART != 0;
            self.mailboxes.lose(mailbox, is_once);
        }
        if self.takes_part() {
            self.activity = Some(Activity::Receiving);
        }
        if self.mode == Mode::Sleep {
            self.flags |= WKUI;
            // 46.4.3: with AWUM the hardware clears SLEEP.
            if self.mcr & AWUM != 0 {
                self.mcr &= !SLEEP;
                self.change_mode();
            }
        }
    }

    fn end_transmission(&mut self, mailbox: usize) {
        self.mailboxes.complete(mailbox);
        self.faults.transmitted();
        self.end_activity();
    }

    fn fail_transmission(&mut self, mailbox: usize, why: ErrorCode) {
        let is_once = self.mcr & NART != 0;
        self.mailboxes.fail(mailbox, is_once);
        if self.faults.transmit_error(why, self.ier, self.mcr & ABOM != 0) {
            self.flags |= ERRI;
        }
        self.end_activity();
    }

    fn end_reception(&mut self, frame: &WireFrame) {
        if self.activity == Some(Activity::Receiving) {
            self.faults.received();
            if let Some((fifo, index)) = self.filters.pass(frame) {
                self.fifos[fifo].put(frame, index, self.mcr & RFLM != 0);
                self.accepted.push(*frame);
            }
        }
        self.end_activity();
    }

    fn fail_reception(&mut self, why: ErrorCode) {
        if self.activity == Some(Activity::Receiving) && self.faults.receive_error(why, self.ier) {
            self.flags |= ERRI;
        }
        self.end_activity();
    }

    fn idle(&mut self, bits: u32) {
        let before = self.recessive;
        self.recessive = before.saturating_add(bits);
        if let Mode::Synchronising { .. } = self.mode
            && self.recessive >= BITS_TO_SYNCHRONISE
        {
            self.enter(Mode::Normal);
        }
        if self.mode == Mode::Normal {
            let sequences = self.recessive / BITS_TO_SYNCHRONISE - before / BITS_TO_SYNCHRONISE;
            self.faults.heard_recessive(sequences);
        }
    }
}

#[cfg(test)]
mod tests;
