//! The flashed image with a watchdog in the emulator: firmware that hangs is reset, and its outputs go low.

use std::time::{Duration, Instant};

use host_tests::emulator::{Emulator, Extras};
use host_tests::gripper_end::GripperEnd;
use host_tests::iwdg::Iwdg;
use host_tests::modbus_master::Master;
use host_tests::registers::Derailment;
use host_tests::rig::PATIENCE;
use host_tests::trace::Trace;
use wsg_bridge_fw::ResetCause;
use wsg_bridge_fw::io::Outputs;
use wsg_sim::Config;

use super::image;

/// Input register RESET_CAUSE (docs/registers.md).
const RESET_CAUSE: u8 = 132;

/// How long the machine goes on without a reset while the firmware is well, in its milliseconds: ten times the watchdog's.
const WELL_MS: u32 = 1_000;

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn firmware_that_hangs_is_reset_and_its_outputs_go_low() {
    let iwdg = Iwdg::new();
    let extras = Extras { models: vec![Box::new(iwdg.clone()), Box::new(iwdg.flags())], ..Extras::default() };
    let mut board = Emulator::start_with(&image("WSG_FIRMWARE_ELF"), extras).unwrap();
    let trace = Trace::new(vec![]);
    let _gripper =
        GripperEnd::start(board.take_gripper_line().unwrap(), board.clock(), Config::default(), &trace)
            .unwrap();
    let mut master = Master::new(board.take_modbus_line().unwrap(), 1);
    let mut reset_cause = || u16::from(*master.ask(&[4, 0, RESET_CAUSE, 0, 1]).unwrap().last().unwrap());
    // At the nominal rate of its clock.
    assert_eq!(iwdg.timeout(), Some(Duration::from_millis(100)));
    let has_link = |outputs: Outputs| outputs.contains(Outputs::LINK_OK);
    board.wait_outputs(PATIENCE, has_link).unwrap();
    assert_eq!(reset_cause(), ResetCause::PowerOn as u16);
    let bound = Instant::now() + PATIENCE;
    while board.now_ms().unwrap() < WELL_MS {
        assert!(Instant::now() < bound, "the board's clock stands still");
    }
    assert_eq!(iwdg.resets(), 0);

    for (resets, how) in (1..).zip([Derailment::Loop, Derailment::Masked, Derailment::Handler]) {
        let changes = board.output_changes();
        let seen = changes.try_iter().count();
        iwdg.derail(how);
        // Low, and up again when the bridge has begun anew.
        let went_low =
            || board.output_changes().try_iter().skip(seen).any(|change| change.outputs.is_empty());
        let bound = Instant::now() + PATIENCE;
        while iwdg.resets() < resets || !went_low() {
            assert!(Instant::now() < bound, "{how:?}: {} resets, {:?}", iwdg.resets(), board.outputs());
        }
        board.wait_outputs(PATIENCE, has_link).unwrap();
        assert_eq!(reset_cause(), ResetCause::Watchdog as u16, "{how:?}");
        assert_eq!(iwdg.resets(), resets, "{how:?}");
    }
}
