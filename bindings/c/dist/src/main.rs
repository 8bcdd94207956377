//! Builds the archive for C and C++ programmers: `libwsg-VERSION.tar.gz` and the same as a folder.
//!
//! `cargo xtask dist-c` calls it, and then tests the archive. Without `--targets` it builds all of [`TARGETS`] that rustup can
//! provide, names the rest, and adds the virtual gripper.

mod symbols;

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
    AARCH64,
    "x86_64-pc-windows-gnu",
];

const AARCH64: &str = "aarch64-unknown-linux-gnu";

/// Files and folders of the archive, and where they come from, relative to `bindings/c`. `@VERSION@` in `package` is replaced.
const FILES: [(&str, &str); 18] = [
    ("README.md", "README.md"),
    ("LICENSE-APACHE", "../../LICENSE-APACHE"),
    ("LICENSE-MIT", "../../LICENSE-MIT"),
    ("CHANGELOG.md", "../../CHANGELOG.md"),
    ("docs/c.md", "../../docs/c.md"),
    ("include/wsg.h", "include/wsg.h"),
    ("include/wsg.hpp", "include/wsg.hpp"),
    ("include/wsg_host.h", "../c-host/include/wsg_host.h"),
    ("examples", "examples"),
    ("examples/host.c", "../c-host/examples/host.c"),
    ("lib/cmake/wsg/wsg-config.cmake", "package/wsg-config.cmake"),
    ("lib/cmake/wsg/wsg-config-version.cmake", "package/wsg-config-version.cmake"),
    ("lib/pkgconfig/wsg.pc", "package/wsg.pc"),
    ("lib/pkgconfig/wsg_host.pc", "package/wsg_host.pc"),
    ("library.json", "package/library.json"),
    ("zephyr/module.yml", "package/zephyr/module.yml"),
    ("zephyr/CMakeLists.txt", "package/zephyr/CMakeLists.txt"),
    ("zephyr/Kconfig", "package/zephyr/Kconfig"),
];

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Cargo arguments that select the libraries and the virtual gripper.
const LINKED: [&str; 4] = [
    "--package wsg-c --features static-library --target thumbv7em-none-eabihf",
    "--package wsg-c-host --target x86_64-unknown-linux-gnu",
    "--package wsg-c-host --target x86_64-pc-windows-gnu",
    "--package wsg-sim",
];

/// The folder `bindings/c`.
const SOURCES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// The flag that makes import libraries for Windows reproducible.
const DLLTOOL: &str = concat!("-Cdlltool=", env!("CARGO_MANIFEST_DIR"), "/dlltool");

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
    let name = format!("libwsg-{VERSION}");
    let archive = Archive { folder: to.join(&name), build: to.join("build") };
    if archive.folder.exists() {
        fs::remove_dir_all(&archive.folder)
            .with_context(|| format!("cannot remove {}", archive.folder.display()))?;
    }
    for (target, source) in FILES {
        copy(&Path::new(SOURCES).join(source), &archive.folder.join(target))?;
    }
    let licences = provenance::licences(&LINKED)?;
    fs::write(archive.folder.join("LICENCES.txt"), licences)?;
    let mut missing = Vec::new();
    match &chosen {
        Some(chosen) => {
            for triple in chosen.split(',') {
                ensure!(TARGETS.contains(&triple), "unknown target {triple}; expected one of {TARGETS:?}");
                archive.add_libraries(triple)?;
            }
        }
        None => {
            for triple in TARGETS {
                if provide(triple) {
                    archive.add_libraries(triple)?;
                } else {
                    missing.push(format!("{triple} (rustup could not install it)"));
                }
            }
            if linker(AARCH64).is_some_and(|linker| !runs(linker)) {
                missing.push(format!("the shared library for {AARCH64} (its C compiler is missing)"));
            }
            archive.add_simulator()?;
        }
    }
    pack(&to, &name)?;
    println!("{}", to.join(format!("{name}.tar.gz")).display());
    if !missing.is_empty() {
        bail!("the archive lacks {}", missing.join(", "));
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
    let text = fs::read_to_string(from).with_context(failed)?.replace("@VERSION@", VERSION);
    let is_page = to.extension().is_some_and(|extension| extension == "md");
    fs::write(to, if is_page { with_links_of_the_archive(&text) } else { text }).with_context(failed)
}

/// Adapts the links of a page to the archive, and removes those to pages that only the repository has.
fn with_links_of_the_archive(page: &str) -> String {
    let mut parts = page.split('[');
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let link = part.split_once("](").and_then(|(label, rest)| Some((label, rest.split_once(')')?)));
        text += &match link {
            Some((label, ("../../docs/c.md", rest))) => format!("[{label}](docs/c.md){rest}"),
            Some((label, ("../bindings/c/README.md", rest))) => format!("[{label}](../README.md){rest}"),
            Some((label, (_, rest))) => format!("{label}{rest}"),
            None => format!("[{part}"),
        };
    }
    text
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

/// The unpacked archive, and cargo's folder for its libraries.
struct Archive {
    folder: PathBuf,
    build: PathBuf,
}

impl Archive {
    /// Returns cargo with these flags for the compiler. Its output does not name the folders of this computer.
    fn cargo(&self, flags: &[&str]) -> Command {
        let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        provenance::remove_paths(&mut cargo, &self.build, flags);
        cargo.env("CARGO_TARGET_DIR", &self.build);
        cargo
    }

    /// Builds the libraries for a target: the session, and on an operating system the blocking calls.
    fn add_libraries(&self, triple: &str) -> Result<()> {
        let session = ["--crate-type", "staticlib", "--features", "static-library"];
        let library = self.add_library("", triple, "libwsg.a", "libwsg.a", &session)?;
        symbols::check(&fs::read(&library)?).with_context(|| library.display().to_string())?;
        if triple.contains("linux") || triple.contains("windows") {
            let host = ["--crate-type", "staticlib"];
            self.add_library("../c-host", triple, "libwsg_host.a", "libwsg_host.a", &host)?;
        }
        if triple.contains("linux") && linker(triple).is_none_or(runs) {
            let shared = format!("shared/libwsg_host.so.{}", abi_version()?);
            let soname = format!("-Clink-arg=-Wl,-soname,libwsg_host.so.{}", abi_version()?);
            let options = ["--crate-type", "cdylib", "--", &soname];
            let library = self.add_library("../c-host", triple, "libwsg_host.so", &shared, &options)?;
            let name = library.file_name().context("it has a name")?;
            let mut link = Command::new("ln");
            succeed(link.arg("-s").arg(name).arg(library.with_file_name("libwsg_host.so")))?;
        }
        Ok(())
    }

    /// Builds one library and puts it into the folder of its target, without debug information and bitcode.
    fn add_library(
        &self,
        package: &str,
        triple: &str,
        built: &str,
        name: &str,
        options: &[&str],
    ) -> Result<PathBuf> {
        let mut cargo = self.cargo(&[DLLTOOL]);
        cargo.current_dir(Path::new(SOURCES).join(package)).args(["rustc", "--locked", "--quiet", "--lib"]);
        if let Some(linker) = linker(triple) {
            cargo.env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER", linker);
        }
        succeed(cargo.args(["--profile", "c-library", "--target", triple]).args(options))?;
        let target = self.folder.join("lib").join(triple).join(name);
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
        succeed(strip.arg(self.build.join(triple).join("c-library").join(built)).arg(&target))?;
        Ok(target)
    }

    /// Builds the virtual gripper for this computer's processor, static, so that it runs with any version of the C library.
    fn add_simulator(&self) -> Result<()> {
        let host = &format!("{}-unknown-linux-gnu", env::consts::ARCH);
        let mut cargo = self.cargo(&["-Ctarget-feature=+crt-static"]);
        cargo.current_dir(SOURCES).args(["build", "--locked", "--quiet", "--package", "wsg-sim"]);
        succeed(cargo.args(["--profile", "wheel", "--target", host]))?;
        fs::create_dir_all(self.folder.join("bin"))?;
        fs::copy(self.build.join(host).join("wheel/wsg-sim"), self.folder.join("bin/wsg-sim"))?;
        Ok(())
    }
}

/// Returns the linker for a shared library, if it is not the default one.
fn linker(triple: &str) -> Option<&'static str> {
    (triple == AARCH64 && cfg!(not(target_arch = "aarch64"))).then_some("aarch64-linux-gnu-gcc")
}

fn runs(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success())
}

/// Returns the ABI version in the header, which is part of the shared library's name.
fn abi_version() -> Result<String> {
    let header = fs::read_to_string(Path::new(SOURCES).join("include/wsg.h"))?;
    let (_, rest) =
        header.split_once("#define WSG_ABI_VERSION ").context("wsg.h does not define WSG_ABI_VERSION")?;
    Ok(rest.lines().next().unwrap_or_default().to_owned())
}

/// Packs the folder, reproducibly.
fn pack(to: &Path, name: &str) -> Result<()> {
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
