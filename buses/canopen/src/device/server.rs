//! The SDO server: what a master reads and writes of the device's objects (CiA 301, 7.2.4).

use super::Device;
use crate::sdo::{self, Request};
use crate::{Abort, Dictionary, Entry, Source};

impl<const R: usize, const T: usize, const Q: usize> Device<R, T, Q> {
    /// Serves an SDO request; whether it wrote a value of the application.
    pub(super) fn answer<D: Dictionary>(
        &mut self,
        now_ms: u32,
        request: &[u8; 8],
        dictionary: &mut D,
    ) -> bool {
        let (index, sub, request) = sdo::parse(request);
        let outcome = match request {
            Request::Aborted => return false,
            Request::Other => Err(Abort::CommandSpecifier),
            Request::Read => self.read(index, sub, dictionary).map(|(len, value)| {
                self.response = Some(sdo::read_response(index, sub, len, value));
                false
            }),
            Request::Write(len, value) => {
                self.write(now_ms, index, sub, len, value, dictionary).inspect(|_| {
                    self.response = Some(sdo::write_response(index, sub));
                })
            }
        };
        outcome.unwrap_or_else(|abort| {
            self.response = Some(sdo::abort_response(index, sub, abort));
            false
        })
    }

    /// The bytes of an entry, low byte first, and how many they are.
    fn read<D: Dictionary>(&self, index: u16, sub: u8, dictionary: &D) -> Result<(u8, u32), Abort> {
        let Entry { kind, source, .. } = dictionary.find(index, sub)?;
        let config = &self.config;
        let time = |times: &[u16; T], number: u8| times.get(usize::from(number)).copied().unwrap_or(0).into();
        let value = match source {
            Source::Fixed(value) => value,
            Source::PlusNode(base) => base | u32::from(config.node),
            Source::ErrorRegister => self.emergency.register(self.profile.faults).into(),
            Source::ConsumerHeartbeat => {
                u32::from(config.master) << 16 | u32::from(dictionary.consumer_time_ms())
            }
            Source::ProducerHeartbeat => config.heartbeat_ms.into(),
            Source::InhibitTime(number) => time(&config.inhibit, number),
            Source::EventTimer(number) => time(&config.event_ms, number),
            Source::Rpdo { number, at } => {
                self.received.get(usize::from(number)).map_or(0, |data| number_at(data, at, kind.len()))
            }
            Source::Tpdo { number, at } => {
                self.tpdos.get(usize::from(number)).map_or(0, |tpdo| number_at(&tpdo.shown, at, kind.len()))
            }
            Source::Application(key) => dictionary.read(key)?,
        };
        Ok((kind.len(), value))
    }

    /// Whether it was a value of the application.
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
        // What a client puts into the bytes that the object does not have means nothing.
        let [low, high, ..] = value.to_le_bytes();
        let number = u16::from_le_bytes([low, high]);
        match entry.source {
            Source::Application(key) => {
                let value = number_at(&value.to_le_bytes(), 0, entry.kind.len());
                return dictionary.write(key, value).map(|()| true);
            }
            Source::ConsumerHeartbeat => {
                let Ok(master @ 1..=127) = u8::try_from(value >> 16) else { return Err(Abort::Value) };
                dictionary.set_consumer_time_ms(number)?;
                if master == self.config.master {
                    // It may fall silent with this request, so it goes on to be watched; its new time begins now.
                    self.heard_at = self.heard_at.map(|_| now_ms);
                } else {
                    self.config.master = master;
                    self.forget_master();
                }
            }
            Source::ProducerHeartbeat => self.config.heartbeat_ms = number,
            Source::InhibitTime(at) => set(&mut self.config.inhibit, at, number),
            Source::EventTimer(at) => set(&mut self.config.event_ms, at, number),
            _ => return Err(Abort::ReadOnly),
        }
        Ok(false)
    }
}

/// The number in these bytes, low byte first.
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
