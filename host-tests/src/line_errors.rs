//! Errors on a UART that QEMU has: its receiver tells them of the bytes that arrive (RM0351, 40.5.16, 40.8.8).
//!
//! QEMU's UART does the rest. Of its registers only those round reception are served from here, so an interrupt costs three
//! accesses.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::{Result, bail};

use crate::load_store::Width;
use crate::registers::{Machine, RegisterModel, ensure_word};

/// UART4 and LPUART1 (RM0351, table 1).
pub const UART4: u32 = 0x4000_4C00;
/// See [`UART4`].
pub const LPUART1: u32 = 0x4000_8000;

/// Offsets of registers, and where the last of them ends.
const ISR: u32 = 0x1C;
const ICR: u32 = 0x20;
const RDR: u32 = 0x24;
const END: u32 = 0x28;

/// Bit of ISR: a byte waits. Those of the errors are at the same places in ICR, which clears them.
const RXNE: u32 = 1 << 5;

/// What is wrong with a byte; its value is the bit of ISR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineError {
    /// Its parity is wrong.
    Parity = 1 << 0,
    /// It has no stop bit.
    Framing = 1 << 1,
    /// Its bits were not the same in all samples.
    Noise = 1 << 2,
    /// It came while the one before had not been fetched, and is lost.
    Overrun = 1 << 3,
}

/// A UART's line; clones are the same one.
#[derive(Clone, Debug)]
pub struct LineErrors {
    base: u32,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    /// Which error, and of how many bytes one has it.
    errors: Option<(LineError, u32)>,
    bytes: u32,
    /// The byte that waits has been looked at.
    is_known: bool,
    flags: u32,
}

impl LineErrors {
    /// The line of the UART whose registers are there.
    #[must_use]
    pub fn on(base: u32) -> Self {
        Self { base, state: Arc::default() }
    }

    /// Lets each n-th byte from now on have this error; `None`: the line is well. Bytes that are not lost have their value.
    pub fn set(&self, errors: Option<(LineError, u32)>) {
        let mut state = self.lock();
        (state.errors, state.bytes) = (errors, 0);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// ISR as the core sees it.
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

    fn load(&mut self, address: u32, _: Width) -> Result<u32> {
        bail!("{address:#010X} is QEMU's")
    }

    fn store(&mut self, address: u32, _: Width, _: u32) -> Result<()> {
        bail!("{address:#010X} is QEMU's")
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
