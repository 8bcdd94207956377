//! Explores every order of events, beside a PLC with wires and beside one with a bus: `cargo xtask explore` runs it.
//!
//! ```sh
//! cargo run --release -p host-tests --example explore -- 100000000
//! ```

use std::process::ExitCode;
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result};
use host_tests::explore::{Bounds, Plc};

fn main() -> Result<ExitCode> {
    let states = std::env::args().nth(1).context("how many states? One number is expected")?;
    let states: u64 = states.parse().with_context(|| format!("{states} is no number of states"))?;
    let bounds = Bounds { depth: 8, states: states / Plc::ALL.len() as u64 };
    let explore = |plc: Plc| {
        let begun = Instant::now();
        (plc.explore(bounds), begun.elapsed().as_secs())
    };
    let reports = thread::scope(|threads| {
        let running = Plc::ALL.map(|plc| threads.spawn(move || explore(plc)));
        running.map(|thread| thread.join().expect("its panic was printed"))
    });
    let mut is_kept = true;
    for (report, seconds) in reports {
        println!("{report}\n{seconds} s; never seen: {:?}\n", report.unseen());
        is_kept &= report.broken().is_empty();
    }
    Ok(if is_kept { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
