//! Three transmit mailboxes (RM0351, 46.7.1, 46.9.2, 46.9.3).

use anyhow::{Result, ensure};

use crate::can_controller::{Attempt, Transmission};
use crate::can_wire::WireFrame;

/// Number of mailboxes.
pub const MAILBOXES: usize = 3;

/// Bits of TSR for mailbox 0; each further mailbox is shifted left by eight.
const RQCP: u32 = 1 << 0;
const TXOK: u32 = 1 << 1;
const ALST: u32 = 1 << 2;
const TERR: u32 = 1 << 3;
const ABRQ: u32 = 1 << 7;
const CODE_AT: u32 = 24;
const TME_AT: u32 = 26;
const LOW_AT: u32 = 29;

/// Bits of TIxR and TDTxR.
const TXRQ: u32 = 1 << 0;
const RTR: u32 = 1 << 1;
const IDE: u32 = 1 << 2;
const TGT: u32 = 1 << 8;

#[derive(Clone, Debug, Default)]
struct Mailbox {
    /// TIxR without TXRQ, TDTxR, TDLxR, TDHxR.
    registers: [u32; 4],
    is_pending: bool,
    is_to_abort: bool,
    /// RQCP, TXOK, ALST and TERR.
    status: u32,
}

impl Mailbox {
    fn frame(&self) -> WireFrame {
        let [id, length, low, high] = self.registers;
        WireFrame::from_fields((id >> 3, id & IDE != 0), id & RTR != 0, (length & 0xF) as u8, [low, high])
    }

    fn empty(&mut self, status: u32) {
        self.status = RQCP | status;
        (self.is_pending, self.is_to_abort) = (false, false);
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Mailboxes([Mailbox; MAILBOXES]);

impl Mailboxes {
    /// Returns the pending mailboxes in order of transmission: lowest identifier first, then lowest mailbox.
    fn order(&self) -> Vec<usize> {
        let mut pending: Vec<_> = (0..MAILBOXES).filter(|&n| self.0[n].is_pending).collect();
        pending.sort_by_key(|&n| self.0[n].frame().arbitration());
        pending
    }

    pub(super) fn next(&self) -> Option<Transmission> {
        let mailbox = *self.order().first()?;
        Some(Transmission { mailbox, frame: self.0[mailbox].frame() })
    }

    pub(super) fn tsr(&self) -> u32 {
        let order = self.order();
        let mut tsr = 0;
        for (n, mailbox) in self.0.iter().enumerate() {
            let abort = if mailbox.is_to_abort { ABRQ } else { 0 };
            tsr |= (mailbox.status | abort) << (8 * n);
            tsr |= u32::from(!mailbox.is_pending) << (TME_AT as usize + n);
        }
        // The next free mailbox, or the last in the order of transmission.
        let free = (0..MAILBOXES).find(|&n| !self.0[n].is_pending);
        let last = order.last().copied();
        tsr |= (free.or(last).unwrap_or(0) as u32) << CODE_AT;
        if let (Some(last), 2..) = (last, order.len()) {
            tsr |= 1 << (LOW_AT as usize + last);
        }
        tsr
    }

    pub(super) fn store_tsr(&mut self, value: u32, is_sending: impl Fn(usize) -> bool) {
        for (n, mailbox) in self.0.iter_mut().enumerate() {
            let value = value >> (8 * n);
            // Clearing RQCP also clears the other flags.
            let cleared = if value & RQCP != 0 { RQCP | TXOK | ALST | TERR } else { value };
            mailbox.status &= !cleared;
            if value & ABRQ != 0 && mailbox.is_pending {
                // 46.7.1: a transmission in progress continues.
                if is_sending(n) { mailbox.is_to_abort = true } else { mailbox.empty(0) }
            }
        }
    }

    pub(super) fn any_request_completed(&self) -> bool {
        self.0.iter().any(|mailbox| mailbox.status & RQCP != 0)
    }

    pub(super) fn load(&self, offset: u32) -> u32 {
        let (mailbox, register) = place(offset);
        let mailbox = &self.0[mailbox];
        let request = if register == 0 && mailbox.is_pending { TXRQ } else { 0 };
        mailbox.registers[register] | request
    }

    /// Returns whether the store takes effect; a pending mailbox ignores it.
    pub(super) fn store(&mut self, offset: u32, value: u32) -> Result<bool> {
        let (mailbox, register) = place(offset);
        let mailbox = &mut self.0[mailbox];
        if mailbox.is_pending {
            return Ok(false);
        }
        ensure!(register != 1 || value & TGT == 0, "time triggered communication is not modelled");
        mailbox.registers[register] = value;
        if register == 0 {
            mailbox.registers[0] &= !TXRQ;
            if value & TXRQ != 0 {
                mailbox.is_pending = true;
                mailbox.status = 0;
            }
        }
        Ok(true)
    }

    /// Retries a transmission without success as the hardware does, unless an abort is requested (46.7.1).
    pub(super) fn attempt_ended(&mut self, mailbox: usize, attempt: Attempt) {
        let mailbox = &mut self.0[mailbox];
        let flag = match attempt {
            Attempt::Acknowledged => TXOK,
            Attempt::LostArbitration => ALST,
            Attempt::Failed => TERR,
        };
        if mailbox.is_to_abort || attempt == Attempt::Acknowledged {
            mailbox.empty(flag);
        } else {
            mailbox.status = mailbox.status & !(ALST | TERR) | flag;
        }
    }
}

fn place(offset: u32) -> (usize, usize) {
    ((offset / 0x10) as usize, (offset % 0x10 / 4) as usize)
}
