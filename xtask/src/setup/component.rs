//! The formatter and the linter: parts of a tool chain that a machine may lack, and that only `test` asks for.

use std::path::Path;

use super::{
    ThumbToolchain,
    apt::{self, Packages},
    obstacle_to_installing, report, rust_target,
};
use crate::{process, workspace::Workspace};

/// A part of the tool chain that rustup's minimal profile and Debian's `cargo-web` leave out.
pub(crate) struct Component {
    subcommand: &'static str,
    rustup_name: &'static str,
    debian_package: &'static str,
    debian_program: &'static str,
}

/// The formatter.
pub(crate) const RUSTFMT: Component = Component {
    subcommand: "fmt",
    rustup_name: "rustfmt",
    debian_package: "rustfmt-web",
    debian_program: "/usr/bin/cargo-fmt",
};

/// The linter.
pub(crate) const CLIPPY: Component = Component {
    subcommand: "clippy",
    rustup_name: "clippy",
    debian_package: "rust-web-clippy",
    debian_program: rust_target::DEBIAN_CLIPPY,
};

impl Component {
    /// Makes the component available to the cargo that was called; says whether it is.
    pub(crate) fn provide(&self, workspace: &Workspace) -> bool {
        self.is_available(workspace) || {
            self.add(workspace);
            self.is_available(workspace)
        }
    }

    /// [`Self::provide`] for the cargo that builds for the thumb target.
    pub(crate) fn provide_for_thumb(&self, workspace: &Workspace, toolchain: &ThumbToolchain) -> bool {
        match toolchain {
            ThumbToolchain::Active => self.provide(workspace),
            ThumbToolchain::Debian { .. } => {
                let program = Path::new(self.debian_program);
                program.exists() || {
                    self.install_debian_package();
                    program.exists()
                }
            }
        }
    }

    fn is_available(&self, workspace: &Workspace) -> bool {
        process::answer(workspace.cargo(self.subcommand).arg("--version")).is_some()
    }

    fn add(&self, workspace: &Workspace) {
        if workspace.cargo_is(rust_target::DEBIAN_CARGO) {
            self.install_debian_package();
        } else {
            rust_target::rustup(workspace, &["component", "add", self.rustup_name]);
        }
    }

    fn install_debian_package(&self) {
        if obstacle_to_installing().is_none() {
            report(apt::install(&[Packages::of(self.debian_package)]));
        }
    }
}
