//! Requests and responses without addresses and checksums: the PDU (specification, chapter 4).

mod identification;

use self::identification::MEI_TYPE;
use super::{Bits, Device, Exception, Words};

/// Bytes of the longest PDU.
pub const MAX_PDU_LEN: usize = 253;

/// Function codes that are served (specification, chapter 6); FC 8 and FC 17 by the serial line alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Function {
    /// 01: Read Coils.
    ReadCoils = 1,
    /// 02: Read Discrete Inputs.
    ReadDiscreteInputs = 2,
    /// 03: Read Holding Registers.
    ReadHoldingRegisters = 3,
    /// 04: Read Input Registers.
    ReadInputRegisters = 4,
    /// 05: Write Single Coil.
    WriteSingleCoil = 5,
    /// 06: Write Single Register.
    WriteSingleRegister = 6,
    /// 08: Diagnostics, on a serial line only.
    Diagnostics = 8,
    /// 15 (0Fh): Write Multiple Coils.
    WriteMultipleCoils = 15,
    /// 16 (10h): Write Multiple Registers.
    WriteMultipleRegisters = 16,
    /// 17 (11h): Report Server ID, on a serial line only.
    ReportServerId = 17,
    /// 22 (16h): Mask Write Register.
    MaskWriteRegister = 22,
    /// 23 (17h): Read/Write Multiple Registers.
    ReadWriteMultipleRegisters = 23,
    /// 43 (2Bh): Encapsulated Interface Transport; of its types, 14: Read Device Identification.
    EncapsulatedInterfaceTransport = 43,
}

impl Function {
    /// Every one, by code.
    pub const ALL: [Self; 13] = [
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
        Self::MaskWriteRegister,
        Self::ReadWriteMultipleRegisters,
        Self::EncapsulatedInterfaceTransport,
    ];

    /// The code.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The function with this code.
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

    /// Whether it writes and reads nothing back, so that it may be broadcast (MODBUS over serial line, 2.1).
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

/// Answers a request. Returns the response's length in `response`; 0, which is no response, for a request without a
/// function code.
///
/// What is checked in which order is the specification's: function (01), then length, quantity, byte count and value
/// (03), then addresses (02), then what the device says. A request whose length is not what its function and counts ask
/// for is 03, "implied length is incorrect".
///
/// The [crate's documentation](crate) has an example.
pub fn serve<D: Device + ?Sized>(request: &[u8], device: &mut D, response: &mut [u8; MAX_PDU_LEN]) -> usize {
    let Some((&code, data)) = request.split_first() else { return 0 };
    let (len, _) = serve_as(Function::from_code(code), code, None, data, device, response);
    len
}

/// As [`serve`], for a caller who has looked at the code; also the exception that it answers with. A unit is what a server
/// on a serial line has.
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

/// The first address and the quantity of a read, the quantity within its limits.
fn block(data: &[u8], most: u16) -> Result<(u16, u16), Exception> {
    let &[a1, a0, q1, q0] = data else { return Err(Exception::IllegalDataValue) };
    let quantity = u16::from_be_bytes([q1, q0]);
    if !(1..=most).contains(&quantity) {
        return Err(Exception::IllegalDataValue);
    }
    Ok((u16::from_be_bytes([a1, a0]), quantity))
}

/// The addresses of a block; past 65 535 there are none.
fn addresses(first: u16, quantity: u16) -> Result<impl Iterator<Item = u16>, Exception> {
    // Not an inclusive range: that takes four times the code.
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

/// The values of a multiple write, when quantity, byte count and length agree.
fn counted(data: &[u8], bytes_of: impl Fn(u16) -> u16, most: u16) -> Result<(u16, u16, &[u8]), Exception> {
    let (head, rest) = data.split_at_checked(4).ok_or(Exception::IllegalDataValue)?;
    let (first, quantity) = block(head, most)?;
    let (&count, values) = rest.split_first().ok_or(Exception::IllegalDataValue)?;
    if u16::from(count) != bytes_of(quantity) || values.len() != usize::from(count) {
        return Err(Exception::IllegalDataValue);
    }
    // So that an address past 65 535 is one that does not exist, not the first again.
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

/// The write is carried out before the read, and not at all when one of the registers to read does not exist.
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

/// A response as it grows. No request that passes its checks makes it longer than a PDU.
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

    // Small requests are worth more than the last microsecond of an answer.
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

    /// Makes it longer by so many bytes, for the caller to fill.
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

    /// Overwrites what was put before.
    fn set(&mut self, at: usize, bytes: &[u8]) {
        copy(self.bytes.get_mut(at..).unwrap_or_default(), bytes);
    }

    fn refuse(&mut self, code: u8, exception: Exception) -> usize {
        self.len = 0;
        let _ = self.put(&[code | 0x80, exception.code()]);
        self.len
    }
}

/// As `copy_from_slice`, but without its panic.
fn copy(to: &mut [u8], from: &[u8]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
