//! Three transmit buffers and two receive buffers (3.0, 4.0).

use super::filters::identifier;
use crate::can_controller::Attempt;
use crate::can_wire::WireFrame;

/// Number of transmit buffers.
pub const TRANSMIT_BUFFERS: usize = 3;

/// Bits of TXBnCTRL (register 3-1).
const ABTF: u8 = 1 << 6;
const MLOA: u8 = 1 << 5;
const TXERR: u8 = 1 << 4;
const TXREQ: u8 = 1 << 3;
const TXP: u8 = 0b11;

/// Bits of xxBnSIDL and xxBnDLC (registers 3-4, 3-7, 4-5, 4-8).
const IDE: u8 = 1 << 3;
const SRR: u8 = 1 << 4;
const RTR: u8 = 1 << 6;

/// Bits of RXBnCTRL (registers 4-1, 4-2).
const RXM: u8 = 0b11 << 5;
const RXRTR: u8 = 1 << 3;
const BUKT: u8 = 1 << 2;

/// SIDH, SIDL, EID8, EID0, DLC and eight bytes of data.
type Message = [u8; 13];

#[derive(Clone, Debug, Default)]
pub(super) struct TransmitBuffer {
    control: u8,
    message: Message,
    /// Abort requested during transmission.
    is_to_abort: bool,
}

impl TransmitBuffer {
    pub(super) const fn is_pending(&self) -> bool {
        self.control & TXREQ != 0
    }

    pub(super) const fn priority(&self) -> u8 {
        self.control & TXP
    }

    /// 3.4: a request clears the flags of the last message.
    pub(super) fn request(&mut self) {
        self.control = self.control & TXP | TXREQ;
    }

    pub(super) fn load(&self, column: u8) -> u8 {
        match column {
            0 => self.control,
            _ => self.message.get(usize::from(column) - 1).copied().unwrap_or(0),
        }
    }

    /// Returns whether the store takes effect; a pending message must not be changed (3.2).
    pub(super) fn store(&mut self, column: u8, value: u8, is_sending: bool) -> bool {
        if column == 0 {
            let was_pending = self.is_pending();
            let control = self.control & !TXP | value & TXP;
            self.control = control;
            match (was_pending, value & TXREQ != 0) {
                (false, true) => self.request(),
                // 3.6: a transmission in progress continues.
                (true, false) if is_sending => self.is_to_abort = true,
                (true, false) => self.control &= !TXREQ,
                _ => {}
            }
            return true;
        }
        if self.is_pending() {
            return false;
        }
        if let Some(byte) = self.message.get_mut(usize::from(column) - 1) {
            *byte = value;
        }
        true
    }

    /// 3.6: handles ABAT, which sets ABTF in aborted buffers.
    pub(super) fn abort_all(&mut self, is_sending: bool) {
        if self.is_pending() && !is_sending {
            self.control = self.control & !TXREQ | ABTF;
        }
    }

    pub(super) fn frame(&self) -> WireFrame {
        let [sidh, sidl, eid8, eid0, dlc, data @ ..] = self.message;
        let id = (identifier([sidh, sidl, eid8, eid0]), sidl & IDE != 0);
        let len = usize::from(dlc & 0xF).min(8);
        let frame = WireFrame { dlc: dlc & 0xF, ..WireFrame::of_id_bits(id, &data[..len]) };
        if dlc & RTR != 0 { frame.remote() } else { frame }
    }

    /// Retries a transmission without success unless an abort is requested; ABTF reports aborts by ABAT (3.4, 3.6).
    pub(super) fn attempt_ended(&mut self, attempt: Attempt, all_are_aborted: bool) {
        self.control |= match attempt {
            Attempt::Acknowledged => 0,
            Attempt::LostArbitration => MLOA,
            Attempt::Failed => TXERR,
        };
        if attempt == Attempt::Acknowledged || all_are_aborted || self.is_to_abort {
            self.control &= !TXREQ;
            self.is_to_abort = false;
        }
        self.control |= if all_are_aborted { ABTF } else { 0 };
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct ReceiveBuffer {
    /// RXM and BUKT.
    control: u8,
    filter: u8,
    message: Message,
    is_remote: bool,
}

impl ReceiveBuffer {
    /// Returns whether the filters are off.
    pub(super) const fn takes_any(&self) -> bool {
        self.control & RXM == RXM
    }

    pub(super) const fn rolls_over(&self) -> bool {
        self.control & BUKT != 0
    }

    pub(super) fn store_control(&mut self, value: u8) {
        self.control = value & (RXM | BUKT);
    }

    /// Loads a register. `buffer` is the number of this receive buffer.
    pub(super) fn load(&self, buffer: usize, column: u8) -> u8 {
        match column {
            0 => {
                let remote = if self.is_remote { RXRTR } else { 0 };
                // RXB0CTRL has one filter bit, and a copy of BUKT beside it.
                let rollover = if buffer == 0 { self.control & BUKT | (self.control & BUKT) >> 1 } else { 0 };
                self.control & RXM | rollover | remote | self.filter
            }
            _ => self.message.get(usize::from(column) - 1).copied().unwrap_or(0),
        }
    }

    pub(super) fn put(&mut self, frame: &WireFrame, filter: u8) {
        let (raw, is_extended) = frame.id_bits();
        let [high, low] = ((raw >> 18) as u16).to_be_bytes();
        let kind = match (is_extended, frame.is_remote) {
            (true, _) => IDE,
            (false, true) => SRR,
            (false, false) => 0,
        };
        let remote = if is_extended && frame.is_remote { RTR } else { 0 };
        self.message[0] = high << 5 | low >> 3;
        self.message[1] = low << 5 | kind | (raw >> 16) as u8 & 0b11;
        self.message[2] = (raw >> 8) as u8;
        self.message[3] = raw as u8;
        self.message[4] = remote | frame.dlc;
        self.message[5..].copy_from_slice(&frame.data);
        (self.filter, self.is_remote) = (filter, frame.is_remote);
    }
}
