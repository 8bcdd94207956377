//! `wsg`: the commander for WSG grippers, the service tool of the bridge, and telemetry for many of them.

mod decode;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Commands and watches WSG grippers and the bridges in front of them.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Decode(decode::Arguments),
}

/// What cannot be done is told in one line; clap ends with 2 where the command line itself is wrong.
fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Decode(arguments) => decode::run(&arguments),
    };
    result.unwrap_or_else(|error| {
        eprintln!("wsg: {error:#}");
        ExitCode::FAILURE
    })
}
