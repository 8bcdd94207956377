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
//! Each test exits with a nonzero status if a limit is exceeded. `docs/figures.md` lists the limits.

mod figures;
mod flood;
mod noise;
mod sim;
mod updates;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;
use std::time::Duration;

/// Puts load on the servers of the virtual gripper
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    mode: Mode,
}

#[derive(Subcommand)]
enum Mode {
    /// 100 connections with updates of four values every 10 ms, while the fingers travel
    Updates {
        /// Duration in seconds
        #[arg(long, value_name = "N", default_value = "30", value_parser = seconds)]
        seconds: Duration,
        /// Number of pages that watch meanwhile
        #[arg(long, value_name = "N", default_value_t = 0)]
        pages: usize,
    },
    /// Clients that flood, hold incomplete frames, never read, connect and disconnect; how the others fare
    Flood {
        /// Duration in seconds
        #[arg(long, value_name = "N", default_value = "15", value_parser = seconds)]
        seconds: Duration,
    },
    /// Random bytes on every port; whether it still answers
    Noise {
        /// Duration in seconds
        #[arg(long, value_name = "N", default_value = "60", value_parser = seconds)]
        seconds: Duration,
    },
    /// The gripper process that the other modes start
    #[command(name = sim::SERVE, hide = true)]
    Serve {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        options: Vec<OsString>,
    },
}

fn seconds(text: &str) -> Result<Duration> {
    Ok(Duration::from_secs(text.parse::<u64>().context("expected a number of seconds")?.max(1)))
}

fn main() -> ExitCode {
    match run() {
        Ok(status) => status.into(),
        Err(error) => {
            eprintln!("load: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<u8> {
    match Arguments::parse().mode {
        Mode::Updates { seconds, pages } => updates::run(seconds, pages)?,
        Mode::Flood { seconds } => flood::run(seconds)?,
        Mode::Noise { seconds } => noise::run(seconds)?,
        Mode::Serve { options } => return Ok(wsg_sim::program::run(options)),
    }
    Ok(0)
}
