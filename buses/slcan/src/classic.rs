//! A frame type for programs without a CAN controller driver.

use embedded_can::{Frame, Id};

use super::FULL;

/// A classic CAN frame: a data frame with up to eight bytes, or a remote frame.
///
/// ```
/// use embedded_can::{Frame, StandardId};
/// use bus_slcan::ClassicFrame;
///
/// let frame = ClassicFrame::new(StandardId::MAX, &[1, 2, 3]).unwrap();
/// assert_eq!((frame.dlc(), frame.data()), (3, &[1, 2, 3][..]));
/// assert!(ClassicFrame::new(StandardId::MAX, &[0; 9]).is_none());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClassicFrame {
    id: Id,
    is_remote: bool,
    dlc: u8,
    bytes: [u8; FULL],
}

impl Frame for ClassicFrame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let mut bytes = [0; FULL];
        for (place, byte) in bytes.get_mut(..data.len())?.iter_mut().zip(data) {
            *place = *byte;
        }
        Some(Self { id: id.into(), is_remote: false, dlc: data.len() as u8, bytes })
    }

    fn new_remote(id: impl Into<Id>, dlc: usize) -> Option<Self> {
        (dlc <= FULL).then(|| Self { id: id.into(), is_remote: true, dlc: dlc as u8, bytes: [0; FULL] })
    }

    fn is_extended(&self) -> bool {
        matches!(self.id, Id::Extended(_))
    }

    fn is_remote_frame(&self) -> bool {
        self.is_remote
    }

    fn id(&self) -> Id {
        self.id
    }

    fn dlc(&self) -> usize {
        self.dlc.into()
    }

    fn data(&self) -> &[u8] {
        let len = if self.is_remote { 0 } else { self.dlc };
        self.bytes.get(..len.into()).unwrap_or(&[])
    }
}
