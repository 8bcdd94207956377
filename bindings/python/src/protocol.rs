//! Frames and commands of the binary protocol without a connection.

use pyo3::prelude::*;
use wsg_protocol::frame::MAX_MESSAGE_LEN;
use wsg_protocol::{
    AutoUpdate, Command, CommandId, Direction, Event, Frame, FrameEncoder, FrameParser, HomingDirection,
    Meaning, PrePositionFlags, Reply, Value,
};

use crate::error;
use crate::number::shortest;

/// A value of a reply.
#[derive(IntoPyObject)]
pub(crate) enum Number {
    Float(f64),
    Integer(u32),
}

/// Finds frames in a byte stream.
#[pyclass(module = "wsg_gripper._native")]
pub(crate) struct Decoder(Box<FrameParser<MAX_MESSAGE_LEN>>);

#[pymethods]
impl Decoder {
    #[new]
    fn new() -> Self {
        Self(Box::new(FrameParser::new()))
    }

    /// Takes bytes and returns the intact frames: id and payload.
    fn feed(&mut self, data: &[u8]) -> Vec<(u8, Vec<u8>)> {
        let mut frames = Vec::new();
        let mut keep = |event: Option<Event<'_>>| {
            if let Some(Event::Frame(Frame { id, payload })) = event {
                frames.push((id, payload.to_vec()));
            }
            event.is_some()
        };
        let mut rest = data;
        loop {
            let (taken, event) = self.0.push_slice(rest);
            rest = rest.get(taken..).unwrap_or(&[]);
            let has_event = keep(event);
            while keep(self.0.poll()) {}
            if rest.is_empty() || (taken == 0 && !has_event) {
                return frames;
            }
        }
    }

    /// Returns the numbers of dropped bytes, of frames with a wrong checksum, and of frames that are too long.
    fn counters(&self) -> (u16, u16, u16) {
        let counters = self.0.counters();
        (counters.dropped, counters.bad_checksum, counters.oversize)
    }
}

fn invalid(py: Python<'_>, text: &str) -> PyErr {
    error::exception(py, "InvalidError", text, None)
}

/// Returns the bytes of a frame.
#[pyfunction]
pub(crate) fn encode_frame(py: Python<'_>, id: u8, payload: &[u8]) -> PyResult<Vec<u8>> {
    if payload.len() > usize::from(u16::MAX) {
        return Err(invalid(py, "a payload has at most 65535 bytes"));
    }
    Ok(FrameEncoder::new(id, payload).collect())
}

/// Returns the bytes of a command with its parameters as numbers.
#[pyfunction]
pub(crate) fn encode_command(py: Python<'_>, id: u8, parameters: Vec<f32>) -> PyResult<Vec<u8>> {
    let whole = |number: f32| number as u16;
    let update = || match parameters[..] {
        [] => Some(AutoUpdate::once()),
        [period] => Some(AutoUpdate::every(whole(period))),
        _ => None,
    };
    let command = match (CommandId::from_code(id), &parameters[..]) {
        (CommandId::Homing, [direction]) => {
            HomingDirection::from_code(whole(*direction) as u8).map(|direction| Command::Homing { direction })
        }
        (CommandId::PrePosition, [width, speed, flags]) => {
            let flags = PrePositionFlags::from_bits(whole(*flags) as u8);
            flags.map(|flags| Command::PrePosition { flags, width: *width, speed: *speed })
        }
        (CommandId::GripPart, [width, speed]) => Some(Command::GripPart { width: *width, speed: *speed }),
        (CommandId::ReleasePart, [width, speed]) => {
            Some(Command::ReleasePart { width: *width, speed: *speed })
        }
        (CommandId::Stop, []) => Some(Command::Stop),
        (CommandId::FastStop, []) => Some(Command::FastStop),
        (CommandId::Acknowledge, []) => Some(Command::ACKNOWLEDGE),
        (CommandId::SetForceLimit, [force]) => Some(Command::SetForceLimit { force: *force }),
        (CommandId::SetAcceleration, [value]) => Some(Command::SetAcceleration { acceleration: *value }),
        (CommandId::GetSystemState, _) => update().map(|update| Command::GetSystemState { update }),
        (CommandId::GetGripperState, _) => update().map(|update| Command::GetGripperState { update }),
        (CommandId::GetOpeningWidth, _) => update().map(|update| Command::GetOpeningWidth { update }),
        (CommandId::GetSpeed, _) => update().map(|update| Command::GetSpeed { update }),
        (CommandId::GetForce, _) => update().map(|update| Command::GetForce { update }),
        _ => None,
    };
    let command = command.ok_or_else(|| invalid(py, "the command does not have these parameters"))?;
    command.check().map_err(|error| invalid(py, &error.to_string()))?;
    Ok(FrameEncoder::new(id, command).collect())
}

/// Returns the status and the value of a reply: width, speed and force, states and flags. Other values are None.
#[pyfunction]
pub(crate) fn decode_reply(py: Python<'_>, id: u8, payload: &[u8]) -> PyResult<(u16, Option<Number>)> {
    let reply = Reply::decode(&Frame { id, payload }).map_err(|error| invalid(py, &error.to_string()))?;
    let value = match reply.value() {
        Some(
            Value::GetOpeningWidth(value)
            | Value::GetSpeed(value)
            | Value::GetForce(value)
            | Value::GetForceLimit(value)
            | Value::GetAcceleration(value),
        ) => Some(Number::Float(shortest(value))),
        Some(Value::GetSystemState(flags)) => Some(Number::Integer(flags.bits())),
        Some(Value::GetGripperState(state)) => Some(Number::Integer(state.code().into())),
        _ => None,
    };
    Ok((reply.status().code(), value))
}

/// Returns a frame as text.
#[pyfunction]
pub(crate) fn describe(id: u8, payload: &[u8], is_reply: bool) -> String {
    let direction = if is_reply { Direction::FromGripper } else { Direction::ToGripper };
    Meaning { direction, frame: Frame { id, payload } }.to_string()
}

/// Returns the ids, names and sections of all commands of the manual.
#[pyfunction]
pub(crate) fn commands() -> Vec<(u8, &'static str, &'static str)> {
    CommandId::ALL.iter().map(|id| (id.code(), id.name(), id.section())).collect()
}
