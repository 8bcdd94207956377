//! DCP (IEC 61158-6-10, 4.3): discovery, naming and addressing of a device. Answers are queued without their contents,
//! which are filled in when they are sent.

use crate::cursor::{Reader, Writer};
use crate::frame::{self, ETHERTYPE_PROFINET, Frame, MacAddress};
use crate::profile::Profile;
use crate::station::{IpParameters, StationName};

/// Destination of Identify requests.
pub(crate) const IDENTIFY_MULTICAST: MacAddress = MacAddress([0x01, 0x0E, 0xCF, 0, 0, 0]);

pub(crate) const GET_SET: u16 = 0xFEFD;
pub(crate) const IDENTIFY: u16 = 0xFEFE;
const IDENTIFY_ANSWER: u16 = 0xFEFF;

mod service {
    pub(super) const GET: u8 = 3;
    pub(super) const SET: u8 = 4;
    pub(super) const IDENTIFY: u8 = 5;
}

const REQUEST: u8 = 0;
const SUCCESS: u8 = 1;

/// Options with their suboptions.
mod option {
    pub(super) const MAC: (u8, u8) = (1, 1);
    pub(super) const IP: (u8, u8) = (1, 2);
    pub(super) const VENDOR: (u8, u8) = (2, 1);
    pub(super) const NAME: (u8, u8) = (2, 2);
    pub(super) const DEVICE_ID: (u8, u8) = (2, 3);
    pub(super) const ROLE: (u8, u8) = (2, 4);
    pub(super) const OPTIONS: (u8, u8) = (2, 5);
    pub(super) const ALIAS: (u8, u8) = (2, 6);
    pub(super) const INSTANCE: (u8, u8) = (2, 7);
    pub(super) const START: (u8, u8) = (5, 1);
    pub(super) const STOP: (u8, u8) = (5, 2);
    pub(super) const SIGNAL: (u8, u8) = (5, 3);
    pub(super) const RESPONSE: (u8, u8) = (5, 4);
    pub(super) const FACTORY_RESET: (u8, u8) = (5, 5);
    pub(super) const RESET: (u8, u8) = (5, 6);
    pub(super) const ALL: (u8, u8) = (0xFF, 0xFF);
}

/// Options in the answer to a request for all options; each can also be requested on its own.
const TOLD: [(u8, u8); 7] = [
    option::NAME,
    option::IP,
    option::DEVICE_ID,
    option::VENDOR,
    option::OPTIONS,
    option::ROLE,
    option::INSTANCE,
];

/// All supported options, for DeviceOptions.
const OPTIONS: [(u8, u8); 13] = [
    option::MAC,
    option::IP,
    option::VENDOR,
    option::NAME,
    option::DEVICE_ID,
    option::ROLE,
    option::OPTIONS,
    option::INSTANCE,
    option::START,
    option::STOP,
    option::SIGNAL,
    option::FACTORY_RESET,
    option::RESET,
];

/// Values of BlockError.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
enum Fault {
    #[default]
    None = 0,
    Option = 1,
    Suboption = 2,
    NotSet = 3,
    NotNow = 6,
}

/// Maximum number of blocks in a request. Further blocks are not answered.
const MAX_BLOCKS: usize = 16;

/// Maximum number of pending answers. Identify answers wait longest: up to 64 s, as the controller requests.
const MAX_ANSWERS: usize = 4;

/// Unit of the response delay of Identify.
const DELAY_UNIT_US: u64 = 10_000;

const MAX_DELAY_FACTOR: u16 = 0x1900;

/// Extent of a reset to factory settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reset {
    /// Resets name and IP parameters.
    Communication,
    /// Resets I&M data as well.
    All,
}

/// Actions requested by a Set request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wishes {
    pub(crate) name: Option<(StationName, bool)>,
    pub(crate) ip: Option<(IpParameters, bool)>,
    pub(crate) signal: bool,
    pub(crate) reset: Option<Reset>,
}

/// A pending answer, without the data that is filled in when it is sent.
#[derive(Clone, Copy, Debug)]
struct Answer {
    to: MacAddress,
    xid: u32,
    due: u64,
    kind: Kind,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Identify,
    Get([(u8, u8); MAX_BLOCKS], usize),
    /// Options to set, with their results.
    Set([((u8, u8), Fault); MAX_BLOCKS], usize),
}

/// The DCP server of a device.
#[derive(Clone, Debug)]
pub(crate) struct Dcp {
    answers: [Option<Answer>; MAX_ANSWERS],
    /// Number of requests without a free place for their answer.
    pub(crate) lost: u32,
}

/// Data for the contents of answers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct About<'a> {
    pub(crate) profile: &'static Profile,
    pub(crate) mac: MacAddress,
    pub(crate) name: &'a StationName,
    pub(crate) ip: &'a IpParameters,
}

impl Dcp {
    pub(crate) const fn new() -> Self {
        Self { answers: [None; MAX_ANSWERS], lost: 0 }
    }

    /// Processes a DCP frame after its frame identifier. If `is_busy`, a controller uses name and address, so
    /// that they cannot be changed.
    pub(crate) fn receive(
        &mut self,
        now: u64,
        frame_id: u16,
        frame: &Frame<'_>,
        payload: &[u8],
        about: &About<'_>,
        is_busy: bool,
    ) -> Option<Wishes> {
        let mut reader = Reader::new(payload);
        let service = reader.u8()?;
        let kind = reader.u8()?;
        let xid = reader.u32()?;
        let delay_factor = reader.u16()?;
        let len = reader.u16()?;
        let blocks = reader.bytes(len.into())?;
        if kind != REQUEST {
            return None;
        }
        match (frame_id, service) {
            // Tools may send Identify to a single station, too.
            (IDENTIFY, service::IDENTIFY) if [IDENTIFY_MULTICAST, about.mac].contains(&frame.destination) => {
                if matches_all(blocks, about)? {
                    let factor = delay_factor.clamp(1, MAX_DELAY_FACTOR);
                    let [.., high, low] = about.mac.0;
                    let slot = u16::from_be_bytes([high, low]).checked_rem(factor).unwrap_or(0);
                    let due = now.saturating_add(DELAY_UNIT_US.saturating_mul(slot.into()));
                    self.answer(Answer { to: frame.source, xid, due, kind: Kind::Identify });
                }
                None
            }
            (GET_SET, service::GET) if frame.destination == about.mac => {
                let mut asked = [(0, 0); MAX_BLOCKS];
                let mut count = 0_usize;
                for (place, pair) in asked.iter_mut().zip(blocks.chunks_exact(2)) {
                    if let [option, suboption] = *pair {
                        *place = (option, suboption);
                        count = count.saturating_add(1);
                    }
                }
                self.answer(Answer { to: frame.source, xid, due: now, kind: Kind::Get(asked, count) });
                None
            }
            (GET_SET, service::SET) if frame.destination == about.mac => {
                let mut wishes = Wishes::default();
                let mut results = [((0, 0), Fault::None); MAX_BLOCKS];
                let mut count = 0_usize;
                let mut blocks = Reader::new(blocks);
                for place in &mut results {
                    let Some((what, data)) = block(&mut blocks) else { break };
                    *place = (what, wish(&mut wishes, what, data, about, is_busy));
                    count = count.saturating_add(1);
                }
                self.answer(Answer { to: frame.source, xid, due: now, kind: Kind::Set(results, count) });
                Some(wishes)
            }
            _ => None,
        }
    }

    fn answer(&mut self, answer: Answer) {
        match self.answers.iter_mut().find(|place| place.is_none()) {
            Some(place) => *place = Some(answer),
            None => self.lost = self.lost.saturating_add(1),
        }
    }

    pub(crate) fn next_due(&self) -> Option<u64> {
        self.answers.iter().flatten().map(|answer| answer.due).min()
    }

    /// Writes an answer that is due. Returns the length of its frame.
    pub(crate) fn transmit(&mut self, now: u64, buffer: &mut [u8], about: &About<'_>) -> Option<usize> {
        let is_due = |place: &&mut Option<Answer>| place.is_some_and(|answer| answer.due <= now);
        let Answer { to, xid, kind, .. } = self.answers.iter_mut().find(is_due)?.take()?;
        let mut writer = Writer::new(buffer);
        frame::header(&mut writer, to, about.mac, None, ETHERTYPE_PROFINET);
        let (frame_id, service) = match kind {
            Kind::Identify => (IDENTIFY_ANSWER, service::IDENTIFY),
            Kind::Get(..) => (GET_SET, service::GET),
            Kind::Set(..) => (GET_SET, service::SET),
        };
        writer.u16(frame_id);
        writer.bytes(&[service, SUCCESS]);
        writer.u32(xid);
        writer.u16(0);
        let length_at = writer.len();
        writer.u16(0);
        match kind {
            Kind::Identify => TOLD.iter().for_each(|what| write_option(&mut writer, *what, about)),
            Kind::Get(asked, count) => {
                for what in asked.iter().take(count) {
                    match what {
                        &option::ALL => TOLD.iter().for_each(|what| write_option(&mut writer, *what, about)),
                        what if TOLD.contains(what) || *what == option::MAC => {
                            write_option(&mut writer, *what, about);
                        }
                        what => result(&mut writer, *what, unknown(*what)),
                    }
                }
            }
            Kind::Set(results, count) => {
                for (what, fault) in results.iter().take(count) {
                    result(&mut writer, *what, *fault);
                }
            }
        }
        let length = writer.len().saturating_sub(length_at).saturating_sub(2);
        writer.put_u16(length_at, length as u16);
        frame::finish(writer)
    }
}

/// Returns the next block: option and suboption, and its data.
fn block<'a>(reader: &mut Reader<'a>) -> Option<((u8, u8), &'a [u8])> {
    let what = (reader.u8()?, reader.u8()?);
    let len = reader.u16()?;
    let data = reader.bytes(len.into())?;
    if len % 2 == 1 {
        // The padding of the last block may be missing.
        let _ = reader.u8();
    }
    Some((what, data))
}

/// Returns whether all filters of a request match this device; `None` if it is invalid.
fn matches_all(blocks: &[u8], about: &About<'_>) -> Option<bool> {
    let mut reader = Reader::new(blocks);
    let mut matches = true;
    while !reader.rest().is_empty() {
        let (what, data) = block(&mut reader)?;
        matches &= match what {
            option::ALL => true,
            option::NAME => data == about.name.as_bytes(),
            // An alias names a port of a neighbour, which this device does not know.
            option::ALIAS => false,
            what => {
                let mut place = [0; 256];
                let mut writer = Writer::new(&mut place);
                value(&mut writer, what, about);
                let len = writer.finish()?;
                len > 0 && place.get(..len) == Some(data)
            }
        };
    }
    Some(matches)
}

fn unknown((option, _): (u8, u8)) -> Fault {
    if matches!(option, 1 | 2 | 5) { Fault::Suboption } else { Fault::Option }
}

/// Records the action that a block requests, if it is possible.
fn wish(wishes: &mut Wishes, what: (u8, u8), data: &[u8], about: &About<'_>, is_busy: bool) -> Fault {
    let Some((qualifier, data)) = data.split_first_chunk::<2>() else { return Fault::NotSet };
    let qualifier = u16::from_be_bytes(*qualifier);
    let is_permanent = qualifier & 1 == 1;
    match what {
        option::NAME => {
            let Some(name) = StationName::from_bytes(data) else { return Fault::NotSet };
            if is_busy && name != *about.name {
                return Fault::NotNow;
            }
            wishes.name = Some((name, is_permanent));
        }
        option::IP => {
            let mut reader = Reader::new(data);
            let parameters = (reader.array(), reader.array(), reader.array());
            let (Some(address), Some(mask), Some(gateway)) = parameters else { return Fault::NotSet };
            let ip = IpParameters { address, mask, gateway };
            if !reader.rest().is_empty() || !ip.are_valid() {
                return Fault::NotSet;
            }
            if is_busy && ip != *about.ip {
                return Fault::NotNow;
            }
            wishes.ip = Some((ip, is_permanent));
        }
        // Start and stop only frame the other blocks.
        option::START | option::STOP => {}
        option::SIGNAL => match data {
            [1, 0] => wishes.signal = true,
            _ => return Fault::NotSet,
        },
        option::FACTORY_RESET => wishes.reset = Some(Reset::All),
        option::RESET => match qualifier >> 1 {
            2 => wishes.reset = Some(Reset::Communication),
            4 | 8 => wishes.reset = Some(Reset::All),
            _ => return Fault::Suboption,
        },
        what if TOLD.contains(&what) || what == option::MAC => return Fault::NotSet,
        what => return unknown(what),
    }
    Fault::None
}

/// Writes the result of a block.
fn result(writer: &mut Writer<'_>, (option, suboption): (u8, u8), fault: Fault) {
    let (control, response) = option::RESPONSE;
    writer.bytes(&[control, response, 0, 3, option, suboption, fault as u8, 0]);
}

/// Writes a block with its BlockInfo.
fn write_option(writer: &mut Writer<'_>, what: (u8, u8), about: &About<'_>) {
    writer.bytes(&[what.0, what.1]);
    let length_at = writer.len();
    writer.u16(0);
    // BlockInfo of IP: whether an address is set.
    writer.u16(if what == option::IP { about.ip.is_set().into() } else { 0 });
    value(writer, what, about);
    let length = writer.len().saturating_sub(length_at).saturating_sub(2);
    writer.put_u16(length_at, length as u16);
    writer.align(length_at, 2);
}

/// Writes the value of an option; nothing for an unknown one.
fn value(writer: &mut Writer<'_>, what: (u8, u8), about: &About<'_>) {
    let About { profile, mac, name, ip } = about;
    match what {
        option::MAC => writer.bytes(&mac.0),
        option::IP => {
            writer.bytes(&ip.address);
            writer.bytes(&ip.mask);
            writer.bytes(&ip.gateway);
        }
        option::VENDOR => writer.bytes(profile.station_type.as_bytes()),
        option::NAME => writer.bytes(name.as_bytes()),
        option::DEVICE_ID => {
            writer.u16(profile.vendor_id);
            writer.u16(profile.device_id);
        }
        // Role: IO device.
        option::ROLE => writer.bytes(&[1, 0]),
        option::OPTIONS => {
            OPTIONS.iter().for_each(|(option, suboption)| writer.bytes(&[*option, *suboption]))
        }
        option::INSTANCE => writer.u16(INSTANCE),
        _ => {}
    }
}

/// Instance number of the device; there is only one per address.
pub(crate) const INSTANCE: u16 = 1;
