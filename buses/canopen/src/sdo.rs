//! Expedited SDO: read and write of objects with up to four bytes (CiA 301, 7.2.4.3).

/// Why a transfer was aborted: the code on the bus (CiA 301, table 22).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Abort {
    /// Client command specifier not valid: segmented and block transfer are not served.
    CommandSpecifier = 0x0504_0001,
    /// Attempt to write a read-only object.
    ReadOnly = 0x0601_0002,
    /// The object does not exist.
    NoObject = 0x0602_0000,
    /// The length does not match.
    Length = 0x0607_0010,
    /// The subindex does not exist.
    NoSubindex = 0x0609_0011,
    /// The value is not allowed.
    Value = 0x0609_0030,
    /// Not in the present device state.
    DeviceState = 0x0800_0022,
}

/// What a client asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    Read,
    /// A write of so many bytes; none said: as many as the object has.
    Write(Option<u8>, u32),
    /// The client gave up. There is nothing to give up here, and no answer.
    Aborted,
    Other,
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
