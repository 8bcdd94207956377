//! Cyclic frames of real time class 1: data of submodules with provider status, and consumer statuses.

use crate::connect::Iocr;
use crate::cursor::{Reader, Writer, copy};
use crate::frame::{self, ETHERTYPE_PROFINET, MacAddress};
use crate::profile::Profile;

/// Provider or consumer status: good.
const GOOD: u8 = 0x80;

/// Bits of DataStatus.
mod data_status {
    /// Primary, valid, normal operation.
    pub(super) const PRIMARY: u8 = 0x01;
    pub(super) const VALID: u8 = 0x04;
    pub(super) const RUN: u8 = 0x10;
    pub(super) const NO_PROBLEM: u8 = 0x20;
}

/// Maximum advance of a newer cycle counter. Beyond it, a frame is old.
const NEWER: u16 = 61_440;

/// State of received outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Received {
    /// All outputs are good.
    Good,
    /// The controller is present without good outputs: stopped, a backup controller, or bad status.
    Bad,
}

/// Reads a frame after its identifier. Writes the outputs if all of them are good. Returns `None` for a frame that is
/// invalid, old or not of this connection; such a frame does not restart the hold time.
pub(crate) fn receive(
    payload: &[u8],
    iocr: &Iocr,
    last_counter: &mut Option<u16>,
    profile: &'static Profile,
    outputs: &mut [u8],
) -> Option<Received> {
    let mut reader = Reader::new(payload);
    let data = reader.bytes(iocr.data_len.into())?;
    let counter = reader.u16()?;
    let status = reader.u8()?;
    let transfer = reader.u8()?;
    // Frames need no padding: 40 bytes of data fill the minimum length.
    if status & data_status::VALID == 0 || transfer != 0 || !reader.rest().is_empty() {
        return None;
    }
    if let Some(last) = *last_counter {
        let ahead = counter.wrapping_sub(last);
        if ahead == 0 || ahead > NEWER {
            return None;
        }
    }
    *last_counter = Some(counter);
    let places = || {
        profile.submodules().zip(&iocr.places).filter_map(|(slotted, place)| {
            let len = usize::from(slotted.submodule.output_len);
            let start = usize::from(place.data?);
            let data = data.get(start..start.saturating_add(len))?;
            let provider = data_at(payload, start.saturating_add(len));
            Some((slotted.output_at, data, provider))
        })
    };
    let has_all = places().map(|(_, data, _)| data.len()).sum::<usize>() == outputs.len();
    let are_good = places().all(|(_, _, provider)| provider & GOOD != 0);
    // Outputs of a backup controller do not count; redundancy is not supported.
    let commands = data_status::PRIMARY | data_status::RUN;
    if status & commands != commands || !are_good || !has_all {
        return Some(Received::Bad);
    }
    for (at, data, _) in places() {
        // Cannot fail: the total length was checked above.
        let _ = copy(outputs, at, data);
    }
    Some(Received::Good)
}

fn data_at(payload: &[u8], at: usize) -> u8 {
    payload.get(at).copied().unwrap_or(0)
}

/// Contents of a frame of inputs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inputs<'a> {
    pub(crate) mac: MacAddress,
    pub(crate) peer: MacAddress,
    pub(crate) data: &'a [u8],
    /// Whether the data is good.
    pub(crate) has_data: bool,
    /// Whether parameters have ended, so that the inputs are good.
    pub(crate) is_ready: bool,
    /// Whether the device has a fault.
    pub(crate) has_problem: bool,
    pub(crate) counter: u16,
}

/// Writes a frame of inputs. Returns its length.
pub(crate) fn transmit(
    buffer: &mut [u8],
    iocr: &Iocr,
    profile: &'static Profile,
    inputs: &Inputs<'_>,
) -> Option<usize> {
    let mut writer = Writer::new(buffer);
    frame::header(&mut writer, inputs.peer, inputs.mac, Some(iocr.tag), ETHERTYPE_PROFINET);
    writer.u16(iocr.frame_id);
    let start = writer.len();
    writer.fill(0, iocr.data_len.into());
    let status = if inputs.is_ready { GOOD } else { 0 };
    for (slotted, place) in profile.submodules().zip(&iocr.places) {
        let len = usize::from(slotted.submodule.input_len);
        if let Some(at) = place.data {
            let at = start.saturating_add(at.into());
            let data = inputs.data.get(slotted.input_at..slotted.input_at.saturating_add(len));
            writer.put(at, data.unwrap_or(&[]));
            let is_good = inputs.has_data || len == 0;
            writer.put(at.saturating_add(len), &[if is_good { status } else { 0 }]);
        }
        if let Some(at) = place.consumer {
            writer.put(start.saturating_add(at.into()), &[status]);
        }
    }
    writer.u16(inputs.counter);
    let problem = if inputs.has_problem { 0 } else { data_status::NO_PROBLEM };
    writer.u8(data_status::PRIMARY | data_status::VALID | data_status::RUN | problem);
    writer.u8(0);
    frame::finish(writer)
}
