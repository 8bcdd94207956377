//! Latency of the line and offset of the gripper's clock, estimated from requests and their replies.

use crate::time::Instant;
use heapless::Deque;

/// Number of exchanges in the estimate.
const WINDOW: usize = 64;

/// A request and its reply.
#[derive(Clone, Copy, Debug)]
struct Exchange {
    round_trip_ms: u32,
    offset_ms: Option<u32>,
}

/// Latency and clock offset, estimated from the last 64 exchanges.
///
/// The estimate uses the exchange with the shortest round trip, because its two directions differ least.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineEstimate {
    /// Half of the shortest round trip, in ms.
    pub latency_ms: f32,
    /// The mean round trip, in ms, which is the shortest period that the line allows.
    pub round_trip_ms: f32,
    /// The gripper's clock minus the driver's, in ms modulo 2³². `None` if the back-end reports no time.
    pub clock_offset_ms: Option<u32>,
}

/// The most recent exchanges.
#[derive(Clone, Debug, Default)]
pub(super) struct Exchanges(Deque<Exchange, WINDOW>);

impl Exchanges {
    /// Adds an exchange. `measured_ms` is the gripper's time in the reply.
    pub(super) fn add(&mut self, sent: Instant, received: Instant, measured_ms: Option<u32>) {
        let round_trip_ms = received.since(sent);
        let middle = sent.plus(round_trip_ms / 2).as_millis();
        let offset_ms = measured_ms.map(|measured| measured.wrapping_sub(middle));
        if self.0.is_full() {
            self.0.pop_front();
        }
        // The queue has room: the oldest exchange was removed.
        let _ = self.0.push_back(Exchange { round_trip_ms, offset_ms });
    }

    pub(super) fn estimate(&self) -> LineEstimate {
        let Some(best) = self.0.iter().min_by_key(|exchange| exchange.round_trip_ms) else {
            return LineEstimate::default();
        };
        let sum: u32 = self.0.iter().map(|exchange| exchange.round_trip_ms).sum();
        LineEstimate {
            latency_ms: best.round_trip_ms as f32 / 2.0,
            round_trip_ms: sum as f32 / self.0.len() as f32,
            clock_offset_ms: best.offset_ms,
        }
    }
}

impl LineEstimate {
    /// Returns the driver's time of a measurement, from the gripper's clock or from `received` minus the latency.
    pub(super) fn measured_at(&self, received: Instant, measured_ms: Option<u32>) -> Instant {
        match (measured_ms, self.clock_offset_ms) {
            // The offset is accurate to half of a round trip.
            (Some(measured), Some(offset)) => {
                Instant::from_millis(measured.wrapping_sub(offset)).earlier_of(received)
            }
            _ => received.plus((self.latency_ms as u32).wrapping_neg()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEGIN: Instant = Instant::from_millis(u32::MAX - 50);
    /// The gripper's clock minus the driver's, in ms.
    const OFFSET: u32 = 5_000;

    /// Adds a request that takes `there` ms with a reply that takes `back` ms.
    fn exchange(exchanges: &mut Exchanges, sent: Instant, there: u32, back: u32) {
        let measured = sent.plus(there).as_millis().wrapping_add(OFFSET);
        exchanges.add(sent, sent.plus(there + back), Some(measured));
    }

    #[test]
    fn estimate_follows_the_shortest_round_trip() {
        let mut exchanges = Exchanges::default();
        for at in 0..20 {
            exchange(&mut exchanges, BEGIN.plus(at * 10), 22, 22 + at);
        }
        let estimate = exchanges.estimate();
        assert_eq!((estimate.latency_ms, estimate.clock_offset_ms), (22.0, Some(OFFSET)));
        assert_eq!(estimate.round_trip_ms, 44.0 + 9.5);
        let measured = BEGIN.plus(7).as_millis().wrapping_add(OFFSET);
        assert_eq!(estimate.measured_at(BEGIN.plus(90), Some(measured)), BEGIN.plus(7));
    }

    #[test]
    fn old_exchanges_no_longer_count() {
        let mut exchanges = Exchanges::default();
        exchange(&mut exchanges, BEGIN, 1, 1);
        for at in 1..=WINDOW as u32 {
            exchange(&mut exchanges, BEGIN.plus(at * 20), 8, 8);
        }
        assert_eq!(exchanges.estimate().latency_ms, 8.0);
    }

    #[test]
    fn without_the_grippers_time_the_latency_dates_a_measurement() {
        let mut exchanges = Exchanges::default();
        assert_eq!(exchanges.estimate(), LineEstimate::default());
        exchanges.add(BEGIN, BEGIN.plus(44), None);
        let estimate = exchanges.estimate();
        assert_eq!(estimate.clock_offset_ms, None);
        assert_eq!(estimate.measured_at(BEGIN.plus(100), None), BEGIN.plus(78));
    }
}
