//! The SDO server: what a master reads and writes of the device's objects (CiA 301, 7.2.4).

use bus_modbus::rtu;

use super::Node;
use super::objects::{Subject, find, with_node};
use super::sdo::{self, Abort, Request};
use crate::plc::View;
use crate::registers::{RegisterError, Settings};

impl Node {
    /// Serves an SDO request; whether it changed a setting.
    pub(super) fn answer(&mut self, request: &[u8; 8], view: &mut View<'_>) -> bool {
        let (index, sub, request) = sdo::parse(request);
        let outcome = match request {
            Request::Aborted => return false,
            Request::Other => Err(Abort::CommandSpecifier),
            Request::Read => self.read(index, sub, view).map(|(len, value)| {
                self.response = Some(sdo::read_response(index, sub, len, value));
                false
            }),
            Request::Write(len, value) => self.write(index, sub, len, value, view).inspect(|_| {
                self.response = Some(sdo::write_response(index, sub));
            }),
        };
        outcome.unwrap_or_else(|abort| {
            self.response = Some(sdo::abort_response(index, sub, abort));
            false
        })
    }

    /// The bytes of an object, low byte first, and how many they are.
    fn read(&self, index: u16, sub: u8, view: &View<'_>) -> Result<(u8, u32), Abort> {
        let found = find(index, sub)?;
        let Self { config, shown, .. } = self;
        let signed = |value: i16| u32::from(value.cast_unsigned());
        let value = match found.subject {
            Subject::Fixed(value) => value,
            Subject::PlusNode(base) => with_node(base, config),
            Subject::ErrorRegister => self.emergency.register().into(),
            Subject::Consumer => u32::from(config.master) << 16 | view.settings.timeout_ms(),
            Subject::Heartbeat => config.heartbeat_ms.into(),
            Subject::Inhibit(number) => config.inhibit.get(usize::from(number)).copied().unwrap_or(0).into(),
            Subject::Event(number) => config.event_ms.get(usize::from(number)).copied().unwrap_or(0).into(),
            Subject::Output(at) => match at {
                0 => self.output.flags.bits().into(),
                1 => self.output.user.into(),
                2 => signed(self.output.width),
                4 => self.output.speed.into(),
                _ => signed(self.output.force_limit),
            },
            Subject::State => shown.state.bits().into(),
            Subject::User => shown.user.into(),
            Subject::System => shown.system.bits(),
            Subject::Width => signed(shown.width),
            Subject::Force => signed(shown.force),
            Subject::Status => shown.status.code().into(),
            Subject::Setting(number) => view.setting(number).map_err(abort_of)?.into(),
            Subject::Report(number) => {
                view.report(number, rtu::Counters::default()).map_err(abort_of)?.into()
            }
            subject => self.report.number(subject),
        };
        Ok((found.kind.len(), value))
    }

    /// Whether a setting was changed.
    fn write(
        &mut self,
        index: u16,
        sub: u8,
        len: Option<u8>,
        value: u32,
        view: &mut View<'_>,
    ) -> Result<bool, Abort> {
        let found = find(index, sub)?;
        if !found.writable {
            return Err(Abort::ReadOnly);
        }
        if len.is_some_and(|len| len != found.kind.len()) {
            return Err(Abort::Length);
        }
        // What a client puts into the bytes that the object does not have means nothing.
        let [low, high, ..] = value.to_le_bytes();
        let number = u16::from_le_bytes([low, high]);
        match found.subject {
            Subject::Setting(at) => return write_setting(view, at, number).map(|()| true),
            Subject::Consumer => {
                let (master, time) = (value >> 16, number);
                let Ok(master @ 1..=127) = u8::try_from(master) else { return Err(Abort::Value) };
                write_setting(view, TIMEOUT_SETTING, time)?;
                self.config.master = master;
                self.forget_master();
            }
            Subject::Heartbeat => self.config.heartbeat_ms = number,
            Subject::Inhibit(at) => set(&mut self.config.inhibit, at, number),
            Subject::Event(at) => set(&mut self.config.event_ms, at, number),
            _ => return Err(Abort::ReadOnly),
        }
        Ok(false)
    }
}

/// BUS_TIMEOUT among the settings.
const TIMEOUT_SETTING: u16 = Settings::TIMEOUT;

fn write_setting(view: &mut View<'_>, at: u16, number: u16) -> Result<(), Abort> {
    view.write_settings(at, [number].into_iter()).map_err(abort_of)
}

fn set(values: &mut [u16; 2], at: u8, number: u16) {
    if let Some(value) = values.get_mut(usize::from(at)) {
        *value = number;
    }
}

/// The abort that says so.
const fn abort_of(error: RegisterError) -> Abort {
    match error {
        RegisterError::Missing => Abort::NoSubindex,
        RegisterError::Value => Abort::Value,
        RegisterError::Moving => Abort::DeviceState,
    }
}
