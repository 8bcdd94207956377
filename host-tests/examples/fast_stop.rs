//! Stopping time of the gripper under line faults: lost, changed, duplicated or inserted bytes. Prints a table row
//! per set of cases, and fails if a case exceeds its limit. Tries every millisecond and every byte:
//!
//! ```sh
//! cargo run --release -p host-tests --example fast_stop
//! ```
//!
//! `--every-fault` tries all values of each byte, which takes forty times as long; `--stride N` tries every N-th
//! case.

use std::process::ExitCode;

use host_tests::fault_sweep::Sweep;

fn main() -> ExitCode {
    let (mut stride, mut every_fault) = (1, false);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--every-fault" => every_fault = true,
            "--stride" => match arguments.next().and_then(|value| value.parse().ok()) {
                Some(value @ 1..) => stride = value,
                _ => return refuse("--stride expects a number of at least 1"),
            },
            other => return refuse(&format!("{other}: expected --stride N or --every-fault")),
        }
    }
    let mut is_held = true;
    println!("| fault | cases | median | worst | limit |\n|---|---|---|---|---|");
    for sweep in Sweep::all(stride, every_fault) {
        let times = sweep.run();
        let Some((worst_ms, case)) = times.worst() else { continue };
        println!(
            "| {} | {} | {} ms | {worst_ms} ms | {} ms |",
            sweep.name,
            times.cases(),
            times.median_ms(),
            sweep.limit_ms
        );
        if *worst_ms > sweep.limit_ms {
            is_held = false;
            eprintln!("fast_stop: not stopped within the limit: {case:?}");
        }
    }
    if is_held { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn refuse(why: &str) -> ExitCode {
    eprintln!("fast_stop: {why}");
    ExitCode::FAILURE
}
