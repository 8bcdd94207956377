//! Read Device Identification, FC 43 / MEI type 14 (specification, 6.21), and Report Server ID, FC 17 (6.13).

use super::Reply;
use crate::{Device, Exception};

/// MEI type of Read Device Identification.
pub(super) const MEI_TYPE: u8 = 0x0E;

/// Run indicator status "ON"; a server that responds is always running.
const RUNNING: u8 = 0xFF;

/// Answers FC 17. The device-specific part is the unit as the server ID, then product code and revision.
pub(super) fn report<D: Device + ?Sized>(
    unit: u8,
    data: &[u8],
    device: &D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    if !data.is_empty() {
        return Err(Exception::IllegalDataValue);
    }
    let identification = device.identification();
    reply.put(&[0, unit, RUNNING])?;
    for text in [identification.product_code, " ", identification.revision] {
        reply.put(text.as_bytes())?;
    }
    // The byte count excludes function code and itself.
    reply.set(1, &[reply.len().saturating_sub(2) as u8]);
    Ok(())
}

/// Answers FC 43. `data` is the request after the MEI type.
pub(super) fn read<D: Device + ?Sized>(
    data: &[u8],
    device: &D,
    reply: &mut Reply<'_>,
) -> Result<(), Exception> {
    let &[code, object] = data else { return Err(Exception::IllegalDataValue) };
    let identification = device.identification();
    let (first, last) = match code {
        // Requests above the server's conformity level get its own level. A stream that starts at an unknown object
        // restarts at the first one.
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
