//! Injects receive errors into a UART that QEMU models (RM0351, 40.5.16, 40.8.8).
//!
//! Only the registers for reception are intercepted, so an interrupt costs three accesses. QEMU's UART handles the
//! rest.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::Result;

use crate::load_store::Width;
use crate::registers::{Machine, RegisterModel, ensure_word};

/// Register offsets, and the end of the intercepted range.
const ISR: u32 = 0x1C;
const ICR: u32 = 0x20;
const RDR: u32 = 0x24;
const END: u32 = 0x28;

/// Receive flag of ISR. The error flags have the same positions in ICR, which clears them.
const RXNE: u32 = 1 << 5;

/// An error of a received byte; the value is the bit of ISR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineError {
    /// Wrong parity.
    Parity = 1 << 0,
    /// Missing stop bit.
    Framing = 1 << 1,
    /// Inconsistent samples of a bit.
    Noise = 1 << 2,
    /// Reception before the previous byte was read; the byte is lost.
    Overrun = 1 << 3,
}

/// A UART's line; clones share it.
#[derive(Clone, Debug)]
pub struct LineErrors {
    base: u32,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    /// The error, and the interval in bytes at which it occurs.
    errors: Option<(LineError, u32)>,
    bytes: u32,
    /// Whether the waiting byte has been processed.
    is_known: bool,
    flags: u32,
}

impl LineErrors {
    /// Creates the line of the UART at this base address.
    #[must_use]
    pub fn on(base: u32) -> Self {
        Self { base, state: Arc::default() }
    }

    /// Injects this error into every n-th byte from now on; `None` stops it. Received values are unchanged.
    pub fn set(&self, errors: Option<(LineError, u32)>) {
        let mut state = self.lock();
        (state.errors, state.bytes) = (errors, 0);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Returns ISR as seen by the core.
    fn isr(&mut self, base: u32, machine: &mut dyn Machine) -> Result<u32> {
        loop {
            let real = machine.load(base + ISR)?;
            if real & RXNE != 0 && !self.is_known {
                self.bytes += 1;
                let due = self.errors.filter(|(_, each)| self.bytes.is_multiple_of(*each));
                self.flags |= due.map_or(0, |(error, _)| error as u32);
                if due.is_some_and(|(error, _)| error == LineError::Overrun) {
                    machine.load(base + RDR)?;
                    continue;
                }
                self.is_known = true;
            }
            return Ok(real | self.flags);
        }
    }
}

impl RegisterModel for LineErrors {
    fn addresses(&self) -> Range<u32> {
        self.base + ISR..self.base + END
    }

    fn load_through(&mut self, address: u32, width: Width, machine: &mut dyn Machine) -> Result<u32> {
        ensure_word(address, width)?;
        let state = &mut *self.lock();
        match address - self.base {
            ISR => state.isr(self.base, machine),
            offset => {
                if offset == RDR {
                    state.is_known = false;
                }
                machine.load(address)
            }
        }
    }

    fn store_through(
        &mut self,
        address: u32,
        width: Width,
        value: u32,
        machine: &mut dyn Machine,
    ) -> Result<()> {
        ensure_word(address, width)?;
        if address - self.base == ICR {
            self.lock().flags &= !value;
        }
        machine.store(address, value)
    }
}

#[cfg(test)]
mod tests;
