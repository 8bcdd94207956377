//! Third-party masters of Modbus and CANopen: `mbpoll` from Debian, the others from PyPI in a virtual environment of their
//! own. Only `test` asks for them. What cannot be had is no failure: `test` leaves its tests out, and says so.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result};

use super::{
    apt::{self, Packages},
    find_or_install, installing_is_forbidden, obstacle_to_installing, report,
};
use crate::{process, workspace::Workspace};

/// The environment variable that tells the tests where the masters' Python is.
pub(crate) const PYTHON_VARIABLE: &str = "WSG_MODBUS_PYTHON";

/// Packages and versions, one `name==version --hash=..` a line.
const REQUIREMENTS: &str = "host-tests/requirements.txt";

/// Packages that masters need, and no test by itself.
const NO_MASTERS: [&str; 5] = ["pyserial", "python-can", "packaging", "typing-extensions", "wrapt"];

/// The masters on this machine.
pub(crate) struct Masters {
    /// The Python that has them, if they are not missing.
    pub(crate) python: PathBuf,
    missing: Vec<String>,
}

impl Masters {
    /// What is not there, as it stands in the names of the tests that need it: `mbpoll`, `modbus_tk`.
    pub(crate) fn missing(&self) -> &[String] {
        &self.missing
    }
}

/// Finds the masters, and installs what is missing where that may be.
pub(crate) fn provide(workspace: &Workspace) -> Result<Masters> {
    let list = workspace.root.join(REQUIREMENTS);
    let list = fs::read_to_string(&list).with_context(|| format!("cannot read {}", list.display()))?;
    let requirements = requirements(&list);
    let environment = workspace.target_dir.join("modbus-masters");
    let python = environment.join("bin/python");
    let has_mbpoll = find_or_install("mbpoll", "mbpoll");
    if !lacking(&python, &requirements).is_empty() && !installing_is_forbidden() {
        report(fill(workspace, &environment));
    }
    let mut missing = Vec::new();
    if !lacking(&python, &requirements).is_empty() {
        // All of them: they share what is no master.
        let masters = requirements.iter().filter(|(name, _)| !NO_MASTERS.contains(name));
        missing.extend(masters.map(|(name, _)| name.replace('-', "_")));
    }
    if !has_mbpoll {
        missing.push("mbpoll".to_owned());
    }
    Ok(Masters { python, missing })
}

/// Makes the environment and puts the packages into it.
fn fill(workspace: &Workspace, environment: &Path) -> Result<()> {
    let make = |python: &str| {
        // What is left of one that was not finished, or whose Python is gone, must not be built upon.
        process::run(Command::new(python).args(["-m", "venv", "--clear"]).arg(environment))
    };
    if make("python3").is_err() {
        // Debian keeps `venv` in a package of its own.
        anyhow::ensure!(obstacle_to_installing().is_none(), "there is no python3 that makes an environment");
        apt::install(&[Packages::of("python3-venv")])?;
        make("/usr/bin/python3")?;
    }
    let mut pip = Command::new(environment.join("bin/python"));
    pip.args(["-m", "pip", "--disable-pip-version-check", "install", "--require-hashes"]);
    pip.args(["--no-deps", "--only-binary", ":all:", "--requirement"]);
    process::run(pip.arg(workspace.root.join(REQUIREMENTS)))
}

/// Names and versions of a requirements file.
fn requirements(text: &str) -> Vec<(&str, &str)> {
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.filter_map(|line| line.split_whitespace().next()?.split_once("==")).collect()
}

/// The packages that this Python lacks, or has in another version; all without that Python.
fn lacking<'a>(python: &Path, requirements: &[(&'a str, &str)]) -> Vec<&'a str> {
    let script =
        "import importlib.metadata as m\nfor d in m.distributions(): print(d.metadata['Name'], d.version)";
    let installed = process::answer(Command::new(python).args(["-c", script])).unwrap_or_default();
    let has = |name: &str, version: &str| {
        installed.lines().filter_map(|line| line.split_once(' ')).any(|(its_name, its_version)| {
            its_name.to_lowercase().replace('_', "-") == name && its_version == version
        })
    };
    requirements.iter().filter(|(name, version)| !has(name, version)).map(|(name, _)| *name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requirements_are_names_and_versions() {
        let text = "# a comment\npymodbus==3.16.1 --hash=sha256:00\n\nmodbus-tk==1.1.5 --hash=sha256:11\n";

        assert_eq!(requirements(text), [("pymodbus", "3.16.1"), ("modbus-tk", "1.1.5")]);
    }

    #[test]
    fn a_python_that_is_not_there_lacks_everything() {
        let lacks = lacking(Path::new("/no/such/python"), &[("pymodbus", "3.16.1"), ("pyserial", "3.5")]);

        assert_eq!(lacks, ["pymodbus", "pyserial"]);
    }
}
