//! The targets of the boards, built by the active tool chain if it has them, otherwise by Debian's Rust packages, which build `core`
//! from source.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use super::{apt::Packages, is_set, report};
use crate::{process, workspace::Workspace};

/// Target of the default board (Cortex-M4F), on which the probes are measured.
pub(crate) const TRIPLE: &str = "thumbv7em-none-eabihf";

/// The targets of all boards.
pub(crate) const TRIPLES: [&str; 2] = [TRIPLE, "thumbv6m-none-eabi"];

/// Arguments with which rustup adds the targets.
pub(super) const RUSTUP_ARGUMENTS: [&str; 4] = ["target", "add", TRIPLES[0], TRIPLES[1]];

/// Oldest supported Rust version.
pub(crate) const MINIMUM_RUST: &str = env!("CARGO_PKG_RUST_VERSION");

pub(super) const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_LINKER: &str = "/usr/bin/ld.lld";
/// A separate build folder, so that the tool chains neither block nor overwrite each other.
const DEBIAN_FOLDER: &str = "debian";

/// A tool chain that builds the workspace for the thumb targets.
pub(crate) struct ThumbToolchain<'a> {
    /// The workspace that it builds.
    pub(crate) workspace: &'a Workspace,
    /// Full path of the linker for Debian's `cargo-web`, `rustc-web` and `rust-web-src`, or `None` for the tool chain of the calling
    /// cargo.
    debian_linker: Option<PathBuf>,
}

/// Finds an installed tool chain for the targets.
pub(crate) fn find(workspace: &Workspace) -> Option<ThumbToolchain<'_>> {
    if TRIPLES.iter().all(|triple| has_target(workspace, triple)) {
        return Some(ThumbToolchain { workspace, debian_linker: None });
    }
    let debian_linker = Some(linker(workspace).filter(|_| debian_can_build_core())?);
    Some(ThumbToolchain { workspace, debian_linker })
}

/// Returns whether the tool chain of the calling cargo has `core` for `target` and may use it.
fn has_target(workspace: &Workspace, target: &str) -> bool {
    if is_set("WSG_NO_RUSTUP") {
        return false;
    }
    let answer = process::answer(workspace.rustc().args(["--print", "target-libdir", "--target", target]));
    answer.is_some_and(|dir| holds_core(Path::new(dir.trim())))
}

/// Adds a target with rustup if necessary. Returns whether it is available.
pub(crate) fn provide_target(workspace: &Workspace, target: &str) -> bool {
    has_target(workspace, target) || rustup(workspace, &["target", "add", target])
}

/// Runs rustup if permitted. Returns whether that succeeded.
pub(crate) fn rustup(workspace: &Workspace, arguments: &[&str]) -> bool {
    if super::installing_is_forbidden() || !rustup_may_be_called() {
        return false;
    }
    let mut rustup = Command::new("rustup");
    // Its own message on a failed download is sufficient. A backtrace would hide the next steps.
    rustup.current_dir(&workspace.root).env_remove("RUST_BACKTRACE").args(arguments);
    report(process::run(&mut rustup))
}

/// Returns whether rustup exists and `WSG_NO_RUSTUP` does not forbid it.
pub(crate) fn rustup_may_be_called() -> bool {
    !is_set("WSG_NO_RUSTUP") && process::answer(Command::new("rustup").arg("--version")).is_some()
}

/// Returns the Debian packages that build `core` from source and link.
pub(crate) fn packages(workspace: &Workspace) -> Packages {
    let mut names = vec!["cargo-web", "rustc-web", "rust-web-src"];
    if linker(workspace).is_none() {
        names.push("lld");
    }
    Packages::of(names)
}

impl ThumbToolchain<'_> {
    /// Returns whether Debian's packages are the tool chain.
    pub(crate) fn is_debian(&self) -> bool {
        self.debian_linker.is_some()
    }

    pub(crate) fn rustc(&self) -> Command {
        if self.is_debian() { Command::new(DEBIAN_RUSTC) } else { self.workspace.rustc() }
    }

    /// Returns `cargo <subcommand>` for one of [`TRIPLES`], with all options that the tool chain needs.
    pub(crate) fn cargo(&self, subcommand: &str, triple: &str) -> Command {
        let mut command = match &self.debian_linker {
            None => self.workspace.cargo(subcommand),
            Some(linker) => debian_cargo(self.workspace, subcommand, triple, linker),
        };
        // `--config` adds to the flags in .cargo/config.toml. TOML escapes quotes and backslashes as Rust does.
        let flags = provenance::path_flags(&self.workspace.target_dir);
        command.args(["--target", triple, "--config", &format!("target.{triple}.rustflags={flags:?}")]);
        // Flags from the environment would replace those in .cargo/config.toml, such as the linker script, and the image would not
        // be reproducible.
        for name in ["RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS", &variable(triple, "RUSTFLAGS")] {
            command.env_remove(name);
        }
        command
    }

    /// Returns the output folder of builds with `profile`.
    pub(crate) fn output_dir(&self, triple: &str, profile: &str) -> PathBuf {
        let target_dir = &self.workspace.target_dir;
        let target_dir = if self.is_debian() { target_dir.join(DEBIAN_FOLDER) } else { target_dir.clone() };
        target_dir.join(triple).join(profile)
    }
}

/// Returns cargo's environment variable for a setting of a target.
fn variable(triple: &str, setting: &str) -> String {
    format!("CARGO_TARGET_{}_{setting}", triple.replace('-', "_").to_uppercase())
}

fn debian_cargo(workspace: &Workspace, subcommand: &str, triple: &str, linker: &Path) -> Command {
    // Called directly, because cargo would first find rustup's shim for `cargo-clippy` in its home folder.
    let of_clippy = if subcommand == "clippy" { "-clippy" } else { "" };
    let mut command = Command::new(format!("{DEBIAN_CARGO}{of_clippy}"));
    command.current_dir(&workspace.root).args([subcommand, "--locked", "-Z", "build-std=core"]);
    command.env("CARGO", DEBIAN_CARGO).env("RUSTC", DEBIAN_RUSTC).env("RUSTC_BOOTSTRAP", "1");
    command.env(variable(triple, "LINKER"), linker);
    command.env("CARGO_TARGET_DIR", workspace.target_dir.join(DEBIAN_FOLDER));
    // Remove the outer cargo's variables, which would lead Debian's programs to rustup's tool chain and libraries.
    command.env_remove("RUSTUP_TOOLCHAIN").env_remove("LD_LIBRARY_PATH").env_remove("RUSTDOC");
    command
}

/// Returns whether the folder contains `core`. rustc prints its path even if the target is not installed.
fn holds_core(libdir: &Path) -> bool {
    fs::read_dir(libdir).into_iter().flatten().flatten().any(|entry| {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        name.starts_with("libcore-") && name.ends_with(".rlib")
    })
}

fn debian_can_build_core() -> bool {
    let ask = |question| {
        // The outer cargo's library path would make Debian's rustc load rustup's libraries.
        process::answer(Command::new(DEBIAN_RUSTC).env_remove("LD_LIBRARY_PATH").arg(question))
    };
    let core = Path::new("lib/rustlib/src/rust/library/core/Cargo.toml");
    Path::new(DEBIAN_CARGO).exists()
        && ask("--version").is_some_and(|version| is_new_enough(&version, MINIMUM_RUST))
        && ask("--print=sysroot").is_some_and(|sysroot| Path::new(sysroot.trim()).join(core).exists())
}

/// Finds `rust-lld` in the active tool chain, or Debian's `lld`.
fn linker(workspace: &Workspace) -> Option<PathBuf> {
    let libdir = process::answer(workspace.rustc().args(["--print", "target-libdir"]));
    let rust_lld = libdir.and_then(|dir| Some(Path::new(dir.trim()).parent()?.join("bin/rust-lld")));
    rust_lld.into_iter().chain([PathBuf::from(DEBIAN_LINKER)]).find(|linker| linker.exists())
}

/// Compares the output of `rustc --version` with a `rust-version`, by major and minor number.
fn is_new_enough(rustc_version: &str, minimum: &str) -> bool {
    let numbers = |version: &str| {
        let mut parts = version.split('.').map(|part| part.parse::<u32>().ok());
        Some((parts.next()??, parts.next()??))
    };
    // Text without a version is older than any.
    rustc_version.split_whitespace().nth(1).and_then(numbers) >= numbers(minimum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_compare_by_number_not_by_text() {
        assert!(is_new_enough("rustc 1.96.0 (ac68faa20 2026-05-25) (built from a source tarball)", "1.88"));
        assert!(is_new_enough("rustc 1.100.0", "1.88"));
        assert!(is_new_enough("rustc 1.88.0-nightly", "1.88"));
        assert!(!is_new_enough("rustc 1.85.0 (4d91de4e4 2025-02-17)", "1.88"));
        assert!(!is_new_enough("rustc 1.9.0", "1.88"));
        assert!(!is_new_enough("", "1.88"));
    }

    #[test]
    fn a_libdir_without_core_is_no_target() {
        let dir = std::env::temp_dir().join(format!("wsg-xtask-libdir-{}", std::process::id()));
        fs::create_dir_all(&dir).unwrap();
        fs::write(dir.join("libcompiler_builtins-12.rlib"), "").unwrap();

        let before = holds_core(&dir);
        fs::write(dir.join("libcore-12.rlib"), "").unwrap();
        let after = holds_core(&dir);

        fs::remove_dir_all(&dir).unwrap();
        assert!(!before && after);
        assert!(!holds_core(&dir));
    }
}
