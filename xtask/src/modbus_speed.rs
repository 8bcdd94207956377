//! What a MODBUS request for eight registers costs the server, in instructions, counted in the emulator.

use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::{process, setup::ThumbToolchain, workspace::Workspace};

const PROBE: &str = "modbus-request";

/// Instructions for a request and its answer, at opt-level 3.
const LIMIT: f64 = 600.0;

/// The profile that the limit is for, and the one that is flashed.
const PROFILES: [(&str, Option<f64>); 2] = [("firmware-o3", Some(LIMIT)), ("firmware", None)];

/// Builds the probe, runs it, prints its counts and fails past the limit.
pub(crate) fn check(workspace: &Workspace, toolchain: &ThumbToolchain) -> Result<()> {
    for (profile, limit) in PROFILES {
        let mut cargo = toolchain.cargo(workspace, "build");
        cargo.args(["-p", "wsg-probes", "--bin", PROBE, "--features", "bench", "--profile", profile]);
        process::run(&mut cargo)?;
        let mut qemu = Command::new("qemu-system-arm");
        qemu.args(["-M", "b-l475e-iot01a", "-display", "none", "-monitor", "none", "-serial", "null"]);
        qemu.args(["-no-reboot", "-icount", "shift=10", "-semihosting-config", "enable=on,target=native"]);
        qemu.arg("-kernel").arg(toolchain.output_dir(workspace, profile).join(PROBE));
        let said = process::answer(&mut qemu).with_context(|| format!("{PROBE} ({profile}) failed"))?;
        let mean = mean(&said).with_context(|| format!("{PROBE} ({profile}) told no count: {said:?}"))?;
        match limit {
            Some(limit) => {
                println!("instructions per request for 8 registers, {profile}: {mean:.0} of {limit:.0}");
                ensure!(mean <= limit, "{mean:.0} instructions are more than {limit:.0}");
            }
            None => println!("instructions per request for 8 registers, {profile}: {mean:.0}"),
        }
    }
    Ok(())
}

/// From `modbus-request INSTRUCTIONS REQUESTS`.
fn mean(said: &str) -> Option<f64> {
    let mut words = said.lines().find_map(|line| line.strip_prefix(PROBE))?.split_whitespace();
    let (instructions, requests): (f64, f64) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
    (requests > 0.0).then(|| instructions / requests)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_is_instructions_by_requests_and_nothing_without_them() {
        assert_eq!(mean("noise\nmodbus-request 38400 64\n"), Some(600.0));
        assert_eq!(mean("modbus-request 38400 0\n"), None);
        assert_eq!(mean("modbus-request 38400\n"), None);
        assert_eq!(mean(""), None);
    }
}
