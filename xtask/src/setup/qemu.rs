//! QEMU, with the machine of the default board.

use std::{fs, process::Command};

use anyhow::Result;

use super::apt::{self, Packages};
use crate::{board::MACHINE, process};

/// Returns whether the `qemu-system-arm` on PATH supports the machine.
pub(crate) fn has_machine() -> bool {
    process::answer(Command::new("qemu-system-arm").args(["-machine", "help"]))
        .is_some_and(|help| lists(&help, MACHINE))
}

/// Returns the packages to install. Debian bookworm needs its backports, because its own QEMU lacks the machine.
pub(crate) fn packages() -> Result<Packages> {
    let names = vec!["qemu-system-arm"];
    if !is_bookworm(&fs::read_to_string("/etc/os-release").unwrap_or_default()) {
        return Ok(Packages { names, release: None, source: None });
    }
    let backports = "bookworm-backports";
    Ok(Packages {
        names,
        release: Some(backports.to_owned()),
        source: apt::source_for("bookworm", backports)?,
    })
}

fn is_bookworm(os_release: &str) -> bool {
    let value = |name: &str| {
        os_release.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('=')).unwrap_or("")
    };
    value("ID").trim_matches('"') == "debian" && value("VERSION_CODENAME").trim_matches('"') == "bookworm"
}

/// Searches the output of `-machine help`, which lists each machine in a line, by name and description.
fn lists(help: &str, machine: &str) -> bool {
    help.lines().any(|line| line.split_whitespace().next() == Some(machine))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_is_found_by_its_whole_name() {
        let help = "Supported machines are:\nakita                Sharp SL-C1000 (Akita) PDA (PXA270)\n\
                    b-l475e-iot01a       B-L475E-IOT01A Discovery Kit (Cortex-M4)\n";

        assert!(lists(help, "b-l475e-iot01a"));
        assert!(!lists(help, "b-l475e"));
        assert!(!lists(help, "B-L475E-IOT01A"));
        assert!(!lists("", "b-l475e-iot01a"));
    }

    #[test]
    fn only_debian_bookworm_takes_the_backports() {
        assert!(is_bookworm("NAME=\"Debian\"\nVERSION_CODENAME=bookworm\nID=debian\n"));
        assert!(is_bookworm("ID=\"debian\"\nVERSION_CODENAME=\"bookworm\"\n"));
        assert!(!is_bookworm("ID=debian\nVERSION_CODENAME=trixie\n"));
        assert!(!is_bookworm("ID=ubuntu\nVERSION_CODENAME=noble\nID_LIKE=debian\n"));
        assert!(!is_bookworm(""));
    }
}
