//! Six filters and two masks (4.5).

use crate::can_wire::WireFrame;

/// RXFnSIDL: the filter applies to extended identifiers (register 4-11).
const EXIDE: u8 = 1 << 3;

/// Row of the masks; the filters precede it in two rows of three.
const MASKS: u8 = 0x20;

/// SIDH, SIDL, EID8 and EID0 of filters and masks.
#[derive(Clone, Debug, Default)]
pub(super) struct Filters {
    filters: [[u8; 4]; 6],
    masks: [[u8; 4]; 2],
}

impl Filters {
    pub(super) fn load(&self, address: u8) -> u8 {
        match place(address) {
            Some((MASKS.., n, byte)) => self.masks[n][byte],
            Some((_, n, byte)) => self.filters[n][byte],
            None => 0,
        }
    }

    pub(super) fn store(&mut self, address: u8, value: u8) {
        // SIDL has unimplemented bits.
        match place(address) {
            Some((MASKS.., n, byte)) => self.masks[n][byte] = if byte == 1 { value & 0xE3 } else { value },
            Some((_, n, byte)) => self.filters[n][byte] = if byte == 1 { value & 0xEB } else { value },
            None => {}
        }
    }

    /// Returns the buffer for a frame and the matching filter. `takes_any` lists the buffers whose filters are off.
    pub(super) fn pass(&self, frame: &WireFrame, takes_any: [bool; 2]) -> Option<(usize, u8)> {
        [0..2, 2..6].into_iter().enumerate().find_map(|(buffer, filters)| {
            if takes_any[buffer] {
                return Some((buffer, filters.start as u8));
            }
            let matching = filters.into_iter().find(|&n| matches(self.filters[n], self.masks[buffer], frame));
            Some((buffer, matching? as u8))
        })
    }
}

/// Returns the row, the index of the filter or mask, and the byte in it.
fn place(address: u8) -> Option<(u8, usize, usize)> {
    let (row, column) = (address & 0xF0, usize::from(address & 0xF));
    let number = match row {
        0x00 if column < 12 => column / 4,
        0x10 if column < 12 => 3 + column / 4,
        MASKS if column < 8 => column / 4,
        _ => return None,
    };
    Some((row, number, column % 4))
}

/// Masks of data bytes, which the lower bits of a mask are for standard identifiers (4.5), are not modelled.
fn matches(filter: [u8; 4], mask: [u8; 4], frame: &WireFrame) -> bool {
    let (value, is_extended) = frame.id_bits();
    (filter[1] & EXIDE != 0) == is_extended && (identifier(filter) ^ value) & identifier(mask) == 0
}

/// Returns 29 bits, with the standard identifier in the upper 11.
pub(super) fn identifier([sidh, sidl, eid8, eid0]: [u8; 4]) -> u32 {
    let (standard, extended) = (u32::from(sidh) << 3 | u32::from(sidl >> 5), u32::from(sidl & 0b11));
    standard << 18 | extended << 16 | u32::from(eid8) << 8 | u32::from(eid0)
}
