//! Proof that no panic can be reached: firmware, protocol and buses link with a panic handler that calls an undefined function.

use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use boards::BOARDS;

use crate::{
    firmware,
    probe::Profile,
    process, public_functions,
    setup::{TRIPLE, ThumbToolchain},
};

/// Name of the undefined function that the panic handler calls.
const UNDEFINED: &str = "a_panic_can_be_reached";

/// The program that contains every public function of the library crates.
const FUNCTIONS: &str = "functions";
const FEATURES: &str = "every-function,on-target";

/// Methods that traits provide, so rustdoc does not list them.
const PROVIDED: [&str; 5] = [
    "&[u8]::byte",
    "&[u8]::is_empty",
    "wsg_protocol::command::Command::is_empty",
    "wsg_protocol::frame::encoder::FrameEncoder::len",
    "wsg_protocol::reply::Reply::is_empty",
];

/// Checks firmware and crates at both opt-levels. A program that panics verifies the check itself.
pub(crate) fn check(toolchain: &ThumbToolchain<'_>) -> Result<()> {
    let functions = public_functions::of_crates(toolchain.workspace)?;
    let listed = public_functions::of_probe(toolchain.workspace)?;
    let missing = public_functions::missing(&functions, &listed);
    ensure!(
        missing.is_empty(),
        "public functions missing from host-tests/probes/src/bin/functions, so their panics are not checked: {}",
        missing.join(", ")
    );
    // rustdoc's JSON is unstable: a changed format must not hide functions.
    let mut unknown = listed.keys().filter(|path| !functions.contains_key(*path));
    if let Some(path) = unknown.find(|path| !PROVIDED.contains(&path.as_str())) {
        bail!("rustdoc does not list {path}, which host-tests/probes/src/bin/functions calls");
    }
    for profile in Profile::ALL {
        let level = format!("opt-level {}", profile.level);
        ensure!(
            panics(&mut toolchain.probe(TRIPLE, "panics", "on-target", profile))?,
            "the control program with a panic links at {level}: the check is ineffective"
        );
        let what = "protocol and buses, every public function";
        hold(what, &level, &mut toolchain.probe(TRIPLE, FUNCTIONS, FEATURES, profile))?;
        // The first profile's images are those that are tested and flashed.
        for board in &BOARDS {
            let mut firmware = toolchain.cargo("build", board.triple);
            firmware.args(firmware::selection(board, &[], profile.name));
            hold(board.name, &level, &mut firmware)?;
        }
    }
    println!(
        "panic paths: 0 in the firmware of each board and in {} public functions of protocol and buses, at opt-level s and 3 \
         (excluded: Display and Debug, which use core::fmt; Hash, which is used only on the host; and the futures of the async driver, which panic by \
         definition if polled after completion)",
        functions.values().sum::<usize>()
    );
    Ok(())
}

fn hold(what: &str, level: &str, build: &mut Command) -> Result<()> {
    ensure!(!panics(build)?, "a panic can be reached: {what}, {level}");
    Ok(())
}

/// Builds a program. Returns whether linking fails only because of the undefined function.
fn panics(build: &mut Command) -> Result<bool> {
    eprintln!("+ {}", process::shell_line(build));
    let output = build.stdin(Stdio::null()).output().context("cannot run cargo")?;
    let printed = String::from_utf8_lossy(&output.stderr);
    let is_undefined = printed.contains(UNDEFINED) && printed.contains("undefined symbol");
    let is_known = output.status.success() || is_undefined;
    ensure!(is_known, "the build failed for a reason other than a panic:\n{printed}");
    Ok(!output.status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(script: &str) -> Result<bool> {
        panics(Command::new("/bin/sh").args(["-c", script]))
    }

    #[test]
    fn only_the_undefined_symbol_counts_as_a_panic_path() {
        assert!(!verdict("exit 0").unwrap());
        let undefined = "echo 'rust-lld: error: undefined symbol: a_panic_can_be_reached' >&2; exit 1";
        assert!(verdict(undefined).unwrap());
        assert!(verdict("echo 'error[E0425]: no such function' >&2; exit 1").is_err());
    }
}
