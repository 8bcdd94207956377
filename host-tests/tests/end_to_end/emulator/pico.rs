//! Features specific to the Pico's registers and emulator: pins, LED, and flash for settings.

use std::time::Instant;

use host_tests::addresses::setting;
use host_tests::emulator::Extras;
use host_tests::modbus_master::Master;
use host_tests::rig::PATIENCE;
use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::registers::{COMMAND_KEY, COMMANDS, FIRST_COMMAND};
use wsg_pico::{INDICATOR, INPUTS};

use super::{Board, RELEASED, wait_until};

/// Levels of all pins, read and driven (RP2040, 2.3.1.7).
const GPIO_IN: u32 = 0xD000_0004;
const GPIO_OUT: u32 = 0xD000_0010;

#[test]
#[ignore = "needs rp2040js and the firmware image: run `cargo xtask test`"]
fn input_wire_reaches_its_pin_and_is_low_if_broken_in_rp2040js() {
    let board = Board::PICO.start(RELEASED, Extras::default());
    let levels = || -> Inputs {
        let pins = board.readl(GPIO_IN).unwrap();
        INPUTS.iter().filter(|wire| pins & 1 << wire.gpio != 0).map(|wire| wire.signal).collect()
    };
    assert_eq!(levels(), Inputs::empty());
    for wire in Inputs::all().iter() {
        board.set_inputs(wire).unwrap();
        assert_eq!(levels(), wire);
    }
}

#[test]
#[ignore = "needs rp2040js and the firmware image: run `cargo xtask test`"]
fn led_shows_that_the_gripper_has_never_answered_in_rp2040js() {
    let board = Board::PICO.start(RELEASED, Extras::default());
    let is_lit = || board.readl(GPIO_OUT).unwrap() & 1 << INDICATOR != 0;
    // Times of the LED's edges.
    let mut edges = Vec::new();
    let (mut was_lit, bound) = (is_lit(), Instant::now() + PATIENCE);
    while edges.len() < 3 {
        assert!(Instant::now() < bound, "the LED does not flash: {edges:?}");
        let now_lit = is_lit();
        if std::mem::replace(&mut was_lit, now_lit) != now_lit {
            edges.push(board.now_ms().unwrap());
        }
    }
    let period = (1..=10_000).find(|ms| {
        (0..10_000)
            .all(|at| Indication::NeverAnswered.is_lit(at) == Indication::NeverAnswered.is_lit(at + ms))
    });
    let (seen, reported) = (edges[2] - edges[0], period.expect("a period"));
    // The host's speed limits the resolution of external readings.
    assert!(seen.abs_diff(reported) <= reported / 4, "period {seen} ms, expected {reported} ms");
}

#[test]
#[ignore = "needs rp2040js and the firmware image: run `cargo xtask test`"]
fn settings_that_were_saved_survive_the_power_in_rp2040js() {
    const SAVED: u16 = 2;
    let folder = std::env::temp_dir().join(format!("wsg-pico-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let flash = folder.join("flash");
    let power_up = || {
        let extras = Extras { flash: Some(&flash), ..Extras::default() };
        let mut board = Board::PICO.start(RELEASED, extras);
        let master = Master::new(board.take_service_line().unwrap(), board.clock(), 1);
        (board, master)
    };
    let (board, mut master) = power_up();
    let debounce = setting("DEBOUNCE");
    assert_eq!(master.read(3, debounce, 1).unwrap(), [2]);
    master.write(debounce, &[7]).unwrap();
    let save = COMMANDS.iter().position(|command| command.name == "SAVE").unwrap() as u16;
    master.write(FIRST_COMMAND + save, &[COMMAND_KEY]).unwrap();
    wait_until("the save to end", || master.report("SAVE_STATE").unwrap(), |state| *state == SAVED);
    drop(board);

    let (_board, mut master) = power_up();
    assert_eq!(master.read(3, debounce, 1).unwrap(), [7]);
    std::fs::remove_dir_all(&folder).unwrap();
}
