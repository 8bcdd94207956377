//! Read Device Identification, FC 43 / MEI type 14 (specification, 6.21).

use super::pdu::Reply;
use super::{Device, Exception};

/// The MODBUS encapsulated interface's type for it.
pub(super) const MEI_TYPE: u8 = 0x0E;

/// The first three objects are mandatory: the basic category.
const BASIC_LEN: usize = 3;

/// The conformity levels: stream and individual access to the basic, or to the regular objects.
const CONFORMITY_BASIC: u8 = 0x81;
const CONFORMITY_REGULAR: u8 = 0x82;

/// What a server says of itself. Printable ASCII; together below 240 bytes, or it takes more than one request.
///
/// ```
/// use bus_modbus::Identification;
///
/// let identification = Identification {
///     vendor_name: "a vendor",
///     product_code: "AB-1",
///     revision: "V1.0",
///     regular: None,
/// };
/// assert!(identification.regular.is_none());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identification {
    /// Object 0.
    pub vendor_name: &'static str,
    /// Object 1.
    pub product_code: &'static str,
    /// Object 2: MajorMinorRevision.
    pub revision: &'static str,
    /// Objects 3 to 6, which are optional: VendorUrl, ProductName, ModelName, UserApplicationName.
    pub regular: Option<[&'static str; 4]>,
}

impl Identification {
    fn object(&self, id: u8) -> Option<&'static str> {
        match id {
            0 => Some(self.vendor_name),
            1 => Some(self.product_code),
            2 => Some(self.revision),
            _ => self.regular?.get(usize::from(id).checked_sub(BASIC_LEN)?).copied(),
        }
    }

    const fn conformity(&self) -> u8 {
        if self.regular.is_some() { CONFORMITY_REGULAR } else { CONFORMITY_BASIC }
    }
}

/// Answers a request; `data` is what stands behind the MEI type.
pub(super) fn read<D: Device + ?Sized>(
    data: &[u8],
    device: &D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let &[code, object] = data else { return Err(Exception::IllegalDataValue) };
    let identification = device.identification();
    let (first, last) = match code {
        // A level above its own is answered at its own, a stream from an object that is not there from the first on.
        1 => (if object <= 2 { object } else { 0 }, 2),
        2 | 3 => (if identification.object(object).is_some() { object } else { 0 }, u8::MAX),
        4 if identification.object(object).is_some() => (object, object),
        4 => return Err(Exception::IllegalDataAddress),
        _ => return Err(Exception::IllegalDataValue),
    };
    reply.put(&[MEI_TYPE, code, identification.conformity()])?;
    let more_at = reply.len();
    reply.put(&[0, 0, 0])?;
    let mut count = 0u8;
    for id in first..=last {
        let Some(text) = identification.object(id) else { break };
        let value = text.as_bytes();
        let Ok(len) = u8::try_from(value.len()) else { break };
        if reply.room() < value.len().saturating_add(2) {
            reply.set(more_at, &[0xFF, id]);
            break;
        }
        reply.put(&[id, len])?;
        reply.put(value)?;
        count = count.saturating_add(1);
    }
    reply.set(more_at.saturating_add(2), &[count]);
    Ok(())
}
