//! Which messages are received, and into which FIFO (RM0351, 46.7.4, 46.9.4).

use anyhow::{Result, bail};
use embedded_can::Id;

use crate::can_wire::WireFrame;

/// Banks of a chip with one controller.
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
/// FINIT, and where the banks of a second controller begin, which this chip has not.
const FMR_BITS: u32 = 0x3F01;

#[derive(Clone, Debug)]
pub(super) struct Filters {
    fmr: u32,
    /// A bit for each bank: list or mask, 32 or 16 bits, FIFO 1 or 0, active or not.
    is_list: u32,
    is_wide: u32,
    fifo: u32,
    is_active: u32,
    banks: [[u32; 2]; BANKS],
}

/// One of the filters in a bank.
struct Filter {
    is_wide: bool,
    is_list: bool,
    id: u32,
    mask: u32,
}

impl Filters {
    pub(super) const fn new() -> Self {
        Self { fmr: 0x2A1C_0E01, is_list: 0, is_wide: 0, fifo: 0, is_active: 0, banks: [[0; 2]; BANKS] }
    }

    fn is_initialising(&self) -> bool {
        self.fmr & FINIT != 0
    }

    pub(super) fn load(&self, offset: u32) -> Result<u32> {
        Ok(match offset {
            FMR => self.fmr,
            FM1R => self.is_list,
            FS1R => self.is_wide,
            FFA1R => self.fifo,
            FA1R => self.is_active,
            BANK_0..END => self.banks[((offset - BANK_0) / 8) as usize][(offset / 4 % 2) as usize],
            _ => bail!("bxCAN has no register at {:#05X}", super::FILTERS + offset),
        })
    }

    /// Whether it was taken: modes, widths and FIFOs only while the filters are initialised, a bank also while it is not
    /// active.
    pub(super) fn store(&mut self, offset: u32, value: u32) -> Result<bool> {
        let is_initialising = self.is_initialising();
        let bits = match offset {
            FMR => {
                self.fmr = self.fmr & !FMR_BITS | value & FMR_BITS;
                return Ok(true);
            }
            FA1R => {
                self.is_active = value & ALL;
                return Ok(true);
            }
            BANK_0..END => {
                let bank = ((offset - BANK_0) / 8) as usize;
                let is_free = is_initialising || self.is_active & 1 << bank == 0;
                if is_free {
                    self.banks[bank][(offset / 4 % 2) as usize] = value;
                }
                return Ok(is_free);
            }
            FM1R => &mut self.is_list,
            FS1R => &mut self.is_wide,
            FFA1R => &mut self.fifo,
            _ => bail!("bxCAN has no register at {:#05X}", super::FILTERS + offset),
        };
        if is_initialising {
            *bits = value & ALL;
        }
        Ok(is_initialising)
    }

    /// The FIFO for a message, and the number of the filter that it passed; `None`: it passes none, or reception is
    /// switched off while the filters are initialised.
    pub(super) fn pass(&self, frame: &WireFrame) -> Option<(usize, u8)> {
        if self.is_initialising() {
            return None;
        }
        let mut numbers = [0u8; 2];
        let mut passed: Vec<(bool, bool, u8, usize)> = Vec::new();
        for bank in 0..BANKS {
            let fifo = usize::from(self.fifo & 1 << bank != 0);
            for filter in self.filters(bank) {
                // Filters count whether they are active or not.
                let number = numbers[fifo];
                numbers[fifo] += 1;
                let seen = if filter.is_wide { wide(frame) } else { narrow(frame) };
                if self.is_active & 1 << bank != 0 && (seen ^ filter.id) & filter.mask == 0 {
                    passed.push((!filter.is_wide, !filter.is_list, number, fifo));
                }
            }
        }
        // 32 bits before 16, a list before a mask, and then the lowest number.
        passed.into_iter().min().map(|(_, _, number, fifo)| (fifo, number))
    }

    fn filters(&self, bank: usize) -> Vec<Filter> {
        let (is_wide, is_list) = (self.is_wide & 1 << bank != 0, self.is_list & 1 << bank != 0);
        let [first, second] = self.banks[bank];
        let filter = |id, mask| Filter { is_wide, is_list, id, mask };
        let halves = |register: u32| (register & 0xFFFF, register >> 16);
        match (is_wide, is_list) {
            // Bit 0 of a register of 32 bits means nothing.
            (true, false) => vec![filter(first, second & !1)],
            (true, true) => vec![filter(first, !1), filter(second, !1)],
            (false, false) => {
                [first, second].map(halves).into_iter().map(|(id, mask)| filter(id, mask)).collect()
            }
            (false, true) => {
                let ids = [first, second].map(halves).into_iter().flat_map(|(low, high)| [low, high]);
                ids.map(|id| filter(id, 0xFFFF)).collect()
            }
        }
    }
}

/// A message as a filter of 32 bits sees it: STID, EXID, IDE, RTR, 0.
fn wide(frame: &WireFrame) -> u32 {
    let id = match frame.id {
        Id::Standard(id) => u32::from(id.as_raw()) << 21,
        Id::Extended(id) => id.as_raw() << 3 | 1 << 2,
    };
    id | u32::from(frame.is_remote) << 1
}

/// A message as a filter of 16 bits sees it: STID, RTR, IDE, the upper three bits of EXID.
fn narrow(frame: &WireFrame) -> u32 {
    let remote = u32::from(frame.is_remote) << 4;
    match frame.id {
        Id::Standard(id) => u32::from(id.as_raw()) << 5 | remote,
        Id::Extended(id) => id.as_raw() >> 18 << 5 | remote | 1 << 3 | id.as_raw() >> 15 & 0b111,
    }
}
