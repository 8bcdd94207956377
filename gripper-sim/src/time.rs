//! Virtual time: microseconds counted by the caller.

/// A moment of virtual time, in microseconds since power-up.
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
    /// Power-up of the gripper.
    pub const ZERO: Self = Self(0);

    /// Returns the moment `micros` microseconds after power-up.
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// Returns the moment `millis` milliseconds after power-up.
    #[must_use]
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

    /// Returns the microseconds since power-up.
    #[must_use]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Returns the moment `micros` microseconds later.
    #[must_use]
    pub const fn plus_micros(self, micros: u64) -> Self {
        Self(self.0.saturating_add(micros))
    }

    /// Returns the moment `millis` milliseconds later.
    #[must_use]
    pub const fn plus_millis(self, millis: u64) -> Self {
        self.plus_micros(millis.saturating_mul(1_000))
    }

    /// Returns the first moment after this one on a grid of `micros` microseconds.
    pub(crate) const fn next_on_grid(self, micros: u64) -> Self {
        Self((self.0 / micros + 1).saturating_mul(micros))
    }
}

/// Returns the earlier of two optional moments.
pub(crate) fn earlier(one: Option<Time>, other: Option<Time>) -> Option<Time> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (moment, None) | (None, moment) => moment,
    }
}

impl core::fmt::Display for Time {
    /// Formats the time as seconds with microseconds: `12.345678 s`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}.{:06} s", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}
