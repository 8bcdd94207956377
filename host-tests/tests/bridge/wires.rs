//! The bridge library with wires and a virtual gripper, in virtual time: output levels and safety.

use host_tests::rtu_double::RtuDouble;
use host_tests::serial_gripper::SerialLine;
use host_tests::world::{IDLE, WIRES, World, quick, with_part};
use proptest::prelude::*;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Config as BridgeConfig, ResetCause, WiresConfig};
use wsg_protocol::frame::MAX_MESSAGE_LEN;
use wsg_protocol::{
    Command, CommandId, DeviceTag, Event, FrameEncoder, FrameParser, GripperState, HomingDirection, Kind,
    Reply, Status, SystemFlags, Value,
};
use wsg_sim::{Config, Part};

fn frame(reply: Reply<'_>) -> Vec<u8> {
    FrameEncoder::new(reply.id().code(), reply).collect()
}

/// Raises a command wire. Returns the number of turns until the frame of this motion is complete, and the commands sent until
/// then.
fn raise(rig: &mut World, wire: Inputs, motion: CommandId) -> (u32, Vec<CommandId>) {
    rig.take_sent();
    rig.set(wire, true);
    let mut sent = vec![];
    for turn in 1..100 {
        rig.step();
        sent.extend(rig.take_sent());
        if sent.contains(&motion) {
            return (turn, sent);
        }
    }
    panic!("{motion} is not sent: {sent:?}");
}

/// Lowers the wire, and waits for the end of the motion.
fn finish(rig: &mut World, wire: Inputs) {
    rig.set(wire, false);
    assert!(rig.until(10_000, |outputs| outputs.contains(Outputs::BUSY)));
    assert!(rig.until(10_000, |outputs| outputs.contains(Outputs::READY)));
}

#[test]
fn grip_is_sent_at_once_if_its_force_limit_is_known() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    rig.command(Inputs::GRIP);
    for pause_ms in 0..300 {
        let (release_turns, _) = raise(&mut rig, Inputs::RELEASE, CommandId::ReleasePart);
        finish(&mut rig, Inputs::RELEASE);
        rig.pass(pause_ms);
        let (turns, sent) = raise(&mut rig, Inputs::GRIP, CommandId::GripPart);
        assert!(!sent.contains(&CommandId::SetForceLimit), "after {pause_ms} ms: {sent:?}");
        // The frame is as long as the frame of RELEASE. One of the session's own requests may be on the line.
        assert!(turns <= release_turns, "after {pause_ms} ms: {turns} turns instead of {release_turns}");
        finish(&mut rig, Inputs::GRIP);
    }
}

#[test]
fn force_limit_changed_by_a_third_party_is_set_again() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    rig.command(Inputs::GRIP);
    rig.command(Inputs::RELEASE);
    let force = rig.gripper().state().force_limit;
    let other = Command::SetForceLimit { force: force + 1.0 };
    let mut bytes = FrameEncoder::new(other.id().code(), other).collect::<Vec<u8>>();
    // Between two of the bridge's frames.
    rig.far.to_gripper = Some(Box::new(move |line| {
        if line.is_empty() {
            line.append(&mut bytes);
        }
    }));
    rig.pass(150);
    assert_eq!(rig.gripper().state().force_limit, force + 1.0);
    let (_, sent) = raise(&mut rig, Inputs::GRIP, CommandId::GripPart);
    assert!(sent.contains(&CommandId::SetForceLimit), "{sent:?}");
    assert_eq!(rig.gripper().state().force_limit, force);
}

#[test]
fn recipe_wires_choose_the_width() {
    for (number, width) in [(0u8, 20.0), (1, 80.0), (2, 10.0), (3, 50.0)] {
        let mut rig = World::homed(WIRES, quick());
        rig.set(Inputs::RECIPE0, number & 1 != 0);
        rig.set(Inputs::RECIPE1, number & 2 != 0);
        rig.command(Inputs::MOVE);
        let stands = rig.gripper().state().width;
        assert!((stands - width).abs() < 0.05, "recipe {number}: {stands}");
    }
}

#[test]
fn fast_stop_ends_busy_at_once() {
    let mut rig = World::homed(WIRES, quick());
    rig.set(Inputs::MOVE, true);
    assert!(rig.until(100, |outputs| outputs.contains(Outputs::BUSY)));
    rig.set(Inputs::FAST_STOP_OK, false);
    assert!(rig.until(20, |outputs| outputs == Outputs::ERROR | Outputs::REFERENCED | Outputs::LINK_OK));
}

/// Gives an edge at READY. Returns the duration of BUSY, and the outputs after it.
fn edge_at_ready(rig: &mut World, wire: Inputs) -> (u32, Outputs) {
    assert!(rig.outputs().contains(Outputs::READY), "{:?}", rig.outputs());
    rig.set(wire, true);
    assert!(rig.until(5, |outputs| outputs.contains(Outputs::BUSY)), "{wire:?}: {:?}", rig.outputs());
    let begun = rig.now();
    assert!(rig.until(10_000, |outputs| !outputs.contains(Outputs::BUSY)));
    let busy_ms = (rig.now().as_micros() - begun.as_micros()) / 1_000;
    rig.set(wire, false);
    rig.pass(5);
    (busy_ms as u32, rig.outputs())
}

#[test]
fn edge_refused_at_ready_shows_busy_for_50_ms_even_in_error() {
    // The gripper ends a motion with an error, so GSTATE is ERROR and READY is high.
    let mut rig = World::homed(WIRES, quick());
    let now = rig.now();
    rig.gripper().set_part(Part::of_width(90.0), now);
    let (_, outputs) = edge_at_ready(&mut rig, Inputs::MOVE);
    let in_error = IDLE | Outputs::ERROR;
    assert_eq!(outputs, in_error, "blocked");
    rig.take_sent();
    for _ in 0..3 {
        let (busy_ms, outputs) = edge_at_ready(&mut rig, Inputs::MOVE);
        assert!((50..=52).contains(&busy_ms), "{busy_ms} ms");
        assert_eq!(outputs, in_error);
        assert_eq!(rig.take_motions(), []);
    }
    // Recovery by wires alone.
    let now = rig.now();
    rig.gripper().set_part(None, now);
    rig.pulse(Inputs::STOP_ACK);
    assert!(rig.until(100, |outputs| outputs == IDLE), "{:?}", rig.outputs());
    assert_eq!(rig.command(Inputs::MOVE), IDLE);
}

#[test]
fn move_is_refused_after_no_part_until_a_release() {
    let mut rig = World::homed(WIRES, quick());
    let (_, no_part) = edge_at_ready(&mut rig, Inputs::GRIP);
    assert_eq!(no_part, IDLE | Outputs::PART_FAULT);
    let (busy_ms, refused) = edge_at_ready(&mut rig, Inputs::MOVE);
    assert!((50..=52).contains(&busy_ms), "{busy_ms} ms");
    assert_eq!(refused, no_part | Outputs::ERROR);
    assert_eq!(rig.command(Inputs::RELEASE), IDLE);
    assert_eq!(rig.command(Inputs::MOVE), IDLE);
}

/// A PLC that monitors HOLDING must not take a refusal for a lost part.
#[test]
fn refused_edge_does_not_change_holding_and_part_fault() {
    for (config, result) in [(with_part(20.0), Outputs::HOLDING), (quick(), Outputs::PART_FAULT)] {
        let mut rig = World::homed(WIRES, config);
        assert_eq!(rig.command(Inputs::GRIP), IDLE | result);
        rig.set(Inputs::MOVE, true);
        assert!(rig.until(5, |outputs| outputs.contains(Outputs::BUSY)));
        assert!(!rig.until(100, |outputs| !outputs.contains(result)), "{:?}", rig.outputs());
        assert_eq!(rig.outputs(), IDLE | result | Outputs::ERROR);
    }
}

#[test]
fn lost_part_is_released_or_gripped_again_by_wires_alone() {
    for way_out in [Inputs::RELEASE, Inputs::GRIP] {
        let mut rig = World::homed(WIRES, with_part(20.0));
        rig.command(Inputs::GRIP);
        let now = rig.now();
        rig.gripper().set_part(None, now);
        assert!(rig.until(50, |outputs| outputs == IDLE | Outputs::PART_FAULT), "{:?}", rig.outputs());
        let (_, refused) = edge_at_ready(&mut rig, Inputs::MOVE);
        assert_eq!(refused, IDLE | Outputs::PART_FAULT | Outputs::ERROR);
        let taken = rig.command(way_out);
        assert!(!taken.contains(Outputs::ERROR), "{way_out:?}: {taken:?}");
        if way_out == Inputs::GRIP {
            assert_eq!(taken, IDLE | Outputs::PART_FAULT, "the part is gone");
            rig.command(Inputs::RELEASE);
        }
        let now = rig.now();
        rig.gripper().set_part(Part::of_width(20.0), now);
        assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
    }
}

fn homed_with_min_busy(min_busy_ms: u32) -> World {
    let wires = WiresConfig { min_busy_ms, ..WiresConfig::DEFAULT };
    let mut rig = World::new(BridgeConfig { wires, ..WIRES }, quick());
    rig.get_homed();
    rig
}

#[test]
fn refusal_shows_busy_for_at_least_50_ms_at_any_min_busy() {
    for (min_busy_ms, expected) in [(0, 50..=52), (70, 70..=72)] {
        let mut rig = homed_with_min_busy(min_busy_ms);
        assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::PART_FAULT);
        let (busy_ms, _) = edge_at_ready(&mut rig, Inputs::MOVE);
        assert!(expected.contains(&busy_ms), "MIN_BUSY {min_busy_ms}: {busy_ms} ms");
    }
}

#[test]
fn busy_shows_exactly_the_motion_without_a_min_busy() {
    let mut rig = homed_with_min_busy(0);
    rig.command(Inputs::MOVE);
    // The fingers are already at the target.
    let (busy_ms, _) = edge_at_ready(&mut rig, Inputs::MOVE);
    assert!((1..50).contains(&busy_ms), "{busy_ms} ms");
    // Until the force limit is set, no motion runs.
    let (_, outputs) = edge_at_ready(&mut rig, Inputs::GRIP);
    assert_eq!(
        (rig.take_motions().last(), outputs),
        (Some(&CommandId::GripPart), IDLE | Outputs::PART_FAULT)
    );
}

#[test]
fn motion_refused_by_the_gripper_shows_busy_for_50_ms() {
    let mut rig = World::ready(WIRES, quick());
    for _ in 0..2 {
        let (busy_ms, outputs) = edge_at_ready(&mut rig, Inputs::GRIP);
        assert!((50..=52).contains(&busy_ms), "{busy_ms} ms");
        assert_eq!(outputs, Outputs::READY | Outputs::ERROR | Outputs::LINK_OK, "not referenced");
    }
    assert_eq!(rig.command(Inputs::HOME), IDLE, "homing clears the error");
}

#[test]
fn recipe_change_during_a_motion_has_no_effect() {
    let mut rig = World::homed(WIRES, quick());
    rig.set(Inputs::MOVE, true);
    rig.until(100, |outputs| outputs.contains(Outputs::BUSY));
    rig.set(Inputs::RECIPE0 | Inputs::RECIPE1, true);
    assert!(rig.until(10_000, |outputs| !outputs.contains(Outputs::BUSY)));
    assert_eq!(rig.outputs(), IDLE, "no FAST STOP");
}

#[test]
fn second_command_during_motion_shows_error_and_is_not_sent() {
    let mut rig = World::homed(WIRES, quick());
    rig.take_sent();
    rig.set(Inputs::MOVE, true);
    rig.until(100, |outputs| outputs.contains(Outputs::BUSY));
    rig.pulse(Inputs::RELEASE);
    assert!(rig.outputs().contains(Outputs::ERROR | Outputs::BUSY));
    assert!(rig.until(10_000, |outputs| !outputs.contains(Outputs::BUSY)));
    assert_eq!(rig.outputs(), IDLE, "the motion's own result counts");
    assert_eq!(rig.take_motions(), [CommandId::PrePosition]);
}

#[test]
fn stop_while_holding_releases_the_force() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    rig.command(Inputs::GRIP);
    rig.pulse(Inputs::STOP_ACK);
    assert!(rig.until(100, |outputs| outputs == IDLE), "{:?}", rig.outputs());
    assert_eq!(rig.gripper().state().force, 0.0);
}

#[test]
fn fast_stop_low_at_power_up_blocks_until_high_and_acknowledged() {
    let mut rig = World::new(WIRES, quick());
    let commands = [Inputs::GRIP, Inputs::RELEASE, Inputs::MOVE, Inputs::HOME];
    let try_all = |rig: &mut World| {
        for wire in commands {
            rig.pulse(wire);
            rig.pass(50);
        }
    };
    rig.pass(500);
    assert!(rig.outputs().contains(Outputs::LINK_OK | Outputs::ERROR));
    try_all(&mut rig);
    rig.pulse(Inputs::STOP_ACK);
    try_all(&mut rig);
    rig.set(Inputs::FAST_STOP_OK, true);
    rig.pass(20);
    try_all(&mut rig);
    assert_eq!(rig.take_motions(), []);
    rig.pulse(Inputs::STOP_ACK);
    assert!(rig.until(100, |outputs| outputs == Outputs::READY | Outputs::LINK_OK), "{:?}", rig.outputs());
    rig.command(Inputs::HOME);
    assert_eq!(rig.take_motions(), [CommandId::Homing]);
}

#[test]
fn fast_stop_low_at_power_up_acts_despite_bouncing_command_wire() {
    let mut rig = World::new(WIRES, quick());
    let chatter = |rig: &mut World, ms: u32| {
        for n in 0..ms {
            rig.set(Inputs::GRIP, n % 2 == 0);
            rig.pass(1);
        }
    };
    rig.set(Inputs::STOP_ACK, true);
    chatter(&mut rig, 300);
    assert!(rig.take_sent().contains(&CommandId::FastStop));
    rig.set(Inputs::FAST_STOP_OK, true);
    chatter(&mut rig, 300);
    rig.set(Inputs::GRIP, true);
    rig.pass(300);
    let sent = rig.take_sent();
    assert!(!sent.contains(&CommandId::Acknowledge), "STOP/ACK was high from the start: {sent:?}");
    assert!(sent.iter().all(|id| id.kind() != Kind::Motion), "and so was GRIP: {sent:?}");
    assert!(rig.outputs().contains(Outputs::ERROR));
    rig.set(Inputs::STOP_ACK | Inputs::GRIP, false);
    rig.pass(10);
    rig.pulse(Inputs::STOP_ACK);
    assert!(rig.until(100, |outputs| outputs == Outputs::READY | Outputs::LINK_OK), "{:?}", rig.outputs());
}

#[test]
fn silent_gripper_is_polled_and_receives_no_motion() {
    let mut rig = World::new(WIRES, quick());
    rig.far.to_bridge = Some(Box::new(Vec::clear));
    rig.set(Inputs::FAST_STOP_OK, true);
    for _ in 0..20 {
        for wire in [Inputs::STOP_ACK, Inputs::HOME, Inputs::GRIP] {
            rig.pulse(wire);
            rig.pass(100);
        }
    }
    assert!(!rig.outputs().intersects(Outputs::LINK_OK | Outputs::READY | Outputs::BUSY));
    assert_eq!(rig.take_motions(), []);
}

#[test]
fn command_while_line_is_cut_is_not_executed_after_repair() {
    let mut rig = World::homed(WIRES, quick());
    rig.take_sent();
    rig.far.to_bridge = Some(Box::new(Vec::clear));
    rig.far.to_gripper = Some(Box::new(Vec::clear));
    assert!(
        rig.until(1_000, |outputs| !outputs.contains(Outputs::LINK_OK)),
        "the cut is shown within a second"
    );
    rig.pulse(Inputs::MOVE);
    rig.far.to_bridge = None;
    rig.far.to_gripper = None;
    assert!(rig.until(1_000, |outputs| outputs.contains(Outputs::LINK_OK)));
    rig.pass(1_000);
    assert_eq!(rig.take_motions(), []);
}

#[test]
fn line_cut_during_a_motion_reports_an_unknown_outcome() {
    let mut rig = World::homed(WIRES, Config::default());
    rig.set(Inputs::MOVE, true);
    rig.until(100, |outputs| outputs.contains(Outputs::BUSY));
    rig.set(Inputs::MOVE, false);
    rig.far.to_bridge = Some(Box::new(Vec::clear));
    assert!(rig.until(1_000, |outputs| outputs == Outputs::ERROR), "{:?}", rig.outputs());
    rig.far.to_bridge = None;
    assert!(rig.until(5_000, |outputs| outputs.contains(Outputs::READY)));
    assert!(rig.outputs().contains(Outputs::ERROR), "the outcome is still unknown");
    rig.set(Inputs::RECIPE0, true);
    rig.pulse(Inputs::STOP_ACK);
    assert_eq!(rig.command(Inputs::MOVE), IDLE, "an acknowledgement clears it");
}

#[test]
fn result_with_a_wrong_checksum_is_detected_and_recovered() {
    let mut rig = World::homed(WIRES, quick());
    rig.take_sent();
    // The second reply to Pre-position (21h, E_SUCCESS) is damaged once.
    let result = frame(Reply::status_only(CommandId::PrePosition, Status::Success));
    let mut done = false;
    rig.far.to_bridge = Some(Box::new(move |bytes| {
        if let Some(at) = bytes.windows(result.len()).position(|window| window == result).filter(|_| !done) {
            bytes[at + 6] ^= 0x10;
            done = true;
        }
    }));
    rig.set(Inputs::RECIPE0, true);
    let outputs = rig.command(Inputs::MOVE);
    assert!(outputs.contains(Outputs::ERROR | Outputs::LINK_OK), "{outputs:?}");
    assert_eq!(rig.counters().line.bad_checksum, 1);
    rig.set(Inputs::RECIPE0, false);
    rig.pulse(Inputs::STOP_ACK);
    assert_eq!(rig.command(Inputs::MOVE), IDLE);
    assert_eq!(rig.take_motions(), [CommandId::PrePosition; 2], "one for each edge");
}

#[test]
fn unsolicited_answers_change_nothing() {
    let mut rig = World::homed(WIRES, quick());
    let outputs = rig.outputs();
    rig.take_sent();
    for id in CommandId::ALL.iter().filter(|id| !matches!(id.code(), 0x40 | 0x41)) {
        for status in [Status::Success, Status::CmdPending, Status::CmdFailed] {
            rig.far.inject(&frame(Reply::status_only(*id, status)));
        }
    }
    rig.pass(300);
    assert_eq!(rig.outputs(), outputs);
    assert_eq!(rig.take_motions(), []);
    assert!(rig.counters().session.unsolicited > 50, "the replies are counted: {:?}", rig.counters());
}

/// Restarted at once, or switched off for 200 ms, which is too short for LINK_OK to fall.
#[test]
fn gripper_restart_is_shown_as_unreferenced_within_250_ms() {
    for (off_ms, offset_ms) in
        [0, 200].into_iter().flat_map(|off| (0..200).step_by(7).map(move |at| (off, at)))
    {
        let mut rig = World::homed(WIRES, quick());
        rig.pass(offset_ms);
        rig.far.to_gripper = Some(Box::new(Vec::clear));
        rig.far.to_bridge = Some(Box::new(Vec::clear));
        rig.pass(off_ms);
        (rig.far.to_gripper, rig.far.to_bridge) = (None, None);
        rig.restart_gripper(quick());
        let shown = rig.until(250, |outputs| outputs == Outputs::READY | Outputs::LINK_OK);
        assert!(shown, "off for {off_ms} ms, {offset_ms}: {:?}", rig.outputs());
    }
}

/// Returns a rig in a FAST STOP confirmed by the gripper, with `FAST_STOP_OK` low.
fn held_in_fast_stop() -> World {
    let mut rig = World::homed(WIRES, quick());
    rig.set(Inputs::FAST_STOP_OK, false);
    rig.pass(100);
    assert!(rig.gripper().state().flags.contains(SystemFlags::FAST_STOP));
    rig
}

/// Fieldbus, 6.6: FASTSTOP is a level.
#[test]
fn low_fast_stop_wire_stops_motion_unlocked_by_a_third_party() {
    for offset_ms in 0..40 {
        let mut rig = held_in_fast_stop();
        for _ in 0..3 {
            rig.pass(offset_ms);
            let now = rig.now();
            rig.gripper().command(&Command::ACKNOWLEDGE, now);
            rig.gripper().command(&Command::Homing { direction: HomingDirection::Default }, now);
            rig.pass(250);
            let state = rig.gripper().state();
            assert!(state.flags.contains(SystemFlags::FAST_STOP), "{offset_ms}: {state:?}");
            assert_eq!(state.speed, 0.0, "{offset_ms}");
            assert_eq!(rig.outputs() & (Outputs::ERROR | Outputs::READY), Outputs::ERROR);
        }
    }
}

/// Fieldbus, 6.6.
#[test]
fn third_party_may_acknowledge_after_the_fast_stop_wire_is_high() {
    let mut rig = held_in_fast_stop();
    rig.set(Inputs::FAST_STOP_OK, true);
    rig.pass(100);
    assert!(rig.outputs().contains(Outputs::ERROR), "not acknowledged");
    let now = rig.now();
    rig.gripper().command(&Command::ACKNOWLEDGE, now);
    assert!(rig.until(250, |outputs| outputs == IDLE), "{:?}", rig.outputs());
    assert_eq!(rig.command(Inputs::MOVE), IDLE);
}

/// Fieldbus, 6.6.
#[test]
fn low_fast_stop_wire_stops_a_restarted_gripper_within_250_ms() {
    for offset_ms in (0..200).step_by(7) {
        let mut rig = held_in_fast_stop();
        rig.pass(offset_ms);
        rig.restart_gripper(quick());
        rig.pass(250);
        assert!(rig.gripper().state().flags.contains(SystemFlags::FAST_STOP), "{offset_ms}");
        assert_eq!(rig.outputs(), Outputs::ERROR | Outputs::LINK_OK, "{offset_ms}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn after_any_noise_the_bridge_works_again(noise in proptest::collection::vec(prop_oneof![Just(0xAAu8), any::<u8>()], 0..200)) {
        let mut rig = World::homed(WIRES, with_part(20.0));
        rig.far.inject(&noise);
        rig.pass(2_000);
        if !rig.outputs().contains(Outputs::READY) {
            // Noise may contain a valid report by chance, of a FAST STOP for example. The next periodic query corrects it.
            rig.pass(2_000);
        }
        prop_assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
    }
}

#[test]
fn watchdog_is_fed_once_per_turn_if_time_has_passed() {
    let mut rig = World::new(WIRES, quick());
    for _ in 0..100 {
        rig.step();
        let now_ms = rig.now_ms();
        assert!(rig.bridge().may_feed_watchdog(now_ms));
        assert!(!rig.bridge().may_feed_watchdog(now_ms + 1), "no turn");
    }
    rig.freeze();
    let now_ms = rig.now_ms();
    for _ in 0..1_000 {
        rig.step();
        assert!(!rig.bridge().may_feed_watchdog(now_ms), "the clock has stopped");
    }
}

#[test]
fn watchdog_is_not_fed_while_the_line_returns_errors() {
    let mut rig = World::new(WIRES, quick());
    rig.far.line = SerialLine::failing();
    rig.set(Inputs::FAST_STOP_OK, true);
    for _ in 0..100 {
        rig.step();
        let now_ms = rig.now_ms();
        assert!(!rig.bridge().may_feed_watchdog(now_ms));
    }
}

#[test]
fn fast_stop_is_sent_with_a_stopped_clock() {
    let mut rig = World::homed(WIRES, quick());
    rig.take_sent();
    rig.set(Inputs::FAST_STOP_OK, false);
    rig.freeze();
    rig.pass(3);
    assert_eq!(rig.take_sent().first(), Some(&CommandId::FastStop));
}

#[test]
fn fast_stop_wire_low_for_2_of_3_or_1_of_5_ms_stops_gripper() {
    for (period, low) in [(3, 2), (5, 1)] {
        let mut rig = World::homed(WIRES, quick());
        rig.set(Inputs::MOVE, true);
        assert!(rig.until(100, |outputs| outputs.contains(Outputs::BUSY)));
        for ms in 0..50 {
            rig.set(Inputs::FAST_STOP_OK, ms % period >= low);
            rig.pass(1);
        }
        assert!(rig.gripper().state().flags.contains(SystemFlags::FAST_STOP), "{low} of {period} ms");
    }
}

#[test]
fn edge_while_ready_is_low_is_refused_even_if_only_busy_is_high() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    rig.command(Inputs::MOVE);
    rig.take_sent();
    // The fingers are already at the target, but BUSY lasts 50 ms.
    rig.set(Inputs::MOVE, true);
    assert!(rig.until(100, |outputs| outputs.contains(Outputs::BUSY)));
    rig.pass(20);
    assert_eq!(rig.take_motions(), [CommandId::PrePosition]);
    assert!(
        rig.outputs().contains(Outputs::BUSY) && !rig.gripper().state().flags.contains(SystemFlags::MOVING)
    );
    rig.set(Inputs::RELEASE, true);
    rig.pass(100);
    assert_eq!(rig.take_motions(), []);
    assert!(rig.outputs().contains(Outputs::ERROR), "{:?}", rig.outputs());
    rig.set(Inputs::MOVE | Inputs::RELEASE, false);
    rig.pass(10);
    assert_eq!(rig.command(Inputs::RELEASE), IDLE, "the refusal does not lock");
}

#[test]
fn stop_unanswered_for_100_ms_becomes_a_fast_stop() {
    let mut rig = World::homed(WIRES, Config::default());
    rig.set(Inputs::MOVE, true);
    rig.pass(50);
    rig.far.to_bridge = Some(Box::new(Vec::clear));
    rig.set(Inputs::STOP_ACK, true);
    rig.pass(5);
    let sent = rig.take_sent();
    assert!(sent.contains(&CommandId::Stop) && !sent.contains(&CommandId::FastStop), "{sent:?}");
    rig.pass(110);
    assert!(rig.take_sent().contains(&CommandId::FastStop));
}

#[test]
fn force_limit_is_read_back_before_the_grip_is_sent() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    rig.take_sent();
    rig.set(Inputs::GRIP, true);
    rig.pass(20);
    let sent = rig.take_sent();
    let place = |id| sent.iter().position(|sent| *sent == id);
    let [set, read, grip] =
        [CommandId::SetForceLimit, CommandId::GetForceLimit, CommandId::GripPart].map(place);
    assert!(set.is_some() && set < read && read < grip, "{sent:?}");
}

#[test]
fn longest_reply_of_a_gripper_is_not_oversize() {
    let mut rig = World::ready(WIRES, quick());
    let tag = [b'T'; DeviceTag::MAX_LEN];
    let reply = [&Status::Success.code().to_le_bytes()[..], &tag].concat();
    rig.far.inject(&FrameEncoder::new(CommandId::GetDeviceTag.code(), &reply[..]).collect::<Vec<u8>>());
    rig.pass(10);
    let counters = rig.counters();
    assert_eq!((counters.line.oversize, counters.session.unsolicited), (0, 1));
}

#[test]
fn edge_in_turn_of_motion_report_is_refused_with_its_parameters() {
    let mut rig = World::homed(WIRES, quick());
    rig.set(Inputs::RECIPE0, true);
    rig.pass(20);
    let flags = rig.gripper().state().flags | SystemFlags::MOVING;
    rig.take_sent();
    rig.set(Inputs::MOVE, true);
    // The wire takes effect in the third turn.
    rig.pass(2);
    assert!(rig.outputs().contains(Outputs::READY));
    let report = Reply::success(Value::GetSystemState(flags));
    rig.far.inject(&frame(report));
    rig.pass(6);
    let sent = rig.take_sent();
    assert!(!sent.contains(&CommandId::FastStop) && !sent.contains(&CommandId::PrePosition), "{sent:?}");
}

#[test]
fn lost_link_ends_the_connection_at_once() {
    let mut rig = World::ready(WIRES, quick());
    assert!(rig.bridge().is_connected());
    rig.bridge().set_link_lost(true);
    assert!(!rig.bridge().is_connected());
}

#[test]
fn ready_stays_low_until_the_stopped_motion_is_answered() {
    let mut rig = World::homed(WIRES, quick());
    rig.far.to_bridge = Some(Box::new(Vec::clear));
    for (wire, high) in [(Inputs::MOVE, true), (Inputs::STOP_ACK, true), (Inputs::STOP_ACK, false)] {
        rig.set(wire, high);
        rig.pass(5);
    }
    // Without an answer, the STOP would become a FAST STOP, which keeps READY low by itself.
    rig.far.inject(&frame(Reply::success(Value::Stop)));
    rig.pass(60);
    assert_eq!(rig.outputs(), Outputs::BUSY | Outputs::REFERENCED | Outputs::LINK_OK, "MIN_BUSY has passed");
    // The refusal ends BUSY after its minimum duration.
    rig.set(Inputs::GRIP, true);
    rig.pass(60);
    assert_eq!(rig.outputs(), Outputs::ERROR | Outputs::REFERENCED | Outputs::LINK_OK);
}

#[test]
fn bridge_reset_during_a_motion_stops_it_and_shows_error() {
    for time_scale in [1.0, 10.0] {
        let mut rig = World::homed(WIRES, Config { time_scale, ..Config::default() });
        rig.set(Inputs::MOVE, true);
        assert!(rig.until(100, |outputs| outputs.contains(Outputs::BUSY)));
        rig.pass(20);
        rig.set(Inputs::MOVE, false);
        rig.restart_bridge(ResetCause::Watchdog);
        rig.take_sent();
        rig.pass(30);
        let sent = rig.take_sent();
        assert_eq!(sent.iter().find(|id| id.kind() != Kind::Query), Some(&CommandId::Stop), "{sent:?}");
        assert!(!rig.gripper().state().flags.contains(SystemFlags::MOVING));
        let stands = rig.gripper().state().width;
        assert!(rig.until(500, |outputs| outputs.contains(Outputs::LINK_OK)));
        rig.pass(100);
        assert!(rig.outputs().contains(Outputs::ERROR), "{:?}", rig.outputs());
        assert_eq!(rig.gripper().state().width, stands);
        rig.pulse(Inputs::STOP_ACK);
        assert_eq!(rig.command(Inputs::MOVE), IDLE);
    }
}

#[test]
fn bridge_reset_while_a_part_is_held_keeps_it() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
    rig.restart_bridge(ResetCause::Watchdog);
    rig.take_sent();
    assert!(rig.until(500, |outputs| outputs == IDLE | Outputs::HOLDING), "{:?}", rig.outputs());
    assert!(rig.take_sent().iter().all(|id| id.kind() == Kind::Query));
}

#[test]
fn force_limit_of_a_withdrawn_motion_is_not_repeated() {
    for drops in [Inputs::STOP_ACK, Inputs::FAST_STOP_OK] {
        let mut rig = World::homed(WIRES, with_part(20.0));
        rig.take_sent();
        rig.far.to_gripper = Some(Box::new(Vec::clear));
        rig.set(Inputs::GRIP, true);
        rig.pass(10);
        rig.set(drops, drops == Inputs::STOP_ACK);
        rig.pass(50);
        rig.far.to_gripper = None;
        rig.pass(1_000);
        let sent = rig.take_sent();
        assert_eq!(
            sent.iter().filter(|id| **id == CommandId::SetForceLimit).count(),
            1,
            "{drops:?}: {sent:?}"
        );
    }
}

#[test]
fn two_hundred_cycles_have_identical_results() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    rig.take_sent();
    for cycle in 0..200 {
        rig.set(Inputs::RECIPE0, true);
        assert_eq!(rig.command(Inputs::MOVE), IDLE, "cycle {cycle}");
        rig.set(Inputs::RECIPE0, false);
        assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING, "cycle {cycle}");
        assert_eq!(rig.command(Inputs::RELEASE), IDLE, "cycle {cycle}");
        let expected = [CommandId::PrePosition, CommandId::GripPart, CommandId::ReleasePart];
        assert_eq!(rig.take_motions(), expected, "cycle {cycle}");
    }
    assert_eq!(rig.gripper().state().statistics.total, 200);
    assert_eq!(
        rig.counters(),
        wsg_bridge_fw::Counters::default(),
        "no message was lost, repeated or unsolicited"
    );
}

/// Fieldbus manual, 6.2: a lost part is a fault immediately, regardless of later motion.
#[test]
fn lost_part_is_shown_at_once_and_missing_part_after_busy() {
    let mut rig = World::homed(WIRES, with_part(20.0));
    rig.command(Inputs::GRIP);
    let flags = rig.gripper().state().flags | SystemFlags::MOVING;
    for (state, is_shown) in [(GripperState::PartLost, true), (GripperState::NoPart, false)] {
        for value in [Value::GetSystemState(flags), Value::GetGripperState(state)] {
            rig.far.inject(&frame(Reply::success(value)));
        }
        rig.pass(1);
        let outputs = rig.outputs();
        assert!(outputs.contains(Outputs::BUSY), "{state:?}: {outputs:?}");
        assert_eq!(outputs.contains(Outputs::PART_FAULT), is_shown, "{state:?}");
    }
}

fn id_of(event: Option<Event<'_>>) -> Option<CommandId> {
    match event {
        Some(Event::Frame(frame)) => Some(CommandId::from_code(frame.id)),
        _ => None,
    }
}

/// Blocks the transmitter after 7 bytes of the next message, until the connection is lost. Returns these bytes, the commands
/// that the gripper receives in full, and the number of broken frames.
fn cut(inputs: Inputs) -> (Vec<u8>, Vec<CommandId>, u16) {
    let mut rig = World::ready(WIRES, quick());
    rig.pass(200);
    rig.inputs = inputs;
    rig.far.line = SerialLine::with_room(7);
    let is_lost = (0..1_000).any(|_| {
        rig.turn_alone(&mut RtuDouble::default());
        !rig.outputs().contains(Outputs::LINK_OK)
    });
    assert!(is_lost, "{:?}", rig.outputs());
    let begun = rig.far.line.take_sent();
    let mut bytes = begun.clone();
    for _ in 0..2_000 {
        rig.turn_alone(&mut RtuDouble::default());
        bytes.extend(rig.far.line.take_sent());
    }
    let mut parser = FrameParser::<MAX_MESSAGE_LEN>::new();
    let mut ids = Vec::new();
    let mut rest = &bytes[..];
    while !rest.is_empty() {
        let (taken, event) = parser.push_slice(rest);
        rest = &rest[taken..];
        ids.extend(id_of(event));
    }
    while let Some(event) = parser.expire() {
        ids.extend(id_of(Some(event)));
    }
    (begun, ids, parser.counters().bad_checksum)
}

/// Completing the frame later would start a motion that was commanded over an earlier connection.
#[test]
fn cut_motion_frame_is_not_completed_after_connection_loss() {
    let (begun, ids, _) = cut(Inputs::FAST_STOP_OK | Inputs::MOVE);
    let whole = FrameEncoder::new(CommandId::PrePosition.code(), &[0; 9][..]).len();
    assert!(begun.starts_with(&[0xAA, 0xAA, 0xAA, CommandId::PrePosition.code()]) && begun.len() < whole);
    assert!(!ids.is_empty() && !ids.contains(&CommandId::PrePosition), "{ids:?}");
}

/// Otherwise the gripper would take the beginning of the next message, such as a FAST STOP, for its rest.
#[test]
fn cut_query_or_fast_stop_is_completed_after_connection_loss() {
    for (inputs, id) in
        [(Inputs::FAST_STOP_OK, CommandId::GetGripperState), (Inputs::empty(), CommandId::FastStop)]
    {
        let (begun, ids, broken) = cut(inputs);
        assert_eq!(begun[..4], [0xAA, 0xAA, 0xAA, id.code()]);
        assert_eq!((begun.len(), ids.first(), broken), (7, Some(&id), 0), "{ids:?}");
    }
}
