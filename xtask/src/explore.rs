//! Exploration of every order of events on the bridge, by an example of host-tests.

use anyhow::{Context, Result};
use lexopt::{Arg, Parser, ValueExt};

use crate::{process, workspace::Workspace};

/// Default number of states to explore.
pub(crate) const STATES: u64 = 100_000_000;

/// Parses `--states N`.
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

/// Explores up to this number of states. Fails if a property is violated, and prints the shortest violation.
pub(crate) fn run(workspace: &Workspace, states: u64) -> Result<()> {
    let mut cargo = workspace.cargo("run");
    cargo.args(["--quiet", "--release", "-p", "host-tests", "--example", "explore", "--"]);
    process::run(cargo.arg(states.to_string())).context("a property is violated; see the output above")
}
