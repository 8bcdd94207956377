//! Acceptance filtering (44.3.3, 44.3.8, 44.3.9, 44.4.19).

use embedded_can::Id;

use super::{EXTENDED_FILTERS, Fdcan, HPM, IR, RXGFC};
use crate::can_wire::WireFrame;

/// Filter actions SFEC and EFEC: FIFO 0, FIFO 1, reject. The upper bit sets HPM.
const FIFO_0: u32 = 1;
const REJECT: u32 = 3;
const PRIORITY: u32 = 1 << 2;

impl Fdcan {
    /// Filters and stores a valid frame: first by remote frames, then by the list, then by the lack of a match. Returns whether
    /// it is for a FIFO.
    pub(super) fn filter(&mut self, frame: &WireFrame) -> bool {
        let config = self.registers[RXGFC];
        // RRFS or RRFE, ANFS or ANFE, LSS or LSE. Larger sizes mean all filters.
        let (rejects_remote, non_matching, len) = match frame.id {
            Id::Standard(_) => (config & 0b10, config >> 4 & 0b11, (config >> 16 & 0x1F).min(28)),
            Id::Extended(_) => (config & 0b01, config >> 2 & 0b11, (config >> 24 & 0xF).min(8)),
        };
        if frame.is_remote && rejects_remote != 0 {
            return false;
        }
        let hit = (0..len).find_map(|n| Some((n, self.action(n as usize, frame.id)?)));
        let action = hit.map_or(REJECT.min(FIFO_0 + non_matching), |(_, action)| action);
        self.registers[IR] |= if action & PRIORITY != 0 { HPM } else { 0 };
        let fifo = action & !PRIORITY;
        if !(FIFO_0..REJECT).contains(&fifo) {
            return false;
        }
        self.put((fifo - FIFO_0) as usize, hit.map(|(n, _)| n), frame);
        true
    }

    /// Returns the action of filter `n` if it is enabled and matches.
    fn action(&self, n: usize, id: Id) -> Option<u32> {
        let (id, kind, action, first, second) = match id {
            Id::Standard(id) => {
                let s0 = self.ram[n];
                (u32::from(id.as_raw()), s0 >> 30, s0 >> 27 & 0b111, s0 >> 16 & 0x7FF, s0 & 0x7FF)
            }
            Id::Extended(id) => {
                let [f0, f1] = [0, 1].map(|word| self.ram[EXTENDED_FILTERS + 2 * n + word]);
                // Type 3 is a range, too: it ignores XIDAM, which is not modelled.
                (id.as_raw(), (f1 >> 30) % 3, f0 >> 29, f0 & 0x1FFF_FFFF, f1 & 0x1FFF_FFFF)
            }
        };
        // Range, dual, classic with a mask, disabled.
        let matches = match kind {
            0 => (first..=second).contains(&id),
            1 => id == first || id == second,
            2 => (id ^ first) & second == 0,
            _ => false,
        };
        // 0 disables a filter; 7 is reserved, which disables it, too.
        (matches && !matches!(action, 0 | 7)).then_some(action)
    }
}
