//! The state as JSON: the answer to requests, and the data of the event stream.

use super::age::as_of;
use super::answer::{HttpError, status};
use super::bench::{Bench, BusLine, Report};
use super::faulty_line::{LineCountsByDirection, LineFaults};
use super::history::Sample;
use super::injected::{FaultName, PartBody};
use crate::faults::Fault;
use crate::fieldbus::ExchangeState;
use crate::finger::{Finger, Jaw};
use crate::time::Time;
use serde::Serialize;
use wsg_fieldbus::{CommandFlags, ForceUnit, GripperFlags};
use wsg_protocol::{CommandId, SystemFlags};

/// Returns the state of gripper and lines as JSON.
pub(crate) fn state(bench: &mut Bench, now: Time) -> Result<String, HttpError> {
    let report = bench.report(now);
    serde_json::to_string(&StateBody::of(bench, &report))
        .map_err(|error| HttpError::new(status::INTERNAL_SERVER_ERROR, error.to_string()))
}

/// The answer to every accepted request.
#[derive(Debug, Serialize)]
pub(crate) struct StateBody<'a> {
    model: &'static str,
    /// Omitted when the enclosing event already contains it, like the next one.
    #[serde(skip_serializing_if = "Option::is_none")]
    time_s: Option<f64>,
    /// The name of this state, by which a request shows what its sender saw.
    #[serde(skip_serializing_if = "Option::is_none")]
    as_of: Option<String>,
    width_mm: f32,
    reported_width_mm: f32,
    speed_mm_per_s: f32,
    force_n: f32,
    force_limit_n: f32,
    gripper_state: String,
    system_state: Vec<&'static str>,
    temperature_c: f32,
    gripping_statistics: StatisticsBody,
    part: Option<PartBody>,
    part_is_between: bool,
    part_is_around: bool,
    fieldbus: FieldbusBody<'a>,
    faults: Vec<ActiveFaultBody>,
    line: LineFaults,
    line_counts: LineCountsByDirection,
    clients: Vec<ClientBody<'a>>,
}

/// The static data that a page receives first.
#[derive(Debug, Serialize)]
pub(crate) struct HelloBody {
    model: &'static str,
    limits: LimitsBody,
    names: NamesBody,
    /// Steps of the force registers in a newton.
    force_steps_per_n: f32,
    /// The commands of the manual: id and name.
    commands: Vec<(u8, &'static str)>,
    /// The device tag; empty if none is set.
    tag: String,
    /// The kinds of both fingers.
    fingers: [&'static str; 2],
    /// Time, width, speed and force of the last 30 s.
    history: Vec<Sample>,
}

#[derive(Debug, Serialize)]
struct LimitsBody {
    stroke_mm: f32,
    min_speed_mm_per_s: f32,
    max_speed_mm_per_s: f32,
    min_force_n: f32,
    nominal_force_n: f32,
    overdrive_force_n: f32,
}

/// The name of each bit, lowest first; empty if undefined.
#[derive(Debug, Serialize)]
struct NamesBody {
    command: Vec<&'static str>,
    gripper: Vec<&'static str>,
    system: Vec<&'static str>,
}

impl HelloBody {
    pub(crate) fn of(bench: &Bench) -> Self {
        let model = bench.config().model;
        let limits = &model.parameters().limits;
        let names_by_bit = |names: &mut dyn Iterator<Item = (&'static str, u32)>| {
            let mut by_bit = vec![""; 8];
            for (name, bits) in names {
                let at = bits.trailing_zeros() as usize;
                by_bit.resize(by_bit.len().max(at + 1), "");
                by_bit[at] = name;
            }
            by_bit
        };
        Self {
            model: model.name(),
            limits: LimitsBody {
                stroke_mm: limits.stroke,
                min_speed_mm_per_s: limits.min_speed,
                max_speed_mm_per_s: limits.max_speed,
                min_force_n: limits.min_force,
                nominal_force_n: limits.nominal_force,
                overdrive_force_n: limits.overdrive_force,
            },
            force_steps_per_n: ForceUnit::of(model.parameters().device).per_newton(),
            commands: CommandId::ALL.iter().map(|id| (id.code(), id.name())).collect(),
            fingers: bench.config().fingers.map(Finger::name),
            tag: bench.config().tag.as_str().to_owned(),
            history: bench.history.samples(),
            names: NamesBody {
                command: names_by_bit(
                    &mut CommandFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into())),
                ),
                gripper: names_by_bit(
                    &mut GripperFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into())),
                ),
                system: names_by_bit(
                    &mut SystemFlags::all().iter_names().map(|(name, flag)| (name, flag.bits())),
                ),
            },
        }
    }
}

/// Both images, byte by byte (fieldbus, 5), and the buses that carry them.
#[derive(Debug, Serialize)]
struct FieldbusBody<'a> {
    buses: &'a [BusLine],
    exchange: &'static str,
    master: Option<&'a str>,
    profibus_master: Option<u8>,
    outputs_received: u32,
    watchdog_expired: u32,
    watchdog_ms: u16,
    output: [u8; 8],
    input: [u8; 12],
    status: String,
}

#[derive(Debug, Serialize)]
struct StatisticsBody {
    total: u32,
    no_part: u16,
    part_lost: u16,
}

#[derive(Debug, Serialize)]
struct ActiveFaultBody {
    fault: FaultName,
    #[serde(skip_serializing_if = "Option::is_none")]
    finger: Option<u8>,
}

#[derive(Debug, Serialize)]
struct ClientBody<'a> {
    name: &'a str,
    bytes_dropped: u16,
    bad_checksums: u16,
    too_long: u16,
    updates_lost: u32,
    replies_lost: u32,
}

impl<'a> StateBody<'a> {
    /// Omits the time, which changes while nothing else does.
    pub(crate) fn without_time(mut self) -> Self {
        self.time_s = None;
        self.as_of = None;
        self
    }

    pub(crate) fn of(bench: &Bench, report: &'a Report) -> Self {
        let Report { now, state, faults, line_faults, line_counts, clients, .. } = report;
        Self {
            model: bench.config().model.name(),
            time_s: Some(now.as_micros() as f64 / 1e6),
            as_of: Some(as_of(bench, *now)),
            width_mm: state.width,
            reported_width_mm: state.reported_width,
            speed_mm_per_s: state.speed,
            force_n: state.force,
            force_limit_n: state.force_limit,
            gripper_state: state.gripper.to_string(),
            system_state: flag_names(state.flags),
            temperature_c: f32::from(state.temperature.0) / 10.0,
            gripping_statistics: StatisticsBody {
                total: state.statistics.total,
                no_part: state.statistics.no_part,
                part_lost: state.statistics.part_lost,
            },
            part: state.part.map(PartBody::from),
            part_is_between: state.part_is_between,
            part_is_around: state.part_is_around,
            fieldbus: FieldbusBody::of(bench, report),
            faults: faults.iter().map(active_fault).collect(),
            line: *line_faults,
            line_counts: *line_counts,
            clients: clients
                .iter()
                .map(|(name, counters)| ClientBody {
                    name,
                    bytes_dropped: counters.parser.dropped,
                    bad_checksums: counters.parser.bad_checksum,
                    too_long: counters.parser.oversize,
                    updates_lost: counters.updates_lost,
                    replies_lost: counters.replies_lost,
                })
                .collect(),
        }
    }
}

impl<'a> FieldbusBody<'a> {
    fn of(bench: &Bench, report: &'a Report) -> Self {
        let Report { images: (output, input), buses, exchange, master, profibus_master, .. } = report;
        Self {
            buses,
            exchange: match exchange.state {
                ExchangeState::Waiting => "waiting for a master",
                ExchangeState::DataExchange => "data exchange",
                ExchangeState::WatchdogExpired => "watchdog expired",
                ExchangeState::Left => "the master has left",
            },
            master: master.as_deref(),
            profibus_master: *profibus_master,
            outputs_received: exchange.outputs,
            watchdog_expired: exchange.timeouts,
            watchdog_ms: bench.config().bus_timeout_ms,
            output: output.to_bytes(),
            input: input.to_bytes(),
            status: input.status.to_string(),
        }
    }
}

fn flag_names(flags: SystemFlags) -> Vec<&'static str> {
    flags.iter_names().map(|(name, _)| name).collect()
}

fn active_fault(fault: &Fault) -> ActiveFaultBody {
    let number = |jaw: &Jaw| Some(if *jaw == Jaw::One { 1 } else { 2 });
    let (fault, finger) = match fault {
        Fault::AxisBlocked => (FaultName::AxisBlocked, None),
        Fault::OverTemperature => (FaultName::OverTemperature, None),
        Fault::SupplyOutOfRange => (FaultName::SupplyOutOfRange, None),
        Fault::MotorCurrent => (FaultName::MotorCurrent, None),
        Fault::FingerShortCircuit(jaw) => (FaultName::FingerShortCircuit, number(jaw)),
        Fault::FingerCommunication(jaw) => (FaultName::FingerCommunication, number(jaw)),
    };
    ActiveFaultBody { fault, finger }
}
