//! TCP framing with the MBAP header (*MODBUS messaging on TCP/IP implementation guide V1.0b*, chapter 3.1).
//!
//! The header carries the length of the frame and its transaction number. There is no checksum, because TCP has one.
//! Several requests may be in flight: [`Receiver`] extracts them from the stream one by one, and [`Request::answer`]
//! prepends the header to each response. The caller handles the sockets.
//!
//! - Frames of another protocol are discarded (guide, 4.4.2.2).
//! - After an invalid length the start of the next frame is unknown; the caller must close the connection.
//! - The unit identifier is echoed. A server that is not a gateway is addressed by its IP address, so it responds to
//!   every unit identifier, including 0 and 255 (guide, 4.4.2.3). There is no broadcast.

use super::MAX_PDU_LEN;

/// Length of the header in bytes, including the unit identifier.
pub const HEADER_LEN: usize = 7;

/// Maximum length of a frame in bytes.
pub const MAX_FRAME_LEN: usize = HEADER_LEN + MAX_PDU_LEN;

/// Valid values of the length field, which covers the unit identifier and a PDU of at least a function code.
const LENGTHS: core::ops::RangeInclusive<u16> = 2..=(1 + MAX_PDU_LEN as u16);

/// Number of bytes up to the end of the length field.
const LENGTH_END: usize = HEADER_LEN - 1;

/// Protocol identifier of MODBUS.
const MODBUS: u16 = 0;

const _: () = assert!(MAX_FRAME_LEN == 260);

/// A request extracted from the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request<'a> {
    /// Transaction identifier, chosen by the client and echoed in the response.
    pub transaction: u16,
    /// Unit identifier, echoed in the response.
    pub unit: u8,
    /// Request PDU: function code and data.
    pub pdu: &'a [u8],
}

impl Request<'_> {
    /// Returns the response frame. `serve` writes the response PDU into the buffer it is passed and returns its length.
    /// The frame is empty if that length is 0 or exceeds [`MAX_PDU_LEN`].
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
        // Cannot truncate: the length was checked above.
        let [l1, l0] = (length as u16).to_be_bytes();
        *header = [t1, t0, p1, p0, l1, l0, self.unit];
        frame.get(..HEADER_LEN.saturating_add(len)).unwrap_or_default()
    }
}

/// Outcome of received bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event<'a> {
    /// A complete request to serve.
    Request(Request<'a>),
    /// A discarded frame of another protocol.
    Foreign {
        /// Length of the frame in bytes, including the header.
        len: u16,
    },
    /// An invalid length field. The receiver ignores the rest of the stream.
    Lost,
}

/// Extracts frames from a stream. Its initial state is all zero.
///
/// ```
/// use bus_modbus::tcp::{Event, Receiver, Request};
///
/// let mut receiver = Receiver::new();
/// // Read Input Registers: one register from address 0, then the start of another frame.
/// let stream = [0x00, 0x07, 0, 0, 0, 6, 0x01, 0x04, 0, 0, 0, 1, 0x00];
/// let (taken, event) = receiver.push_slice(&stream);
/// let request = Request { transaction: 7, unit: 1, pdu: &[0x04, 0, 0, 0, 1] };
/// assert_eq!((taken, event), (12, Some(Event::Request(request))));
/// assert_eq!(receiver.push_slice(&stream[12..]), (1, None));
/// ```
#[derive(Clone, Debug)]
pub struct Receiver {
    frame: [u8; MAX_FRAME_LEN],
    /// Number of bytes of the current frame received so far.
    len: u16,
    lost: bool,
}

impl Receiver {
    /// Creates a receiver for the start of a stream.
    #[must_use]
    pub const fn new() -> Self {
        Self { frame: [0; MAX_FRAME_LEN], len: 0, lost: false }
    }

    /// Processes one byte of the stream, and returns the request or error that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Event<'_>> {
        let step = self.step(byte);
        self.event(step)
    }

    /// Processes bytes up to the end of the next frame. Returns the number of bytes consumed and the event, if any.
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

    /// Returns whether an invalid length was received. From then on, all bytes are ignored.
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

/// Result of one received byte.
#[derive(Clone, Copy)]
enum Step {
    Nothing,
    Request { length: u16 },
    Foreign { length: u16 },
    Lost,
}

#[cfg(test)]
mod tests;
