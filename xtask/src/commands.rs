//! Commands that consist of one run of another program of the workspace or of a tool.

use std::{
    env,
    ffi::OsString,
    process::{Command, ExitStatus},
};

use anyhow::{Context, Result, ensure};
use boards::Board;

use crate::{
    firmware::{self, IMAGE_VARIABLE, Image, Variant},
    platforms, process,
    ros2::SECOND_CLIENT,
    setup::{self, ThumbToolchain},
    tool::{
        self, CARGO_AUDITABLE, CARGO_CYCLONEDX, CARGO_DENY, CARGO_LLVM_COV, CARGO_PUBLIC_API,
        CARGO_SEMVER_CHECKS, MDBOOK, MIRI, NIGHTLY,
    },
    web,
    workspace::{TARGET_CRATES, Workspace},
};

/// Runs the demonstration of an image, or of the bridge's library, with its own `arguments`, and returns its exit status.
pub(crate) fn demo(
    workspace: &Workspace,
    image: Option<&Image>,
    arguments: &[OsString],
) -> Result<ExitStatus> {
    let mut cargo = workspace.cargo_in_current_dir("run -q -p host-tests --bin demo --");
    if let Some(image) = image {
        cargo.arg("--elf").arg(&image.path);
        setup::set_up_emulator(workspace, image.board, &mut cargo)?;
    }
    process::run_for_status(cargo.args(arguments))
}

/// Builds the delivery folder for PLC engineers with `image` and the book.
pub(crate) fn dist(workspace: &Workspace, image: &Image) -> Result<()> {
    tools_of_book(workspace)?;
    let mut cargo = workspace.cargo("run -q -p dist -- folder --book --elf");
    process::run(cargo.arg(&image.path).arg("--to").arg(workspace.target_dir.join("dist")))
}

/// Name prefix of the tests of the C library that need the archive with all targets.
pub(crate) const WHOLE_ARCHIVE: &str = "whole::";

/// Builds the archive for C and C++ programmers. An archive with all targets is tested.
pub(crate) fn dist_c(workspace: &Workspace, arguments: &[OsString]) -> Result<()> {
    setup::thumb_and_qemu(workspace)?;
    let missing = setup::lacking(&setup::FOR_C);
    let folder = workspace.target_dir.join("dist-c");
    process::run(workspace.cargo("run --quiet -p dist-c -- --to").arg(&folder).args(arguments))?;
    if arguments.is_empty() {
        let mut tests = workspace.cargo("test -p dist-c -- --include-ignored --skip");
        tests.arg(platforms::TESTS).env("WSG_C_ARCHIVE", folder);
        process::run(tests.args(missing.iter().flat_map(|name| ["--skip", name])))?;
        ensure!(missing.is_empty(), "NOT CHECKED: the archive, {}", missing.join(", "));
    }
    Ok(())
}

/// Builds the documents as a book.
pub(crate) fn docs(workspace: &Workspace) -> Result<()> {
    tools_of_book(workspace)?;
    process::run(&mut workspace.cargo("run -q -p dist -- book"))?;
    web::add_to_book(workspace)
}

/// Installs mdBook and Chromium. Without Chromium, there is no PDF.
fn tools_of_book(workspace: &Workspace) -> Result<()> {
    setup::lacking(&[("the PDF", "chromium", "chromium")]);
    MDBOOK.require(workspace, "the book")
}

/// Compares public APIs and command lines with their records, or writes the records.
pub(crate) fn api(workspace: &Workspace, update: bool) -> Result<()> {
    [NIGHTLY, CARGO_PUBLIC_API, CARGO_SEMVER_CHECKS]
        .iter()
        .try_for_each(|tool| tool.require(workspace, "public APIs"))?;
    process::run(workspace.cargo("run -q -p dist -- api").args(update.then_some("--update")))
}

/// Makes the files to upload, all or some `parts`, and tries them. Programs for systems without an emulator here are only linked.
pub(crate) fn release(workspace: &Workspace, parts: &[OsString]) -> Result<()> {
    for target in ["x86_64-unknown-linux-musl", "aarch64-unknown-linux-musl", platforms::WINDOWS] {
        ensure!(setup::provide_target(workspace, target), "rustup could not install {target}");
    }
    [CARGO_AUDITABLE, CARGO_CYCLONEDX].iter().try_for_each(|tool| tool.require(workspace, "the release"))?;
    setup::lacking(&platforms::FROM_DEBIAN);
    setup::lacking(&[
        ("aarch64", "qemu-aarch64-static", "qemu-user-static"),
        ("containers", "buildah", "buildah"),
        ("units", "systemd-analyze", "systemd"),
    ]);
    let zig = setup::zig(workspace).context("zig cannot be installed")?.join("bin");
    let path = env::var_os("PATH").unwrap_or_default();
    tools_of_book(workspace)?;
    let mut release = workspace.cargo("run -q -p dist -- release --to");
    release.arg(workspace.target_dir.join(concat!("release-", env!("CARGO_PKG_VERSION")))).args(parts);
    release.env("PATH", env::join_paths([zig].into_iter().chain(env::split_paths(&path)))?);
    setup::set_up_emulator(workspace, Board::named("pico")?, &mut release)?;
    process::run(&mut release)
}

/// Checks licences, bans and sources of the dependencies against deny.toml. Advisories are not checked, because they need a network.
pub(crate) fn dependencies(workspace: &Workspace) -> Result<()> {
    CARGO_DENY.require(workspace, "licences, bans and sources of the dependencies")?;
    ["", SECOND_CLIENT].iter().try_for_each(|folder| {
        let mut deny = tool::plain(workspace, "cargo deny --locked check licenses bans sources --config");
        process::run(deny.arg(workspace.root.join("deny.toml")).current_dir(workspace.root.join(folder)))
    })
}

/// Measures the stopping time of the gripper on a disturbed line in virtual time, and returns the rows of the table. Fails if a case
/// exceeds its limit.
pub(crate) fn fast_stop(workspace: &Workspace) -> Result<String> {
    let mut cargo = workspace.cargo("run --quiet --release -p host-tests --example fast_stop");
    let table = process::output(&mut cargo).context("the gripper did not stop in time")?;
    print!("{table}");
    Ok(table)
}

/// Measures the transfers of an update to a Pico in its emulator, and returns their table.
pub(crate) fn update_times(toolchain: &ThumbToolchain<'_>) -> Result<String> {
    let mut tests = toolchain.workspace.cargo(
        "test --quiet -p host-tests --test end_to_end each_transport_receives_an_image -- --include-ignored --nocapture",
    );
    let board = Board::emulated("pico")?;
    setup::set_up_emulator(toolchain.workspace, board, &mut tests)?;
    tests.env("WSG_WHOLE", "1").env("WSG_BOOT_ELF_PICO", firmware::boot_loader(toolchain, board)?.path);
    tests.env("WSG_SLOT_ELF_PICO", firmware::build_for_slot(toolchain, board)?.path);
    let printed = process::output(&mut tests).context("a transport did not receive the image")?;
    let rows = printed.lines().filter(|line| line.starts_with("| ")).flat_map(|row| [row, "\n"]);
    let head = document::table(["transport", "bytes", "transfer and check"], []);
    let table = head + &rows.collect::<String>();
    print!("{table}");
    Ok(table)
}

/// Default number of states to explore.
pub(crate) const STATES: u64 = 100_000_000;

/// Explores every order of events on the bridge, up to this number of states. Fails if a property is violated, and prints the
/// shortest violation.
pub(crate) fn explore(workspace: &Workspace, states: u64) -> Result<()> {
    let mut cargo = workspace.cargo("run --quiet --release -p host-tests --example explore --");
    process::run(cargo.arg(states.to_string())).context("a property is violated; see the output above")
}

/// The length and seed of a soak test.
#[derive(clap::Args)]
pub(crate) struct Soak {
    /// Number of commands to send
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    commands: u64,
    /// Seed of the corrupted bytes
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Board to run; it must be emulated
    #[arg(long, value_name = "NAME", value_parser = Board::emulated, default_value = Board::default_name())]
    board: &'static Board,
}

impl Soak {
    /// The extent for `ci`, about 90 s.
    pub(crate) const CI: Self = Self { commands: 700, seed: 1, board: &boards::BOARDS[0] };
}

/// Runs the test that sends commands to the image in the emulator on a faulty line. Its last line summarizes the results.
pub(crate) fn soak(toolchain: &ThumbToolchain<'_>, extent: &Soak) -> Result<()> {
    let image = firmware::build(toolchain, &Variant { board: extent.board, ..Variant::default() })?;
    let mut cargo =
        toolchain.workspace.cargo("test -q -p host-tests --test end_to_end soak_on_a_faulty_line --");
    cargo.args(["--include-ignored", "--nocapture"]).env(IMAGE_VARIABLE, &image.path);
    cargo.env("WSG_SOAK_COMMANDS", extent.commands.to_string());
    process::run(cargo.env("WSG_SOAK_SEED", extent.seed.to_string()))
}

/// Runs the load test of `wsg telemetry` with 500 virtual grippers, separately from all other tests.
pub(crate) fn telemetry(workspace: &Workspace) -> Result<()> {
    let mut cargo =
        workspace.cargo("test --release -p wsg-tool --test telemetry five_hundred -- --nocapture");
    process::run(cargo.env("WSG_LOAD", "1"))
}

/// Checks data shared by interrupt handlers and the main loop under every order that the memory model allows, with `loom`.
pub(crate) fn loom(workspace: &Workspace) -> Result<()> {
    let mut models = workspace.cargo("test --release --lib ::model:: -p");
    models.arg(firmware::BRIDGE);
    // A separate build folder, because the flag would cause a full rebuild of everything else.
    models.env("RUSTFLAGS", "--cfg loom").env("CARGO_TARGET_DIR", workspace.target_dir.join("loom"));
    let printed = process::output(&mut models)?;
    print!("{printed}");
    ensure!(!printed.contains("running 0 tests"), "no loom models were run");
    println!(
        "loom: bytes, frames, images and silences stay whole, in order and current under every order of events"
    );
    Ok(())
}

/// Runs the tests of the bridge's library, which contains the firmware's static queues, under Miri.
pub(crate) fn miri(workspace: &Workspace) -> Result<()> {
    [NIGHTLY, MIRI].iter().try_for_each(|tool| tool.require(workspace, "the bridge's tests in Miri"))?;
    let mut miri = tool::plain(workspace, "rustup run nightly cargo miri test --locked --lib -p");
    miri.arg(firmware::BRIDGE).env("CARGO_TARGET_DIR", workspace.target_dir.join("miri"));
    // Property tests write failures to files, which Miri's isolation prevents. Buffers that are statics on a board are leaked here.
    // Few cases, to save time.
    miri.env("MIRIFLAGS", "-Zmiri-disable-isolation -Zmiri-ignore-leaks").env("PROPTEST_CASES", "4");
    process::run(&mut miri)?;
    println!(
        "miri: no undefined behaviour in the bridge's host tests (board code, which only the target has, is not among them)"
    );
    Ok(())
}

/// Prints the line coverage of the library crates per file and in total, by the tests without doc examples.
pub(crate) fn coverage(workspace: &Workspace) -> Result<()> {
    CARGO_LLVM_COV.require(workspace, "the coverage of protocol and buses")?;
    // CARGO_LLVM_COV_SETUP lets it install missing LLVM tools with rustup without asking.
    let mut coverage = tool::plain(workspace, "cargo llvm-cov --locked --lib --tests");
    coverage.env("CARGO_LLVM_COV_SETUP", "yes");
    coverage.args(["--ignore-filename-regex", r"tests\.rs|/tests/|gripper-sim|host-tests|boards/|/xtask/"]);
    coverage.args(TARGET_CRATES.into_iter().flat_map(|package| ["-p", package]));
    // The tests of the bridge in virtual time.
    coverage.args(["-p", "host-tests"]);
    coverage.env("CARGO_LLVM_COV_TARGET_DIR", workspace.target_dir.join("coverage"));
    process::run(&mut coverage)
}

/// Fails with installation instructions if probe-rs is missing. Called before the build, which takes longer.
pub(crate) fn require_probe_rs() -> Result<()> {
    let version = process::answer(Command::new("probe-rs").arg("--version"));
    ensure!(version.is_some(), "probe-rs not found; install it with: cargo install probe-rs-tools --locked");
    Ok(())
}

/// Writes the image to the board's flash over its debug probe, and starts it.
pub(crate) fn flash(image: &Image) -> Result<()> {
    process::run(Command::new("probe-rs").args(["download", "--chip", image.board.chip]).arg(&image.path))?;
    process::run(Command::new("probe-rs").args(["reset", "--chip", image.board.chip]))
}
