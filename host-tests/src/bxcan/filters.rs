//! Acceptance filters with 32-bit masks (RM0351, 46.7.4, 46.9.4).

use anyhow::{Result, bail, ensure};

use crate::can_wire::WireFrame;

/// Filter banks of a chip with one controller.
const BANKS: usize = 14;
const ALL: u32 = (1 << BANKS) - 1;

/// Offsets from FMR.
const FMR: u32 = 0x00;
const FM1R: u32 = 0x04;
const FS1R: u32 = 0x0C;
const FFA1R: u32 = 0x14;
const FA1R: u32 = 0x1C;
const BANK_0: u32 = 0x40;
const END: u32 = BANK_0 + 8 * BANKS as u32;

const FINIT: u32 = 1 << 0;
/// FINIT, and the start bank of a second controller, which this chip lacks.
const FMR_BITS: u32 = 0x3F01;

#[derive(Clone, Debug)]
pub(super) struct Filters {
    fmr: u32,
    /// One bit per bank: 32-bit scale, and active.
    is_wide: u32,
    is_active: u32,
    /// Identifier and mask.
    banks: [[u32; 2]; BANKS],
}

impl Filters {
    pub(super) const fn new() -> Self {
        Self { fmr: 0x2A1C_0E01, is_wide: 0, is_active: 0, banks: [[0; 2]; BANKS] }
    }

    fn is_initialising(&self) -> bool {
        self.fmr & FINIT != 0
    }

    pub(super) fn load(&self, offset: u32) -> Result<u32> {
        Ok(match offset {
            FMR => self.fmr,
            FM1R | FFA1R => 0,
            FS1R => self.is_wide,
            FA1R => self.is_active,
            BANK_0..END => self.banks[((offset - BANK_0) / 8) as usize][(offset / 4 % 2) as usize],
            _ => bail!("bxCAN has no register at {:#05X}", super::FILTERS + offset),
        })
    }

    /// Returns whether the store takes effect: scales only during initialisation, a bank also while inactive.
    pub(super) fn store(&mut self, offset: u32, value: u32) -> Result<bool> {
        let is_initialising = self.is_initialising();
        match offset {
            FMR => self.fmr = self.fmr & !FMR_BITS | value & FMR_BITS,
            FA1R => self.is_active = value & ALL,
            BANK_0..END => {
                let bank = ((offset - BANK_0) / 8) as usize;
                if !is_initialising && self.is_active & 1 << bank != 0 {
                    return Ok(false);
                }
                self.banks[bank][(offset / 4 % 2) as usize] = value;
            }
            FM1R | FFA1R | FS1R if !is_initialising => return Ok(false),
            FM1R | FFA1R => ensure!(value & ALL == 0, "list filters and FIFO 1 are not modelled"),
            FS1R => self.is_wide = value & ALL,
            _ => bail!("bxCAN has no register at {:#05X}", super::FILTERS + offset),
        }
        ensure!(self.is_active & !self.is_wide == 0, "filters of 16 bits are not modelled");
        Ok(true)
    }

    /// Returns the index of the first matching filter; `None` without a match, or while initialisation disables
    /// reception.
    pub(super) fn pass(&self, frame: &WireFrame) -> Option<u8> {
        if self.is_initialising() {
            return None;
        }
        let seen = rir(frame);
        let bank = (0..BANKS).find(|&bank| {
            let [id, mask] = self.banks[bank];
            // Bit 0 is unused.
            self.is_active & 1 << bank != 0 && (seen ^ id) & mask & !1 == 0
        })?;
        // Inactive banks count as well; a 16-bit bank holds two filters.
        Some((0..bank).map(|bank| if self.is_wide & 1 << bank != 0 { 1 } else { 2 }).sum())
    }
}

/// Returns RIxR of a message, which a filter compares: STID, EXID, IDE, RTR, 0.
pub(super) fn rir(frame: &WireFrame) -> u32 {
    let (id, is_extended) = frame.id_bits();
    id << 3 | u32::from(is_extended) << 2 | u32::from(frame.is_remote) << 1
}
