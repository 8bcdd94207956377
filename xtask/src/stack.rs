//! The firmware's worst-case stack: by a walk over all calls in the image, and by a painted stack in the emulator.
//!
//! The walk sees every path and takes each as possible; the emulator sees what really happens in a bad case. The truth
//! lies between the two.

use std::{fs, process::Command};

use anyhow::{Context, Result, ensure};
use footprint::Program;

use crate::{
    board::Board,
    firmware::{self, Image},
    gate::Gate,
    process,
    setup::{self, ThumbToolchain},
    workspace::Workspace,
};

const LIMIT: u64 = 3 * 1024;

/// What an exception puts on the stack by itself: 8 registers and a word to align; and 18 of the floating point unit, if there is one.
const EXCEPTION_FRAME: u64 = 4 * (8 + 1);
const FLOAT_FRAME: u64 = 4 * 18;

/// Walks the calls of each board's firmware.
pub(crate) fn walked(
    workspace: &Workspace,
    toolchain: &ThumbToolchain,
    images: &[Image],
) -> Result<Vec<Gate>> {
    images.iter().map(|image| walk(workspace, toolchain, image)).collect()
}

fn walk(workspace: &Workspace, toolchain: &ThumbToolchain, image: &Image) -> Result<Gate> {
    let elf = build_with_sizes(workspace, toolchain, image.board)?;
    let what_failed = || format!("cannot walk the calls of {}", image.path.display());
    let program = Program::of(&elf).with_context(what_failed)?;
    // The option gives symbols other hashes, so functions lie in another order, and some bytes more or less apart.
    let tested = Program::of(&fs::read(&image.path)?).with_context(what_failed)?;
    ensure!(
        program.code_len.abs_diff(tested.code_len) * 100 <= tested.code_len
            && program.function_count() == tested.function_count(),
        "the image with stack sizes holds other code ({} B) than the image ({} B)",
        program.code_len,
        tested.code_len
    );
    let deepest = program.deepest().with_context(what_failed)?;
    for function in &deepest.by_prologue {
        println!("  no stack size from the compiler, taken from its code: {function}");
    }
    for function in &deepest.indirect {
        println!("  indirect call, taken for one of any function whose address is taken: {function}");
    }
    let own = EXCEPTION_FRAME + if image.board.triple.ends_with("hf") { FLOAT_FRAME } else { 0 };
    println!("  program: {} B", deepest.program.bytes);
    for step in &deepest.program.path {
        println!("    {step}");
    }
    for handler in &deepest.handlers {
        println!("  exception: {} B and {own} B by itself: {}", handler.bytes, handler.path.join(" > "));
    }
    let exceptions: u64 = deepest.handlers.iter().map(|handler| handler.bytes + own).sum();
    println!("  counted as if every exception interrupted the one before at its deepest");
    let what = image.board.figure("worst-case stack, walked");
    Ok(Gate::bytes(what, deepest.program.bytes + exceptions, LIMIT))
}

/// The deepest that the stack of each image was seen: an example of host-tests boots it on painted memory, puts it
/// through the worst that it knows, and looks how far the paint is gone.
pub(crate) fn painted(workspace: &Workspace, images: &[Image]) -> Result<Vec<Gate>> {
    // As a part of the workspace: with the features that the tests have, nothing is built twice.
    process::run(workspace.cargo("build").args(["-q", "--workspace", "--example", "painted_stack"]))?;
    let emulated = images.iter().filter(|image| image.board.emulated.is_some());
    emulated.map(|image| paint(workspace, image)).collect()
}

fn paint(workspace: &Workspace, image: &Image) -> Result<Gate> {
    let mut program = Command::new(workspace.target_dir.join("debug/examples/painted_stack"));
    setup::tell_emulator(workspace, image.board, &mut program)?;
    let said = process::output(program.arg(&image.path))?;
    let bytes = said.lines().find_map(|line| line.strip_prefix("painted-stack ")?.trim().parse().ok());
    let bytes = bytes.context("the program painted-stack told no figure")?;
    Ok(Gate::bytes(image.board.figure("worst-case stack, painted in the emulator"), bytes, LIMIT))
}

/// The image once more, with a section of stack sizes that takes no memory.
fn build_with_sizes(workspace: &Workspace, toolchain: &ThumbToolchain, board: &Board) -> Result<Vec<u8>> {
    let mut cargo = toolchain.cargo(workspace, "build", board.triple);
    cargo.args(firmware::selection(board, &[]));
    cargo.args(["--config", &format!("target.{}.rustflags=[\"-Zemit-stack-sizes\"]", board.triple)]);
    // Apart from the image that is tested. The option is not stable, the section that it writes is LLVM's.
    let target_dir = workspace.target_dir.join("stack");
    cargo.env("CARGO_TARGET_DIR", &target_dir).env("RUSTC_BOOTSTRAP", "1");
    process::run(&mut cargo)?;
    let output_dir = toolchain.output_dir(workspace, board.triple, "firmware");
    let below = output_dir.strip_prefix(&workspace.target_dir).unwrap_or(&output_dir);
    // Debian's tool chain has a folder of its own below the target folder, which the variable replaces.
    let below = below.strip_prefix("debian").unwrap_or(below);
    let path = target_dir.join(below).join(board.name);
    fs::read(&path).with_context(|| format!("cannot read {}", path.display()))
}
