//! Encapsulation (volume 2, chapter 2): header, frames in a byte stream, and the common packet format.

use core::net::SocketAddrV4;

use crate::cursor::{Reader, Writer, copy};

/// TCP and UDP port for encapsulated messages.
pub const PORT: u16 = 44_818;
/// UDP port for cyclic data, in both directions.
pub const IO_PORT: u16 = 2_222;
/// Maximum length of a frame or datagram in bytes.
pub const MAX_FRAME_LEN: usize = 600;
/// Maximum size of a connection: the maximum of Forward_Open.
pub(crate) const MAX_SIZE: u16 = 511;
/// Maximum length of a CIP message, after the sequence count of a connection.
pub(crate) const MAX_MESSAGE_LEN: usize = MAX_SIZE as usize - 2;

const HEADER_LEN: usize = 24;
/// Header, interface and time-out, count, address item, data item, two socket addresses.
const _: () = assert!(HEADER_LEN + 6 + 2 + 8 + 4 + MAX_SIZE as usize + 2 * 20 <= MAX_FRAME_LEN);

pub(crate) mod command {
    pub(crate) const NOP: u16 = 0x00;
    pub(crate) const LIST_SERVICES: u16 = 0x04;
    pub(crate) const LIST_IDENTITY: u16 = 0x63;
    pub(crate) const LIST_INTERFACES: u16 = 0x64;
    pub(crate) const REGISTER_SESSION: u16 = 0x65;
    pub(crate) const UNREGISTER_SESSION: u16 = 0x66;
    pub(crate) const SEND_RR_DATA: u16 = 0x6F;
    pub(crate) const SEND_UNIT_DATA: u16 = 0x70;
}

/// Status of a frame.
pub(crate) mod status {
    pub(crate) const INVALID_COMMAND: u32 = 0x01;
    pub(crate) const NO_RESOURCE: u32 = 0x02;
    pub(crate) const BAD_DATA: u32 = 0x03;
    pub(crate) const INVALID_SESSION: u32 = 0x64;
    pub(crate) const INVALID_LENGTH: u32 = 0x65;
    pub(crate) const UNSUPPORTED_VERSION: u32 = 0x69;
}

/// Types of items.
pub(crate) mod item {
    pub(crate) const NULL: u16 = 0x0000;
    pub(crate) const IDENTITY: u16 = 0x000C;
    pub(crate) const CONNECTED_ADDRESS: u16 = 0x00A1;
    pub(crate) const CONNECTED_DATA: u16 = 0x00B1;
    pub(crate) const UNCONNECTED_DATA: u16 = 0x00B2;
    pub(crate) const SERVICES: u16 = 0x0100;
    /// Socket addresses for data to the device and to the originator.
    pub(crate) const SOCKET_O_TO_T: u16 = 0x8000;
    pub(crate) const SOCKET_T_TO_O: u16 = 0x8001;
    pub(crate) const SEQUENCED_ADDRESS: u16 = 0x8002;
}

/// Header of a request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Header {
    pub(crate) command: u16,
    len: u16,
    pub(crate) session: u32,
    pub(crate) context: [u8; 8],
}

/// What a command results in: the session handle of the answer, or its error status. `None` sends no answer.
pub(crate) type Outcome = Option<Result<u32, u32>>;

impl Header {
    /// Splits a frame into header and data. Returns `None` if it is truncated or has a status or options, which must be
    /// ignored.
    pub(crate) fn parse(frame: &[u8]) -> Option<(Self, &[u8])> {
        let mut reader = Reader::new(frame);
        let (command, len, session) = (reader.u16()?, reader.u16()?, reader.u32()?);
        let (status, context, options) = (reader.u32()?, reader.array()?, reader.u32()?);
        (status == 0 && options == 0).then_some((Self { command, len, session, context }, reader.rest()))
    }

    /// Returns whether the frame has data of the announced length.
    pub(crate) fn is_exact(&self, data: &[u8]) -> bool {
        data.len() == usize::from(self.len)
    }

    /// Writes an answer with the data written by `body`, which also decides its status.
    pub(crate) fn answer<'a>(
        &self,
        buffer: &'a mut [u8; MAX_FRAME_LEN],
        body: impl FnOnce(&mut Writer<'_>) -> Outcome,
    ) -> Option<&'a [u8]> {
        let (head, data) = buffer.split_first_chunk_mut::<HEADER_LEN>()?;
        let mut out = Writer::new(data);
        let (session, status) = match body(&mut out)? {
            Ok(session) => (session, 0),
            Err(status) => (self.session, status),
        };
        let len = out.finish()?;
        let mut out = Writer::new(head);
        out.u16(self.command);
        out.u16(len as u16);
        out.u32(session);
        out.u32(status);
        out.bytes(&self.context);
        out.u32(0);
        buffer.get(..HEADER_LEN.saturating_add(len))
    }
}

/// Cuts the bytes of one TCP connection into frames.
#[derive(Clone, Debug)]
pub struct Receiver {
    buffer: [u8; MAX_FRAME_LEN],
    len: usize,
    /// Whether the buffer has a frame that was returned before.
    is_complete: bool,
    /// Remaining bytes of a frame that is too long.
    skipped: usize,
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

impl Receiver {
    /// Creates a receiver for a new connection.
    #[must_use]
    pub const fn new() -> Self {
        Self { buffer: [0; MAX_FRAME_LEN], len: 0, is_complete: false, skipped: 0 }
    }

    /// Takes bytes up to the end of the next frame. Returns how many it took, and the frame if it is complete. Call it again
    /// with the remaining bytes after each frame.
    ///
    /// Of a frame that is longer than [`MAX_FRAME_LEN`], only the header is returned, which the device refuses.
    pub fn push_slice(&mut self, bytes: &[u8]) -> (usize, Option<&[u8]>) {
        if core::mem::take(&mut self.is_complete) {
            self.len = 0;
        }
        let mut taken = self.skipped.min(bytes.len());
        self.skipped = self.skipped.saturating_sub(taken);
        // First the header, then the data that it announces.
        for _ in 0..2 {
            let missing = self.wanted_len().saturating_sub(self.len);
            let rest = bytes.get(taken..).unwrap_or(&[]);
            let part = rest.get(..missing).unwrap_or(rest);
            // The wanted length never exceeds the buffer.
            self.len = copy(&mut self.buffer, self.len, part).unwrap_or(self.len);
            taken = taken.saturating_add(part.len());
        }
        if self.len < self.wanted_len() {
            return (taken, None);
        }
        self.is_complete = true;
        self.skipped = self.frame_len().saturating_sub(self.len);
        (taken, self.buffer.get(..self.len))
    }

    /// Returns how much of the current frame is stored: all, or only the header of a frame that is too long.
    fn wanted_len(&self) -> usize {
        Some(self.frame_len()).filter(|len| *len <= MAX_FRAME_LEN).unwrap_or(HEADER_LEN)
    }

    /// Returns the length of the current frame, or of its header while the header is incomplete.
    fn frame_len(&self) -> usize {
        match Reader::new(self.buffer.get(2..self.len).unwrap_or(&[])).u16() {
            Some(len) if self.len >= HEADER_LEN => HEADER_LEN.saturating_add(len.into()),
            _ => HEADER_LEN,
        }
    }
}

/// Contents of SendRRData or SendUnitData.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Items<'a> {
    /// Connection identifier; 0 in unconnected messages.
    pub(crate) connection: u32,
    pub(crate) message: &'a [u8],
    /// Socket address for data to the originator, if the originator gives one.
    pub(crate) target: Option<SocketAddrV4>,
}

impl<'a> Items<'a> {
    /// Parses exactly one address item, one data item and, in unconnected messages, up to one socket address per direction.
    pub(crate) fn parse(data: &'a [u8], is_connected: bool) -> Option<Self> {
        let mut reader = Reader::new(data);
        // The interface is CIP. The time-out is for routers.
        let (0, _timeout) = (reader.u32()?, reader.u16()?) else { return None };
        let mut places = Default::default();
        let (connection, message, sockets) = match *items(reader, &mut places)? {
            [(item::NULL, []), (item::UNCONNECTED_DATA, message), ref sockets @ ..] if !is_connected => {
                (0, message, sockets)
            }
            [(item::CONNECTED_ADDRESS, &[a, b, c, d]), (item::CONNECTED_DATA, message)] if is_connected => {
                (u32::from_le_bytes([a, b, c, d]), message, [].as_slice())
            }
            _ => return None,
        };
        let mut addresses = [None; 2];
        for (kind, bytes) in sockets {
            let place = addresses.get_mut(usize::from(kind.checked_sub(item::SOCKET_O_TO_T)?))?;
            let address = Reader::new(bytes).socket_address()?;
            if bytes.len() != 16 || place.replace(address).is_some() {
                return None;
            }
        }
        Some(Self { connection, message, target: addresses[1] })
    }
}

/// An item: its type and its bytes.
pub(crate) type Item<'a> = (u16, &'a [u8]);

/// Splits the common packet format into its items. Returns `None` if there are more than `places`, or if their lengths
/// differ from that of the data.
pub(crate) fn items<'a, 'b>(mut reader: Reader<'a>, places: &'b mut [Item<'a>; 4]) -> Option<&'b [Item<'a>]> {
    let count = reader.u16()?;
    let items = places.get_mut(..count.into())?;
    for item in &mut *items {
        let (kind, len) = (reader.u16()?, reader.u16()?);
        *item = (kind, reader.bytes(len.into())?);
    }
    reader.rest().is_empty().then_some(items)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn frames_are_found_in_any_segmentation_and_long_ones_skipped() {
        let frame = |len: u16, is_whole: bool| {
            let mut frame = std::vec![7; HEADER_LEN + usize::from(len)];
            frame[2..4].copy_from_slice(&len.to_le_bytes());
            let expected = if is_whole { frame.clone() } else { frame[..HEADER_LEN].to_vec() };
            (frame, expected)
        };
        let longest = (MAX_FRAME_LEN - HEADER_LEN) as u16;
        let frames = [frame(0, true), frame(4, true), frame(longest, true), frame(longest + 1, false)];
        let frames = [&frames[..], &[frame(65_535, false), frame(1, true), frame(0, true)]].concat();
        let stream: Vec<u8> = frames.iter().flat_map(|(frame, _)| frame.clone()).collect();
        for segment in [1, 2, 3, 23, 24, 25, 599, 600, 601, 1_460, stream.len()] {
            let mut receiver = Receiver::new();
            let mut found = Vec::new();
            for mut bytes in stream.chunks(segment) {
                while !bytes.is_empty() {
                    let (taken, frame) = receiver.push_slice(bytes);
                    found.extend(frame.map(<[u8]>::to_vec));
                    bytes = &bytes[taken..];
                }
            }
            let expected: Vec<_> = frames.iter().map(|(_, expected)| expected.clone()).collect();
            assert_eq!(found, expected, "segments of {segment} bytes");
        }
    }
}
