//! `wsg`: commands grippers, sets up bridges, decodes recordings, and publishes telemetry over MQTT.

mod bridge;
mod decode;
mod gripper;
#[cfg(feature = "telemetry")]
mod telemetry;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;

/// Commands and monitors WSG grippers and their fieldbus bridges.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Bridge(bridge::Arguments),
    Decode(decode::Arguments),
    Gripper(gripper::Arguments),
    #[cfg(feature = "telemetry")]
    Telemetry(telemetry::Arguments),
    /// Prints a shell completion script for `wsg`
    Completions {
        /// Shell to generate the script for
        shell: Shell,
    },
}

/// Reports an error in one line and exits with 1. clap exits with 2 on an invalid command line.
fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Bridge(arguments) => bridge::run(&arguments),
        Command::Decode(arguments) => decode::run(&arguments),
        Command::Gripper(arguments) => gripper::run(arguments),
        #[cfg(feature = "telemetry")]
        Command::Telemetry(arguments) => telemetry::run(&arguments),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Arguments::command(), "wsg", &mut script);
            io::stdout().write_all(&script).map(|()| ExitCode::SUCCESS).map_err(anyhow::Error::from)
        }
    };
    result.unwrap_or_else(|error| {
        eprintln!("wsg: {error:#}");
        ExitCode::FAILURE
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_line_definition_is_valid() {
        Arguments::command().debug_assert();
    }
}
