//! Errors of commands, as text, as JSON and as an exit status.

use std::any::Any;
use std::fmt::{self, Display, Formatter};
use std::io;
use std::time::Duration;

use serde_json::{Value, json};
use wsg_protocol::Status;
use wsg_protocol::driver::Error;
use wsg_protocol::limits::Quantity;

use super::answer::Outcome;
use super::record::Unlogged;
use super::signals::Caught;

/// An error of a command.
pub(crate) enum Trouble {
    /// The driver reported an error.
    Driver(Error<io::Error>),
    /// The gripper answered so late that the command was not sent.
    Late(Duration),
    /// The line could not be opened.
    NoLine(anyhow::Error),
    /// A file could not be written.
    NoFile(anyhow::Error),
    /// The protocol does not support the command, or a script has invalid lines.
    Usage(String),
    /// A grip in a script found no part, which ends the script.
    NoPart,
    /// Standard input, standard output or a file failed.
    Output(io::Error),
    /// A signal was caught.
    Caught(Caught),
    /// The fingers may still be moving: the stop at the end failed.
    NotStopped(Error<io::Error>),
    Panicked(Box<dyn Any + Send>),
}

/// The exit statuses, for the help and docs/tool.md.
pub(crate) const EXIT_STATUSES: &[(u8, &str)] = &[
    (0, "success; after a grip: a part is held"),
    (1, "any other error, such as an unreadable file"),
    (2, "invalid command line, script line or parameter"),
    (3, "no part gripped"),
    (4, "refused by the gripper; the message explains its status"),
    (5, "the motion started but failed: blocked or aborted"),
    (6, "no connection, or time-out"),
    (130, "interrupted by Ctrl-C, after stopping the fingers; 143 for SIGTERM, 129 for SIGHUP"),
];

impl Outcome {
    pub(crate) const fn exit_status(self) -> u8 {
        match self {
            Self::Done | Self::Held => 0,
            Self::NoPart => 3,
        }
    }
}

impl Trouble {
    pub(crate) const fn exit_status(&self) -> u8 {
        match self {
            Self::Driver(error) => match error {
                Error::Refused(_) | Error::NotSetBack(_) | Error::Mismatch => 4,
                Error::Blocked | Error::Aborted | Error::Failed(_) => 5,
                Error::Invalid(_) | Error::OutOfLimits(_) | Error::NotInGcl | Error::NoForceLimit => 2,
                Error::NotConnected | Error::Unanswered | Error::Transport(_) | Error::Closed => 6,
                _ => 1,
            },
            Self::Late(_) | Self::NoLine(_) | Self::NotStopped(_) => 6,
            Self::Usage(_) => 2,
            Self::NoPart => Outcome::NoPart.exit_status(),
            Self::NoFile(_) | Self::Output(_) | Self::Panicked(_) => 1,
            Self::Caught(Caught(signal)) => 128_u8.saturating_add(*signal),
        }
    }

    /// Returns whether the connection or the program cannot continue after this error.
    pub(crate) const fn is_final(&self) -> bool {
        match self {
            Self::Driver(error) => matches!(error, Error::Transport(_) | Error::Closed),
            Self::NoLine(_)
            | Self::NotStopped(_)
            | Self::NoFile(_)
            | Self::Output(_)
            | Self::Caught(_)
            | Self::Panicked(_) => true,
            Self::Late(_) | Self::Usage(_) | Self::NoPart => false,
        }
    }

    /// Returns whether the reader of the output has closed its pipe.
    pub(crate) fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(error) if error.kind() == io::ErrorKind::BrokenPipe)
    }

    pub(crate) fn to_json(&self, command: &str) -> Value {
        let status = self.status();
        json!({
            "command": command,
            "result": self.name(),
            "status": status.map(Status::symbol),
            "status_code": status.map(Status::code),
            "message": self.to_string(),
        })
    }

    /// Returns the gripper's status code that caused the error.
    const fn status(&self) -> Option<Status> {
        match self {
            Self::Driver(Error::Refused(status) | Error::NotSetBack(status) | Error::Failed(status)) => {
                Some(*status)
            }
            Self::Driver(Error::Blocked) => Some(Status::AxisBlocked),
            Self::Driver(Error::Aborted) => Some(Status::CmdAborted),
            _ => None,
        }
    }

    /// The value of `result` in JSON.
    const fn name(&self) -> &'static str {
        match self.exit_status() {
            2 => "wrong_use",
            3 => "no_part",
            4 => "refused",
            5 => "failed",
            6 => "no_connection",
            128.. => "interrupted",
            _ => "error",
        }
    }
}

impl From<Error<io::Error>> for Trouble {
    fn from(error: Error<io::Error>) -> Self {
        let Error::Transport(error) = error else { return Self::Driver(error) };
        // The line also passes on signals and log errors as transport errors.
        let inner = error.get_ref();
        if let Some(signal) = inner.and_then(|inner| inner.downcast_ref::<Caught>()) {
            Self::Caught(*signal)
        } else if let Some(Unlogged(kind)) = inner.and_then(|inner| inner.downcast_ref()) {
            Self::Output((*kind).into())
        } else {
            Self::Driver(Error::Transport(error))
        }
    }
}

impl From<io::Error> for Trouble {
    fn from(error: io::Error) -> Self {
        match error.get_ref().and_then(|inner| inner.downcast_ref::<Caught>()) {
            Some(signal) => Self::Caught(*signal),
            None => Self::Output(error),
        }
    }
}

impl Display for Trouble {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            // Only 62h and 72h are refused with this status (3.6.3). A grip without a part starts, then fails.
            Self::Driver(Error::Refused(status @ Status::CmdFailed)) => write!(
                f,
                "refused: {status}; only generic fingers have a switchable supply (check `finger-info`), and POWER_FAULT indicates a \
                 short circuit (check `finger-flags`)"
            ),
            Self::Driver(Error::Refused(status)) => {
                write!(f, "refused: {status}, {}", status.meaning())?;
                match status {
                    Status::NotInitialized => f.write_str("; run `home` first"),
                    Status::AccessDenied => f.write_str("; run `ack` when it is safe to move the fingers"),
                    _ => Ok(()),
                }
            }
            Self::Driver(Error::Failed(status)) => {
                write!(f, "the motion failed: {status}, {}", status.meaning())
            }
            Self::Driver(Error::OutOfLimits(refusal)) if refusal.quantity() == Quantity::Force => {
                write!(
                    f,
                    "{refusal}; `overdrive on` permits more on grippers with overdrive, but not over GCL"
                )
            }
            Self::Driver(Error::Mismatch) => f.write_str("the gripper applied a different value"),
            Self::Driver(Error::NoForceLimit) => {
                f.write_str("no force limit is set, and GCL needs one for each grip; pass `--force`")
            }
            Self::Driver(Error::NotConnected) => f.write_str("the gripper does not answer"),
            Self::Driver(Error::Closed) => f.write_str("the gripper closed the connection"),
            Self::Driver(error) => error.fmt(f),
            Self::NoFile(error) => write!(f, "{error:#}"),
            Self::Late(age) => write!(
                f,
                "the gripper answered only after {:.1} s; nothing was sent, because a command that could move the fingers must \
                 be sent within 1 s; run it again",
                age.as_secs_f32()
            ),
            Self::NoLine(error) => write!(f, "no connection: {error:#}"),
            Self::Usage(message) => f.write_str(message),
            Self::NotStopped(error) => write!(f, "the fingers may still be moving: the stop failed: {error}"),
            Self::NoPart => f.write_str("no part"),
            Self::Output(error) => error.fmt(f),
            Self::Caught(Caught(_)) => f.write_str("interrupted by a signal"),
            Self::Panicked(_) => f.write_str("internal error (panic)"),
        }
    }
}
