//! Subscriptions to values.

use super::message::Message;

/// A value that a gripper can send periodically, and its update settings.
pub trait Subscription: Copy + PartialEq {
    /// The dialect's request type.
    type Request: Message;

    /// Returns the name of the command that queries the value.
    fn name(&self) -> <Self::Request as Message>::Name;

    /// Returns whether the value is polled. The session always polls the two states, with or without updates.
    fn is_wanted(&self) -> bool;

    /// Returns the request that starts or ends the subscription.
    fn request(&self) -> Self::Request;

    /// Returns the subscription that a request starts or ends, if any.
    fn of(request: &Self::Request) -> Option<Self>;
}

/// All possible subscriptions of a dialect, and which of them the gripper has yet to confirm.
#[derive(Clone, Debug, Hash)]
pub struct Subscriptions<S, const N: usize> {
    all: [S; N],
    /// Bit mask of the subscriptions that were changed while connected and are not confirmed yet.
    changed: u8,
}

/// [`Subscriptions`] for any number of values.
pub trait List {
    /// The dialect's request type.
    type Request: Message;

    /// Returns whether the value of this name is polled.
    fn wants(&self, name: <Self::Request as Message>::Name) -> bool;

    /// Returns the request for a changed subscription, if any.
    fn changed(&self) -> Option<Self::Request>;

    /// Records that the gripper has answered this request.
    fn confirm(&mut self, request: &Self::Request);
}

impl<S: Subscription, const N: usize> Subscriptions<S, N> {
    pub(crate) const fn new(all: [S; N]) -> Self {
        const { assert!(N <= u8::BITS as usize, "at most 8 subscriptions, one bit each") }
        Self { all, changed: 0 }
    }

    /// Replaces the subscription to the same value and marks it as changed.
    pub(crate) fn set(&mut self, subscription: S) {
        let of = self.all.iter().position(|slot| slot.name() == subscription.name());
        if let Some((slot, bit)) = of.and_then(|place| Some((self.all.get_mut(place)?, bit(place)))) {
            *slot = subscription;
            self.changed |= bit;
        }
    }

    /// Returns the subscription to the value that this command queries.
    pub(crate) fn find(&self, name: <S::Request as Message>::Name) -> Option<S> {
        self.all.iter().find(|slot| slot.name() == name).copied()
    }

    /// Returns the `n`th polled subscription.
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
        // Not confirmed if it was changed again in the meantime.
        if let Some(confirmed) = S::of(request)
            && let Some(place) = self.all.iter().position(|slot| *slot == confirmed)
        {
            self.changed &= !bit(place);
        }
    }
}

/// Returns the bit mask of the subscription at this index (at most 7).
const fn bit(place: usize) -> u8 {
    1_u8.unbounded_shl(place as u32)
}
