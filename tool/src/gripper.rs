//! `wsg gripper`: commands a gripper by name, monitors it, and logs the messages on its line.

mod action;
mod address;
mod answer;
pub(crate) mod can;
mod doctor;
mod editor;
mod line;
mod lines;
mod output;
mod prompt;
mod record;
mod run;
mod signals;
mod trouble;
mod watch;
pub(crate) mod wire;

use std::fs::File;
use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use wsg_protocol::driver::blocking::{GclGripper, Gripper as BinaryGripper};
use wsg_protocol::driver::host::StdClock;

pub use address::Address;
pub use wire::{Wire, open};

pub(crate) use action::signed;
pub(crate) use address::with_port;

use action::Named;
use answer::Answer;
pub(crate) use line::Connection;
use line::LOOK_MS;
use lines::Script;
use output::Output;
use record::Recorder;
use run::{Gripper, ProtocolCommands};
use signals::Caught;
pub(crate) use signals::Signals;
use trouble::{EXIT_STATUSES, Trouble};

/// Commands or monitors a gripper; opens a prompt if no command is given
#[derive(Args)]
#[command(after_help = after_help(), subcommand_help_heading = "Commands (with the section of the command set manual)")]
pub(crate) struct Arguments {
    /// Address of the gripper, such as tcp://192.168.1.20; see Addresses below
    #[arg(value_parser = address)]
    address: Address,
    /// Print results as JSON, one object per line
    #[arg(long, global = true)]
    json: bool,
    /// Log each message to this file, in hex and decoded; `-` is standard error
    #[arg(long, global = true, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Command to run; opens a prompt if omitted
    #[command(subcommand)]
    task: Option<Task>,
}

#[derive(Subcommand)]
enum Task {
    #[command(flatten)]
    Action(Named),
    /// Checks the connection and reports what to change; never moves the fingers
    Doctor {
        /// Over TCP, also tests whether a lost connection causes FAST STOP; if it does, FAST STOP stays latched until `ack`. Only
        /// with fingers at rest and no part held
        #[arg(long)]
        try_disconnect: bool,
    },
    /// Plots state, width, speed and force on the full screen; press q to quit
    Watch,
    /// Prints each message of this connection in hex and decoded, until Ctrl-C
    Log {
        /// Write the log to this file as well
        #[arg(long, value_name = "FILE")]
        file: Option<PathBuf>,
    },
    /// Runs the commands in a file, one per line; stops at the first failure
    Script {
        /// Script to run; `-` is standard input. Blank lines and comments (#) are ignored
        file: PathBuf,
    },
    /// A word that is none of the commands above
    #[command(external_subcommand)]
    Unknown(Vec<String>),
}

fn address(text: &str) -> Result<Address, String> {
    text.parse()
}

fn after_help() -> String {
    let statuses: String =
        EXIT_STATUSES.iter().map(|(status, meaning)| format!("\n  {status:>3}  {meaning}")).collect();
    format!("Addresses:\n  {}\n\nExit status:{statuses}", address::FORMS.replace('\n', "\n  "))
}

/// Runs the command given on the command line, and returns its exit status.
pub(crate) fn run(arguments: Arguments) -> Result<u8> {
    let Arguments { address, json, record, task } = arguments;
    let output = Output { is_json: json };
    let name = match &task {
        None => "prompt",
        Some(Task::Unknown(words)) => lines::explain(words.first().map_or("", String::as_str)),
        Some(Task::Action(named)) => &named.name,
        Some(Task::Doctor { .. }) => "doctor",
        Some(Task::Watch) => "watch",
        Some(Task::Log { .. }) => "log",
        Some(Task::Script { .. }) => "script",
    }
    .to_owned();
    let status = match perform(&address, record.as_deref(), &output, task) {
        Ok(status) => status,
        Err(Trouble::Panicked(panic)) => resume_unwind(panic),
        Err(trouble) if trouble.is_broken_pipe() => trouble.exit_status(),
        Err(trouble) => output.report(&name, &Err(trouble), None)?,
    };
    Ok(status)
}

fn perform(
    address: &Address,
    record: Option<&Path>,
    output: &Output,
    task: Option<Task>,
) -> Result<u8, Trouble> {
    // Read the whole script before sending, so that a mistake in it never leaves it half executed.
    let script = match &task {
        Some(Task::Script { file }) => Some(Script::read(file)?),
        _ => None,
    };
    let recorder = recorder(address, record, task.as_ref()).map_err(Trouble::NoFile)?;
    let signals = Signals::catch()?;
    if let Some(Task::Doctor { try_disconnect }) = task {
        return doctor::run(address, recorder, &signals, output, try_disconnect);
    }
    let line = Connection::open(address, recorder, signals.clone()).map_err(Trouble::NoLine)?;
    let work = Work { task, script, output, signals, title: address.to_string() };
    if address.is_gcl() {
        let mut gripper = GclGripper::new(line, StdClock::new());
        if let Some(limits) = address.limits() {
            gripper.assume_limits(limits);
        }
        work.on(gripper)
    } else {
        work.on(BinaryGripper::new(line, StdClock::new()))
    }
}

/// Creates the recorder for `--record` and `log`, or `None` if neither was given.
fn recorder(address: &Address, record: Option<&Path>, task: Option<&Task>) -> Result<Option<Recorder>> {
    let mut sinks: Vec<Box<dyn Write>> = Vec::new();
    let mut files = record.into_iter().collect::<Vec<_>>();
    if let Some(Task::Log { file }) = task {
        sinks.push(Box::new(io::stdout()));
        files.extend(file.as_deref());
    }
    for path in files {
        if path.as_os_str() == "-" {
            sinks.push(Box::new(io::stderr()));
        } else {
            let file = File::create(path);
            sinks.push(Box::new(file.with_context(|| format!("cannot write {}", path.display()))?));
        }
    }
    Ok((!sinks.is_empty()).then(|| Recorder::new(address.to_string(), address.is_gcl(), sinks)))
}

/// Connects, runs a program, and closes the connection without causing a FAST STOP.
///
/// Even if the program fails or panics, its motions are stopped and the end of the connection is announced.
fn guarded<P: ProtocolCommands>(
    gripper: &mut Gripper<P>,
    signals: &Signals,
    program: impl FnOnce(&mut Gripper<P>) -> Result<u8, Trouble>,
) -> Result<u8, Trouble> {
    gripper.with_connection(|gripper| {
        let ended = catch_unwind(AssertUnwindSafe(|| program(gripper)));
        // A second Ctrl-C must not prevent the stop. Every wait from here on has a time-out.
        signals.heed(false);
        let stopped = if gripper.motion().is_some() { gripper.stop() } else { Ok(()) };
        let ended = ended.unwrap_or_else(|panic| Err(Trouble::Panicked(panic)));
        match (stopped, ended) {
            // The program has already reported the lost line.
            (Err(_), Err(trouble @ Trouble::Driver(_))) => Err(trouble),
            (Err(error), _) => Err(Trouble::NotStopped(error)),
            (Ok(()), ended) => ended,
        }
    })
}

/// A task and what it needs to run on a gripper.
struct Work<'a> {
    task: Option<Task>,
    script: Option<Script>,
    output: &'a Output,
    signals: Signals,
    title: String,
}

impl Work<'_> {
    fn on<P: ProtocolCommands>(self, mut gripper: Gripper<P>) -> Result<u8, Trouble> {
        let (signals, asked) = (self.signals.clone(), Instant::now());
        let stopped = match &self.task {
            // A stop does not wait for a connection, whose answers may be late.
            Some(Task::Action(named)) if named.stops() => {
                Some(run::carry_out(&mut gripper, &named.action, &mut |_| Ok(())))
            }
            _ => None,
        };
        guarded(&mut gripper, &signals, |gripper| self.do_it(gripper, asked, stopped))
    }

    /// Runs the task, which was requested at `asked`. `stopped` is the result of a stop.
    fn do_it<P: ProtocolCommands>(
        self,
        gripper: &mut Gripper<P>,
        asked: Instant,
        stopped: Option<Result<Answer, Trouble>>,
    ) -> Result<u8, Trouble> {
        match self.task {
            // `doctor` and an unknown command never get here.
            None | Some(Task::Unknown(_) | Task::Doctor { .. }) => {
                prompt::run(gripper, self.output, &self.signals)
            }
            Some(Task::Action(named)) => {
                let age = asked.elapsed();
                let result = match stopped {
                    Some(stopped) => stopped,
                    None if named.may_move() && age > MAX_AGE => Err(Trouble::Late(age)),
                    None => run::carry_out(gripper, &named.action, &mut |_| Ok(())),
                };
                match result {
                    Err(trouble) if trouble.is_final() => Err(trouble),
                    result => Ok(self.output.report(&named.name, &result, None)?),
                }
            }
            Some(Task::Watch) => watch::run(gripper, self.title),
            Some(Task::Log { .. }) => log(gripper),
            // A script is as old as its request when it begins. Its later commands follow one another.
            Some(Task::Script { .. }) if asked.elapsed() > MAX_AGE => Err(Trouble::Late(asked.elapsed())),
            Some(Task::Script { .. }) => match self.script {
                Some(script) => script.run(gripper, self.output),
                None => Ok(0),
            },
        }
    }
}

/// Age after which a command that could move the fingers is not sent any more.
const MAX_AGE: Duration = Duration::from_secs(1);

/// Shortest interval between two values in the log, in ms.
const LOG_PERIOD_MS: u16 = 100;

/// Receives until Ctrl-C. The line itself writes the log.
fn log<P: ProtocolCommands>(gripper: &mut Gripper<P>) -> Result<u8, Trouble> {
    run::subscribe(gripper, LOG_PERIOD_MS);
    loop {
        match gripper.next_update(LOOK_MS).map_err(Trouble::from) {
            Ok(_) => {}
            // Ctrl-C is the normal end of `log`.
            Err(Trouble::Caught(Caught::INTERRUPT)) => return Ok(0),
            Err(trouble) => return Err(trouble),
        }
    }
}

#[cfg(test)]
mod documents;
#[cfg(test)]
mod tests {
    use super::*;
    use wsg_protocol::driver::host::with_gripper;
    use wsg_protocol::driver::{Error, Mm, MmPerS, OnBlock};
    use wsg_protocol::{HomingDirection, SystemFlags};
    use wsg_sim::Config;
    use wsg_sim::server::{Lines, ServerThread};

    #[test]
    fn panic_in_mid_travel_stops_fingers_and_leaves_no_fast_stop() {
        let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
        let config = Config { homing_speed: Some(400.0), ..Config::default() };
        let server = ServerThread::start(config, &lines, None).unwrap();
        let host = server.tcp_address().unwrap();
        let signals = Signals::default();
        let line = Connection::open(&Address::Tcp(host.to_string()), None, signals.clone()).unwrap();
        let mut gripper = BinaryGripper::new(line, StdClock::new());
        let ended = guarded(&mut gripper, &signals, |gripper| {
            gripper.home(HomingDirection::Positive)?;
            let _ = gripper.begin_move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop)?;
            resume_unwind(Box::new("an intended panic"));
        });
        assert!(matches!(ended, Err(Trouble::Panicked(_))));
        drop(gripper);
        let flags =
            with_gripper(host, |gripper| gripper.system_state()).map_err(|error: Error<io::Error>| error);
        let flags = flags.unwrap();
        assert!(!flags.intersects(SystemFlags::FAST_STOP | SystemFlags::MOVING), "{flags}");
        assert!(flags.contains(SystemFlags::AXIS_STOPPED), "{flags}");
    }
}
