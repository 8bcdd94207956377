//! Endpoint mapper: lists the only interface, that of the device, and its port.

use crate::cursor::{Order, Reader, Writer};
use crate::dcp::INSTANCE;
use crate::profile::Profile;
use crate::rpc::{DEVICE_INTERFACE, RPC_PORT};

/// Operations: look up the next endpoint, and release the handle of a look-up.
pub(crate) const LOOKUP: u16 = 2;
pub(crate) const FREE_HANDLE: u16 = 4;

/// Status: no further entry.
const NOT_REGISTERED: u32 = 0x16C9_A0D6;

/// UUID of the transfer syntax NDR, as in a floor of a tower.
const NDR: [u8; 16] =
    [0x8A, 0x88, 0x5D, 0x04, 0x1C, 0xEB, 0x11, 0xC9, 0x9F, 0xE8, 0x08, 0, 0x2B, 0x10, 0x48, 0x60];

/// Protocol identifiers of floors.
mod floor {
    pub(super) const UUID: u8 = 0x0D;
    pub(super) const RPC: u8 = 0x0A;
    pub(super) const UDP: u8 = 0x08;
    pub(super) const IP: u8 = 0x09;
}

const ANNOTATION_LEN: usize = 64;

/// Common prefix of all PROFINET object UUIDs (IEC 61158-6-10, ObjectUUID), of devices and of controllers.
const OBJECT_PREFIX: [u8; 10] = [0xDE, 0xA0, 0, 0, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71];

/// Returns the object UUID of a device: instance, device number and vendor number after the common prefix.
pub(crate) fn object(profile: &Profile) -> [u8; 16] {
    let [o0, o1, o2, o3, o4, o5, o6, o7, o8, o9] = OBJECT_PREFIX;
    let [i0, i1] = INSTANCE.to_be_bytes();
    let [d0, d1] = profile.device_id.to_be_bytes();
    let [v0, v1] = profile.vendor_id.to_be_bytes();
    [o0, o1, o2, o3, o4, o5, o6, o7, o8, o9, i0, i1, d0, d1, v0, v1]
}

/// Returns whether a UUID identifies a PROFINET object of any vendor.
pub(crate) fn is_object(uuid: &[u8; 16]) -> bool {
    uuid.starts_with(&OBJECT_PREFIX)
}

/// Writes the answer to a look-up. Returns `None` if the request is invalid.
pub(crate) fn lookup(
    body: &[u8],
    order: Order,
    writer: &mut Writer<'_>,
    profile: &Profile,
    address: [u8; 4],
) -> Option<()> {
    let mut reader = Reader::new(body);
    reader.skip(4)?;
    if reader.u32_in(order)? != 0 {
        reader.skip(16)?;
    }
    if reader.u32_in(order)? != 0 {
        reader.skip(20)?;
    }
    reader.skip(4)?;
    let handle: [u8; 20] = reader.array()?;
    let max_entries = reader.u32_in(order)?;
    let is_first = handle == [0; 20];
    let count = u32::from(is_first && max_entries > 0);
    // A non-zero handle marks that the entry has been returned.
    writer.u32(0);
    writer.bytes(&if count == 1 { object(profile) } else { [0; 16] });
    writer.u32_in(order, count);
    writer.u32_in(order, max_entries);
    writer.u32_in(order, 0);
    writer.u32_in(order, count);
    if count == 1 {
        writer.bytes(&uuid(object(profile), order));
        // Referent of the tower, which follows.
        writer.u32_in(order, 1);
        writer.u32_in(order, 0);
        writer.u32_in(order, ANNOTATION_LEN as u32);
        annotation(writer, profile);
        let start = writer.len();
        writer.u32(0);
        writer.u32(0);
        tower(writer, address);
        let len = writer.len().saturating_sub(start).saturating_sub(8) as u32;
        let bytes = if order == Order::BigEndian { len.to_be_bytes() } else { len.to_le_bytes() };
        writer.put(start, &bytes);
        writer.put(start.saturating_add(4), &bytes);
        writer.align(start, 4);
    }
    writer.u32_in(order, if count == 1 { 0 } else { NOT_REGISTERED });
    Some(())
}

/// Writes a readable description: type, order number, revisions.
fn annotation(writer: &mut Writer<'_>, profile: &Profile) {
    let start = writer.len();
    writer.text(profile.station_type.as_bytes(), 25);
    writer.u8(b' ');
    writer.text(profile.order_id.as_bytes(), 20);
    writer.u8(b' ');
    decimal(writer, profile.hardware_revision, 5);
    writer.bytes(b" V");
    for part in profile.software_revision {
        decimal(writer, part.into(), 3);
    }
    let written = writer.len().saturating_sub(start);
    writer.fill(0, ANNOTATION_LEN.saturating_sub(written));
}

/// Writes a decimal number, right-aligned with blanks.
fn decimal(writer: &mut Writer<'_>, mut number: u16, width: usize) {
    let mut digits = [b' '; 5];
    for digit in digits.iter_mut().rev().take(width) {
        *digit = b'0'.saturating_add((number % 10) as u8);
        number /= 10;
        if number == 0 {
            break;
        }
    }
    writer.bytes(digits.get(digits.len().saturating_sub(width)..).unwrap_or(&[]));
}

/// Writes the protocol tower of the interface. Numbers in floors are little-endian.
fn tower(writer: &mut Writer<'_>, address: [u8; 4]) {
    let number = |value: u16| value.to_le_bytes();
    writer.bytes(&number(5));
    for (interface, version) in [(DEVICE_INTERFACE, 1), (NDR, 2)] {
        writer.bytes(&number(19));
        writer.u8(floor::UUID);
        writer.bytes(&uuid(interface, Order::LittleEndian));
        writer.bytes(&number(version));
        writer.bytes(&number(2));
        writer.bytes(&number(0));
    }
    let port = RPC_PORT.to_be_bytes();
    for (protocol, value) in [(floor::RPC, &[0, 0][..]), (floor::UDP, &port), (floor::IP, &address)] {
        writer.bytes(&number(1));
        writer.u8(protocol);
        writer.bytes(&number(value.len() as u16));
        writer.bytes(value);
    }
}

fn uuid(uuid: [u8; 16], order: Order) -> [u8; 16] {
    crate::rpc::swapped(uuid, order)
}
