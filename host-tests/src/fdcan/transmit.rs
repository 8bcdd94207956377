//! Tx handler: requests, their order and their cancellation (44.3.3, 44.4.26 to 44.4.34).

use anyhow::{Result, ensure};

use super::{
    ELEMENT_WORDS, ELEMENTS, Fdcan, IR, RTR, TC, TFQM, TX_BUFFERS, TXBC, TXBCF, TXBCR, TXBRP, TXBTIE, TXBTO,
    XTD,
};
use crate::can_controller::Transmission;
use crate::can_wire::WireFrame;

/// Returns the buffers that are set in a register, beginning with this one.
fn buffers(register: u32, from: usize) -> impl Iterator<Item = usize> {
    (0..ELEMENTS).map(move |n| (from + n) % ELEMENTS).filter(move |n| register >> n & 1 == 1)
}

impl Fdcan {
    /// Returns TXFQS (44.4.27).
    pub(super) fn txfqs(&self) -> u32 {
        let pending = self.registers[TXBRP];
        let put = buffers(!pending, self.put_index).next();
        let get = buffers(pending, self.put_index).next().unwrap_or(self.put_index);
        let of_fifo = if self.registers[TXBC] == TFQM { 0 } else { get << 8 | buffers(!pending, 0).count() };
        (of_fifo | put.unwrap_or(self.put_index) << 16 | usize::from(put.is_none()) << 21) as u32
    }

    /// Returns the next transmission: in queue mode the lowest identifier, then the lowest buffer.
    pub(super) fn next_buffer(&self) -> Option<Transmission> {
        let frame = |buffer: usize| {
            let at = TX_BUFFERS + buffer * ELEMENT_WORDS;
            let [t0, t1, low, high] = [0, 1, 2, 3].map(|n| self.ram[at + n]);
            WireFrame::from_fields((t0, t0 & XTD != 0), t0 & RTR != 0, (t1 >> 16 & 0xF) as u8, [low, high])
        };
        let pending = self.registers[TXBRP];
        let mailbox = if self.registers[TXBC] == TFQM {
            let id = |n: &usize| WireFrame { is_remote: false, ..frame(*n) }.arbitration();
            buffers(pending, 0).min_by_key(id)?
        } else {
            buffers(pending, self.put_index).next()?
        };
        Some(Transmission { mailbox, frame: frame(mailbox) })
    }

    /// Handles a store to TXBAR (44.4.29).
    pub(super) fn add_requests(&mut self, value: u32) -> Result<()> {
        for buffer in buffers(value, self.put_index) {
            let (bit, t1) = (1_u32 << buffer, self.ram[TX_BUFFERS + buffer * ELEMENT_WORDS + 1]);
            ensure!(t1 & 0xB0_0000 == 0, "T1 {t1:#010X}: BRS, FDF and EFC are not modelled");
            if self.registers[TXBRP] & bit != 0 {
                self.node.forbidden("44.4.29: the buffer already has a request");
            } else if self.registers[TXBC] != TFQM && buffer != self.put_index {
                self.node.forbidden("44.3.3: the buffer is not at the put index of the TX FIFO");
            } else {
                self.registers[TXBRP] |= bit;
                self.registers[TXBTO] &= !bit;
                self.registers[TXBCF] &= !bit;
                self.put_index = (buffer + 1) % ELEMENTS;
            }
        }
        Ok(())
    }

    /// Handles a store to TXBCR (44.4.30). It cancels a transmission that has begun at its end.
    pub(super) fn cancel_requests(&mut self, value: u32) {
        for buffer in buffers(value, 0) {
            self.registers[TXBCR] |= 1 << buffer;
            if !self.node.is_sending(buffer) {
                // 44.4.32: without a request, too.
                self.finish(buffer, false);
            }
        }
    }

    /// Ends or cancels a request. If not sent, it is repeated unless it is to be cancelled (44.4.28 to 44.4.34).
    pub(super) fn finish(&mut self, buffer: usize, is_sent: bool) {
        let bit = 1_u32 << buffer;
        let cancelled = self.registers[TXBCR] & bit;
        if is_sent {
            self.registers[TXBTO] |= bit;
            self.registers[IR] |= if self.registers[TXBTIE] & bit != 0 { TC } else { 0 };
        }
        self.registers[TXBRP] &= if is_sent { !bit } else { !cancelled };
        self.registers[TXBCF] |= cancelled;
        self.registers[TXBCR] &= !bit;
    }
}
