//! What the operator injects: the part, faults of the device, and faults of the lines.

use super::answer::{HttpError, status};
use super::faulty_line::{FaultDirection, LineFaults};
use super::json::{IfSome, ToJson, body, names, object};
use crate::axis::Part;
use crate::config::Config;
use crate::faults::Fault;
use crate::finger::{Finger, Jaw};
use wsg_protocol::Number;

pub(crate) const PART_EXPECTED: &str = r#"{"width_mm":20.0,"stiffness_n_per_mm":100.0} with numbers above 0 (the stiffness is optional), "inner_width_mm":15.0 for a hollow part, or null for no part"#;
pub(crate) const FAULT_EXPECTED: &str =
    r#"{"fault":"axis_blocked","on":true}, and "finger":1 or "finger":2 with the faults of a finger"#;
pub(crate) const LINE_EXPECTED: &str = r#"rates from 0 to 1, such as {"drop":0.01,"corrupt":0.01,"truncate":0.01,"duplicate":0.01,"delay":0.01,"delay_ms":50}, where delay_ms is at most 60000 and omitted values are 0, and "direction":"requests", "replies" or "both""#;

#[derive(Debug)]
pub(crate) struct PartBody {
    width_mm: f32,
    stiffness_n_per_mm: Option<f32>,
    inner_width_mm: Option<f32>,
}
body!(PartBody: width_mm, stiffness_n_per_mm, inner_width_mm);

impl ToJson for Part {
    fn write(&self, json: &mut String) {
        object!(json;
            "width_mm" => self.width(),
            "stiffness_n_per_mm" => self.stiffness(),
            "inner_width_mm" => IfSome(self.inner_width()),
        );
    }
}

pub(crate) fn part(body: Option<PartBody>) -> Result<Option<Part>, HttpError> {
    let Some(PartBody { width_mm, stiffness_n_per_mm, inner_width_mm }) = body else { return Ok(None) };
    let stiffness = stiffness_n_per_mm.unwrap_or(Part::DEFAULT_STIFFNESS);
    let solid = Part::new(width_mm, stiffness);
    let part = match inner_width_mm {
        Some(inner_width) => solid.and_then(|part| part.with_inner_width(inner_width)),
        None => solid,
    };
    part.map(Some).ok_or_else(|| {
        let hole =
            inner_width_mm.map(|width| format!(" and a hole of {} mm", Number(width))).unwrap_or_default();
        HttpError::wrong(format!(
            "a part {} mm wide with {} N/mm{hole} is invalid; expected {PART_EXPECTED}",
            Number(width_mm),
            Number(stiffness)
        ))
    })
}

#[derive(Debug)]
pub(crate) struct FaultBody {
    pub(crate) fault: FaultName,
    pub(crate) finger: Option<u8>,
    pub(crate) on: bool,
}
body!(FaultBody: fault, finger, on);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FaultName {
    AxisBlocked,
    OverTemperature,
    SupplyOutOfRange,
    MotorCurrent,
    FingerShortCircuit,
    FingerCommunication,
}
names!(
    FaultName: AxisBlocked "axis_blocked", OverTemperature "over_temperature", SupplyOutOfRange "supply_out_of_range",
    MotorCurrent "motor_current", FingerShortCircuit "finger_short_circuit", FingerCommunication "finger_communication"
);

pub(crate) fn which_fault(config: &Config, name: FaultName, finger: Option<u8>) -> Result<Fault, HttpError> {
    let of_a_finger = |fault: fn(Jaw) -> Fault, is_possible: fn(Finger) -> bool, needs: &str| {
        let [one, two] = config.fingers;
        let (jaw, mounted) = match finger {
            Some(1) => (Jaw::One, one),
            Some(2) => (Jaw::Two, two),
            Some(other) => {
                return Err(HttpError::wrong(format!("there is no finger {other}; expected 1 or 2")));
            }
            None => {
                return Err(HttpError::wrong(format!(
                    "the fault requires a finger; expected {FAULT_EXPECTED}"
                )));
            }
        };
        if is_possible(mounted) {
            return Ok(fault(jaw));
        }
        let error =
            format!("the finger is \"{}\", which cannot have this fault; expected {needs}", mounted.name());
        Err(HttpError::new(status::CONFLICT, error))
    };
    let fault = match name {
        FaultName::AxisBlocked => Fault::AxisBlocked,
        FaultName::OverTemperature => Fault::OverTemperature,
        FaultName::SupplyOutOfRange => Fault::SupplyOutOfRange,
        FaultName::MotorCurrent => Fault::MotorCurrent,
        FaultName::FingerShortCircuit => {
            let is_possible = |finger| finger != Finger::None;
            return of_a_finger(Fault::FingerShortCircuit, is_possible, "generic, fmf or dsa");
        }
        FaultName::FingerCommunication => {
            let is_possible = |finger| matches!(finger, Finger::Fmf | Finger::Dsa);
            return of_a_finger(Fault::FingerCommunication, is_possible, "fmf or dsa");
        }
    };
    match finger {
        None => Ok(fault),
        Some(_) => Err(HttpError::wrong(
            "the fault does not concern a finger; expected it without \"finger\"".to_owned(),
        )),
    }
}

#[derive(Debug)]
pub(crate) struct LineBody {
    direction: FaultDirection,
    drop: f32,
    delay: Option<f32>,
    delay_ms: Option<u32>,
    corrupt: f32,
    truncate: f32,
    duplicate: f32,
}
body!(
    LineBody: #[default] direction, #[default] drop, delay, delay_ms, #[default] corrupt, #[default] truncate,
    #[default] duplicate
);

/// Returns the requested faults. A delay without a rate hits every frame.
pub(crate) fn line_faults(body: &LineBody) -> Result<LineFaults, HttpError> {
    let LineBody { direction, drop, delay, delay_ms, corrupt, truncate, duplicate } = *body;
    if delay.is_some_and(|rate| rate > 0.0) && delay_ms.is_none() {
        return Err(HttpError::wrong(format!("delay lacks delay_ms; expected {LINE_EXPECTED}")));
    }
    let delay_ms = delay_ms.unwrap_or(0);
    let delay = delay.unwrap_or(if delay_ms > 0 { 1.0 } else { 0.0 });
    for (name, rate) in [
        ("drop", drop),
        ("delay", delay),
        ("corrupt", corrupt),
        ("truncate", truncate),
        ("duplicate", duplicate),
    ] {
        if !(0.0..=1.0).contains(&rate) {
            return Err(HttpError::wrong(format!("{name} is {}; expected {LINE_EXPECTED}", Number(rate))));
        }
    }
    if delay_ms > LineFaults::MAX_DELAY_MS {
        return Err(HttpError::wrong(format!("delay_ms is {delay_ms}; expected {LINE_EXPECTED}")));
    }
    Ok(LineFaults { direction, drop, delay, delay_ms, corrupt, truncate, duplicate })
}
