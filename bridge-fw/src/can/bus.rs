//! The controller, shared by those who are on the bus.

use embedded_can::{Frame, Id};
use wsg_protocol::Instant;

use super::bus_off::{BusOff, Step};
use super::{
    BusCounters, BusOffPolicy, BusReport, BusState, CanController, Health, LinkCounters, Withdrawal,
};

/// Frames taken from the controller in one turn, at the most: at 1 Mbit/s a millisecond brings 9 of 8 bytes, or 21 empty
/// ones.
pub(crate) const MAX_RECEIVED_PER_POLL: usize = 24;

/// Frames given to the controller in one turn, at the most.
const MAX_SENT_PER_POLL: usize = 8;

/// Frames of one participant that can be on their way at once: one in the controller, two that wait for it.
pub(crate) const MAX_ON_THE_WAY: usize = 3;

/// Places of the participants among those who wait.
const FIRST: usize = 0;
const SECOND: usize = 1;

/// Somebody on the bus: what it hears and what it has to say.
pub trait CanNode<F> {
    /// Hears a frame, whoever it is for.
    fn on_frame(&mut self, now: Instant, frame: &F);

    /// The next frame that it sends.
    fn poll_transmit(&mut self, now: Instant) -> Option<F>;

    /// Whether frames with this identifier are its own.
    fn sends(&self, id: Id) -> bool;

    /// A frame of its own will not leave: what goes with it need not either.
    fn lost(&mut self);

    /// The bus is lost, or there again. What was to be said before is not said after.
    fn bus_changed(&mut self, is_on: bool);

    /// Returns the identifier of the frames that it takes back: all of its own that were not sent. A frame that is never
    /// acknowledged waits in the controller for ever, and is sent as soon as somebody joins the bus. It sends nothing before
    /// [`taken_back`](Self::taken_back).
    fn takes_back(&self) -> Option<Id> {
        None
    }

    /// It has its frames back: the last `count` of those that it gave were not sent, and all before them were.
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

/// A controller and its bus, for up to two participants: the gripper's link first, the PLC's side second. Board-free: in each turn of the main loop
/// [`listen`](Self::listen) before the bridge's turn and [`talk`](Self::talk) behind it.
#[derive(Debug)]
pub struct CanBus<C: CanController> {
    controller: C,
    bus_off: BusOff,
    health: Health,
    counters: BusCounters,
    waiting: [Waiting<C::Frame>; 2],
}

/// Frames of one participant that the controller has not taken, in order.
#[derive(Debug)]
struct Waiting<F> {
    next: Option<F>,
    /// What was to follow when the controller gave back a frame that it had taken.
    behind: Option<F>,
}

impl<F> Waiting<F> {
    const NOTHING: Self = Self { next: None, behind: None };

    fn count(&self) -> usize {
        usize::from(self.next.is_some()).saturating_add(self.behind.is_some().into())
    }
}

impl<C: CanController> CanBus<C> {
    /// A bus by this controller, which takes part already.
    pub const fn new(controller: C, policy: BusOffPolicy) -> Self {
        Self {
            controller,
            bus_off: BusOff::new(policy),
            health: Health { is_off: false, is_passive: false, transmit_errors: 0, receive_errors: 0 },
            counters: BusCounters { bus_offs: 0, overruns: 0, refused: 0 },
            waiting: [const { Waiting::NOTHING }; 2],
        }
    }

    /// How the bridge stands to the bus.
    pub const fn state(&self) -> BusState {
        self.bus_off.state()
    }

    /// Whether the bus is lost, which the PLC must be told.
    pub fn is_lost(&self) -> bool {
        self.state() != BusState::On
    }

    /// How the controller saw the bus in the last turn.
    pub const fn health(&self) -> Health {
        self.health
    }

    /// What has been met so far.
    pub const fn counters(&self) -> BusCounters {
        self.counters
    }

    /// What is known of the bus and of the gripper's link on it, for those who report it; a link that is not on this bus has
    /// met nothing.
    pub const fn report(&self, link: LinkCounters) -> BusReport {
        BusReport { state: self.state(), health: self.health(), counters: self.counters, link }
    }

    /// The controller, for its board.
    pub const fn controller(&mut self) -> &mut C {
        &mut self.controller
    }

    /// Tries again after the bus was given up.
    pub fn retry(&mut self, now: Instant) {
        self.bus_off.retry(now);
    }

    /// The first half of a turn, before the bridge's: looks after the controller and hears what has come. Never waits.
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
                // What the controller was given before must not leave now, whatever it did with it meanwhile.
                self.forget();
                first.bus_changed(true);
                second.bus_changed(true);
            }
        }
        self.receive(now, first, second);
        if step == Step::Leave {
            // What had come before was true, and may be a FAST STOP.
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

    /// The second half of a turn, behind the bridge's: says what the controller takes. Never waits.
    ///
    /// The first participant's frames are offered first, whatever their identifiers: a controller takes no frame while one
    /// waits in it that is more urgent, but it takes a more urgent one at any time. So the second's never keep a FAST STOP
    /// waiting in here, and on the bus all leave in the order of their identifiers.
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

    /// Gives a participant its unsent frames back, if it asks for them. Returns whether it may send: not while it is open
    /// whether the frame in the controller can still be withdrawn.
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

    /// Gives the controller the next frame of a participant; whether it is gone.
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

/// Puts a frame before those that wait; whether there was room.
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
