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
    fn moments_are_compared_by_their_distance_wherever_the_clock_wraps() {
        for begin in [0, 5, u32::MAX - 2, 1 << 31] {
            let before = Instant::from_millis(begin);
            for distance in [1, 1_000, (1 << 31) - 1] {
                let after = before.plus(distance);
                assert_eq!(after.as_millis(), begin.wrapping_add(distance));
                assert!(after.has_reached(before) && !before.has_reached(after));
                assert_eq!((after.since(before), before.since(after)), (distance, 0));
                assert_eq!((before.earlier_of(after), after.earlier_of(before)), (before, before));
                assert_eq!(before.until(after), Duration::from_millis(distance.into()));
                assert_eq!(after.until(before), Duration::ZERO);
            }
            assert!(before.has_reached(before));
        }
    }
}
