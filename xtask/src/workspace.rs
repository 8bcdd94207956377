//! Where this workspace is, where it builds to, and the cargo that was called.

use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result};

/// The crates for other people's boards, by package and folder: built for each target, free of panics, published as packages.
/// A crate stands behind those that it depends on.
pub(crate) const TARGET_CRATES: [(&str, &str); 7] = [
    ("bus-modbus", "buses/modbus"),
    ("bus-slcan", "buses/slcan"),
    ("bus-canopen", "buses/canopen"),
    ("bus-profibus", "buses/profibus"),
    ("bus-profinet", "buses/profinet"),
    ("wsg-protocol", "protocol"),
    ("wsg-fieldbus", "fieldbus"),
];

/// The workspace that `cargo xtask` was called in.
pub(crate) struct Workspace {
    /// The folder of the workspace's `Cargo.toml`.
    pub(crate) root: PathBuf,
    /// Where builds go: `CARGO_TARGET_DIR`, else `target` in the root.
    pub(crate) target_dir: PathBuf,
    cargo: OsString,
}

impl Workspace {
    /// Reads the environment that `cargo run` gives to this program.
    pub(crate) fn from_env() -> Result<Self> {
        let started_by_cargo = "start this program as `cargo xtask`";
        let manifest_dir = env::var_os("CARGO_MANIFEST_DIR").context(started_by_cargo)?;
        let root = Path::new(&manifest_dir).parent().context(started_by_cargo)?.to_owned();
        let target_dir = match env::var_os("CARGO_TARGET_DIR") {
            Some(dir) => std::path::absolute(dir).context("CARGO_TARGET_DIR names no folder")?,
            None => root.join("target"),
        };
        let cargo = env::var_os("CARGO").context(started_by_cargo)?;
        Ok(Self { root, target_dir, cargo })
    }

    /// A workspace that nothing is built in.
    #[cfg(test)]
    pub(crate) fn for_tests() -> Self {
        Self { root: env::temp_dir(), target_dir: env::temp_dir(), cargo: "cargo".into() }
    }

    /// `cargo <subcommand>` of the cargo that was called (the same tool chain), run in the root.
    pub(crate) fn cargo(&self, subcommand: &str) -> Command {
        let mut command = self.cargo_in_current_dir(subcommand);
        command.current_dir(&self.root);
        command
    }

    /// The same, run where the user is: for a program whose arguments may name files.
    pub(crate) fn cargo_in_current_dir(&self, subcommand: &str) -> Command {
        let mut command = Command::new(&self.cargo);
        command.env("CARGO_TARGET_DIR", &self.target_dir).arg(subcommand);
        // What is built is what Cargo.lock says, or nothing. The formatter builds nothing and does not know the option.
        if subcommand != "fmt" {
            command.arg("--locked");
        }
        // What a machine builds once needs no notes for the next time, which take it a tenth of the time.
        if env::var_os("CI").is_some() {
            command.env("CARGO_INCREMENTAL", "0");
        }
        command
    }

    /// Whether the cargo that was called is the one at `path`.
    pub(crate) fn cargo_is(&self, path: &str) -> bool {
        Path::new(&self.cargo) == Path::new(path)
    }

    /// The compiler of the cargo that was called.
    pub(crate) fn rustc(&self) -> Command {
        // Beside cargo lies the tool chain's own; on PATH it may be another's.
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

    /// Where cargo keeps the sources of dependencies.
    pub(crate) fn cargo_home(&self) -> Option<PathBuf> {
        env::var_os("CARGO_HOME").map(PathBuf::from).or_else(|| Some(env::home_dir()?.join(".cargo")))
    }
}
