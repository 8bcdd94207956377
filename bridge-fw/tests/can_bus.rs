//! The bus that two share, on a controller that notes what it is given: who goes first, what is given back, who is told of a loss.

use std::collections::VecDeque;

use bus_slcan::ClassicFrame;
use embedded_can::{ExtendedId, Frame, Id, StandardId};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, CanController, CanNode, Health, Withdrawal};
use wsg_protocol::Instant;

/// What the controller does with a frame that it is offered.
#[derive(Clone, Copy, Debug)]
enum Takes {
    /// Takes it.
    It,
    /// Has no room for this identifier.
    No,
    /// Takes it, and gives back one that it had taken before.
    Instead(ClassicFrame),
    /// Refuses it.
    Never,
}

/// A controller that does as it was told, and takes everything when that is used up.
#[derive(Debug, Default)]
struct Scripted {
    answers: VecDeque<Takes>,
    /// Identifiers for which there never is room.
    full: Vec<Id>,
    taken: Vec<Id>,
    /// What becomes of withdrawals, and of which identifiers they were.
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

/// Somebody with frames to send, all of one identifier.
#[derive(Debug)]
struct Speaker {
    id: Id,
    left: usize,
    losses: usize,
    takes_back: bool,
    /// How many frames came back.
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
fn frames_of_the_first_are_offered_before_those_of_the_second_whatever_their_identifiers() {
    for [first, second] in
        [[standard(1), standard(2)], [standard(2), standard(1)], [extended(7), standard(1)]]
    {
        let mut bus = bus(Scripted::default());
        talk(&mut bus, &mut Speaker::new(first, 2), &mut Speaker::new(second, 2));
        assert_eq!(bus.controller().taken, [first, first, second, second]);
    }
}

#[test]
fn where_there_is_no_room_for_one_the_other_still_speaks() {
    for (full, free) in [(1, 2), (2, 1)] {
        let mut bus = bus(Scripted { full: vec![standard(full)], ..Scripted::default() });
        let (mut first, mut second) = (Speaker::new(standard(1), 3), Speaker::new(standard(2), 3));
        talk(&mut bus, &mut first, &mut second);
        assert_eq!(bus.controller().taken, [free; 3].map(standard));
        bus.controller().full.clear();
        talk(&mut bus, &mut first, &mut second);
        assert_eq!(bus.controller().taken[3..], [full; 3].map(standard), "none was lost");
    }
}

#[test]
fn eight_frames_leave_in_a_turn_at_the_most() {
    let mut bus = bus(Scripted::default());
    let mut first = Speaker::new(standard(1), 20);
    talk(&mut bus, &mut first, &mut None::<&mut Speaker>);
    assert_eq!(bus.controller().taken.len(), 8);
}

#[test]
fn a_frame_that_the_controller_gives_back_leaves_next_and_before_what_waited() {
    for (giver, taker) in [(1u16, 2u16), (2, 1)] {
        // `giver` had a frame in the controller, which `taker`'s takes the place of.
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

/// A bus on which frames of the second take the place of two of the first that were taken before, while another waits.
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
fn what_a_given_back_frame_pushed_aside_is_not_lost() {
    let (mut bus, mut first, mut second) = crowded(1);
    bus.controller().full.clear();
    talk(&mut bus, &mut first, &mut second);
    assert_eq!(bus.controller().taken, [1, 2, 2].map(standard));
    assert_eq!((first.losses, second.losses, bus.counters().refused), (0, 0, 0));
}

#[test]
fn where_a_given_back_frame_has_no_place_everybody_is_told() {
    // Two come back while a third waits: there are two places.
    let (bus, first, second) = crowded(2);
    assert_eq!((first.losses, second.losses, bus.counters().refused), (1, 1, 1));
}

#[test]
fn a_frame_of_the_second_that_comes_back_is_not_taken_for_nobodys() {
    let mut bus = bus(Scripted::default());
    let mut second = Speaker::new(standard(1), 1);
    bus.controller().answers.extend([Takes::Instead(frame(standard(1))), Takes::Never]);
    talk(&mut bus, &mut None::<&mut Speaker>, &mut second);
    assert_eq!(second.losses, 1, "it is told of what was refused then");
}

#[test]
fn only_he_whose_frame_was_refused_is_told() {
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
fn frames_that_one_takes_back_are_counted_and_those_of_the_other_stay() {
    // In the controller, and waiting for it.
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
fn nothing_of_one_that_takes_back_is_sent_until_the_controller_has_decided() {
    let mut bus = bus(Scripted { full: vec![standard(1)], ..Scripted::default() });
    let (mut first, mut second) = (Speaker::new(standard(1), 1), Speaker::new(standard(2), 1));
    talk(&mut bus, &mut first, &mut second);
    (first.takes_back, second.left) = (true, 1);
    // The frame on the bus has ended in this very turn, so there would be room.
    bus.controller().full.clear();
    bus.controller().outcomes.extend([Withdrawal::Undecided, Withdrawal::TooLate]);

    talk(&mut bus, &mut first, &mut second);
    assert_eq!((bus.controller().taken.as_slice(), first.back), (&[standard(2); 2][..], None));

    talk(&mut bus, &mut first, &mut second);
    assert_eq!(first.back, Some(1));
    assert_eq!(bus.controller().taken, [standard(2); 2]);
}
