//! The caller's millisecond clock, which may wrap.

use core::hash::{Hash, Hasher};
use core::time::Duration;

/// A point in time on the caller's millisecond clock.
///
/// The counter may wrap (after 49.7 days if it starts at 0). Instants are compared by their distance, which must be
/// less than 2³¹ ms.
///
/// ```
/// use wsg_protocol::Instant;
///
/// let before = Instant::from_millis(u32::MAX);
/// let after = before.plus(5);
/// assert!(after.has_reached(before) && !before.has_reached(after));
/// assert_eq!(after.since(before), 5);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct Instant(u32);

/// Hashes as an `i32`, which is unique in this crate. A [`Hasher`] that compares states of different ages can thus
/// recognize instants and make them relative to its own "now".
impl Hash for Instant {
    fn hash<H: Hasher>(&self, state: &mut H) {
        state.write_i32(self.0.cast_signed());
    }
}

impl Instant {
    /// Greatest [`age`](Self::age): 12 days, in milliseconds.
    pub const MAX_AGE_MS: u32 = 1 << 30;

    /// Creates the instant at which the clock shows `millis`.
    #[must_use]
    pub const fn from_millis(millis: u32) -> Self {
        Self(millis)
    }

    /// Returns the clock value at this instant, in milliseconds.
    #[must_use]
    pub const fn as_millis(self) -> u32 {
        self.0
    }

    /// Returns the instant `millis` milliseconds later, but at most 2³¹ - 1, so that it is later.
    #[must_use]
    pub const fn plus_at_most(self, millis: u32) -> Self {
        self.plus(if millis < 1 << 31 { millis } else { (1 << 31) - 1 })
    }

    /// Returns the instant `millis` milliseconds later.
    #[must_use]
    pub const fn plus(self, millis: u32) -> Self {
        Self(self.0.wrapping_add(millis))
    }

    /// Returns the milliseconds from `earlier` to this instant, or 0 if `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> u32 {
        let distance = self.0.wrapping_sub(earlier.0);
        if distance < 1 << 31 { distance } else { 0 }
    }

    /// Returns the milliseconds from `other` to this instant, negative if this instant is earlier.
    ///
    /// Use it for a time from outside the program, and reject a distance beyond a horizon. At a distance of exactly
    /// 2³¹ ms, which returns `i32::MIN`, neither instant is the later one.
    #[must_use]
    pub const fn signed_since(self, other: Self) -> i32 {
        self.0.wrapping_sub(other.0).cast_signed()
    }

    /// Returns the milliseconds from this instant to `now`, at most [`MAX_AGE_MS`](Self::MAX_AGE_MS). From then on, this
    /// instant follows the clock at that distance, if the call is repeated at least once in 12 days.
    ///
    /// Use it for the time of an event that may be compared for longer than 24 days. With [`since`](Self::since) it would
    /// then seem recent again.
    pub const fn age(&mut self, now: Self) -> u32 {
        let age_ms = now.since(*self);
        if age_ms <= Self::MAX_AGE_MS {
            return age_ms;
        }
        *self = now.plus(Self::MAX_AGE_MS.wrapping_neg());
        Self::MAX_AGE_MS
    }

    /// Returns whether this instant is at or after `other`.
    #[must_use]
    pub const fn has_reached(self, other: Self) -> bool {
        self.0.wrapping_sub(other.0) < 1 << 31
    }

    /// Returns the earlier of two instants.
    #[must_use]
    pub const fn earlier_of(self, other: Self) -> Self {
        if self.has_reached(other) { other } else { self }
    }

    /// Returns the time from this instant to `later`, for a caller that sleeps.
    #[must_use]
    pub const fn until(self, later: Self) -> Duration {
        Duration::from_millis(later.since(self) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_compare_by_distance_wherever_the_clock_wraps() {
        for begin in [0, 5, u32::MAX - 2, 1 << 31] {
            let before = Instant::from_millis(begin);
            for distance in [1, 1_000, (1 << 31) - 1] {
                let after = before.plus(distance);
                assert_eq!(after.as_millis(), begin.wrapping_add(distance));
                assert!(after.has_reached(before) && !before.has_reached(after));
                assert_eq!((after.since(before), before.since(after)), (distance, 0));
                let signed = distance.cast_signed();
                assert_eq!((after.signed_since(before), before.signed_since(after)), (signed, -signed));
                assert_eq!((before.earlier_of(after), after.earlier_of(before)), (before, before));
                assert_eq!(before.until(after), Duration::from_millis(distance.into()));
                assert_eq!(after.until(before), Duration::ZERO);
            }
            assert!(before.has_reached(before));
        }
    }

    #[test]
    fn longest_wait_ends_later() {
        let now = Instant::from_millis(u32::MAX - 2);
        for millis in [(1 << 31) - 1, 1 << 31, u32::MAX] {
            assert_eq!(now.plus_at_most(millis).since(now), (1 << 31) - 1);
        }
        assert_eq!(now.plus_at_most(5), now.plus(5));
    }

    #[test]
    fn age_never_wraps() {
        for begin in [0, u32::MAX - 2].map(Instant::from_millis) {
            let mut at = begin;
            assert_eq!(at.age(begin.plus(5)), 5);
            assert_eq!(at.age(begin.plus(Instant::MAX_AGE_MS)), Instant::MAX_AGE_MS);
            assert_eq!(at, begin);
            for days in 13..100_u32 {
                assert_eq!(at.age(begin.plus(days.wrapping_mul(86_400_000))), Instant::MAX_AGE_MS, "{days}");
            }
        }
    }

    #[test]
    fn at_half_a_turn_of_the_clock_neither_instant_is_the_later_one() {
        for begin in [0, 5, u32::MAX - 2, 1 << 31] {
            let (one, other) = (Instant::from_millis(begin), Instant::from_millis(begin).plus(1 << 31));
            for (one, other) in [(one, other), (other, one)] {
                assert!(!one.has_reached(other));
                assert_eq!((one.since(other), one.signed_since(other)), (0, i32::MIN));
            }
        }
    }
}
