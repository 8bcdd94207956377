//! What is subscribed to, and how.

use super::message::Message;

/// One value that a gripper can send by itself, and how it is to do so.
pub trait Subscription: Copy + PartialEq {
    /// A request of the dialect.
    type Request: Message;

    /// Returns the command that asks for the value.
    fn name(&self) -> <Self::Request as Message>::Name;

    /// Whether it is asked for again and again. The two states are, with updates or without: the session needs them.
    fn is_wanted(&self) -> bool;

    /// Returns the request that subscribes, or ends the subscription.
    fn request(&self) -> Self::Request;

    /// Returns what a request subscribes to.
    fn of(request: &Self::Request) -> Option<Self>;
}

/// All values that a dialect has subscriptions for, and which of them the gripper does not know yet.
#[derive(Clone, Debug, Hash)]
pub struct Subscriptions<S, const N: usize> {
    all: [S; N],
    /// Those that were changed while connected and that the gripper has not confirmed; one bit each.
    changed: u8,
}

/// [`Subscriptions`] of any number of values.
pub trait List {
    /// A request of the dialect.
    type Request: Message;

    /// Whether this value is asked for again and again.
    fn wants(&self, name: <Self::Request as Message>::Name) -> bool;

    /// Returns the request for a subscription that was changed.
    fn changed(&self) -> Option<Self::Request>;

    /// Notes that the gripper has answered this request.
    fn confirm(&mut self, request: &Self::Request);
}

impl<S: Subscription, const N: usize> Subscriptions<S, N> {
    pub(crate) const fn new(all: [S; N]) -> Self {
        const { assert!(N <= u8::BITS as usize, "one bit each") }
        Self { all, changed: 0 }
    }

    /// Replaces the subscription to the same value; the gripper is to be told.
    pub(crate) fn set(&mut self, subscription: S) {
        let of = self.all.iter().position(|slot| slot.name() == subscription.name());
        if let Some((slot, bit)) = of.and_then(|place| Some((self.all.get_mut(place)?, bit(place)))) {
            *slot = subscription;
            self.changed |= bit;
        }
    }

    /// Returns the subscription to the value that this command asks for.
    pub(crate) fn find(&self, name: <S::Request as Message>::Name) -> Option<S> {
        self.all.iter().find(|slot| slot.name() == name).copied()
    }

    /// Returns the `n`th of those that are asked for again and again.
    pub(crate) fn nth(&self, n: u8) -> Option<S> {
        self.all.iter().filter(|slot| slot.is_wanted()).nth(n.into()).copied()
    }
}

impl<S: Subscription, const N: usize> List for Subscriptions<S, N> {
    type Request = S::Request;

    fn wants(&self, name: <S::Request as Message>::Name) -> bool {
        self.find(name).is_some_and(|slot| slot.is_wanted())
    }

    fn changed(&self) -> Option<S::Request> {
        let first = self.changed.trailing_zeros() as usize;
        self.all.get(first).map(S::request)
    }

    fn confirm(&mut self, request: &S::Request) {
        // Unless it was changed again in the meantime.
        if let Some(confirmed) = S::of(request)
            && let Some(place) = self.all.iter().position(|slot| *slot == confirmed)
        {
            self.changed &= !bit(place);
        }
    }
}

/// The bit of the subscription at this place. There are at most eight.
const fn bit(place: usize) -> u8 {
    1_u8.unbounded_shl(place as u32)
}
