//! The independent watchdog of the STM32L4 (RM0351, chapter 36), and the flags that tell who has reset the machine (6.4.29).

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Result, bail};

use crate::load_store::Width;
use crate::registers::{Derailment, RegisterModel, ensure_word};

/// Where its registers are, and offsets (RM0351, table 1; 36.4).
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

/// PVU and RVU: a new value is on its way to the slow clock (36.4.4).
const PVU: u32 = 1 << 0;
const RVU: u32 = 1 << 1;

/// A cycle of the slow clock, LSI at its nominal 32 kHz, and how many of them a new value takes at the most.
const LSI_CYCLE: Duration = Duration::from_nanos(31_250);
const UPDATE: Duration = Duration::from_nanos(5 * 31_250);

/// RCC_CSR, and its bits for the watchdog, brown-out and the pin, and the one that clears them all.
const RCC_CSR: u32 = 0x4002_1094;
const IWDGRSTF: u32 = 1 << 29;
const BORRSTF: u32 = 1 << 27;
const PINRSTF: u32 = 1 << 26;
const RMVF: u32 = 1 << 23;

/// The watchdog; clones are the same one.
#[derive(Clone, Debug)]
pub struct Iwdg(Arc<Mutex<State>>);

/// The flags of the last reset.
#[derive(Debug)]
pub struct ResetFlags(Iwdg);

#[derive(Debug)]
struct State {
    is_running: bool,
    is_unlocked: bool,
    prescaler: u32,
    reload: u32,
    window: u32,
    /// How long PVU and RVU stay set.
    updating: [Duration; 2],
    /// Until it resets the machine.
    left: Duration,
    flags: u32,
    resets: u32,
    derailment: Option<Derailment>,
}

impl Iwdg {
    /// A watchdog that does not run, after power-on.
    #[must_use]
    pub fn new() -> Self {
        let mut state = State {
            is_running: false,
            is_unlocked: false,
            prescaler: 0,
            reload: 0,
            window: 0,
            updating: [Duration::ZERO; 2],
            left: Duration::ZERO,
            flags: BORRSTF | PINRSTF,
            resets: 0,
            derailment: None,
        };
        state.reset();
        Self(Arc::new(Mutex::new(state)))
    }

    /// The flags beside it: a peripheral of their own.
    #[must_use]
    pub fn flags(&self) -> ResetFlags {
        ResetFlags(self.clone())
    }

    /// How often it has reset the machine.
    #[must_use]
    pub fn resets(&self) -> u32 {
        self.lock().resets
    }

    /// The time that it gives; `None`: it does not run.
    #[must_use]
    pub fn timeout(&self) -> Option<Duration> {
        let state = self.lock();
        state.is_running.then(|| state.timeout())
    }

    /// Lets the firmware hang behind its next access to the watchdog, which is that of its main loop.
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
    /// What a reset leaves: the watchdog off, and its values those of reset.
    fn reset(&mut self) {
        (self.is_running, self.is_unlocked) = (false, false);
        (self.prescaler, self.reload, self.window) = (0, 0xFFF, 0xFFF);
        self.updating = [Duration::ZERO; 2];
    }

    /// 36.3.2: the counter runs from the reload value to 0 at the prescaled clock.
    fn timeout(&self) -> Duration {
        // 110 and 111 both divide by 256.
        LSI_CYCLE * (4 << self.prescaler.min(6)) * (self.reload + 1)
    }

    fn store(&mut self, offset: u32, value: u32) -> Result<()> {
        match offset {
            KR => {
                // 36.3.4: another key locks again.
                self.is_unlocked = value & 0xFFFF == UNLOCK;
                match value & 0xFFFF {
                    START => self.is_running = true,
                    RELOAD | UNLOCK => {}
                    other => bail!("IWDG has no key {other:#06X}"),
                }
                if value & 0xFFFF != UNLOCK {
                    self.left = self.timeout();
                }
            }
            PR | RLR => {
                let at = usize::from(offset == RLR);
                // Without the key, and while the value before is on its way, nothing is taken (36.4.2, 36.4.3).
                if self.is_unlocked && self.updating[at].is_zero() {
                    let register = if offset == PR { &mut self.prescaler } else { &mut self.reload };
                    *register = value & if offset == PR { 0b111 } else { 0xFFF };
                    self.updating[at] = UPDATE;
                }
            }
            WINR => bail!("the window of IWDG is not modelled"),
            _ => bail!("IWDG has no register to store to at {offset:#04X}"),
        }
        Ok(())
    }
}

impl RegisterModel for Iwdg {
    fn addresses(&self) -> Range<u32> {
        IWDG..IWDG + 0x14
    }

    fn load(&mut self, address: u32, width: Width) -> Result<u32> {
        ensure_word(address, width)?;
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
            offset => bail!("IWDG has no register at {offset:#04X}"),
        })
    }

    fn store(&mut self, address: u32, width: Width, value: u32) -> Result<()> {
        ensure_word(address, width)?;
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

    fn is_watchdog(&self) -> bool {
        true
    }

    fn resets_machine(&self) -> bool {
        let state = self.lock();
        state.is_running && state.left.is_zero()
    }

    fn reset(&mut self) {
        let state = &mut *self.lock();
        state.reset();
        // 6.1.1: an internal reset also pulls the pin.
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

    fn load(&mut self, address: u32, width: Width) -> Result<u32> {
        ensure_word(address, width)?;
        Ok(self.0.lock().flags)
    }

    fn store(&mut self, address: u32, width: Width, value: u32) -> Result<()> {
        ensure_word(address, width)?;
        if value & RMVF != 0 {
            self.0.lock().flags = 0;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
