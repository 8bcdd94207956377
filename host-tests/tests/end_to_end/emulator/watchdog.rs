//! The released image with a watchdog in the emulator: hung firmware is reset, and its outputs go low.

use std::time::Duration;

use host_tests::emulator::{Emulator, Extras};
use host_tests::iwdg::Iwdg;
use host_tests::registers::Derailment;
use host_tests::rig::{PATIENCE, Rig};
use wsg_bridge_fw::ResetCause;
use wsg_bridge_fw::io::Outputs;
use wsg_sim::Config;

use super::{Board, RELEASED, wait_until};

const TIMEOUT: Duration = Duration::from_millis(100);

/// Time without a reset for running firmware, in milliseconds of board time: ten times the time-out.
const WELL_MS: u32 = 1_000;

/// Checks that hung firmware is reset, its outputs go low, and RESET_CAUSE reports the watchdog. `derail` hangs the firmware,
/// and `resets` returns the number of resets.
fn is_reset(mut rig: Rig, derail: impl Fn(&Emulator, Derailment), resets: impl Fn(&Emulator) -> u32) {
    let mut master = rig.master(1).unwrap();
    let board = rig.board();
    let mut reset_cause = || master.report("RESET_CAUSE").unwrap();
    let has_link = |outputs: Outputs| outputs.contains(Outputs::LINK_OK);
    board.wait_outputs(PATIENCE, has_link).unwrap();
    assert_eq!(reset_cause(), ResetCause::PowerOn as u16);
    wait_until("the board's clock to advance", || board.now_ms().unwrap(), |now_ms| *now_ms >= WELL_MS);
    assert_eq!(resets(board), 0);

    for (expected, how) in (1..).zip([Derailment::Loop, Derailment::Masked, Derailment::Handler]) {
        let changes = board.output_changes();
        let seen = changes.try_iter().count();
        derail(board, how);
        // The outputs go low and return after the restart.
        let went_low =
            || board.output_changes().try_iter().skip(seen).any(|change| change.outputs.is_empty());
        let look = || (resets(board), went_low(), board.outputs());
        wait_until(&format!("a reset: {how:?}"), look, |&(resets, low, _)| resets >= expected && low);
        board.wait_outputs(PATIENCE, has_link).unwrap();
        assert_eq!(reset_cause(), ResetCause::Watchdog as u16, "{how:?}");
        assert_eq!(resets(board), expected, "{how:?}");
    }
}

fn firmware_that_hangs_is_reset_and_its_outputs_go_low(board: Board) {
    let iwdg = Iwdg::new();
    let extras = Extras { models: vec![Box::new(iwdg.clone()), Box::new(iwdg.flags())], ..Extras::default() };
    let rig = board.rig(RELEASED, extras, Config::default());
    // At the nominal clock rate of the watchdog.
    assert_eq!(iwdg.timeout(), Some(TIMEOUT));
    is_reset(rig, |_, how| iwdg.derail(how), |_| iwdg.resets());
}

#[test]
#[ignore = "needs rp2040js and the firmware image: run `cargo xtask test`"]
fn hung_firmware_is_reset_in_time_with_outputs_low_in_rp2040js() {
    let extras = Extras { may_reset: true, ..Extras::default() };
    let rig = Board::PICO.rig(RELEASED, extras, Config::default());
    let derail = |board: &Emulator, how| board.derail(how).unwrap();
    is_reset(rig, derail, |board| {
        let (resets, behind_last_turn) = board.watchdog_resets().unwrap();
        // The reset lowers the outputs. It occurs at the first instruction after the time-out.
        let is_in_time = behind_last_turn.abs_diff(TIMEOUT) < Duration::from_micros(10);
        assert!(resets == 0 || is_in_time, "{behind_last_turn:?}");
        resets
    });
}

on_every_board!(board_in_qemu => firmware_that_hangs_is_reset_and_its_outputs_go_low);
