//! Virtual time: microseconds that the caller counts.

/// A moment of virtual time, in microseconds since the gripper was switched on.
///
/// ```
/// use wsg_sim::Time;
///
/// let start = Time::from_millis(2);
/// assert_eq!(start.plus_micros(500).as_micros(), 2_500);
/// assert!(start < start.plus_millis(1));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time(u64);

impl Time {
    /// The moment at which the gripper was switched on.
    pub const ZERO: Self = Self(0);

    /// The moment `micros` microseconds after switching on.
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// The moment `millis` milliseconds after switching on.
    #[must_use]
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

    /// Microseconds since switching on.
    #[must_use]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// The moment `micros` microseconds later.
    #[must_use]
    pub const fn plus_micros(self, micros: u64) -> Self {
        Self(self.0.saturating_add(micros))
    }

    /// The moment `millis` milliseconds later.
    #[must_use]
    pub const fn plus_millis(self, millis: u64) -> Self {
        self.plus_micros(millis.saturating_mul(1_000))
    }

    /// The first moment after this one on a grid of `micros` microseconds.
    pub(crate) const fn next_on_grid(self, micros: u64) -> Self {
        Self((self.0 / micros + 1).saturating_mul(micros))
    }
}

/// Returns the earlier of two moments, if there are any.
pub(crate) fn earlier(one: Option<Time>, other: Option<Time>) -> Option<Time> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (moment, None) | (None, moment) => moment,
    }
}

impl core::fmt::Display for Time {
    /// Seconds with microseconds: `12.345678 s`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}.{:06} s", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}
