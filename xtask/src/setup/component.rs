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
}

/// The formatter, `cargo fmt`.
pub(crate) const RUSTFMT: Component =
    Component { subcommand: "fmt", rustup_name: "rustfmt", debian_package: "rustfmt-web" };

/// The linter, `cargo clippy`.
pub(crate) const CLIPPY: Component =
    Component { subcommand: "clippy", rustup_name: "clippy", debian_package: "rust-web-clippy" };

impl Component {
    /// Installs the component for the calling cargo if necessary. Returns whether it is available.
    pub(crate) fn provide(&self, workspace: &Workspace) -> bool {
        let is_available = || process::answer(workspace.cargo(self.subcommand).arg("--version")).is_some();
        if is_available() {
            return true;
        }
        if workspace.cargo == rust_target::DEBIAN_CARGO {
            self.install_debian_package();
        } else {
            rust_target::rustup(workspace, &["component", "add", self.rustup_name]);
        }
        is_available()
    }

    /// Like [`Self::provide`], for the cargo that builds for the thumb targets.
    pub(crate) fn provide_for_thumb(&self, toolchain: &ThumbToolchain<'_>) -> bool {
        if !toolchain.is_debian() {
            return self.provide(toolchain.workspace);
        }
        let program = format!("{}-{}", rust_target::DEBIAN_CARGO, self.subcommand);
        let is_available = || Path::new(&program).exists();
        if !is_available() {
            self.install_debian_package();
        }
        is_available()
    }

    fn install_debian_package(&self) {
        if obstacle_to_installing().is_none() {
            report(apt::install(&[Packages::of(vec![self.debian_package])]));
        }
    }
}
