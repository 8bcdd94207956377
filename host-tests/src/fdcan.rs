//! Model of FDCAN1, the STM32G474's CAN controller, per chapter 44 of ST's RM0440 Rev 4: its registers, its message
//! RAM and its behaviour on a bus.
//!
//! The bus of [`can_bus`](crate::can_bus) reports when a frame begins, ends or fails. The model rejects all options
//! beyond classic CAN: FD frames, test modes, bus monitoring, transmit pause, edge filtering, timestamps, the
//! time-out counter and the TX event FIFO. [`Fdcan::violations`] lists the accesses that the manual forbids.

mod filters;
mod transmit;

use std::collections::BTreeMap;
use std::ops::Range;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use embedded_can::Id;

use self::transmit::Requests;
use crate::can_bus::CanBus;
use crate::can_controller::{
    BITS_TO_SYNCHRONISE, BitTiming, BusController, Confinement, ErrorCode, Transmission, count_sequences,
};
use crate::can_wire::WireFrame;
use crate::chance::Chance;
use crate::load_store::Width;
use crate::registers::{RegisterModel, ensure_word};

/// Base address and length of the registers.
const FDCAN1: u32 = 0x4000_6400;
const LEN: u32 = 0x400;

/// Interrupt numbers of line 0 and line 1.
pub const LINES: [u8; 2] = [21, 22];

/// Kernel clock of the NUCLEO-G474RE: its crystal.
pub const HSE_HZ: u32 = 24_000_000;

/// Register offsets (44.4).
const CCCR: u32 = 0x18;
const NBTP: u32 = 0x1C;
const ECR: u32 = 0x40;
const PSR: u32 = 0x44;
const IR: u32 = 0x50;
const IE: u32 = 0x54;
const ILS: u32 = 0x58;
const ILE: u32 = 0x5C;
const RXGFC: u32 = 0x80;
const XIDAM: u32 = 0x84;
const RXF0S: u32 = 0x90;
const RXF0A: u32 = 0x94;
const RXF1S: u32 = 0x98;
const RXF1A: u32 = 0x9C;
const TXBC: u32 = 0xC0;
const TXFQS: u32 = 0xC4;
const TXBRP: u32 = 0xC8;
const TXBAR: u32 = 0xCC;
const TXBCR: u32 = 0xD0;
const TXBTO: u32 = 0xD4;
const TXBCF: u32 = 0xD8;
const TXBTIE: u32 = 0xDC;
const TXBCIE: u32 = 0xE0;
const CKDIV: u32 = 0x100;

/// Registers without side effects: offset, value after reset, modelled bits, and whether they are protected (P), that
/// is, writable only while INIT and CCE are set. DBTP, TEST, RWD, TSCC, TOCC and TDCR have no names above.
const PLAIN: [(u32, u32, u32, bool); 16] = [
    (0x0C, 0x0000_0A33, 0, true),
    (0x10, 0, 0, false),
    (0x14, 0, 0, true),
    (NBTP, 0x0600_0A03, 0xFFFF_FF7F, true),
    (0x20, 0, 0x000F_0000, true),
    (0x28, 0xFFFF_0000, 0xFFFF_0006, true),
    (0x48, 0, 0, true),
    (IE, 0, 0x00FF_FFFF, false),
    (ILS, 0, 0x7F, false),
    (ILE, 0, 0b11, false),
    (RXGFC, 0, 0x0F1F_033F, true),
    (XIDAM, 0x1FFF_FFFF, 0x1FFF_FFFF, true),
    (TXBC, 0, TFQM, true),
    (TXBTIE, 0, 0b111, false),
    (TXBCIE, 0, 0b111, false),
    (CKDIV, 0, 0xF, true),
];

/// Bits of CCCR (44.4.6).
const INIT: u32 = 1 << 0;
const CCE: u32 = 1 << 1;
const ASM: u32 = 1 << 2;
const CSA: u32 = 1 << 3;
const CSR: u32 = 1 << 4;
const DAR: u32 = 1 << 6;
const PXHD: u32 = 1 << 12;
const CCCR_BITS: u32 = INIT | CCE | ASM | CSA | CSR | DAR | PXHD;

/// Bits of PSR (44.4.13). The flags of IR that report their changes are twelve bits higher.
const EP: u32 = 1 << 5;
const EW: u32 = 1 << 6;
const BO: u32 = 1 << 7;

/// Flags of IR (44.4.15). The flags of FIFO 1 are three bits higher.
const RF0N: u32 = 1 << 0;
const RF0F: u32 = 1 << 1;
const RF0L: u32 = 1 << 2;
const HPM: u32 = 1 << 6;
const MRAF: u32 = 1 << 14;
const ELO: u32 = 1 << 16;
const PEA: u32 = 1 << 21;

/// Flags of IR in the groups of ILS (44.4.17): RXFIFO0, RXFIFO1, SMSG, TFERR, MISC, BERR, PERR.
const GROUPS: [u32; 7] = [0x7, 0x38, 0x1C0, 0x1E00, 0xE000, 0x3_0000, 0xFC_0000];

/// RXGFC: overwrite mode of FIFO 0; the bit of FIFO 1 is the next lower one. TXBC: queue mode.
const F0OM: u32 = 1 << 9;
const TFQM: u32 = 1 << 24;

/// The message RAM (44.3.3): offset of its address 4000A400h, and its sections in words after the standard filters.
const RAM: u32 = 0x4000;
const EXTENDED_FILTERS: usize = 0x70 / 4;
const RX_FIFOS: usize = 0xB0 / 4;
const TX_BUFFERS: usize = 0x278 / 4;
const RAM_WORDS: usize = 0x350 / 4;
/// Number and length of the elements of a FIFO and of the TX buffers.
const ELEMENTS: usize = 3;
const ELEMENT_WORDS: usize = 18;
const _: () = assert!(TX_BUFFERS + ELEMENTS * ELEMENT_WORDS == RAM_WORDS);

/// Bits of R0 and T0 (44.3.5, 44.3.6).
const RTR: u32 = 1 << 29;
const XTD: u32 = 1 << 30;

/// Sequences of 11 recessive bits that end bus-off, and LEC after it was read (44.4.13).
const RECOVERY: u32 = 129;
const NO_CHANGE: u32 = 7;

/// Activity, numbered as ACT in PSR (44.4.13).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Activity {
    /// Off the bus, or waiting for recessive bits.
    Synchronising,
    Idle,
    Receiving,
    Transmitting,
}

/// Get index and fill level of a receive FIFO.
#[derive(Clone, Copy, Debug, Default)]
struct RxFifo {
    get: usize,
    fill: usize,
}

/// The FDCAN controller.
#[derive(Clone, Debug)]
pub struct Fdcan {
    kernel_hz: u32,
    cccr: u32,
    /// Loads of CCCR that read back a new INIT: the first one still returns the previous value.
    init_loads: u8,
    /// Content of the registers in [`PLAIN`].
    registers: BTreeMap<u32, u32>,
    ir: u32,
    ram: [u32; RAM_WORDS],
    rubbish: Chance,
    fifos: [RxFifo; 2],
    requests: Requests,
    activity: Activity,
    recessive: u32,
    faults: Confinement,
    /// LEC and CEL.
    last_error: u32,
    logged: u32,
    accepted: Vec<WireFrame>,
    violations: Vec<String>,
}

impl Fdcan {
    /// Creates a controller after power-on with this kernel clock in Hz. Its message RAM holds rubbish, always the
    /// same.
    #[must_use]
    pub fn new(kernel_hz: u32) -> Self {
        let mut rubbish = Chance::new(u64::from(FDCAN1));
        Self {
            kernel_hz,
            cccr: INIT,
            init_loads: 0,
            registers: PLAIN.iter().map(|&(offset, reset, ..)| (offset, reset)).collect(),
            ir: 0,
            ram: std::array::from_fn(|_| rubbish.number() as u32),
            rubbish,
            fifos: Default::default(),
            requests: Requests::default(),
            activity: Activity::Synchronising,
            recessive: 0,
            faults: Confinement::default(),
            last_error: NO_CHANGE,
            logged: 0,
            accepted: Vec::new(),
            violations: Vec::new(),
        }
    }

    /// Returns all messages accepted by a filter since reset, including any lost in a FIFO.
    #[must_use]
    pub fn accepted(&self) -> &[WireFrame] {
        &self.accepted
    }

    /// Returns the driver's accesses that the manual forbids.
    #[must_use]
    pub fn violations(&self) -> &[String] {
        &self.violations
    }

    /// Returns the configured bit timing (44.4.7, 44.4.37).
    #[must_use]
    pub fn bit_timing(&self) -> BitTiming {
        let nbtp = self.registers[&NBTP];
        let field = |at: u32, bits: u32| (nbtp >> at & ((1 << bits) - 1)) + 1;
        let divider = (2 * self.registers[&CKDIV]).max(1);
        BitTiming::new(self.kernel_hz, divider * field(16, 9), [1 + field(8, 8), field(0, 7)], field(25, 7))
    }

    /// Simulates a message RAM that responds too late to the Tx handler: enters restricted operation (44.4.15).
    pub fn fail_ram_access(&mut self) {
        self.cccr |= ASM;
        self.ir |= MRAF;
    }

    /// Loads the register at this offset, or the word of the message RAM, whose first offset is 4000h.
    ///
    /// # Errors
    /// Fails when no such register is modelled.
    pub fn load(&mut self, offset: u32) -> Result<u32> {
        Ok(match offset {
            // CREL, ENDN.
            0x00 => 0x3214_1218,
            0x04 => 0x8765_4321,
            CCCR => self.load_cccr(),
            ECR => self.load_ecr(),
            PSR => self.load_psr(),
            IR => self.ir,
            RXF0S | RXF1S => self.rxfs(usize::from(offset == RXF1S)),
            TXFQS => self.txfqs(),
            TXBRP => self.requests.pending,
            // Requests take effect at once.
            TXBAR => 0,
            TXBCR => self.requests.to_cancel,
            TXBTO => self.requests.occurred,
            TXBCF => self.requests.cancelled,
            RAM.. => *self.ram.get((offset - RAM) as usize / 4).with_context(|| unknown(offset))?,
            _ => *self.registers.get(&offset).with_context(|| unknown(offset))?,
        })
    }

    /// Stores to the register at this offset, or to the word of the message RAM, whose first offset is 4000h.
    ///
    /// # Errors
    /// Fails when the register or the requested option is not modelled.
    pub fn store(&mut self, offset: u32, value: u32) -> Result<()> {
        match offset {
            CCCR => return self.store_cccr(value),
            IR => self.ir &= !value,
            RXF0A | RXF1A => self.acknowledge(usize::from(offset == RXF1A), value as usize),
            TXBAR => return self.add_requests(value),
            TXBCR => self.cancel_requests(value),
            RAM.. => return self.store_ram(offset, value),
            _ => {
                let plain = PLAIN.into_iter().find(|plain| plain.0 == offset);
                let (_, reset, bits, is_protected) = plain.with_context(|| unknown(offset))?;
                if is_protected && !self.is_configurable() {
                    self.forbidden(&format!("44.4: {offset:#05X} is protected without INIT and CCE"));
                    return Ok(());
                }
                let rejected = (value ^ reset) & !bits;
                ensure!(rejected == 0, "{value:#X} at {offset:#05X} selects options that are not modelled");
                self.registers.insert(offset, value);
            }
        }
        Ok(())
    }

    /// Returns the interrupt levels in the order of [`LINES`] (44.4.16 to 44.4.18).
    #[must_use]
    pub fn interrupts(&self) -> [bool; 2] {
        let [raised, ils, ile] = [IE, ILS, ILE].map(|offset| self.registers[&offset]);
        let of_line_1 = (0..GROUPS.len()).filter(|n| ils >> n & 1 == 1).fold(0, |flags, n| flags | GROUPS[n]);
        let raised = raised & self.ir;
        [raised & !of_line_1 != 0 && ile & 0b01 != 0, raised & of_line_1 != 0 && ile & 0b10 != 0]
    }

    fn forbidden(&mut self, what: &str) {
        self.violations.push(what.into());
    }

    const fn is_configurable(&self) -> bool {
        self.cccr & (INIT | CCE) == INIT | CCE
    }

    /// The core may always store to the RAM (44.3.4), but these words belong to the handlers.
    fn store_ram(&mut self, offset: u32, value: u32) -> Result<()> {
        let word = (offset - RAM) as usize / 4;
        *self.ram.get_mut(word).with_context(|| unknown(offset))? = value;
        let buffer = word.checked_sub(TX_BUFFERS).map(|word| word / ELEMENT_WORDS);
        let is_owned = word >= RX_FIFOS && buffer.is_none_or(|buffer| self.requests.is_pending(buffer));
        if is_owned && !self.is_configurable() {
            self.forbidden(&format!("44.3.3: {offset:#05X} is in a FIFO or in a TX buffer with a request"));
        }
        Ok(())
    }

    /// 44.3.2, 44.4.6
    fn load_cccr(&mut self) -> u32 {
        let is_late = self.init_loads == 2;
        self.init_loads = self.init_loads.saturating_sub(1);
        if is_late { self.cccr ^ INIT } else { self.cccr }
    }

    fn store_cccr(&mut self, value: u32) -> Result<()> {
        ensure!(value & !CCCR_BITS == 0, "CCCR {value:#X}: a mode is not modelled");
        let was = self.cccr;
        let mut new = value & !CSA | was & CSA;
        if new & !was & CCE != 0 && (was & new & INIT == 0 || self.init_loads > 0) {
            self.forbidden("44.3.2: CCE is set before INIT reads 1");
            new &= !CCE;
        }
        if (new & !was & ASM != 0 || (new ^ was) & (DAR | PXHD) != 0) && !self.is_configurable() {
            self.forbidden("44.4.6: ASM is set, or DAR or PXHD is changed, without INIT and CCE");
            let ignored = ASM | DAR | PXHD;
            new = new & !ignored | was & ignored;
        }
        if was & !new & INIT != 0 && was & CSA != 0 {
            self.forbidden("44.3.2: INIT is cleared while CSA is set");
            new |= INIT;
        }
        if (new ^ was) & INIT != 0 {
            if self.init_loads > 0 {
                self.forbidden("44.4.6: INIT is changed before its last value is read back");
            }
            let is_sending = self.activity == Activity::Transmitting;
            ensure!(!is_sending, "CCCR: a transmission that INIT truncates is not modelled");
            self.init_loads = 2;
            (self.activity, self.recessive) = (Activity::Synchronising, 0);
            if new & INIT == 0 {
                self.faults.begin_recovery(RECOVERY);
            }
        }
        if new & INIT == 0 {
            new &= !CCE;
        }
        if new & CSR == 0 {
            new &= !CSA;
        }
        if new & !was & CCE != 0 {
            (self.fifos, self.requests) = (Default::default(), Requests::default());
        }
        self.cccr = new;
        self.stop_clock();
        Ok(())
    }

    /// Grants a requested clock stop after all transmissions, on an idle bus (44.3.2).
    fn stop_clock(&mut self) {
        let is_idle = self.activity == Activity::Idle && self.requests.pending == 0;
        if self.cccr & CSR != 0 && (self.cccr & INIT != 0 || is_idle) {
            self.cccr |= INIT | CSA;
            self.activity = Activity::Synchronising;
        }
    }

    /// Returns BO, EW and EP.
    fn states(&self) -> u32 {
        let Confinement { transmit, receive, is_off, .. } = self.faults;
        let highest = transmit.max(receive);
        [(EP, Confinement::is_passive(highest)), (EW, Confinement::warns(highest)), (BO, is_off)]
            .iter()
            .fold(0, |bits, (bit, is_set)| if *is_set { bits | bit } else { bits })
    }

    /// Loads PSR, which resets LEC. DLEC stays reset.
    fn load_psr(&mut self) -> u32 {
        let last = std::mem::replace(&mut self.last_error, NO_CHANGE);
        last | (self.activity as u32) << 3 | self.states() | NO_CHANGE << 8
    }

    /// Loads ECR, which resets CEL (44.4.12). During recovery, REC counts its sequences (44.4.13).
    fn load_ecr(&mut self) -> u32 {
        let Confinement { transmit, receive, to_recover, .. } = self.faults;
        let receive = to_recover.map_or(receive.into(), |left| RECOVERY - left);
        let counters = u32::from(transmit.min(255)) | receive.min(127) << 8 | u32::from(receive > 127) << 15;
        counters | std::mem::take(&mut self.logged) << 16
    }

    /// Changes the error counters. Reports changed states, and leaves the bus when it is off.
    fn count(&mut self, event: impl FnOnce(&mut Confinement)) {
        let before = self.states();
        event(&mut self.faults);
        let changed = before ^ self.states();
        self.ir |= changed << 12;
        if self.faults.is_off && changed & BO != 0 {
            self.cccr |= INIT;
            (self.init_loads, self.activity) = (0, Activity::Synchronising);
        }
    }

    /// Counts a frame or, with a cause, an error. Restricted operation freezes the counters, but logs errors
    /// (44.4.12).
    fn frame_ended(&mut self, why: Option<ErrorCode>, event: impl FnOnce(&mut Confinement)) {
        self.last_error = why.map_or(0, |why| why as u32);
        let (before, is_frozen) = ((self.faults.transmit, self.faults.receive), self.cccr & ASM != 0);
        if !is_frozen {
            self.count(event);
        }
        if why.is_some() {
            let is_counted = is_frozen || (self.faults.transmit, self.faults.receive) != before;
            let overflow = if is_counted && self.logged == 0xFF { ELO } else { 0 };
            self.logged = (self.logged + u32::from(is_counted)).min(0xFF);
            self.ir |= PEA | overflow;
        }
        if self.takes_part() {
            self.activity = Activity::Idle;
        }
    }

    /// A frame ends with as many recessive bits as synchronisation requires.
    fn end_activity(&mut self) {
        self.recessive = 0;
        self.idle(BITS_TO_SYNCHRONISE);
    }

    /// Returns RXFnS (44.4.22); RFnL copies the flag of IR.
    fn rxfs(&self, number: usize) -> u32 {
        let RxFifo { get, fill } = self.fifos[number];
        let put = (get + fill) % ELEMENTS;
        let status = fill | get << 8 | put << 16 | usize::from(fill == ELEMENTS) << 24;
        status as u32 | (self.ir >> (3 * number) & RF0L) << 23
    }

    /// Frees the elements up to this one (44.3.4).
    fn acknowledge(&mut self, number: usize, index: usize) {
        let RxFifo { get, fill } = self.fifos[number];
        let read = (index % ELEMENTS + ELEMENTS - get) % ELEMENTS + 1;
        if index >= ELEMENTS || read > fill {
            return self.forbidden(&format!("44.3.4: element {index} of FIFO {number} holds no message"));
        }
        self.fifos[number] = RxFifo { get: (index + 1) % ELEMENTS, fill: fill - read };
    }

    /// Stores an accepted message, except in a full FIFO that is not in overwrite mode (44.3.3).
    fn put(&mut self, number: usize, filter: Option<u32>, frame: &WireFrame) {
        let RxFifo { mut get, mut fill } = self.fifos[number];
        if fill == ELEMENTS {
            if self.registers[&RXGFC] & F0OM >> number == 0 {
                self.ir |= RF0L << (3 * number);
                return;
            }
            (get, fill) = ((get + 1) % ELEMENTS, fill - 1);
        }
        let at = RX_FIFOS + (number * ELEMENTS + (get + fill) % ELEMENTS) * ELEMENT_WORDS;
        let element = self.element(filter, frame);
        self.ram[at..at + element.len()].copy_from_slice(&element);
        self.fifos[number] = RxFifo { get, fill: fill + 1 };
        self.ir |= (RF0N | if fill + 1 == ELEMENTS { RF0F } else { 0 }) << (3 * number);
    }

    /// Returns R0 to R3, with rubbish in the unused bits (44.3.5).
    fn element(&mut self, filter: Option<u32>, frame: &WireFrame) -> [u32; 4] {
        let (id, of_id) = match frame.id {
            Id::Standard(id) => (u32::from(id.as_raw()) << 18, !0x3_FFFF),
            Id::Extended(id) => (id.as_raw() | XTD, u32::MAX),
        };
        let id = if frame.is_remote { id | RTR } else { id };
        // ANMF is set, and FIDX is invalid, without a matching filter.
        let (r1, of_r1) = filter.map_or((1 << 31, 0x803F_FFFF), |filter| (filter << 24, 0xFF3F_FFFF));
        let (r1, [low, high], len) = (r1 | u32::from(frame.dlc) << 16, frame.words(), frame.payload().len());
        let bytes = |from: usize| ((1_u64 << (8 * len.saturating_sub(from).min(4))) - 1) as u32;
        [(id, of_id), (r1, of_r1), (low, bytes(0)), (high, bytes(4))]
            .map(|(word, used)| word & used | self.rubbish.number() as u32 & !used)
    }
}

fn unknown(offset: u32) -> String {
    format!("FDCAN: no such register is modelled at {offset:#05X}")
}

impl BusController for Fdcan {
    fn rate(&self) -> u32 {
        self.bit_timing().rate
    }

    fn takes_part(&self) -> bool {
        self.activity != Activity::Synchronising
    }

    fn next_transmission(&self) -> Option<Transmission> {
        // 44.3.2: restricted operation sends no frames.
        if self.takes_part() && self.cccr & ASM == 0 { self.next_request() } else { None }
    }

    fn begin_transmission(&mut self, mailbox: usize) {
        self.activity = Activity::Transmitting;
        self.requests.sending = mailbox;
    }

    fn begin_reception(&mut self, lost: Option<usize>) {
        self.recessive = 0;
        if let Some(buffer) = lost {
            self.retry(buffer);
        }
        if self.takes_part() {
            self.activity = Activity::Receiving;
        }
    }

    fn end_transmission(&mut self, mailbox: usize) {
        self.finish(mailbox, true);
        self.frame_ended(None, Confinement::transmitted);
        self.end_activity();
    }

    fn fail_transmission(&mut self, mailbox: usize, why: ErrorCode) {
        self.retry(mailbox);
        self.frame_ended(Some(why), |faults| faults.transmit_error(why));
        self.end_activity();
    }

    fn end_reception(&mut self, frame: &WireFrame) {
        if self.activity == Activity::Receiving {
            self.filter(frame);
            self.frame_ended(None, Confinement::received);
        }
        self.end_activity();
    }

    fn fail_reception(&mut self, why: ErrorCode) {
        if self.activity == Activity::Receiving {
            self.frame_ended(Some(why), Confinement::receive_error);
        }
        self.end_activity();
    }

    fn idle(&mut self, bits: u32) {
        let sequences = count_sequences(&mut self.recessive, bits);
        if self.cccr & INIT == 0 && sequences > 0 {
            if self.faults.is_off {
                self.last_error = ErrorCode::BitDominant as u32;
                self.count(|faults| faults.count_recessive(sequences));
            }
            if !self.faults.is_off && !self.takes_part() {
                self.activity = Activity::Idle;
            }
        }
        self.stop_clock();
    }
}

/// The addresses of a controller on a bus: its registers, or its message RAM.
#[derive(Debug)]
struct Window(CanBus<Fdcan>, Range<u32>);

impl CanBus<Fdcan> {
    /// Returns the models of the controller's registers and of its message RAM.
    #[must_use]
    pub fn models(&self) -> Vec<Box<dyn RegisterModel>> {
        let window = |start: u32, len: u32| -> Box<dyn RegisterModel> {
            Box::new(Window(self.clone(), start..start + len))
        };
        vec![window(FDCAN1, LEN), window(FDCAN1 + RAM, 4 * RAM_WORDS as u32)]
    }
}

impl Window {
    /// Accesses a word; other widths are faults.
    fn act<T>(&self, address: u32, width: Width, what: impl FnOnce(&mut Fdcan) -> Result<T>) -> Result<T> {
        self.0.act(|can| {
            ensure_word(address, width).inspect_err(|error| can.forbidden(&error.to_string()))?;
            what(can)
        })
    }
}

impl RegisterModel for Window {
    fn addresses(&self) -> Range<u32> {
        self.1.clone()
    }

    fn load(&mut self, address: u32, width: Width) -> Result<u32> {
        self.act(address, width, |can| can.load(address - FDCAN1))
    }

    fn store(&mut self, address: u32, width: Width, value: u32) -> Result<()> {
        self.act(address, width, |can| can.store(address - FDCAN1, value))
    }

    fn advance(&mut self, time: Duration) {
        // Once for both windows.
        if self.1.start == FDCAN1 {
            self.0.pass(time);
        }
    }

    fn interrupts(&self) -> Vec<(u8, bool)> {
        LINES.into_iter().zip(self.0.act(|can| can.interrupts())).collect()
    }

    fn has_unread_data(&self) -> bool {
        // Off the bus, no FIFO overruns.
        self.0.act(|can| can.takes_part() && can.fifos.iter().any(|fifo| fifo.fill > 0))
    }

    fn reset(&mut self) {
        // The message RAM and the findings remain.
        self.0.reset_with(|can| {
            let (ram, violations) = (can.ram, std::mem::take(&mut can.violations));
            *can = Fdcan { ram, violations, ..Fdcan::new(can.kernel_hz) };
        });
    }
}

#[cfg(test)]
mod tests;
