//! Tx handler: requests, their order and their cancellation (44.3.3, 44.4.26 to 44.4.34).

use std::collections::VecDeque;

use anyhow::{Result, ensure};

use super::{
    Activity, CCE, DAR, ELEMENT_WORDS, ELEMENTS, Fdcan, RTR, TFQM, TX_BUFFERS, TXBC, TXBCIE, TXBTIE, XTD,
};
use crate::can_controller::Transmission;
use crate::can_wire::WireFrame;

/// Flags of IR (44.4.15).
pub(super) const TC: u32 = 1 << 7;
pub(super) const TCF: u32 = 1 << 8;

/// Bits of T1 (44.3.6): bit rate switching, FD format, and event FIFO control.
const UNMODELLED_T1: u32 = 1 << 20 | 1 << 21 | 1 << 23;

/// State of the transmit buffers, buffer 0 in bit 0.
#[derive(Clone, Debug, Default)]
pub(super) struct Requests {
    /// TXBRP, TXBTO, TXBCF and TXBCR.
    pub(super) pending: u32,
    pub(super) occurred: u32,
    pub(super) cancelled: u32,
    pub(super) to_cancel: u32,
    /// Buffer of the transmission, if there is one.
    pub(super) sending: usize,
    /// Put index.
    put: usize,
    /// In FIFO mode, the buffers from the get index to the put index.
    fifo: VecDeque<usize>,
}

impl Requests {
    pub(super) const fn is_pending(&self, buffer: usize) -> bool {
        self.pending >> buffer & 1 == 1
    }
}

/// Returns the buffers that are set in a register, beginning with this one.
fn buffers(register: u32, from: usize) -> impl Iterator<Item = usize> {
    (0..ELEMENTS).map(move |n| (from + n) % ELEMENTS).filter(move |n| register >> n & 1 == 1)
}

impl Fdcan {
    fn is_queue(&self) -> bool {
        self.registers[&TXBC] & TFQM != 0
    }

    /// Returns TXFQS (44.4.27).
    pub(super) fn txfqs(&self) -> u32 {
        let Requests { put, fifo, pending, .. } = &self.requests;
        let (put, get, free, is_full) = if self.is_queue() {
            let free = buffers(!pending, *put).next();
            (free.unwrap_or(0), 0, 0, free.is_none())
        } else {
            (*put, *fifo.front().unwrap_or(put), ELEMENTS - fifo.len(), fifo.len() == ELEMENTS)
        };
        (free | get << 8 | put << 16 | usize::from(is_full) << 21) as u32
    }

    fn frame(&self, buffer: usize) -> WireFrame {
        let at = TX_BUFFERS + buffer * ELEMENT_WORDS;
        let [t0, t1, low, high] = [0, 1, 2, 3].map(|n| self.ram[at + n]);
        let standard = WireFrame::standard((t0 >> 18) as u16, &[]).id;
        let id = if t0 & XTD != 0 { WireFrame::extended(t0, &[]).id } else { standard };
        WireFrame::from_fields(id, t0 & RTR != 0, (t1 >> 16 & 0xF) as u8, [low, high])
    }

    /// Returns the next transmission: from the queue the lowest identifier, then the lowest buffer.
    pub(super) fn next_request(&self) -> Option<Transmission> {
        let mailbox = if self.is_queue() {
            let id = |n: usize| WireFrame { is_remote: false, ..self.frame(n) }.arbitration();
            buffers(self.requests.pending, 0).min_by_key(|n| id(*n))?
        } else {
            *self.requests.fifo.front()?
        };
        Some(Transmission { mailbox, frame: self.frame(mailbox) })
    }

    /// Handles a store to TXBAR (44.4.29).
    pub(super) fn add_requests(&mut self, value: u32) -> Result<()> {
        for buffer in buffers(value, self.requests.put) {
            let t1 = self.ram[TX_BUFFERS + buffer * ELEMENT_WORDS + 1];
            ensure!(t1 & UNMODELLED_T1 == 0, "T1 {t1:#010X}: FD frames and TX events are not modelled");
            let is_queue = self.is_queue();
            if self.cccr & CCE != 0 {
                self.forbidden("44.3.2: TXBAR is not writable while CCE is set");
            } else if self.requests.is_pending(buffer) {
                self.forbidden("44.4.29: the buffer already has a request");
            } else if !is_queue && buffer != self.requests.put {
                self.forbidden("44.3.3: the buffer is not at the put index of the TX FIFO");
            } else {
                let (requests, bit) = (&mut self.requests, 1_u32 << buffer);
                requests.pending |= bit;
                requests.occurred &= !bit;
                requests.cancelled &= !bit;
                requests.put = (buffer + 1) % ELEMENTS;
                requests.fifo.extend((!is_queue).then_some(buffer));
            }
        }
        Ok(())
    }

    /// Handles a store to TXBCR (44.4.30).
    pub(super) fn cancel_requests(&mut self, value: u32) {
        if self.cccr & CCE != 0 {
            return self.forbidden("44.3.2: TXBCR is not writable while CCE is set");
        }
        if !self.is_queue() {
            self.forbidden("44.3.3: cancellation is not intended for the TX FIFO");
        }
        for buffer in buffers(value, 0) {
            if self.activity == Activity::Transmitting && self.requests.sending == buffer {
                self.requests.to_cancel |= 1 << buffer;
            } else {
                // 44.4.32: without a request, too.
                self.finish(buffer, false);
            }
        }
    }

    /// Ends a request, by transmission or by cancellation (44.4.31 to 44.4.34).
    pub(super) fn finish(&mut self, buffer: usize, is_sent: bool) {
        let (requests, bit) = (&mut self.requests, 1_u32 << buffer);
        let is_cancelled = !is_sent || requests.to_cancel & bit != 0;
        requests.pending &= !bit;
        requests.to_cancel &= !bit;
        while requests.fifo.front().is_some_and(|n| requests.pending >> n & 1 == 0) {
            requests.fifo.pop_front();
        }
        if is_sent {
            requests.occurred |= bit;
            self.ir |= if self.registers[&TXBTIE] & bit != 0 { TC } else { 0 };
        }
        if is_cancelled {
            requests.cancelled |= bit;
            self.ir |= if self.registers[&TXBCIE] & bit != 0 { TCF } else { 0 };
        }
    }

    /// Repeats a transmission after a lost arbitration or an error, unless it is to be cancelled (44.4.28).
    pub(super) fn retry(&mut self, buffer: usize) {
        if self.requests.to_cancel >> buffer & 1 == 1 || self.cccr & DAR != 0 {
            self.finish(buffer, false);
        }
    }
}
