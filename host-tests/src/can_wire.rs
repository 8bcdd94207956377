//! A frame as it is on the wire of a CAN bus: what arbitration sees, and how long it takes (ISO 11898-1).

use embedded_can::{ExtendedId, Frame, Id, StandardId};

/// Bytes of data in a frame.
pub const MAX_DATA: usize = 8;

/// Bits of a frame around its identifier and data: start, control, CRC, acknowledgement, end. Stuff bits are not counted.
const OVERHEAD_BITS: u32 = 1 + 1 + 6 + 16 + 2 + 7;

/// Bits between two frames.
const INTERMISSION_BITS: u32 = 3;

/// A frame of classic CAN.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WireFrame {
    /// Its identifier.
    pub id: Id,
    /// Whether it asks for data instead of bringing some.
    pub is_remote: bool,
    /// Its length field, 0 to 15; above 8 it also means 8.
    pub dlc: u8,
    /// Its data; what the length does not cover is 0.
    pub data: [u8; MAX_DATA],
}

impl WireFrame {
    /// A data frame with a standard identifier; the lowest 11 bits of `id`.
    #[must_use]
    pub fn standard(id: u16, data: &[u8]) -> Self {
        Self::new(Id::Standard(StandardId::new(id & 0x7FF).unwrap_or(StandardId::ZERO)), data)
    }

    /// A data frame with an extended identifier; the lowest 29 bits of `id`.
    #[must_use]
    pub fn extended(id: u32, data: &[u8]) -> Self {
        Self::new(Id::Extended(ExtendedId::new(id & 0x1FFF_FFFF).unwrap_or(ExtendedId::ZERO)), data)
    }

    /// A data frame with up to 8 bytes; more are left out.
    #[must_use]
    pub fn new(id: Id, data: &[u8]) -> Self {
        let mut bytes = [0; MAX_DATA];
        for (place, byte) in bytes.iter_mut().zip(data) {
            *place = *byte;
        }
        Self { id, is_remote: false, dlc: data.len().min(MAX_DATA) as u8, data: bytes }
    }

    /// The same as a remote frame, without data.
    #[must_use]
    pub fn remote(self) -> Self {
        Self { is_remote: true, data: [0; MAX_DATA], ..self }
    }

    /// A frame of another type, which cannot have a length above 8.
    #[must_use]
    pub fn of<F: Frame>(frame: &F) -> Self {
        let mut this = Self::new(frame.id(), frame.data());
        this.is_remote = frame.is_remote_frame();
        this.dlc = frame.dlc() as u8;
        this
    }

    /// As another type of frame; a length above 8 is 8 there.
    #[must_use]
    pub fn to<F: Frame>(&self) -> Option<F> {
        let len = usize::from(self.dlc).min(MAX_DATA);
        if self.is_remote { F::new_remote(self.id, len) } else { F::new(self.id, &self.data[..len]) }
    }

    /// The bytes that it brings.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        let len = if self.is_remote { 0 } else { usize::from(self.dlc).min(MAX_DATA) };
        &self.data[..len]
    }

    /// Its arbitration field, from the top bit on; where two begin at once the lower one goes on.
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

    /// Bits on the bus, with the pause behind it and without stuff bits.
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
    fn arbitration_is_won_by_the_lower_identifier_data_before_remote_and_standard_before_extended() {
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
