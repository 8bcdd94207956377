//! Formatter and linter: optional components of the tool chain, used only by `test`.

use std::path::Path;

use super::{
    ThumbToolchain,
    apt::{self, Packages},
    obstacle_to_installing, report, rust_target,
};
use crate::{process, workspace::Workspace};

/// A component that is not part of rustup's minimal profile and Debian's `cargo-web`.
pub(crate) struct Component {
    subcommand: &'static str,
    rustup_name: &'static str,
    debian_package: &'static str,
    debian_program: &'static str,
}

/// The formatter, `cargo fmt`.
pub(crate) const RUSTFMT: Component = Component {
    subcommand: "fmt",
    rustup_name: "rustfmt",
    debian_package: "rustfmt-web",
    debian_program: "/usr/bin/cargo-fmt",
};

/// The linter, `cargo clippy`.
pub(crate) const CLIPPY: Component = Component {
    subcommand: "clippy",
    rustup_name: "clippy",
    debian_package: "rust-web-clippy",
    debian_program: rust_target::DEBIAN_CLIPPY,
};

impl Component {
    /// Installs the component for the calling cargo if necessary. Returns whether it is available.
    pub(crate) fn provide(&self, workspace: &Workspace) -> bool {
        self.is_available(workspace) || {
            self.add(workspace);
            self.is_available(workspace)
        }
    }

    /// Like [`Self::provide`], for the cargo that builds for the thumb targets.
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
