//! Every order of events on the bridge: an example of host-tests.

use anyhow::{Context, Result};
use lexopt::{Arg, Parser, ValueExt};

use crate::{process, workspace::Workspace};

/// How many states are met when nothing else is said.
pub(crate) const STATES: u64 = 100_000_000;

/// `--states N`.
pub(crate) fn states(mut arguments: Parser) -> Result<u64> {
    let mut states = STATES;
    while let Some(argument) = arguments.next()? {
        match argument {
            Arg::Long("states") => states = arguments.value()?.parse()?,
            other => return Err(other.unexpected()).context("see `cargo xtask help`"),
        }
    }
    Ok(states)
}

/// Explores until so many states were met. Fails when a promise is broken; the shortest way to break it is printed.
pub(crate) fn run(workspace: &Workspace, states: u64) -> Result<()> {
    let mut cargo = workspace.cargo("run");
    cargo.args(["--quiet", "--release", "-p", "host-tests", "--example", "explore", "--"]);
    process::run(cargo.arg(states.to_string())).context("a promise is broken: the output shows how")
}
