//! Tools for individual checks, including nightly Rust: finds them, installs them if permitted, or reports the missing check.

use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::{process, setup, workspace::Workspace};

/// A tool and how to install it.
pub(crate) struct Tool {
    /// Name for messages.
    pub(crate) name: &'static str,
    /// Command that succeeds if the tool is installed.
    pub(crate) probe: &'static [&'static str],
    /// Command that installs the tool.
    pub(crate) install: &'static [&'static str],
}

/// cargo-fuzz, for the fuzz targets.
pub(crate) const CARGO_FUZZ: Tool = Tool {
    name: "cargo-fuzz",
    probe: &["cargo", "fuzz", "--version"],
    install: &["cargo", "install", "cargo-fuzz", "--locked"],
};

/// cargo-mutants, for mutation testing.
pub(crate) const CARGO_MUTANTS: Tool = Tool {
    name: "cargo-mutants",
    probe: &["cargo", "mutants", "--version"],
    install: &["cargo", "install", "cargo-mutants", "--locked"],
};

/// cargo-deny, for checks of the dependencies.
pub(crate) const CARGO_DENY: Tool = Tool {
    name: "cargo-deny",
    probe: &["cargo", "deny", "--version"],
    install: &["cargo", "install", "cargo-deny", "--locked"],
};

/// cargo-llvm-cov, for line coverage.
pub(crate) const CARGO_LLVM_COV: Tool = Tool {
    name: "cargo-llvm-cov",
    probe: &["cargo", "llvm-cov", "--version"],
    install: &["cargo", "install", "cargo-llvm-cov", "--locked"],
};

/// The nightly tool chain, for Miri and cargo-fuzz.
pub(crate) const NIGHTLY: Tool = Tool {
    name: "nightly Rust",
    probe: &["rustup", "run", "nightly", "rustc", "--version"],
    install: &["rustup", "toolchain", "install", "nightly", "--profile", "minimal"],
};

/// Miri, with the sources of the standard library.
pub(crate) const MIRI: Tool = Tool {
    name: "Miri",
    probe: &["rustup", "run", "nightly", "cargo", "miri", "--version"],
    install: &["rustup", "component", "add", "--toolchain", "nightly", "miri", "rust-src"],
};

impl Tool {
    /// Installs the tool if necessary. Fails with a note of the missing check.
    pub(crate) fn require(&self, workspace: &Workspace, what_for: &str) -> Result<()> {
        if self.is_there(workspace) {
            return Ok(());
        }
        let line = self.install.join(" ");
        if setup::installing_is_forbidden() {
            bail!(
                "NOT CHECKED: {what_for}. {} is missing, and WSG_NO_INSTALL=1 forbids installation; run `{line}`",
                self.name
            );
        }
        process::run(&mut plain(workspace, self.install)).with_context(|| {
            format!("NOT CHECKED: {what_for}. {} cannot be installed with `{line}`", self.name)
        })?;
        if !self.is_there(workspace) {
            bail!("NOT CHECKED: {what_for}. {} is still missing after `{line}`", self.name);
        }
        Ok(())
    }

    fn is_there(&self, workspace: &Workspace) -> bool {
        process::answer(&mut plain(workspace, self.probe)).is_some()
    }
}

/// Returns `cargo` of the nightly tool chain, run in the workspace root.
pub(crate) fn nightly_cargo(workspace: &Workspace, arguments: &[&str]) -> Command {
    let mut command = plain(workspace, &["rustup", "run", "nightly", "cargo"]);
    command.args(arguments);
    command
}

/// Returns a command without the outer cargo's environment variables, which would make rustup use the outer tool chain.
pub(crate) fn plain(workspace: &Workspace, words: &[&str]) -> Command {
    let (program, arguments) = words.split_first().unwrap_or((&"true", &[]));
    let mut command = Command::new(program);
    command.args(arguments).current_dir(&workspace.root);
    for name in ["RUSTUP_TOOLCHAIN", "CARGO", "RUSTC", "RUSTDOC", "LD_LIBRARY_PATH", "CARGO_TARGET_DIR"] {
        command.env_remove(name);
    }
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tool_that_cannot_be_installed_reports_what_was_not_checked() {
        let tool = Tool { name: "nothing", probe: &["/bin/false"], install: &["/bin/false"] };

        let error = format!("{:#}", tool.require(&Workspace::for_tests(), "the moon").unwrap_err());

        assert!(error.starts_with("NOT CHECKED: the moon. nothing "), "{error}");
    }
}
