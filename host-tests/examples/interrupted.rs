//! Runs a program while continually stopping and continuing it, as debuggers and shell job control do. Socket calls
//! with a time-out then return `Interrupted`, even without signal handlers. Returns the program's exit code.
//!
//! ```sh
//! cargo build -p host-tests --example interrupted
//! CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER=$PWD/target/debug/examples/interrupted cargo test -p wsg-sim --tests
//! ```

use std::process::ExitCode;

#[cfg(unix)]
fn main() -> anyhow::Result<ExitCode> {
    use anyhow::Context;
    use rustix::process::{Pid, Signal, kill_process};
    use std::process::Command;
    use std::thread::sleep;
    use std::time::Duration;

    /// Running time between two stops, and duration of a stop.
    const RUNS: Duration = Duration::from_millis(2);
    const STANDS: Duration = Duration::from_micros(200);

    let mut arguments = std::env::args_os().skip(1);
    let program = arguments.next().context("expected a program and its arguments")?;
    let mut child = Command::new(&program).args(arguments).spawn().context("cannot start the program")?;
    let pid = Pid::from_child(&child);
    loop {
        sleep(RUNS);
        // Until it is reaped, its process number cannot be reused.
        if let Some(status) = child.try_wait()? {
            // A program ended by a signal has no exit code.
            return Ok(status
                .code()
                .and_then(|code| u8::try_from(code).ok())
                .map_or(ExitCode::FAILURE, Into::into));
        }
        kill_process(pid, Signal::STOP)?;
        sleep(STANDS);
        kill_process(pid, Signal::CONT)?;
    }
}

#[cfg(not(unix))]
fn main() -> anyhow::Result<ExitCode> {
    anyhow::bail!("stopping and continuing programs requires Unix")
}
