//! The state as JSON: the answer to requests, and the data of the event stream.

use super::age::as_of;
use super::bench::{Bench, Report};
use super::injected::FaultName;
use super::json::{IfSome, Json, ToJson, object};
use crate::faults::Fault;
use crate::fieldbus::ExchangeState;
use crate::finger::{Finger, Jaw};
use crate::port::PortCounters;
use crate::time::Time;
use std::sync::Arc;
use wsg_fieldbus::{CommandFlags, ForceUnit, GripperFlags};
use wsg_protocol::{CommandId, SystemFlags};

/// Returns the state of gripper and lines: the answer to every accepted request.
pub(crate) fn state(bench: &mut Bench, now: Time) -> String {
    let report = bench.report(now);
    of(bench, &report, Some(report.now))
}

/// Returns a reported state. Its time, and the name by which a request shows what its sender saw, are omitted if the enclosing
/// event contains them: they change while nothing else does.
pub(super) fn of(bench: &Bench, report: &Report, named: Option<Time>) -> String {
    let Report { state, faults, line_faults, line_counts, clients, .. } = report;
    object! {
        "model": bench.config().model.name(),
        "time_s": IfSome(named),
        "as_of": IfSome(named.map(|now| as_of(bench, now))),
        "width_mm": state.width,
        "reported_width_mm": state.reported_width,
        "speed_mm_per_s": state.speed,
        "force_n": state.force,
        "force_limit_n": state.force_limit,
        "gripper_state": state.gripper.to_string(),
        "system_state": state.flags.iter_names().map(|(name, _)| name).collect::<Vec<_>>(),
        "temperature_c": f32::from(state.temperature.0) / 10.0,
        "gripping_statistics": Json(&object! {
            "total": state.statistics.total,
            "no_part": state.statistics.no_part,
            "part_lost": state.statistics.part_lost,
        }),
        "part": state.part,
        "part_is_between": state.part_is_between,
        "part_is_around": state.part_is_around,
        "fieldbus": Json(&fieldbus(bench, report)),
        "faults": faults,
        "line": line_faults,
        "line_counts": line_counts,
        "clients": clients,
    }
}

/// Returns both images, byte by byte (fieldbus, 5), and the buses that carry them.
fn fieldbus(bench: &Bench, report: &Report) -> String {
    let Report { images: (output, input), buses, exchange, master, profibus_master, .. } = report;
    object! {
        "buses": buses,
        "exchange": match exchange.state {
            ExchangeState::Waiting => "waiting for a master",
            ExchangeState::DataExchange => "data exchange",
            ExchangeState::WatchdogExpired => "watchdog expired",
            ExchangeState::Left => "the master has left",
        },
        "master": master.as_deref(),
        "profibus_master": profibus_master,
        "outputs_received": exchange.outputs,
        "watchdog_expired": exchange.timeouts,
        "watchdog_ms": bench.config().bus_timeout_ms,
        "output": output.to_bytes(),
        "input": input.to_bytes(),
        "status": input.status.to_string(),
    }
}

/// Returns the static data that a page receives first.
pub(super) fn static_data(bench: &Bench) -> String {
    let model = bench.config().model;
    let limits = &model.parameters().limits;
    object! {
        "model": model.name(),
        "limits": Json(&object! {
            "stroke_mm": limits.stroke,
            "min_speed_mm_per_s": limits.min_speed,
            "max_speed_mm_per_s": limits.max_speed,
            "min_force_n": limits.min_force,
            "nominal_force_n": limits.nominal_force,
            "overdrive_force_n": limits.overdrive_force,
        }),
        "names": Json(&object! {
            "command": names_by_bit(&mut CommandFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into()))),
            "gripper": names_by_bit(&mut GripperFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into()))),
            "system": names_by_bit(&mut SystemFlags::all().iter_names().map(|(name, flag)| (name, flag.bits()))),
        }),
        // Steps of the force registers in a newton.
        "force_steps_per_n": ForceUnit::of(model.parameters().device).per_newton(),
        "commands": CommandId::ALL.iter().map(|id| (id.code(), id.name())).collect::<Vec<_>>(),
        "tag": bench.config().tag.as_str(),
        "fingers": bench.config().fingers.map(Finger::name),
        // Time, width, speed and force of the last 30 s.
        "history": bench.history.samples(),
    }
}

/// Returns the name of each bit, lowest first; empty if undefined.
fn names_by_bit(names: &mut dyn Iterator<Item = (&'static str, u32)>) -> Vec<&'static str> {
    let mut by_bit = vec![""; 8];
    for (name, bits) in names {
        let at = bits.trailing_zeros() as usize;
        by_bit.resize(by_bit.len().max(at + 1), "");
        by_bit[at] = name;
    }
    by_bit
}

impl ToJson for (Arc<str>, PortCounters) {
    fn write(&self, json: &mut String) {
        let (name, counters) = self;
        object!(json;
            "name" => &**name,
            "bytes_dropped" => counters.parser.dropped,
            "bad_checksums" => counters.parser.bad_checksum,
            "too_long" => counters.parser.oversize,
            "updates_lost" => counters.updates_lost,
            "replies_lost" => counters.replies_lost,
        );
    }
}

impl ToJson for Fault {
    fn write(&self, json: &mut String) {
        let number = |jaw: &Jaw| Some(if *jaw == Jaw::One { 1u8 } else { 2 });
        let (fault, finger) = match self {
            Self::AxisBlocked => (FaultName::AxisBlocked, None),
            Self::OverTemperature => (FaultName::OverTemperature, None),
            Self::SupplyOutOfRange => (FaultName::SupplyOutOfRange, None),
            Self::MotorCurrent => (FaultName::MotorCurrent, None),
            Self::FingerShortCircuit(jaw) => (FaultName::FingerShortCircuit, number(jaw)),
            Self::FingerCommunication(jaw) => (FaultName::FingerCommunication, number(jaw)),
        };
        object!(json; "fault" => fault, "finger" => IfSome(finger));
    }
}
