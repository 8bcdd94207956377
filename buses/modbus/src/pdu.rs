//! Requests and responses without address and checksum: the PDU (specification, chapter 4).

mod identification;

use self::identification::MEI_TYPE;
use super::{Bits, Device, Exception, FileRecords, Words};

/// Maximum length of a PDU in bytes.
pub const MAX_PDU_LEN: usize = 253;

/// Supported function codes (specification, chapter 6). FC 8 and FC 17 are for serial lines only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Function {
    /// 01: Read Coils (6.1).
    ReadCoils = 1,
    /// 02: Read Discrete Inputs (6.2).
    ReadDiscreteInputs = 2,
    /// 03: Read Holding Registers (6.3).
    ReadHoldingRegisters = 3,
    /// 04: Read Input Registers (6.4).
    ReadInputRegisters = 4,
    /// 05: Write Single Coil (6.5).
    WriteSingleCoil = 5,
    /// 06: Write Single Register (6.6).
    WriteSingleRegister = 6,
    /// 08: Diagnostics (6.8), on a serial line only.
    Diagnostics = 8,
    /// 15 (0Fh): Write Multiple Coils (6.11).
    WriteMultipleCoils = 15,
    /// 16 (10h): Write Multiple Registers (6.12).
    WriteMultipleRegisters = 16,
    /// 17 (11h): Report Server ID (6.13), on a serial line only.
    ReportServerId = 17,
    /// 21 (15h): Write File Record (6.15).
    WriteFileRecord = 21,
    /// 22 (16h): Mask Write Register (6.16).
    MaskWriteRegister = 22,
    /// 23 (17h): Read/Write Multiple Registers (6.17).
    ReadWriteMultipleRegisters = 23,
    /// 43 (2Bh): Encapsulated Interface Transport, MEI type 14 only: Read Device Identification (6.21).
    EncapsulatedInterfaceTransport = 43,
}

impl Function {
    /// All supported functions, in ascending order of code.
    pub const ALL: [Self; 14] = [
        Self::ReadCoils,
        Self::ReadDiscreteInputs,
        Self::ReadHoldingRegisters,
        Self::ReadInputRegisters,
        Self::WriteSingleCoil,
        Self::WriteSingleRegister,
        Self::Diagnostics,
        Self::WriteMultipleCoils,
        Self::WriteMultipleRegisters,
        Self::ReportServerId,
        Self::WriteFileRecord,
        Self::MaskWriteRegister,
        Self::ReadWriteMultipleRegisters,
        Self::EncapsulatedInterfaceTransport,
    ];

    /// Returns the function code as sent in a request.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// Returns the function with this code, or `None` if it is not supported.
    ///
    /// ```
    /// use bus_modbus::Function;
    ///
    /// assert_eq!(Function::from_code(0x17), Some(Function::ReadWriteMultipleRegisters));
    /// assert_eq!(Function::from_code(7), None);
    /// ```
    #[must_use]
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.iter().copied().find(|function| function.code() == code)
    }

    /// Returns whether the function only writes, so that it may be broadcast (MODBUS over serial line, 2.1).
    #[must_use]
    pub const fn may_be_broadcast(self) -> bool {
        matches!(
            self,
            Self::WriteSingleCoil
                | Self::WriteSingleRegister
                | Self::WriteMultipleCoils
                | Self::WriteMultipleRegisters
                | Self::MaskWriteRegister
        )
    }
}

/// Serves a request PDU. Returns the length of the response PDU, which starts at `response[0]`. Returns 0, meaning no
/// response, for a request without a function code.
///
/// Checks follow the order of the specification: function (01); length, quantity, byte count and value (03); addresses
/// (02); then the device. A request whose length does not match its function and counts is answered with 03 ("implied
/// length is incorrect").
///
/// See the [crate's documentation](crate) for an example.
pub fn serve<D: Device + ?Sized>(request: &[u8], device: &mut D, response: &mut [u8; MAX_PDU_LEN]) -> usize {
    let Some((&code, data)) = request.split_first() else { return 0 };
    let (len, _) = serve_as(Function::from_code(code), code, None, data, device, response);
    len
}

/// Like [`serve`], for a caller that has already decoded the function code. Also returns the exception sent, if any.
/// `unit` is the address of a server on a serial line.
#[inline]
pub(super) fn serve_as<D: Device + ?Sized>(
    function: Option<Function>,
    code: u8,
    unit: Option<u8>,
    data: &[u8],
    device: &mut D,
    response: &mut [u8; MAX_PDU_LEN],
) -> (usize, Option<Exception>) {
    let mut reply = Reply::new(code, response);
    match answer(function, unit, data, device, &mut reply) {
        Ok(()) => (reply.len(), None),
        Err(exception) => (reply.refuse(code, exception), Some(exception)),
    }
}

fn answer<D: Device + ?Sized>(
    function: Option<Function>,
    unit: Option<u8>,
    data: &[u8],
    device: &mut D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    match function.ok_or(Exception::IllegalFunction)? {
        Function::ReadCoils => read_bits(data, device, false, reply),
        Function::ReadDiscreteInputs => read_bits(data, device, true, reply),
        Function::ReadHoldingRegisters => read_registers(data, device, false, reply),
        Function::ReadInputRegisters => read_registers(data, device, true, reply),
        Function::WriteSingleCoil => write_single_coil(data, device, reply),
        Function::WriteSingleRegister => {
            let &[a1, a0, v1, v0] = data else { return Err(Exception::IllegalDataValue) };
            device.write_registers(u16::from_be_bytes([a1, a0]), Words::new(&[v1, v0]))?;
            reply.put(data)
        }
        Function::WriteMultipleCoils => write_multiple_coils(data, device, reply),
        Function::WriteMultipleRegisters => write_multiple_registers(data, device, reply),
        Function::ReportServerId => {
            identification::report(unit.ok_or(Exception::IllegalFunction)?, data, device, reply)
        }
        Function::WriteFileRecord => write_file_records(data, device, reply),
        Function::MaskWriteRegister => mask_write_register(data, device, reply),
        Function::ReadWriteMultipleRegisters => read_write_multiple_registers(data, device, reply),
        Function::EncapsulatedInterfaceTransport => match data.split_first() {
            Some((&MEI_TYPE, data)) => identification::read(data, device, reply),
            Some(_) => Err(Exception::IllegalFunction),
            None => Err(Exception::IllegalDataValue),
        },
        Function::Diagnostics => Err(Exception::IllegalFunction),
    }
}

/// Returns the first address and the quantity of a request. Rejects quantities outside 1 to `most`.
fn block(data: &[u8], most: u16) -> Result<(u16, u16), Exception> {
    let &[a1, a0, q1, q0] = data else { return Err(Exception::IllegalDataValue) };
    let quantity = u16::from_be_bytes([q1, q0]);
    if !(1..=most).contains(&quantity) {
        return Err(Exception::IllegalDataValue);
    }
    Ok((u16::from_be_bytes([a1, a0]), quantity))
}

/// Returns the addresses of a block. Rejects blocks that extend past 65 535.
fn addresses(first: u16, quantity: u16) -> Result<impl Iterator<Item = u16>, Exception> {
    // A half-open range: an inclusive one takes four times the code.
    let (first, end) = (u32::from(first), u32::from(first).saturating_add(quantity.into()));
    if end > 0x1_0000 {
        return Err(Exception::IllegalDataAddress);
    }
    Ok((first..end).map(|address| address as u16))
}

fn read_bits<D: Device + ?Sized>(
    data: &[u8],
    device: &D,
    inputs: bool,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let (first, quantity) = block(data, 2000)?;
    reply.put(&[quantity.div_ceil(8) as u8])?;
    let (mut byte, mut mask) = (0u8, 1u8);
    for address in addresses(first, quantity)? {
        let value = if inputs { device.discrete_input(address) } else { device.coil(address) };
        if value? {
            byte |= mask;
        }
        mask = mask.rotate_left(1);
        if mask == 1 {
            reply.put(&[core::mem::take(&mut byte)])?;
        }
    }
    if mask != 1 {
        reply.put(&[byte])?;
    }
    Ok(())
}

fn read_registers<D: Device + ?Sized>(
    data: &[u8],
    device: &D,
    inputs: bool,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let (first, quantity) = block(data, 125)?;
    let count = quantity.wrapping_mul(2) as u8;
    reply.put_byte(count)?;
    let places = reply.extend(count.into())?.as_chunks_mut().0;
    for (place, address) in places.iter_mut().zip(addresses(first, quantity)?) {
        let value = if inputs { device.input_register(address) } else { device.holding_register(address) };
        *place = value?.to_be_bytes();
    }
    Ok(())
}

fn write_single_coil<D: Device + ?Sized>(
    data: &[u8],
    device: &mut D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let &[a1, a0, v1, v0] = data else { return Err(Exception::IllegalDataValue) };
    let value = match u16::from_be_bytes([v1, v0]) {
        0x0000 => 0,
        0xFF00 => 1,
        _ => return Err(Exception::IllegalDataValue),
    };
    device.write_coils(u16::from_be_bytes([a1, a0]), Bits::new(&[value], 1))?;
    reply.put(data)
}

/// Returns first address, quantity and values of a multiple write, if quantity, byte count and length agree.
fn counted(data: &[u8], bytes_of: impl Fn(u16) -> u16, most: u16) -> Result<(u16, u16, &[u8]), Exception> {
    let (head, rest) = data.split_at_checked(4).ok_or(Exception::IllegalDataValue)?;
    let (first, quantity) = block(head, most)?;
    let (&count, values) = rest.split_first().ok_or(Exception::IllegalDataValue)?;
    if u16::from(count) != bytes_of(quantity) || values.len() != usize::from(count) {
        return Err(Exception::IllegalDataValue);
    }
    // Rejects blocks past 65 535, whose addresses would otherwise wrap to 0.
    let _ = addresses(first, quantity)?;
    Ok((first, quantity, values))
}

fn write_multiple_coils<D: Device + ?Sized>(
    data: &[u8],
    device: &mut D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let (first, quantity, values) = counted(data, |quantity| quantity.div_ceil(8), 0x07B0)?;
    device.write_coils(first, Bits::new(values, quantity))?;
    reply.put_block(first, quantity)
}

fn write_multiple_registers<D: Device + ?Sized>(
    data: &[u8],
    device: &mut D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let (first, quantity, values) = counted(data, |quantity| quantity.wrapping_mul(2), 0x007B)?;
    device.write_registers(first, Words::new(values))?;
    reply.put_block(first, quantity)
}

/// Valid values of the byte count in Write File Record: from one group with one record to the longest PDU.
const FILE_RECORD_BYTES: core::ops::RangeInclusive<u8> = 0x09..=0xFB;

fn write_file_records<D: Device + ?Sized>(
    data: &[u8],
    device: &mut D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let (&count, groups) = data.split_first().ok_or(Exception::IllegalDataValue)?;
    if !FILE_RECORD_BYTES.contains(&count) || groups.len() != usize::from(count) {
        return Err(Exception::IllegalDataValue);
    }
    device.write_file_records(FileRecords::new(groups)?)?;
    reply.put(data)
}

fn mask_write_register<D: Device + ?Sized>(
    data: &[u8],
    device: &mut D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let &[a1, a0, and1, and0, or1, or0] = data else { return Err(Exception::IllegalDataValue) };
    let address = u16::from_be_bytes([a1, a0]);
    let (and, or) = (u16::from_be_bytes([and1, and0]), u16::from_be_bytes([or1, or0]));
    let value = (device.holding_register(address)? & and) | (or & !and);
    device.write_registers(address, Words::new(&value.to_be_bytes()))?;
    reply.put(data)
}

/// Writes before reading. Writes nothing if a register to read does not exist.
fn read_write_multiple_registers<D: Device + ?Sized>(
    data: &[u8],
    device: &mut D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let (head, rest) = data.split_at_checked(4).ok_or(Exception::IllegalDataValue)?;
    let (first, quantity) = block(head, 0x007D)?;
    let (write_first, _, values) = counted(rest, |quantity| quantity.wrapping_mul(2), 0x0079)?;
    for address in addresses(first, quantity)? {
        device.holding_register(address)?;
    }
    device.write_registers(write_first, Words::new(values))?;
    read_registers(head, device, false, reply)
}

/// A response under construction. Valid requests never make it longer than a PDU.
struct Reply<'a> {
    bytes: &'a mut [u8; MAX_PDU_LEN],
    len: usize,
}

impl<'a> Reply<'a> {
    fn new(code: u8, bytes: &'a mut [u8; MAX_PDU_LEN]) -> Self {
        let mut reply = Self { bytes, len: 0 };
        let _ = reply.put_byte(code);
        reply
    }

    const fn len(&self) -> usize {
        self.len
    }

    const fn room(&self) -> usize {
        MAX_PDU_LEN.saturating_sub(self.len)
    }

    // Not inlined: shorter code for small requests outweighs the last microsecond of a response.
    #[inline(never)]
    fn put(&mut self, bytes: &[u8]) -> Result<(), Exception> {
        copy(self.extend(bytes.len())?, bytes);
        Ok(())
    }

    fn put_byte(&mut self, byte: u8) -> Result<(), Exception> {
        self.extend(1)?.first_mut().map_or(Err(Exception::ServerDeviceFailure), |place| {
            *place = byte;
            Ok(())
        })
    }

    /// Extends the response by `len` bytes and returns them for the caller to fill.
    fn extend(&mut self, len: usize) -> Result<&mut [u8], Exception> {
        let start = self.len;
        let end = start.saturating_add(len);
        let place = self.bytes.get_mut(start..end).ok_or(Exception::ServerDeviceFailure)?;
        self.len = end;
        Ok(place)
    }

    fn put_block(&mut self, first: u16, quantity: u16) -> Result<(), Exception> {
        self.put(&first.to_be_bytes())?;
        self.put(&quantity.to_be_bytes())
    }

    /// Overwrites bytes already in the response.
    fn set(&mut self, at: usize, bytes: &[u8]) {
        copy(self.bytes.get_mut(at..).unwrap_or_default(), bytes);
    }

    fn refuse(&mut self, code: u8, exception: Exception) -> usize {
        self.len = 0;
        let _ = self.put(&[code | 0x80, exception.code()]);
        self.len
    }
}

/// Like `copy_from_slice`, but without its panic: copies the shorter of the two lengths.
fn copy(to: &mut [u8], from: &[u8]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
