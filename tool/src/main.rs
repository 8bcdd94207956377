//! `wsg`: the commander for WSG grippers, the service tool of the bridge, and telemetry for many of them.

mod bridge;
mod decode;
mod gripper;
#[cfg(feature = "telemetry")]
mod telemetry;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;

/// Commands and watches WSG grippers and the bridges in front of them.
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
    /// Writes what a shell needs to complete the commands of `wsg`
    Completions {
        /// The shell
        shell: Shell,
    },
}

/// What cannot be done is told in one line; clap ends with 2 where the command line itself is wrong.
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
    fn command_line_is_one_that_clap_takes() {
        Arguments::command().debug_assert();
    }
}
