//! Output levels compared with the table of docs/wiring.md, in cases that need a particular gripper, flag or time.

use host_tests::rtu_double::RtuDouble;
use host_tests::world::{IDLE, WIRES, World, quick, with_part};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Config, RECIPES};
use wsg_protocol::CommandId;
use wsg_sim::{Fault, Model, Part};

#[test]
fn persistent_fault_keeps_ready_low_despite_acknowledgements() {
    // Only the overload of the motor causes a FAST STOP (command set, appendix B, D14 to D16).
    for (fault, is_latched) in
        [(Fault::OverTemperature, false), (Fault::SupplyOutOfRange, false), (Fault::MotorCurrent, true)]
    {
        let mut rig = World::homed(WIRES, quick());
        let now = rig.now();
        rig.gripper().set_fault(fault, true, now);
        assert!(rig.until(100, |outputs| !outputs.contains(Outputs::READY)), "{fault:?}");
        for _ in 0..3 {
            rig.pulse(Inputs::STOP_ACK);
            let shown = |outputs: Outputs| {
                outputs.contains(Outputs::READY) || !outputs.contains(Outputs::ERROR | Outputs::LINK_OK)
            };
            assert!(!rig.until(200, shown), "{fault:?}: {:?}", rig.outputs());
        }
        let now = rig.now();
        rig.gripper().set_fault(fault, false, now);
        if is_latched {
            rig.pass(100);
            assert!(rig.outputs().contains(Outputs::ERROR), "{fault:?}: not cleared automatically");
            rig.pulse(Inputs::STOP_ACK);
        }
        assert!(rig.until(200, |outputs| outputs == IDLE), "{fault:?}: {:?}", rig.outputs());
    }
}

#[test]
fn ready_is_low_while_stop_ack_is_high() {
    let mut rig = World::homed(WIRES, quick());
    rig.set(Inputs::STOP_ACK, true);
    assert!(rig.until(5, |outputs| !outputs.contains(Outputs::READY)));
    assert!(!rig.until(1_000, |outputs| outputs.contains(Outputs::READY)), "{:?}", rig.outputs());
    rig.set(Inputs::STOP_ACK, false);
    assert!(rig.until(5, |outputs| outputs == IDLE), "{:?}", rig.outputs());
}

#[test]
fn recipe_grips_with_its_force_on_a_wsg_70() {
    // Recipes with a force within the limits of a WSG 70.
    for number in [0, 3] {
        let recipe = RECIPES[number];
        let width = f32::from(recipe.width) / 100.0;
        let config = wsg_sim::Config { model: Model::Wsg70, part: Part::of_width(width), ..quick() };
        let mut rig = World::homed(WIRES, config);
        rig.set(Inputs::RECIPE0, number & 1 != 0);
        rig.set(Inputs::RECIPE1, number & 2 != 0);
        assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING, "recipe {number}");
        let force = f32::from(recipe.force) / 100.0;
        let state = rig.gripper().state();
        assert_eq!((state.force_limit, state.force), (force, force), "recipe {number}");
    }
}

/// Start of a reply that is never completed: preamble, id, and a length that the bridge accepts.
const HALF_FRAME: [u8; 7] = [0xAA, 0xAA, 0xAA, 0x41, 60, 0, 0];

#[test]
fn incomplete_frame_is_discarded_20_ms_after_its_last_byte() {
    let mut rig = World::new(WIRES, quick());
    let mut dropped_after = |ms: u32, delivered: &[u8]| {
        rig.far.line.deliver(delivered);
        rig.skip_ms(ms - 1);
        rig.turn_alone(&mut RtuDouble::default());
        rig.counters().line.dropped
    };
    let (begun, rest) = HALF_FRAME.split_at(4);
    assert_eq!(dropped_after(1_000, begun), 0);
    assert_eq!(dropped_after(15, rest), 0);
    for ms in 1..20 {
        assert_eq!(dropped_after(1, &[]), 0, "after {ms} ms");
    }
    assert_eq!(usize::from(dropped_after(1, &[])), HALF_FRAME.len());
}

#[test]
fn incomplete_frame_does_not_swallow_later_reports() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
    // Until the line has been idle for longer than the time-out of an incomplete frame.
    let mut silent_ms = 0;
    while silent_ms < 3 {
        silent_ms = if rig.take_sent().is_empty() { silent_ms + 1 } else { 0 };
        rig.step();
    }
    rig.far.inject(&HALF_FRAME);
    rig.pass(21);
    let now = rig.now();
    rig.gripper().set_part(None, now);
    assert!(rig.until(15, |outputs| outputs.contains(Outputs::PART_FAULT)), "{:?}", rig.outputs());
}

#[test]
fn at_most_256_bytes_are_read_per_turn() {
    let mut rig = World::new(WIRES, quick());
    rig.far.line.deliver(&[0x55; 1_000]);
    for turn in 1..=3 {
        rig.turn_alone(&mut RtuDouble::default());
        assert_eq!(u32::from(rig.counters().line.dropped), 256 * turn);
    }
}

#[test]
fn recipe_takes_effect_with_its_command_while_the_gripper_sends() {
    let recipe = RECIPES[3];
    let width = f32::from(recipe.width) / 100.0;
    let mut rig = World::homed(WIRES, with_part(width));
    rig.inputs |= Inputs::RECIPE0 | Inputs::RECIPE1 | Inputs::GRIP;
    for _ in 0..10 {
        rig.far.inject(&[0]);
        rig.step();
    }
    rig.set(Inputs::GRIP, false);
    assert!(rig.until(5_000, |outputs| outputs == IDLE | Outputs::HOLDING), "{:?}", rig.outputs());
    assert_eq!(rig.gripper().state().force_limit, f32::from(recipe.force) / 100.0);
}

#[test]
fn fast_stop_is_sent_in_the_turn_that_reads_its_wire_low() {
    let mut rig = World::homed(WIRES, quick());
    // Until the line is free.
    rig.until(100, |_| false);
    while !rig.take_sent().is_empty() {
        rig.step();
    }
    rig.set(Inputs::FAST_STOP_OK, false);
    rig.step();
    assert_eq!(rig.take_sent(), [CommandId::FastStop]);
}

#[test]
fn busy_lasts_50_ms_for_a_motion_already_at_its_target() {
    let mut rig = World::homed(WIRES, quick());
    rig.command(Inputs::MOVE);
    rig.set(Inputs::MOVE, true);
    let busy = |rig: &mut World| {
        rig.step();
        rig.outputs().contains(Outputs::BUSY)
    };
    assert!((0..20).any(|_| busy(&mut rig)));
    let mut lasted_ms = 1;
    while busy(&mut rig) {
        lasted_ms += 1;
    }
    assert_eq!(lasted_ms, Config::DEFAULT.wires.min_busy_ms);
}
