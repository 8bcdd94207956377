//! What holds on every bus, in virtual time: the fieldbus manual's chapter 6, and "Who commands" of docs/registers.md. The
//! tests of the single buses add what only that bus has.

use host_tests::world::plc::{PARAMETERS, Plc};
use host_tests::world::{canopen, modbus, profibus, quick, with_part};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{BusConfig, Config, ControlSource, Counters, Recipe};
use wsg_fieldbus::{CommandFlags as Flag, GripperFlags as Shown, OutputImage, SilenceReaction};
use wsg_protocol::types::SoftLimits;
use wsg_protocol::{Command, CommandId, Kind, Status, SystemFlags};

/// Makes a test of each function, on each bus.
macro_rules! on_every_bus {
    ($($test:ident,)*) => {
        on_every_bus! { over_modbus(modbus::Master): $($test)* }
        on_every_bus! { over_canopen(canopen::Master): $($test)* }
        on_every_bus! { over_profibus(profibus::Master): $($test)* }
    };
    ($bus:ident($master:ty): $($test:ident)*) => {
        mod $bus {
            use super::*;

            $(#[test]
            fn $test() {
                super::$test::<$master>();
            })*
        }
    };
}

on_every_bus!(
    grip_cycle_moves_grips_and_releases,
    missing_and_lost_parts_are_shown_in_gstate,
    lowest_of_simultaneous_edges_is_executed,
    changed_parameter_and_speed_out_of_range_are_a_fast_stop,
    jog_moves_while_its_flag_is_set,
    jog_runs_to_the_soft_limits_and_sets_their_flags,
    first_image_starts_nothing_except_fast_stop,
    stop_in_first_image_lowers_ready_and_refuses_wires,
    silent_plc_holds_stops_or_fast_stops_its_motion,
    silent_plc_ends_a_jog_even_with_reaction_hold,
    part_stays_held_while_the_plc_is_silent,
    motion_ends_with_width_and_force_measured_after_it,
    fast_stop_wire_stops_bus_motion_and_bus_acknowledges,
    fast_stop_of_the_bus_stops_a_motion_of_the_wires,
    wires_command_while_any_is_high_then_the_bus,
    parameters_on_the_bus_do_not_disturb_a_motion_of_the_wires,
    second_motion_is_refused_and_the_first_still_ends,
    motion_while_a_part_is_held_is_refused,
    bus_uses_the_selected_recipe_and_not_its_own_parameters,
    lost_gripper_is_an_error_and_no_later_motion,
    restarted_gripper_is_unreferenced_within_250_ms,
);

/// Returns a slow gripper.
fn slow() -> wsg_sim::Config {
    wsg_sim::Config::default()
}

fn homed<P: Plc>(gripper: wsg_sim::Config) -> P {
    P::homed(P::CONFIG, gripper)
}

fn with_reaction<P: Plc>(reaction: SilenceReaction) -> Config {
    Config { bus: BusConfig { reaction, ..P::CONFIG.bus }, ..P::CONFIG }
}

/// Returns the stops among the commands sent since the last call.
fn stops(plc: &mut impl Plc) -> Vec<CommandId> {
    plc.world().take_sent().into_iter().filter(|id| id.kind() == Kind::Stop).collect()
}

fn has(plc: &mut impl Plc, flag: SystemFlags) -> bool {
    plc.read().system.contains(flag)
}

fn width(plc: &mut impl Plc) -> f32 {
    plc.world().gripper().state().width
}

/// Returns a PLC during a MOVE that lasts 10 s.
fn moving<P: Plc>(config: Config) -> P {
    let mut plc = P::homed(config, slow());
    plc.image().speed = 10_00;
    plc.set_with_width(Flag::MOVE, 10_00);
    plc.run(50);
    assert_eq!(plc.world().take_motions(), [CommandId::PrePosition]);
    plc
}

fn grip_cycle_moves_grips_and_releases<P: Plc>() {
    let mut plc: P = homed(with_part(20.0));
    for _ in 0..10 {
        plc.image().speed = 200_00;
        plc.image().width = 80_00;
        assert_eq!(plc.command(Flag::MOVE), Status::Success);
        plc.run(200);
        let input = plc.read();
        assert_eq!((input.state, input.status, input.width), (Shown::IDLE, Status::Success, 80_00));
        *plc.image() = PARAMETERS;
        assert_eq!(plc.command(Flag::GRIP), Status::Success);
        plc.run(200);
        let input = plc.read();
        assert_eq!(input.state, Shown::HOLDING);
        assert!(input.width.abs_diff(20_00) <= 50 && input.force.abs_diff(40_00) <= 1_00, "{input:?}");
        plc.image().width = 40_00;
        assert_eq!(plc.command(Flag::RELEASE), Status::Success);
        assert_eq!(plc.read().state, Shown::IDLE);
    }
    let cycle = [CommandId::PrePosition, CommandId::GripPart, CommandId::ReleasePart];
    assert_eq!(plc.world().take_motions(), cycle.repeat(10));
    assert_eq!(plc.world().counters(), Counters::default());
    assert_eq!(plc.world().bridge().control_source(), ControlSource::Bus);
}

fn missing_and_lost_parts_are_shown_in_gstate<P: Plc>() {
    let mut plc: P = homed(quick());
    assert_eq!((plc.command(Flag::GRIP), plc.read().state), (Status::CmdFailed, Shown::NO_PART));
    let mut plc: P = homed(with_part(20.0));
    plc.command(Flag::GRIP);
    let now = plc.world().now();
    plc.world().gripper().set_part(None, now);
    plc.run(100);
    assert_eq!(plc.read().state, Shown::PART_LOST);
}

fn lowest_of_simultaneous_edges_is_executed<P: Plc>() {
    let mut plc: P = homed(quick());
    plc.command(Flag::MOVE | Flag::GRIP | Flag::HOMING);
    assert_eq!(plc.world().take_motions(), [CommandId::PrePosition]);
}

fn changed_parameter_and_speed_out_of_range_are_a_fast_stop<P: Plc>() {
    let moves = OutputImage { flags: Flag::MOVE, width: 30_00, ..PARAMETERS };
    for second in [OutputImage { width: 30_01, ..moves }, OutputImage { speed: 51_00, ..moves }] {
        let mut plc: P = homed(slow());
        for image in [moves, second] {
            *plc.image() = image;
            plc.write();
        }
        plc.run(150);
        assert!(has(&mut plc, SystemFlags::FAST_STOP));
        assert_eq!(plc.read().state, Shown::IDLE);
    }
    let mut plc: P = homed(quick());
    *plc.image() = OutputImage { speed: 1, ..moves };
    plc.write();
    plc.run(150);
    assert!(has(&mut plc, SystemFlags::FAST_STOP));
    *plc.image() = OutputImage { flags: Flag::empty(), ..moves };
    plc.write();
    plc.command(Flag::STOP_ACK);
    plc.run(150);
    assert!(!has(&mut plc, SystemFlags::FAST_STOP));
    assert_eq!(plc.command(Flag::MOVE), Status::Success);
}

fn jog_moves_while_its_flag_is_set<P: Plc>() {
    let mut plc: P = homed(quick());
    plc.command(Flag::MOVE);
    plc.image().speed = 20_00;
    plc.set(Flag::JOG_PLUS);
    plc.run(150);
    assert_eq!(plc.read().state, Shown::RELEASING);
    let from = width(&mut plc);
    plc.image().speed = 40_00;
    plc.write();
    plc.run(100);
    assert_eq!(plc.read().state, Shown::RELEASING, "the speed may change during a jog");
    plc.set(Flag::empty());
    plc.run(150);
    let input = plc.read();
    assert_eq!((input.state, input.status), (Shown::IDLE, Status::Success));
    let stands = width(&mut plc);
    assert!(stands > from && stands < 109.0, "{stands}");
    plc.run(500);
    assert_eq!(width(&mut plc), stands);
}

/// Fieldbus, 6.7; command set, 3.3.5: limits at 40 and 80 mm, over the bridge's own session.
fn jog_runs_to_the_soft_limits_and_sets_their_flags<P: Plc>() {
    let mut plc: P = homed(quick());
    plc.image().width = 60_00;
    plc.command(Flag::MOVE);
    let now = plc.world().now();
    let limits = Command::SetSoftLimits { limits: SoftLimits { minus: 40.0, plus: 80.0 } };
    assert_eq!(plc.world().gripper().command(&limits, now), Status::Success);
    for (flag, limit, reached) in [
        (Flag::JOG_PLUS, 80.0, SystemFlags::SOFT_LIMIT_PLUS),
        (Flag::JOG_MINUS, 40.0, SystemFlags::SOFT_LIMIT_MINUS),
    ] {
        plc.set(flag);
        plc.run(2_000);
        let input = plc.read();
        assert!((width(&mut plc) - limit).abs() < 0.05 && input.system.contains(reached), "{input:?}");
        assert_eq!((input.state, input.status), (Shown::IDLE, Status::Success));
        plc.set(Flag::empty());
        plc.set(flag);
        plc.run(500);
        let input = plc.read();
        assert_eq!((input.state, input.status), (Shown::IDLE, Status::RangeError), "already at the limit");
        assert!((width(&mut plc) - limit).abs() < 0.05);
        plc.set(Flag::empty());
    }
}

fn first_image_starts_nothing_except_fast_stop<P: Plc>() {
    let first = OutputImage { flags: Flag::HOMING | Flag::JOG_PLUS, ..PARAMETERS };
    let mut plc = P::connect(P::CONFIG, quick(), first);
    for _ in 0..5 {
        plc.run(50);
        plc.write();
    }
    assert_eq!(plc.world().take_motions(), []);
    plc.set(Flag::empty());
    plc.set(Flag::HOMING);
    plc.run(20);
    assert_eq!(plc.world().take_motions(), [CommandId::Homing]);

    let first = OutputImage { flags: Flag::FASTSTOP, ..PARAMETERS };
    let mut plc = P::connect(P::CONFIG, quick(), first);
    plc.run(20);
    assert_eq!(stops(&mut plc).first(), Some(&CommandId::FastStop));
}

/// STOP/ACK in the first image is no edge, but its level blocks motions (fieldbus, table 1).
fn stop_in_first_image_lowers_ready_and_refuses_wires<P: Plc>() {
    let first = OutputImage { flags: Flag::STOP_ACK, ..PARAMETERS };
    let mut plc = P::connect(P::CONFIG, quick(), first);
    plc.run(100);
    let held = Outputs::LINK_OK;
    assert_eq!(plc.world().outputs(), held, "no READY");
    plc.world().set(Inputs::HOME, true);
    plc.run(100);
    assert_eq!((plc.world().outputs(), plc.world().take_motions()), (held | Outputs::ERROR, vec![]));
    plc.world().set(Inputs::HOME, false);
    plc.set(Flag::empty());
    plc.run(20);
    assert!(plc.world().outputs().contains(Outputs::READY), "{:?}", plc.world().outputs());
    plc.world().set(Inputs::HOME, true);
    plc.run(5_000);
    assert_eq!(plc.world().outputs(), held | Outputs::READY | Outputs::REFERENCED);
}

fn silent_plc_holds_stops_or_fast_stops_its_motion<P: Plc>() {
    for (reaction, expected) in [
        (SilenceReaction::Hold, &[][..]),
        (SilenceReaction::Stop, &[CommandId::Stop]),
        (SilenceReaction::FastStop, &[CommandId::FastStop]),
    ] {
        let mut plc: P = moving(with_reaction::<P>(reaction));
        // A heartbeat of the master may follow its last image by 200 ms.
        plc.fall_silent(P::TIMEOUT_MS.saturating_sub(210));
        assert_eq!(stops(&mut plc), [], "too early");
        plc.fall_silent(215);
        assert_eq!(stops(&mut plc), expected, "{reaction:?}");
        plc.fall_silent(3_000);
        assert_eq!(stops(&mut plc), [], "only once");
    }
}

fn silent_plc_ends_a_jog_even_with_reaction_hold<P: Plc>() {
    let mut plc = P::homed(with_reaction::<P>(SilenceReaction::Hold), quick());
    plc.command(Flag::MOVE);
    plc.image().speed = 5_00;
    plc.set(Flag::JOG_PLUS);
    plc.run(50);
    assert_eq!(stops(&mut plc), []);
    plc.fall_silent(P::TIMEOUT_MS + 20);
    assert_eq!(stops(&mut plc), [CommandId::Stop]);
    let stands = width(&mut plc);
    // The PLC resumes with its button still pressed.
    plc.resume();
    plc.run(200);
    assert_eq!((width(&mut plc), plc.world().take_motions()), (stands, vec![]));
}

fn part_stays_held_while_the_plc_is_silent<P: Plc>() {
    let mut plc: P = homed(with_part(20.0));
    plc.command(Flag::GRIP);
    plc.fall_silent(5_000);
    assert!(plc.world().outputs().contains(Outputs::HOLDING), "{:?}", plc.world().outputs());
    plc.resume();
    plc.run(150);
    assert_eq!(plc.read().state, Shown::HOLDING);
}

fn motion_ends_with_width_and_force_measured_after_it<P: Plc>() {
    for phase_ms in 0..5 {
        let mut plc: P = homed(with_part(20.0));
        plc.run(2 * phase_ms);
        for (flag, width, state) in [(Flag::GRIP, 20_00, Shown::HOLDING), (Flag::RELEASE, 40_00, Shown::IDLE)]
        {
            plc.set_with_width(Flag::empty(), width);
            plc.set(flag);
            assert_eq!(plc.end_of_command(), Status::Success);
            plc.run(P::MEASURED_MS);
            let input = plc.read();
            assert_eq!(input.state, state);
            plc.run(2_000);
            assert_eq!(plc.read(), input, "nothing changes after the end");
        }
    }
}

fn fast_stop_wire_stops_bus_motion_and_bus_acknowledges<P: Plc>() {
    let mut plc: P = moving(P::CONFIG);
    plc.world().set(Inputs::FAST_STOP_OK, false);
    plc.run(150);
    assert!(has(&mut plc, SystemFlags::FAST_STOP));
    plc.set(Flag::empty());
    plc.command(Flag::STOP_ACK);
    plc.run(150);
    assert!(has(&mut plc, SystemFlags::FAST_STOP), "not while the wire is low");
    plc.world().set(Inputs::FAST_STOP_OK, true);
    plc.run(10);
    plc.command(Flag::STOP_ACK);
    plc.run(150);
    assert!(!has(&mut plc, SystemFlags::FAST_STOP));
}

fn fast_stop_of_the_bus_stops_a_motion_of_the_wires<P: Plc>() {
    let mut plc: P = homed(slow());
    plc.world().set(Inputs::MOVE, true);
    plc.run(20);
    plc.world().set(Inputs::MOVE, false);
    plc.set(Flag::FASTSTOP);
    plc.run(150);
    assert!(plc.world().outputs().contains(Outputs::ERROR) && has(&mut plc, SystemFlags::FAST_STOP));
    plc.world().set(Inputs::STOP_ACK, true);
    plc.run(150);
    assert!(has(&mut plc, SystemFlags::FAST_STOP), "the bus's FASTSTOP is still 1");
}

fn wires_command_while_any_is_high_then_the_bus<P: Plc>() {
    let mut plc: P = homed(quick());
    plc.world().set(Inputs::MOVE, true);
    plc.run(3_000);
    plc.world().take_motions();
    plc.set_with_width(Flag::MOVE, 30_00);
    plc.run(50);
    assert_eq!(plc.world().take_motions(), [], "the wire is high");
    plc.world().set(Inputs::MOVE, false);
    plc.run(50);
    assert_eq!(plc.world().take_motions(), [], "the bus's command is not executed later");
    assert_eq!(plc.world().bridge().control_source(), ControlSource::Wires);
    plc.set(Flag::empty());
    assert_eq!(plc.command(Flag::MOVE), Status::Success);
    assert_eq!(plc.world().take_motions(), [CommandId::PrePosition]);
    assert_eq!(plc.world().bridge().control_source(), ControlSource::Bus);
    assert!((width(&mut plc) - 30.0).abs() < 0.05);
}

fn parameters_on_the_bus_do_not_disturb_a_motion_of_the_wires<P: Plc>() {
    let mut plc: P = homed(slow());
    plc.world().set(Inputs::MOVE, true);
    plc.run(20);
    *plc.image() = OutputImage { width: 12_34, speed: 100_00, force_limit: 20_00, ..OutputImage::ZERO };
    plc.write();
    plc.run(5_000);
    assert!(!has(&mut plc, SystemFlags::FAST_STOP));
    assert!((width(&mut plc) - 20.0).abs() < 0.05, "{}", width(&mut plc));
}

fn second_motion_is_refused_and_the_first_still_ends<P: Plc>() {
    let mut plc: P = homed(slow());
    plc.set(Flag::MOVE);
    plc.set(Flag::MOVE | Flag::RELEASE);
    plc.run(20);
    assert_eq!(plc.read().status, Status::AlreadyRunning);
    plc.run(5_000);
    assert_eq!(plc.read().status, Status::Success);
    assert_eq!(plc.world().take_motions(), [CommandId::PrePosition]);
}

fn motion_while_a_part_is_held_is_refused<P: Plc>() {
    let mut plc: P = homed(with_part(20.0));
    plc.command(Flag::GRIP);
    plc.world().take_motions();
    for _ in 0..3 {
        plc.set_with_width(Flag::MOVE, 80_00);
        plc.set(Flag::empty());
        plc.run(20);
        let input = plc.read();
        assert_eq!((input.state, input.status), (Shown::HOLDING, Status::AccessDenied));
    }
    assert_eq!(plc.world().take_motions(), []);
    plc.image().width = 40_00;
    assert_eq!(plc.command(Flag::RELEASE), Status::Success);
}

fn bus_uses_the_selected_recipe_and_not_its_own_parameters<P: Plc>() {
    let mut recipes = P::CONFIG.recipes;
    recipes[12] = Recipe { width: 33_00, speed: 150_00, force: 20_00, release_width: 66_00 };
    let mut plc = P::homed(Config { bus_recipe: Some(12), recipes, ..P::CONFIG }, quick());
    for (flag, expected) in [(Flag::MOVE, 33.0), (Flag::RELEASE, 66.0)] {
        plc.set(flag);
        // The parameters change, and the flag falls, while the fingers move. Neither counts as a change.
        *plc.image() = OutputImage { width: 1, speed: 2, force_limit: 3, ..OutputImage::ZERO };
        plc.write();
        assert_eq!(plc.end_of_command(), Status::Success);
        assert!((width(&mut plc) - expected).abs() < 0.05, "{}", width(&mut plc));
    }
    assert_eq!(stops(&mut plc), []);
}

fn lost_gripper_is_an_error_and_no_later_motion<P: Plc>() {
    let mut plc: P = homed(quick());
    plc.world().set_cut(true);
    plc.run(2_000);
    assert!(plc.misses_the_gripper());
    plc.set(Flag::MOVE);
    plc.run(100);
    plc.set(Flag::empty());
    plc.world().take_motions();
    plc.world().set_cut(false);
    plc.run(2_000);
    assert!(!plc.misses_the_gripper());
    assert_eq!(plc.world().take_motions(), []);
    plc.command(Flag::STOP_ACK);
    assert_eq!(plc.command(Flag::MOVE), Status::Success);
}

/// A bus subscribes to width and force in addition to the states.
fn restarted_gripper_is_unreferenced_within_250_ms<P: Plc>() {
    for offset_ms in (0..200).step_by(7) {
        let mut plc: P = homed(quick());
        plc.run(offset_ms);
        plc.world().restart_gripper(quick());
        plc.run(250);
        assert!(!has(&mut plc, SystemFlags::REFERENCED), "{offset_ms}");
    }
}
