//! Records: acyclic reads, and the few supported writes.

use crate::alarm::{APPEARS, CHANNEL_DIAGNOSIS, WHOLE_SUBMODULE};
use crate::connect::{Configuration, Match};
use crate::cursor::{Reader, Writer};
use crate::frame::MacAddress;
use crate::lldp::{MAU_TYPE, PORT_ID};
use crate::profile::Profile;
use crate::rpc::access;
use crate::station::{IpParameters, Maintenance, StationName};

/// Data for the contents of records.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View<'a> {
    pub(crate) profile: &'static Profile,
    pub(crate) mac: MacAddress,
    pub(crate) name: &'a StationName,
    pub(crate) ip: &'a IpParameters,
    pub(crate) maintenance: &'a Maintenance,
    /// Present faults, bit n for fault n.
    pub(crate) faults: u32,
    /// Configuration that the controller expects; `None` outside its connection.
    pub(crate) expected: Option<&'a Configuration>,
}

/// Address of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Address {
    pub(crate) api: u32,
    pub(crate) slot: u16,
    pub(crate) subslot: u16,
    pub(crate) index: u16,
}

/// Part of the device that an index covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scope {
    Submodule,
    Module,
    Whole,
}

mod index {
    pub(super) const IM0: u16 = 0xAFF0;
    pub(super) const IM1: u16 = 0xAFF1;
    pub(super) const IM2: u16 = 0xAFF2;
    pub(super) const IM3: u16 = 0xAFF3;
    pub(super) const PORT_REAL: u16 = 0x802A;
    pub(super) const INTERFACE_REAL: u16 = 0x8080;
    pub(super) const MODULE_DIFF: u16 = 0xE002;
    pub(super) const API_DATA: u16 = 0xF821;
    pub(super) const IM0_FILTER: u16 = 0xF840;
    pub(super) const PD_REAL: u16 = 0xF841;
    pub(super) const DEVICE_DIAGNOSIS: u16 = 0xF80C;
}

mod block {
    pub(super) const DIAGNOSIS: u16 = 0x0010;
    pub(super) const EXPECTED: u16 = 0x0012;
    pub(super) const REAL: u16 = 0x0013;
    pub(super) const API_DATA: u16 = 0x001A;
    pub(super) const IM0: u16 = 0x0020;
    pub(super) const IM1: u16 = 0x0021;
    pub(super) const IM2: u16 = 0x0022;
    pub(super) const IM3: u16 = 0x0023;
    pub(super) const FILTER_SUBMODULES: u16 = 0x0030;
    pub(super) const FILTER_DEVICE: u16 = 0x0032;
    pub(super) const PORT_REAL: u16 = 0x020F;
    pub(super) const INTERFACE_REAL: u16 = 0x0240;
    pub(super) const MULTIPLE: u16 = 0x0400;
    pub(super) const MODULE_DIFF: u16 = 0x8104;
}

pub(crate) const INTERFACE_SUBSLOT: u16 = 0x8000;
pub(crate) const PORT_SUBSLOT: u16 = 0x8001;

/// Bit mask of the supported records I&M 1 to 3; I&M 0 is mandatory.
const IM_SUPPORTED: u16 = 0x000E;

/// Writes a record. Returns the error reason if it is not available.
pub(crate) fn read(view: &View<'_>, what: Address, writer: &mut Writer<'_>) -> Result<(), u8> {
    let Address { api, slot, subslot, index } = what;
    let scope = match index {
        0x8000..=0x8FFF | 0xAFF0..=0xAFFF => Scope::Submodule,
        0xC000..=0xCFFF => Scope::Module,
        _ => Scope::Whole,
    };
    let profile = view.profile;
    let is_there = match scope {
        Scope::Submodule => profile.submodule(slot, subslot).is_some(),
        Scope::Module => profile.module(slot).is_some(),
        Scope::Whole => true,
    };
    if api != 0 || !is_there {
        return Err(access::INVALID_SLOT);
    }
    let is_here = |module, submodule| match scope {
        Scope::Submodule => (module, submodule) == (slot, subslot),
        Scope::Module => module == slot,
        Scope::Whole => true,
    };
    match index {
        index::IM0 => im0(writer, profile),
        index::IM1 => writer.block(block::IM1, 0, |writer| {
            writer.bytes(&view.maintenance.function);
            writer.bytes(&view.maintenance.location);
        }),
        index::IM2 => writer.block(block::IM2, 0, |writer| writer.bytes(&view.maintenance.date)),
        index::IM3 => writer.block(block::IM3, 0, |writer| writer.bytes(&view.maintenance.descriptor)),
        index::IM0_FILTER => {
            let all = || real(profile);
            writer.block(block::FILTER_SUBMODULES, 0, |writer| identification(writer, all(), |_, _| true));
            let access_point = |slot, subslot| slot == 0 && subslot == 1;
            writer.block(block::FILTER_DEVICE, 0, |writer| identification(writer, all(), access_point));
        }
        // Expected and real identification, by submodule, module, connection and API.
        0x8000 | 0xC000 | 0xE000 => {
            let expected = view.expected.ok_or(access::NOT_THERE)?.iter().flatten();
            let expected = expected.map(|it| (it.slot, it.module, it.subslot, it.ident));
            writer.block(block::EXPECTED, 1, |writer| identification(writer, expected, is_here));
        }
        0x8001 | 0xC001 | 0xE001 | 0xF000 => {
            writer.block(block::REAL, 1, |writer| identification(writer, real(profile), is_here));
        }
        // Diagnosis: of channels, all, and all including maintenance.
        0x800A..=0x800C | 0xC00A..=0xC00C | 0xE00A..=0xE00C | 0xF00A..=0xF00C | index::DEVICE_DIAGNOSIS => {
            if is_here(0, 1) {
                diagnosis(writer, view);
            }
        }
        index::MODULE_DIFF => module_diff(writer, view.expected.ok_or(access::NOT_THERE)?, profile),
        index::API_DATA => writer.block(block::API_DATA, 0, |writer| {
            writer.u16(1);
            writer.u32(0);
        }),
        index::INTERFACE_REAL if subslot == INTERFACE_SUBSLOT => interface(writer, view),
        index::PORT_REAL if subslot == PORT_SUBSLOT => port(writer),
        index::PD_REAL => {
            of_submodule(writer, INTERFACE_SUBSLOT, |writer| interface(writer, view));
            of_submodule(writer, PORT_SUBSLOT, port);
        }
        _ => return Err(access::INVALID_INDEX),
    }
    Ok(())
}

/// Executes a write to a record. Returns the error reason if it is rejected.
pub(crate) fn write(
    profile: &Profile,
    what: Address,
    data: &[u8],
    maintenance: &mut Maintenance,
) -> Result<(), u8> {
    if what.api != 0 || profile.submodule(what.slot, what.subslot).is_none() {
        return Err(access::INVALID_SLOT);
    }
    match what.index {
        index::IM0 => return Err(access::DENIED),
        index::IM1 => {
            let mut reader = contents(block::IM1, data)?;
            let (Some(function), Some(location), []) = (reader.array(), reader.array(), reader.rest()) else {
                return Err(access::WRITE_LENGTH);
            };
            maintenance.function = function;
            maintenance.location = location;
        }
        index::IM2 => maintenance.date = whole(contents(block::IM2, data)?)?,
        index::IM3 => maintenance.descriptor = whole(contents(block::IM3, data)?)?,
        _ => return Err(access::INVALID_INDEX),
    }
    Ok(())
}

/// Returns the contents of the block of this type.
fn contents(kind: u16, data: &[u8]) -> Result<Reader<'_>, u8> {
    let mut reader = Reader::new(data);
    let header = (reader.u16(), reader.u16(), reader.u16());
    let len = reader.rest().len();
    // The length of a block includes the version, but not type and length.
    let expected = (Some(kind), u16::try_from(len.saturating_add(2)).ok(), Some(0x0100));
    if header == expected { Ok(reader) } else { Err(access::WRITE_LENGTH) }
}

fn whole<const N: usize>(reader: Reader<'_>) -> Result<[u8; N], u8> {
    reader.rest().try_into().map_err(|_| access::WRITE_LENGTH)
}

fn im0(writer: &mut Writer<'_>, profile: &Profile) {
    writer.block(block::IM0, 0, |writer| {
        writer.u16(profile.vendor_id);
        writer.text(profile.order_id.as_bytes(), 20);
        writer.text(profile.serial_number.as_bytes(), 16);
        writer.u16(profile.hardware_revision);
        writer.u8(b'V');
        writer.bytes(&profile.software_revision);
        // No revision counter, no profile.
        writer.u16s(&[0, 0, 0]);
        // I&M version 1.1.
        writer.bytes(&[1, 1]);
        writer.u16(IM_SUPPORTED);
    });
}

/// Iterates over the real configuration: slot, module, subslot, submodule.
fn real(profile: &Profile) -> impl Iterator<Item = (u16, u32, u16, u32)> + Clone + use<> {
    let modules = profile.modules;
    modules.iter().flat_map(|module| {
        let submodules = module.submodules.iter();
        submodules.map(|submodule| (module.slot, module.ident, submodule.subslot, submodule.ident))
    })
}

/// Writes one API with the requested slots and subslots.
fn identification(
    writer: &mut Writer<'_>,
    all: impl Iterator<Item = (u16, u32, u16, u32)>,
    is_requested: impl Fn(u16, u16) -> bool,
) {
    writer.u16(1);
    writer.u32(0);
    let slots = writer.begin_count();
    let (mut subslots, mut last_slot) = (slots, None);
    for (slot, module, subslot, submodule) in
        all.filter(|(slot, _, subslot, _)| is_requested(*slot, *subslot))
    {
        if last_slot != Some(slot) {
            last_slot = Some(slot);
            writer.count_one(slots);
            writer.u16(slot);
            writer.u32(module);
            subslots = writer.begin_count();
        }
        writer.count_one(subslots);
        writer.u16(subslot);
        writer.u32(submodule);
    }
}

/// Returns whether any expected submodule does not match.
pub(crate) fn differs(expected: &Configuration, profile: &Profile) -> bool {
    expected.iter().flatten().any(|expected| expected.compare(profile) != Match::Proper)
}

/// Writes all expected submodules that do not match.
pub(crate) fn module_diff(writer: &mut Writer<'_>, expected: &Configuration, profile: &Profile) {
    let differing =
        || expected.iter().flatten().filter(|expected| expected.compare(profile) != Match::Proper);
    writer.block(block::MODULE_DIFF, 0, |writer| {
        writer.u16(differing().next().is_some().into());
        if differing().next().is_none() {
            return;
        }
        writer.u32(0);
        let modules = writer.begin_count();
        let (mut subslots, mut last_slot) = (modules, None);
        for expected in differing() {
            let how = expected.compare(profile);
            if last_slot != Some(expected.slot) {
                last_slot = Some(expected.slot);
                writer.count_one(modules);
                writer.u16(expected.slot);
                writer.u32(profile.module(expected.slot).map_or(0, |module| module.ident));
                // No module, wrong module, or proper module with wrong submodules.
                writer.u16(match how {
                    Match::NoModule => 0,
                    Match::WrongModule => 1,
                    _ => 2,
                });
                subslots = writer.begin_count();
            }
            if matches!(how, Match::WrongSubmodule | Match::NoSubmodule) {
                writer.count_one(subslots);
                writer.u16(expected.subslot);
                let real = profile.submodule(expected.slot, expected.subslot);
                writer.u32(real.map_or(0, |submodule| submodule.ident));
                // Coded state: wrong identification (2) or no submodule (3).
                writer.u16(0x8000 | if how == Match::WrongSubmodule { 2 } else { 3 } << 11);
            }
        }
    });
}

/// Writes the present faults as channel diagnosis of the device access point.
fn diagnosis(writer: &mut Writer<'_>, view: &View<'_>) {
    if view.faults == 0 {
        return;
    }
    writer.block(block::DIAGNOSIS, 1, |writer| {
        writer.u32(0);
        writer.u16s(&[0, 1, WHOLE_SUBMODULE, APPEARS, CHANNEL_DIAGNOSIS]);
        for (bit, fault) in view.profile.faults.iter().enumerate() {
            if view.faults.checked_shr(bit as u32).unwrap_or(0) & 1 == 1 {
                writer.u16s(&[WHOLE_SUBMODULE, APPEARS, fault.error_type]);
            }
        }
    });
}

/// Writes a block of a submodule of the device access point.
fn of_submodule(writer: &mut Writer<'_>, subslot: u16, body: impl FnOnce(&mut Writer<'_>)) {
    writer.block(block::MULTIPLE, 0, |writer| {
        writer.u16s(&[0, 0, 0, 0, subslot]);
        body(writer);
    });
}

fn interface(writer: &mut Writer<'_>, view: &View<'_>) {
    let start = writer.len();
    writer.block(block::INTERFACE_REAL, 0, |writer| {
        let name = view.name.as_bytes();
        writer.u8(name.len() as u8);
        writer.bytes(name);
        writer.align(start, 4);
        writer.bytes(&view.mac.0);
        writer.align(start, 4);
        writer.bytes(&view.ip.address);
        writer.bytes(&view.ip.mask);
        writer.bytes(&view.ip.gateway);
    });
}

fn port(writer: &mut Writer<'_>) {
    let start = writer.len();
    writer.block(block::PORT_REAL, 0, |writer| {
        writer.u16s(&[0, 0, PORT_SUBSLOT]);
        writer.u8(PORT_ID.len() as u8);
        writer.bytes(PORT_ID);
        // Neighbours are not detected.
        writer.u8(0);
        writer.align(start, 4);
        writer.u16(MAU_TYPE);
        writer.align(start, 4);
        // No domain boundaries.
        writer.u32(0);
        writer.u32(0);
        // Link up and forwarding; then medium: copper.
        writer.u16(1);
        writer.align(start, 4);
        writer.u32(1);
    });
}
