//! Framing on TCP (*MODBUS messaging on TCP/IP implementation guide V1.0b*, chapter 3.1): the MBAP header.
//!
//! A header says how long the frame is and which transaction it belongs to; there is no checksum, because TCP has one.
//! Many requests may be under way; [`Receiver`] cuts them out of the stream one after the other, and
//! [`Request::answer`] puts the header before each response. Sockets are the caller's business.
//!
//! - A frame of another protocol is discarded (guide, 4.4.2.2).
//! - A length that no frame of MODBUS has leaves no way to find the next one: the connection is to be closed.
//! - The unit identifier is returned as it came. A server that is no gateway is addressed by its IP address, so it serves
//!   all of them, 0 and 255 as well (guide, 4.4.2.3); there is no broadcast.

use super::MAX_PDU_LEN;

/// Bytes of the header, the unit identifier included.
pub const HEADER_LEN: usize = 7;

/// Bytes of the longest frame.
pub const MAX_FRAME_LEN: usize = HEADER_LEN + MAX_PDU_LEN;

/// What the length field counts: the unit identifier and the PDU, which has a function code at least.
const LENGTHS: core::ops::RangeInclusive<u16> = 2..=(1 + MAX_PDU_LEN as u16);

/// Bytes up to the end of the length field.
const LENGTH_END: usize = HEADER_LEN - 1;

/// The protocol identifier of MODBUS.
const MODBUS: u16 = 0;

const _: () = assert!(MAX_FRAME_LEN == 260);

/// A request out of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request<'a> {
    /// Which transaction it belongs to, in the client's count.
    pub transaction: u16,
    /// The unit identifier.
    pub unit: u8,
    /// Function code and data.
    pub pdu: &'a [u8],
}

impl Request<'_> {
    /// The frame that answers, with the PDU that `serve` leaves in its place, of the length that it returns. Empty when
    /// that is 0 or more than there is room for.
    ///
    /// ```
    /// use bus_modbus::tcp::{MAX_FRAME_LEN, Request};
    ///
    /// let request = Request { transaction: 0x1501, unit: 0xFF, pdu: &[0x05] };
    /// let mut frame = [0; MAX_FRAME_LEN];
    /// let answer = request.answer(&mut frame, |pdu, response| {
    ///     response[..2].copy_from_slice(&[pdu[0] | 0x80, 0x03]);
    ///     2
    /// });
    /// assert_eq!(answer, [0x15, 0x01, 0, 0, 0, 3, 0xFF, 0x85, 0x03]);
    /// ```
    pub fn answer<'b>(
        &self,
        frame: &'b mut [u8; MAX_FRAME_LEN],
        serve: impl FnOnce(&[u8], &mut [u8; MAX_PDU_LEN]) -> usize,
    ) -> &'b [u8] {
        let Some((header, place)) = frame.split_first_chunk_mut::<HEADER_LEN>() else { return &[] };
        let Some(place) = place.first_chunk_mut::<MAX_PDU_LEN>() else { return &[] };
        let len = serve(self.pdu, place);
        let length = len.saturating_add(1);
        if len == 0 || length > usize::from(*LENGTHS.end()) {
            return &[];
        }
        let [t1, t0] = self.transaction.to_be_bytes();
        let [p1, p0] = MODBUS.to_be_bytes();
        // It fits: it was compared above.
        let [l1, l0] = (length as u16).to_be_bytes();
        *header = [t1, t0, p1, p0, l1, l0, self.unit];
        frame.get(..HEADER_LEN.saturating_add(len)).unwrap_or_default()
    }
}

/// What a stream holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event<'a> {
    /// A request.
    Request(Request<'a>),
    /// A frame of another protocol, which was discarded.
    Foreign {
        /// Its bytes, header included.
        len: u16,
    },
    /// A length that no frame has: nothing more is taken from this stream.
    Lost,
}

/// Finds the frames in a stream. Its reset state is all zero.
///
/// ```
/// use bus_modbus::tcp::{Event, Receiver, Request};
///
/// let mut receiver = Receiver::new();
/// // Read Input Registers, one from 0 on; and the beginning of another frame.
/// let stream = [0x00, 0x07, 0, 0, 0, 6, 0x01, 0x04, 0, 0, 0, 1, 0x00];
/// let (taken, event) = receiver.push_slice(&stream);
/// let request = Request { transaction: 7, unit: 1, pdu: &[0x04, 0, 0, 0, 1] };
/// assert_eq!((taken, event), (12, Some(Event::Request(request))));
/// assert_eq!(receiver.push_slice(&stream[12..]), (1, None));
/// ```
#[derive(Clone, Debug)]
pub struct Receiver {
    frame: [u8; MAX_FRAME_LEN],
    /// How much of the frame has come.
    len: u16,
    lost: bool,
}

impl Receiver {
    /// A receiver at the beginning of a stream.
    #[must_use]
    pub const fn new() -> Self {
        Self { frame: [0; MAX_FRAME_LEN], len: 0, lost: false }
    }

    /// Takes one byte.
    pub fn push(&mut self, byte: u8) -> Option<Event<'_>> {
        let step = self.step(byte);
        self.event(step)
    }

    /// Takes bytes up to the end of the next frame: how many, and what they held.
    pub fn push_slice(&mut self, bytes: &[u8]) -> (usize, Option<Event<'_>>) {
        let mut taken = 0usize;
        let mut step = Step::Nothing;
        for byte in bytes {
            taken = taken.saturating_add(1);
            step = self.step(*byte);
            if !matches!(step, Step::Nothing) {
                break;
            }
        }
        (taken, self.event(step))
    }

    /// Whether the way to the next frame is lost: nothing more is taken.
    #[must_use]
    pub const fn is_lost(&self) -> bool {
        self.lost
    }

    fn step(&mut self, byte: u8) -> Step {
        let Some(place) = self.frame.get_mut(usize::from(self.len)).filter(|_| !self.lost) else {
            return Step::Nothing;
        };
        *place = byte;
        self.len = self.len.saturating_add(1);
        let len = usize::from(self.len);
        if len < LENGTH_END {
            return Step::Nothing;
        }
        let [_, _, p1, p0, l1, l0, ..] = self.frame;
        let length = u16::from_be_bytes([l1, l0]);
        if !LENGTHS.contains(&length) {
            self.lost = true;
            return Step::Lost;
        }
        if len < LENGTH_END.saturating_add(length.into()) {
            return Step::Nothing;
        }
        self.len = 0;
        if u16::from_be_bytes([p1, p0]) == MODBUS {
            Step::Request { length }
        } else {
            Step::Foreign { length }
        }
    }

    fn event(&self, step: Step) -> Option<Event<'_>> {
        let [t1, t0, _, _, _, _, unit, pdu @ ..] = &self.frame;
        match step {
            Step::Nothing => None,
            Step::Request { length } => Some(Event::Request(Request {
                transaction: u16::from_be_bytes([*t1, *t0]),
                unit: *unit,
                pdu: pdu.get(..usize::from(length).saturating_sub(1))?,
            })),
            Step::Foreign { length } => {
                Some(Event::Foreign { len: length.saturating_add(LENGTH_END as u16) })
            }
            Step::Lost => Some(Event::Lost),
        }
    }
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

/// What a byte came to.
#[derive(Clone, Copy)]
enum Step {
    Nothing,
    Request { length: u16 },
    Foreign { length: u16 },
    Lost,
}

#[cfg(test)]
mod tests;
