//! The PLC's actions, step by step, and their expected results.

use std::fs::File;
use std::io::Write;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use host_tests::emulator::Emulator;
use host_tests::rig::{PATIENCE, Rig, motions, names};
use host_tests::trace::Trace;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{RECIPES, Recipe};
use wsg_protocol::{CommandId, SystemFlags};
use wsg_sim::{Config, Part};

use crate::options::Options;

/// The recipe that opens wide, for MOVE.
const WIDE: u8 = 1;
/// The recipe that closes slowly enough to be stopped in mid travel.
const SLOW: u8 = 2;

/// First line of a demonstration without an emulator.
const WITHOUT_BOARD: &str =
    "demo: the bridge's library runs on this computer in place of a board; the firmware is not tested";

/// Permitted deviation of the fingers from their target, in mm.
const TOLERANCE: f32 = 0.1;

/// Name and action of a step.
type Step = (&'static str, fn(&Run) -> Result<Outcome>);

/// Outcome of a step that did not fail.
enum Outcome {
    Passed,
    /// The step does not apply to this run.
    LeftOut(&'static str),
}

/// The rig and the parameters of this run.
struct Run {
    rig: Rig,
    part: Option<Part>,
    /// The recipe closest to the part's width.
    recipe: u8,
    /// Whether that recipe can find the part.
    fits: bool,
}

const STEPS: [Step; 12] = [
    ("power up: the gripper answers, and nothing moves", power_up),
    ("FAST STOP wire connected and acknowledged", acknowledge_power_up),
    ("HOME: the fingers are referenced", home),
    ("MOVE: wide open", move_wide),
    ("GRIP the part", grip),
    ("the part is pulled out", pull_out),
    ("RELEASE", release),
    ("GRIP with no part", grip_nothing),
    ("RELEASE again", release),
    ("STOP in mid travel", stop_in_mid_travel),
    ("FAST STOP wire broken: motion is refused until it is mended and acknowledged", break_fast_stop_wire),
    ("gripper line cut and restored", cut_line),
];

/// Plays all steps. Returns whether all succeeded.
pub(crate) fn play(options: &Options) -> Result<bool> {
    let mut sinks: Vec<Box<dyn Write + Send>> = vec![Box::new(std::io::stdout())];
    if let Some(path) = &options.trace {
        let file =
            File::create(path).with_context(|| format!("cannot write the trace to {}", path.display()))?;
        sinks.push(Box::new(file));
    }
    let trace = Trace::new(sinks);
    // The part is placed only before the grip, because homing must not hit it.
    let config = Config { time_scale: options.speed_up.unwrap_or(1.0), ..Config::default() };
    let (board, remark) = match &options.elf {
        Some(elf) => (Emulator::start(elf)?, ""),
        None => {
            trace.headline(WITHOUT_BOARD);
            (Emulator::start_library()?, " (the bridge's library, not the firmware)")
        }
    };
    trace.headline("  seconds  PLC: its wires; bridge: its wires; -> to the gripper; <- from the gripper");
    let rig = Rig::of(board, None, config, trace.clone())?;
    let (recipe, fits) = recipe_for(options.part, &config);
    let run = Run { rig, part: options.part, recipe, fits };

    let (mut passed, mut failed) = (0, 0);
    for (number, (name, step)) in (1..).zip(STEPS) {
        trace.headline(&format!("\n=== {number}. {name}"));
        match step(&run) {
            Ok(Outcome::Passed) => {
                passed += 1;
                trace.headline("    passed");
            }
            Ok(Outcome::LeftOut(why)) => trace.headline(&format!("    left out: {why}")),
            Err(error) => {
                failed += 1;
                trace.headline(&format!("    FAILED: {error:#}"));
            }
        }
    }
    trace.finish(&format!("\ndemo: {passed} steps passed, {failed} failed{remark}"));
    Ok(failed == 0)
}

/// Returns the recipe closest to the part's width, and whether it can find the part.
fn recipe_for(part: Option<Part>, config: &Config) -> (u8, bool) {
    let Some(part) = part else { return (0, false) };
    let off = |recipe: &Recipe| part.width() - f32::from(recipe.width) / 100.0;
    let nearest = (0u8..).zip(&RECIPES).min_by(|(_, a), (_, b)| off(a).abs().total_cmp(&off(b).abs()));
    let (number, recipe) = nearest.unwrap_or((0, &RECIPES[0]));
    (number, off(recipe) > -config.clamping_travel && off(recipe) <= config.part_width_tolerance)
}

fn power_up(run: &Run) -> Result<Outcome> {
    let rig = &run.rig;
    let outputs = rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK))?;
    ensure!(
        !outputs.contains(Outputs::READY),
        "READY although the FAST STOP wire is low: {}",
        names(outputs)
    );
    rig.catch_up()?;
    let moved = motions(&rig.trace().since(0));
    ensure!(moved.is_empty(), "the bridge sent {moved:?} by itself");
    Ok(Outcome::Passed)
}

fn acknowledge_power_up(run: &Run) -> Result<Outcome> {
    run.rig.release_fast_stop()?;
    Ok(Outcome::Passed)
}

fn home(run: &Run) -> Result<Outcome> {
    let outputs = run.rig.command(Inputs::HOME)?;
    expect(outputs, Outputs::READY | Outputs::REFERENCED | Outputs::LINK_OK)?;
    Ok(Outcome::Passed)
}

fn move_wide(run: &Run) -> Result<Outcome> {
    run.rig.select_recipe(WIDE)?;
    let outputs = run.rig.command(Inputs::MOVE)?;
    expect(outputs, Outputs::READY | Outputs::REFERENCED | Outputs::LINK_OK)?;
    run.stands_at(f32::from(RECIPES[usize::from(WIDE)].width) / 100.0)
}

fn grip(run: &Run) -> Result<Outcome> {
    run.rig.gripper().set_part(run.part);
    run.rig.select_recipe(run.recipe)?;
    let outputs = run.rig.command(Inputs::GRIP)?;
    let found = if run.fits { Outputs::HOLDING } else { Outputs::PART_FAULT };
    expect(outputs, found | Outputs::READY | Outputs::REFERENCED | Outputs::LINK_OK)?;
    Ok(Outcome::Passed)
}

fn pull_out(run: &Run) -> Result<Outcome> {
    if !run.fits {
        return Ok(Outcome::LeftOut("no part is held"));
    }
    run.rig.gripper().set_part(None);
    let outputs = run.rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::PART_FAULT))?;
    ensure!(!outputs.contains(Outputs::HOLDING), "still HOLDING");
    Ok(Outcome::Passed)
}

fn release(run: &Run) -> Result<Outcome> {
    run.rig.gripper().set_part(None);
    let outputs = run.rig.command(Inputs::RELEASE)?;
    expect(outputs, Outputs::READY | Outputs::REFERENCED | Outputs::LINK_OK)?;
    run.stands_at(f32::from(RECIPES[usize::from(run.recipe)].release_width) / 100.0)
}

fn grip_nothing(run: &Run) -> Result<Outcome> {
    let outputs = run.rig.command(Inputs::GRIP)?;
    expect(outputs, Outputs::PART_FAULT | Outputs::READY | Outputs::REFERENCED | Outputs::LINK_OK)?;
    Ok(Outcome::Passed)
}

fn stop_in_mid_travel(run: &Run) -> Result<Outcome> {
    let rig = &run.rig;
    rig.select_recipe(WIDE)?;
    rig.command(Inputs::MOVE)?;
    rig.select_recipe(SLOW)?;
    let start = rig.gripper().state().width;
    rig.begin(Inputs::MOVE)?;
    let bound = Instant::now() + PATIENCE;
    while (rig.gripper().state().width - start).abs() < 2.0 {
        ensure!(Instant::now() < bound, "the fingers do not start to move");
    }
    rig.pulse(Inputs::STOP_ACK)?;
    let outputs = rig.await_outputs(PATIENCE, |outputs| !outputs.contains(Outputs::BUSY))?;
    expect(outputs & !Outputs::READY, Outputs::REFERENCED | Outputs::LINK_OK)?;
    rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::READY))
        .context("not READY after STOP")?;
    let state = rig.gripper().state();
    let target = f32::from(RECIPES[usize::from(SLOW)].width) / 100.0;
    ensure!(
        (state.width - target).abs() > 1.0,
        "the fingers arrived at {:.2} mm in spite of STOP",
        state.width
    );
    ensure!(state.flags.contains(SystemFlags::AXIS_STOPPED), "the gripper reports no STOP: {}", state.flags);
    Ok(Outcome::Passed)
}

fn break_fast_stop_wire(run: &Run) -> Result<Outcome> {
    let rig = &run.rig;
    rig.set(Inputs::FAST_STOP_OK, false)?;
    rig.await_outputs(PATIENCE, |outputs| {
        !outputs.contains(Outputs::READY) && outputs.contains(Outputs::ERROR)
    })
    .context("the broken wire is not reported")?;
    let (mark, width) = (rig.trace().mark(), rig.gripper().state().width);
    rig.pulse(Inputs::MOVE)?;
    rig.set(Inputs::FAST_STOP_OK, true)?;
    rig.pulse(Inputs::HOME)?;
    let moved: Vec<CommandId> = rig.motions_since(mark)?;
    ensure!(moved.is_empty(), "the bridge sent {moved:?} in spite of FAST STOP");
    ensure!(rig.gripper().state().width == width, "the fingers moved in FAST STOP");
    rig.release_fast_stop()?;
    Ok(Outcome::Passed)
}

fn cut_line(run: &Run) -> Result<Outcome> {
    let rig = &run.rig;
    rig.gripper().cut(true);
    let cut_at = rig.board().now_ms()?;
    rig.await_outputs(PATIENCE, |outputs| !outputs.contains(Outputs::LINK_OK))
        .context("the cut is not detected")?;
    let detected_ms = rig.board().now_ms()?.wrapping_sub(cut_at);
    ensure!(detected_ms < 2_000, "the cut was detected after {detected_ms} ms");
    rig.gripper().cut(false);
    let outputs =
        rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK | Outputs::READY))?;
    expect(outputs, Outputs::READY | Outputs::REFERENCED | Outputs::LINK_OK)?;
    Ok(Outcome::Passed)
}

impl Run {
    fn stands_at(&self, width: f32) -> Result<Outcome> {
        let stands = self.rig.gripper().state().width;
        ensure!(
            (stands - width).abs() < TOLERANCE,
            "the fingers are at {stands:.2} mm instead of {width:.2} mm"
        );
        Ok(Outcome::Passed)
    }
}

fn expect(outputs: Outputs, wanted: Outputs) -> Result<()> {
    ensure!(outputs == wanted, "the outputs are {} instead of {}", names(outputs), names(wanted));
    Ok(())
}
