//! The start times of the periods.

use crate::time::Instant;

const SECOND_MS: u32 = 1_000;

/// Periods of a fixed rate, counted from a common start so that fractions of a millisecond do not accumulate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    rate_hz: u32,
    /// Start of the period from which `count` periods are counted.
    begin: Instant,
    count: u32,
}

impl Pace {
    /// Creates a pace whose first period begins now. The rate is clamped to 1 to 500 per second.
    pub(super) fn new(rate_hz: u16, now: Instant) -> Self {
        Self { rate_hz: rate_hz.clamp(1, 500).into(), begin: now, count: 0 }
    }

    /// Returns the start of the next period, or now if a whole period was missed. Missed periods are skipped.
    pub(super) fn next(&mut self, now: Instant) -> Instant {
        if self.count >= self.rate_hz {
            (self.begin, self.count) = (self.begin.plus(SECOND_MS), 0);
        }
        self.count = self.count.saturating_add(1);
        let due = self.begin.plus(self.part_of_a_second(self.count));
        if now.since(due) < self.part_of_a_second(1) {
            return due;
        }
        (self.begin, self.count) = (now, 0);
        now
    }

    /// Returns the duration of this number of periods in ms.
    fn part_of_a_second(&self, periods: u32) -> u32 {
        periods.saturating_mul(SECOND_MS).checked_div(self.rate_hz).unwrap_or(SECOND_MS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const BEGIN: Instant = Instant::from_millis(u32::MAX - 50);

    #[test]
    fn periods_of_a_fraction_of_a_millisecond_do_not_drift() {
        let mut pace = Pace::new(30, BEGIN);
        let periods: Vec<Instant> = (0..90).map(|_| pace.next(BEGIN)).collect();
        assert_eq!(periods[..3], [33, 66, 100].map(|ms| BEGIN.plus(ms)));
        assert_eq!(periods[89], BEGIN.plus(3_000));
    }

    #[test]
    fn period_is_missed_when_the_next_one_is_due() {
        for (late_ms, due_ms) in [(9, 10), (10, 20)] {
            let mut pace = Pace::new(100, BEGIN);
            assert_eq!(pace.next(BEGIN.plus(10 + late_ms)), BEGIN.plus(due_ms));
        }
    }

    #[test]
    fn late_period_keeps_the_pace_and_missed_ones_are_skipped() {
        let mut pace = Pace::new(100, BEGIN);
        assert_eq!(pace.next(BEGIN.plus(4)), BEGIN.plus(10));
        assert_eq!(pace.next(BEGIN.plus(29)), BEGIN.plus(20));
        assert_eq!(pace.next(BEGIN.plus(29)), BEGIN.plus(30));
        assert_eq!(pace.next(BEGIN.plus(75)), BEGIN.plus(75));
        assert_eq!(pace.next(BEGIN.plus(76)), BEGIN.plus(85));
    }
}
