//! `wsg`: commands grippers, sets up bridges, is a bridge without a board, decodes recordings, publishes telemetry over MQTT, and
//! demonstrates a virtual gripper.
//!
//! A library, so that other programs, such as the Python package, can run the whole program with [`run`], or open a
//! gripper at any of its addresses with [`Address`] and [`open`].

mod bridge;
mod decode;
mod demo;
mod file_flash;
mod gateway;
mod gripper;
#[cfg(feature = "telemetry")]
mod telemetry;

use std::ffi::OsString;
use std::fmt::Display;
use std::io::{self, Write};
use std::net::SocketAddr;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use clap_complete::Shell;
use wsg_sim::command_line::{address, suggest, without_markdown};
use wsg_sim::text::one_line;

pub use gripper::{Address, Wire, open};

/// Commands and monitors WSG grippers and their fieldbus bridges.
#[derive(Parser)]
#[command(name = "wsg", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Bridge(bridge::Arguments),
    Decode(decode::Arguments),
    Demo(demo::Arguments),
    Gateway(gateway::Arguments),
    Gripper(gripper::Arguments),
    #[cfg(feature = "telemetry")]
    Telemetry(telemetry::Arguments),
    /// Prints a shell completion script for `wsg`
    Completions {
        /// Shell to generate the script for
        shell: Shell,
    },
}

/// Runs `wsg` with a command line whose first word is the name of the program, and returns its exit status.
///
/// Reports an error in one line with status 1. An invalid command line ends the process with status 2.
pub fn run(command_line: impl IntoIterator<Item = OsString>) -> u8 {
    let result = match parsed(command_line.into_iter().collect()).command {
        Command::Bridge(arguments) => bridge::run(&arguments),
        Command::Decode(arguments) => decode::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Gateway(arguments) => gateway::run(&arguments),
        Command::Gripper(arguments) => gripper::run(arguments),
        #[cfg(feature = "telemetry")]
        Command::Telemetry(arguments) => telemetry::run(&arguments),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut command(), "wsg", &mut script);
            io::stdout().write_all(&script).map(|()| 0).map_err(anyhow::Error::from)
        }
    };
    result.unwrap_or_else(|error| {
        print_error(format_args!("{error:#}"));
        1
    })
}

/// Parses the command line. Ends the process if it is invalid, or requests help.
fn parsed(words: Vec<OsString>) -> Arguments {
    let matches = command().try_get_matches_from(with_signs(&words));
    matches.and_then(|mut matches| Arguments::from_arg_matches_mut(&mut matches)).unwrap_or_else(|error| {
        let words: Vec<_> = words.iter().skip(1).map(|word| word.to_string_lossy()).collect();
        suggest(error, &command(), &words).exit()
    })
}

/// Marks the signs of the numbers in a command for a gripper, so that none of them is taken for an option.
fn with_signs(words: &[OsString]) -> impl Iterator<Item = OsString> {
    let mut is_of_gripper = false;
    words.iter().map(move |word| match word.to_str() {
        Some(text) if is_of_gripper => gripper::signed(text.to_owned()).into(),
        _ => {
            is_of_gripper |= word == "gripper";
            word.clone()
        }
    })
}

/// Parses the address of an option on which the program listens.
fn listen_address(text: &str) -> Result<SocketAddr, String> {
    address(text)
        .ok_or_else(|| "expected an address with a port, such as 127.0.0.1:8080 or localhost:0".to_owned())
}

/// Severity of a message, as a number of syslog.
#[derive(Clone, Copy)]
enum Severity {
    Error = 3,
    Warning = 4,
    Info = 6,
}

/// Prints an error like [`print_message`].
fn print_error(what: impl Display) {
    print_message(Severity::Error, what);
}

/// Prints a message on standard error, in one line: it may contain text from outside, such as a topic or a file name. Write
/// errors are ignored.
fn print_message(severity: Severity, what: impl Display) {
    let prefix = if stderr_is_journal() { format!("<{}>", severity as u8) } else { String::new() };
    let _ = writeln!(io::stderr(), "{prefix}wsg: {}", one_line(&what.to_string()));
}

/// Returns whether standard error leads to the journal of systemd, which reads the severity at the start of a line.
#[cfg(target_os = "linux")]
fn stderr_is_journal() -> bool {
    std::env::var("JOURNAL_STREAM").is_ok_and(|stream| {
        rustix::fs::fstat(io::stderr()).is_ok_and(|file| stream == format!("{}:{}", file.st_dev, file.st_ino))
    })
}

#[cfg(not(target_os = "linux"))]
const fn stderr_is_journal() -> bool {
    false
}

/// Returns the definition of the command line, for manual pages and other descriptions.
#[must_use]
pub fn command() -> clap::Command {
    without_markdown(Arguments::command())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_line_definition_is_valid() {
        command().debug_assert();
    }
}
