//! SDO protocol: expedited transfer of up to four bytes, segmented upload of text, and segmented download of domains (CiA 301,
//! 7.2.4.3).

/// SDO abort code (CiA 301, table 22).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Abort {
    /// The toggle bit of a segment did not alternate.
    Toggle = 0x0503_0000,
    /// Invalid client command specifier: no transfer is in progress, only domains are downloaded in segments, and block transfer is
    /// not supported.
    CommandSpecifier = 0x0504_0001,
    /// Attempt to read a write-only object.
    WriteOnly = 0x0601_0001,
    /// Attempt to write a read-only object.
    ReadOnly = 0x0601_0002,
    /// The object does not exist.
    NoObject = 0x0602_0000,
    /// The object cannot be mapped to the PDO, because mappings are fixed.
    Mapping = 0x0604_0041,
    /// Access failed due to a hardware error; nothing was stored.
    Hardware = 0x0606_0000,
    /// The length does not match the object's data type.
    Length = 0x0607_0010,
    /// The subindex does not exist.
    NoSubindex = 0x0609_0011,
    /// The value is not allowed for this object.
    Value = 0x0609_0030,
    /// Data cannot be stored, because the signature is wrong.
    Store = 0x0800_0020,
    /// The value is under local control and cannot be changed by SDO.
    LocalControl = 0x0800_0021,
    /// Not possible in the present device state.
    DeviceState = 0x0800_0022,
    /// There is no data to read.
    NoData = 0x0800_0024,
}

/// A decoded client request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    Read,
    /// A write of this many bytes. `None`: the client gave no size, use the length of the object.
    Write(Option<u8>, u32),
    /// Start of a download in segments, with the size, if the client gives it.
    Begin(Option<u32>),
    /// A segment of a download.
    Data(Data),
    /// Request for the next segment of an upload, with this toggle bit.
    Segment(bool),
    /// An abort by the client, which gets no response.
    Aborted,
    Other,
}

/// A segment of a download.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Data {
    pub(crate) toggle: bool,
    bytes: [u8; SEGMENT],
    len: u8,
    pub(crate) is_last: bool,
}

impl Data {
    pub(crate) fn bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or_default()
    }
}

/// A segmented download in progress.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Download {
    pub(crate) index: u16,
    pub(crate) sub: u8,
    /// Toggle bit of the next segment.
    pub(crate) toggle: bool,
}

const TOGGLE: u8 = 1 << 4;

/// Maximum number of data bytes per segment.
const SEGMENT: usize = 7;

/// A segmented upload in progress.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Upload {
    index: u16,
    sub: u8,
    rest: &'static [u8],
    toggle: bool,
}

impl Upload {
    /// Starts the upload of a text. Returns the transfer and the response.
    pub(crate) fn begin(index: u16, sub: u8, text: &'static str) -> (Self, [u8; 8]) {
        let size = u32::try_from(text.len()).unwrap_or(u32::MAX);
        (Self { index, sub, rest: text.as_bytes(), toggle: false }, response(0b0100_0001, index, sub, size))
    }

    /// Returns the next segment, and whether more follow.
    ///
    /// # Errors
    /// Returns the abort response if the toggle bit did not alternate.
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

/// Decodes a request into index, subindex and command.
pub(crate) fn parse(data: &[u8; 8]) -> (u16, u8, Request) {
    let [specifier, low, high, sub, a, b, c, d] = *data;
    let request = match specifier >> 5 {
        1 if specifier & 0b10 != 0 => {
            let len = (specifier & 0b1 != 0).then_some(4u8.wrapping_sub(specifier >> 2 & 0b11));
            Request::Write(len, u32::from_le_bytes([a, b, c, d]))
        }
        1 => Request::Begin((specifier & 0b1 != 0).then(|| u32::from_le_bytes([a, b, c, d]))),
        0 => Request::Data(Data {
            toggle: specifier & TOGGLE != 0,
            bytes: [low, high, sub, a, b, c, d],
            len: (SEGMENT as u8).wrapping_sub(specifier >> 1 & 0b111),
            is_last: specifier & 0b1 != 0,
        }),
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

pub(crate) fn segment_response(toggle: bool) -> [u8; 8] {
    [0b0010_0000 | if toggle { TOGGLE } else { 0 }, 0, 0, 0, 0, 0, 0, 0]
}

pub(crate) fn abort_response(index: u16, sub: u8, abort: Abort) -> [u8; 8] {
    response(0b1000_0000, index, sub, abort as u32)
}

fn response(specifier: u8, index: u16, sub: u8, value: u32) -> [u8; 8] {
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = value.to_le_bytes();
    [specifier, low, high, sub, a, b, c, d]
}
