//! Object dictionary: one table for the server, the EDS file and the documents.

use bus_canopen::{Abort, DataType, Dictionary, Entry, Pdo, Source, entries, find};

use crate::can::BusReport;
use crate::plc::side::BoardId;
use crate::plc::{REPORTS, SETTINGS, Settings, View};
use crate::register::{BusCounts, RegisterError, SaveState, StoreCommand, UpdateCommand, UpdateRefusal};
use crate::update::Master;

/// A value of the bridge in the dictionary: bus state, setting or report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key(Value);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Value {
    DeviceName,
    HardwareVersion,
    SoftwareVersion,
    SerialNumber,
    BusStatus,
    TransmitErrors,
    ReceiveErrors,
    BusOffs,
    Overruns,
    Refused,
    FramesDropped,
    FramesMiscut,
    FramesExpired,
    LinkBroken,
    /// A store command, which is written as a signature.
    Store(StoreCommand),
    /// The image of an update.
    Image,
    /// Program control of an update.
    Program,
    /// Index of a setting.
    Setting(u16),
    /// Index of a report.
    Report(u16),
}

/// An object of the dictionary, or an entry of an object.
pub type Object = bus_canopen::Object<Key>;

/// Record of the settings. Entry n is holding register 99 + n of `docs/registers.md`.
pub const SETTINGS_INDEX: u16 = 0x2100;
/// Record of the reports. Entry n is input register 99 + n of `docs/registers.md`.
pub const REPORTS_INDEX: u16 = 0x2101;
/// Record of the output image.
pub const OUTPUT_INDEX: u16 = 0x2000;
/// Record of the input image.
pub const INPUT_INDEX: u16 = 0x2001;

/// Device name (1008h).
pub(super) const DEVICE_NAME: &str = "WSG gripper bridge";
/// Software version (100Ah).
pub(super) const SOFTWARE_VERSION: &str = env!("CARGO_PKG_VERSION");

const REVISION: u32 = 1 << 16;

/// Name of subindex 0 of a record.
pub(super) const COUNT: &str = "Number of entries";

/// Objects 1000h to 2002h. The subsequent settings and reports have tables of their own.
pub const OBJECTS: [Object; 89] = {
    use DataType::{Domain, I16, Text, U8, U16, U32};
    use Pdo::{Receive, Transmit};
    use Source as S;
    use Value as V;
    const ERRORS: &str = "Pre-defined error field";
    const BEHAVIOUR: &str = "Error behaviour";
    const RPDO: &str = "RPDO1 communication";
    const RPDO_MAP: &str = "RPDO1 mapping";
    const TPDO1: &str = "TPDO1 communication";
    const TPDO1_MAP: &str = "TPDO1 mapping";
    const TPDO2: &str = "TPDO2 communication";
    const TPDO2_MAP: &str = "TPDO2 mapping";
    const IDENTITY: &str = "Identity";
    const OUTPUT: &str = "Output image";
    const INPUT: &str = "Input image";
    const BUS: &str = "CAN";
    const STORE: &str = "Store parameters";
    const RESTORE: &str = "Restore default parameters";
    const DATA: &str = "Program data";
    const CONTROL: &str = "Program control";
    /// Field of RPDO1 at this byte offset.
    const fn received(at: u8) -> Source<Key> {
        Source::Rpdo { number: 0, at }
    }
    /// Field of TPDO1 at this byte offset.
    const fn state(at: u8) -> Source<Key> {
        Source::Tpdo { number: 0, at }
    }
    /// Field of TPDO2 at this byte offset.
    const fn measured(at: u8) -> Source<Key> {
        Source::Tpdo { number: 1, at }
    }
    const fn own(value: Value) -> Source<Key> {
        Source::Application(Key(value))
    }
    const fn map(index: u16, sub: u8, kind: DataType) -> Source<Key> {
        Source::Mapping(((index as u32) << 16) | ((sub as u32) << 8) | (kind.len() as u32 * 8))
    }
    const fn ro(
        index: u16,
        sub: u8,
        kind: DataType,
        source: Source<Key>,
        record: &'static str,
        name: &'static str,
    ) -> Object {
        Object { index, sub, kind, writable: false, mappable: false, name, record, source }
    }
    const fn rw(
        index: u16,
        sub: u8,
        kind: DataType,
        source: Source<Key>,
        record: &'static str,
        name: &'static str,
    ) -> Object {
        Object { writable: true, ..ro(index, sub, kind, source, record, name) }
    }
    const fn field(index: u16, sub: u8, kind: DataType, source: Source<Key>, name: &'static str) -> Object {
        let (record, writable) = if index == OUTPUT_INDEX { (OUTPUT, true) } else { (INPUT, false) };
        Object { mappable: true, writable, ..ro(index, sub, kind, source, record, name) }
    }
    const fn error(sub: u8, name: &'static str) -> Object {
        ro(0x1003, sub, DataType::U32, Source::PastError(sub.wrapping_sub(1)), ERRORS, name)
    }
    [
        ro(0x1000, 0, U32, S::Fixed(0), "", "Device type"),
        ro(0x1001, 0, U8, S::ErrorRegister, "", "Error register"),
        rw(0x1003, 0, U8, S::ErrorCount, ERRORS, COUNT),
        error(1, "Latest error: code, ERROR_CAUSE in bits 16 to 23"),
        error(2, "2nd latest error"),
        error(3, "3rd latest error"),
        error(4, "4th latest error"),
        error(5, "5th latest error"),
        error(6, "6th latest error"),
        error(7, "7th latest error"),
        error(8, "8th latest error"),
        rw(0x1005, 0, U32, S::Fixed(0x80), "", "COB-ID SYNC"),
        ro(0x1008, 0, Text, own(V::DeviceName), "", "Manufacturer device name"),
        ro(0x1009, 0, Text, own(V::HardwareVersion), "", "Manufacturer hardware version"),
        ro(0x100A, 0, Text, own(V::SoftwareVersion), "", "Manufacturer software version"),
        ro(0x1010, 0, U8, S::Fixed(1), STORE, COUNT),
        rw(0x1010, 1, U32, own(V::Store(StoreCommand::Save)), STORE, "All settings (2100h): \"save\""),
        ro(0x1011, 0, U8, S::Fixed(1), RESTORE, COUNT),
        rw(0x1011, 1, U32, own(V::Store(StoreCommand::Defaults)), RESTORE, "All settings (2100h): \"load\""),
        rw(0x1014, 0, U32, S::PlusNode(0x80), "", "COB-ID EMCY"),
        rw(0x1015, 0, U16, S::EmergencyInhibitTime, "", "Inhibit time EMCY in 100 us"),
        ro(0x1016, 0, U8, S::Fixed(1), "Consumer heartbeat time", COUNT),
        rw(
            0x1016,
            1,
            U32,
            S::ConsumerHeartbeat,
            "Consumer heartbeat time",
            "Master (bits 16 to 22) and time in ms",
        ),
        rw(0x1017, 0, U16, S::ProducerHeartbeat, "", "Producer heartbeat time in ms"),
        ro(0x1018, 0, U8, S::Fixed(4), IDENTITY, COUNT),
        ro(0x1018, 1, U32, S::Fixed(0), IDENTITY, "Vendor-ID (none assigned)"),
        ro(0x1018, 2, U32, S::Fixed(1), IDENTITY, "Product code"),
        ro(0x1018, 3, U32, S::Fixed(REVISION), IDENTITY, "Revision number"),
        ro(0x1018, 4, U32, own(V::SerialNumber), IDENTITY, "Serial number"),
        ro(0x1029, 0, U8, S::Fixed(1), BEHAVIOUR, COUNT),
        rw(0x1029, 1, U8, S::ErrorBehaviour, BEHAVIOUR, "Communication error"),
        ro(0x1200, 0, U8, S::Fixed(2), "SDO server", COUNT),
        ro(0x1200, 1, U32, S::PlusNode(0x600), "SDO server", "COB-ID client to server"),
        ro(0x1200, 2, U32, S::PlusNode(0x580), "SDO server", "COB-ID server to client"),
        ro(0x1400, 0, U8, S::Fixed(2), RPDO, COUNT),
        rw(0x1400, 1, U32, S::CobId(Receive(0)), RPDO, "COB-ID"),
        rw(0x1400, 2, U8, S::TransmissionType(Receive(0)), RPDO, "Transmission type"),
        rw(0x1600, 0, U8, S::Mapped(Receive(0), 5), RPDO_MAP, COUNT),
        rw(0x1600, 1, U32, map(OUTPUT_INDEX, 1, U8), RPDO_MAP, "CMDFLAGS"),
        rw(0x1600, 2, U32, map(OUTPUT_INDEX, 2, U8), RPDO_MAP, "IF"),
        rw(0x1600, 3, U32, map(OUTPUT_INDEX, 3, I16), RPDO_MAP, "WIDTH"),
        rw(0x1600, 4, U32, map(OUTPUT_INDEX, 4, U16), RPDO_MAP, "SPEED"),
        rw(0x1600, 5, U32, map(OUTPUT_INDEX, 5, I16), RPDO_MAP, "FORCELIMIT"),
        ro(0x1800, 0, U8, S::Fixed(5), TPDO1, COUNT),
        rw(0x1800, 1, U32, S::CobId(Transmit(0)), TPDO1, "COB-ID"),
        rw(0x1800, 2, U8, S::TransmissionType(Transmit(0)), TPDO1, "Transmission type"),
        rw(0x1800, 3, U16, S::InhibitTime(0), TPDO1, "Inhibit time in 100 us"),
        rw(0x1800, 5, U16, S::EventTimer(0), TPDO1, "Event timer in ms"),
        ro(0x1801, 0, U8, S::Fixed(5), TPDO2, COUNT),
        rw(0x1801, 1, U32, S::CobId(Transmit(1)), TPDO2, "COB-ID"),
        rw(0x1801, 2, U8, S::TransmissionType(Transmit(1)), TPDO2, "Transmission type"),
        rw(0x1801, 3, U16, S::InhibitTime(1), TPDO2, "Inhibit time in 100 us"),
        rw(0x1801, 5, U16, S::EventTimer(1), TPDO2, "Event timer in ms"),
        rw(0x1A00, 0, U8, S::Mapped(Transmit(0), 4), TPDO1_MAP, COUNT),
        rw(0x1A00, 1, U32, map(INPUT_INDEX, 1, U8), TPDO1_MAP, "GSTATE"),
        rw(0x1A00, 2, U32, map(INPUT_INDEX, 2, U8), TPDO1_MAP, "OF"),
        rw(0x1A00, 3, U32, map(INPUT_INDEX, 3, U32), TPDO1_MAP, "SYSSTATE"),
        rw(0x1A00, 4, U32, map(INPUT_INDEX, 6, U16), TPDO1_MAP, "Status Code"),
        rw(0x1A01, 0, U8, S::Mapped(Transmit(1), 2), TPDO2_MAP, COUNT),
        rw(0x1A01, 1, U32, map(INPUT_INDEX, 4, I16), TPDO2_MAP, "WIDTH"),
        rw(0x1A01, 2, U32, map(INPUT_INDEX, 5, I16), TPDO2_MAP, "Gripping Force"),
        ro(0x1F50, 0, U8, S::Fixed(1), DATA, COUNT),
        rw(0x1F50, 1, Domain, own(V::Image), DATA, "Image and signature for an update"),
        ro(0x1F51, 0, U8, S::Fixed(1), CONTROL, COUNT),
        rw(0x1F51, 1, U8, own(V::Program), CONTROL, "Write 0 or 3: none; 1: restart with the image"),
        ro(OUTPUT_INDEX, 0, U8, S::Fixed(5), OUTPUT, COUNT),
        field(OUTPUT_INDEX, 1, U8, received(0), "CMDFLAGS"),
        field(OUTPUT_INDEX, 2, U8, received(1), "IF"),
        field(OUTPUT_INDEX, 3, I16, received(2), "WIDTH"),
        field(OUTPUT_INDEX, 4, U16, received(4), "SPEED"),
        field(OUTPUT_INDEX, 5, I16, received(6), "FORCELIMIT"),
        ro(INPUT_INDEX, 0, U8, S::Fixed(6), INPUT, COUNT),
        field(INPUT_INDEX, 1, U8, state(0), "GSTATE"),
        field(INPUT_INDEX, 2, U8, state(1), "OF"),
        field(INPUT_INDEX, 3, U32, state(2), "SYSSTATE"),
        field(INPUT_INDEX, 4, I16, measured(0), "WIDTH"),
        field(INPUT_INDEX, 5, I16, measured(2), "Gripping Force"),
        field(INPUT_INDEX, 6, U16, state(6), "Status Code"),
        ro(0x2002, 0, U8, S::Fixed(10), BUS, COUNT),
        ro(0x2002, 1, U8, own(V::BusStatus), BUS, "0 on, 1 off, 2 recovering, 3 given up; 80h: passive"),
        ro(0x2002, 2, U8, own(V::TransmitErrors), BUS, "Transmit error counter"),
        ro(0x2002, 3, U8, own(V::ReceiveErrors), BUS, "Receive error counter"),
        ro(0x2002, 4, U16, own(V::BusOffs), BUS, "Transitions to bus-off"),
        ro(0x2002, 5, U16, own(V::Overruns), BUS, "Frames lost by the controller"),
        ro(0x2002, 6, U16, own(V::Refused), BUS, "Frames refused by the controller"),
        ro(0x2002, 7, U16, own(V::FramesDropped), BUS, "Gripper: frames outside of intact messages"),
        ro(0x2002, 8, U16, own(V::FramesMiscut), BUS, "Gripper: messages split incorrectly"),
        ro(0x2002, 9, U16, own(V::FramesExpired), BUS, "Gripper: incomplete messages"),
        ro(0x2002, 10, U16, own(V::LinkBroken), BUS, "To the gripper: messages sent only in part"),
    ]
};

/// Number of settings and reports, without subindex 0.
const SETTINGS_COUNT: u8 = SETTINGS.len() as u8;
const REPORTS_COUNT: u8 = REPORTS.len() as u8;
const _: () = assert!(SETTINGS.len() < 255 && REPORTS.len() < 255);

/// Entries of the table that the server needs.
const ENTRIES: [Entry<Key>; OBJECTS.len()] = entries(&OBJECTS);

/// Returns the source of the setting with this subindex, counted from 1.
pub(super) const fn setting(sub: u8) -> Source<Key> {
    Source::Application(Key(Value::Setting((sub as u16).wrapping_sub(1))))
}

/// Returns the source of the report with this subindex, counted from 1.
pub(super) const fn report(sub: u8) -> Source<Key> {
    Source::Application(Key(Value::Report((sub as u16).wrapping_sub(1))))
}

/// The bridge's objects for SDO, during one turn.
pub(super) struct Objects<'a, 'v> {
    pub(super) view: &'a mut View<'v>,
    pub(super) report: &'a BusReport,
    pub(super) board: BoardId,
}

impl Dictionary for Objects<'_, '_> {
    type Key = Key;

    fn find(&self, index: u16, sub: u8) -> Result<Entry<Key>, Abort> {
        let record = |count: u8, writable: bool, source: Source<Key>| match sub {
            0 => {
                let source = Source::Fixed(count.into());
                Ok(Entry { index, sub, kind: DataType::U8, writable: false, source })
            }
            sub if sub <= count => Ok(Entry { index, sub, kind: DataType::U16, writable, source }),
            _ => Err(Abort::NoSubindex),
        };
        match index {
            SETTINGS_INDEX => record(SETTINGS_COUNT, true, setting(sub)),
            REPORTS_INDEX => record(REPORTS_COUNT, false, report(sub)),
            _ => find(&ENTRIES, index, sub),
        }
    }

    fn read(&self, Key(value): Key) -> Result<u32, Abort> {
        match value {
            Value::Setting(number) => self.view.setting(number).map(u32::from).map_err(abort_of),
            Value::Report(number) => {
                self.view.report(number, BusCounts::default()).map(u32::from).map_err(abort_of)
            }
            Value::SerialNumber => Ok(self.board.serial),
            // Bit 0: saves on command, not autonomously. The program runs.
            Value::Store(_) | Value::Program => Ok(1),
            _ => Ok(bus_value(self.report, value)),
        }
    }

    fn text(&self, Key(value): Key) -> Result<&'static str, Abort> {
        match value {
            Value::DeviceName => Ok(DEVICE_NAME),
            Value::HardwareVersion => Ok(self.board.name),
            Value::SoftwareVersion => Ok(SOFTWARE_VERSION),
            _ => Err(Abort::NoData),
        }
    }

    fn write(&mut self, Key(value): Key, number: u32) -> Result<(), Abort> {
        match value {
            Value::Setting(at) => self.write_setting(at, number as u16),
            // CiA 301 requires this abort for a wrong signature.
            Value::Store(command) if number != signature(command) => Err(Abort::Store),
            Value::Store(command) => self.view.command_store(command).map_err(abort_of),
            Value::Program => match number {
                // The program runs during the transfer, which erases slot B itself.
                STOP_PROGRAM | CLEAR_PROGRAM => Ok(()),
                START_PROGRAM => {
                    self.view.command_update(Master::Bus, UpdateCommand::Restart).map_err(abort_of_update)
                }
                _ => Err(Abort::Value),
            },
            _ => Err(Abort::ReadOnly),
        }
    }

    fn begin_domain(&mut self, _: Key, _: Option<u32>) -> Result<(), Abort> {
        self.view.write_image(Master::Bus, 0, &[]).map_err(abort_of_update)
    }

    fn write_domain(&mut self, _: Key, bytes: &[u8], is_last: bool) -> Result<(), Abort> {
        let at = self.view.facts.update.next();
        self.view.write_image(Master::Bus, at, bytes).map_err(abort_of_update)?;
        if !is_last {
            return Ok(());
        }
        self.view.command_update(Master::Bus, UpdateCommand::Check).map_err(abort_of_update)
    }

    fn outcome(&self, Key(value): Key) -> Option<Result<(), Abort>> {
        match (value, self.view.save_state()) {
            (Value::Store(_), SaveState::Saving) => None,
            (Value::Store(_), SaveState::Failed) => Some(Err(Abort::Hardware)),
            (Value::Image, _) => self.view.facts.update.outcome().map(|done| done.map_err(abort_of_update)),
            _ => Some(Ok(())),
        }
    }

    fn consumer_time_ms(&self) -> u16 {
        self.view.settings.timeout_ms() as u16
    }

    fn set_consumer_time_ms(&mut self, time_ms: u16) -> Result<(), Abort> {
        self.write_setting(Settings::TIMEOUT, time_ms)
    }
}

impl Objects<'_, '_> {
    fn write_setting(&mut self, at: u16, number: u16) -> Result<(), Abort> {
        self.view.write_settings(at, [number].into_iter()).map_err(abort_of)
    }
}

/// Returns the CiA 301 signature for 1010h ("save") and 1011h ("load"), first letter in the lowest byte.
const fn signature(command: StoreCommand) -> u32 {
    u32::from_le_bytes(match command {
        StoreCommand::Save => *b"save",
        StoreCommand::Restore | StoreCommand::Defaults => *b"load",
    })
}

/// Returns the abort code for an error.
const fn abort_of(error: RegisterError) -> Abort {
    match error {
        RegisterError::Missing => Abort::NoSubindex,
        RegisterError::Value => Abort::Value,
        RegisterError::Moving | RegisterError::Saving | RegisterError::Updating => Abort::DeviceState,
    }
}

/// Returns the abort code for a refusal of an update. The report UPDATE_REFUSAL has the reason.
const fn abort_of_update(why: UpdateRefusal) -> Abort {
    use UpdateRefusal as Why;
    match why {
        Why::Moving | Why::Saving | Why::OtherMaster | Why::Busy | Why::NothingReceived => Abort::DeviceState,
        Why::NoBootLoader => Abort::LocalControl,
        Why::TooLong => Abort::Length,
        Why::Flash => Abort::Hardware,
        _ => Abort::Store,
    }
}

/// Values of program control (CiA 302-3, 1F51h).
const STOP_PROGRAM: u32 = 0;
const START_PROGRAM: u32 = 1;
const CLEAR_PROGRAM: u32 = 3;

/// Returns the value of an object about the bus.
fn bus_value(report: &BusReport, value: Value) -> u32 {
    let BusReport { state, health, counters, link } = report;
    match value {
        Value::BusStatus => *state as u32 | if health.is_passive { 0x80 } else { 0 },
        Value::TransmitErrors => health.transmit_errors.into(),
        Value::ReceiveErrors => health.receive_errors.into(),
        Value::BusOffs => counters.bus_offs.into(),
        Value::Overruns => counters.overruns.into(),
        Value::Refused => counters.refused.into(),
        Value::FramesDropped => link.frames.dropped.into(),
        Value::FramesMiscut => link.frames.miscut.into(),
        Value::FramesExpired => link.frames.expired.into(),
        Value::LinkBroken => link.broken.into(),
        _ => 0,
    }
}

#[cfg(test)]
mod tests;
