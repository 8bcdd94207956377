//! Tools for individual checks, including nightly Rust: finds them, installs them if permitted, or reports the missing check.

use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::{process, setup, workspace::Workspace};

/// A tool and how to install it.
pub(crate) struct Tool {
    /// Name for messages.
    name: &'static str,
    /// Command that succeeds if the tool is installed.
    probe: &'static str,
    /// Command that installs the tool.
    install: &'static str,
}

macro_rules! of_cargo {
    ($name:literal) => {
        Tool::new(
            concat!("cargo-", $name),
            concat!("cargo ", $name, " --version"),
            concat!("cargo install cargo-", $name, " --locked"),
        )
    };
}

// For the fuzz targets, mutation testing, checks of the dependencies, and line coverage.
pub(crate) const CARGO_FUZZ: Tool = of_cargo!("fuzz");
pub(crate) const CARGO_MUTANTS: Tool = of_cargo!("mutants");
pub(crate) const CARGO_DENY: Tool = of_cargo!("deny");
pub(crate) const CARGO_LLVM_COV: Tool = of_cargo!("llvm-cov");
// For a release: lists of the parts of a program in it and beside it, and the records of public APIs.
pub(crate) const CARGO_AUDITABLE: Tool = of_cargo!("auditable");
pub(crate) const CARGO_CYCLONEDX: Tool = of_cargo!("cyclonedx");
pub(crate) const CARGO_PUBLIC_API: Tool = of_cargo!("public-api");
pub(crate) const CARGO_SEMVER_CHECKS: Tool = of_cargo!("semver-checks");

/// mdBook, without its web server.
pub(crate) const MDBOOK: Tool = Tool::new(
    "mdbook",
    "mdbook --version",
    "cargo install mdbook --locked --no-default-features --features search",
);

/// The nightly tool chain, for Miri and cargo-fuzz.
pub(crate) const NIGHTLY: Tool = Tool::new(
    "nightly Rust",
    "rustup run nightly rustc --version",
    "rustup toolchain install nightly --profile minimal",
);

/// Miri, with the sources of the standard library.
pub(crate) const MIRI: Tool = Tool::new(
    "Miri",
    "rustup run nightly cargo miri --version",
    "rustup component add --toolchain nightly miri rust-src",
);

impl Tool {
    const fn new(name: &'static str, probe: &'static str, install: &'static str) -> Self {
        Self { name, probe, install }
    }

    /// Installs the tool if necessary. Fails with a note of the missing check.
    pub(crate) fn require(&self, workspace: &Workspace, what_for: &str) -> Result<()> {
        if self.is_there(workspace) {
            return Ok(());
        }
        let Self { name, install, .. } = self;
        ensure!(
            !setup::installing_is_forbidden(),
            "NOT CHECKED: {what_for}. {name} is missing, and WSG_NO_INSTALL=1 forbids installation; run `{install}`"
        );
        process::run(&mut plain(workspace, install)).with_context(|| {
            format!("NOT CHECKED: {what_for}. {name} cannot be installed with `{install}`")
        })?;
        ensure!(
            self.is_there(workspace),
            "NOT CHECKED: {what_for}. {name} is still missing after `{install}`"
        );
        Ok(())
    }

    fn is_there(&self, workspace: &Workspace) -> bool {
        process::answer(&mut plain(workspace, self.probe)).is_some()
    }
}

/// Returns a command, whose words are separated by spaces, run in the workspace root without the outer cargo's environment
/// variables, which would make rustup use the outer tool chain.
pub(crate) fn plain(workspace: &Workspace, line: &str) -> Command {
    let mut words = line.split(' ');
    let mut command = Command::new(words.next().unwrap_or_default());
    command.args(words).current_dir(&workspace.root);
    for name in ["RUSTUP_TOOLCHAIN", "CARGO", "RUSTC", "RUSTDOC", "LD_LIBRARY_PATH", "CARGO_TARGET_DIR"] {
        command.env_remove(name);
    }
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tool_that_cannot_be_installed_reports_the_skipped_check() {
        let tool = Tool { name: "nothing", probe: "/bin/false", install: "/bin/false" };

        let error = format!("{:#}", tool.require(&Workspace::from_env().unwrap(), "the moon").unwrap_err());

        assert!(error.starts_with("NOT CHECKED: the moon. nothing "), "{error}");
    }
}
