//! The control interface without I/O (feature `control`): requests and their answers as JSON, and the events for pages.
//!
//! The server `wsg-sim` adds sockets, the checks of senders, files and scripts; a page without a server uses [`Simulator`].
//! `docs/simulator.md` is the user documentation.
#![cfg_attr(
    not(feature = "std"),
    allow(dead_code, reason = "a page without a server has no other clients, files and scripts")
)]

mod age;
mod answer;
mod bench;
mod commands;
mod executed;
mod faulty_line;
mod history;
mod injected;
pub mod json;
mod latest_script;
mod log;
mod publisher;
mod request_line;
mod settings;
mod simulator;
mod state;
mod system_log;
pub(crate) mod words;

pub use log::Log;
pub use simulator::Simulator;

pub(crate) use age::{Effect, check, lacking};
pub(crate) use answer::{Answer, HttpError};
pub(crate) use bench::Bench;
pub(crate) use commands::CommandBody;
pub(crate) use settings::{Changes, Refused, SettingState};
#[cfg(feature = "std")]
pub(crate) use {
    age::MAX_AGE_MS,
    bench::{BusLine, Client, Gripper, PAGE, Report, SCRIPT},
    faulty_line::Latency,
    latest_script::{OutputLine, Run, RunState, ScriptReport},
    log::Sink,
    publisher::{Publisher, hello},
    settings::{COMMAND, DEVICE, FIELDBUS, GROUPS, Given, MOTION, NETWORK, Setting, changed_settings},
    system_log::{Severity, SystemLog},
};

#[cfg(all(test, feature = "std"))]
pub(crate) use {age::as_of, bench::MAX_CLIENTS};

use crate::axis::Part;
use crate::config::Config;
use crate::faults::Fault;
use crate::time::Time;
use answer::status;
use bench::{FRAME_EXPECTED, FrameBody};
use commands::COMMAND_EXPECTED;
use faulty_line::LineFaults;
use injected::{FAULT_EXPECTED, FaultBody, LINE_EXPECTED, PART_EXPECTED, line_faults, part, which_fault};
use json::{FromJson, object};
use settings::{SETTINGS_EXPECTED, SettingsBody, change, settings};
pub(crate) use state::state;
use wsg_protocol::editor::Quoted;

/// What the control interface needs of the program around it.
pub(crate) trait Host {
    /// Calls `act` with the bench at the current time.
    fn at_bench<T>(&mut self, act: impl FnOnce(&mut Bench, Time) -> T) -> T;

    /// Returns every setting; `None` without options.
    fn settings(&mut self) -> Option<Vec<SettingState>>;

    /// Returns the file in which settings are saved.
    fn settings_file(&mut self) -> Option<String>;

    /// Changes settings, all or none.
    fn change_settings(&mut self, changes: &Changes) -> Result<(), Refused>;

    /// Restarts the gripper once the request is answered.
    fn restart(&mut self);
}

/// A request that is understood.
#[derive(Debug)]
pub(crate) enum Action {
    State,
    Log,
    LogFile,
    Frames,
    Settings,
    Change(SettingsBody),
    Restart,
    Frame(FrameBody),
    Command(CommandBody),
    Part(Option<Part>),
    Fault(Fault, bool),
    Line(LineFaults),
}

/// Returns what a body for this path must contain; `None` for a path without one.
pub(crate) fn expected(path: &str) -> Option<&'static str> {
    Some(match path {
        "/settings" => SETTINGS_EXPECTED,
        "/frame" => FRAME_EXPECTED,
        "/command" => COMMAND_EXPECTED,
        "/part" => PART_EXPECTED,
        "/fault" => FAULT_EXPECTED,
        "/line" => LINE_EXPECTED,
        _ => return None,
    })
}

/// Parses the body of a request.
pub(crate) fn parsed<T: FromJson>(body: &[u8], expected: &str) -> Result<T, HttpError> {
    json::read(body).map_err(|error| invalid(&error, expected))
}

fn invalid(error: &str, expected: &str) -> HttpError {
    HttpError::wrong(format!("the body is invalid: {error}; expected {expected}"))
}

impl Action {
    /// Returns the action of a request to a gripper with these settings. Only a POST has a body.
    pub(crate) fn of(config: &Config, path: &str, body: Option<&[u8]>) -> Result<Self, HttpError> {
        let wanted = expected(path).unwrap_or_default();
        Ok(match (path, body) {
            ("/state", None) => Self::State,
            ("/log", None) => Self::Log,
            ("/log.txt", None) => Self::LogFile,
            ("/frames", None) => Self::Frames,
            ("/settings", None) => Self::Settings,
            ("/settings", Some(body)) => Self::Change(parsed(body, wanted)?),
            ("/restart", Some(_)) => Self::Restart,
            ("/frame", Some(body)) => Self::Frame(parsed(body, wanted)?),
            ("/command", Some(body)) => Self::Command(parsed(body, wanted)?),
            ("/part", Some(body)) => Self::Part(part(parsed(body, wanted)?)?),
            ("/fault", Some(body)) => {
                let FaultBody { fault, finger, on } = parsed(body, wanted)?;
                Self::Fault(which_fault(config, fault, finger)?, on)
            }
            ("/line", Some(body)) => Self::Line(line_faults(&parsed(body, wanted)?)?),
            _ => {
                return Err(HttpError::new(
                    status::NOT_FOUND,
                    format!("the path {} is unknown", Quoted(path)),
                ));
            }
        })
    }

    /// Returns what the age of the request must be checked for; `None` if it changes nothing or stops the fingers.
    pub(crate) fn effect(&self) -> Option<Effect> {
        match self {
            Self::State | Self::Log | Self::LogFile | Self::Frames | Self::Settings => None,
            Self::Frame(body) => body.commands().then_some(Effect::Moves),
            Self::Command(body) => (!body.is_stop()).then_some(Effect::Moves),
            Self::Restart => Some(Effect::Moves),
            Self::Change(_) | Self::Part(_) | Self::Fault(..) | Self::Line(_) => Some(Effect::Changes),
        }
    }

    /// Executes the action. The answer is the state, unless the request names something else.
    pub(crate) fn execute(self, host: &mut impl Host) -> Result<Answer, HttpError> {
        match self {
            Self::Settings => return settings(host).map(Answer::of_json),
            Self::Change(body) => {
                change(host, body)?;
                return settings(host).map(Answer::of_json);
            }
            Self::Restart => {
                settings(host)?;
                host.restart();
            }
            _ => {}
        }
        host.at_bench(|bench, now| {
            match self {
                Self::Log => {
                    let entries = bench.system_log().entries_from(0);
                    return Ok(Answer::of_json(object! { "entries": entries }));
                }
                Self::LogFile => {
                    let lines = bench.system_log().entries_from(0).into_iter();
                    return Ok(Answer::LogFile(lines.map(|entry| format!("{entry}\n")).collect()));
                }
                Self::Frames => return Ok(Answer::of_json(object! { "frames": bench.frames_from(0) })),
                Self::Frame(body) => return Ok(Answer::json(&bench.take_frame(&body, now)?)),
                Self::Command(body) => body.execute(bench, now)?,
                Self::Part(part) => bench.set_part(part, now),
                Self::Fault(fault, on) => bench.set_fault(fault, on, now),
                Self::Line(faults) => bench.set_line_faults(faults, now),
                Self::State | Self::Restart | Self::Settings | Self::Change(_) => {}
            }
            Ok(Answer::of_json(state(bench, now)))
        })
    }
}
