//! Builds the archive for C and C++ programmers: `libwsg-VERSION.tar.gz` and the same as a folder.
//!
//! `cargo xtask dist-c` calls it. Without `--targets` it builds all of [`TARGETS`] that rustup can provide, and names the rest.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::{env, fs};

use anyhow::{Context, Result, bail, ensure};
use clap::Parser;

/// The targets of the static library.
const TARGETS: [&str; 8] = [
    "thumbv6m-none-eabi",
    "thumbv7em-none-eabi",
    "thumbv7em-none-eabihf",
    "thumbv8m.main-none-eabi",
    "riscv32imac-unknown-none-elf",
    "x86_64-unknown-linux-gnu",
    "aarch64-unknown-linux-gnu",
    "x86_64-pc-windows-gnu",
];

/// Files and folders of the archive, and where they come from, relative to `bindings/c`. `@VERSION@` in `package` is replaced.
const FILES: [(&str, &str); 16] = [
    ("README.md", "README.md"),
    ("LICENSE-APACHE", "../../LICENSE-APACHE"),
    ("LICENSE-MIT", "../../LICENSE-MIT"),
    ("CHANGELOG.md", "../../CHANGELOG.md"),
    ("include/wsg.h", "include/wsg.h"),
    ("include/wsg.hpp", "include/wsg.hpp"),
    ("include/wsg_host.h", "../c-host/include/wsg_host.h"),
    ("examples", "examples"),
    ("examples/host.c", "../c-host/examples/host.c"),
    ("lib/cmake/wsg/wsg-config.cmake", "package/wsg-config.cmake"),
    ("lib/cmake/wsg/wsg-config-version.cmake", "package/wsg-config-version.cmake"),
    ("lib/pkgconfig/wsg.pc", "package/wsg.pc"),
    ("library.json", "package/library.json"),
    ("zephyr/module.yml", "package/zephyr/module.yml"),
    ("zephyr/CMakeLists.txt", "package/zephyr/CMakeLists.txt"),
    ("zephyr/Kconfig", "package/zephyr/Kconfig"),
];

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Builds the archive for C and C++ programmers.
#[derive(Parser)]
struct Arguments {
    /// Targets of the libraries, separated by commas [default: all]
    #[arg(long, value_name = "TRIPLE,...")]
    targets: Option<String>,
    /// Folder of the archive
    #[arg(long, value_name = "FOLDER", default_value = "target/dist-c")]
    to: PathBuf,
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<()> {
    let Arguments { targets: chosen, to } = Arguments::parse();
    let to = std::path::absolute(to)?;
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let name = format!("libwsg-{VERSION}");
    let folder = to.join(&name);
    if folder.exists() {
        fs::remove_dir_all(&folder).with_context(|| format!("cannot remove {}", folder.display()))?;
    }
    for (target, source) in FILES {
        copy(&sources.join(source), &folder.join(target))?;
    }
    let mut missing = Vec::new();
    match &chosen {
        Some(chosen) => {
            for triple in chosen.split(',') {
                ensure!(TARGETS.contains(&triple), "unknown target {triple}; expected one of {TARGETS:?}");
                libraries(&sources, &to, &folder, triple)?;
            }
        }
        None => {
            for triple in TARGETS {
                if provide(triple) {
                    libraries(&sources, &to, &folder, triple)?;
                } else {
                    missing.push(triple);
                }
            }
        }
    }
    archive(&to, &name)?;
    println!("{}", to.join(format!("{name}.tar.gz")).display());
    if !missing.is_empty() {
        bail!("the archive lacks {}: rustup could not install these targets", missing.join(", "));
    }
    Ok(())
}

/// Copies a file or a folder, and replaces the version in it.
fn copy(from: &Path, to: &Path) -> Result<()> {
    let failed = || format!("cannot copy {} to {}", from.display(), to.display());
    if from.is_dir() {
        for entry in fs::read_dir(from).with_context(failed)? {
            let entry = entry?;
            copy(&entry.path(), &to.join(entry.file_name()))?;
        }
        return Ok(());
    }
    fs::create_dir_all(to.parent().context("every file has a folder")?)?;
    let text = fs::read_to_string(from).with_context(failed)?;
    fs::write(to, text.replace("@VERSION@", VERSION)).with_context(failed)
}

/// Installs a target with rustup. Returns whether it is installed.
fn provide(triple: &str) -> bool {
    let is_forbidden = env::var("WSG_NO_INSTALL").is_ok_and(|value| !value.is_empty() && value != "0");
    let mut rustup = Command::new("rustup");
    if is_forbidden {
        rustup.args(["target", "list", "--installed"])
    } else {
        rustup.args(["target", "add", triple])
    };
    let Ok(output) = rustup.output() else { return false };
    output.status.success()
        && (!is_forbidden || String::from_utf8_lossy(&output.stdout).lines().any(|line| line == triple))
}

/// Builds the static libraries for a target: the session, and on an operating system the blocking calls.
fn libraries(sources: &Path, to: &Path, folder: &Path, triple: &str) -> Result<()> {
    library(sources, to, folder, triple, "libwsg.a", &["--features", "static-library"])?;
    if triple.contains("linux") || triple.contains("windows") {
        library(&sources.join("../c-host"), to, folder, triple, "libwsg_host.a", &[])?;
    }
    Ok(())
}

/// Builds one static library and puts it into the folder, without debug information and bitcode.
fn library(
    package: &Path,
    to: &Path,
    folder: &Path,
    triple: &str,
    name: &str,
    features: &[&str],
) -> Result<()> {
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(package).args(["rustc", "--locked", "--quiet", "--lib", "--profile", "c-library"]);
    cargo.args(["--crate-type", "staticlib", "--target", triple]).args(features);
    succeed(cargo.arg("--target-dir").arg(to.join("build")))?;
    let built = to.join("build").join(triple).join("c-library").join(name);
    let target = folder.join("lib").join(triple).join(name);
    fs::create_dir_all(target.parent().context("it has a folder")?)?;
    // LLVM's tool, which comes with rustc and reads every target's objects.
    let mut sysroot = Command::new(env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()));
    let output = sysroot.args(["--print", "target-libdir"]).output().context("cannot run rustc")?;
    let libraries = PathBuf::from(String::from_utf8(output.stdout)?.trim());
    let objcopy = libraries.parent().context("it has a parent")?.join("bin/rust-objcopy");
    let mut strip = Command::new(objcopy);
    strip.args(["--strip-debug", "--enable-deterministic-archives"]);
    // Bitcode for the compiler's own linker.
    strip.args(["--remove-section=.llvmbc", "--remove-section=.llvmcmd"]);
    succeed(strip.arg(built).arg(target))
}

/// Packs the folder, reproducibly.
fn archive(to: &Path, name: &str) -> Result<()> {
    let mut tar = Command::new("tar");
    tar.current_dir(to).args(["--sort=name", "--mtime=@0", "--owner=0", "--group=0", "--numeric-owner"]);
    tar.args(["--use-compress-program=gzip -n", "-cf"]);
    succeed(tar.arg(format!("{name}.tar.gz")).arg(name))
}

fn succeed(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("cannot run {:?}", command.get_program()))?;
    ensure!(status.success(), "{command:?} failed: {status}");
    Ok(())
}
