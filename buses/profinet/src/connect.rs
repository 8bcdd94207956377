//! Connect (IEC 61158-6-10, 5.2.4 ff.): checks the controller's request against the device.

use core::ops::Range;

use crate::cursor::Reader;
use crate::epm;
use crate::frame::{ETHERTYPE_PROFINET, MacAddress};
use crate::profile::{MAX_SUBMODULES, Profile};
use crate::rpc::{Endpoint, PnioStatus, server};

/// Block types of the request.
mod block {
    pub(super) const AR: u16 = 0x0101;
    pub(super) const IOCR: u16 = 0x0102;
    pub(super) const ALARM_CR: u16 = 0x0103;
    pub(super) const EXPECTED: u16 = 0x0104;
}

/// Numbers of the blocks in error codes, in the order of the specification.
mod blamed {
    pub(super) const AR: u8 = 1;
    pub(super) const IOCR: u8 = 2;
    pub(super) const EXPECTED: u8 = 3;
    pub(super) const ALARM_CR: u8 = 4;
}

const AR_TYPE_CONTROLLER: u16 = 1;
const AR_TYPE_SUPERVISOR: u16 = 6;

/// ARProperties: access to records only, no cyclic data.
const DEVICE_ACCESS: u32 = 1 << 8;
/// ARProperties: companion AR and advanced start-up, which the GSDML file does not offer.
const UNSUPPORTED: u32 = 3 << 9 | 1 << 30;

/// Maximum hold time of a controller, in µs.
const MAX_HOLD_US: u64 = 1_920_000;

/// Maximum length of a station name.
const MAX_NAME_LEN: u16 = 240;

/// VLAN tags of cyclic data and of alarms (IEC 61158-6-10, 5.2.4): priority 6 or 5, no VLAN. The reserved bit
/// in between is not checked.
const PRIORITY_6: u16 = 0xC000;
const PRIORITY_5: u16 = 0xA000;
const RESERVED_OF_TAG: u16 = 0x1000;

/// Valid length of the cyclic data in bytes.
const DATA_LEN: core::ops::RangeInclusive<u16> = 40..=1_440;

/// Application relation: identity and address of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Relation {
    pub(crate) kind: u16,
    pub(crate) uuid: [u8; 16],
    pub(crate) session_key: u16,
    pub(crate) mac: MacAddress,
    pub(crate) object: [u8; 16],
    /// Source address of the request.
    pub(crate) host: Endpoint,
    /// Time-out between two calls, in µs.
    pub(crate) activity_us: u64,
}

/// A submodule that the controller expects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Expected {
    pub(crate) slot: u16,
    pub(crate) module: u32,
    pub(crate) subslot: u16,
    pub(crate) ident: u32,
    input_len: u16,
    output_len: u16,
}

/// Result of comparing an expected submodule with the real one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Match {
    Proper,
    WrongSubmodule,
    NoSubmodule,
    WrongModule,
    NoModule,
}

impl Expected {
    pub(crate) fn compare(&self, profile: &Profile) -> Match {
        let Some(module) = profile.module(self.slot) else { return Match::NoModule };
        if module.ident != self.module {
            return Match::WrongModule;
        }
        let Some(submodule) = profile.submodule(self.slot, self.subslot) else { return Match::NoSubmodule };
        let lens = (submodule.input_len, submodule.output_len);
        if submodule.ident == self.ident && lens == (self.input_len, self.output_len) {
            Match::Proper
        } else {
            Match::WrongSubmodule
        }
    }
}

/// All submodules that the controller expects.
pub(crate) type Configuration = [Option<Expected>; MAX_SUBMODULES];

/// Offsets of a submodule in a frame: its data, followed by the provider status, and its consumer status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) data: Option<u16>,
    pub(crate) consumer: Option<u16>,
}

/// Cyclic data in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Iocr {
    pub(crate) reference: u16,
    pub(crate) frame_id: u16,
    pub(crate) data_len: u16,
    /// Cycle time in 31.25 µs.
    pub(crate) cycle: u16,
    pub(crate) hold_us: u64,
    pub(crate) tag: u16,
    /// Offsets, in the order of the device's submodules.
    pub(crate) places: [Place; MAX_SUBMODULES],
}

impl Iocr {
    pub(crate) fn cycle_us(&self) -> u64 {
        // 31.25 µs is 125/4.
        u64::from(self.cycle).saturating_mul(125) / 4
    }
}

/// Parameters of the alarm connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct AlarmCr {
    /// Whether all alarms have low priority.
    pub(crate) is_low_only: bool,
    pub(crate) timeout_us: u64,
    pub(crate) retries: u8,
    /// The controller's reference for its end.
    pub(crate) reference: u16,
    pub(crate) tag_high: u16,
    pub(crate) tag_low: u16,
}

#[expect(clippy::large_enum_variant, reason = "short-lived: the caller destructures it immediately")]
#[derive(Clone, Debug)]
pub(crate) enum Request {
    Access(Relation),
    Io { relation: Relation, input: Iocr, output: Iocr, alarms: AlarmCr, expected: Configuration },
}

impl Request {
    /// Parses the blocks of a request from this host. Returns the error status if they are invalid.
    pub(crate) fn parse(
        blocks: &[u8],
        host: Endpoint,
        profile: &'static Profile,
    ) -> Result<Self, PnioStatus> {
        let mut expected = [None; MAX_SUBMODULES];
        let mut count = 0;
        each_block(blocks, |kind, body| match kind {
            block::EXPECTED => parse_expected(body, &mut expected, &mut count),
            _ => Ok(()),
        })?;
        let (mut relation, mut input, mut output, mut alarms) = (None, None, None, None);
        each_block(blocks, |kind, body| {
            if (kind == block::AR) == relation.is_some() {
                return Err(PnioStatus::connect(blamed::AR, 0));
            }
            match kind {
                block::AR => relation = Some(parse_ar(body, host)?),
                block::IOCR => {
                    let (is_input, iocr) = parse_iocr(body, &expected, profile)?;
                    let place = if is_input { &mut input } else { &mut output };
                    if place.replace(iocr).is_some() {
                        return Err(PnioStatus::connect(blamed::IOCR, 4));
                    }
                }
                block::ALARM_CR => {
                    if alarms.replace(parse_alarm_cr(body)?).is_some() {
                        return Err(PnioStatus::connect_server(server::ALARM_CR_COUNT));
                    }
                }
                block::EXPECTED => {}
                _ => return Err(PnioStatus::connect_server(server::UNKNOWN_BLOCK)),
            }
            Ok(())
        })?;
        let relation = relation.ok_or(PnioStatus::connect(blamed::AR, 0))?;
        if relation.kind == AR_TYPE_SUPERVISOR {
            return Ok(Self::Access(relation));
        }
        let (Some(input), Some(output)) = (input, output) else {
            return Err(PnioStatus::connect_server(server::IOCR_MISSING));
        };
        let alarms = alarms.ok_or(PnioStatus::connect_server(server::ALARM_CR_COUNT))?;
        if count == 0 {
            return Err(PnioStatus::connect(blamed::EXPECTED, 4));
        }
        // Each matching submodule with data needs a place in a frame.
        for (at, slotted) in profile.submodules().enumerate() {
            let is_expected = expected.iter().flatten().any(|expected| {
                (expected.slot, expected.subslot) == (slotted.module.slot, slotted.submodule.subslot)
                    && expected.compare(profile) == Match::Proper
            });
            let is_missing =
                |iocr: &Iocr, len| len > 0 && iocr.places.get(at).is_none_or(|place| place.data.is_none());
            if is_expected
                && (is_missing(&input, slotted.submodule.input_len)
                    || is_missing(&output, slotted.submodule.output_len))
            {
                return Err(PnioStatus::connect(blamed::IOCR, 21));
            }
        }
        Ok(Self::Io { relation, input, output, alarms, expected })
    }
}

/// Passes type and body of each block of a request to `take`. Bodies exclude the version.
pub(crate) fn each_block(
    blocks: &[u8],
    mut take: impl FnMut(u16, &[u8]) -> Result<(), PnioStatus>,
) -> Result<(), PnioStatus> {
    let mut reader = Reader::new(blocks);
    while !reader.rest().is_empty() {
        let (kind, body) = next_block(&mut reader).ok_or(PnioStatus::connect_server(server::ARGUMENTS))?;
        take(kind, body)?;
    }
    Ok(())
}

/// Returns type and body of the next block. The body excludes the version.
pub(crate) fn next_block<'a>(reader: &mut Reader<'a>) -> Option<(u16, &'a [u8])> {
    let kind = reader.u16()?;
    let len = reader.u16()?;
    let mut body = Reader::new(reader.bytes(len.into())?);
    let major = reader_version(&mut body)?;
    (major == 1).then_some((kind, body.rest()))
}

fn reader_version(body: &mut Reader<'_>) -> Option<u8> {
    let major = body.u8()?;
    body.u8()?;
    Some(major)
}

fn parse_ar(body: &[u8], host: Endpoint) -> Result<Relation, PnioStatus> {
    let wrong = |parameter| PnioStatus::connect(blamed::AR, parameter);
    let short = wrong(1);
    let mut reader = Reader::new(body);
    let kind = reader.u16().ok_or(short)?;
    let uuid: [u8; 16] = reader.array().ok_or(short)?;
    let session_key = reader.u16().ok_or(short)?;
    let mac = MacAddress(reader.array().ok_or(short)?);
    let object = reader.array().ok_or(short)?;
    let properties = reader.u32().ok_or(short)?;
    let timeout_factor = reader.u16().ok_or(short)?;
    reader.skip(2).ok_or(short)?;
    let name_len = reader.u16().ok_or(short)?;
    reader.bytes(name_len.into()).ok_or(wrong(12))?;
    let has_name = (1..=MAX_NAME_LEN).contains(&name_len);
    let is_access = properties & DEVICE_ACCESS != 0;
    match kind {
        AR_TYPE_CONTROLLER if !is_access => {}
        AR_TYPE_SUPERVISOR if is_access => {}
        _ => return Err(wrong(4)),
    }
    if uuid == [0; 16] {
        return Err(wrong(5));
    }
    let [first, ..] = mac.0;
    if first & 1 == 1 {
        return Err(wrong(7));
    }
    if !epm::is_object(&object) {
        return Err(wrong(8));
    }
    // Only the active start is supported, and no property that the device does not offer.
    if properties & 7 != 1 || properties & UNSUPPORTED != 0 {
        return Err(wrong(9));
    }
    if !(1..=1_000).contains(&timeout_factor) {
        return Err(wrong(10));
    }
    if !has_name {
        return Err(wrong(12));
    }
    let activity_us = u64::from(timeout_factor).saturating_mul(100_000);
    Ok(Relation { kind, uuid, session_key, mac, object, host, activity_us })
}

fn parse_expected(body: &[u8], expected: &mut Configuration, count: &mut usize) -> Result<(), PnioStatus> {
    let wrong = |parameter| PnioStatus::connect(blamed::EXPECTED, parameter);
    let short = wrong(1);
    let mut reader = Reader::new(body);
    for _ in 0..reader.u16().ok_or(short)? {
        if reader.u32().ok_or(short)? != 0 {
            return Err(wrong(5));
        }
        let slot = reader.u16().ok_or(short)?;
        let module = reader.u32().ok_or(short)?;
        reader.skip(2).ok_or(short)?;
        for _ in 0..reader.u16().ok_or(short)? {
            let subslot = reader.u16().ok_or(short)?;
            let ident = reader.u32().ok_or(short)?;
            let properties = reader.u16().ok_or(short)?;
            let (mut input_len, mut output_len) = (0, 0);
            // One description, or two for data in both directions.
            for _ in 0..if properties & 3 == 3 { 2 } else { 1 } {
                let direction = reader.u16().ok_or(short)?;
                let len = reader.u16().ok_or(short)?;
                let status_lens = reader.array().ok_or(short)?;
                match direction {
                    1 => input_len = len,
                    2 => output_len = len,
                    _ => return Err(wrong(13)),
                }
                if status_lens != [1, 1] {
                    return Err(wrong(15));
                }
            }
            let is_new = |other: &Expected| (other.slot, other.subslot) != (slot, subslot);
            if !expected.iter().flatten().all(is_new) {
                return Err(wrong(10));
            }
            let place = expected.get_mut(*count).ok_or(wrong(9))?;
            *place = Some(Expected { slot, module, subslot, ident, input_len, output_len });
            *count = count.saturating_add(1);
        }
    }
    Ok(())
}

/// Returns whether the frame identifier is of real time class 1, or of class 2, which class 1 may use.
const fn is_frame_id(id: u16) -> bool {
    matches!(id, 0x8000..=0xBBFF | 0xC000..=0xFBFF)
}

/// Leaves the choice of the frame identifier to the device.
const ANY_FRAME_ID: u16 = 0xFFFF;

fn parse_iocr(
    body: &[u8],
    expected: &Configuration,
    profile: &'static Profile,
) -> Result<(bool, Iocr), PnioStatus> {
    let wrong = |parameter| PnioStatus::connect(blamed::IOCR, parameter);
    let short = wrong(1);
    let mut reader = Reader::new(body);
    let kind = reader.u16().ok_or(short)?;
    let reference = reader.u16().ok_or(short)?;
    let ethertype = reader.u16().ok_or(short)?;
    let class = reader.u32().ok_or(short)? & 0x0F;
    let data_len = reader.u16().ok_or(short)?;
    let frame_id = reader.u16().ok_or(short)?;
    let send_clock = reader.u16().ok_or(short)?;
    let reduction = reader.u16().ok_or(short)?;
    let phase = reader.u16().ok_or(short)?;
    // Sequence and offset are ignored: in class 1 the device chooses the moment within a phase. The hold factor
    // below replaces the watchdog factor.
    reader.skip(8).ok_or(short)?;
    let hold_factor = reader.u16().ok_or(short)?;
    let tag = reader.u16().ok_or(short)?;
    reader.skip(6).ok_or(short)?;
    let is_input = match kind {
        1 => true,
        2 => false,
        _ => return Err(wrong(4)),
    };
    if ethertype != ETHERTYPE_PROFINET {
        return Err(wrong(6));
    }
    if !matches!(class, 1 | 2) {
        return Err(wrong(7));
    }
    if !DATA_LEN.contains(&data_len) {
        return Err(wrong(8));
    }
    let frame_id = match frame_id {
        ANY_FRAME_ID if class == 1 => 0xC000,
        ANY_FRAME_ID => 0x8000,
        id if is_frame_id(id) => id,
        _ => return Err(wrong(9)),
    };
    if !(1..=128).contains(&send_clock) {
        return Err(wrong(10));
    }
    let cycle = send_clock.saturating_mul(reduction);
    if !(1..=512).contains(&reduction) || cycle < profile.min_interval || cycle > 16_384 {
        return Err(wrong(11));
    }
    // The phase is one of the send clocks of a cycle, counted from 1.
    if !(1..=reduction).contains(&phase) {
        return Err(wrong(12));
    }
    let places = [Place::default(); MAX_SUBMODULES];
    let mut iocr = Iocr { reference, frame_id, data_len, cycle, hold_us: 0, tag, places };
    iocr.hold_us = iocr.cycle_us().saturating_mul(hold_factor.into());
    if hold_factor == 0 || iocr.hold_us > MAX_HOLD_US {
        return Err(wrong(16));
    }
    if tag & !RESERVED_OF_TAG != PRIORITY_6 {
        return Err(wrong(17));
    }
    let mut parts = Parts::default();
    for _ in 0..reader.u16().ok_or(short)? {
        if reader.u32().ok_or(short)? != 0 {
            return Err(wrong(20));
        }
        for _ in 0..reader.u16().ok_or(short)? {
            let part = parse_object(&mut reader, &mut iocr, expected, profile, Some(is_input), (22, 24))?;
            parts.add(part).ok_or(wrong(24))?;
        }
        for _ in 0..reader.u16().ok_or(short)? {
            let part = parse_object(&mut reader, &mut iocr, expected, profile, None, (26, 28))?;
            parts.add(part).ok_or(wrong(28))?;
        }
    }
    Ok((is_input, iocr))
}

/// Parts of a frame already assigned to objects. If two shared a byte, data could be mistaken for a status.
#[derive(Default)]
struct Parts {
    taken: [Range<u32>; 2 * MAX_SUBMODULES],
    count: usize,
}

impl Parts {
    /// Adds a part. Returns `None` if it overlaps another one.
    fn add(&mut self, part: Range<u32>) -> Option<()> {
        let is_free = |other: &Range<u32>| part.end <= other.start || other.end <= part.start;
        if !self.taken.iter().take(self.count).all(is_free) {
            return None;
        }
        *self.taken.get_mut(self.count)? = part;
        self.count = self.count.saturating_add(1);
        Some(())
    }
}

/// Parses an object of a frame. `data` selects inputs (`true`) or outputs (`false`) with provider status; `None` is a
/// consumer status. `blame` holds the error parameters for an invalid slot and an invalid offset. Returns the part of
/// the frame that the object occupies.
fn parse_object(
    reader: &mut Reader<'_>,
    iocr: &mut Iocr,
    expected: &Configuration,
    profile: &'static Profile,
    data: Option<bool>,
    blame: (u8, u8),
) -> Result<Range<u32>, PnioStatus> {
    let wrong = |parameter| PnioStatus::connect(blamed::IOCR, parameter);
    let short = wrong(1);
    let slot = reader.u16().ok_or(short)?;
    let subslot = reader.u16().ok_or(short)?;
    let offset = reader.u16().ok_or(short)?;
    let is_it = |expected: &&Expected| (expected.slot, expected.subslot) == (slot, subslot);
    let found = expected.iter().flatten().find(is_it).ok_or(wrong(blame.0))?;
    let len = match data {
        Some(true) => found.input_len,
        Some(false) => found.output_len,
        None => 0,
    };
    // One byte of status follows the data.
    let start = u32::from(offset);
    let part = start..start.saturating_add(len.into()).saturating_add(1);
    if part.end > iocr.data_len.into() {
        return Err(wrong(blame.1));
    }
    if found.compare(profile) != Match::Proper {
        // A submodule that does not match has no place: its bytes stay 0, which is also a bad status.
        return Ok(part);
    }
    let at = profile
        .submodules()
        .position(|slotted| (slotted.module.slot, slotted.submodule.subslot) == (slot, subslot));
    let Some(place) = at.and_then(|at| iocr.places.get_mut(at)) else { return Err(wrong(blame.0)) };
    let field = if data.is_some() { &mut place.data } else { &mut place.consumer };
    if field.replace(offset).is_some() {
        return Err(wrong(blame.0));
    }
    Ok(part)
}

fn parse_alarm_cr(body: &[u8]) -> Result<AlarmCr, PnioStatus> {
    let wrong = |parameter| PnioStatus::connect(blamed::ALARM_CR, parameter);
    let short = wrong(1);
    let mut reader = Reader::new(body);
    let kind = reader.u16().ok_or(short)?;
    let ethertype = reader.u16().ok_or(short)?;
    let properties = reader.u32().ok_or(short)?;
    let timeout_factor = reader.u16().ok_or(short)?;
    let retries = reader.u16().ok_or(short)?;
    let reference = reader.u16().ok_or(short)?;
    let max_len = reader.u16().ok_or(short)?;
    let tag_high = reader.u16().ok_or(short)?;
    let tag_low = reader.u16().ok_or(short)?;
    if kind != 1 {
        return Err(wrong(4));
    }
    if ethertype != ETHERTYPE_PROFINET {
        return Err(wrong(5));
    }
    // Alarms over UDP are not supported.
    if properties & 2 != 0 {
        return Err(wrong(6));
    }
    if !(1..=100).contains(&timeout_factor) {
        return Err(wrong(7));
    }
    if !(3..=15).contains(&retries) {
        return Err(wrong(8));
    }
    if !(200..=1_432).contains(&max_len) {
        return Err(wrong(10));
    }
    if tag_high & !RESERVED_OF_TAG != PRIORITY_6 {
        return Err(wrong(11));
    }
    if tag_low & !RESERVED_OF_TAG != PRIORITY_5 {
        return Err(wrong(12));
    }
    let timeout_us = u64::from(timeout_factor).saturating_mul(100_000);
    let is_low_only = properties & 1 != 0;
    Ok(AlarmCr { is_low_only, timeout_us, retries: retries as u8, reference, tag_high, tag_low })
}
