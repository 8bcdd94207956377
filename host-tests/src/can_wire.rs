//! A CAN frame on the wire: its arbitration field and its duration (ISO 11898-1).

use embedded_can::{ExtendedId, Frame, Id, StandardId};

/// Maximum number of data bytes.
pub const MAX_DATA: usize = 8;

/// Bits in addition to identifier and data: start, control, CRC, acknowledgement, end of frame; without stuff bits.
const OVERHEAD_BITS: u32 = 1 + 1 + 6 + 16 + 2 + 7;

/// Idle bits between two frames.
const INTERMISSION_BITS: u32 = 3;

/// A classic CAN frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WireFrame {
    /// The identifier.
    pub id: Id,
    /// Whether it is a remote frame.
    pub is_remote: bool,
    /// Data length code, 0 to 15; values above 8 mean 8 bytes.
    pub dlc: u8,
    /// Data, zero-padded.
    pub data: [u8; MAX_DATA],
}

impl WireFrame {
    /// Creates a data frame with the lowest 11 bits of `id` as standard identifier.
    #[must_use]
    pub fn standard(id: u16, data: &[u8]) -> Self {
        Self::new(Id::Standard(StandardId::new(id & 0x7FF).unwrap_or(StandardId::ZERO)), data)
    }

    /// Creates a data frame with the lowest 29 bits of `id` as extended identifier.
    #[must_use]
    pub fn extended(id: u32, data: &[u8]) -> Self {
        Self::new(Id::Extended(ExtendedId::new(id & 0x1FFF_FFFF).unwrap_or(ExtendedId::ZERO)), data)
    }

    /// Creates a data frame from the first 8 bytes of `data`.
    #[must_use]
    pub fn new(id: Id, data: &[u8]) -> Self {
        let mut bytes = [0; MAX_DATA];
        for (place, byte) in bytes.iter_mut().zip(data) {
            *place = *byte;
        }
        Self { id, is_remote: false, dlc: data.len().min(MAX_DATA) as u8, data: bytes }
    }

    /// Creates a data frame with the identifier of [`id_bits`](Self::id_bits). Higher bits are ignored.
    pub(crate) fn of_id_bits((id, is_extended): (u32, bool), data: &[u8]) -> Self {
        if is_extended { Self::extended(id, data) } else { Self::standard((id >> 18) as u16, data) }
    }

    /// Creates a frame from the fields of a controller's buffer: the identifier as in [`of_id_bits`](Self::of_id_bits),
    /// and the data in two little-endian words. Bytes beyond the length are dropped.
    pub(crate) fn from_fields(id: (u32, bool), is_remote: bool, dlc: u8, [low, high]: [u32; 2]) -> Self {
        let mut data = [0; MAX_DATA];
        data[..4].copy_from_slice(&low.to_le_bytes());
        data[4..].copy_from_slice(&high.to_le_bytes());
        let frame = Self { dlc, ..Self::of_id_bits(id, &data[..usize::from(dlc).min(MAX_DATA)]) };
        if is_remote { frame.remote() } else { frame }
    }

    /// Returns the identifier as 29 bits, a standard one in the upper 11, and whether it is extended.
    pub(crate) fn id_bits(&self) -> (u32, bool) {
        match self.id {
            Id::Standard(id) => (u32::from(id.as_raw()) << 18, false),
            Id::Extended(id) => (id.as_raw(), true),
        }
    }

    /// Returns the data in two little-endian words.
    pub(crate) fn words(&self) -> [u32; 2] {
        let [a, b, c, d, e, f, g, h] = self.data;
        [u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h])]
    }

    /// Converts to a remote frame without data.
    #[must_use]
    pub fn remote(self) -> Self {
        Self { is_remote: true, data: [0; MAX_DATA], ..self }
    }

    /// Converts from another frame type, whose length is at most 8.
    #[must_use]
    pub fn of<F: Frame>(frame: &F) -> Self {
        let mut this = Self::new(frame.id(), frame.data());
        this.is_remote = frame.is_remote_frame();
        this.dlc = frame.dlc() as u8;
        this
    }

    /// Converts to another frame type; a length above 8 becomes 8.
    #[must_use]
    pub fn to<F: Frame>(&self) -> Option<F> {
        let len = usize::from(self.dlc).min(MAX_DATA);
        if self.is_remote { F::new_remote(self.id, len) } else { F::new(self.id, &self.data[..len]) }
    }

    /// Returns the data bytes.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        let len = if self.is_remote { 0 } else { usize::from(self.dlc).min(MAX_DATA) };
        &self.data[..len]
    }

    /// Returns the arbitration field, left-aligned; the lower value wins.
    #[must_use]
    pub fn arbitration(&self) -> u32 {
        let remote = u32::from(self.is_remote);
        match self.id {
            Id::Standard(id) => u32::from(id.as_raw()) << 21 | remote << 20,
            // SRR and IDE are recessive.
            Id::Extended(id) => {
                let (base, rest) = (id.as_raw() >> 18, id.as_raw() & 0x3_FFFF);
                base << 21 | 0b11 << 19 | rest << 1 | remote
            }
        }
    }

    /// Returns the number of bits on the bus, including intermission, without stuff bits.
    #[must_use]
    pub fn bits(&self) -> u32 {
        let id = if matches!(self.id, Id::Extended(_)) { 29 + 2 } else { 11 };
        OVERHEAD_BITS + id + 8 * self.payload().len() as u32 + INTERMISSION_BITS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lower_identifiers_standard_and_data_frames_win_arbitration() {
        let standard = WireFrame::standard(0x120, &[1]);
        let higher = WireFrame::standard(0x121, &[]);
        let same_base = WireFrame::extended(0x120 << 18, &[]);
        let order = [standard, standard.remote(), same_base, same_base.remote(), higher];
        assert!(order.is_sorted_by_key(WireFrame::arbitration));
        assert!(order.windows(2).all(|pair| pair[0].arbitration() != pair[1].arbitration()));
    }

    #[test]
    fn a_frame_takes_as_many_bits_as_the_standard_says() {
        assert_eq!(WireFrame::standard(0, &[]).bits(), 47);
        assert_eq!(WireFrame::standard(0, &[0; 8]).bits(), 47 + 64);
        assert_eq!(WireFrame::extended(0, &[0; 8]).bits(), 67 + 64);
        assert_eq!(WireFrame::standard(0, &[0; 8]).remote().bits(), 47);
    }
}
