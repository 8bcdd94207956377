//! The flashed image between a PLC and a virtual gripper, in the emulator.

use std::time::Instant;

use host_tests::emulator::Emulator;
use host_tests::extent;
use host_tests::rig::{PATIENCE, Rig, motions, names};
use host_tests::trace::{Entry, Sequences, Trace, frame_id};
use wsg_b_l475e_iot01a::INDICATOR;
use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::session::FastStopPattern;
use wsg_protocol::{Command, CommandId, FrameEncoder, Reply, Status, SystemFlags};
use wsg_sim::{Config, Part};

use super::{Board, image};

const IDLE: Outputs = Outputs::READY.union(Outputs::REFERENCED).union(Outputs::LINK_OK);

/// The recipe that opens wide.
const WIDE: u8 = 1;

/// A gripper whose fingers travel ten times as fast, which leaves every phase of a motion well above the 10 ms in which
/// reports are drawn together.
fn quick() -> Config {
    Config { time_scale: 10.0, ..Config::default() }
}

fn with_part() -> Config {
    Config { part: Part::of_width(20.0), ..quick() }
}

fn powered(board: Board, config: Config) -> Rig {
    Rig::power_up(&board.image("WSG_FIRMWARE_ELF"), config, Trace::new(vec![])).unwrap()
}

fn ready(board: Board, config: Config) -> Rig {
    let rig = powered(board, config);
    rig.release_fast_stop().unwrap();
    rig
}

fn homed(board: Board, config: Config) -> Rig {
    let rig = ready(board, config);
    assert_eq!(rig.command(Inputs::HOME).unwrap(), IDLE);
    rig
}

fn frame(reply: Reply<'_>) -> Vec<u8> {
    FrameEncoder::new(reply.id().code(), reply).collect()
}

/// MOVE wide, GRIP the part, RELEASE: each must end as it should.
fn cycle(rig: &Rig, number: usize) {
    rig.select_recipe(WIDE).unwrap();
    assert_eq!(rig.command(Inputs::MOVE).unwrap(), IDLE, "MOVE of cycle {number}");
    rig.select_recipe(0).unwrap();
    assert_eq!(rig.command(Inputs::GRIP).unwrap(), IDLE | Outputs::HOLDING, "GRIP of cycle {number}");
    assert_eq!(rig.command(Inputs::RELEASE).unwrap(), IDLE, "RELEASE of cycle {number}");
}

fn grip_cycles_without_one_deviation(board: Board) {
    let cycles = extent::of(200);
    let rig = homed(board, with_part());
    rig.catch_up().unwrap();
    let mark = rig.trace().mark();

    for number in 0..cycles {
        cycle(&rig, number);
    }

    rig.catch_up().unwrap();
    let entries = rig.trace().since(mark);
    let expected = [CommandId::PrePosition, CommandId::GripPart, CommandId::ReleasePart].repeat(cycles);
    assert_eq!(motions(&entries), expected, "one command for each edge");
    let statistics = rig.gripper().state().statistics;
    assert_eq!((statistics.total as usize, statistics.no_part, statistics.part_lost), (cycles, 0, 0));
    let notes: Vec<&Entry> = entries.iter().filter(|entry| matches!(entry, Entry::Note(_))).collect();
    assert!(notes.is_empty(), "{notes:?}");
    // Every cycle looks like the first one: edges and outputs from the sequence of one cycle.
    let sequences = Sequences::of(&entries, 0);
    let per_cycle = sequences.edges.len() / cycles;
    assert!(sequences.edges.chunks(per_cycle).all(|chunk| chunk == &sequences.edges[..per_cycle]));
    assert_eq!(sequences.outputs.len() % cycles, 0, "{} changes of outputs", sequences.outputs.len());
    let per_cycle = sequences.outputs.len() / cycles;
    assert!(sequences.outputs.chunks(per_cycle).all(|chunk| chunk == &sequences.outputs[..per_cycle]));
}

/// The main job once, from READY on. (At power-up the board, the gripper and the PLC start each in its own time: whether
/// the first question or the FAST STOP of the low wire goes out first is nobody's to say.)
fn main_job(board: Board) -> Sequences {
    let rig = powered(board, with_part());
    // A PLC takes longer from one action to the next than the 10 ms that lie between two reports of one value, so no
    // report is drawn together with the one after it.
    let next = || rig.pass(20).unwrap();
    rig.release_fast_stop().unwrap();
    rig.catch_up().unwrap();
    let mark = rig.trace().mark();
    for wire in [Inputs::HOME, Inputs::GRIP, Inputs::RELEASE, Inputs::GRIP] {
        rig.command(wire).unwrap();
        next();
    }
    rig.gripper().set_part(None);
    rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::PART_FAULT)).unwrap();
    for wire in [Inputs::RELEASE, Inputs::GRIP, Inputs::RELEASE] {
        next();
        rig.command(wire).unwrap();
    }
    next();
    rig.set(Inputs::FAST_STOP_OK, false).unwrap();
    rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::ERROR)).unwrap();
    next();
    rig.release_fast_stop().unwrap();
    next();
    rig.catch_up().unwrap();
    Sequences::of(&rig.trace().since(0), mark)
}

fn two_runs_give_the_same_edges_frames_and_output_changes(board: Board) {
    let (first, second) = (main_job(board), main_job(board));
    assert!(first.frames.len() > 25 && first.edges.len() > 15 && first.outputs.len() > 15);
    assert_eq!(first.edges, second.edges);
    assert_eq!(first.output_edges(), second.output_edges());
    assert_eq!(first.system_states, second.system_states);
    assert_eq!(first.gripper_states, second.gripper_states);
    assert_eq!(first.frames, second.frames);
}

fn fast_stop_wire_low_at_power_up_lets_no_motion_out_until_high_and_acknowledged(board: Board) {
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

fn noise_before_between_and_inside_frames_moves_nothing_and_is_recovered_from(board: Board) {
    let rig = homed(board, with_part());
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
    // Before and behind every frame of a while, then inside every third one.
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

fn reply_with_a_wrong_checksum_shows_as_error_or_lost_link_and_is_recovered_from(board: Board) {
    let rig = homed(board, quick());
    rig.select_recipe(WIDE).unwrap();
    for damaged in [Status::CmdPending, Status::Success] {
        let target = frame(Reply::status_only(CommandId::PrePosition, damaged));
        let mut once = true;
        rig.gripper().tamper(Some(Box::new(move |mut frame| {
            if frame == target && std::mem::take(&mut once) {
                frame[7] ^= 0x04;
            }
            vec![frame]
        })));
        let mark = rig.trace().mark();
        rig.begin(Inputs::MOVE).unwrap();
        let shown =
            |outputs: Outputs| outputs.contains(Outputs::ERROR) || !outputs.contains(Outputs::LINK_OK);
        rig.await_outputs(PATIENCE, shown).unwrap();
        rig.await_outputs(PATIENCE, |outputs| outputs.contains(IDLE)).unwrap();
        assert_eq!(
            rig.motions_since(mark).unwrap(),
            [CommandId::PrePosition],
            "never a second time by itself"
        );
        rig.gripper().tamper(None);
        rig.pulse(Inputs::STOP_ACK).unwrap();
        rig.await_outputs(PATIENCE, |outputs| outputs == IDLE).unwrap();
        assert_eq!(rig.command(Inputs::MOVE).unwrap(), IDLE, "and behind STOP/ACK it goes on");
    }
}

fn answers_to_nothing_ever_asked_change_nothing(board: Board) {
    let rig = homed(board, quick());
    let (mark, changes) = (rig.trace().mark(), rig.board().output_changes());
    let before = changes.try_iter().count();
    for id in CommandId::ALL.iter().filter(|id| !matches!(id.code(), 0x40 | 0x41)) {
        for status in [Status::Success, Status::CmdPending, Status::AccessDenied] {
            rig.gripper().inject(&frame(Reply::status_only(*id, status)));
        }
    }
    rig.catch_up().unwrap();
    rig.catch_up().unwrap();
    assert!(before > 0);
    assert_eq!(changes.try_iter().collect::<Vec<_>>(), []);
    assert_eq!(rig.motions_since(mark).unwrap(), []);
}

fn gripper_that_never_answers_is_asked_and_never_told_to_move(board: Board) {
    let rig = powered(board, quick());
    rig.gripper().tamper(Some(Box::new(|_| vec![])));
    rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    for _ in 0..5 {
        for wire in [Inputs::STOP_ACK, Inputs::HOME, Inputs::GRIP] {
            rig.pulse(wire).unwrap();
            rig.pass(50).unwrap();
        }
    }
    let outputs = rig.board().outputs();
    assert!(!outputs.intersects(Outputs::LINK_OK | Outputs::READY | Outputs::BUSY), "{}", names(outputs));
    assert_eq!(rig.motions_since(0).unwrap(), []);
    rig.gripper().tamper(None);
    rig.release_fast_stop().unwrap();
    assert_eq!(rig.command(Inputs::HOME).unwrap(), IDLE);
}

fn line_cut_and_restored_shows_and_nothing_asked_for_meanwhile_is_done(board: Board) {
    let rig = homed(board, quick());
    rig.gripper().cut(true);
    rig.await_outputs(PATIENCE, |outputs| outputs == Outputs::ERROR).unwrap();
    rig.pulse(Inputs::MOVE).unwrap();
    let mark = rig.trace().mark();
    rig.gripper().cut(false);
    rig.await_outputs(PATIENCE, |outputs| outputs.contains(IDLE)).unwrap();
    rig.pass(300).unwrap();
    assert_eq!(rig.motions_since(mark).unwrap(), []);
    assert!(rig.board().outputs().contains(Outputs::ERROR), "the refused MOVE shows");
}

fn restarted_gripper_shows_that_homing_is_due(board: Board) {
    let rig = homed(board, quick());
    rig.gripper().restart().unwrap();
    let outputs = rig.await_outputs(PATIENCE, |outputs| !outputs.contains(Outputs::REFERENCED)).unwrap();
    assert!(!outputs.contains(Outputs::HOLDING), "{}", names(outputs));
    rig.await_outputs(PATIENCE, |outputs| outputs == Outputs::READY | Outputs::LINK_OK).unwrap();
    assert_eq!(rig.command(Inputs::HOME).unwrap(), IDLE);
}

/// Fieldbus manual, 6.6: FAST STOP is a level. The PLC holds the wire low while somebody acknowledges at the gripper, and while
/// the gripper is restarted.
fn fast_stop_wire_that_is_low_outlasts_third_parties_and_a_restart(board: Board) {
    let rig = homed(board, quick());
    let is_stopped = || rig.gripper().state().flags.contains(SystemFlags::FAST_STOP);
    let await_stopped = |what: &str| {
        let bound = Instant::now() + PATIENCE;
        while !is_stopped() {
            assert!(Instant::now() < bound, "{what}: no FAST STOP follows");
            rig.pass(1).unwrap();
        }
    };
    rig.set(Inputs::FAST_STOP_OK, false).unwrap();
    await_stopped("wire");
    rig.await_outputs(PATIENCE, |outputs| !outputs.contains(Outputs::READY)).unwrap();
    let mark = rig.trace().mark();
    for _ in 0..3 {
        assert_eq!(rig.gripper().command(&Command::ACKNOWLEDGE), Status::Success);
        rig.pulse(Inputs::MOVE).unwrap();
        await_stopped("third party");
    }
    rig.gripper().restart().unwrap();
    await_stopped("restart");
    assert_eq!(rig.motions_since(mark).unwrap(), []);

    rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    rig.pass(500).unwrap();
    assert!(is_stopped() && !rig.board().outputs().contains(Outputs::READY), "high alone unlocks nothing");
    assert_eq!(rig.gripper().command(&Command::ACKNOWLEDGE), Status::Success);
    rig.await_outputs(PATIENCE, |outputs| outputs == Outputs::READY | Outputs::LINK_OK).unwrap();
    assert_eq!(rig.command(Inputs::HOME).unwrap(), IDLE);
}

/// The image's queues and interrupts keep a burst together: what `fault_sweep` shows of the library in virtual time.
fn fast_stop_reaches_a_gripper_that_waits_for_the_rest_of_a_frame_that_does_not_exist(board: Board) {
    let is_fast_stop =
        |entry: &&Entry| matches!(entry, Entry::ToGripper(bytes) if frame_id(bytes) == Some(0x23));
    for high_byte_of_the_size in 1..=3 {
        // It does not give up by itself, however slow this machine is.
        let rig = homed(board, Config { frame_timeout_ms: 60_000, ..Config::default() });
        rig.begin(Inputs::MOVE).unwrap();
        rig.catch_up().unwrap();
        let mark = rig.trace().mark();
        rig.gripper().mislead(&[0xAA, 0xAA, 0xAA, 0x40, 0x03, high_byte_of_the_size]);
        rig.set(Inputs::FAST_STOP_OK, false).unwrap();
        let answered =
            |entry: &Entry| matches!(entry, Entry::FromGripper(bytes) if frame_id(bytes) == Some(0x23));
        assert!(rig.trace().wait(mark, PATIENCE, answered), "FAST STOP is not heard");
        let state = rig.gripper().state();
        assert!(state.flags.contains(SystemFlags::FAST_STOP) && state.speed == 0.0, "{state:?}");
        let entries = rig.trace().since(mark);
        let until = entries.iter().position(answered).unwrap();
        let sent = entries[..until].iter().filter(is_fast_stop).count();
        let burst = usize::from(FastStopPattern::DEFAULT.burst_frames);
        assert!((2..=1 + burst).contains(&sent), "the first burst is enough: {sent}");
        rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::ERROR)).unwrap();
        rig.release_fast_stop().unwrap();
    }
}

on_both_boards!(
    grip_cycles_without_one_deviation,
    two_runs_give_the_same_edges_frames_and_output_changes,
    fast_stop_wire_low_at_power_up_lets_no_motion_out_until_high_and_acknowledged,
    command_wire_that_is_high_at_power_up_starts_nothing,
    noise_before_between_and_inside_frames_moves_nothing_and_is_recovered_from,
    reply_with_a_wrong_checksum_shows_as_error_or_lost_link_and_is_recovered_from,
    answers_to_nothing_ever_asked_change_nothing,
    gripper_that_never_answers_is_asked_and_never_told_to_move,
    line_cut_and_restored_shows_and_nothing_asked_for_meanwhile_is_done,
    restarted_gripper_shows_that_homing_is_due,
    fast_stop_wire_that_is_low_outlasts_third_parties_and_a_restart,
    fast_stop_reaches_a_gripper_that_waits_for_the_rest_of_a_frame_that_does_not_exist,
);

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn led_tells_that_the_gripper_has_never_answered() {
    let board = Emulator::start(&image("WSG_FIRMWARE_ELF")).unwrap();
    let (port, pin) = INDICATOR;
    // RM0351, 2.2.2 and 8.4: the port's registers MODER and ODR.
    let moder = 0x4800_0000 + 0x400 * (u32::from(port.letter()) - u32::from('A'));
    let odr = moder + 0x14;
    assert_eq!(board.readl(moder).unwrap() >> (2 * pin) & 0b11, 0b01, "the pin is an output");

    let (mut was_lit, mut was_dark) = (false, false);
    let bound = Instant::now() + PATIENCE;
    while !(was_lit && was_dark) {
        assert!(Instant::now() < bound, "lit: {was_lit}, dark: {was_dark}");
        let before = board.now_ms().unwrap();
        let is_lit = board.readl(odr).unwrap() & 1 << pin != 0;
        let after = board.now_ms().unwrap();
        // The pin is written at the end of a turn of the main loop, with the time of its beginning.
        let mut turns = before.saturating_sub(2)..=after;
        assert!(
            turns.any(|ms| Indication::NeverAnswered.is_lit(ms) == is_lit),
            "lit: {is_lit}, between {before} and {after} ms"
        );
        was_lit |= is_lit;
        was_dark |= !is_lit;
    }
}
