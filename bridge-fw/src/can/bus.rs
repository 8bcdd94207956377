//! The controller, shared by the participants of the bus.

use embedded_can::{Frame, Id};
use wsg_protocol::Instant;

use super::bus_off::{BusOff, Step};
use super::{
    BusCounters, BusOffPolicy, BusReport, BusState, CanController, Health, LinkCounters, Withdrawal,
};

/// Maximum frames read from the controller per turn. At 1 Mbit/s, a millisecond is 9 frames of 8 bytes, or 21 empty ones.
pub(crate) const MAX_RECEIVED_PER_POLL: usize = 24;

/// Maximum frames passed to the controller per turn.
const MAX_SENT_PER_POLL: usize = 8;

/// Maximum unsent frames of one participant: one in the controller, two waiting for it.
pub(crate) const MAX_ON_THE_WAY: usize = 3;

/// Indices of the participants in `waiting`.
const FIRST: usize = 0;
const SECOND: usize = 1;

/// A participant of the bus.
pub trait CanNode<F> {
    /// Processes a received frame, for any node.
    fn on_frame(&mut self, now: Instant, frame: &F);

    /// Returns the next frame to send.
    fn poll_transmit(&mut self, now: Instant) -> Option<F>;

    /// Returns whether frames with this identifier are its own.
    fn sends(&self, id: Id) -> bool;

    /// One of its frames was discarded, so related frames need not be sent either.
    fn lost(&mut self);

    /// The bus was lost or has recovered. Frames from before must not be sent afterwards.
    fn bus_changed(&mut self, is_on: bool);

    /// Returns the identifier of its frames if it wants to withdraw all unsent ones. Without an acknowledgement, a frame
    /// waits in the controller indefinitely, and is sent as soon as another node joins. The participant sends nothing before
    /// [`taken_back`](Self::taken_back).
    fn takes_back(&self) -> Option<Id> {
        None
    }

    /// Its frames are withdrawn: the last `count` frames were not sent, all earlier ones were.
    fn taken_back(&mut self, _count: usize) {}
}

/// An optional node: `None` ignores every frame.
impl<F, N: CanNode<F>> CanNode<F> for Option<&mut N> {
    fn on_frame(&mut self, now: Instant, frame: &F) {
        if let Some(node) = self {
            node.on_frame(now, frame);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<F> {
        self.as_mut()?.poll_transmit(now)
    }

    fn sends(&self, id: Id) -> bool {
        self.as_ref().is_some_and(|node| node.sends(id))
    }

    fn lost(&mut self) {
        if let Some(node) = self {
            node.lost();
        }
    }

    fn bus_changed(&mut self, is_on: bool) {
        if let Some(node) = self {
            node.bus_changed(is_on);
        }
    }

    fn takes_back(&self) -> Option<Id> {
        self.as_ref()?.takes_back()
    }

    fn taken_back(&mut self, count: usize) {
        if let Some(node) = self {
            node.taken_back(count);
        }
    }
}

/// A controller and its bus, for up to two participants: the gripper's link first, the PLC's side second. Independent of the
/// board. In each turn, call [`listen`](Self::listen) before the bridge's turn and [`talk`](Self::talk) after it.
#[derive(Clone, Debug)]
pub struct CanBus<C: CanController> {
    controller: C,
    bus_off: BusOff,
    health: Health,
    counters: BusCounters,
    waiting: [Waiting<C::Frame>; 2],
}

/// Frames of one participant that the controller has not accepted, in order.
#[derive(Clone, Debug)]
struct Waiting<F> {
    next: Option<F>,
    /// The frame after `next`, if the controller returned an earlier frame.
    behind: Option<F>,
}

impl<F> Waiting<F> {
    const NOTHING: Self = Self { next: None, behind: None };

    fn count(&self) -> usize {
        usize::from(self.next.is_some()).saturating_add(self.behind.is_some().into())
    }
}

impl<C: CanController> CanBus<C> {
    /// Creates a bus with this controller, which is already on the bus.
    pub const fn new(controller: C, policy: BusOffPolicy) -> Self {
        Self {
            controller,
            bus_off: BusOff::new(policy),
            health: Health { is_off: false, is_passive: false, transmit_errors: 0, receive_errors: 0 },
            counters: BusCounters { bus_offs: 0, overruns: 0, refused: 0 },
            waiting: [const { Waiting::NOTHING }; 2],
        }
    }

    /// Returns the bridge's participation in the bus.
    pub const fn state(&self) -> BusState {
        self.bus_off.state()
    }

    /// Returns whether the bus is lost, which the PLC must be shown.
    pub fn is_lost(&self) -> bool {
        self.state() != BusState::On
    }

    /// Returns the controller's state in the last turn.
    pub const fn health(&self) -> Health {
        self.health
    }

    /// Returns the error counters of the bus.
    pub const fn counters(&self) -> BusCounters {
        self.counters
    }

    /// Returns the report on the bus, with the counters of the gripper's link, which are 0 if the link is not on this bus.
    pub const fn report(&self, link: LinkCounters) -> BusReport {
        BusReport { state: self.state(), health: self.health(), counters: self.counters, link }
    }

    /// Returns the controller, for its board.
    pub const fn controller(&mut self) -> &mut C {
        &mut self.controller
    }

    /// Tries to recover a bus that was given up.
    pub fn retry(&mut self, now: Instant) {
        self.bus_off.retry(now);
    }

    /// First half of a turn, before the bridge's: checks the controller and processes received frames. Never waits.
    pub fn listen(
        &mut self,
        now: Instant,
        first: &mut impl CanNode<C::Frame>,
        second: &mut impl CanNode<C::Frame>,
    ) {
        self.health = self.controller.health();
        let step = self.bus_off.update(now, self.health.is_off);
        match step {
            Step::Nothing | Step::Leave => {}
            Step::Recover => self.controller.recover(),
            Step::Join => {
                // The controller must not send earlier frames now, even if it still holds some.
                self.forget();
                first.bus_changed(true);
                second.bus_changed(true);
            }
        }
        self.receive(now, first, second);
        if step == Step::Leave {
            // Frames received before the loss are valid, and may include a FAST STOP.
            add(&mut self.counters.bus_offs);
            self.forget();
            first.bus_changed(false);
            second.bus_changed(false);
        }
    }

    fn receive(
        &mut self,
        now: Instant,
        first: &mut impl CanNode<C::Frame>,
        second: &mut impl CanNode<C::Frame>,
    ) {
        for _ in 0..MAX_RECEIVED_PER_POLL {
            match self.controller.receive() {
                Ok(frame) => {
                    first.on_frame(now, &frame);
                    second.on_frame(now, &frame);
                }
                Err(nb::Error::WouldBlock) => return,
                Err(nb::Error::Other(_)) => add(&mut self.counters.overruns),
            }
        }
    }

    /// Second half of a turn, after the bridge's: passes frames to the controller. Never waits.
    ///
    /// The first participant has priority, regardless of identifiers. A controller rejects frames while it holds a more
    /// urgent one, but always accepts a more urgent one. So the second participant never delays a FAST STOP here, and the bus
    /// carries all frames in the order of their identifiers.
    pub fn talk(
        &mut self,
        now: Instant,
        first: &mut impl CanNode<C::Frame>,
        second: &mut impl CanNode<C::Frame>,
    ) {
        if self.is_lost() {
            return;
        }
        let may_send = [self.take_back(FIRST, first), self.take_back(SECOND, second)];
        for _ in 0..MAX_SENT_PER_POLL {
            let [own, other] = &mut self.waiting;
            fill(own, now, first);
            fill(other, now, second);
            let [first_may, second_may] = may_send;
            let is_given = (first_may && self.send(FIRST, first, second))
                || (second_may && self.send(SECOND, first, second));
            if !is_given {
                return;
            }
        }
    }

    /// Withdraws a participant's unsent frames on its request. Returns whether it may send, which it may not while a
    /// withdrawal from the controller is undecided.
    fn take_back(&mut self, whose: usize, node: &mut impl CanNode<C::Frame>) -> bool {
        let Some(id) = node.takes_back() else { return true };
        let in_controller = match self.controller.withdraw(id) {
            Withdrawal::Undecided => return false,
            Withdrawal::Withdrawn => 1,
            Withdrawal::TooLate => 0,
        };
        let waiting =
            self.waiting.get_mut(whose).map(|waiting| core::mem::replace(waiting, Waiting::NOTHING));
        node.taken_back(waiting.map_or(0, |waiting| waiting.count()).saturating_add(in_controller));
        true
    }

    fn forget(&mut self) {
        self.controller.abort();
        self.waiting = [const { Waiting::NOTHING }; 2];
    }

    /// Passes a participant's next frame to the controller. Returns whether the frame left the queue.
    fn send(
        &mut self,
        whose: usize,
        first: &mut impl CanNode<C::Frame>,
        second: &mut impl CanNode<C::Frame>,
    ) -> bool {
        let Some(waiting) = self.waiting.get_mut(whose) else { return false };
        let Some(frame) = waiting.next.take() else { return false };
        match self.controller.transmit(&frame) {
            Ok(None) => true,
            Ok(Some(given_back)) => {
                let [own, other] = &mut self.waiting;
                let fits = if first.sends(given_back.id()) {
                    put_back(own, given_back)
                } else {
                    put_back(other, given_back)
                };
                if !fits {
                    add(&mut self.counters.refused);
                    first.lost();
                    second.lost();
                }
                true
            }
            Err(nb::Error::WouldBlock) => {
                waiting.next = Some(frame);
                false
            }
            Err(nb::Error::Other(_)) => {
                add(&mut self.counters.refused);
                if whose == FIRST {
                    first.lost()
                } else {
                    second.lost()
                }
                true
            }
        }
    }
}

fn fill<F>(waiting: &mut Waiting<F>, now: Instant, whose: &mut impl CanNode<F>) {
    if waiting.next.is_none() {
        waiting.next = waiting.behind.take().or_else(|| whose.poll_transmit(now));
    }
}

/// Puts a frame before the waiting ones. Returns whether there was room.
fn put_back<F>(waiting: &mut Waiting<F>, frame: F) -> bool {
    let follower = waiting.next.replace(frame);
    match follower {
        None => true,
        follower => core::mem::replace(&mut waiting.behind, follower).is_none(),
    }
}

fn add(count: &mut u16) {
    *count = count.saturating_add(1);
}
