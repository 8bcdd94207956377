//! The caller's clock: milliseconds that may wrap.

use core::hash::{Hash, Hasher};
use core::time::Duration;

/// A moment on the caller's millisecond clock.
///
/// The counter may wrap (after 49.7 days for one that starts at 0): moments are compared by their distance, which
/// must stay below 2³¹ ms.
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

/// Hashes as an `i32`, as nothing else in this crate does: a [`Hasher`] that compares states of different ages can tell
/// moments from other numbers and take them relative to its own "now".
impl Hash for Instant {
    fn hash<H: Hasher>(&self, state: &mut H) {
        state.write_i32(self.0.cast_signed());
    }
}

impl Instant {
    /// The moment at which the clock shows `millis`.
    #[must_use]
    pub const fn from_millis(millis: u32) -> Self {
        Self(millis)
    }

    /// What the clock shows at this moment, in milliseconds.
    #[must_use]
    pub const fn as_millis(self) -> u32 {
        self.0
    }

    /// The moment `millis` later.
    #[must_use]
    pub const fn plus(self, millis: u32) -> Self {
        Self(self.0.wrapping_add(millis))
    }

    /// Milliseconds from `earlier` to this moment; 0 when `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> u32 {
        let distance = self.0.wrapping_sub(earlier.0);
        if distance < 1 << 31 { distance } else { 0 }
    }

    /// Whether this moment is at or after `other`.
    #[must_use]
    pub const fn has_reached(self, other: Self) -> bool {
        self.0.wrapping_sub(other.0) < 1 << 31
    }

    /// The earlier of the two.
    #[must_use]
    pub const fn earlier_of(self, other: Self) -> Self {
        if self.has_reached(other) { other } else { self }
    }

    /// The time from this moment to `later`, for a caller that sleeps.
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
