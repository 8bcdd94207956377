//! SDO server: reads and writes of the device's objects (CiA 301, 7.2.4).

use super::pdo::Setup;
use super::{Device, ErrorBehaviour, Event, NmtState};
use crate::object::NO_REMOTE;
use crate::sdo::{self, Download, Request, Upload};
use crate::{Abort, DataType, Dictionary, Entry, Pdo, Source};

/// COB-ID of a PDO, bit 31: the PDO is disabled.
const DISABLED: u32 = 1 << 31;

impl<const R: usize, const T: usize, const Q: usize> Device<R, T, Q> {
    /// Serves an SDO request. Returns whether it wrote a value of the application.
    pub(super) fn answer<D: Dictionary>(
        &mut self,
        now_ms: u32,
        request: &[u8; 8],
        dictionary: &mut D,
    ) -> bool {
        let (mut index, mut sub, request) = sdo::parse(request);
        let upload = self.upload.take();
        let download = self.download.take();
        if let (Request::Data(data), Some(going), Some((.., toggle))) = (request, download, self.writing)
            && toggle == Some(data.toggle)
        {
            // The client repeats a segment that is being written.
            self.download = Some(going);
            return false;
        }
        // A new request replaces a write in progress, whose response is dropped.
        self.writing = None;
        let outcome = match request {
            Request::Aborted => return false,
            Request::Other => Err(Abort::CommandSpecifier),
            Request::Segment(toggle) => match upload {
                Some(upload) => {
                    self.go_on(upload, toggle);
                    return false;
                }
                None => Err(Abort::CommandSpecifier),
            },
            Request::Read => self.begin_read(index, sub, dictionary).map(|response| {
                self.response = Some(response);
                false
            }),
            Request::Begin(size) => self.begin_download(index, sub, size, dictionary),
            Request::Data(data) => match download {
                Some(download) => {
                    (index, sub) = (download.index, download.sub);
                    self.take_segment(download, &data, dictionary)
                }
                None => Err(Abort::CommandSpecifier),
            },
            Request::Write(len, value) => {
                self.write(now_ms, index, sub, len, value, dictionary).inspect(|_| {
                    self.writing = Some((index, sub, None));
                    self.confirm(dictionary);
                })
            }
        };
        outcome.unwrap_or_else(|abort| {
            self.response = Some(sdo::abort_response(index, sub, abort));
            false
        })
    }

    /// Responds to a write in progress as soon as it has ended.
    pub(super) fn confirm<D: Dictionary>(&mut self, dictionary: &D) {
        let Some((index, sub, toggle)) = self.writing else { return };
        let outcome = match dictionary.find(index, sub) {
            Ok(Entry { source: Source::Application(key), .. }) => dictionary.outcome(key),
            _ => Some(Ok(())),
        };
        let Some(outcome) = outcome else { return };
        self.writing = None;
        self.response = Some(match outcome {
            Ok(()) => toggle.map_or_else(|| sdo::write_response(index, sub), sdo::segment_response),
            Err(abort) => {
                self.download = None;
                sdo::abort_response(index, sub, abort)
            }
        });
    }

    /// Starts a segmented download.
    fn begin_download<D: Dictionary>(
        &mut self,
        index: u16,
        sub: u8,
        size: Option<u32>,
        dictionary: &mut D,
    ) -> Result<bool, Abort> {
        let entry = dictionary.find(index, sub)?;
        let Entry { kind: DataType::Domain, writable: true, source: Source::Application(key), .. } = entry
        else {
            return Err(if entry.writable { Abort::CommandSpecifier } else { Abort::ReadOnly });
        };
        dictionary.begin_domain(key, size)?;
        self.download = Some(Download { index, sub, toggle: false });
        self.writing = Some((index, sub, None));
        self.confirm(dictionary);
        Ok(false)
    }

    /// Passes a segment to the application. Returns whether it ends the download.
    fn take_segment<D: Dictionary>(
        &mut self,
        download: Download,
        data: &sdo::Data,
        dictionary: &mut D,
    ) -> Result<bool, Abort> {
        let Download { index, sub, toggle } = download;
        if data.toggle != toggle {
            return Err(Abort::Toggle);
        }
        let Entry { source: Source::Application(key), .. } = dictionary.find(index, sub)? else {
            return Err(Abort::NoObject);
        };
        dictionary.write_domain(key, data.bytes(), data.is_last)?;
        self.download = (!data.is_last).then_some(Download { toggle: !toggle, ..download });
        self.writing = Some((index, sub, Some(toggle)));
        self.confirm(dictionary);
        Ok(data.is_last)
    }

    /// Sends the next segment of a text.
    fn go_on(&mut self, mut upload: Upload, toggle: bool) {
        match upload.next(toggle) {
            Ok((response, goes_on)) => {
                self.response = Some(response);
                self.upload = goes_on.then_some(upload);
            }
            Err(abort) => self.response = Some(abort),
        }
    }

    fn begin_read<D: Dictionary>(&mut self, index: u16, sub: u8, dictionary: &D) -> Result<[u8; 8], Abort> {
        let entry = dictionary.find(index, sub)?;
        if entry.kind == DataType::Domain {
            return Err(Abort::WriteOnly);
        }
        if let Entry { kind: DataType::Text, source: Source::Application(key), .. } = entry {
            let (upload, response) = Upload::begin(index, sub, dictionary.text(key)?);
            self.upload = Some(upload);
            return Ok(response);
        }
        let value = self.read(entry, dictionary)?;
        Ok(sdo::read_response(index, sub, entry.kind.len(), value))
    }

    /// Returns the numeric value of an entry.
    fn read<D: Dictionary>(&self, entry: Entry<D::Key>, dictionary: &D) -> Result<u32, Abort> {
        let Entry { kind, source, .. } = entry;
        let config = &self.config;
        let time = |times: &[u16; T], number: u8| times.get(usize::from(number)).copied().unwrap_or(0).into();
        Ok(match source {
            Source::Fixed(value) | Source::Mapping(value) => value,
            Source::PlusNode(base) => base | u32::from(config.node),
            Source::ErrorRegister => self.emergency.register(self.profile.faults).into(),
            Source::ErrorCount => self.emergency.count().into(),
            Source::PastError(number) => self.emergency.past(number).ok_or(Abort::NoData)?,
            Source::EmergencyInhibitTime => config.emergency_inhibit.into(),
            Source::ErrorBehaviour => self.error_behaviour as u32,
            Source::ConsumerHeartbeat if !self.watches_heartbeat => 0,
            Source::ConsumerHeartbeat => {
                u32::from(config.master) << 16 | u32::from(dictionary.consumer_time_ms())
            }
            Source::ProducerHeartbeat => config.heartbeat_ms.into(),
            Source::CobId(pdo) => {
                let disabled = if self.setup(pdo)?.is_enabled { 0 } else { DISABLED };
                self.cob_id(pdo) | disabled
            }
            Source::TransmissionType(pdo) => self.setup(pdo)?.transmission.into(),
            Source::Mapped(pdo, count) => {
                if self.setup(pdo)?.is_mapped {
                    count.into()
                } else {
                    0
                }
            }
            Source::InhibitTime(number) => time(&config.inhibit, number),
            Source::EventTimer(number) => time(&config.event_ms, number),
            Source::Rpdo { number, at } => {
                self.rpdos.get(usize::from(number)).map_or(0, |rpdo| number_at(&rpdo.taken, at, kind.len()))
            }
            Source::Tpdo { number, at } => {
                self.tpdos.get(usize::from(number)).map_or(0, |tpdo| number_at(&tpdo.shown, at, kind.len()))
            }
            Source::Application(key) => dictionary.read(key)?,
        })
    }

    /// Returns the COB-ID of a PDO while enabled.
    fn cob_id(&self, pdo: Pdo) -> u32 {
        pdo.base_cob_id() | u32::from(self.config.node)
    }

    fn setup(&self, pdo: Pdo) -> Result<Setup, Abort> {
        let setup = match pdo {
            Pdo::Receive(number) => self.rpdos.get(usize::from(number)).map(|rpdo| rpdo.setup),
            Pdo::Transmit(number) => self.tpdos.get(usize::from(number)).map(|tpdo| tpdo.setup),
        };
        setup.ok_or(Abort::NoObject)
    }

    /// Applies new parameters and resets the PDO.
    fn set_up(&mut self, pdo: Pdo, setup: Setup) {
        match pdo {
            Pdo::Receive(number) => {
                let Some(rpdo) = self.rpdos.get_mut(usize::from(number)) else { return };
                let is_lost = rpdo.setup.is_enabled && !setup.is_enabled;
                (rpdo.setup, rpdo.waiting) = (setup, None);
                if is_lost && self.state == NmtState::Operational {
                    self.push(Event::Left { master_silent: false });
                    if !self.has_heartbeat {
                        // The master may have stopped sending RPDOs. Without a heartbeat, monitoring
                        // pauses until the next one.
                        self.received_at = None;
                    }
                }
            }
            Pdo::Transmit(number) => {
                let Some(tpdo) = self.tpdos.get_mut(usize::from(number)) else { return };
                tpdo.setup = setup;
                tpdo.send_again();
            }
        }
    }

    fn write_cob_id(&mut self, pdo: Pdo, value: u32) -> Result<(), Abort> {
        let (wanted, setup) = (value & !DISABLED, self.setup(pdo)?);
        let is_own = match pdo {
            Pdo::Receive(_) => wanted & !NO_REMOTE == self.cob_id(pdo),
            Pdo::Transmit(_) => wanted == self.cob_id(pdo),
        };
        if !is_own {
            return Err(Abort::Value);
        }
        let is_enabled = value & DISABLED == 0;
        if is_enabled && !setup.is_mapped {
            return Err(Abort::DeviceState);
        }
        if is_enabled != setup.is_enabled {
            self.set_up(pdo, Setup { is_enabled, ..setup });
        }
        Ok(())
    }

    fn write_transmission_type(&mut self, pdo: Pdo, transmission: u8) -> Result<(), Abort> {
        let setup = self.setup(pdo)?;
        if !Setup::has(transmission) {
            return Err(Abort::Value);
        }
        if transmission != setup.transmission {
            self.set_up(pdo, Setup { transmission, ..setup });
        }
        Ok(())
    }

    /// The mapping is fixed. A master may clear it and then write the same mapping again.
    fn write_mapped(&mut self, pdo: Pdo, count: u8, wanted: u8) -> Result<(), Abort> {
        let setup = self.setup(pdo)?;
        if wanted != 0 && wanted != count {
            return Err(Abort::Value);
        }
        let is_mapped = wanted != 0;
        if is_mapped != setup.is_mapped {
            if setup.is_enabled {
                return Err(Abort::DeviceState);
            }
            self.set_up(pdo, Setup { is_mapped, ..setup });
        }
        Ok(())
    }

    fn write_inhibit_time(&mut self, number: u8, time: u16) -> Result<(), Abort> {
        let setup = self.setup(Pdo::Transmit(number))?;
        let Some(place) = self.config.inhibit.get_mut(usize::from(number)) else {
            return Err(Abort::NoObject);
        };
        if setup.is_enabled && *place != time {
            return Err(Abort::DeviceState);
        }
        *place = time;
        Ok(())
    }

    /// Writes 1016h, 1: bits 16 to 23 are the master's node-ID, the lower 16 bits the time-out in milliseconds. If
    /// either is 0, the heartbeat is not monitored, but RPDOs still are, with the application's time-out.
    fn write_consumer<D: Dictionary>(
        &mut self,
        now_ms: u32,
        value: u32,
        dictionary: &mut D,
    ) -> Result<(), Abort> {
        let [low, high, master, reserved] = value.to_le_bytes();
        let time_ms = u16::from_le_bytes([low, high]);
        if master > 127 || reserved != 0 {
            return Err(Abort::Value);
        }
        let watches = master != 0 && time_ms != 0;
        if watches {
            dictionary.set_consumer_time_ms(time_ms)?;
        }
        if !watches || master == self.config.master {
            // Monitoring continues in case this is the master's last frame; the new time-out starts now.
            self.received_at = self.received_at.map(|_| now_ms);
            self.has_heartbeat &= watches;
        } else {
            self.config.master = master;
            self.forget_master();
        }
        self.watches_heartbeat = watches;
        Ok(())
    }

    /// Writes an entry. Returns whether it is a value of the application.
    fn write<D: Dictionary>(
        &mut self,
        now_ms: u32,
        index: u16,
        sub: u8,
        len: Option<u8>,
        value: u32,
        dictionary: &mut D,
    ) -> Result<bool, Abort> {
        let entry = dictionary.find(index, sub)?;
        if !entry.writable {
            return Err(Abort::ReadOnly);
        }
        if len.is_some_and(|len| len != entry.kind.len()) {
            return Err(Abort::Length);
        }
        // Ignores data bytes past the object's length.
        let value = number_at(&value.to_le_bytes(), 0, entry.kind.len());
        let number = value as u16;
        match entry.source {
            Source::Application(key) => return dictionary.write(key, value).map(|()| true),
            Source::ConsumerHeartbeat => self.write_consumer(now_ms, value, dictionary)?,
            Source::ProducerHeartbeat => self.config.heartbeat_ms = number,
            Source::ErrorCount if value == 0 => self.emergency.forget_past(),
            Source::ErrorCount => return Err(Abort::Value),
            Source::EmergencyInhibitTime => self.config.emergency_inhibit = number,
            Source::ErrorBehaviour => {
                self.error_behaviour = match value {
                    0 => ErrorBehaviour::PreOperational,
                    1 => ErrorBehaviour::NoChange,
                    2 => ErrorBehaviour::Stopped,
                    _ => return Err(Abort::Value),
                };
            }
            Source::CobId(pdo) => self.write_cob_id(pdo, value)?,
            Source::TransmissionType(pdo) => self.write_transmission_type(pdo, value as u8)?,
            Source::Mapped(pdo, count) => self.write_mapped(pdo, count, value as u8)?,
            Source::InhibitTime(at) => self.write_inhibit_time(at, number)?,
            Source::EventTimer(at) => set(&mut self.config.event_ms, at, number),
            Source::Mapping(_) if self.read(entry, dictionary)? != value => return Err(Abort::Mapping),
            Source::Rpdo { .. } if self.read(entry, dictionary)? != value => return Err(Abort::LocalControl),
            Source::Fixed(_) | Source::PlusNode(_) if self.read(entry, dictionary)? != value => {
                return Err(Abort::Value);
            }
            Source::Mapping(_) | Source::Rpdo { .. } | Source::Fixed(_) | Source::PlusNode(_) => {}
            Source::ErrorRegister | Source::PastError(_) | Source::Tpdo { .. } => {
                return Err(Abort::ReadOnly);
            }
        }
        Ok(false)
    }
}

/// Returns the number in `len` bytes from `at`, low byte first.
fn number_at(bytes: &[u8], at: u8, len: u8) -> u32 {
    let mut number = [0; 4];
    let taken = bytes.iter().skip(at.into()).take(len.into());
    for (place, byte) in number.iter_mut().zip(taken) {
        *place = *byte;
    }
    u32::from_le_bytes(number)
}

fn set<const T: usize>(times: &mut [u16; T], number: u8, time: u16) {
    if let Some(place) = times.get_mut(usize::from(number)) {
        *place = time;
    }
}
