//! Commands of the page's buttons, translated to the binary protocol.

use crate::config::Config;
use serde::Deserialize;
use wsg_protocol::types::AckKey;
use wsg_protocol::{Command, HomingDirection, PrePositionFlags};

pub(super) const COMMAND_EXPECTED: &str = r#"{"command":"home"}, "stop", "fast_stop" or "acknowledge"; {"command":"move","width_mm":50.0,"speed_mm_per_s":100.0}, "grip" (and "force_n":40.0) or "release" (speed and force are optional)"#;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum CommandName {
    Home,
    Move,
    Grip,
    Release,
    Stop,
    FastStop,
    Acknowledge,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CommandBody {
    command: CommandName,
    width_mm: Option<f32>,
    speed_mm_per_s: Option<f32>,
    force_n: Option<f32>,
}

impl CommandBody {
    /// Returns the commands in order; `None` if a number is missing or not supported by the command.
    pub(super) fn commands(&self, config: &Config) -> Option<Vec<Command<'static>>> {
        let Self { command, width_mm, speed_mm_per_s, force_n } = self;
        let numbers = [width_mm, speed_mm_per_s, force_n];
        if numbers.into_iter().flatten().any(|number| !number.is_finite()) {
            return None;
        }
        let speed = speed_mm_per_s.unwrap_or(config.speed);
        let motion = match (command, *width_mm, *force_n) {
            (CommandName::Move, Some(width), None) => {
                Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed }
            }
            (CommandName::Grip, Some(width), force) => {
                let force = force.map(|force| Command::SetForceLimit { force });
                return Some(force.into_iter().chain([Command::GripPart { width, speed }]).collect());
            }
            (CommandName::Release, Some(width), None) => Command::ReleasePart { width, speed },
            (_, None, None) if speed_mm_per_s.is_none() => match command {
                CommandName::Home => Command::Homing { direction: HomingDirection::Default },
                CommandName::Stop => Command::Stop,
                CommandName::FastStop => Command::FastStop,
                CommandName::Acknowledge => Command::Acknowledge { key: AckKey },
                CommandName::Move | CommandName::Grip | CommandName::Release => return None,
            },
            _ => return None,
        };
        Some(vec![motion])
    }
}
