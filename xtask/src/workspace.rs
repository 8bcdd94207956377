//! The workspace: its folder, its build folder, and the calling cargo.

use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result};
use serde_json::Value;

use crate::process;

/// Packages of the library crates for boards: built for each target, panic-free, published. Each crate follows its dependencies.
pub(crate) const TARGET_CRATES: [&str; 8] = [
    "bus-modbus",
    "bus-slcan",
    "bus-canopen",
    "bus-profibus",
    "bus-profinet",
    "bus-ethernetip",
    "wsg-protocol",
    "wsg-fieldbus",
];

/// The workspace in which `cargo xtask` was called.
pub(crate) struct Workspace {
    /// Folder of the workspace's `Cargo.toml`.
    pub(crate) root: PathBuf,
    /// Build folder: `CARGO_TARGET_DIR`, or `target` in the root.
    pub(crate) target_dir: PathBuf,
    /// The calling cargo.
    pub(crate) cargo: OsString,
}

impl Workspace {
    /// Selects an example of host-tests, and with it the features that the tests select of other crates, so that those are not
    /// compiled again with fewer.
    pub(crate) const FEATURES_OF_TESTS: &str = "--example painted_stack";

    /// Reads the environment set by `cargo run`.
    pub(crate) fn from_env() -> Result<Self> {
        let started_by_cargo = "run this program as `cargo xtask`";
        let manifest_dir = env::var_os("CARGO_MANIFEST_DIR").context(started_by_cargo)?;
        let root = Path::new(&manifest_dir).parent().context(started_by_cargo)?.to_owned();
        let target_dir = match env::var_os("CARGO_TARGET_DIR") {
            Some(dir) => std::path::absolute(dir).context("CARGO_TARGET_DIR is not a valid path")?,
            None => root.join("target"),
        };
        let cargo = env::var_os("CARGO").context(started_by_cargo)?;
        Ok(Self { root, target_dir, cargo })
    }

    /// Returns `cargo` with a subcommand and options, separated by spaces, with the calling tool chain, run in the workspace root.
    pub(crate) fn cargo(&self, line: &str) -> Command {
        let mut command = self.cargo_in_current_dir(line);
        command.current_dir(&self.root);
        command
    }

    /// The same, run in the current folder, for programs whose arguments may be file names.
    pub(crate) fn cargo_in_current_dir(&self, line: &str) -> Command {
        let (subcommand, options) = line.split_once(' ').unwrap_or((line, ""));
        let mut command = Command::new(&self.cargo);
        command.env("CARGO_TARGET_DIR", &self.target_dir).arg(subcommand);
        // Never build with versions other than those in Cargo.lock. The formatter does not support this option.
        if subcommand != "fmt" {
            command.arg("--locked");
        }
        // Incremental compilation does not pay off for a single build; it costs a tenth of the time.
        if env::var_os("CI").is_some() {
            command.env("CARGO_INCREMENTAL", "0");
        }
        command.args(options.split_whitespace());
        command
    }

    /// Returns the packages of the workspace, as cargo describes them.
    pub(crate) fn packages(&self) -> Result<Vec<Value>> {
        let text = process::output(&mut self.cargo("metadata --no-deps --format-version 1 --offline"))?;
        let mut metadata: Value = serde_json::from_str(&text)?;
        Ok(serde_json::from_value(metadata["packages"].take())?)
    }

    /// Returns the compiler of the calling cargo.
    pub(crate) fn rustc(&self) -> Command {
        // Prefer the rustc next to cargo: the one on PATH may belong to another tool chain.
        let beside_cargo = Path::new(&self.cargo).with_file_name("rustc");
        let rustc = match env::var_os("RUSTC") {
            Some(rustc) => rustc,
            None if beside_cargo.exists() => beside_cargo.into(),
            None => "rustc".into(),
        };
        let mut command = Command::new(rustc);
        command.current_dir(&self.root);
        command
    }
}
