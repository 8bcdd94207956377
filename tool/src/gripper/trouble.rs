//! Why a command came to nothing: in words, in JSON, and as an exit status.

use std::any::Any;
use std::fmt::{self, Display, Formatter};
use std::io;

use serde_json::{Value, json};
use wsg_protocol::Status;
use wsg_protocol::driver::Error;

use super::answer::Outcome;
use super::record::Unlogged;
use super::signals::Caught;

/// Why a command came to nothing.
pub(crate) enum Trouble {
    /// The driver's.
    Driver(Error<io::Error>),
    /// The line cannot be opened.
    NoLine(anyhow::Error),
    /// A file cannot be written.
    NoFile(anyhow::Error),
    /// The protocol cannot say it, or a line of a script is none.
    Usage(String),
    /// A script goes no further without one.
    NoPart,
    /// The gripper took another value; which it takes.
    Clamped(String),
    /// What cannot be written or read here.
    Output(io::Error),
    /// A signal.
    Caught(Caught),
    /// The fingers were to be stopped, and it is not known that they were.
    NotStopped(Error<io::Error>),
    /// This program's.
    Panicked(Box<dyn Any + Send>),
}

/// Statuses that the program exits with, for the help and the document.
pub(crate) const EXIT_STATUSES: &[(u8, &str)] = &[
    (0, "done; a part is held"),
    (1, "anything else, such as a file that cannot be read"),
    (2, "wrong use"),
    (3, "no part"),
    (4, "refused by the gripper, with its status in words"),
    (5, "the motion began and failed: blocked, aborted"),
    (6, "no connection, or no answer in time"),
    (130, "ended by Ctrl-C, after the fingers were stopped; 143 by SIGTERM, 129 by SIGHUP"),
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
                Error::Refused(_) | Error::Mismatch => 4,
                Error::Blocked | Error::Aborted | Error::Failed(_) => 5,
                Error::Invalid(_) | Error::NotInGcl | Error::NoForceLimit => 2,
                Error::NotConnected | Error::Unanswered | Error::Transport(_) | Error::Closed => 6,
                _ => 1,
            },
            Self::NoLine(_) | Self::NotStopped(_) => 6,
            Self::Usage(_) => 2,
            Self::Clamped(_) => 4,
            Self::NoPart => Outcome::NoPart.exit_status(),
            Self::NoFile(_) | Self::Output(_) | Self::Panicked(_) => 1,
            Self::Caught(Caught(signal)) => 128_u8.saturating_add(*signal),
        }
    }

    /// Whether nothing else can be done on this connection.
    pub(crate) const fn is_final(&self) -> bool {
        match self {
            Self::Driver(error) => matches!(error, Error::Transport(_) | Error::Closed),
            Self::NoLine(_)
            | Self::NotStopped(_)
            | Self::NoFile(_)
            | Self::Output(_)
            | Self::Caught(_)
            | Self::Panicked(_) => true,
            Self::Usage(_) | Self::Clamped(_) | Self::NoPart => false,
        }
    }

    /// Whether nobody reads what is written here any more.
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

    /// The gripper's status behind it.
    const fn status(&self) -> Option<Status> {
        match self {
            Self::Driver(Error::Refused(status) | Error::Failed(status)) => Some(*status),
            Self::Driver(Error::Blocked) => Some(Status::AxisBlocked),
            Self::Driver(Error::Aborted) => Some(Status::CmdAborted),
            _ => None,
        }
    }

    /// In JSON.
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
        // Not all that comes from the line is the transport's.
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
            // Only 62h and 72h are refused so (3.6.3): a grip without a part begins, and fails.
            Self::Driver(Error::Refused(status @ Status::CmdFailed)) => write!(
                f,
                "refused: {status}; the gripper switches the supply of generic fingers only (`finger-info`), and a finger with \
                 POWER_FAULT is short-circuited (`finger-flags`)"
            ),
            Self::Driver(Error::Refused(status)) => {
                write!(f, "refused: {status}, {}", status.meaning())?;
                match status {
                    Status::NotInitialized => f.write_str("; `home` first"),
                    Status::AccessDenied => f.write_str("; when the fingers may move: `ack`"),
                    _ => Ok(()),
                }
            }
            Self::Driver(Error::Failed(status)) => {
                write!(f, "the motion failed: {status}, {}", status.meaning())
            }
            Self::Driver(Error::Mismatch) => f.write_str("the gripper took another value than this one"),
            Self::Driver(Error::NoForceLimit) => {
                f.write_str("over GCL each grip states its force: `--force`")
            }
            Self::Driver(Error::NotConnected) => f.write_str("the gripper does not answer"),
            Self::Driver(Error::Closed) => f.write_str("the gripper has closed the connection"),
            Self::Driver(error) => error.fmt(f),
            Self::NoFile(error) => write!(f, "{error:#}"),
            Self::NoLine(error) => write!(f, "no connection: {error:#}"),
            Self::Usage(message) | Self::Clamped(message) => f.write_str(message),
            Self::NotStopped(error) => write!(f, "whether the fingers were stopped is not known: {error}"),
            Self::NoPart => f.write_str("no part"),
            Self::Output(error) => error.fmt(f),
            Self::Caught(Caught(_)) => f.write_str("ended by a signal"),
            Self::Panicked(_) => f.write_str("a fault of this program"),
        }
    }
}
