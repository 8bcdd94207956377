//! Tools that only some checks need, and nightly Rust with them: found, installed where that is allowed, else named with
//! what was therefore not checked.

use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::{process, setup, workspace::Workspace};

/// A tool and how to get it. What answers for it, and what installs it, are arguments to rustup or to cargo.
pub(crate) struct Tool {
    /// For a person.
    pub(crate) name: &'static str,
    /// Succeeds where the tool is there.
    pub(crate) probe: &'static [&'static str],
    /// Gets it.
    pub(crate) install: &'static [&'static str],
}

/// cargo-fuzz.
pub(crate) const CARGO_FUZZ: Tool = Tool {
    name: "cargo-fuzz",
    probe: &["cargo", "fuzz", "--version"],
    install: &["cargo", "install", "cargo-fuzz", "--locked"],
};

/// cargo-mutants.
pub(crate) const CARGO_MUTANTS: Tool = Tool {
    name: "cargo-mutants",
    probe: &["cargo", "mutants", "--version"],
    install: &["cargo", "install", "cargo-mutants", "--locked"],
};

/// cargo-deny.
pub(crate) const CARGO_DENY: Tool = Tool {
    name: "cargo-deny",
    probe: &["cargo", "deny", "--version"],
    install: &["cargo", "install", "cargo-deny", "--locked"],
};

/// cargo-llvm-cov.
pub(crate) const CARGO_LLVM_COV: Tool = Tool {
    name: "cargo-llvm-cov",
    probe: &["cargo", "llvm-cov", "--version"],
    install: &["cargo", "install", "cargo-llvm-cov", "--locked"],
};

/// mdBook.
const MDBOOK: Tool = Tool {
    name: "mdbook",
    probe: &["mdbook", "--version"],
    install: &["cargo", "install", "mdbook", "--locked"],
};

/// Makes the book of the documents.
pub(crate) fn book(workspace: &Workspace) -> Result<()> {
    MDBOOK.require(workspace, "the book")?;
    process::run(plain(workspace, &["mdbook", "build"]).current_dir(&workspace.root))
}

/// The nightly tool chain.
pub(crate) const NIGHTLY: Tool = Tool {
    name: "nightly Rust",
    probe: &["rustup", "run", "nightly", "rustc", "--version"],
    install: &["rustup", "toolchain", "install", "nightly", "--profile", "minimal"],
};

/// Miri, and the sources of the library that it runs.
pub(crate) const MIRI: Tool = Tool {
    name: "Miri",
    probe: &["rustup", "run", "nightly", "cargo", "miri", "--version"],
    install: &["rustup", "component", "add", "--toolchain", "nightly", "miri", "rust-src"],
};

impl Tool {
    /// Makes the tool available, or says what cannot be checked without it.
    pub(crate) fn require(&self, workspace: &Workspace, what_for: &str) -> Result<()> {
        if self.is_there(workspace) {
            return Ok(());
        }
        let line = self.install.join(" ");
        if setup::installing_is_forbidden() {
            bail!(
                "NOT CHECKED: {what_for}. {} is missing, and WSG_NO_INSTALL=1 forbids installing it: {line}",
                self.name
            );
        }
        process::run(&mut plain(workspace, self.install)).with_context(|| {
            format!("NOT CHECKED: {what_for}. {} cannot be installed by `{line}`", self.name)
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

/// `cargo` of the nightly tool chain, in the root of the workspace.
pub(crate) fn nightly_cargo(workspace: &Workspace, arguments: &[&str]) -> Command {
    let mut command = plain(workspace, &["rustup", "run", "nightly", "cargo"]);
    command.args(arguments);
    command
}

/// A command without what the outer cargo has put into the environment, which would lead rustup to the outer tool chain.
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
    fn a_tool_that_cannot_be_had_says_what_was_not_checked() {
        let tool = Tool { name: "nothing", probe: &["/bin/false"], install: &["/bin/false"] };

        let error = format!("{:#}", tool.require(&Workspace::for_tests(), "the moon").unwrap_err());

        assert!(error.starts_with("NOT CHECKED: the moon. nothing "), "{error}");
    }
}
