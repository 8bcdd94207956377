//! Worst-case stack of the firmware, by walking all calls in the image and by painting the stack in the emulator.
//!
//! The walk assumes that every path is possible, so it gives an upper bound. The emulator observes a demanding run, so it gives a
//! lower bound.

use std::{fs, process::Command};

use anyhow::{Context, Result};
use footprint::Program;

use crate::{firmware::Image, gate::Gate, process, setup, workspace::Workspace};

const LIMIT: u64 = 3 * 1024;

/// Stack used by exception entry in bytes: 8 registers and an alignment word, plus 18 words with a floating-point unit.
const EXCEPTION_FRAME: u64 = 4 * (8 + 1);
const FLOAT_FRAME: u64 = 4 * 18;

/// Walks the calls in each board's firmware.
pub(crate) fn walked(images: &[Image]) -> Result<Vec<Gate>> {
    images.iter().map(walk).collect()
}

fn walk(image: &Image) -> Result<Gate> {
    let what_failed = || format!("cannot walk the calls of {}", image.path.display());
    let program = Program::of(&fs::read(&image.path)?).with_context(what_failed)?;
    let deepest = program.deepest().with_context(what_failed)?;
    for function in &deepest.indirect {
        println!("  indirect call, assumed to reach any function whose address is taken: {function}");
    }
    let own = EXCEPTION_FRAME + if image.board.triple.ends_with("hf") { FLOAT_FRAME } else { 0 };
    println!("  program: {} B", deepest.program.bytes);
    for step in &deepest.program.path {
        println!("    {step}");
    }
    for handler in &deepest.handlers {
        println!("  exception: {} B plus {own} B for entry: {}", handler.bytes, handler.path.join(" > "));
    }
    let exceptions: u64 = deepest.handlers.iter().map(|handler| handler.bytes + own).sum();
    println!("  assuming that every exception interrupts the previous one at its deepest point");
    let what = image.board.figure("worst-case stack, walked");
    Ok(Gate::bytes(what, deepest.program.bytes + exceptions, LIMIT))
}

/// Measures the observed stack depth of each image. An example of host-tests boots it on painted memory, runs a demanding load, and
/// checks how much paint is left.
pub(crate) fn painted(workspace: &Workspace, images: &[Image]) -> Result<Vec<Gate>> {
    process::run(&mut workspace.cargo(&format!("build -q --workspace {}", Workspace::FEATURES_OF_TESTS)))?;
    let paint = |image: &Image| {
        let mut program = Command::new(workspace.target_dir.join("debug/examples/painted_stack"));
        setup::set_up_emulator(workspace, image.board, &mut program)?;
        let printed = process::output(program.arg(&image.path))?;
        let bytes = printed.lines().find_map(|line| line.strip_prefix("painted-stack ")?.trim().parse().ok());
        let bytes = bytes.context("painted_stack printed no figure")?;
        Ok(Gate::bytes(image.board.figure("worst-case stack, painted in the emulator"), bytes, LIMIT))
    };
    images.iter().filter(|image| image.board.emulated.is_some()).map(paint).collect()
}
