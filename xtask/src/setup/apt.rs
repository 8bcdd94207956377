//! Debian packages: finds the apt sources of this machine, and installs missing packages.

use std::{fs, process::Command};

use anyhow::{Context, Result};

use crate::process;

/// The release whose own QEMU lacks the machine, its backports, which have it, and the file that adds them to the apt sources.
const BOOKWORM: &str = "bookworm";
const BACKPORTS: &str = "bookworm-backports";
const SOURCE: &str = "/etc/apt/sources.list.d/wsg-bookworm-backports.sources";

/// Keyring that signs all Debian mirrors.
const KEYRING: &str = "/usr/share/keyrings/debian-archive-keyring.gpg";

/// Missing packages and where to install them from.
pub(super) struct Packages {
    /// Names of the packages.
    names: Vec<&'static str>,
    /// Whether to install them from the backports instead of the machine's own release.
    from_backports: bool,
    /// Mirror of the backports, if the machine's apt sources lack them.
    mirror: Option<String>,
}

impl Packages {
    /// Returns packages of the machine's own release.
    pub(super) fn of(names: Vec<&'static str>) -> Self {
        Self { names, from_backports: false, mirror: None }
    }

    /// Returns QEMU, on Debian bookworm from its backports.
    pub(super) fn qemu() -> Result<Self> {
        let names = vec!["qemu-system-arm"];
        let mut release = Command::new("sh");
        release.args(["-c", ". /etc/os-release && echo $ID $VERSION_CODENAME"]);
        if process::answer(&mut release).is_none_or(|it| it.trim() != format!("debian {BOOKWORM}")) {
            return Ok(Self::of(names));
        }
        let mut sources = Command::new("apt-get");
        // Works without package lists, which a fresh machine does not have.
        sources.args(["indextargets", "--no-release-info", "--format", "$(RELEASE) $(REPO_URI)"]);
        sources.args(["Created-By: Packages", "Component: main"]);
        let listed = process::answer(&mut sources).context("`apt-get indextargets` lists no sources")?;
        Ok(Self { names, from_backports: true, mirror: missing_mirror(&listed)? })
    }
}

/// Returns the mirror from which to add the backports, or `None` if the machine already has them. Uses the mirror of the release, so
/// that a machine with a local mirror keeps using it. The list has a suite and a mirror per line.
fn missing_mirror(listed: &str) -> Result<Option<String>> {
    let mut sources = listed.lines().filter_map(|line| line.split_once(' '));
    if sources.clone().any(|(suite, _)| suite == BACKPORTS) {
        return Ok(None);
    }
    // A CD does not contain the backports.
    let found = sources.find(|(suite, uri)| *suite == BOOKWORM && !uri.starts_with("cdrom:"));
    let (_, uri) = found.with_context(|| {
        format!(
            "no apt source serves {BOOKWORM} main, so the mirror for {BACKPORTS} is unknown; \
             add {BACKPORTS} to the apt sources manually"
        )
    })?;
    Ok(Some(uri.to_owned()))
}

/// Installs the packages, printing each command first.
pub(super) fn install(wanted: &[Packages]) -> Result<()> {
    let run = |line: &String| {
        process::run(Command::new("sh").args(["-c", line]))
            .with_context(|| format!("correct what apt reports above, or run `{line}` yourself"))
    };
    let outcome = shell_lines(wanted).iter().try_for_each(run);
    if outcome.is_err() && wanted.iter().any(|packages| packages.mirror.is_some()) {
        // A broken source would fail every later `apt-get update` on this machine.
        fs::remove_file(SOURCE).with_context(|| format!("cannot remove {SOURCE}"))?;
    }
    outcome
}

/// Returns the commands that install the packages.
pub(super) fn shell_lines(wanted: &[Packages]) -> Vec<String> {
    let sources = wanted.iter().filter_map(|packages| packages.mirror.as_ref()).map(|mirror| {
        format!(
            r"printf '%s\n' 'Types: deb' 'URIs: {mirror}' 'Suites: {BACKPORTS}' 'Components: main' 'Signed-By: {KEYRING}' > {SOURCE}"
        )
    });
    let installs = wanted.iter().map(|Packages { names, from_backports, .. }| {
        let release = if *from_backports { format!("-t {BACKPORTS} ") } else { String::new() };
        let install = "DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends";
        format!("{install} {release}{}", names.join(" "))
    });
    sources.chain(["apt-get update".to_owned()]).chain(installs).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backports_are_added_from_the_mirror_that_the_machine_uses() {
        let listed = "bookworm cdrom:[Debian]/\nbookworm-security http://b.example/security/\n\
                      bookworm http://a.example/debian/\n";

        assert_eq!(missing_mirror(listed).unwrap().unwrap(), "http://a.example/debian/");
        assert_eq!(missing_mirror(&format!("{listed}bookworm-backports http://a.example/\n")).unwrap(), None);
        let error = missing_mirror("").unwrap_err().to_string();
        assert!(error.contains("add bookworm-backports to the apt sources manually"), "{error}");
    }

    #[test]
    fn steps_write_the_source_update_once_and_install() {
        let mirror = Some("http://a.example/debian/".to_owned());
        let qemu = Packages { names: vec!["qemu"], from_backports: true, mirror };

        let lines = shell_lines(&[Packages::of(vec!["lld", "rustc-web"]), qemu]);

        let install = "DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends";
        let expected = [
            "apt-get update".to_owned(),
            format!("{install} lld rustc-web"),
            format!("{install} -t bookworm-backports qemu"),
        ];
        assert!(lines[0].contains("'URIs: http://a.example/debian/'") && lines[0].ends_with(SOURCE));
        assert_eq!(lines[1..], expected);
    }
}
