//! Connectionless DCE RPC (version 4): datagram header, and arguments before the blocks.

use crate::cursor::{Order, Reader, Writer};

/// UDP port of every PROFINET station for the endpoint mapper; here also for the context manager.
pub const RPC_PORT: u16 = 0x8894;

/// Length of a datagram header in bytes.
pub(crate) const HEADER_LEN: usize = 80;

pub(crate) mod kind {
    pub(crate) const REQUEST: u8 = 0;
    pub(crate) const PING: u8 = 1;
    pub(crate) const RESPONSE: u8 = 2;
    pub(crate) const FAULT: u8 = 3;
    pub(crate) const NO_CALL: u8 = 5;
    pub(crate) const REJECT: u8 = 6;
}

/// Status codes of Reject and Fault.
pub(crate) mod status {
    /// `nca_s_op_rng_error`: the operation does not exist.
    pub(crate) const NO_SUCH_OPERATION: u32 = 0x1C01_0002;
    /// `nca_s_unk_if`: the interface does not exist.
    pub(crate) const NO_SUCH_INTERFACE: u32 = 0x1C01_0003;
    /// `nca_s_proto_error`: the datagram is not a valid request.
    pub(crate) const PROTOCOL: u32 = 0x1C01_000B;
    /// `nca_s_unsupported_type`: no object has this UUID.
    pub(crate) const NO_SUCH_OBJECT: u32 = 0x1C01_0017;
}

/// Operations of the context manager.
pub(crate) mod operation {
    pub(crate) const CONNECT: u16 = 0;
    pub(crate) const RELEASE: u16 = 1;
    pub(crate) const READ: u16 = 2;
    pub(crate) const WRITE: u16 = 3;
    pub(crate) const CONTROL: u16 = 4;
    pub(crate) const READ_IMPLICIT: u16 = 5;
}

/// Interface UUID of a device's context manager.
pub(crate) const DEVICE_INTERFACE: [u8; 16] =
    [0xDE, 0xA0, 0, 0x01, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 0xA0, 0x24, 0x42, 0xDF, 0x7D];
/// Interface UUID of a controller's context manager.
pub(crate) const CONTROLLER_INTERFACE: [u8; 16] =
    [0xDE, 0xA0, 0, 0x02, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 0xA0, 0x24, 0x42, 0xDF, 0x7D];
/// Interface UUID of the endpoint mapper.
pub(crate) const EPM_INTERFACE: [u8; 16] =
    [0xE1, 0xAF, 0x83, 0x08, 0x5D, 0x1F, 0x11, 0xC9, 0x91, 0xA4, 0x08, 0, 0x2B, 0x14, 0xA0, 0xFA];

/// Flag: the call has more than one fragment.
const FLAG_FRAGMENT: u8 = 0x04;
/// Flags: no acknowledgement of fragments; idempotent.
const FLAGS: u8 = 0x28;

/// A UDP endpoint over IPv4.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// IPv4 address, in order of transmission.
    pub address: [u8; 4],
    /// UDP port number.
    pub port: u16,
}

/// A datagram header. UUIDs are in text order, the high byte of each field first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    pub(crate) kind: u8,
    pub(crate) order: Order,
    pub(crate) object: [u8; 16],
    pub(crate) interface: [u8; 16],
    pub(crate) activity: [u8; 16],
    pub(crate) boot_time: u32,
    pub(crate) version: u32,
    pub(crate) sequence: u32,
    pub(crate) operation: u16,
}

/// A parsed datagram: header and body. `Err` holds the header and the status to reject it with.
pub(crate) type Parsed<'a> = Result<(Header, &'a [u8]), (Header, u32)>;

impl Header {
    /// Parses a datagram. Returns `None` if it is truncated or of another version.
    pub(crate) fn parse(datagram: &[u8]) -> Option<Parsed<'_>> {
        let mut reader = Reader::new(datagram);
        let version_number = reader.u8()?;
        let kind = reader.u8()?;
        let flags = reader.u8()?;
        reader.skip(1)?;
        let order = if reader.u8()? & 0xF0 == 0x10 { Order::LittleEndian } else { Order::BigEndian };
        reader.skip(3)?;
        let object = swapped(reader.array()?, order);
        let interface = swapped(reader.array()?, order);
        let activity = swapped(reader.array()?, order);
        let boot_time = reader.u32_in(order)?;
        let version = reader.u32_in(order)?;
        let sequence = reader.u32_in(order)?;
        let operation = reader.u16_in(order)?;
        reader.skip(4)?;
        let len = reader.u16_in(order)?;
        let fragment = reader.u16_in(order)?;
        let authentication = reader.u8()?;
        reader.skip(1)?;
        if version_number != 4 {
            return None;
        }
        let header =
            Self { kind, order, object, interface, activity, boot_time, version, sequence, operation };
        let is_whole = flags & FLAG_FRAGMENT == 0 && fragment == 0 && authentication == 0;
        Some(match reader.bytes(len.into()) {
            Some(body) if is_whole => Ok((header, body)),
            _ => Err((header, status::PROTOCOL)),
        })
    }

    /// Writes the header, then the output of `body`, which must use the same byte order.
    pub(crate) fn write(&self, writer: &mut Writer<'_>, body: impl FnOnce(&mut Writer<'_>)) {
        let Self { order, .. } = *self;
        let representation = if order == Order::LittleEndian { 0x10 } else { 0 };
        writer.bytes(&[4, self.kind, FLAGS, 0, representation, 0, 0, 0]);
        writer.bytes(&swapped(self.object, order));
        writer.bytes(&swapped(self.interface, order));
        writer.bytes(&swapped(self.activity, order));
        writer.u32_in(order, self.boot_time);
        writer.u32_in(order, self.version);
        writer.u32_in(order, self.sequence);
        writer.u16_in(order, self.operation);
        // No interface hint and no activity hint.
        writer.u16(0xFFFF);
        writer.u16(0xFFFF);
        let length_at = writer.len();
        writer.u16(0);
        // Fragment number 0, the only one; no authentication.
        writer.u16(0);
        writer.u16(0);
        let start = writer.len();
        body(writer);
        let len = writer.len().saturating_sub(start) as u16;
        let bytes = if order == Order::BigEndian { len.to_be_bytes() } else { len.to_le_bytes() };
        writer.put(length_at, &bytes);
    }
}

/// Converts a UUID between wire order and text order.
pub(crate) fn swapped(uuid: [u8; 16], order: Order) -> [u8; 16] {
    let [a, b, c, d, e, f, g, h, rest @ ..] = uuid;
    let [i, j, k, l, m, n, o, p] = rest;
    match order {
        Order::BigEndian => uuid,
        Order::LittleEndian => [d, c, b, a, f, e, h, g, i, j, k, l, m, n, o, p],
    }
}

/// Parses the arguments of a request to a context manager: maximum length of the answer, and the blocks.
pub(crate) fn arguments(body: &[u8], order: Order) -> Option<(usize, &[u8])> {
    let mut reader = Reader::new(body);
    let max_len = reader.u32_in(order)?;
    let len = reader.u32_in(order)?;
    let max_count = reader.u32_in(order)?;
    let offset = reader.u32_in(order)?;
    let count = reader.u32_in(order)?;
    let blocks = reader.bytes(usize::try_from(len).ok()?)?;
    (offset == 0 && count == len && len <= max_count).then_some((usize::try_from(max_len).ok()?, blocks))
}

/// PNIOStatus: 0 for success, otherwise the error of an operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PnioStatus(pub(crate) u32);

impl PnioStatus {
    pub(crate) const OK: Self = Self(0);

    const fn of(code: u8, decode: u8, code1: u8, code2: u8) -> Self {
        Self(u32::from_be_bytes([code, decode, code1, code2]))
    }

    /// Error of Connect: number of the block, and of its parameter from 0.
    pub(crate) const fn connect(block: u8, parameter: u8) -> Self {
        Self::of(0xDB, 0x81, block, parameter)
    }

    /// Error of Connect, reported by the context manager's server.
    pub(crate) const fn connect_server(reason: u8) -> Self {
        Self::of(0xDB, 0x81, 0x40, reason)
    }

    pub(crate) const fn release(block: u8, parameter: u8) -> Self {
        Self::of(0xDC, 0x81, block, parameter)
    }

    pub(crate) const fn control(block: u8, parameter: u8) -> Self {
        Self::of(0xDD, 0x81, block, parameter)
    }

    pub(crate) const fn read(reason: u8) -> Self {
        Self::of(0xDE, 0x80, reason, 0)
    }

    pub(crate) const fn write(reason: u8) -> Self {
        Self::of(0xDF, 0x80, reason, 0)
    }

    /// RTA-ERR: reason for the end of a connection.
    pub(crate) const fn abort(reason: u8) -> Self {
        Self::of(0xCF, 0x81, 0xFD, reason)
    }
}

/// Error reasons of the context manager's server.
pub(crate) mod server {
    pub(crate) const ARGUMENTS: u8 = 0;
    pub(crate) const UNKNOWN_BLOCK: u8 = 1;
    pub(crate) const IOCR_MISSING: u8 = 2;
    pub(crate) const ALARM_CR_COUNT: u8 = 3;
    pub(crate) const OUT_OF_ARS: u8 = 4;
    pub(crate) const AR_UNKNOWN: u8 = 5;
    pub(crate) const STATE_CONFLICT: u8 = 6;
}

/// Error reasons of Read and Write.
pub(crate) mod access {
    pub(crate) const NOT_THERE: u8 = 0xA9;
    pub(crate) const INVALID_INDEX: u8 = 0xB0;
    pub(crate) const WRITE_LENGTH: u8 = 0xB1;
    pub(crate) const INVALID_SLOT: u8 = 0xB2;
    pub(crate) const DENIED: u8 = 0xB6;
}

/// Writes the body of a response: status, then blocks.
pub(crate) fn response(
    writer: &mut Writer<'_>,
    order: Order,
    max_len: usize,
    status: PnioStatus,
    body: impl FnOnce(&mut Writer<'_>),
) {
    writer.u32_in(order, status.0);
    counted(writer, order, max_len, body);
}

/// Writes an array of bytes in NDR: length, maximum length, offset 0, length, then the output of `body`.
pub(crate) fn counted(
    writer: &mut Writer<'_>,
    order: Order,
    max_len: usize,
    body: impl FnOnce(&mut Writer<'_>),
) {
    let start = writer.len();
    writer.fill(0, 16);
    let from = writer.len();
    body(writer);
    let len = writer.len().saturating_sub(from) as u32;
    let max_count = len.max(u32::try_from(max_len).unwrap_or(u32::MAX));
    for (at, value) in [(0, len), (4, max_count), (12, len)] {
        let bytes = if order == Order::BigEndian { value.to_be_bytes() } else { value.to_le_bytes() };
        writer.put(start.saturating_add(at), &bytes);
    }
}
