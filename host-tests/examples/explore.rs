//! Explores every order of events with a PLC on wires and a PLC on a bus; run by `cargo xtask explore`.
//!
//! ```sh
//! cargo run --release -p host-tests --example explore -- 100000000
//! ```

use std::process::ExitCode;
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result};
use host_tests::explore::{Bounds, PlcKind};

fn main() -> Result<ExitCode> {
    let states = std::env::args().nth(1).context("expected the number of states")?;
    let states: u64 = states.parse().with_context(|| format!("{states} is not a number of states"))?;
    let bounds = Bounds { depth: 8, states: states / PlcKind::ALL.len() as u64 };
    let explore = |plc: PlcKind| {
        let begun = Instant::now();
        (plc.explore(bounds), begun.elapsed().as_secs())
    };
    let reports = thread::scope(|threads| {
        let running = PlcKind::ALL.map(|plc| threads.spawn(move || explore(plc)));
        running.map(|thread| thread.join().expect("its panic was printed"))
    });
    let mut is_kept = true;
    for (report, seconds) in reports {
        println!("{report}\n{seconds} s; never seen: {:?}\n", report.unseen());
        is_kept &= report.broken().is_empty();
    }
    Ok(if is_kept { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
