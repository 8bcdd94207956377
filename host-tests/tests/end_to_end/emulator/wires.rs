//! The released image between a PLC on wires and a virtual gripper, in the emulator.

use std::time::Instant;

use host_tests::emulator::Extras;
use host_tests::extent;
use host_tests::rig::{PATIENCE, Rig, motions};
use host_tests::trace::{Entry, frame_id};
use host_tests::world::{IDLE, quick, with_part};
use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::session::FastStopPattern;
use wsg_protocol::{CommandId, SystemFlags};
use wsg_sim::Config;

use super::{Board, RELEASED};

/// The recipe with a large width.
const WIDE: u8 = 1;

fn powered(board: Board, config: Config) -> Rig {
    board.rig(RELEASED, Extras::default(), config)
}

fn homed(board: Board, config: Config) -> Rig {
    let rig = powered(board, config);
    rig.release_fast_stop().unwrap();
    assert_eq!(rig.command(Inputs::HOME).unwrap(), IDLE);
    rig
}

/// Runs MOVE with the large width, GRIP and RELEASE, and checks the end of each.
fn cycle(rig: &Rig, number: usize) {
    rig.select_recipe(WIDE).unwrap();
    assert_eq!(rig.command(Inputs::MOVE).unwrap(), IDLE, "MOVE of cycle {number}");
    rig.select_recipe(0).unwrap();
    assert_eq!(rig.command(Inputs::GRIP).unwrap(), IDLE | Outputs::HOLDING, "GRIP of cycle {number}");
    assert_eq!(rig.command(Inputs::RELEASE).unwrap(), IDLE, "RELEASE of cycle {number}");
}

fn grip_cycles_without_one_deviation(board: Board) {
    let cycles = extent::of(200);
    let rig = homed(board, with_part(20.0));
    rig.catch_up().unwrap();
    let mark = rig.trace().mark();

    for number in 0..cycles {
        cycle(&rig, number);
    }

    rig.catch_up().unwrap();
    let entries = rig.trace().since(mark);
    let expected = [CommandId::PrePosition, CommandId::GripPart, CommandId::ReleasePart].repeat(cycles);
    assert_eq!(motions(&entries), expected, "one command per edge");
    let statistics = rig.gripper().state().statistics;
    assert_eq!((statistics.total as usize, statistics.no_part, statistics.part_lost), (cycles, 0, 0));
    let notes: Vec<&Entry> = entries.iter().filter(|entry| matches!(entry, Entry::Note(_))).collect();
    assert!(notes.is_empty(), "{notes:?}");
    // The edges of the PLC and the output changes of the bridge are equal in every cycle.
    let kinds: [fn(&&Entry) -> bool; 2] =
        [|entry| matches!(entry, Entry::Plc(..)), |entry| matches!(entry, Entry::Bridge(..))];
    for is_of_kind in kinds {
        let changes: Vec<&Entry> = entries.iter().filter(is_of_kind).collect();
        assert_eq!(changes.len() % cycles, 0, "{} changes are not a multiple of the cycles", changes.len());
        let per_cycle = changes.len() / cycles;
        assert!(changes.chunks(per_cycle).all(|chunk| chunk == &changes[..per_cycle]));
    }
}

fn low_fast_stop_wire_at_power_up_blocks_until_acknowledged(board: Board) {
    let rig = powered(board, quick());
    rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
    let commands = [Inputs::GRIP, Inputs::RELEASE, Inputs::MOVE, Inputs::HOME];
    let try_all = || commands.iter().for_each(|wire| rig.pulse(*wire).unwrap());

    try_all();
    rig.pulse(Inputs::STOP_ACK).unwrap();
    try_all();
    rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    rig.pass(10).unwrap();
    try_all();
    assert_eq!(rig.motions_since(0).unwrap(), []);

    rig.release_fast_stop().unwrap();
    rig.command(Inputs::HOME).unwrap();
    assert_eq!(rig.motions_since(0).unwrap(), [CommandId::Homing]);
}

fn command_wire_that_is_high_at_power_up_starts_nothing(board: Board) {
    let rig = powered(board, quick());
    rig.set(Inputs::HOME | Inputs::GRIP, true).unwrap();
    rig.release_fast_stop().unwrap();
    rig.pass(300).unwrap();
    assert_eq!(rig.motions_since(0).unwrap(), []);
}

fn noise_around_and_inside_frames_moves_nothing_and_is_overcome(board: Board) {
    let rig = homed(board, with_part(20.0));
    let mark = rig.trace().mark();
    let false_starts: [&[u8]; 4] = [
        &[0x00, 0xFF, 0xAA],
        &[0xAA, 0xAA, 0xAA, 0x25, 0x02],
        &[0xAA, 0xAA, 0xAA, 0xAA, 0xAA, 0xAA, 0xAA],
        &[0xAA, 0xAA, 0xAA, 0x20, 0xFF, 0xFF, 0x12],
    ];
    for noise in false_starts {
        rig.gripper().inject(noise);
        rig.catch_up().unwrap();
    }
    // Insert noise before and after every frame for some time, then inside every third frame.
    let mut count = 0u32;
    rig.gripper().tamper(Some(Box::new(move |frame| {
        count += 1;
        let mut inside = frame.clone();
        if count.is_multiple_of(3) {
            inside.splice(5..5, [0x55, 0xAA]);
        }
        vec![vec![0xAA, 0xAA], inside, vec![0x13]]
    })));
    for _ in 0..8 {
        rig.catch_up().unwrap();
    }
    rig.gripper().tamper(None);
    assert_eq!(rig.motions_since(mark).unwrap(), []);
    rig.await_outputs(PATIENCE, |outputs| outputs.contains(IDLE)).unwrap();
    cycle(&rig, 0);
}

/// The image's queues and interrupts do not split a burst. `fault_sweep` tests the library in virtual time.
fn fast_stop_reaches_a_gripper_that_awaits_a_nonexistent_frame(board: Board) {
    for high_byte_of_the_size in 1..=3 {
        // The gripper's own time-out exceeds any delay of a slow machine.
        let rig = homed(board, Config { frame_timeout_ms: 60_000, ..Config::default() });
        rig.begin(Inputs::MOVE).unwrap();
        rig.catch_up().unwrap();
        let mark = rig.trace().mark();
        rig.gripper().mislead(&[0xAA, 0xAA, 0xAA, 0x40, 0x03, high_byte_of_the_size]);
        rig.set(Inputs::FAST_STOP_OK, false).unwrap();
        let answered =
            |entry: &Entry| matches!(entry, Entry::FromGripper(bytes) if frame_id(bytes) == Some(0x23));
        assert!(rig.trace().wait(mark, PATIENCE, answered), "the gripper does not answer FAST STOP");
        let state = rig.gripper().state();
        assert!(state.flags.contains(SystemFlags::FAST_STOP) && state.speed == 0.0, "{state:?}");
        let entries = rig.trace().since(mark);
        let until = entries.iter().position(answered).unwrap();
        let sent =
            entries[..until].iter().filter(|entry| entry.command() == Some(CommandId::FastStop)).count();
        let burst = usize::from(FastStopPattern::DEFAULT.burst_frames);
        assert!((2..=1 + burst).contains(&sent), "the first burst must suffice; {sent} were sent");
        rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::ERROR)).unwrap();
        rig.release_fast_stop().unwrap();
    }
}

on_every_board!(board =>
    grip_cycles_without_one_deviation,
    low_fast_stop_wire_at_power_up_blocks_until_acknowledged,
    command_wire_that_is_high_at_power_up_starts_nothing,
    noise_around_and_inside_frames_moves_nothing_and_is_overcome,
    fast_stop_reaches_a_gripper_that_awaits_a_nonexistent_frame,
);

/// The status LED, whose port QEMU has.
mod led {
    use super::*;

    fn led_shows_that_the_gripper_has_never_answered(kind: Board) {
        let board = kind.start(RELEASED, Extras::default());
        let (port, pin) = kind.in_qemu().indicator;
        // MODER and ODR of the port (RM0351, 2.2.2 and 8.4).
        let moder = 0x4800_0000 + 0x400 * (u32::from(port.letter()) - u32::from('A'));
        let odr = moder + 0x14;
        assert_eq!(board.readl(moder).unwrap() >> (2 * pin) & 0b11, 0b01, "the pin must be an output");

        let (mut was_lit, mut was_dark) = (false, false);
        let bound = Instant::now() + PATIENCE;
        while !(was_lit && was_dark) {
            assert!(Instant::now() < bound, "lit: {was_lit}, dark: {was_dark}");
            let before = board.now_ms().unwrap();
            let is_lit = board.readl(odr).unwrap() & 1 << pin != 0;
            let after = board.now_ms().unwrap();
            // The pin is written at the end of a turn of the main loop, with the time at the turn's start.
            let mut turns = before.saturating_sub(2)..=after;
            assert!(
                turns.any(|ms| Indication::NeverAnswered.is_lit(ms) == is_lit),
                "lit: {is_lit}, between {before} and {after} ms"
            );
            was_lit |= is_lit;
            was_dark |= !is_lit;
        }
    }

    on_every_board!(board_in_qemu => led_shows_that_the_gripper_has_never_answered);
}
