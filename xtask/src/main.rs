//! `cargo xtask`: set-up, build, demo, test, figures and flash of this workspace.
//!
//! What a command needs is set up first; each program that is run for it is printed before.

mod bench;
mod board;
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
  setup              install what build, demo and test need: the thumb target's Rust, QEMU, and
                     the masters of the tests (mbpoll, packages of Python, and of Node.js if it is there)
  build              build the firmware image, print its path and SHA-256
                     [--board NAME]: b-l475e-iot01a; pico, which has a UF2 file beside it; or
                     nucleo-g474re, which no emulator has, so that nobody has ever run its image;
                     [--set NAME=VALUE]: a setting that it is delivered with (docs/registers.md);
                     [--features X]: more features. The image then has a name of its own
  demo [ARGS]        boot the image in an emulator between a PLC and a virtual gripper;
                     [--board NAME] first, one that an emulator has; ARGS: --part none|WIDTH_MM, --speed-up X, --trace FILE
  test [FILTER]      every check of the workspace, the emulator tests included;
                     with FILTER only the tests whose names match it; --strict before it: fails where
                     something could not be checked or compared, which is else only said
  matrix             the protocol crate with every combination of its features on three targets,
                     the workspace on the oldest Rust, and the package for crates.io
  ci                 deny, test --strict with all of what test does in part, then platforms, a short
                     soak, fast-stop, explore, loom and Miri: before a release
  platforms          wsg-sim.exe under Wine, and what `cargo test` builds compiled for Windows and macOS
  deny               licences, bans and sources of all dependencies against deny.toml; cargo-deny
  size               flash and static RAM of each board's image, and of the protocol beside an empty
                     program, against their limits
  stack              the firmware's worst-case stack, by a walk over its calls and by a painted
                     stack in the emulator
  panics             firmware, protocol and buses link only if no panic can be reached
  bench              instructions on a Cortex-M4, counted in the emulator and held to a committed
                     baseline [--update: write it anew]; throughput and latency on this machine
  fast-stop          how long the gripper takes to stop with every byte around it damaged in turn, in
                     virtual time, against the limits of docs/wiring.md; some two minutes
  explore            every order of events on the bridge, until 10^8 states were met; some ten
                     minutes on two cores [--states N]
  fuzz               the fuzz targets [--seconds N each, 60 if not given]; nightly Rust, cargo-fuzz.
                     --inputs N: their bodies over so many generated inputs each, on stable Rust
  soak               10 000 commands in the emulator on a line where one byte in 10 000 goes wrong;
                     a quarter of an hour [--commands N] [--seed N]
  mutants [FILE...]  changes of protocol, buses and the bridge's library, or of these files of them, that no
                     test notices; takes hours for all [--jobs N: at a time, 1] [--shard K/N: every N-th,
                     a sample] [--again: but those that the run before has caught]; cargo-mutants
  loom               what interrupt handlers and the main loop share, under every order of events
  miri               the bridge's host tests under Miri; nightly Rust
  coverage           lines of protocol and buses that their tests reach; cargo-llvm-cov
  figures            measure all that docs/figures.md tells, and write it
  dist               make the folder that a PLC engineer gets; the same bytes wherever it is made
  docs               make the book of docs/ in target/book; mdbook
  flash              write the image to a board with probe-rs and start it
                     [--board NAME] [--set NAME=VALUE] [--features X] as for build
  help               this page

Environment
  WSG_NO_INSTALL=1   install nothing: where something is missing, print the commands and stop
  WSG_NO_RUSTUP=1    as if rustup's server were out of reach: rustup is not called, a thumb
                     target that it installed is not used, and Debian's Rust packages build
                     for the target instead
  CI                 where it is set, cargo notes nothing for the next build (CARGO_INCREMENTAL=0)
  WSG_FIRMWARE_ELF   set by test for the emulator tests: the image to boot
  WSG_FIRMWARE_ELF_CAN_GRIPPER, WSG_FIRMWARE_ELF_CAN_PLC, WSG_FIRMWARE_ELF_CAN_BOTH,
  WSG_FIRMWARE_ELF_NO_BUS, WSG_FIRMWARE_ELF_PROFIBUS
                     the same for images whose settings put them on these; each with _PICO behind it for the Pico
  WSG_WHOLE=1        set by ci: tests that take long are run in full
  WSG_LOAD=1         set by ci: the test with 500 grippers runs
  WSG_SIM_EXE        set by platforms for its tests: the program for Windows
  WSG_MODBUS_PYTHON, WSG_MODBUS_NODE
                     set by test for those with masters: the Python, and the folder, that have them
  CARGO_TARGET_DIR   where builds go (default: target); images are in its folder firmware

Set-up runs nothing on a machine that has everything. As root it installs what is missing without
asking, on Debian bookworm from its backports, whose source it adds if it is not there
(/etc/apt/sources.list.d/wsg-bookworm-backports.sources).
";

fn main() -> ExitCode {
    match run() {
        Ok(code) => code,
        Err(error) => {
            // Not `{:?}`: a person reads this, and a backtrace of xtask would not help.
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
                [] => println!("setup: everything is there"),
                missing => println!("setup: test will not check what needs {}", missing.join(", ")),
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
                ensure!(board.emulated.is_some(), "no emulator has the board {}", board.name);
                arguments.drain(..2);
            }
            let toolchain = setup::thumb_and_qemu(&workspace)?;
            let image = firmware::build(&workspace, &toolchain, &Variant { board, ..Variant::default() })?;
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
        "dist" => {
            no_more(arguments)?;
            let workspace = Workspace::from_env()?;
            let image = firmware::build(&workspace, &setup::thumb(&workspace)?, &Variant::default())?;
            demo::dist(&workspace, &image)?;
        }
        "docs" => {
            no_more(arguments)?;
            tool::book(&Workspace::from_env()?)?;
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
        println!("nobody has ever run an image for {}: no emulator has that board", image.board.name);
    }
}

/// `--board NAME`; `--features X` and `--set NAME=VALUE`, each as often as wanted.
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

/// A program that a signal ended has no code of its own.
fn exit_code(status: ExitStatus) -> ExitCode {
    match status.code() {
        Some(code) => ExitCode::from(u8::try_from(code).unwrap_or(1)),
        None => ExitCode::FAILURE,
    }
}
