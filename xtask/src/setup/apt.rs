//! Debian packages: finds the apt sources of this machine, and installs missing packages.

use std::{fs, path::PathBuf, process::Command};

use anyhow::{Context, Result};

use crate::process;

/// Keyring that signs all Debian mirrors.
const KEYRING: &str = "/usr/share/keyrings/debian-archive-keyring.gpg";

/// Missing packages and the release to install them from.
pub(crate) struct Packages {
    /// Names of the packages.
    pub(crate) names: Vec<&'static str>,
    /// Release for `apt-get install -t`, or `None` for the machine's own release.
    pub(crate) release: Option<String>,
    /// Apt source to add first, if the machine does not have that release.
    pub(crate) source: Option<SourceFile>,
}

impl Packages {
    /// Returns a package from the machine's own release.
    pub(super) fn of(name: &'static str) -> Self {
        Self { names: vec![name], release: None, source: None }
    }
}

/// An additional file in `/etc/apt/sources.list.d`.
#[derive(Debug, PartialEq)]
pub(crate) struct SourceFile {
    path: PathBuf,
    lines: Vec<String>,
}

impl SourceFile {
    fn shell_line(&self) -> String {
        let lines: Vec<String> = self.lines.iter().map(process::quoted).collect();
        format!(r"printf '%s\n' {} > {}", lines.join(" "), self.path.display())
    }

    fn write(&self) -> Result<()> {
        eprintln!("+ {}", self.shell_line());
        fs::write(&self.path, self.lines.join("\n") + "\n")
            .with_context(|| format!("cannot write the apt source {}", self.path.display()))
    }
}

/// Installs the packages, printing each command first.
pub(crate) fn install(wanted: &[Packages]) -> Result<()> {
    let added: Vec<&SourceFile> = wanted.iter().filter_map(|packages| packages.source.as_ref()).collect();
    for source in &added {
        source.write()?;
    }
    if let Err(error) = process::run(&mut update()) {
        // Remove the new source, because a broken one would fail every later `apt-get update` on this machine.
        for source in &added {
            fs::remove_file(&source.path)
                .with_context(|| format!("cannot remove {}", source.path.display()))?;
        }
        return Err(error.context("apt cannot read its sources; repair them and run the command again"));
    }
    wanted.iter().try_for_each(|packages| process::run(&mut packages.install_command()))
}

/// Returns the commands that [`install`] would run, for the user to type.
pub(crate) fn shell_lines(wanted: &[Packages]) -> Vec<String> {
    let sources = wanted.iter().filter_map(|packages| packages.source.as_ref()).map(SourceFile::shell_line);
    let installs = wanted.iter().map(|packages| process::shell_line(&packages.install_command()));
    sources.chain([process::shell_line(&update())]).chain(installs).collect()
}

impl Packages {
    fn install_command(&self) -> Command {
        let mut command = Command::new("apt-get");
        command.env("DEBIAN_FRONTEND", "noninteractive");
        command.args(["install", "--yes", "--no-install-recommends"]);
        if let Some(release) = &self.release {
            command.args(["-t", release]);
        }
        command.args(&self.names);
        command
    }
}

fn update() -> Command {
    let mut command = Command::new("apt-get");
    command.arg("update");
    command
}

/// Returns the source file to add for `suite`, or `None` if the machine already has it.
///
/// Uses the mirror of `base_suite`, so that a machine with a local mirror keeps using it.
pub(crate) fn source_for(base_suite: &str, suite: &str) -> Result<Option<SourceFile>> {
    let mut sources = Command::new("apt-get");
    // Works without package lists, which a fresh machine does not have.
    sources.args(["indextargets", "--no-release-info", "--format", "$(RELEASE) $(REPO_URI)"]);
    sources.args(["Created-By: Packages", "Component: main"]);
    let listed = process::answer(&mut sources).context("`apt-get indextargets` lists no sources")?;
    source_beside(&listed, base_suite, suite)
}

/// The same for a list of apt sources, with a suite and a mirror per line.
fn source_beside(listed: &str, base_suite: &str, suite: &str) -> Result<Option<SourceFile>> {
    // A CD does not contain the backports.
    let mut sources =
        listed.lines().filter_map(|line| line.split_once(' ')).filter(|(_, uri)| !uri.starts_with("cdrom:"));
    if sources.clone().any(|(its, _)| its == suite) {
        return Ok(None);
    }
    let (_, uri) = sources.find(|(its, _)| *its == base_suite).with_context(|| {
        format!(
            "no apt source serves {base_suite} main, so the mirror for {suite} is unknown; \
             add {suite} to the apt sources manually"
        )
    })?;
    let lines = vec![
        "Types: deb".to_owned(),
        format!("URIs: {uri}"),
        format!("Suites: {suite}"),
        "Components: main".to_owned(),
        format!("Signed-By: {KEYRING}"),
    ];
    let path = PathBuf::from(format!("/etc/apt/sources.list.d/wsg-{suite}.sources"));
    Ok(Some(SourceFile { path, lines }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backports_come_from_the_mirror_that_the_machine_uses() {
        let listed = "bookworm cdrom:[Debian]/\nbookworm-security http://b.example/security/\n\
                      bookworm http://a.example/debian/\n";

        let source = source_beside(listed, "bookworm", "bookworm-backports").unwrap().unwrap();

        assert!(source.lines.contains(&"URIs: http://a.example/debian/".to_owned()), "{source:?}");
        assert!(source.path.ends_with("wsg-bookworm-backports.sources"));
    }

    #[test]
    fn backports_that_the_machine_has_are_not_added() {
        let listed = "bookworm http://a.example/debian/\nbookworm-backports http://a.example/debian/\n";
        assert_eq!(source_beside(listed, "bookworm", "bookworm-backports").unwrap(), None);
    }

    #[test]
    fn steps_for_a_person_write_the_source_update_once_and_install() {
        let source = SourceFile { path: "/etc/x.sources".into(), lines: vec!["Types: deb".into()] };
        let wanted = [
            Packages { names: vec!["lld"], release: None, source: None },
            Packages { names: vec!["qemu"], release: Some("r-backports".into()), source: Some(source) },
        ];

        let install = "DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends";
        let expected = [
            r"printf '%s\n' 'Types: deb' > /etc/x.sources".to_owned(),
            "apt-get update".to_owned(),
            format!("{install} lld"),
            format!("{install} -t r-backports qemu"),
        ];
        assert_eq!(shell_lines(&wanted), expected);
    }

    #[test]
    fn without_a_mirror_the_user_is_told_what_to_add() {
        let error = source_beside("", "bookworm", "bookworm-backports").unwrap_err().to_string();
        assert!(error.contains("add bookworm-backports to the apt sources manually"), "{error}");
    }
}
