//! Runs a program and stops and continues it all the time, as debuggers and jobs of a shell do: calls that wait on a socket
//! with a time-out give `Interrupted` then, without any handler in the program. It ends as the program ends.
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

    /// How long it runs between two stops, and stands in each.
    const RUNS: Duration = Duration::from_millis(2);
    const STANDS: Duration = Duration::from_micros(200);

    let mut arguments = std::env::args_os().skip(1);
    let program = arguments.next().context("which program? Its arguments follow")?;
    let mut child = Command::new(&program).args(arguments).spawn().context("it does not start")?;
    let pid = Pid::from_child(&child);
    loop {
        sleep(RUNS);
        // Until it is waited for, its number is nobody else's.
        if let Some(status) = child.try_wait()? {
            // A program that a signal ended has no code of its own.
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
    anyhow::bail!("only Unix stops and continues programs")
}
