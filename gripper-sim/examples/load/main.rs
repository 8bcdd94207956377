//! Load tests of the servers. The gripper runs in a separate process, so that its CPU time and memory can be measured
//! separately from the clients. Linux only.
//!
//! ```sh
//! cargo run --release -p wsg-sim --example load -- updates --seconds 30
//! cargo run --release -p wsg-sim --example load -- updates --seconds 30 --pages 50
//! cargo run --release -p wsg-sim --example load -- flood --seconds 15
//! cargo run --release -p wsg-sim --example load -- noise --seconds 60
//! ```
//!
//! Each test exits with a nonzero status if a limit is exceeded. `docs/simulator.md` lists the limits.

mod figures;
mod flood;
mod noise;
mod sim;
mod updates;

use anyhow::{Context, Result, bail};
use lexopt::{Arg, Parser, ValueExt};
use std::process::ExitCode;
use std::time::Duration;

const USAGE: &str = "\
Puts load on the servers of the virtual gripper.

Usage: load updates|flood|noise [--seconds N] [--pages N]

  updates   100 connections with updates of four values every 10 ms, while the fingers travel (30 s)
  flood     clients that flood, hold half frames, never read, come and go; how the others fare (15 s)
  noise     random bytes on every port; whether it still answers (60 s)

  --pages N with updates: so many pages watch meanwhile (0)
";

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("load: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<()> {
    let mut parser = Parser::from_env();
    let mut seconds = None;
    let mut mode = None;
    let mut pages = 0;
    while let Some(argument) = parser.next()? {
        match argument {
            Arg::Long("seconds") => {
                seconds = Some(parser.value()?.parse().context("--seconds expects a number")?)
            }
            Arg::Long("pages") => pages = parser.value()?.parse().context("--pages expects a number")?,
            Arg::Long("help") => {
                print!("{USAGE}");
                return Ok(());
            }
            Arg::Value(value) if mode.is_none() => mode = Some(value.string()?),
            _ => return Err(argument.unexpected().into()),
        }
    }
    let lasting = |usual: u64| Duration::from_secs(seconds.unwrap_or(usual).max(1));
    match mode.as_deref() {
        Some("updates") => updates::run(lasting(30), pages),
        Some("flood") => flood::run(lasting(15)),
        Some("noise") => noise::run(lasting(60)),
        // The gripper process started by the modes above.
        Some(sim::SERVE) => sim::serve(),
        _ => bail!("expected updates, flood or noise; --help says more"),
    }
}
