//! Commands of the page's buttons, translated to the binary protocol.

use super::answer::{HttpError, status};
use super::bench::Bench;
use super::json::{body, names};
use crate::time::Time;
use wsg_protocol::types::AckKey;
use wsg_protocol::{Command, HomingDirection, PrePositionFlags, Status};

pub(crate) const COMMAND_EXPECTED: &str = r#"{"command":"home"}, "stop", "fast_stop" or "acknowledge"; {"command":"move","width_mm":50.0,"speed_mm_per_s":100.0}, "grip" (and "force_n":40.0) or "release" (speed and force are optional)"#;

#[derive(Debug)]
enum CommandName {
    Home,
    Move,
    Grip,
    Release,
    Stop,
    FastStop,
    Acknowledge,
}
names!(
    CommandName: Home "home", Move "move", Grip "grip", Release "release", Stop "stop", FastStop "fast_stop",
    Acknowledge "acknowledge"
);

#[derive(Debug)]
pub(crate) struct CommandBody {
    command: CommandName,
    width_mm: Option<f32>,
    speed_mm_per_s: Option<f32>,
    force_n: Option<f32>,
    /// A random number. A second command with it, such as a stop that is sent on two ways, is not executed.
    key: Option<u64>,
}
body!(CommandBody: command, width_mm, speed_mm_per_s, force_n, key);

impl CommandBody {
    /// Returns whether the command stops the fingers, which is never refused for its age.
    pub(crate) const fn is_stop(&self) -> bool {
        matches!(self.command, CommandName::Stop | CommandName::FastStop)
    }

    /// Executes the command. A refusal by the gripper, or a number outside its limits, changes nothing.
    pub(crate) fn execute(&self, bench: &mut Bench, now: Time) -> Result<(), HttpError> {
        if self.key.is_some_and(|key| bench.executed.contains(key)) {
            return Ok(());
        }
        let command = self.command(bench.config().speed).ok_or_else(|| {
            HttpError::wrong(format!(
                "the command has missing or invalid numbers; expected {COMMAND_EXPECTED}"
            ))
        })?;
        check_limits(bench, &command, self.force_n, now)?;
        let status = bench.command(self.force_n, &command, now);
        if matches!(status, Status::Success | Status::CmdPending) {
            if let Some(key) = self.key {
                bench.executed.keep(key);
            }
            return Ok(());
        }
        let error = format!("the gripper refuses {command}: {status}");
        Err(HttpError::new(status::CONFLICT, error))
    }

    /// Returns the command; `None` if a number is missing or not supported by the command.
    fn command(&self, default_speed: f32) -> Option<Command<'static>> {
        let Self { command, width_mm, speed_mm_per_s, force_n, .. } = self;
        let numbers = [width_mm, speed_mm_per_s, force_n];
        if numbers.into_iter().flatten().any(|number| !number.is_finite()) {
            return None;
        }
        let speed = speed_mm_per_s.unwrap_or(default_speed);
        Some(match (command, *width_mm, *force_n) {
            (CommandName::Move, Some(width), None) => {
                Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed }
            }
            (CommandName::Grip, Some(width), _) => Command::GripPart { width, speed },
            (CommandName::Release, Some(width), None) => Command::ReleasePart { width, speed },
            (_, None, None) if speed_mm_per_s.is_none() => match command {
                CommandName::Home => Command::Homing { direction: HomingDirection::Default },
                CommandName::Stop => Command::Stop,
                CommandName::FastStop => Command::FastStop,
                CommandName::Acknowledge => Command::Acknowledge { key: AckKey },
                CommandName::Move | CommandName::Grip | CommandName::Release => return None,
            },
            _ => return None,
        })
    }
}

/// Rejects numbers outside the limits (command set, 3.5.4), which the gripper would correct without an error.
fn check_limits(
    bench: &mut Bench,
    command: &Command<'_>,
    force: Option<f32>,
    now: Time,
) -> Result<(), HttpError> {
    let limits = bench.config().model.parameters().limits;
    let flags = bench.look(now, |gripper| gripper.state().flags);
    let force = force.map(|force| Command::SetForceLimit { force });
    let mut commands = force.iter().chain([command]);
    let checked = commands.try_for_each(|command| command.check_limits(&limits, flags, None));
    checked.map_err(|refusal| HttpError::wrong(refusal.to_string()))
}
