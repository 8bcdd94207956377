//! The object dictionary: one table for the server, the EDS file and the documents.

use super::super::{BusState, Health, LinkCounters, bus::BusCounters};
use super::NodeConfig;
use crate::registers::{CanReports, REPORTS, SETTINGS};

/// The type of an object (CiA 301, table 44).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DataType {
    /// INTEGER16.
    I16,
    /// UNSIGNED8.
    U8,
    /// UNSIGNED16.
    U16,
    /// UNSIGNED32.
    U32,
}

impl DataType {
    /// Its bytes on the bus.
    #[must_use]
    pub const fn len(self) -> u8 {
        match self {
            Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 => 4,
        }
    }

    /// Its number in the dictionary.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::I16 => 3,
            Self::U8 => 5,
            Self::U16 => 6,
            Self::U32 => 7,
        }
    }

    /// Whether there are no bytes: of none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        false
    }
}

/// What an object holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Subject {
    /// A number that never changes.
    Fixed(u32),
    /// A number with the node-ID added.
    PlusNode(u32),
    ErrorRegister,
    Consumer,
    Heartbeat,
    Inhibit(u8),
    Event(u8),
    /// Bytes of the output image, by their index.
    Output(u8),
    /// Fields of the input image.
    State,
    User,
    System,
    Width,
    Force,
    Status,
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
    /// A register of the settings, counted from 0.
    Setting(u16),
    /// A report, counted from 0.
    Report(u16),
}

/// An object of the dictionary, or one of its entries.
#[derive(Clone, Copy, Debug)]
pub struct Object {
    /// Its index.
    pub index: u16,
    /// Its subindex.
    pub sub: u8,
    /// Its type.
    pub kind: DataType,
    /// Whether a master may write it.
    pub writable: bool,
    /// Whether it can be part of a PDO.
    pub mappable: bool,
    /// Its name.
    pub name: &'static str,
    /// The name of the record that it is in; empty for an object without entries.
    pub record: &'static str,
    pub(super) subject: Subject,
}

/// The index of the record of the settings: entry n is holding register 99 + n of `docs/registers.md`.
pub const SETTINGS_INDEX: u16 = 0x2100;
/// The index of the record of the reports: entry n is input register 99 + n of `docs/registers.md`.
pub const REPORTS_INDEX: u16 = 0x2101;
/// The index of the output image.
pub const OUTPUT_INDEX: u16 = 0x2000;
/// The index of the input image.
pub const INPUT_INDEX: u16 = 0x2001;

/// Bit 30 of a TPDO's COB-ID: it cannot be asked for by a remote frame.
const NO_REMOTE: u32 = 1 << 30;

const REVISION: u32 = 1 << 16;

/// Objects 1000h to 2002h. The settings and reports behind them have tables of their own.
pub const OBJECTS: [Object; 65] = {
    use DataType::{I16, U8, U16, U32};
    use Subject as S;
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
    const COUNT: &str = "Number of entries";
    const fn map(index: u16, sub: u8, kind: DataType) -> Subject {
        Subject::Fixed(((index as u32) << 16) | ((sub as u32) << 8) | (kind.len() as u32 * 8))
    }
    const fn ro(
        index: u16,
        sub: u8,
        kind: DataType,
        subject: Subject,
        record: &'static str,
        name: &'static str,
    ) -> Object {
        Object { index, sub, kind, writable: false, mappable: false, name, record, subject }
    }
    const fn rw(
        index: u16,
        sub: u8,
        kind: DataType,
        subject: Subject,
        record: &'static str,
        name: &'static str,
    ) -> Object {
        Object { writable: true, ..ro(index, sub, kind, subject, record, name) }
    }
    const fn field(index: u16, sub: u8, kind: DataType, subject: Subject, name: &'static str) -> Object {
        let record = if index == OUTPUT_INDEX { OUTPUT } else { INPUT };
        Object { mappable: true, ..ro(index, sub, kind, subject, record, name) }
    }
    [
        ro(0x1000, 0, U32, S::Fixed(0), "", "Device type"),
        ro(0x1001, 0, U8, S::ErrorRegister, "", "Error register"),
        ro(0x1014, 0, U32, S::PlusNode(0x80), "", "COB-ID EMCY"),
        ro(0x1016, 0, U8, S::Fixed(1), "Consumer heartbeat time", COUNT),
        rw(0x1016, 1, U32, S::Consumer, "Consumer heartbeat time", "Master (bits 16 to 22) and time in ms"),
        rw(0x1017, 0, U16, S::Heartbeat, "", "Producer heartbeat time in ms"),
        ro(0x1018, 0, U8, S::Fixed(4), IDENTITY, COUNT),
        ro(0x1018, 1, U32, S::Fixed(0), IDENTITY, "Vendor-ID (none assigned)"),
        ro(0x1018, 2, U32, S::Fixed(1), IDENTITY, "Product code"),
        ro(0x1018, 3, U32, S::Fixed(REVISION), IDENTITY, "Revision number"),
        ro(0x1018, 4, U32, S::Fixed(0), IDENTITY, "Serial number"),
        ro(0x1200, 0, U8, S::Fixed(2), "SDO server", COUNT),
        ro(0x1200, 1, U32, S::PlusNode(0x600), "SDO server", "COB-ID client to server"),
        ro(0x1200, 2, U32, S::PlusNode(0x580), "SDO server", "COB-ID server to client"),
        ro(0x1400, 0, U8, S::Fixed(2), RPDO, COUNT),
        ro(0x1400, 1, U32, S::PlusNode(0x200), RPDO, "COB-ID"),
        ro(0x1400, 2, U8, S::Fixed(255), RPDO, "Transmission type"),
        ro(0x1600, 0, U8, S::Fixed(5), RPDO_MAP, COUNT),
        ro(0x1600, 1, U32, map(OUTPUT_INDEX, 1, U8), RPDO_MAP, "CMDFLAGS"),
        ro(0x1600, 2, U32, map(OUTPUT_INDEX, 2, U8), RPDO_MAP, "IF"),
        ro(0x1600, 3, U32, map(OUTPUT_INDEX, 3, I16), RPDO_MAP, "WIDTH"),
        ro(0x1600, 4, U32, map(OUTPUT_INDEX, 4, U16), RPDO_MAP, "SPEED"),
        ro(0x1600, 5, U32, map(OUTPUT_INDEX, 5, I16), RPDO_MAP, "FORCELIMIT"),
        ro(0x1800, 0, U8, S::Fixed(5), TPDO1, COUNT),
        ro(0x1800, 1, U32, S::PlusNode(0x180 | NO_REMOTE), TPDO1, "COB-ID"),
        ro(0x1800, 2, U8, S::Fixed(255), TPDO1, "Transmission type"),
        rw(0x1800, 3, U16, S::Inhibit(0), TPDO1, "Inhibit time in 100 us"),
        rw(0x1800, 5, U16, S::Event(0), TPDO1, "Event timer in ms"),
        ro(0x1801, 0, U8, S::Fixed(5), TPDO2, COUNT),
        ro(0x1801, 1, U32, S::PlusNode(0x280 | NO_REMOTE), TPDO2, "COB-ID"),
        ro(0x1801, 2, U8, S::Fixed(255), TPDO2, "Transmission type"),
        rw(0x1801, 3, U16, S::Inhibit(1), TPDO2, "Inhibit time in 100 us"),
        rw(0x1801, 5, U16, S::Event(1), TPDO2, "Event timer in ms"),
        ro(0x1A00, 0, U8, S::Fixed(4), TPDO1_MAP, COUNT),
        ro(0x1A00, 1, U32, map(INPUT_INDEX, 1, U8), TPDO1_MAP, "GSTATE"),
        ro(0x1A00, 2, U32, map(INPUT_INDEX, 2, U8), TPDO1_MAP, "OF"),
        ro(0x1A00, 3, U32, map(INPUT_INDEX, 3, U32), TPDO1_MAP, "SYSSTATE"),
        ro(0x1A00, 4, U32, map(INPUT_INDEX, 6, U16), TPDO1_MAP, "Status Code"),
        ro(0x1A01, 0, U8, S::Fixed(2), TPDO2_MAP, COUNT),
        ro(0x1A01, 1, U32, map(INPUT_INDEX, 4, I16), TPDO2_MAP, "WIDTH"),
        ro(0x1A01, 2, U32, map(INPUT_INDEX, 5, I16), TPDO2_MAP, "Gripping Force"),
        ro(OUTPUT_INDEX, 0, U8, S::Fixed(5), OUTPUT, COUNT),
        field(OUTPUT_INDEX, 1, U8, S::Output(0), "CMDFLAGS"),
        field(OUTPUT_INDEX, 2, U8, S::Output(1), "IF"),
        field(OUTPUT_INDEX, 3, I16, S::Output(2), "WIDTH"),
        field(OUTPUT_INDEX, 4, U16, S::Output(4), "SPEED"),
        field(OUTPUT_INDEX, 5, I16, S::Output(6), "FORCELIMIT"),
        ro(INPUT_INDEX, 0, U8, S::Fixed(6), INPUT, COUNT),
        field(INPUT_INDEX, 1, U8, S::State, "GSTATE"),
        field(INPUT_INDEX, 2, U8, S::User, "OF"),
        field(INPUT_INDEX, 3, U32, S::System, "SYSSTATE"),
        field(INPUT_INDEX, 4, I16, S::Width, "WIDTH"),
        field(INPUT_INDEX, 5, I16, S::Force, "Gripping Force"),
        field(INPUT_INDEX, 6, U16, S::Status, "Status Code"),
        ro(0x2002, 0, U8, S::Fixed(10), BUS, COUNT),
        ro(0x2002, 1, U8, S::BusStatus, BUS, "0 on, 1 off, 2 recovering, 3 given up; 80h: passive"),
        ro(0x2002, 2, U8, S::TransmitErrors, BUS, "Transmit error counter"),
        ro(0x2002, 3, U8, S::ReceiveErrors, BUS, "Receive error counter"),
        ro(0x2002, 4, U16, S::BusOffs, BUS, "Times bus-off"),
        ro(0x2002, 5, U16, S::Overruns, BUS, "Frames lost by the controller"),
        ro(0x2002, 6, U16, S::Refused, BUS, "Frames refused by the controller"),
        ro(0x2002, 7, U16, S::FramesDropped, BUS, "Gripper: frames of no intact message"),
        ro(0x2002, 8, U16, S::FramesMiscut, BUS, "Gripper: messages cut wrongly"),
        ro(0x2002, 9, U16, S::FramesExpired, BUS, "Gripper: half messages"),
        ro(0x2002, 10, U16, S::LinkBroken, BUS, "To the gripper: messages that left in part"),
    ]
};

/// How many entries the settings and the reports have, without the one that says so.
const SETTINGS_COUNT: u8 = SETTINGS.len() as u8;
const REPORTS_COUNT: u8 = REPORTS.len() as u8;
const _: () = assert!(SETTINGS.len() < 255 && REPORTS.len() < 255);

/// The server's part of the table, so that the words stay out of the image.
#[derive(Clone, Copy)]
struct Place {
    index: u16,
    sub: u8,
    kind: DataType,
    writable: bool,
    subject: Subject,
}

const PLACES: [Place; OBJECTS.len()] = {
    let mut places =
        [Place { index: 0, sub: 0, kind: DataType::U8, writable: false, subject: Subject::Fixed(0) };
            OBJECTS.len()];
    let mut at = 0;
    while at < OBJECTS.len() {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            let Object { index, sub, kind, writable, subject, .. } = OBJECTS[at];
            places[at] = Place { index, sub, kind, writable, subject };
        }
        at += 1;
    }
    places
};

/// Where an object was found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub(super) kind: DataType,
    pub(super) writable: bool,
    pub(super) subject: Subject,
}

/// Why there is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Missing {
    Object,
    Subindex,
}

/// Looks an object up.
pub(super) fn find(index: u16, sub: u8) -> Result<Found, Missing> {
    let record = |count: u8, writable: bool, subject: Subject| match sub {
        0 => Ok(Found { kind: DataType::U8, writable: false, subject: Subject::Fixed(count.into()) }),
        sub if sub <= count => Ok(Found { kind: DataType::U16, writable, subject }),
        _ => Err(Missing::Subindex),
    };
    let number = u16::from(sub).wrapping_sub(1);
    match index {
        SETTINGS_INDEX => record(SETTINGS_COUNT, true, Subject::Setting(number)),
        REPORTS_INDEX => record(REPORTS_COUNT, false, Subject::Report(number)),
        _ => {
            let mut missing = Missing::Object;
            for place in &PLACES {
                if place.index == index {
                    missing = Missing::Subindex;
                    if place.sub == sub {
                        let Place { kind, writable, subject, .. } = *place;
                        return Ok(Found { kind, writable, subject });
                    }
                }
            }
            Err(missing)
        }
    }
}

/// What a node knows of its bus, for the counters.
#[derive(Clone, Copy, Debug, Default)]
pub struct BusReport {
    /// How the bridge stands to the bus.
    pub state: BusState,
    /// How the controller sees the bus.
    pub health: Health,
    /// What the bus has met.
    pub counters: BusCounters,
    /// What the gripper's link has met; nothing where it is not on this bus.
    pub link: LinkCounters,
}

impl BusReport {
    pub(super) const NOTHING: Self = Self {
        state: BusState::On,
        health: Health { is_off: false, is_passive: false, transmit_errors: 0, receive_errors: 0 },
        counters: BusCounters { bus_offs: 0, overruns: 0, refused: 0 },
        link: LinkCounters {
            frames: wsg_protocol::can::Counters {
                foreign: 0,
                dropped: 0,
                miscut: 0,
                bad_checksum: 0,
                oversize: 0,
                expired: 0,
            },
            overflows: 0,
            broken: 0,
        },
    };

    /// Returns the reports about CAN.
    #[must_use]
    pub const fn registers(&self) -> CanReports {
        let Self { state, health, counters, link } = self;
        let passive = if health.is_passive { 0x80 } else { 0 };
        CanReports([
            *state as u16 | passive,
            health.transmit_errors as u16,
            health.receive_errors as u16,
            counters.bus_offs,
            counters.overruns,
            link.frames.dropped,
        ])
    }

    pub(super) fn number(&self, subject: Subject) -> u32 {
        let Self { state, health, counters, link } = self;
        match subject {
            Subject::BusStatus => *state as u32 | if health.is_passive { 0x80 } else { 0 },
            Subject::TransmitErrors => health.transmit_errors.into(),
            Subject::ReceiveErrors => health.receive_errors.into(),
            Subject::BusOffs => counters.bus_offs.into(),
            Subject::Overruns => counters.overruns.into(),
            Subject::Refused => counters.refused.into(),
            Subject::FramesDropped => link.frames.dropped.into(),
            Subject::FramesMiscut => link.frames.miscut.into(),
            Subject::FramesExpired => link.frames.expired.into(),
            Subject::LinkBroken => link.broken.into(),
            _ => 0,
        }
    }
}

/// The number that says which node a COB-ID belongs to.
pub(super) const fn with_node(base: u32, config: &NodeConfig) -> u32 {
    base | config.node as u32
}
