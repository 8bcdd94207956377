//! Thirty scenarios: each fault in each place of a GRIP, in virtual time, with the bridge's library.
//!
//! In every scenario, the bridge sends one motion per edge, the fingers move only for that edge, the PLC reads the actual
//! result, and the next GRIP works.

use std::cell::RefCell;
use std::rc::Rc;

use host_tests::faulty_link::{Fault, FaultyWay};
use host_tests::serial_gripper::Disturbance;
use host_tests::world::{WIRES, World};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{CommandId, GripperState};
use wsg_sim::{Config, Part};

/// The frame of a GRIP that the fault hits.
#[derive(Clone, Copy, Debug)]
enum Place {
    /// The preceding command that sets the force limit.
    ForceLimit,
    Command,
    /// The answer that reports the start of the motion.
    Pending,
    /// The answer with the result.
    Result,
    /// A report of the gripper's state during the motion.
    Report,
}

/// The state that the PLC reads at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shown {
    /// HOLDING without ERROR.
    Held,
    /// ERROR, or a temporary loss of the link: the PLC detects a problem.
    Trouble,
}
use Place::{Command, ForceLimit, Pending, Report, Result};
use Shown::{Held, Trouble};

/// Identification of the frame in each place, and its direction.
impl Place {
    fn id(self) -> CommandId {
        match self {
            ForceLimit => CommandId::SetForceLimit,
            Command | Pending | Result => CommandId::GripPart,
            Report => CommandId::GetGripperState,
        }
    }

    fn is_to_gripper(self) -> bool {
        matches!(self, ForceLimit | Command)
    }

    /// Returns the index of the frame among frames with its id, counted from 0.
    fn number(self) -> usize {
        usize::from(matches!(self, Result))
    }
}

/// Longest permitted loss of the link for one fault.
const LONGEST_OUTAGE_MS: u32 = 2_000;

/// First offset after the id: a wrong id would address another frame.
const BEHIND_ID: u64 = 4;
/// Offset of the size's high byte.
const SIZE_HIGH: u64 = 5;

/// Applies `fault` to this byte of the frame in this place, at its first occurrence once `armed`.
fn hit(place: Place, fault: Fault, offset: u64, armed: Rc<RefCell<bool>>) -> Disturbance {
    let mut way = FaultyWay::perfect();
    let (mut now_ms, mut seen) = (0, 0);
    Box::new(move |bytes| {
        now_ms += 1;
        if *armed.borrow() {
            for at in frames_of(place.id(), bytes) {
                if seen == place.number() {
                    // A delay applies to the whole frame.
                    let offset = if matches!(fault, Fault::Delay(_)) { 0 } else { offset };
                    way.hit(way.counts().bytes + at as u64 + offset, fault);
                }
                seen += 1;
            }
        }
        way.pass(now_ms, bytes);
        *bytes = way.arrive(now_ms);
    })
}

/// Returns the offsets of frames with this id. The input may end inside a frame, but contains its whole header.
fn frames_of(id: CommandId, bytes: &[u8]) -> Vec<usize> {
    let head = [0xAA, 0xAA, 0xAA, id.code()];
    bytes.windows(head.len()).enumerate().filter(|(_, it)| **it == head).map(|(at, _)| at).collect()
}

fn scenario(place: Place, fault: Fault, offset: u64, expected: Shown) {
    let what = format!("{fault:?} in {place:?}");
    let config = Config { part: Part::of_width(20.0), ..Config::default() };
    let mut rig = World::homed(WIRES, config);
    assert_eq!(rig.command(Inputs::RELEASE) & Outputs::ERROR, Outputs::empty(), "{what}");
    let armed = Rc::new(RefCell::new(false));
    let disturbance = Some(hit(place, fault, offset, Rc::clone(&armed)));
    if place.is_to_gripper() {
        rig.far.to_gripper = disturbance;
    } else {
        rig.far.to_bridge = disturbance;
    }
    rig.take_sent();
    let before = rig.gripper().state();
    *armed.borrow_mut() = true;

    let mut without_link_ms = 0;
    rig.set(Inputs::GRIP, true);
    rig.pass(10);
    rig.set(Inputs::GRIP, false);
    for _ in 0..20_000 {
        rig.pass(1);
        without_link_ms += u32::from(!rig.outputs().contains(Outputs::LINK_OK));
    }

    assert!(without_link_ms <= LONGEST_OUTAGE_MS, "{what}: no link for {without_link_ms} ms");
    let lost_link = without_link_ms > 0;
    let shown = rig.outputs();
    let state = rig.gripper().state();
    let sent = rig.take_motions();
    assert!(sent.len() <= 1 && sent.iter().all(|id| *id == CommandId::GripPart), "{what}: {sent:?}");
    assert!(!shown.contains(Outputs::BUSY), "{what}: {shown:?}");
    let moved = (state.width - before.width).abs() > 0.01;
    assert!(!moved || sent.len() == 1, "{what}: the fingers moved without a command");
    if !shown.contains(Outputs::ERROR) && !lost_link {
        assert_eq!(
            state.gripper,
            GripperState::Holding,
            "{what}: no problem is reported, but no part is held"
        );
    }
    assert_eq!(
        shown.contains(Outputs::HOLDING),
        state.gripper == GripperState::Holding,
        "{what}: the outputs contradict the gripper: {shown:?}"
    );
    let trouble = shown.contains(Outputs::ERROR) || lost_link;
    assert_eq!(if trouble { Trouble } else { Held }, expected, "{what}: {shown:?}, lost link {lost_link}");

    *armed.borrow_mut() = false;
    assert!(rig.until(10_000, |outputs| outputs.contains(Outputs::READY)), "{what}: {shown:?}");
    rig.command(Inputs::RELEASE);
    let outputs = rig.command(Inputs::GRIP);
    assert!(outputs.contains(Outputs::HOLDING) && !outputs.contains(Outputs::ERROR), "{what}: {outputs:?}");
}

/// Generates a test for each scenario from its name, place, fault and the state that the PLC reads.
macro_rules! scenarios {
    ($($name:ident: $fault:expr, $place:ident => $shown:ident;)*) => {
        $(
            #[test]
            fn $name() {
                scenario($place, $fault, BEHIND_ID, $shown);
            }
        )*
    };
}

// The bridge repeats a force limit until it is answered, and polls the gripper's states. It never repeats a motion
// command: its execution is unknown, so the PLC reads a problem, with or without a held part.
scenarios! {
    lost_byte_in_the_force_limit: Fault::Drop, ForceLimit => Held;
    wrong_bit_in_the_force_limit: Fault::Flip(0x10), ForceLimit => Held;
    doubled_byte_in_the_force_limit: Fault::Duplicate, ForceLimit => Held;
    extra_byte_in_the_force_limit: Fault::Insert(0xAA), ForceLimit => Held;
    truncated_force_limit: Fault::Truncate, ForceLimit => Held;
    late_force_limit: Fault::Delay(40), ForceLimit => Held;
    lost_byte_in_the_command: Fault::Drop, Command => Trouble;
    wrong_bit_in_the_command: Fault::Flip(0x10), Command => Trouble;
    doubled_byte_in_the_command: Fault::Duplicate, Command => Trouble;
    extra_byte_in_the_command: Fault::Insert(0xAA), Command => Trouble;
    truncated_command: Fault::Truncate, Command => Trouble;
    late_command: Fault::Delay(40), Command => Held;
    lost_byte_in_the_pending_answer: Fault::Drop, Pending => Trouble;
    wrong_bit_in_the_pending_answer: Fault::Flip(0x10), Pending => Trouble;
    doubled_byte_in_the_pending_answer: Fault::Duplicate, Pending => Trouble;
    extra_byte_in_the_pending_answer: Fault::Insert(0xAA), Pending => Trouble;
    truncated_pending_answer: Fault::Truncate, Pending => Trouble;
    late_pending_answer: Fault::Delay(40), Pending => Held;
    lost_byte_in_the_result: Fault::Drop, Result => Trouble;
    wrong_bit_in_the_result: Fault::Flip(0x10), Result => Trouble;
    doubled_byte_in_the_result: Fault::Duplicate, Result => Trouble;
    extra_byte_in_the_result: Fault::Insert(0xAA), Result => Trouble;
    truncated_result: Fault::Truncate, Result => Trouble;
    late_result: Fault::Delay(40), Result => Held;
    lost_byte_in_a_report: Fault::Drop, Report => Held;
    wrong_bit_in_a_report: Fault::Flip(0x10), Report => Held;
    doubled_byte_in_a_report: Fault::Duplicate, Report => Held;
    extra_byte_in_a_report: Fault::Insert(0xAA), Report => Held;
    truncated_report: Fault::Truncate, Report => Held;
    late_report: Fault::Delay(40), Report => Held;
}

/// A gripper that reads a command as the header of a long frame discards it only after silence on the line. The bridge
/// must therefore be silent for longer, or the incomplete frame consumes every attempt to reconnect.
#[test]
fn gripper_that_waits_for_a_long_frame_is_reached_again() {
    for bit in [0x01, 0x02] {
        scenario(Command, Fault::Flip(bit), SIZE_HIGH, Trouble);
        scenario(ForceLimit, Fault::Flip(bit), SIZE_HIGH, Trouble);
    }
}
