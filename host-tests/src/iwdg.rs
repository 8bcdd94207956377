//! Model of the STM32L4's independent watchdog (RM0351, chapter 36) and reset cause flags (6.4.29).

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Result, bail};

use crate::registers::{Derailment, RegisterModel};

/// Base address and register offsets (RM0351, table 1; 36.4).
const IWDG: u32 = 0x4000_3000;
const KR: u32 = 0x00;
const PR: u32 = 0x04;
const RLR: u32 = 0x08;
const SR: u32 = 0x0C;
const WINR: u32 = 0x10;

/// Keys (36.4.1).
const RELOAD: u32 = 0xAAAA;
const UNLOCK: u32 = 0x5555;
const START: u32 = 0xCCCC;

/// PVU and RVU: a new value is being transferred to the slow clock domain (36.4.4).
const PVU: u32 = 1 << 0;
const RVU: u32 = 1 << 1;

/// Cycle of the slow clock (LSI, nominally 32 kHz), and the maximum duration of an update.
const LSI_CYCLE: Duration = Duration::from_nanos(31_250);
const UPDATE: Duration = Duration::from_nanos(5 * 31_250);

/// RCC_CSR: flags for watchdog, brown-out and pin reset, and the bit that clears all flags.
const RCC_CSR: u32 = 0x4002_1094;
const IWDGRSTF: u32 = 1 << 29;
const BORRSTF: u32 = 1 << 27;
const PINRSTF: u32 = 1 << 26;
const RMVF: u32 = 1 << 23;

/// The watchdog; clones share it.
#[derive(Clone, Debug)]
pub struct Iwdg(Arc<Mutex<State>>);

/// The reset cause flags.
#[derive(Debug)]
pub struct ResetFlags(Iwdg);

#[derive(Debug, Default)]
struct State {
    is_running: bool,
    is_unlocked: bool,
    prescaler: u32,
    reload: u32,
    window: u32,
    /// Remaining time of PVU and RVU.
    updating: [Duration; 2],
    /// Time until it resets the machine.
    left: Duration,
    flags: u32,
    resets: u32,
    derailment: Option<Derailment>,
}

impl Iwdg {
    /// Creates a stopped watchdog after power-on.
    #[must_use]
    pub fn new() -> Self {
        let mut state = State { flags: BORRSTF | PINRSTF, ..State::default() };
        state.reset();
        Self(Arc::new(Mutex::new(state)))
    }

    /// Returns the reset cause flags, which are a separate peripheral.
    #[must_use]
    pub fn flags(&self) -> ResetFlags {
        ResetFlags(self.clone())
    }

    /// Returns the number of resets that it has caused.
    #[must_use]
    pub fn resets(&self) -> u32 {
        self.lock().resets
    }

    /// Returns the configured time-out; `None` while stopped.
    #[must_use]
    pub fn timeout(&self) -> Option<Duration> {
        let state = self.lock();
        state.is_running.then(|| state.timeout())
    }

    /// Makes the firmware hang after its next access to the watchdog, which the main loop makes.
    pub fn derail(&self, how: Derailment) {
        self.lock().derailment = Some(how);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Default for Iwdg {
    fn default() -> Self {
        Self::new()
    }
}

impl State {
    /// Resets the watchdog: stopped, with reset values.
    fn reset(&mut self) {
        (self.is_running, self.is_unlocked) = (false, false);
        (self.prescaler, self.reload, self.window) = (0, 0xFFF, 0xFFF);
        self.updating = [Duration::ZERO; 2];
    }

    /// 36.3.2: the counter runs from the reload value down to 0 at the prescaled clock.
    fn timeout(&self) -> Duration {
        // 110b and 111b both divide by 256.
        LSI_CYCLE * (4 << self.prescaler.min(6)) * (self.reload + 1)
    }

    fn store(&mut self, offset: u32, value: u32) -> Result<()> {
        match offset {
            KR => {
                // 36.3.4: any other key locks again.
                self.is_unlocked = value & 0xFFFF == UNLOCK;
                match value & 0xFFFF {
                    START => self.is_running = true,
                    RELOAD | UNLOCK => {}
                    other => bail!("IWDG: unknown key {other:#06X}"),
                }
                if value & 0xFFFF != UNLOCK {
                    self.left = self.timeout();
                }
            }
            PR | RLR => {
                let at = usize::from(offset == RLR);
                // Writes without the key or during an update are ignored (36.4.2, 36.4.3).
                if self.is_unlocked && self.updating[at].is_zero() {
                    let register = if offset == PR { &mut self.prescaler } else { &mut self.reload };
                    *register = value & if offset == PR { 0b111 } else { 0xFFF };
                    self.updating[at] = UPDATE;
                }
            }
            WINR => bail!("the window of IWDG is not modelled"),
            _ => bail!("IWDG: no writable register at {offset:#04X}"),
        }
        Ok(())
    }
}

impl RegisterModel for Iwdg {
    fn addresses(&self) -> Range<u32> {
        IWDG..IWDG + 0x14
    }

    fn load(&mut self, address: u32) -> Result<u32> {
        let state = self.lock();
        Ok(match address - IWDG {
            KR => 0,
            PR => state.prescaler,
            RLR => state.reload,
            SR => {
                let flags = [PVU, RVU].into_iter().zip(state.updating);
                flags.filter(|(_, left)| !left.is_zero()).fold(0, |bits, (bit, _)| bits | bit)
            }
            WINR => state.window,
            offset => bail!("IWDG: no register at {offset:#04X}"),
        })
    }

    fn store(&mut self, address: u32, value: u32) -> Result<()> {
        self.lock().store(address - IWDG, value)
    }

    fn advance(&mut self, time: Duration) {
        for left in &mut self.lock().updating {
            *left = left.saturating_sub(time);
        }
    }

    fn has_run(&mut self, time: Duration) {
        let state = &mut *self.lock();
        if state.is_running {
            state.left = state.left.saturating_sub(time);
        }
    }

    fn resets_machine(&self) -> Option<bool> {
        let state = self.lock();
        Some(state.is_running && state.left.is_zero())
    }

    fn reset(&mut self) {
        let state = &mut *self.lock();
        state.reset();
        // 6.1.1: an internal reset also drives the reset pin.
        state.flags |= IWDGRSTF | PINRSTF;
        state.resets += 1;
    }

    fn derailment(&mut self) -> Option<Derailment> {
        self.lock().derailment.take()
    }
}

impl RegisterModel for ResetFlags {
    fn addresses(&self) -> Range<u32> {
        RCC_CSR..RCC_CSR + 4
    }

    fn load(&mut self, _: u32) -> Result<u32> {
        Ok(self.0.lock().flags)
    }

    fn store(&mut self, _: u32, value: u32) -> Result<()> {
        if value & RMVF != 0 {
            self.0.lock().flags = 0;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
