//! Debounces the input wires.
//!
//! FAST_STOP_OK falls fast and rises slowly. One low reading takes effect immediately, regardless of the debounce time. The
//! wire counts as high only after an uninterrupted high level. So bounce, a loose wire and noise all lead to a stop.

use crate::io::Inputs;
use wsg_protocol::Instant;

/// Wires of commands and recipes. They settle together, so that a command never takes effect with half of a recipe change.
const COMMAND_GROUP: Inputs = Inputs::GRIP
    .union(Inputs::RELEASE)
    .union(Inputs::MOVE)
    .union(Inputs::HOME)
    .union(Inputs::RECIPE0)
    .union(Inputs::RECIPE1);

/// Groups with separate debounce times, so that a bouncing command wire does not delay a stop.
const GROUPS: [Inputs; 2] = [COMMAND_GROUP, Inputs::STOP_ACK];

/// Minimum high time of FAST_STOP_OK before it counts as high, in milliseconds. A wire that is low once in this time counts
/// as low.
const LEAST_RELEASE_MS: u32 = 5;

const _: () = assert!(
    GROUPS[0].union(GROUPS[1]).union(Inputs::FAST_STOP_OK).bits() == Inputs::all().bits(),
    "each wire must be in a group"
);

/// Debouncer of all input wires.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Debounce {
    period_ms: u32,
    /// Last reading; `None` before the first.
    read: Option<Inputs>,
    /// Start of each group's current reading.
    since: [Instant; GROUPS.len()],
    /// Start of the current high reading of FAST_STOP_OK.
    high_since: Instant,
    /// Wires that have settled at least once, and their debounced levels.
    settled: Inputs,
    levels: Inputs,
}

impl Debounce {
    /// Creates a debouncer with a debounce time of `period_ms` milliseconds. A low FAST_STOP_OK takes effect immediately.
    #[must_use]
    pub(crate) const fn new(period_ms: u32) -> Self {
        Self {
            period_ms,
            read: None,
            since: [Instant::from_millis(0); GROUPS.len()],
            high_since: Instant::from_millis(0),
            settled: Inputs::empty(),
            levels: Inputs::empty(),
        }
    }

    /// Sets the debounce time, from the next reading on.
    pub(crate) const fn set_period(&mut self, period_ms: u32) {
        self.period_ms = period_ms;
    }

    /// Processes a reading. Returns the debounced levels, or `None` until every wire has settled once after power-up.
    pub(crate) fn update(&mut self, now: Instant, reading: Inputs) -> Option<Inputs> {
        let before = self.read.replace(reading);
        let changed = before.map_or(Inputs::all(), |before| before.symmetric_difference(reading));
        for (group, since) in GROUPS.iter().zip(&mut self.since) {
            if changed.intersects(*group) {
                *since = now;
            } else if now.since(*since) >= self.period_ms {
                self.levels = self.levels.difference(*group).union(reading.intersection(*group));
                self.settled |= *group;
            }
        }
        self.update_fast_stop(now, reading, changed);
        self.settled.is_all().then_some(self.levels)
    }

    fn update_fast_stop(&mut self, now: Instant, reading: Inputs, changed: Inputs) {
        const WIRE: Inputs = Inputs::FAST_STOP_OK;
        if !reading.contains(WIRE) {
            self.levels -= WIRE;
            self.settled |= WIRE;
        } else if changed.contains(WIRE) {
            self.high_since = now;
        } else if !self.levels.contains(WIRE)
            && now.since(self.high_since) >= self.period_ms.max(LEAST_RELEASE_MS)
        {
            self.levels |= WIRE;
            self.settled |= WIRE;
        }
    }

    /// Returns whether this wire has settled low, regardless of the other wires.
    #[must_use]
    pub(crate) fn is_settled_low(&self, wire: Inputs) -> bool {
        self.settled.contains(wire) && !self.levels.intersects(wire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u32) -> Instant {
        Instant::from_millis(ms)
    }

    #[test]
    fn levels_are_unknown_until_every_wire_has_settled() {
        let mut debounce = Debounce::new(2);
        for ms in 0..5 {
            assert_eq!(debounce.update(at(ms), Inputs::FAST_STOP_OK), None, "{ms} ms");
        }
        assert_eq!(debounce.update(at(5), Inputs::FAST_STOP_OK), Some(Inputs::FAST_STOP_OK));
    }

    #[test]
    fn low_fast_stop_wire_takes_effect_at_once_at_any_debounce_time() {
        for period_ms in [0, 2, 1_000] {
            let mut debounce = settled(period_ms);
            assert_eq!(debounce.update(at(2_000), Inputs::empty()), Some(Inputs::empty()), "{period_ms} ms");
        }
    }

    #[test]
    fn fast_stop_wire_that_is_high_4_of_every_5_ms_stays_low() {
        let mut debounce = settled(2);
        for ms in 2_000..2_100 {
            let wire = if ms % 5 == 0 { Inputs::empty() } else { Inputs::FAST_STOP_OK };
            assert_eq!(debounce.update(at(ms), wire), Some(Inputs::empty()), "{ms} ms");
        }
    }

    #[test]
    fn rising_fast_stop_wire_is_debounced_for_at_least_5_ms() {
        for (period_ms, release_ms) in [(0, 5), (2, 5), (5, 5), (6, 6), (100, 100)] {
            let mut debounce = settled(period_ms);
            debounce.update(at(2_000), Inputs::empty());
            let high_at = (2_001..3_000)
                .find(|ms| debounce.update(at(*ms), Inputs::FAST_STOP_OK) == Some(Inputs::FAST_STOP_OK));
            assert_eq!(high_at, Some(2_001 + release_ms), "{period_ms} ms");
        }
    }

    /// Returns a debouncer whose wires have settled: FAST_STOP_OK high, all others low.
    fn settled(period_ms: u32) -> Debounce {
        let mut debounce = Debounce::new(period_ms);
        for ms in 0..=1_001 {
            debounce.update(at(ms), Inputs::FAST_STOP_OK);
        }
        debounce
    }

    #[test]
    fn pulse_shorter_than_the_debounce_time_is_ignored() {
        let mut debounce = Debounce::new(2);
        for ms in 0..5 {
            debounce.update(at(ms), Inputs::empty());
        }
        assert_eq!(debounce.update(at(5), Inputs::GRIP), Some(Inputs::empty()));
        assert_eq!(debounce.update(at(6), Inputs::GRIP), Some(Inputs::empty()));
        assert_eq!(debounce.update(at(7), Inputs::empty()), Some(Inputs::empty()));
        assert_eq!(debounce.update(at(9), Inputs::empty()), Some(Inputs::empty()));
    }

    #[test]
    fn recipe_and_command_settle_together_despite_skew() {
        let mut debounce = Debounce::new(2);
        for ms in 0..5 {
            debounce.update(at(ms), Inputs::empty());
        }
        let both = Inputs::GRIP | Inputs::RECIPE0;
        assert_eq!(debounce.update(at(5), Inputs::GRIP), Some(Inputs::empty()));
        for ms in 6..8 {
            assert_eq!(debounce.update(at(ms), both), Some(Inputs::empty()), "{ms} ms");
        }
        assert_eq!(debounce.update(at(8), both), Some(both));
    }

    #[test]
    fn bouncing_command_wire_does_not_delay_a_stop() {
        let mut debounce = Debounce::new(2);
        for ms in 0..5 {
            debounce.update(at(ms), Inputs::FAST_STOP_OK);
        }
        let mut levels = None;
        for ms in 5..9 {
            let chatter = if ms % 2 == 0 { Inputs::GRIP } else { Inputs::empty() };
            levels = debounce.update(at(ms), chatter | Inputs::STOP_ACK);
        }
        assert_eq!(
            levels,
            Some(Inputs::STOP_ACK),
            "FAST STOP wire low and STOP high take effect, GRIP does not"
        );
    }

    #[test]
    fn clock_may_wrap() {
        let mut debounce = Debounce::new(2);
        assert_eq!(debounce.update(at(u32::MAX - 1), Inputs::all()), None);
        assert_eq!(debounce.update(at(2), Inputs::all()), None);
        assert_eq!(debounce.update(at(3), Inputs::all()), Some(Inputs::all()));
    }
}
