//! `cargo xtask`: set-up, build, demo, test, measurement and flashing for this workspace.
//!
//! Each command first installs its prerequisites. Every program that it runs is printed beforehand.

mod bench;
mod board;
mod book;
mod coverage;
mod demo;
mod dependencies;
mod explore;
mod fast_stop;
mod figures;
mod firmware;
mod flash;
mod fuzz;
mod gate;
mod interleavings;
mod matrix;
mod measure;
mod mutants;
mod panics;
mod platforms;
mod probe;
mod process;
mod public_functions;
mod python;
mod recording;
mod settings;
mod setup;
mod size;
mod soak;
mod stack;
mod test;
mod tool;
mod undefined_behaviour;
mod workspace;

use std::{
    ffi::OsString,
    process::{ExitCode, ExitStatus},
};

use anyhow::{Context, Result, ensure};
use lexopt::{Arg, Parser, ValueExt};

use board::Board;
use firmware::Variant;
use matrix::Extent;
use settings::Change;
use workspace::Workspace;

const HELP: &str = "\
cargo xtask <command>

Commands
  setup              install the prerequisites of build, demo and test: Rust for the thumb targets, QEMU, and
                     the third-party masters for the tests (mbpoll, Python and Node.js packages)
  build              build the firmware image; print its path and SHA-256
                     [--board NAME]: b-l475e-iot01a (default), pico (also builds a UF2 file), or
                     nucleo-g474re (not emulated; its image has never been executed);
                     [--set NAME=VALUE]: change a default setting (docs/registers.md);
                     [--features X]: enable additional features. Such an image gets a separate name
  demo [ARGS]        run the image in an emulator between a PLC and a virtual gripper;
                     [--board NAME] comes first and must be emulated; ARGS: --part none|WIDTH_MM, --speed-up X, --trace FILE;
                     --record FILE.svg instead of ARGS: also write an animated picture of the run (docs/demo.svg)
  test [FILTER]      run all checks of the workspace, including the emulator tests;
                     with FILTER, only the tests whose names match; with --strict before FILTER,
                     checks that had to be skipped are failures instead of being listed
  matrix             check the protocol crate with every combination of features on three targets, the
                     workspace on the oldest supported Rust, and the packages for crates.io
  ci                 release checks: deny, test --strict with the long tests in full, platforms, a
                     short soak, fast-stop, explore, loom and Miri
  platforms          run wsg-sim.exe under Wine; compile everything that `cargo test` builds for Windows and macOS
  deny               check licences, bans and sources of all dependencies against deny.toml (cargo-deny)
  size               check flash and static RAM of each board's image, and of the protocol relative to
                     an empty program, against their limits
  stack              determine the firmware's worst-case stack by walking its calls and by painting
                     the stack in the emulator
  panics             prove by linking that firmware, protocol and buses cannot reach a panic
  bench              count instructions in the emulator and compare them with a committed baseline
                     [--update: rewrite it]; measure throughput and latency on this machine
  fast-stop          measure the stopping time with every byte around the request corrupted in turn, in
                     virtual time, against the limits in docs/wiring.md; about two minutes
  explore            explore every order of events on the bridge up to 10^8 states; about ten
                     minutes on two cores [--states N]
  fuzz               run the fuzz targets [--seconds N per target, default 60]; needs nightly Rust and cargo-fuzz.
                     --inputs N: run their bodies on N generated inputs each, on stable Rust
  soak               send 10 000 commands in the emulator while one byte in 10 000 is corrupted; about
                     15 minutes [--commands N] [--seed N]
  mutants [FILE...]  find changes of protocol, buses and bridge library, or of the given files, that no
                     test detects; takes hours in full [--jobs N: run N in parallel, default 1] [--shard K/N: test
                     every N-th only] [--again: skip those caught by the previous run]; cargo-mutants
  loom               check data shared by interrupt handlers and the main loop under every order of events
  miri               run the bridge's host tests under Miri; needs nightly Rust
  coverage           report the lines of protocol and buses that their tests cover (cargo-llvm-cov)
  figures            measure all figures of docs/figures.md and update the file
  python             build the wheel of bindings/python and test it in a virtual environment; part of test
  dist               build the delivery folder for PLC engineers (reproducible)
  docs               build the documents as a book in target/book (mdbook), and print it to target/book.pdf
                     (Chromium; without it, there is no PDF)
  flash              write the image to a board with probe-rs and start it
                     [--board NAME] [--set NAME=VALUE] [--features X] as for build
  help               print this page

Environment
  WSG_NO_INSTALL=1   install nothing: if something is missing, print the commands and stop
  WSG_NO_RUSTUP=1    work as if rustup's server were unreachable: do not call rustup, ignore thumb
                     targets that it installed, and build for them with Debian's Rust packages
  CI                 if set, disables incremental compilation (CARGO_INCREMENTAL=0)
  WSG_FIRMWARE_ELF   set by test for the emulator tests: the image to boot
  WSG_FIRMWARE_ELF_CAN_GRIPPER, WSG_FIRMWARE_ELF_CAN_PLC, WSG_FIRMWARE_ELF_CAN_BOTH,
  WSG_FIRMWARE_ELF_NO_BUS, WSG_FIRMWARE_ELF_PROFIBUS
                     the same for images with other bus settings; with the suffix _PICO for the Pico
  WSG_C_LIBRARY      set by test: the static library for the program in C that runs in the emulator
  WSG_WHOLE=1        set by ci: run long tests in full
  WSG_LOAD=1         set by ci: run the load test with 500 grippers
  WSG_SIM_EXE        set by platforms for its tests: the simulator's Windows executable
  WSG_MODBUS_PYTHON, WSG_MODBUS_NODE
                     set by test for tests with third-party masters: their Python, and their Node.js packages
  CARGO_TARGET_DIR   build folder (default: target); images are in its subfolder firmware

Set-up does nothing if all prerequisites are present. As root, it installs missing packages without
asking, on Debian bookworm from backports. If necessary, it adds the backports to the apt sources
(/etc/apt/sources.list.d/wsg-bookworm-backports.sources).
";

fn main() -> ExitCode {
    match run() {
        Ok(code) => code,
        Err(error) => {
            // Not `{:?}`, because a backtrace of xtask would not help the user.
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<ExitCode> {
    let mut arguments = Parser::from_env();
    let command = match arguments.next()? {
        None | Some(Arg::Short('h') | Arg::Long("help")) => "help".to_owned(),
        Some(Arg::Value(command)) => command.string()?,
        Some(other) => return Err(other.unexpected()).context("see `cargo xtask help`"),
    };
    match command.as_str() {
        "help" => print!("{HELP}"),
        "setup" => {
            no_more(arguments)?;
            let workspace = Workspace::from_env()?;
            setup::thumb_and_qemu(&workspace)?;
            match &setup::masters(&workspace).missing[..] {
                [] => println!("setup: all prerequisites are present"),
                missing => println!("setup: test will skip checks that need {}", missing.join(", ")),
            }
        }
        "build" => {
            let variant = variant(arguments)?;
            let workspace = Workspace::from_env()?;
            let toolchain = setup::thumb(&workspace)?;
            print_image(&firmware::build(&workspace, &toolchain, &variant)?);
        }
        "demo" => {
            let workspace = Workspace::from_env()?;
            let mut arguments = rest(arguments)?;
            let mut board = <&Board>::default();
            if let [option, name, ..] = &arguments[..]
                && option == "--board"
            {
                board = Board::named(&name.to_string_lossy())?;
                ensure!(board.emulated.is_some(), "the board {} is not emulated", board.name);
                arguments.drain(..2);
            }
            let toolchain = setup::thumb_and_qemu(&workspace)?;
            let image = firmware::build(&workspace, &toolchain, &Variant { board, ..Variant::default() })?;
            if let [option, file] = &arguments[..]
                && option == "--record"
            {
                return Ok(exit_code(demo::record(&workspace, &image, file.as_ref())?));
            }
            return Ok(exit_code(demo::run(&workspace, &image, &arguments)?));
        }
        "test" => {
            let workspace = Workspace::from_env()?;
            let toolchain = setup::thumb_and_qemu(&workspace)?;
            let image = firmware::build(&workspace, &toolchain, &Variant::default())?;
            print_image(&image);
            let mut filter = rest(arguments)?;
            let is_strict = filter.first().is_some_and(|first| first == "--strict");
            filter.drain(..usize::from(is_strict));
            test::run(&workspace, &toolchain, &filter, Extent::Quick, is_strict)?;
        }
        "python" => {
            no_more(arguments)?;
            let workspace = Workspace::from_env()?;
            let environment =
                setup::python(&workspace).context("the tools of the Python package are missing")?;
            python::test(&workspace, &environment)?;
        }
        "dist" => {
            no_more(arguments)?;
            let workspace = Workspace::from_env()?;
            let image = firmware::build(&workspace, &setup::thumb(&workspace)?, &Variant::default())?;
            demo::dist(&workspace, &image)?;
        }
        "docs" => {
            no_more(arguments)?;
            book::build(&Workspace::from_env()?)?;
        }
        "matrix" => {
            no_more(arguments)?;
            matrix::run(&Workspace::from_env()?)?;
        }
        "flash" => {
            let variant = variant(arguments)?;
            flash::require_probe_rs()?;
            let workspace = Workspace::from_env()?;
            let toolchain = setup::thumb(&workspace)?;
            let image = firmware::build(&workspace, &toolchain, &variant)?;
            print_image(&image);
            flash::run(&image)?;
        }
        other => measure::run(other, arguments)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn print_image(image: &firmware::Image) {
    println!("{}\nsha256 {}", image.path.display(), image.sha256);
    if image.board.emulated.is_none() {
        println!(
            "warning: the image for {} has never been executed, because the board is not emulated",
            image.board.name
        );
    }
}

/// Parses `--board NAME`, and any number of `--features X` and `--set NAME=VALUE`.
fn variant(mut arguments: Parser) -> Result<Variant> {
    let mut variant = Variant::default();
    while let Some(argument) = arguments.next()? {
        match argument {
            Arg::Long("features") => {
                let list = arguments.value()?.string()?;
                variant
                    .features
                    .extend(list.split([',', ' ']).filter(|it| !it.is_empty()).map(str::to_owned));
            }
            Arg::Long("board") => variant.board = Board::named(&arguments.value()?.string()?)?,
            Arg::Long("set") => variant.settings.push(Change::parse(&arguments.value()?.string()?)?),
            other => return Err(other.unexpected()).context("see `cargo xtask help`"),
        }
    }
    settings::check(&variant.settings)?;
    Ok(variant)
}

fn no_more(mut arguments: Parser) -> Result<()> {
    match arguments.next()? {
        None => Ok(()),
        Some(argument) => Err(argument.unexpected()).context("see `cargo xtask help`"),
    }
}

fn rest(mut arguments: Parser) -> Result<Vec<OsString>> {
    Ok(arguments.raw_args()?.collect())
}

/// Returns the exit code of a program, or a failure if a signal ended it.
fn exit_code(status: ExitStatus) -> ExitCode {
    match status.code() {
        Some(code) => ExitCode::from(u8::try_from(code).unwrap_or(1)),
        None => ExitCode::FAILURE,
    }
}
