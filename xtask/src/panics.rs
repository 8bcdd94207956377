//! No panic can be reached: firmware, protocol and buses link with a panic handler that calls what nobody defines.

use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};

use crate::{
    board::{BOARDS, Board},
    firmware,
    probe::{Probes, Profile},
    process, public_functions,
    setup::TRIPLE,
};

/// What the panic handler calls.
const UNDEFINED: &str = "a_panic_can_be_reached";

/// The program that holds every public function of the crates for boards.
const FUNCTIONS: &str = "functions";
const FEATURES: &str = "every-function,on-target";

/// Whether a panic can be reached in a program.
#[derive(Debug, PartialEq)]
enum Outcome {
    /// It links.
    PanicFree,
    /// It does not, for the one reason.
    Panics,
}

/// Checks firmware and crates at both opt-levels, and the check itself on a program that panics.
pub(crate) fn check(probes: &Probes<'_>) -> Result<()> {
    let functions = public_functions::of_crates(probes.workspace)?;
    let missing = public_functions::missing(&functions, &public_functions::of_probe(probes.workspace)?);
    ensure!(
        missing.is_empty(),
        "public functions that host-tests/probes/src/bin/functions does not name, so nobody knows whether they can panic: {}",
        missing.join(", ")
    );
    for profile in Profile::ALL {
        let level = profile.opt_level();
        let control = outcome(&mut probes.cargo(TRIPLE, "panics", "on-target", profile))?;
        ensure!(
            control == Outcome::Panics,
            "the program that panics links at {level}: this check checks nothing"
        );
        let what = "protocol and buses, every public function";
        hold(what, level, &mut probes.cargo(TRIPLE, FUNCTIONS, FEATURES, profile))?;
        for board in &BOARDS {
            hold(board.name, level, &mut firmware_build(probes, board, profile))?;
        }
    }
    println!(
        "panic paths: 0 in the firmware of each board and in {} public functions of protocol and buses, at opt-level s and 3 (not \
         proved: text for persons, Display and Debug, which is core::fmt's; Hash, which only the host uses; and the async driver's futures: one that is \
         polled after its end panics, by the language's rule)",
        functions.values().sum::<usize>()
    );
    Ok(())
}

fn hold(what: &str, level: &str, build: &mut Command) -> Result<()> {
    if outcome(build)? == Outcome::Panics {
        bail!("a panic can be reached: {what}, {level}");
    }
    Ok(())
}

fn firmware_build(probes: &Probes<'_>, board: &Board, profile: Profile) -> Command {
    let mut cargo = probes.toolchain.cargo(probes.workspace, "build", board.triple);
    cargo.args(firmware::selection_for(board, &["prove-panic-free".to_owned()], profile.name()));
    cargo
}

/// Builds, and tells a panic path from every other failure.
fn outcome(build: &mut Command) -> Result<Outcome> {
    eprintln!("+ {}", process::shell_line(build));
    let output = build.stdin(Stdio::null()).output().context("cannot run cargo")?;
    if output.status.success() {
        return Ok(Outcome::PanicFree);
    }
    let said = String::from_utf8_lossy(&output.stderr);
    if said.contains(UNDEFINED) && said.contains("undefined symbol") {
        return Ok(Outcome::Panics);
    }
    bail!("the build fails for another reason than a panic:\n{said}");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn says(script: &str) -> Result<Outcome> {
        outcome(Command::new("/bin/sh").args(["-c", script]))
    }

    #[test]
    fn only_the_undefined_symbol_counts_as_a_panic_path() {
        assert_eq!(says("exit 0").unwrap(), Outcome::PanicFree);
        let undefined = "echo 'rust-lld: error: undefined symbol: a_panic_can_be_reached' >&2; exit 1";
        assert_eq!(says(undefined).unwrap(), Outcome::Panics);
        assert!(says("echo 'error[E0425]: no such function' >&2; exit 1").is_err());
    }
}
