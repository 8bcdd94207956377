//! Model of FDCAN1, the STM32G474's CAN controller, per chapter 44 of ST's RM0440 Rev 4: its registers, its message
//! RAM and its behaviour on a bus.
//!
//! The bus of [`can_bus`](crate::can_bus) reports when a frame begins, ends or fails. The model rejects options that
//! drivers for classic CAN do not use, such as FD frames, single transmission, clock stop, test modes, overwriting
//! FIFOs and timestamps. [`violations`](BusController::violations) lists the accesses that the manual forbids.
//!
//! Only excerpts of RM0440 were available: pages 1960, 1962, 1970 to 1973 and 1999 of Rev 4. Bit positions follow ST's header, the
//! layout of the RAM ST's HAL, and other rules a public digest of RM0522 (STM32C5, chapter 46), which has the same controller.
//! The author of this model has not read the driver.

mod filters;
mod transmit;

use std::ops::Range;

use anyhow::{Result, bail, ensure};

use crate::can_controller::{
    Activity, Attempt, BitTiming, BusController, CAN1, Confinement, ErrorCode, MappedController, Node,
    Transmission,
};
use crate::can_wire::{MAX_DATA, WireFrame};
use crate::chance::Chance;

/// Kernel clock of the NUCLEO-G474RE: its crystal.
pub const HSE_HZ: u32 = 24_000_000;

/// Registers (44.4), numbered by words.
const CCCR: usize = 0x18 / 4;
const NBTP: usize = 0x1C / 4;
const ECR: usize = 0x40 / 4;
const PSR: usize = 0x44 / 4;
const IR: usize = 0x50 / 4;
const IE: usize = 0x54 / 4;
const ILS: usize = 0x58 / 4;
const ILE: usize = 0x5C / 4;
const RXGFC: usize = 0x80 / 4;
const RXF0S: usize = 0x90 / 4;
const RXF0A: usize = 0x94 / 4;
const RXF1S: usize = 0x98 / 4;
const RXF1A: usize = 0x9C / 4;
const TXBC: usize = 0xC0 / 4;
const TXFQS: usize = 0xC4 / 4;
const TXBRP: usize = 0xC8 / 4;
const TXBAR: usize = 0xCC / 4;
const TXBCR: usize = 0xD0 / 4;
const TXBTO: usize = 0xD4 / 4;
const TXBCF: usize = 0xD8 / 4;
const TXBTIE: usize = 0xDC / 4;

/// Bits of CCCR (44.4.6), and queue mode in TXBC.
const INIT: u32 = 1 << 0;
const CCE: u32 = 1 << 1;
const ASM: u32 = 1 << 2;
const TFQM: u32 = 1 << 24;

/// EW, EP and BO in PSR (44.4.13). The flags of IR that report their changes are twelve bits higher.
const STATES: [u32; 3] = [1 << 6, 1 << 5, 1 << 7];

/// Flags of IR (44.4.15). The flags of FIFO 1 are three bits higher.
const RF0N: u32 = 1 << 0;
const RF0F: u32 = 1 << 1;
const RF0L: u32 = 1 << 2;
const HPM: u32 = 1 << 6;
const TC: u32 = 1 << 7;
const MRAF: u32 = 1 << 14;
const PEA: u32 = 1 << 21;

/// Flags of IR in the groups of ILS (44.4.17): RXFIFO0, RXFIFO1, SMSG, TFERR, MISC, BERR, PERR.
const GROUPS: [u32; 7] = [0x7, 0x38, 0x1C0, 0x1E00, 0xE000, 0x3_0000, 0xFC_0000];

/// The message RAM (44.3.3): number of its first word, at 4000A400h, and its sections after the standard filters.
const RAM: usize = 0x4000 / 4;
const RAM_END: usize = RAM + 0x350 / 4;
const EXTENDED_FILTERS: usize = 0x70 / 4;
const RX_FIFOS: usize = 0xB0 / 4;
const TX_BUFFERS: usize = 0x278 / 4;
/// Number and length of the elements of a FIFO and of the TX buffers.
const ELEMENTS: usize = 3;
const ELEMENT_WORDS: usize = 18;
const _: () = assert!(RAM + TX_BUFFERS + ELEMENTS * ELEMENT_WORDS == RAM_END);

/// Bits of R0 and T0 (44.3.5, 44.3.6).
const RTR: u32 = 1 << 29;
const XTD: u32 = 1 << 30;

/// Sequences of 11 recessive bits that end bus-off, and LEC after it was read (44.4.13).
const RECOVERY: u32 = 129;
const NO_CHANGE: u32 = 7;

/// The FDCAN controller.
#[derive(Clone, Debug)]
pub struct Fdcan {
    kernel_hz: u32,
    /// Of PSR, only the states.
    registers: [u32; TXBTIE + 1],
    ram: [u32; RAM_END - RAM],
    /// Get index and fill level of the receive FIFOs.
    fifos: [(usize, usize); 2],
    /// Put index of the TX buffers.
    put_index: usize,
    /// Its last error is LEC.
    node: Node,
}

impl Fdcan {
    /// Creates a controller after power-on with this kernel clock in Hz, and with reproducible rubbish in its RAM.
    #[must_use]
    pub fn new(kernel_hz: u32) -> Self {
        let mut registers = [0; TXBTIE + 1];
        (registers[CCCR], registers[NBTP]) = (INIT, 0x0600_0A03);
        let mut rubbish = Chance::new(u64::from(CAN1));
        Self {
            kernel_hz,
            registers,
            ram: std::array::from_fn(|_| rubbish.number() as u32),
            fifos: [(0, 0); 2],
            put_index: 0,
            node: Node { last_error: NO_CHANGE, ..Node::default() },
        }
    }

    /// Simulates a message RAM that responds too late to the Tx handler: enters restricted operation (44.4.15).
    pub fn fail_ram_access(&mut self) {
        self.registers[CCCR] |= ASM;
        self.registers[IR] |= MRAF;
    }

    /// 44.3.2, 44.4.6
    fn store_cccr(&mut self, value: u32) -> Result<()> {
        let (was, mut new) = (self.registers[CCCR], value);
        // The Tx handler enters restricted operation, and software leaves it.
        ensure!(new & !(INIT | CCE | was & ASM) == 0, "CCCR {value:#X}: a mode is not modelled");
        if new & !was & CCE != 0 && was & new & INIT == 0 {
            self.node.forbidden("44.3.2: CCE is set before INIT reads 1");
            new &= !CCE;
        }
        if new & CCE != 0 {
            (self.fifos, self.put_index) = ([(0, 0); 2], 0);
            self.registers[TXBRP..=TXBCF].fill(0);
        }
        if (new ^ was) & INIT != 0 {
            ensure!(
                self.node.activity != Activity::Transmitting,
                "CCCR: INIT in a transmission is not modelled"
            );
            self.node.synchronise();
            self.node.faults.begin_recovery(RECOVERY);
        }
        self.registers[CCCR] = if new & INIT == 0 { new & !CCE } else { new };
        Ok(())
    }

    /// Frees the elements up to this one (44.3.4).
    fn acknowledge(&mut self, number: usize, index: usize) {
        let (get, fill) = self.fifos[number];
        let read = (index % ELEMENTS + ELEMENTS - get) % ELEMENTS + 1;
        if index >= ELEMENTS || read > fill {
            return self.node.forbidden(format!("44.3.4: element {index} of FIFO {number} holds no message"));
        }
        self.fifos[number] = ((index + 1) % ELEMENTS, fill - read);
    }

    /// Stores an accepted message, except in a full FIFO (44.3.3). Unused bits keep their rubbish (44.3.5).
    fn put(&mut self, number: usize, filter: Option<u32>, frame: &WireFrame) {
        let (get, fill) = self.fifos[number];
        if fill == ELEMENTS {
            self.registers[IR] |= RF0L << (3 * number);
            return;
        }
        let (id, is_extended) = frame.id_bits();
        let (r0, of_r0) = if is_extended { (id | XTD, u32::MAX) } else { (id, !0x3_FFFF) };
        let r0 = if frame.is_remote { r0 | RTR } else { r0 };
        // ANMF is set, and FIDX is invalid, without a matching filter.
        let (r1, of_r1) = filter.map_or((1 << 31, 0x803F_FFFF), |filter| (filter << 24, 0xFF3F_FFFF));
        let r1 = r1 | u32::from(frame.dlc) << 16;
        let [low, high] = frame.words();
        let [of_low, of_high] = WireFrame::new(frame.id, &[0xFF; MAX_DATA][..frame.payload().len()]).words();
        let at = RX_FIFOS + (number * ELEMENTS + (get + fill) % ELEMENTS) * ELEMENT_WORDS;
        let element = [(r0, of_r0), (r1, of_r1), (low, of_low), (high, of_high)];
        for (word, (value, used)) in self.ram[at..].iter_mut().zip(element) {
            *word = value & used | *word & !used;
        }
        self.fifos[number].1 += 1;
        self.registers[IR] |= (RF0N | if fill + 1 == ELEMENTS { RF0F } else { 0 }) << (3 * number);
    }
}

impl BusController for Fdcan {
    fn node(&self) -> &Node {
        &self.node
    }

    fn node_mut(&mut self) -> &mut Node {
        &mut self.node
    }

    /// 44.4.7
    fn bit_timing(&self) -> BitTiming {
        let field = |at: u32, bits: u32| (self.registers[NBTP] >> at & ((1 << bits) - 1)) + 1;
        BitTiming::new(self.kernel_hz, field(16, 9), [1 + field(8, 8), field(0, 7)], field(25, 7))
    }

    fn next_request(&self) -> Option<Transmission> {
        // 44.3.2: restricted operation sends no frames.
        if self.registers[CCCR] & ASM == 0 { self.next_buffer() } else { None }
    }

    fn attempt_ended(&mut self, mailbox: usize, attempt: Attempt) {
        self.finish(mailbox, attempt == Attempt::Acknowledged);
    }

    fn accept(&mut self, frame: &WireFrame) -> bool {
        self.filter(frame)
    }

    fn frame_ended(&mut self, why: Option<ErrorCode>) {
        self.registers[IR] |= if why.is_some() { PEA } else { 0 };
        // 44.3.2: restricted operation freezes the counters.
        if self.registers[CCCR] & ASM == 0 {
            self.node.count(why);
        }
        self.registers[CCCR] |= if self.node.faults.is_off { INIT } else { 0 };
    }

    fn idle(&mut self, bits: u32) {
        let was_off = self.node.faults.is_off;
        if self.registers[CCCR] & INIT == 0 && self.node.idle(bits) && was_off {
            self.node.last_error = ErrorCode::BitDominant as u32;
        }
        let states = self.node.faults.states(STATES);
        self.registers[IR] |= (self.registers[PSR] ^ states) << 12;
        self.registers[PSR] = states;
    }
}

impl MappedController for Fdcan {
    const RAM: Range<u32> = CAN1 + 4 * RAM as u32..CAN1 + 4 * RAM_END as u32;
    const LINES: [u8; 2] = [21, 22];

    fn load(&mut self, offset: u32) -> Result<u32> {
        let number = offset as usize / 4;
        Ok(match number {
            // CEL is not modelled. During recovery, REC counts its sequences (44.4.13).
            ECR => {
                let Confinement { transmit, receive, to_recover, .. } = self.node.faults;
                let rec = to_recover.map_or(receive.into(), |left| RECOVERY - left);
                u32::from(transmit.min(255)) | rec.min(127) << 8 | u32::from(rec > 127) << 15
            }
            // Resets LEC. DLEC stays reset.
            PSR => {
                let lec = std::mem::replace(&mut self.node.last_error, NO_CHANGE);
                lec | (self.node.activity as u32) << 3 | self.registers[PSR] | NO_CHANGE << 8
            }
            // RFnL copies the flag of IR (44.4.22).
            RXF0S | RXF1S => {
                let fifo = usize::from(number == RXF1S);
                let (get, fill) = self.fifos[fifo];
                let (put, is_full) = ((get + fill) % ELEMENTS, usize::from(fill == ELEMENTS));
                let status = (is_full << 24 | put << 16 | get << 8 | fill) as u32;
                status | (self.registers[IR] >> (3 * fifo) & RF0L) << 23
            }
            TXFQS => self.txfqs(),
            // TXBAR stays reset: requests take effect at once.
            CCCR | NBTP | IR..=ILE | RXGFC | TXBC | TXBRP..=TXBTIE => self.registers[number],
            RAM..RAM_END => self.ram[number - RAM],
            _ => bail!("FDCAN: no register is modelled at {offset:#05X}"),
        })
    }

    fn store(&mut self, offset: u32, value: u32) -> Result<()> {
        let (number, is_open) = (offset as usize / 4, self.registers[CCCR] & CCE != 0);
        match number {
            CCCR => self.store_cccr(value)?,
            IR => self.registers[IR] &= !value,
            RXF0A | RXF1A => self.acknowledge(usize::from(number == RXF1A), value as usize),
            TXBAR | TXBCR if is_open => self.node.forbidden("44.3.2: a request while CCE is set"),
            TXBAR => self.add_requests(value)?,
            TXBCR => self.cancel_requests(value),
            RAM..RAM_END => {
                self.ram[number - RAM] = value;
                let buffer = number.checked_sub(RAM + TX_BUFFERS).map(|word| word / ELEMENT_WORDS);
                if buffer.is_some_and(|buffer| self.registers[TXBRP] >> buffer & 1 == 1) {
                    self.node.forbidden(format!("44.3.3: {offset:#06X} is in a TX buffer with a request"));
                }
            }
            NBTP | RXGFC | TXBC if !is_open => self.node.forbidden("44.4: NBTP, RXGFC or TXBC without CCE"),
            _ => {
                let modelled = match number {
                    NBTP => 0xFFFF_FF7F,
                    IE => 0x00FF_FFFF,
                    ILS => 0x7F,
                    ILE => 0b11,
                    RXGFC => 0x0F1F_003F,
                    TXBC => TFQM,
                    TXBTIE => 0b111,
                    _ => bail!("FDCAN: no writable register is modelled at {offset:#05X}"),
                };
                ensure!(value & !modelled == 0, "{value:#X} at {offset:#05X} selects unmodelled options");
                self.registers[number] = value;
            }
        }
        Ok(())
    }

    /// 44.4.16 to 44.4.18
    fn interrupts(&self) -> [bool; 2] {
        let [ir, ie, ils, ile] = [IR, IE, ILS, ILE].map(|number| self.registers[number]);
        let of_line_1 = (0..GROUPS.len()).filter(|n| ils >> n & 1 == 1).fold(0, |flags, n| flags | GROUPS[n]);
        [ir & ie & !of_line_1 != 0 && ile & 0b01 != 0, ir & ie & of_line_1 != 0 && ile & 0b10 != 0]
    }

    fn has_unread_data(&self) -> bool {
        // Off the bus, no FIFO overruns.
        self.takes_part() && self.fifos.iter().any(|(_, fill)| *fill > 0)
    }

    fn reset(&mut self) {
        *self = Self { ram: self.ram, ..Self::new(self.kernel_hz) };
    }
}

#[cfg(test)]
mod tests;
