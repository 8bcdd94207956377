//! The message RAM of FDCAN1: filters and frame elements (RM0440, FDCAN, "Message RAM").
//!
//! The layout is fixed on an STM32G4, and `stm32-metapac` names its parts. The bus is classic CAN, so an element has at most
//! eight data bytes.

use bus_slcan::ClassicFrame;
use embedded_can::{ExtendedId, Frame, Id, StandardId};

/// Elements of a receive FIFO, and number of transmit buffers.
pub const ELEMENTS: usize = 3;

/// Words from one element to the next: two header words and 64 data bytes.
pub const ELEMENT_STRIDE: usize = 18;

/// The words of a classic frame's element: identifier, length and eight data bytes.
pub type Element = [u32; 4];

/// First word of an element: extended identifier, remote frame, position of a standard identifier.
const XTD: u32 = 1 << 30;
const RTR: u32 = 1 << 29;
const STANDARD_AT: u32 = 18;

/// Second word of an element: position of the length.
const DLC_AT: u32 = 16;

/// Maximum number of data bytes. A length code above 8, up to 15, also means 8 (ISO 11898-1).
const MAX_DATA_LEN: usize = 8;

/// Filter word: filter by identifier and mask, target FIFO, position of the identifier. The mask is in the lowest bits.
const SFT_MASK: u32 = 0b10 << 30;
const SFEC_AT: u32 = 27;
const SFID1_AT: u32 = 16;

/// A receive FIFO of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fifo {
    /// FIFO 0: the gripper's frames, separate so that no other frames displace them.
    Gripper,
    /// FIFO 1: all other accepted frames.
    Others,
}

/// Returns the filter for standard identifiers that equal `id` in the bits set in `mask`, for a FIFO.
#[must_use]
pub const fn filter(fifo: Fifo, id: u16, mask: u16) -> u32 {
    let target = match fifo {
        Fifo::Gripper => 0b001,
        Fifo::Others => 0b010,
    };
    SFT_MASK | target << SFEC_AT | (id as u32 & 0x7FF) << SFID1_AT | mask as u32 & 0x7FF
}

/// Returns the first word of a data frame with this identifier.
fn id_word(id: Id) -> u32 {
    match id {
        Id::Standard(id) => u32::from(id.as_raw()) << STANDARD_AT,
        Id::Extended(id) => id.as_raw() | XTD,
    }
}

/// Encodes a frame to send, without an entry in the event FIFO.
#[must_use]
pub fn element(frame: &ClassicFrame) -> Element {
    let remote = if frame.is_remote_frame() { RTR } else { 0 };
    let mut data = [0; MAX_DATA_LEN];
    for (place, byte) in data.iter_mut().zip(frame.data()) {
        *place = *byte;
    }
    let [a, b, c, d, e, f, g, h] = data;
    [
        id_word(frame.id()) | remote,
        (frame.dlc() as u32 & 0xF) << DLC_AT,
        u32::from_le_bytes([a, b, c, d]),
        u32::from_le_bytes([e, f, g, h]),
    ]
}

/// Decodes a received element.
#[must_use]
pub fn frame([id, header, low, high]: Element) -> Option<ClassicFrame> {
    let len = (header >> DLC_AT & 0xF) as usize;
    let len = len.min(MAX_DATA_LEN);
    let is_remote = id & RTR != 0;
    let id = if id & XTD != 0 {
        Id::Extended(ExtendedId::new(id & ExtendedId::MAX.as_raw())?)
    } else {
        Id::Standard(StandardId::new((id >> STANDARD_AT) as u16 & StandardId::MAX.as_raw())?)
    };
    if is_remote {
        return ClassicFrame::new_remote(id, len);
    }
    let [a, b, c, d] = low.to_le_bytes();
    let [e, f, g, h] = high.to_le_bytes();
    ClassicFrame::new(id, [a, b, c, d, e, f, g, h].get(..len)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standard(id: u16) -> Id {
        Id::Standard(StandardId::new(id).unwrap())
    }

    fn extended(id: u32) -> Id {
        Id::Extended(ExtendedId::new(id).unwrap())
    }

    #[test]
    fn a_standard_identifier_is_in_the_upper_bits_of_its_field() {
        let frame = ClassicFrame::new(standard(0x7A5), &[1, 2, 3, 4, 5]).unwrap();
        assert_eq!(element(&frame), [0x7A5 << 18, 5 << 16, 0x0403_0201, 0x0000_0005]);
    }

    #[test]
    fn an_extended_identifier_and_a_remote_frame_have_their_bits() {
        let frame = ClassicFrame::new(extended(0x1ABC_DEF0), &[]).unwrap();
        assert_eq!(element(&frame), [0x5ABC_DEF0, 0, 0, 0]);
        let frame = ClassicFrame::new_remote(standard(0x123), 8).unwrap();
        assert_eq!(element(&frame), [1 << 29 | 0x123 << 18, 8 << 16, 0, 0]);
    }

    #[test]
    fn every_frame_survives_its_element() {
        for id in [standard(0), standard(0x7FF), extended(0), extended(0x7FF), extended(0x1FFF_FFFF)] {
            for len in 0..=8 {
                let data = [0xFF, 0, 0x80, 1, 0x7F, 0xAA, 0x55, 0xFE];
                for sent in [ClassicFrame::new(id, &data[..len]), ClassicFrame::new_remote(id, len)] {
                    let sent = sent.unwrap();
                    assert_eq!(frame(element(&sent)), Some(sent));
                }
            }
        }
    }

    #[test]
    fn what_the_controller_notes_beside_a_frame_is_no_part_of_it() {
        // ESI; ANMF and filter index; RXTS; a length above 8; unused bits of the identifier field.
        let noted = [1 << 31 | 0x123 << 18 | 0x3_FFFF, 0xFFCF_FFFF, 0x0403_0201, 0x0807_0605];
        assert_eq!(frame(noted), ClassicFrame::new(standard(0x123), &[1, 2, 3, 4, 5, 6, 7, 8]));
    }

    #[test]
    fn filters_have_identifier_mask_and_fifo() {
        assert_eq!(filter(Fifo::Gripper, 0x001, 0x7FF), 0x8801_07FF);
        assert_eq!(filter(Fifo::Others, 0x700, 0x780), 0x9700_0780);
        assert_eq!(filter(Fifo::Others, 0xFFFF, 0xFFFF), filter(Fifo::Others, 0x7FF, 0x7FF));
    }
}
