//! Other people's programs that tests run beside ours: some from Debian, some from PyPI in a virtual environment of their
//! own, and some from npm below the target folder, where there is Node.js. Only `test` asks for them. What cannot be had is no
//! failure: `test` leaves its tests out, and says so.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result};

use super::{
    apt::{self, Packages},
    installing_is_forbidden, obstacle_to_installing, report,
};
use crate::{board::Board, process, workspace::Workspace};

/// The environment variables that tell the tests where the masters' Python is, and the packages from npm.
pub(crate) const PYTHON_VARIABLE: &str = "WSG_MODBUS_PYTHON";
pub(crate) const NODE_VARIABLE: &str = "WSG_MODBUS_NODE";

/// What says which packages there are, and in which versions; the environment that has them keeps a copy.
const REQUIREMENTS: [&str; 1] = ["requirements.txt"];
const NODE_PACKAGES: [&str; 2] = ["package.json", "package-lock.json"];

/// The masters from PyPI, as they stand in the names of the tests that need them.
const FROM_PYPI: [&str; 10] = [
    "pymodbus",
    "minimalmodbus",
    "modbus_tk",
    "canopen",
    "pyprofibus",
    "pytest",
    "profinet_py",
    "pnio_dcp",
    "scapy",
    "typos",
];

/// The packages from npm the same way: a master, and the emulator of the Pico.
const FROM_NPM: [&str; 3] = ["jsmodbus", "rp2040js", "sparkplug_payload"];

/// A program of Debian's: what it is called where it is missing, its name, its package.
pub(crate) type Program = (&'static str, &'static str, &'static str);

/// Debian's programs, called as in the names of the tests that need them.
const FROM_DEBIAN: [Program; 7] = [
    (NAMESPACES, "ip", "iproute2"),
    ("mbpoll", "mbpoll", "mbpoll"),
    ("by_hand_with_nc", "nc", "netcat-openbsd"),
    ("in_chromium", "chromium", "chromium"),
    ("tshark", "tshark", "tshark"),
    ("mosquitto", "mosquitto", "mosquitto"),
    ("mosquitto", "mosquitto_sub", "mosquitto-clients"),
];

/// As tests have it in their names that have networks of their own, which not every root may make.
const NAMESPACES: &str = "in_namespaces";

/// The masters on this machine, as far as they are not missing.
pub(crate) struct Masters {
    /// The Python that has them.
    pub(crate) python: PathBuf,
    /// The folder that Node.js finds them in.
    pub(crate) node: PathBuf,
    /// What is not there, as it stands in the names of the tests that need it: `mbpoll`, `modbus_tk`.
    pub(crate) missing: Vec<&'static str>,
}

/// Finds the masters, and installs what is missing where that may be.
pub(crate) fn provide(workspace: &Workspace) -> Masters {
    let lists = workspace.root.join("host-tests");
    let environment = workspace.target_dir.join("modbus-masters");
    let python = environment.join("bin/python");
    let has_python = || {
        is_of(&environment, &lists, &REQUIREMENTS)
            && process::answer(Command::new(&python).args(["-c", "import pymodbus"])).is_some()
    };
    if !has_python() && !installing_is_forbidden() {
        report(fill(&environment, &lists));
    }
    let mut missing = Vec::new();
    if !has_python() {
        missing.extend(FROM_PYPI);
    }
    let node = node(workspace);
    if node.is_none() {
        missing.extend(FROM_NPM);
    }
    missing.extend(lacking(&FROM_DEBIAN));
    if !missing.contains(&NAMESPACES)
        && process::answer(Command::new("unshare").args(["-n", "true"])).is_none()
    {
        missing.push(NAMESPACES);
    }
    Masters { python, node: node.unwrap_or_default(), missing }
}

/// The folder that Node.js finds the packages from npm in, which are installed where that may be.
pub(crate) fn node(workspace: &Workspace) -> Option<PathBuf> {
    let (lists, packages) =
        (workspace.root.join("host-tests"), workspace.target_dir.join("modbus-masters-node"));
    let node = packages.join("node_modules");
    let has_node = || {
        let mut start = Command::new("node");
        start.args(["-e", "require('jsmodbus'); require('rp2040js')"]).env("NODE_PATH", &node);
        is_of(&packages, &lists, &NODE_PACKAGES) && process::answer(&mut start).is_some()
    };
    if !has_node() && !installing_is_forbidden() && process::exists("npm") {
        report(fill_node(&packages, &lists));
    }
    has_node().then_some(node)
}

/// Tells a program that runs an emulator of this board where that is.
pub(crate) fn tell_emulator(workspace: &Workspace, board: &Board, program: &mut Command) -> Result<()> {
    if board.name == "pico" {
        let node = node(workspace).context("there is no Node.js with npm, for the emulator of the Pico")?;
        program.env(NODE_VARIABLE, node);
    }
    Ok(())
}

/// Installs those programs that are not there, where that may be; what those are called that still are not.
pub(crate) fn lacking(programs: &[Program]) -> Vec<&'static str> {
    let lacking = || programs.iter().filter(|(_, program, _)| !process::exists(program));
    let names: Vec<_> = lacking().map(|(_, _, package)| *package).collect();
    if !names.is_empty() && obstacle_to_installing().is_none() {
        report(apt::install(&[Packages { names, release: None, source: None }]));
    }
    lacking().map(|(name, ..)| *name).collect()
}

/// Makes the environment and puts the packages into it.
fn fill(environment: &Path, lists: &Path) -> Result<()> {
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
    process::run(pip.arg(lists.join(REQUIREMENTS[0])))?;
    copy(environment, lists, &REQUIREMENTS)
}

/// The same for the packages from npm: those of the lock file, without their install scripts.
fn fill_node(packages: &Path, lists: &Path) -> Result<()> {
    copy(packages, lists, &NODE_PACKAGES)?;
    let mut npm = Command::new("npm");
    process::run(npm.args(["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--prefix"]).arg(packages))
}

fn copy(environment: &Path, lists: &Path, names: &[&str]) -> Result<()> {
    fs::create_dir_all(environment)?;
    for name in names {
        fs::copy(lists.join(name), environment.join(name)).with_context(|| format!("cannot copy {name}"))?;
    }
    Ok(())
}

/// Whether the environment was made of these lists as they are now.
fn is_of(environment: &Path, lists: &Path, names: &[&str]) -> bool {
    let read = |folder: &Path, name| fs::read(folder.join(name)).ok();
    names.iter().all(|name| read(environment, name).is_some_and(|copy| read(lists, name) == Some(copy)))
}
