//! Acceptance filtering (44.3.3, 44.3.8, 44.3.9, 44.4.19).

use embedded_can::Id;

use super::{EXTENDED_FILTERS, Fdcan, HPM, RXGFC, XIDAM};
use crate::can_wire::WireFrame;

/// Filter types SFT and EFT. Type 3 is a disabled standard filter, or an extended range without XIDAM.
const DUAL: u32 = 1;
const CLASSIC: u32 = 2;
const THIRD: u32 = 3;

/// Lower bits of the filter actions SFEC and EFEC: FIFO 0 and FIFO 1. The upper bit sets HPM.
const TO_FIFO: [u32; 2] = [1, 2];
const PRIORITY: u32 = 1 << 2;

impl Fdcan {
    /// Filters and stores a valid frame: first by remote frames, then by the list, then by the lack of a match.
    pub(super) fn filter(&mut self, frame: &WireFrame) {
        let config = self.registers[&RXGFC];
        let (id, is_extended) = match frame.id {
            Id::Standard(id) => (u32::from(id.as_raw()), false),
            Id::Extended(id) => (id.as_raw(), true),
        };
        // RRFE or RRFS, ANFE or ANFS, LSE or LSS. Larger sizes mean all filters.
        let (rejects_remote, non_matching, len) = if is_extended {
            (config & 0b01, config >> 2 & 0b11, (config >> 24 & 0xF).min(8))
        } else {
            (config & 0b10, config >> 4 & 0b11, (config >> 16 & 0x1F).min(28))
        };
        if frame.is_remote && rejects_remote != 0 {
            return;
        }
        let hit = (0..len).find_map(|n| Some((n, self.action(n, id, is_extended)?)));
        let fifo = match hit {
            Some((_, action)) => TO_FIFO.iter().position(|to| *to == action & !PRIORITY),
            None => [0, 1].into_iter().find(|fifo| *fifo == non_matching as usize),
        };
        if hit.is_some_and(|(_, action)| action & PRIORITY != 0) {
            self.ir |= HPM;
        }
        if let Some(fifo) = fifo {
            self.put(fifo, hit.map(|(n, _)| n), frame);
            self.accepted.push(*frame);
        }
    }

    /// Returns the action of filter `n` if it is enabled and matches.
    fn action(&self, n: u32, id: u32, is_extended: bool) -> Option<u32> {
        let (kind, action, first, second, id) = if is_extended {
            let [f0, f1] = [0, 1].map(|word| self.ram[EXTENDED_FILTERS + 2 * n as usize + word]);
            let id = if f1 >> 30 == THIRD { id } else { id & self.registers[&XIDAM] };
            (f1 >> 30, f0 >> 29, f0 & 0x1FFF_FFFF, f1 & 0x1FFF_FFFF, id)
        } else {
            let s0 = self.ram[n as usize];
            let action = if s0 >> 30 == THIRD { 0 } else { s0 >> 27 & 0b111 };
            (s0 >> 30, action, s0 >> 16 & 0x7FF, s0 & 0x7FF, id)
        };
        let matches = match kind {
            DUAL => id == first || id == second,
            CLASSIC => (id ^ first) & second == 0,
            _ => (first..=second).contains(&id),
        };
        // 0 disables a filter; 7 is reserved, which disables it, too.
        (matches && !matches!(action, 0 | 7)).then_some(action)
    }
}
