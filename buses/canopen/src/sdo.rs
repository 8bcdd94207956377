//! SDO: read and write of objects with up to four bytes in one frame, and read of texts in segments (CiA 301, 7.2.4.3).

/// Why a transfer was aborted: the code on the bus (CiA 301, table 22).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Abort {
    /// The toggle bit of a segment did not alternate.
    Toggle = 0x0503_0000,
    /// Client command specifier not valid: writing in segments and block transfer are not served.
    CommandSpecifier = 0x0504_0001,
    /// Attempt to write a read-only object.
    ReadOnly = 0x0601_0002,
    /// The object does not exist.
    NoObject = 0x0602_0000,
    /// The object cannot be mapped to the PDO: mappings are fixed.
    Mapping = 0x0604_0041,
    /// The hardware failed: nothing was stored.
    Hardware = 0x0606_0000,
    /// The length does not match.
    Length = 0x0607_0010,
    /// The subindex does not exist.
    NoSubindex = 0x0609_0011,
    /// The value is not allowed.
    Value = 0x0609_0030,
    /// Data cannot be stored: the signature is wrong.
    Store = 0x0800_0020,
    /// Only something else than a master's SDO changes it.
    LocalControl = 0x0800_0021,
    /// Not in the present device state.
    DeviceState = 0x0800_0022,
    /// There is nothing to be read.
    NoData = 0x0800_0024,
}

/// What a client asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    Read,
    /// A write of so many bytes; none said: as many as the object has.
    Write(Option<u8>, u32),
    /// The next segment of what is read, with this toggle bit.
    Segment(bool),
    /// The client gave up, which has no answer.
    Aborted,
    Other,
}

const TOGGLE: u8 = 1 << 4;

/// The bytes that fit into a segment.
const SEGMENT: usize = 7;

/// A text that is being read in segments.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Upload {
    index: u16,
    sub: u8,
    rest: &'static [u8],
    toggle: bool,
}

impl Upload {
    /// Begins to read a text: the transfer, and the answer to the client.
    pub(crate) fn begin(index: u16, sub: u8, text: &'static str) -> (Self, [u8; 8]) {
        let size = u32::try_from(text.len()).unwrap_or(u32::MAX);
        (Self { index, sub, rest: text.as_bytes(), toggle: false }, response(0b0100_0001, index, sub, size))
    }

    /// The next segment, and whether more follow.
    ///
    /// # Errors
    /// The answer that aborts the transfer, when the client lost count.
    pub(crate) fn next(&mut self, toggle: bool) -> Result<([u8; 8], bool), [u8; 8]> {
        if toggle != self.toggle {
            return Err(abort_response(self.index, self.sub, Abort::Toggle));
        }
        let (now, rest) = self.rest.split_at_checked(SEGMENT).unwrap_or((self.rest, &[]));
        let mut frame = [0; 8];
        let [specifier, data @ ..] = &mut frame;
        for (place, byte) in data.iter_mut().zip(now) {
            *place = *byte;
        }
        let unused = (SEGMENT as u8).wrapping_sub(now.len() as u8);
        *specifier = if toggle { TOGGLE } else { 0 } | unused << 1 | u8::from(rest.is_empty());
        (self.rest, self.toggle) = (rest, !toggle);
        Ok((frame, !rest.is_empty()))
    }
}

/// An object's address, and what is to be done with it.
pub(crate) fn parse(data: &[u8; 8]) -> (u16, u8, Request) {
    let [specifier, low, high, sub, a, b, c, d] = *data;
    let request = match specifier >> 5 {
        // Download: expedited, or refused.
        1 if specifier & 0b10 != 0 => {
            let len = (specifier & 0b1 != 0).then_some(4u8.wrapping_sub(specifier >> 2 & 0b11));
            Request::Write(len, u32::from_le_bytes([a, b, c, d]))
        }
        2 => Request::Read,
        3 => Request::Segment(specifier & TOGGLE != 0),
        4 => Request::Aborted,
        _ => Request::Other,
    };
    (u16::from_le_bytes([low, high]), sub, request)
}

pub(crate) fn read_response(index: u16, sub: u8, len: u8, value: u32) -> [u8; 8] {
    let unused = 4u8.wrapping_sub(len) & 0b11;
    response(0b0100_0011 | unused << 2, index, sub, value)
}

pub(crate) fn write_response(index: u16, sub: u8) -> [u8; 8] {
    response(0b0110_0000, index, sub, 0)
}

pub(crate) fn abort_response(index: u16, sub: u8, abort: Abort) -> [u8; 8] {
    response(0b1000_0000, index, sub, abort as u32)
}

fn response(specifier: u8, index: u16, sub: u8, value: u32) -> [u8; 8] {
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = value.to_le_bytes();
    [specifier, low, high, sub, a, b, c, d]
}
