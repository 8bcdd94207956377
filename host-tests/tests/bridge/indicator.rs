//! The LED, in virtual time, read like a person does: by counting flashes between longer pauses.

use host_tests::world::modbus::Master;
use host_tests::world::{WIRES, World, quick};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::indicator::{INDICATIONS, Indication};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::registers::CanReports;

/// Dark time that separates groups of flashes for a person.
const PAUSE_MS: usize = 500;

/// Describes the visible pattern in the words of the table.
fn seen(levels: &[bool]) -> String {
    let lit = levels.iter().filter(|is_lit| **is_lit).count();
    if lit * 2 > levels.len() {
        let gaps = levels.windows(2).filter(|pair| pair[0] && !pair[1]).count();
        return if gaps > 1 { "on, with one short gap every 2 s".into() } else { "lit".into() };
    }
    let runs: Vec<&[bool]> = levels.chunk_by(|a, b| a == b).collect();
    let is_pause = |run: &&[bool]| !run[0] && run.len() > PAUSE_MS;
    // The first and the last group may be incomplete.
    let groups: Vec<usize> =
        runs.split(is_pause).map(|group| group.iter().filter(|run| run[0]).count()).collect();
    let whole = &groups[1..groups.len().saturating_sub(1).max(1)];
    assert!(whole.len() > 1 && whole.iter().all(|count| *count == whole[0]), "groups of flashes: {groups:?}");
    match whole[0] {
        1 => "1 flash".into(),
        count => format!("{count} flashes"),
    }
}

/// Observes the LED for 10 s.
fn look(world: &mut World) -> String {
    let level = |ms| {
        world.step();
        world.indication().is_lit(ms)
    };
    seen(&(0..10_000).map(level).collect::<Vec<_>>())
}

#[test]
fn each_pattern_looks_as_in_the_table() {
    for text in INDICATIONS.iter().filter(|text| text.indication != Indication::NotStarted) {
        for begin in [0, 137, 1_000, 1_999] {
            let levels: Vec<bool> = (begin..begin + 10_000).map(|ms| text.indication.is_lit(ms)).collect();
            assert_eq!(seen(&levels), text.seen);
        }
    }
}

#[test]
fn power_up_homing_and_a_cut_line_are_shown() {
    let mut rig = World::new(WIRES, quick());
    rig.far.to_bridge = Some(Box::new(Vec::clear));
    assert_eq!(look(&mut rig), "1 flash");

    rig.far.to_bridge = None;
    rig.set(Inputs::FAST_STOP_OK, true);
    rig.pass(1_000);
    assert_eq!(look(&mut rig), "4 flashes", "the FAST STOP of power-up");

    rig.get_homed();
    assert_eq!(look(&mut rig), "on, with one short gap every 2 s");

    rig.far.to_bridge = Some(Box::new(Vec::clear));
    rig.pass(3_000);
    assert_eq!(look(&mut rig), "2 flashes");
}

#[test]
fn silent_master_is_shown_until_it_resumes() {
    let mut rig = Master::homed(quick());
    rig.pass(u32::from(Config::DEFAULT.bus.timeout_ms) + 100);
    assert_eq!(look(&mut rig), "3 flashes");

    rig.write(0, &[0, 0, 0, 0]);
    assert_ne!(rig.indication(), Indication::BusLost);
}

#[test]
fn absent_master_is_hidden_if_never_connected_or_wires_command() {
    let mut rig = Master::new(Config::DEFAULT, quick());
    rig.get_homed();
    assert_eq!(look(&mut rig), "on, with one short gap every 2 s");

    rig.write(0, &[0, 0, 0, 0]);
    assert_eq!(look(&mut rig), "on, with one short gap every 2 s");
}

#[test]
fn controller_off_the_bus_is_shown_until_the_recovery() {
    let mut rig = Master::new(Config::DEFAULT, quick());
    rig.get_homed();
    for state in [1, 2, 3] {
        rig.bridge().set_can_reports(CanReports([state, 0, 0, 1, 0, 0]));
        assert_eq!(rig.indication(), Indication::BusLost, "CAN_STATE {state}");
    }
    // Error passive is not bus-off.
    rig.bridge().set_can_reports(CanReports([128, 0, 0, 1, 0, 0]));
    assert_eq!(rig.indication(), Indication::Running);
}
