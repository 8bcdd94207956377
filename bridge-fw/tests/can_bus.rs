//! Tests of a CAN bus with two participants, on a recording controller: priority, returned frames and losses.

use std::collections::VecDeque;

use bus_slcan::ClassicFrame;
use embedded_can::{ExtendedId, Frame, Id, StandardId};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, CanController, CanNode, Health, Withdrawal};
use wsg_protocol::Instant;

/// Response of the controller to a frame.
#[derive(Clone, Copy, Debug)]
enum Takes {
    It,
    /// Has no room for this identifier.
    No,
    /// Accepts the frame, and returns an earlier one.
    Instead(ClassicFrame),
    Never,
}

/// A controller with scripted responses. After the script, it accepts every frame.
#[derive(Debug, Default)]
struct Scripted {
    answers: VecDeque<Takes>,
    /// Identifiers that are always rejected for lack of room.
    full: Vec<Id>,
    taken: Vec<Id>,
    /// Scripted outcomes of withdrawals, and the identifiers of all withdrawals.
    outcomes: VecDeque<Withdrawal>,
    withdrawn: Vec<Id>,
}

#[derive(Debug)]
struct Refused;

impl embedded_can::Error for Refused {
    fn kind(&self) -> embedded_can::ErrorKind {
        embedded_can::ErrorKind::Other
    }
}

impl embedded_can::nb::Can for Scripted {
    type Frame = ClassicFrame;
    type Error = Refused;

    fn transmit(&mut self, frame: &ClassicFrame) -> nb::Result<Option<ClassicFrame>, Refused> {
        if self.full.contains(&frame.id()) {
            return Err(nb::Error::WouldBlock);
        }
        let given_back = match self.answers.pop_front().unwrap_or(Takes::It) {
            Takes::It => None,
            Takes::No => return Err(nb::Error::WouldBlock),
            Takes::Never => return Err(nb::Error::Other(Refused)),
            Takes::Instead(earlier) => Some(earlier),
        };
        self.taken.push(frame.id());
        Ok(given_back)
    }

    fn receive(&mut self) -> nb::Result<ClassicFrame, Refused> {
        Err(nb::Error::WouldBlock)
    }
}

impl CanController for Scripted {
    fn health(&mut self) -> Health {
        Health::default()
    }

    fn withdraw(&mut self, id: Id) -> Withdrawal {
        self.withdrawn.push(id);
        self.outcomes.pop_front().unwrap_or(Withdrawal::TooLate)
    }

    fn abort(&mut self) {}

    fn recover(&mut self) {}
}

/// A participant with frames to send, all with one identifier.
#[derive(Debug)]
struct Speaker {
    id: Id,
    left: usize,
    losses: usize,
    takes_back: bool,
    /// Number of withdrawn frames.
    back: Option<usize>,
}

impl Speaker {
    fn new(id: Id, left: usize) -> Self {
        Self { id, left, losses: 0, takes_back: false, back: None }
    }
}

impl CanNode<ClassicFrame> for Speaker {
    fn on_frame(&mut self, _: Instant, _: &ClassicFrame) {}

    fn poll_transmit(&mut self, _: Instant) -> Option<ClassicFrame> {
        self.left = self.left.checked_sub(1)?;
        Some(frame(self.id))
    }

    fn sends(&self, id: Id) -> bool {
        id == self.id
    }

    fn lost(&mut self) {
        self.losses += 1;
    }

    fn takes_back(&self) -> Option<Id> {
        self.takes_back.then_some(self.id)
    }

    fn taken_back(&mut self, count: usize) {
        self.takes_back = false;
        self.back = Some(count);
    }

    fn bus_changed(&mut self, _: bool) {}
}

fn standard(id: u16) -> Id {
    StandardId::new(id).unwrap().into()
}

fn extended(id: u32) -> Id {
    ExtendedId::new(id).unwrap().into()
}

fn frame(id: Id) -> ClassicFrame {
    ClassicFrame::new(id, &[]).unwrap()
}

fn bus(controller: Scripted) -> CanBus<Scripted> {
    CanBus::new(controller, BusOffPolicy::DEFAULT)
}

fn talk(
    bus: &mut CanBus<Scripted>,
    first: &mut impl CanNode<ClassicFrame>,
    second: &mut impl CanNode<ClassicFrame>,
) {
    bus.talk(Instant::from_millis(1), first, second);
}

#[test]
fn first_participant_has_priority_regardless_of_identifiers() {
    for [first, second] in
        [[standard(1), standard(2)], [standard(2), standard(1)], [extended(7), standard(1)]]
    {
        let mut bus = bus(Scripted::default());
        talk(&mut bus, &mut Speaker::new(first, 2), &mut Speaker::new(second, 2));
        assert_eq!(bus.controller().taken, [first, first, second, second]);
    }
}

#[test]
fn participant_without_room_does_not_block_the_other() {
    for (full, free) in [(1, 2), (2, 1)] {
        let mut bus = bus(Scripted { full: vec![standard(full)], ..Scripted::default() });
        let (mut first, mut second) = (Speaker::new(standard(1), 3), Speaker::new(standard(2), 3));
        talk(&mut bus, &mut first, &mut second);
        assert_eq!(bus.controller().taken, [free; 3].map(standard));
        bus.controller().full.clear();
        talk(&mut bus, &mut first, &mut second);
        assert_eq!(bus.controller().taken[3..], [full; 3].map(standard), "no frame was lost");
    }
}

#[test]
fn at_most_eight_frames_are_sent_per_turn() {
    let mut bus = bus(Scripted::default());
    let mut first = Speaker::new(standard(1), 20);
    talk(&mut bus, &mut first, &mut None::<&mut Speaker>);
    assert_eq!(bus.controller().taken.len(), 8);
}

#[test]
fn returned_frame_is_sent_next_before_waiting_frames() {
    for (giver, taker) in [(1u16, 2u16), (2, 1)] {
        // A frame of `taker` replaces one of `giver` in the controller.
        let mut bus = bus(Scripted::default());
        let mut speakers = [Speaker::new(standard(1), 0), Speaker::new(standard(2), 0)];
        speakers[usize::from(taker - 1)].left = 1;
        bus.controller().answers.extend([Takes::Instead(frame(standard(giver))), Takes::No, Takes::No]);
        let [first, second] = &mut speakers;
        talk(&mut bus, first, second);
        assert_eq!(bus.controller().taken, [standard(taker)]);
        bus.controller().answers.clear();
        talk(&mut bus, first, second);
        assert_eq!(bus.controller().taken, [standard(taker), standard(giver)]);
        assert_eq!((first.losses, second.losses, bus.counters().refused), (0, 0, 0));
    }
}

/// Returns a bus on which frames of the second participant replaced earlier ones of the first, while another one of the first
/// waits.
fn crowded(frames_of_the_second: usize) -> (CanBus<Scripted>, Speaker, Speaker) {
    let mut bus = bus(Scripted { full: vec![standard(2)], ..Scripted::default() });
    let (mut first, mut second) =
        (Speaker::new(standard(2), 1), Speaker::new(standard(1), frames_of_the_second));
    let earlier = Takes::Instead(frame(standard(2)));
    bus.controller().answers.extend(vec![earlier; frames_of_the_second]);
    talk(&mut bus, &mut first, &mut second);
    (bus, first, second)
}

#[test]
fn frame_displaced_by_a_returned_one_is_not_lost() {
    let (mut bus, mut first, mut second) = crowded(1);
    bus.controller().full.clear();
    talk(&mut bus, &mut first, &mut second);
    assert_eq!(bus.controller().taken, [1, 2, 2].map(standard));
    assert_eq!((first.losses, second.losses, bus.counters().refused), (0, 0, 0));
}

#[test]
fn returned_frame_without_room_is_reported_to_both() {
    // Two frames are returned while a third waits, but there is room for two.
    let (bus, first, second) = crowded(2);
    assert_eq!((first.losses, second.losses, bus.counters().refused), (1, 1, 1));
}

#[test]
fn returned_frame_keeps_its_owner() {
    for is_of_the_first in [true, false] {
        let mut bus = bus(Scripted::default());
        let mut speaker = Speaker::new(standard(1), 1);
        let (mut first, mut second) =
            if is_of_the_first { (Some(&mut speaker), None) } else { (None, Some(&mut speaker)) };
        bus.controller().answers.extend([Takes::Instead(frame(standard(1))), Takes::Never]);
        talk(&mut bus, &mut first, &mut second);
        assert_eq!(speaker.losses, 1, "the later rejection is reported to it");
    }
}

#[test]
fn rejection_is_reported_only_to_the_frames_owner() {
    for (refused, losses) in [(1, (1, 0)), (2, (0, 1))] {
        let mut bus = bus(Scripted::default());
        let (mut first, mut second) = (Speaker::new(standard(1), 0), Speaker::new(standard(2), 0));
        let speaker = if refused == 1 { &mut first } else { &mut second };
        speaker.left = 1;
        bus.controller().answers.push_back(Takes::Never);
        talk(&mut bus, &mut first, &mut second);
        assert_eq!((first.losses, second.losses), losses);
        assert_eq!(bus.counters().refused, 1);
    }
}

#[test]
fn withdrawn_frames_are_counted_and_frames_of_the_other_stay() {
    // Outcome for the frame in the controller; another frame waits for it; withdrawn frames.
    for (outcome, waits, count) in [
        (Withdrawal::Withdrawn, true, 2),
        (Withdrawal::Withdrawn, false, 1),
        (Withdrawal::TooLate, true, 1),
        (Withdrawal::TooLate, false, 0),
    ] {
        for (taker, other) in [(1u16, 2u16), (2, 1)] {
            let mut bus = bus(Scripted::default());
            let mut speakers = [1, 2].map(|id| Speaker::new(standard(id), 1));
            let [first, second] = &mut speakers;
            talk(&mut bus, first, second);
            bus.controller().full = vec![standard(1), standard(2)];
            speakers.iter_mut().for_each(|speaker| speaker.left = 1);
            speakers[usize::from(taker - 1)].left = usize::from(waits);
            let [first, second] = &mut speakers;
            talk(&mut bus, first, second);

            speakers[usize::from(taker - 1)].takes_back = true;
            bus.controller().outcomes.push_back(outcome);
            bus.controller().full.clear();
            let [first, second] = &mut speakers;
            talk(&mut bus, first, second);

            assert_eq!(bus.controller().withdrawn, [standard(taker)]);
            assert_eq!(speakers[usize::from(taker - 1)].back, Some(count), "{outcome:?}, {waits}");
            let other_back = &speakers[usize::from(other - 1)];
            assert_eq!((other_back.back, other_back.losses), (None, 0));
            assert_eq!(bus.controller().taken[2..], [standard(other)], "its frame is sent once");
        }
    }
}

#[test]
fn participant_sends_nothing_during_an_undecided_withdrawal() {
    let mut bus = bus(Scripted { full: vec![standard(1)], ..Scripted::default() });
    let (mut first, mut second) = (Speaker::new(standard(1), 1), Speaker::new(standard(2), 1));
    talk(&mut bus, &mut first, &mut second);
    (first.takes_back, second.left) = (true, 1);
    // The frame on the bus ended in this turn, so there would be room.
    bus.controller().full.clear();
    bus.controller().outcomes.extend([Withdrawal::Undecided, Withdrawal::TooLate]);

    talk(&mut bus, &mut first, &mut second);
    assert_eq!((bus.controller().taken.as_slice(), first.back), (&[standard(2); 2][..], None));

    talk(&mut bus, &mut first, &mut second);
    assert_eq!(first.back, Some(1));
    assert_eq!(bus.controller().taken, [standard(2); 2]);
}
