//! The gripper on CAN, in virtual time: a grip cycle, lost and repeated frames, bus-off and recovery, and a blocked bus when
//! the fingers must stop.

use std::cell::RefCell;
use std::rc::Rc;

use bus_slcan::ClassicFrame;
use embedded_can::{ExtendedId, Frame, Id, StandardId};
use host_tests::world::can::Disturbance;
use host_tests::world::{IDLE, World, quick, with_part};
use wsg_bridge_fw::can::{BusOffPolicy, BusState, DEFAULT_NODE};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::can::{Identifiers, Segments};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{CommandId, FrameEncoder, Kind, Reply, Status, SystemFlags, checksum};
use wsg_sim::Config;

const POLICY: BusOffPolicy = BusOffPolicy::DEFAULT;

fn homed() -> World {
    World::homed_on_can(with_part(20.0), POLICY)
}

#[test]
fn grip_cycle_over_can_shows_what_the_gripper_does() {
    let mut rig = homed();
    assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
    assert_eq!(rig.command(Inputs::RELEASE), IDLE);
    assert_eq!(rig.take_motions(), [CommandId::Homing, CommandId::GripPart, CommandId::ReleasePart]);
    assert_eq!(rig.can.broken(), 0);
    let counters = rig.link().counters();
    assert_eq!((counters.overflows, counters.broken), (0, 0));
    assert_eq!(counters.frames, wsg_protocol::can::ReassemblerCounters::default());
}

#[test]
fn frames_of_other_nodes_have_no_effect() {
    let mut rig = homed();
    let base = Identifiers::DEFAULT.controller();
    let mut count = 0u32;
    rig.can.to_bridge = Some(Box::new(move |frame| {
        count += 1;
        let id = base.receive.as_raw();
        let other = StandardId::new(id + (count % 5) as u16 + 1).unwrap();
        let extended = ExtendedId::new(id.into()).unwrap();
        vec![
            ClassicFrame::new(other, frame.data()).unwrap(),
            frame,
            ClassicFrame::new(extended, frame.data()).unwrap(),
            ClassicFrame::new_remote(base.receive, 8).unwrap(),
        ]
    }));
    assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
    assert!(rig.link().counters().frames.foreign > 10);
    assert_eq!(rig.link().counters().frames.dropped, 0);
}

#[test]
fn lost_or_repeated_frames_cause_no_motion_and_a_defined_state() {
    for doubled in [false, true] {
        let mut rig = homed();
        rig.take_sent();
        let disturbance = move || {
            let mut count = 0u32;
            Box::new(move |frame: ClassicFrame| {
                count += 1;
                match (count.is_multiple_of(7), doubled) {
                    (false, _) => vec![frame],
                    (true, true) => vec![frame, frame],
                    (true, false) => vec![],
                }
            })
        };
        rig.can.to_gripper = Some(disturbance());
        rig.can.to_bridge = Some(disturbance());
        rig.set(Inputs::GRIP, true);
        rig.pass(5);
        rig.set(Inputs::GRIP, false);
        rig.pass(5_000);
        (rig.can.to_gripper, rig.can.to_bridge) = (None, None);
        rig.pass(2_000);
        let motions = rig.take_motions();
        assert!(motions.len() <= 1 && motions.iter().all(|id| *id == CommandId::GripPart), "{motions:?}");
        let outputs = rig.outputs();
        assert!(outputs.contains(Outputs::LINK_OK) && !outputs.contains(Outputs::BUSY), "{outputs:?}");
    }
}

#[test]
fn bus_off_is_shown_at_once_and_the_bridge_recovers() {
    let mut rig = homed();
    rig.can.double.go_off(0);
    rig.pass(1);
    assert_eq!(rig.outputs(), Outputs::ERROR, "no LINK_OK, and no other state is known");
    assert_eq!(rig.can_bus().state(), BusState::Off);
    assert_eq!(rig.can_bus().health().transmit_errors, 255);

    rig.pass(POLICY.delay_ms - 2);
    assert_eq!(rig.can.double.recoveries(), 0, "not before the delay");
    assert!(rig.until(2_000, |outputs| outputs == IDLE), "{:?}", rig.outputs());
    assert_eq!((rig.can.double.recoveries(), rig.can_bus().counters().bus_offs), (1, 1));
    assert_eq!(rig.can_bus().state(), BusState::On);
    assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
}

#[test]
fn motion_commanded_during_bus_off_is_never_sent() {
    let mut rig = homed();
    rig.take_sent();
    rig.can.double.go_off(0);
    // In the millisecond of bus-off, and during it.
    rig.set(Inputs::GRIP, true);
    rig.pass(20);
    rig.set(Inputs::GRIP, false);
    rig.pass(20);
    rig.pulse(Inputs::MOVE);
    assert!(rig.until(2_000, |outputs| outputs.contains(Outputs::LINK_OK)));
    rig.pass(2_000);
    assert_eq!(rig.take_motions(), []);
    assert!(rig.outputs().contains(Outputs::ERROR), "{:?}", rig.outputs());
}

#[test]
fn message_cut_by_bus_off_is_not_continued_after_it() {
    // Bus-off directly after the first of the two frames of Grip Part, or of the three of Pre-position.
    for (wire, id) in [(Inputs::GRIP, 0x25), (Inputs::MOVE, 0x21)] {
        let mut rig = homed();
        rig.take_sent();
        let double = rig.can.double.clone();
        let mut cut = false;
        rig.can.to_gripper = Some(Box::new(move |frame| {
            if !cut && frame.data().starts_with(&[0xAA, 0xAA, 0xAA, id]) {
                cut = true;
                double.go_off(0);
            }
            vec![frame]
        }));
        rig.set(wire, true);
        assert!(rig.until(100, |outputs| outputs == Outputs::ERROR), "{:?}", rig.outputs());
        rig.set(wire, false);
        assert!(rig.until(3_000, |outputs| outputs.contains(Outputs::LINK_OK)));
        rig.pass(3_000);
        assert_eq!(rig.take_motions(), []);
        assert!(rig.outputs().contains(Outputs::ERROR), "unknown outcome: {:?}", rig.outputs());
        assert_eq!(rig.can.broken(), 1, "the truncated message");
        assert_eq!(rig.can.double.aborts(), 2, "at bus-off and after the recovery");
        assert_eq!(
            rig.link().counters().broken,
            u16::from(wire == Inputs::MOVE),
            "one frame was still in the link"
        );
    }
}

#[test]
fn motion_during_bus_off_has_an_unknown_outcome_and_shows_error() {
    let mut rig = World::homed_on_can(Config { time_scale: 1.0, ..with_part(20.0) }, POLICY);
    rig.set(Inputs::GRIP, true);
    assert!(rig.until(100, |outputs| outputs.contains(Outputs::BUSY)));
    rig.set(Inputs::GRIP, false);
    rig.pass(100);
    rig.can.double.go_off(0);
    assert!(rig.until(3_000, |outputs| outputs.contains(Outputs::LINK_OK)));
    assert!(rig.until(10_000, |outputs| !outputs.contains(Outputs::BUSY)));
    assert!(rig.outputs().contains(Outputs::ERROR), "{:?}", rig.outputs());
}

/// Requested during bus-off, before the gripper stops answering, or waiting in the controller at bus-off.
#[test]
fn pending_fast_stop_is_sent_with_first_frames_after_bus_off() {
    for (is_in_controller, low_ms) in [(false, 0), (false, 20), (true, 5)] {
        let mut rig = homed();
        if !is_in_controller {
            rig.can.double.go_off(0);
            rig.pass(10);
        }
        rig.can.double.set_unheard(is_in_controller);
        rig.set(Inputs::FAST_STOP_OK, false);
        rig.pass(low_ms);
        if is_in_controller {
            rig.can.double.go_off(0);
            rig.can.double.set_unheard(false);
        }
        rig.take_sent();
        rig.pass(1);
        while rig.can_bus().state() != BusState::On {
            rig.pass(1);
        }
        rig.pass(2);
        let context = format!("in the controller: {is_in_controller}, low for {low_ms} ms");
        assert_eq!(rig.take_sent().first(), Some(&CommandId::FastStop), "{context}");
        assert!(rig.until(3_000, |outputs| outputs.contains(Outputs::LINK_OK)), "{context}");
        rig.pass(100);
        assert!(rig.gripper().state().flags.contains(SystemFlags::FAST_STOP), "{context}");
    }
}

#[test]
fn fast_stop_is_sent_at_once_around_the_loss_of_the_connection() {
    /// A gripper that receives everything, but answers no longer.
    fn falling_silent() -> World {
        let mut rig = homed();
        rig.can.to_bridge = Some(Box::new(|_| vec![]));
        rig
    }
    let mut rig = falling_silent();
    let mut given_up = 0;
    while rig.outputs().contains(Outputs::LINK_OK) {
        rig.pass(1);
        given_up += 1;
    }
    for asked in given_up - 10..given_up + 5 {
        let mut rig = falling_silent();
        rig.pass(asked);
        rig.take_sent();
        rig.set(Inputs::FAST_STOP_OK, false);
        rig.pass(wsg_bridge_fw::Config::DEFAULT.wires.debounce_ms + 5);
        assert!(rig.take_sent().contains(&CommandId::FastStop), "{asked} of {given_up} ms");
    }
}

#[test]
fn repeated_bus_off_is_given_up() {
    let policy = BusOffPolicy { limit: 3, ..POLICY };
    let mut rig = World::homed_on_can(with_part(20.0), policy);
    rig.can.double.go_off(u32::MAX);
    rig.pass(10 * (policy.delay_ms + policy.recovery_ms));
    assert_eq!(rig.can_bus().state(), BusState::GivenUp);
    assert_eq!(rig.can.double.recoveries(), 2, "the third failure is the last");
    assert_eq!(rig.outputs(), Outputs::ERROR);

    // The controller's own recovery has no effect.
    rig.can.double.go_off(0);
    rig.pass(60_000);
    assert_eq!((rig.can_bus().state(), rig.can.double.recoveries()), (BusState::GivenUp, 2));

    let now = wsg_protocol::Instant::from_millis(rig.now_ms());
    rig.can_bus().retry(now);
    assert!(rig.until(3_000, |outputs| outputs == IDLE), "{:?}", rig.outputs());
}

#[test]
fn failures_are_reset_only_after_a_stable_time() {
    let policy = BusOffPolicy { limit: 3, stable_ms: 5_000, ..POLICY };
    for (pause, given_up) in [(4_000, true), (7_000, false)] {
        let mut rig = World::homed_on_can(with_part(20.0), policy);
        for _ in 0..3 {
            rig.can.double.go_off(0);
            rig.pass(pause);
        }
        assert_eq!(rig.can_bus().state() == BusState::GivenUp, given_up, "{pause} ms apart");
    }
}

#[test]
fn limit_of_zero_never_gives_up() {
    let mut rig = World::homed_on_can(with_part(20.0), BusOffPolicy { limit: 0, ..POLICY });
    rig.can.double.go_off(400);
    rig.pass(401 * (POLICY.delay_ms + POLICY.recovery_ms));
    assert!(rig.until(3_000, |outputs| outputs == IDLE), "{:?}", rig.outputs());
}

#[test]
fn unacknowledged_motion_is_not_sent_when_a_node_joins() {
    for wire in [Inputs::GRIP, Inputs::MOVE] {
        let mut rig = homed();
        rig.take_sent();
        // The gripper is unplugged, so frames stay in the controller's mailboxes.
        rig.can.double.set_unheard(true);
        rig.can.to_bridge = Some(Box::new(|_| vec![]));
        rig.set(wire, true);
        rig.pass(20);
        rig.set(wire, false);
        assert!(rig.until(2_000, |outputs| !outputs.contains(Outputs::LINK_OK)), "{:?}", rig.outputs());
        rig.pass(60_000);
        rig.can.double.set_unheard(false);
        rig.can.to_bridge = None;
        assert!(rig.until(3_000, |outputs| outputs.contains(Outputs::LINK_OK)), "{:?}", rig.outputs());
        rig.pass(3_000);
        assert_eq!(rig.take_motions(), []);
        assert!(rig.outputs().contains(Outputs::ERROR), "unknown outcome: {:?}", rig.outputs());
    }
}

/// Without a node that acknowledges, every other repetition waits in the controller's mailbox until it is discarded.
#[test]
fn link_ok_falls_within_a_second_after_the_plug_is_pulled() {
    for offset_ms in 0..150 {
        let mut rig = homed();
        assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
        assert_eq!(rig.command(Inputs::RELEASE), IDLE);
        rig.pass(offset_ms);
        rig.can.double.set_unheard(true);
        rig.can.to_bridge = Some(Box::new(|_| vec![]));
        assert!(rig.until(1_000, |outputs| !outputs.contains(Outputs::LINK_OK)), "{offset_ms}");
    }
}

#[test]
fn unsent_message_is_withdrawn_before_its_time_out() {
    // Frames are received, but none is sent, as with only a listening node on the bus.
    let mut rig = homed();
    rig.take_sent();
    rig.can.double.set_unheard(true);
    rig.set(Inputs::GRIP, true);
    rig.pass(20);
    rig.set(Inputs::GRIP, false);
    rig.pass(1_000);
    assert!(rig.can.double.withdrawn() > 0 && rig.link().counters().broken > 0);
    rig.can.double.set_unheard(false);
    rig.pass(3_000);
    assert_eq!(rig.take_motions(), []);
    assert!(rig.outputs().contains(Outputs::ERROR | Outputs::LINK_OK), "{:?}", rig.outputs());
    assert_eq!(rig.command(Inputs::GRIP), IDLE | Outputs::HOLDING);
}

#[test]
fn controller_overruns_and_refusals_are_counted_and_overcome() {
    let mut rig = homed();
    rig.can.double.overrun();
    rig.pass(500);
    rig.can.double.refuse(true);
    rig.pass(3_000);
    assert!(!rig.outputs().contains(Outputs::LINK_OK));
    rig.can.double.refuse(false);
    assert!(rig.until(3_000, |outputs| outputs.contains(Outputs::LINK_OK)), "{:?}", rig.outputs());
    let counters = rig.can_bus().counters();
    assert_eq!(counters.overruns, 1);
    assert!(counters.refused > 0);
}

/// Fault of one frame.
#[derive(Clone, Copy, Debug)]
enum FrameFault {
    Lost,
    Doubled,
    /// Another node sends the start of a long message with the same identifier before it.
    Misled,
}

/// Applies the fault to the frame with this number, counted from now.
fn hit(fault: FrameFault, number: usize) -> Disturbance {
    let mut count = 0;
    Box::new(move |frame: ClassicFrame| {
        count += 1;
        match fault {
            _ if count != number + 1 => vec![frame],
            FrameFault::Lost => vec![],
            FrameFault::Doubled => vec![frame, frame],
            FrameFault::Misled => {
                let head = [0xAA, 0xAA, 0xAA, 0x40, 0x03, 0x03, 0, 0];
                vec![ClassicFrame::new(frame.id(), &head).unwrap(), frame]
            }
        }
    })
}

#[test]
fn fast_stop_over_can_arrives_in_250_ms_despite_any_frame_fault() {
    const FRAMES: usize = 12;
    let mut rig = World::homed_on_can(quick(), BusOffPolicy::DEFAULT);
    let mut worst = 0;
    let mut case = 0;
    for fault in [FrameFault::Lost, FrameFault::Doubled, FrameFault::Misled] {
        for to_gripper in [true, false] {
            for number in 0..FRAMES {
                for low_after in [0, 2, 4, 12] {
                    case += 1;
                    rig.set(Inputs::RECIPE0, case % 2 == 0);
                    rig.set(Inputs::GRIP, true);
                    let disturbance = Some(hit(fault, number));
                    if to_gripper {
                        rig.can.to_gripper = disturbance;
                    } else {
                        rig.can.to_bridge = disturbance;
                    }
                    rig.pass(low_after);
                    rig.set(Inputs::FAST_STOP_OK, false);
                    let stopped = (1..=1_000).find(|_| {
                        rig.pass(1);
                        rig.gripper().state().flags.contains(SystemFlags::FAST_STOP)
                    });
                    let ms = stopped.unwrap_or(1_001);
                    worst = worst.max(ms);
                    assert!(
                        ms <= 250,
                        "{fault:?} of frame {number}, to the gripper: {to_gripper}, {low_after} ms: {ms} ms"
                    );
                    (rig.can.to_gripper, rig.can.to_bridge) = (None, None);
                    rig.set(Inputs::GRIP, false);
                    rig.set(Inputs::FAST_STOP_OK, true);
                    rig.pass(700);
                    rig.get_ready();
                }
            }
        }
    }
    assert!(worst > 30, "some cases need a burst: {worst} ms");
}

/// A motion of the wires: wire, command, and number of CAN frames.
#[derive(Clone, Copy, Debug)]
struct Motion {
    wire: Inputs,
    id: CommandId,
    frames: usize,
}

const MOTIONS: [Motion; 2] = [
    Motion { wire: Inputs::GRIP, id: CommandId::GripPart, frames: 2 },
    Motion { wire: Inputs::MOVE, id: CommandId::PrePosition, frames: 3 },
];

/// Wires and levels that stop the fingers.
const STOPS: [(Inputs, bool); 2] = [(Inputs::STOP_ACK, true), (Inputs::FAST_STOP_OK, false)];

/// SDO response of the bridge to a PLC.
const SDO_ANSWER: u16 = 0x580 | DEFAULT_NODE.node as u16;

/// A rig with gripper and PLC on one bus, which blocks during a motion command.
struct Blocked {
    rig: World,
    motion: Motion,
    /// All bytes that the gripper has received since the motion command.
    bytes: Rc<RefCell<Vec<u8>>>,
    width: f32,
}

impl Blocked {
    /// Sends `sent` frames of the motion, then blocks the bus. An SDO response waits as well.
    fn after(motion: Motion, sent: usize) -> Self {
        let mut rig = World::with_node(with_part(20.0), DEFAULT_NODE);
        rig.get_homed();
        // The gripper already has the recipe's force limit, so GRIP is sent without setting it.
        rig.command(Inputs::GRIP);
        rig.command(Inputs::RELEASE);
        rig.pass(500);
        rig.take_sent();
        rig.can.take_frames();
        let width = rig.gripper().state().width;
        if sent == 0 {
            rig.can.double.set_unheard(true);
        }
        let bytes = Rc::new(RefCell::new(Vec::new()));
        let (double, got) = (rig.can.double.clone(), Rc::clone(&bytes));
        let own = Id::Standard(Identifiers::DEFAULT.controller().transmit);
        let mut frames_of_it = 0;
        rig.can.to_gripper = Some(Box::new(move |frame: ClassicFrame| {
            if frame.id() == own {
                got.borrow_mut().extend_from_slice(frame.data());
                let begins = frame.data().starts_with(&[0xAA, 0xAA, 0xAA, motion.id.code()]);
                frames_of_it += usize::from(begins || frames_of_it > 0);
                if frames_of_it == sent && sent > 0 {
                    double.set_unheard(true);
                }
            }
            vec![frame]
        }));
        let request = StandardId::new(0x600 | u16::from(DEFAULT_NODE.node)).unwrap();
        let request = ClassicFrame::new(request, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]).unwrap();
        // In a mailbox before the motion, or waiting for one after it.
        if sent == 0 {
            rig.can.queue(request);
            rig.pass(2);
        }
        rig.set(motion.wire, true);
        rig.pass(10);
        rig.set(motion.wire, false);
        if sent > 0 {
            rig.can.queue(request);
        }
        rig.pass(2);
        Self { rig, motion, bytes, width }
    }

    /// Stops the fingers, and frees the bus 15 ms later. Returns the first command that the gripper then receives, and after
    /// how many milliseconds.
    fn stop_and_unblock(&mut self, (wire, level): (Inputs, bool)) -> (CommandId, u32) {
        self.rig.set(wire, level);
        self.rig.pass(15);
        self.unblock()
    }

    /// Begins to send the next frame of the motion. Its first frame may follow a query.
    fn begin_frame(&mut self, is_first: bool) {
        let head = [0xAA, 0xAA, 0xAA, self.motion.id.code()];
        loop {
            let frame = self.rig.can.double.begin_frame().expect("a frame of the motion waits");
            if !is_first || frame.data().starts_with(&head) {
                return;
            }
            self.rig.end_frame(true);
            self.rig.pass(1);
        }
    }

    fn unblock(&mut self) -> (CommandId, u32) {
        let earlier = self.rig.take_sent().into_iter().find(|id| id.kind() == Kind::Motion);
        assert_eq!(earlier, None, "{:?}", self.motion);
        self.rig.can.double.set_unheard(false);
        for ms in 1..=50 {
            self.rig.step();
            // A query may precede it.
            if let Some(first) = self.rig.take_sent().into_iter().find(|id| id.kind() != Kind::Query) {
                return (first, ms);
            }
        }
        panic!("{:?}: nothing is sent", self.motion);
    }

    /// Returns the commands that the simplest gripper finds. It treats the frames' data as a stream of bytes, waits without a
    /// time-out for the length in the size field, and discards all bytes of a message with a wrong checksum.
    fn received_by_the_simplest_gripper(&self) -> Vec<CommandId> {
        let bytes = self.bytes.borrow();
        let (mut rest, mut received) = (bytes.as_slice(), vec![]);
        while let [first, others @ ..] = rest {
            rest = match rest {
                [0xAA, 0xAA, 0xAA, id, low, high, ..] => {
                    let len = usize::from(u16::from_le_bytes([*low, *high])) + OVERHEAD;
                    let Some((message, after)) = rest.split_at_checked(len) else { return received };
                    if checksum::of(message) == 0 {
                        received.push(CommandId::from_code(*id));
                    }
                    after
                }
                _ => {
                    assert_ne!(*first, 0xAA, "the start of a message was lost");
                    others
                }
            };
        }
        received
    }

    /// Checks the state after the stop, regardless of the point of interruption.
    fn check_that_it_is_over(mut self, (wire, level): (Inputs, bool), context: &str) {
        self.rig.pass(200);
        let Self { rig, motion, width, .. } = &mut self;
        assert!(rig.outputs().contains(Outputs::LINK_OK), "{context}: {:?}", rig.outputs());
        assert_eq!(rig.take_motions(), [], "{context}: sent later");
        assert_eq!(rig.gripper().state().width, *width, "{context}: the fingers have moved");
        let answers = rig.can.take_frames().into_iter().filter(|(_, id, _)| *id == SDO_ANSWER);
        assert_eq!(answers.count(), 1, "{context}: the SDO answer");
        rig.set(wire, !level);
        rig.pass(20);
        rig.pulse(Inputs::STOP_ACK);
        assert!(rig.until(200, |outputs| outputs.contains(Outputs::READY)), "{context}: {:?}", rig.outputs());
        assert_eq!(rig.take_motions(), [], "{context}");
        rig.command(motion.wire);
        assert_eq!(rig.take_motions(), [motion.id], "{context}");
        let received = self.received_by_the_simplest_gripper();
        let commands: Vec<CommandId> = received.into_iter().filter(|id| id.kind() != Kind::Query).collect();
        assert_eq!(commands.first().map(|id| id.kind()), Some(Kind::Stop), "{context}: {commands:?}");
        let motions = commands.iter().filter(|id| id.kind() == Kind::Motion);
        assert_eq!(motions.count(), 1, "{context}: {commands:?}");
    }
}

#[test]
fn stop_and_fast_stop_withdraw_a_motion_with_unsent_frames() {
    for motion in MOTIONS {
        for sent in 0..motion.frames {
            for stop in STOPS {
                let context = format!("{motion:?}, {sent} sent, {stop:?}");
                let mut blocked = Blocked::after(motion, sent);
                let waits = blocked.rig.can.double.waiting();
                assert!(
                    waits
                        .iter()
                        .any(|frame| frame.id() == Id::Standard(Identifiers::DEFAULT.controller().transmit))
                );

                let (first, ms) = blocked.stop_and_unblock(stop);

                let expected = if stop.0 == Inputs::STOP_ACK { CommandId::Stop } else { CommandId::FastStop };
                assert_eq!(first, expected, "{context}");
                assert!(ms <= 2, "{context}: after {ms} ms");
                assert_eq!(blocked.rig.can.broken(), u16::from(sent > 0), "{context}: spoilt if partly sent");
                blocked.check_that_it_is_over(stop, &context);
            }
        }
    }
}

#[test]
fn completely_sent_motion_is_sent_once_and_stopped() {
    for motion in MOTIONS {
        for stop in STOPS {
            let mut blocked = Blocked::after(motion, motion.frames);
            assert_eq!(blocked.rig.take_motions(), [motion.id]);

            let (first, ms) = blocked.stop_and_unblock(stop);

            assert!(matches!(first, CommandId::Stop | CommandId::FastStop), "{motion:?}, {stop:?}: {first}");
            assert!(ms <= 2, "{motion:?}, {stop:?}: after {ms} ms");
            blocked.rig.pass(1_000);
            assert_eq!(blocked.rig.take_motions(), []);
            assert_eq!(blocked.rig.can.broken(), 0);
        }
    }
}

#[test]
fn late_reply_to_earlier_motion_does_not_prevent_withdrawal() {
    for motion in MOTIONS {
        for status in [Status::CmdPending, Status::Success] {
            for stop in STOPS {
                let context = format!("{motion:?}, {status:?}, {stop:?}");
                let mut blocked = Blocked::after(motion, 1);
                let answer = Reply::status_only(motion.id, status);
                for segment in Segments::new(FrameEncoder::new(motion.id.code(), answer)) {
                    let from_gripper = Identifiers::DEFAULT.controller().receive;
                    blocked.rig.can.double.deliver(segment.frame(from_gripper).unwrap());
                }
                blocked.rig.pass(2);

                let (first, ms) = blocked.stop_and_unblock(stop);

                assert_eq!((first.kind(), ms <= 2), (Kind::Stop, true), "{context}: {first} after {ms} ms");
                blocked.rig.pass(1_000);
                assert_eq!(blocked.rig.take_motions(), [], "{context}");
                assert_eq!(blocked.rig.gripper().state().width, blocked.width, "{context}");
            }
        }
    }
}

#[test]
fn withdrawal_is_decided_after_the_end_of_the_frame_on_the_bus() {
    for motion in MOTIONS {
        for sent in 0..motion.frames {
            for stop in STOPS {
                for is_acknowledged in [false, true] {
                    let context =
                        format!("{motion:?}, {sent} sent, one acknowledged: {is_acknowledged}, {stop:?}");
                    let mut blocked = Blocked::after(motion, sent);
                    blocked.begin_frame(sent == 0);
                    blocked.rig.set(stop.0, stop.1);
                    blocked.rig.pass(15);
                    assert_eq!(blocked.rig.can.double.withdrawn(), 0, "{context}");

                    blocked.rig.end_frame(is_acknowledged);

                    let is_whole = is_acknowledged && sent + 1 == motion.frames;
                    if is_whole {
                        assert_eq!(blocked.rig.take_motions(), [motion.id], "{context}");
                    }
                    let (first, ms) = blocked.unblock();
                    let expected =
                        if stop.0 == Inputs::STOP_ACK { CommandId::Stop } else { CommandId::FastStop };
                    assert_eq!(first, expected, "{context}");
                    assert!(ms <= 2, "{context}: after {ms} ms");
                    let is_begun = sent > 0 || is_acknowledged;
                    assert_eq!(blocked.rig.can.broken(), u16::from(is_begun && !is_whole), "{context}");
                    if !is_whole {
                        blocked.check_that_it_is_over(stop, &context);
                    }
                }
            }
        }
    }
}

#[test]
fn acknowledgement_is_withdrawn_when_fast_stop_ok_falls_again() {
    for sent in 0..2 {
        let mut rig = World::with_node(with_part(20.0), DEFAULT_NODE);
        rig.get_homed();
        rig.set(Inputs::FAST_STOP_OK, false);
        rig.pass(100);
        rig.set(Inputs::FAST_STOP_OK, true);
        rig.pass(100);
        rig.take_sent();
        let double = rig.can.double.clone();
        rig.can.double.set_unheard(sent == 0);
        rig.can.to_gripper = Some(Box::new(move |frame: ClassicFrame| {
            let is_head = frame.data().starts_with(&[0xAA, 0xAA, 0xAA, CommandId::Acknowledge.code()]);
            double.set_unheard(sent > 0 && is_head);
            vec![frame]
        }));
        rig.set(Inputs::STOP_ACK, true);
        rig.pass(10);
        assert_eq!(rig.take_sent(), []);

        rig.set(Inputs::FAST_STOP_OK, false);
        rig.pass(15);
        rig.can.to_gripper = None;
        rig.can.double.set_unheard(false);
        rig.pass(2);

        assert_eq!(rig.take_sent().first(), Some(&CommandId::FastStop), "{sent} sent");
        rig.pass(1_000);
        assert!(!rig.take_sent().contains(&CommandId::Acknowledge), "{sent} sent");
        assert!(rig.gripper().state().flags.contains(SystemFlags::FAST_STOP), "{sent} sent");
        assert!(rig.outputs().contains(Outputs::LINK_OK), "{sent} sent: {:?}", rig.outputs());
    }
}
