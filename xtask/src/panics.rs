//! No panic can be reached: firmware and protocol link with a panic handler that calls what nobody defines.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use anyhow::{Context, Result, bail, ensure};

use crate::{
    firmware,
    probe::{Probes, Profile},
    process, public_functions,
};

/// What the panic handler calls.
const UNDEFINED: &str = "a_panic_can_be_reached";

/// The programs that call every public function of the protocol crate: name, features, what they stand for.
const PROGRAMS: [(&str, &str, &str); 5] = [
    ("protocol", "on-target", "protocol, every public function of the binary protocol and the fieldbus"),
    ("gcl", "on-target", "protocol's module gcl, every public function"),
    ("modbus", "modbus", "protocol's module modbus, every public function"),
    ("can", "can", "protocol's module can, every public function"),
    ("driver", "drivers", "protocol's blocking driver over both protocols, every public function"),
];

/// Whether a panic can be reached in a program.
#[derive(Debug, PartialEq)]
enum Outcome {
    /// It links.
    PanicFree,
    /// It does not, for the one reason.
    Panics,
}

/// Checks firmware and protocol at both opt-levels, and the check itself on a program that panics.
pub(crate) fn check(probes: &Probes<'_>) -> Result<()> {
    let functions = public_functions::of_folder(&probes.workspace.root.join("protocol/src"))?;
    let called = PROGRAMS.map(|(name, _, _)| read(&source_of(probes, name)));
    let called = called.into_iter().collect::<Result<String>>()?;
    let missing = public_functions::missing_in(&functions, &called);
    ensure!(
        missing.is_empty(),
        "public functions that no program of host-tests/probes calls, so nobody knows whether they can panic: {}",
        missing.join(", ")
    );
    for profile in Profile::ALL {
        let level = profile.opt_level();
        let control = outcome(&mut probes.cargo("build", "panics", "on-target", profile))?;
        ensure!(
            control == Outcome::Panics,
            "the program that panics links at {level}: this check checks nothing"
        );
        for (name, features, what) in PROGRAMS {
            hold(what, level, &mut probes.cargo("build", name, features, profile))?;
        }
        hold("firmware", level, &mut firmware_build(probes, profile))?;
    }
    println!(
        "panic paths: 0 in the firmware and in {} public functions of the protocol, at opt-level s and 3 (not \
         proved: text for persons, Display and Debug, which is core::fmt's; and the async driver's futures: one that is \
         polled after its end panics, by the language's rule)",
        functions.len()
    );
    Ok(())
}

fn hold(what: &str, level: &str, build: &mut Command) -> Result<()> {
    if outcome(build)? == Outcome::Panics {
        bail!("a panic can be reached: {what}, {level}");
    }
    Ok(())
}

fn firmware_build(probes: &Probes<'_>, profile: Profile) -> Command {
    let mut cargo = probes.toolchain.cargo(probes.workspace, "build");
    cargo.args(firmware::selection_for(&["prove-panic-free".to_owned()], profile.name()));
    // Apart from the image that is tested: this one is only linked.
    cargo.env("CARGO_TARGET_DIR", probes.workspace.target_dir.join("panics"));
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

fn source_of(probes: &Probes<'_>, name: &str) -> PathBuf {
    probes.workspace.root.join(format!("host-tests/probes/src/bin/{name}.rs"))
}

fn read(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
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
