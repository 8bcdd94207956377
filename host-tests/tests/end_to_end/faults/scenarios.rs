//! Thirty scenarios: each fault in each place of a GRIP. In virtual time, with the bridge that the image is made of.
//!
//! In all of them a motion leaves once for each edge, the fingers move for that edge alone, the PLC is told the truth, and
//! the next GRIP works.

use std::cell::RefCell;
use std::rc::Rc;

use host_tests::bench::{Bench, Disturbance};
use host_tests::faulty_link::{Fault, FaultyWay};
use host_tests::wires::Wires;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{CommandId, GripperState};
use wsg_sim::{Config, Part};

/// Where in a GRIP the fault hits.
#[derive(Clone, Copy, Debug)]
enum Place {
    /// The command that sets the force limit before it.
    ForceLimit,
    /// The command.
    Command,
    /// The answer that says that it has begun.
    Pending,
    /// The answer that says how it ended.
    Result,
    /// A report of the gripper's state on the way.
    Report,
}

/// What the PLC is shown at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shown {
    /// HOLDING without ERROR.
    Held,
    /// ERROR, or a lost link on the way: the PLC knows that something went wrong.
    Trouble,
}
use Place::{Command, ForceLimit, Pending, Report, Result};
use Shown::{Held, Trouble};

/// What a place's frame looks like, and which way it goes.
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

    /// Which frame of that id it is, counted from 0.
    fn number(self) -> usize {
        usize::from(matches!(self, Result))
    }
}

/// How long the link may be away for one fault.
const LONGEST_OUTAGE_MS: u32 = 2_000;

/// Behind the id: a wrong id would be another frame.
const BEHIND_ID: u64 = 4;
/// The high byte of the size.
const SIZE_HIGH: u64 = 5;

/// Lets `fault` hit this byte of the frame of this place, the first time that it comes once `armed`.
fn hit(place: Place, fault: Fault, offset: u64, armed: Rc<RefCell<bool>>) -> Disturbance {
    let mut way = FaultyWay::perfect();
    let (mut now_ms, mut seen) = (0, 0);
    Box::new(move |bytes| {
        now_ms += 1;
        if *armed.borrow() {
            for at in frames_of(place.id(), bytes) {
                if seen == place.number() {
                    // A frame that is late is so as a whole.
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

/// Where frames of this id begin. (What the line carries in a millisecond may end in one; its head is always whole here.)
fn frames_of(id: CommandId, bytes: &[u8]) -> Vec<usize> {
    let head = [0xAA, 0xAA, 0xAA, id.code()];
    bytes.windows(head.len()).enumerate().filter(|(_, it)| **it == head).map(|(at, _)| at).collect()
}

fn scenario(place: Place, fault: Fault, offset: u64, expected: Shown) {
    let what = format!("{fault:?} in {place:?}");
    let config = Config { part: Part::of_width(20.0), ..Config::default() };
    let mut bench = Bench::homed(config);
    assert_eq!(bench.command(Inputs::RELEASE) & Outputs::ERROR, Outputs::empty(), "{what}");
    let armed = Rc::new(RefCell::new(false));
    let disturbance = Some(hit(place, fault, offset, Rc::clone(&armed)));
    if place.is_to_gripper() {
        bench.far.to_gripper = disturbance;
    } else {
        bench.far.to_bridge = disturbance;
    }
    bench.take_sent();
    let before = bench.gripper().state();
    *armed.borrow_mut() = true;

    let mut without_link_ms = 0;
    bench.set(Inputs::GRIP, true);
    bench.pass(10);
    bench.set(Inputs::GRIP, false);
    for _ in 0..20_000 {
        bench.pass(1);
        without_link_ms += u32::from(!bench.outputs().contains(Outputs::LINK_OK));
    }

    assert!(without_link_ms <= LONGEST_OUTAGE_MS, "{what}: no link for {without_link_ms} ms");
    let lost_link = without_link_ms > 0;
    let shown = bench.outputs();
    let state = bench.gripper().state();
    let sent = bench.take_motions();
    assert!(sent.len() <= 1 && sent.iter().all(|id| *id == CommandId::GripPart), "{what}: {sent:?}");
    assert!(!shown.contains(Outputs::BUSY), "{what}: {shown:?}");
    let moved = (state.width - before.width).abs() > 0.01;
    assert!(!moved || sent.len() == 1, "{what}: the fingers moved and no command left");
    if !shown.contains(Outputs::ERROR) && !lost_link {
        assert_eq!(state.gripper, GripperState::Holding, "{what}: no trouble shown, and no part held");
    }
    assert_eq!(
        shown.contains(Outputs::HOLDING),
        state.gripper == GripperState::Holding,
        "{what}: HOLDING is what the gripper does, {shown:?}"
    );
    let trouble = shown.contains(Outputs::ERROR) || lost_link;
    assert_eq!(if trouble { Trouble } else { Held }, expected, "{what}: {shown:?}, lost link {lost_link}");

    *armed.borrow_mut() = false;
    assert!(bench.until(10_000, |outputs| outputs.contains(Outputs::READY)), "{what}: {shown:?}");
    bench.command(Inputs::RELEASE);
    let outputs = bench.command(Inputs::GRIP);
    assert!(outputs.contains(Outputs::HOLDING) && !outputs.contains(Outputs::ERROR), "{what}: {outputs:?}");
}

/// A test for each: its name, the place, the fault, what the PLC is shown.
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

// A force limit is set again until it is answered, and the gripper's states are asked for again and again. A motion command
// is never repeated: nobody knows whether the gripper has it, so the PLC is told of trouble, part held or not.
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

/// A gripper that takes a command for the head of a long frame hears nothing until it gives that up, which it only does in
/// silence. So the bridge must be silent for longer, or every try to connect again is swallowed with the rest.
#[test]
fn gripper_that_waits_for_a_long_frame_is_reached_again() {
    for bit in [0x01, 0x02] {
        scenario(Command, Fault::Flip(bit), SIZE_HIGH, Trouble);
        scenario(ForceLimit, Fault::Flip(bit), SIZE_HIGH, Trouble);
    }
}
