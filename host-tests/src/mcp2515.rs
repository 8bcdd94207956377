//! Model of the CAN controller MCP2515, per Microchip's DS20001801: its SPI interface and its behaviour on a bus.
//!
//! The bus of [`can_bus`](crate::can_bus) reports when a frame begins, ends or fails. Rejected are sleep, loopback,
//! listen-only and one-shot mode, RX STATUS, and the pins TXnRTS and RXnBF. Accesses that the data sheet forbids and
//! the chip ignores are ignored, too, and recorded in [`violations`](BusController::violations).

mod buffers;
mod filters;

use anyhow::{Result, bail, ensure};

pub use self::buffers::TRANSMIT_BUFFERS;
use self::buffers::{ReceiveBuffer, TransmitBuffer};
use crate::can_controller::{
    Activity, Attempt, BitTiming, BusController, Confinement, ErrorCode, Node, RECOVERY, Transmission,
};
use crate::can_wire::WireFrame;

/// Register addresses (table 11-1). CANSTAT and CANCTRL occupy these columns of every row.
const BFPCTRL: u8 = 0x0C;
const TXRTSCTRL: u8 = 0x0D;
const CANSTAT: u8 = 0x0E;
const CANCTRL: u8 = 0x0F;
const TEC: u8 = 0x1C;
const REC: u8 = 0x1D;
const CNF3: u8 = 0x28;
const CNF1: u8 = 0x2A;
const CANINTE: u8 = 0x2B;
const CANINTF: u8 = 0x2C;
const EFLG: u8 = 0x2D;
const TRANSMIT: u8 = 0x30;
const RECEIVE: u8 = 0x60;

/// Number of registers; sequential READ and WRITE wrap to the first.
const REGISTERS: u8 = 0x80;

/// Bits of CANCTRL (register 10-1).
const REQOP: u8 = 0b111 << 5;
const ABAT: u8 = 1 << 4;
const OSM: u8 = 1 << 3;
const CANCTRL_RESET: u8 = 0x87;

/// Bits of CANINTF and CANINTE (registers 7-1 and 7-2).
const MERRF: u8 = 1 << 7;
const ERRIF: u8 = 1 << 5;
const TX0IF: u8 = 1 << 2;
const RX0IF: u8 = 1 << 0;

/// Bits of EFLG (register 6-3): the host clears the first two, the others show the state.
const RX1OVR: u8 = 1 << 7;
const RX0OVR: u8 = 1 << 6;
const TXBO: u8 = 1 << 5;
const TXEP: u8 = 1 << 4;
const RXEP: u8 = 1 << 3;
const TXWAR: u8 = 1 << 2;
const RXWAR: u8 = 1 << 1;
const EWARN: u8 = 1 << 0;

/// CNF2: CNF3 determines the length of phase segment 2 (register 5-2).
const BTLMODE: u32 = 1 << 7;

/// Modelled operating modes (10.0).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Normal = 0,
    Configuration = 4,
}

/// Progress of an SPI instruction (table 12-1) while the chip is selected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Instruction {
    Awaited,
    Address(Access),
    Read {
        address: u8,
        clears: u8,
    },
    Write {
        address: u8,
    },
    Modify {
        address: u8,
        mask: Option<u8>,
    },
    ReadStatus,
    /// No more bytes are expected.
    Ended,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Access {
    Read,
    Write,
    Modify,
}

/// The MCP2515.
#[derive(Clone, Debug)]
pub struct Mcp2515 {
    oscillator_hz: u32,
    mode: Mode,
    canctrl: u8,
    /// CNF1, CNF2, CNF3.
    timing: [u8; 3],
    enabled: u8,
    flags: u8,
    overflows: u8,
    filters: filters::Filters,
    transmit: [TransmitBuffer; TRANSMIT_BUFFERS],
    receive: [ReceiveBuffer; 2],
    node: Node,
    instruction: Option<Instruction>,
    lost: Vec<WireFrame>,
}

impl Mcp2515 {
    /// Creates a controller after reset with this oscillator frequency in Hz.
    #[must_use]
    pub fn new(oscillator_hz: u32) -> Self {
        Self {
            oscillator_hz,
            mode: Mode::Configuration,
            canctrl: CANCTRL_RESET,
            timing: [0; 3],
            enabled: 0,
            flags: 0,
            overflows: 0,
            filters: filters::Filters::default(),
            transmit: Default::default(),
            receive: Default::default(),
            node: Node::default(),
            instruction: None,
            lost: Vec::new(),
        }
    }

    /// Power-cycles the chip.
    pub fn reset(&mut self) {
        // Keeps the findings for the tests.
        let violations = std::mem::take(&mut self.node.violations);
        *self = Self::new(self.oscillator_hz);
        self.node.violations = violations;
    }

    /// Returns the accepted messages that were lost for lack of a buffer.
    #[must_use]
    pub fn lost(&self) -> &[WireFrame] {
        &self.lost
    }

    /// Returns the pending transmit buffers, buffer 0 in bit 0.
    #[must_use]
    pub fn pending(&self) -> u8 {
        (0..TRANSMIT_BUFFERS).filter(|&n| self.transmit[n].is_pending()).fold(0, |bits, n| bits | 1 << n)
    }

    /// Returns the level of the pin INT: low while an enabled interrupt is pending (7.0).
    #[must_use]
    pub fn interrupt_pin(&self) -> bool {
        self.flags & self.enabled == 0
    }

    /// Drives the pin CS low.
    pub fn select(&mut self) {
        self.instruction = Some(Instruction::Awaited);
    }

    /// Drives the pin CS high.
    pub fn deselect(&mut self) {
        if let Some(Instruction::Read { clears, .. }) = self.instruction.take() {
            // 12.4: the end of READ RX BUFFER clears the buffer's flag.
            self.flags &= !clears;
        }
    }

    /// Exchanges a byte; the output is FFh while the chip only receives.
    ///
    /// # Errors
    /// Fails when the instruction, register or option is not modelled.
    pub fn exchange(&mut self, byte: u8) -> Result<u8> {
        let Some(instruction) = self.instruction else { bail!("the chip is not selected") };
        let mut out = 0xFF;
        let next = match instruction {
            Instruction::Awaited => self.begin(byte)?,
            Instruction::Address(access) => {
                let address = byte % REGISTERS;
                match access {
                    Access::Read => Instruction::Read { address, clears: 0 },
                    Access::Write => Instruction::Write { address },
                    Access::Modify => Instruction::Modify { address, mask: None },
                }
            }
            Instruction::Read { address, clears } => {
                out = self.load(address);
                Instruction::Read { address: (address + 1) % REGISTERS, clears }
            }
            Instruction::Write { address } => {
                self.store(address, byte, 0xFF)?;
                Instruction::Write { address: (address + 1) % REGISTERS }
            }
            Instruction::Modify { address, mask: None } => Instruction::Modify { address, mask: Some(byte) },
            Instruction::Modify { address, mask: Some(mask) } => {
                // 12.10: for registers without bit access, the mask is forced to FFh.
                let mask = if is_bit_modifiable(address) { mask } else { 0xFF };
                self.store(address, byte, mask)?;
                Instruction::Ended
            }
            Instruction::ReadStatus => {
                out = self.read_status();
                instruction
            }
            Instruction::Ended => instruction,
        };
        self.instruction = Some(next);
        Ok(out)
    }

    fn begin(&mut self, code: u8) -> Result<Instruction> {
        Ok(match code {
            0b1100_0000 => {
                self.reset();
                Instruction::Ended
            }
            0b0000_0011 => Instruction::Address(Access::Read),
            0b0000_0010 => Instruction::Address(Access::Write),
            0b0000_0101 => Instruction::Address(Access::Modify),
            0b1010_0000 => Instruction::ReadStatus,
            // Figure 12-3: starts at the identifier or at the data.
            0b1001_0000 | 0b1001_0010 | 0b1001_0100 | 0b1001_0110 => {
                let (buffer, is_data) = (code >> 2 & 1, code >> 1 & 1);
                let address = RECEIVE + 0x10 * buffer + if is_data == 1 { 6 } else { 1 };
                Instruction::Read { address, clears: RX0IF << buffer }
            }
            // Figure 12-5.
            0b0100_0000..=0b0100_0101 => {
                let (buffer, is_data) = (code >> 1 & 0b11, code & 1);
                let address = TRANSMIT + 0x10 * buffer + if is_data == 1 { 6 } else { 1 };
                Instruction::Write { address }
            }
            0b1000_0000..=0b1000_0111 => {
                for n in (0..TRANSMIT_BUFFERS).filter(|n| code >> n & 1 == 1) {
                    self.transmit[n].request();
                }
                Instruction::Ended
            }
            _ => bail!("MCP2515: unknown instruction {code:#010b}"),
        })
    }

    /// Figure 12-8.
    fn read_status(&self) -> u8 {
        let received = self.flags & 0b11;
        (0..TRANSMIT_BUFFERS).fold(received, |status, n| {
            let is_sent = self.flags >> (2 + n) & 1;
            status | u8::from(self.transmit[n].is_pending()) << (2 + 2 * n) | is_sent << (3 + 2 * n)
        })
    }

    fn load(&self, address: u8) -> u8 {
        match address {
            _ if address & 0xF == CANSTAT => (self.mode as u8) << 5 | self.interrupt_code() << 1,
            _ if address & 0xF == CANCTRL => self.canctrl,
            BFPCTRL | TXRTSCTRL => 0,
            TEC => self.node.faults.transmit.min(255) as u8,
            REC => self.node.faults.receive as u8,
            CNF3..=CNF1 => self.timing[usize::from(CNF1 - address)],
            CANINTE => self.enabled,
            CANINTF => self.flags,
            EFLG => self.overflows | self.states(),
            TRANSMIT..RECEIVE => self.transmit[usize::from(address / 0x10 - 3)].load(address & 0xF),
            RECEIVE.. => {
                let buffer = usize::from(address / 0x10 - 6);
                self.receive[buffer].load(buffer, address & 0xF)
            }
            _ => self.filters.load(address),
        }
    }

    /// Stores the bits selected by a mask.
    fn store(&mut self, address: u8, value: u8, mask: u8) -> Result<()> {
        let value = self.load(address) & !mask | value & mask;
        let is_configuration = self.mode == Mode::Configuration;
        match address {
            _ if address & 0xF == CANSTAT => {}
            _ if address & 0xF == CANCTRL => self.store_canctrl(value)?,
            BFPCTRL | TXRTSCTRL => ensure!(value == 0, "the pins TXnRTS and RXnBF are not modelled"),
            // Registers 6-1 and 6-2: read only.
            TEC | REC => {}
            CNF3..=CNF1 if is_configuration => self.timing[usize::from(CNF1 - address)] = value,
            CANINTE => self.enabled = value,
            CANINTF => self.flags = value,
            EFLG => self.overflows &= value,
            TRANSMIT..RECEIVE => {
                let buffer = usize::from(address / 0x10 - 3);
                if !self.transmit[buffer].store(address & 0xF, value, self.node.is_sending(buffer)) {
                    self.node.forbidden(format!("3.2: write to a pending buffer, at {address:#04X}"));
                }
            }
            RECEIVE.. if address & 0xF == 0 => {
                self.receive[usize::from(address / 0x10 - 6)].store_control(value);
            }
            RECEIVE.. => self.node.forbidden(format!("4.0: write to a receive buffer, at {address:#04X}")),
            0x20..CNF3 if address & 0b11 > 1 => ensure!(value == 0, "masks of data bytes are not modelled"),
            _ if is_configuration => self.filters.store(address, value),
            _ => self.node.forbidden(format!("10.1: write to {address:#04X} outside Configuration mode")),
        }
        Ok(())
    }

    fn store_canctrl(&mut self, value: u8) -> Result<()> {
        self.canctrl = value;
        if value & ABAT != 0 {
            for (n, buffer) in self.transmit.iter_mut().enumerate() {
                buffer.abort_all(self.node.is_sending(n));
            }
        }
        ensure!(
            matches!(value >> 5, 0 | 4) && value & OSM == 0,
            "CANCTRL {value:#04X}: only Normal and Configuration mode are modelled"
        );
        self.change_mode();
        Ok(())
    }

    /// ICOD: code of the enabled interrupt with the highest priority (table 7-1).
    fn interrupt_code(&self) -> u8 {
        const ORDER: [u8; 7] = [ERRIF, 1 << 6, TX0IF, TX0IF << 1, TX0IF << 2, RX0IF, RX0IF << 1];
        let raised = self.flags & self.enabled;
        ORDER.iter().position(|flag| raised & flag != 0).map_or(0, |at| at as u8 + 1)
    }

    /// Returns the state bits of EFLG.
    fn states(&self) -> u8 {
        let Confinement { transmit, receive, is_off, .. } = self.node.faults;
        let states = [
            (TXBO, is_off),
            (TXEP, Confinement::is_passive(transmit)),
            (RXEP, Confinement::is_passive(receive)),
            (TXWAR, Confinement::warns(transmit)),
            (RXWAR, Confinement::warns(receive)),
            (EWARN, Confinement::warns(transmit.max(receive))),
        ];
        states.iter().fold(0, |bits, (bit, is_set)| if *is_set { bits | bit } else { bits })
    }

    /// Changes the node, and requests an interrupt if the state bits of EFLG change.
    fn change_node(&mut self, change: impl FnOnce(&mut Node)) {
        let before = self.states();
        change(&mut self.node);
        if self.states() != before {
            self.flags |= ERRIF;
        }
    }
}

/// Returns whether the register supports BIT MODIFY (shaded in table 11-1).
fn is_bit_modifiable(address: u8) -> bool {
    match address {
        BFPCTRL | TXRTSCTRL | CNF3..=EFLG => true,
        TRANSMIT.. => address & 0xF == 0 || address & 0xF == CANCTRL,
        _ => address & 0xF == CANCTRL,
    }
}

impl BusController for Mcp2515 {
    fn node(&self) -> &Node {
        &self.node
    }

    fn node_mut(&mut self) -> &mut Node {
        &mut self.node
    }

    /// 5.0
    fn bit_timing(&self) -> BitTiming {
        let [cnf1, cnf2, cnf3] = self.timing.map(u32::from);
        let (propagation, phase_1) = ((cnf2 & 0b111) + 1, (cnf2 >> 3 & 0b111) + 1);
        let phase_2 = if cnf2 & BTLMODE != 0 { (cnf3 & 0b111) + 1 } else { phase_1.max(2) };
        // A time quantum is two oscillator periods, scaled by BRP (5.1).
        let prescaler = 2 * ((cnf1 & 0x3F) + 1);
        BitTiming::new(self.oscillator_hz, prescaler, [1 + propagation + phase_1, phase_2], (cnf1 >> 6) + 1)
    }

    fn next_request(&self) -> Option<Transmission> {
        // 3.6: no transmission starts while ABAT is set.
        if self.canctrl & ABAT != 0 {
            return None;
        }
        // 3.3: by TXP, then by buffer number.
        let pending = (0..TRANSMIT_BUFFERS).filter(|&n| self.transmit[n].is_pending());
        let mailbox = pending.max_by_key(|&n| (self.transmit[n].priority(), n))?;
        Some(Transmission { mailbox, frame: self.transmit[mailbox].frame() })
    }

    fn attempt_ended(&mut self, mailbox: usize, attempt: Attempt) {
        let all_are_aborted = attempt == Attempt::Failed && self.canctrl & ABAT != 0;
        self.transmit[mailbox].attempt_ended(attempt, all_are_aborted);
        if attempt == Attempt::Acknowledged {
            self.flags |= TX0IF << mailbox;
        }
    }

    /// Stores a message per figure 4-3.
    fn accept(&mut self, frame: &WireFrame) -> bool {
        let modes = [&self.receive[0], &self.receive[1]].map(ReceiveBuffer::takes_any);
        let Some((buffer, filter)) = self.filters.pass(frame, modes) else { return false };
        let is_full = |n: usize| self.flags >> n & 1 == 1;
        let rolls_over = buffer == 0 && is_full(0) && self.receive[0].rolls_over();
        let target = if rolls_over { 1 } else { buffer };
        if is_full(target) {
            self.overflows |= [RX0OVR, RX1OVR][target];
            self.flags |= ERRIF;
            self.lost.push(*frame);
        } else {
            self.receive[target].put(frame, filter);
            self.flags |= RX0IF << target;
        }
        true
    }

    fn frame_ended(&mut self, why: Option<ErrorCode>) {
        self.flags |= if why.is_some() { MERRF } else { 0 };
        self.change_node(|node| node.count(why));
        // 6.6: the chip recovers without a request.
        self.node.faults.begin_recovery(RECOVERY);
    }

    /// 10.0: the mode changes after all pending messages have been sent.
    fn change_mode(&mut self) {
        let wanted = if self.canctrl & REQOP == 0 { Mode::Normal } else { Mode::Configuration };
        let is_busy = matches!(self.node.activity, Activity::Receiving | Activity::Transmitting);
        let is_pending = self.mode == Mode::Normal && self.pending() != 0;
        if wanted == self.mode || is_busy || is_pending {
            return;
        }
        self.mode = wanted;
        self.node.synchronise();
        if wanted == Mode::Configuration {
            // 10.1
            self.node.faults = Confinement::default();
        }
    }

    fn idle(&mut self, bits: u32) {
        if self.mode == Mode::Normal {
            self.change_node(|node| _ = node.idle(bits));
        }
    }
}

#[cfg(test)]
mod tests;
