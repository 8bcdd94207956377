//! The commanded position at any time: set-points interpolated, limited in speed and held.

use super::{HORIZON_MS, Rejected};
use crate::time::Instant;
use std::collections::VecDeque;

/// A position in mm and the time at which to reach it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SetPoint {
    position: f32,
    at: Instant,
}

/// The time of a set-point, at most [`HORIZON_MS`] ahead. Only such times are compared, so none of them wraps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ahead(u32);

impl Ahead {
    /// Returns how far `at` is ahead, and 0 for a time in the past. Rejects times beyond the horizon in both
    /// directions: on a clock that wraps, a time far ahead is also one in the past.
    pub(super) const fn of(now: Instant, at: Instant) -> Result<Self, Rejected> {
        let ahead_ms = at.signed_since(now);
        if ahead_ms.unsigned_abs() > HORIZON_MS {
            return Err(Rejected::BeyondHorizon { ahead_ms });
        }
        Ok(Self(if ahead_ms < 0 { 0 } else { ahead_ms.unsigned_abs() }))
    }
}

/// Straight lines between set-points, followed within the speed limit.
///
/// A new line begins at the commanded position, so the position never jumps. After the last set-point the position is
/// held. At every time, the commanded position lies between the one before and the next set-point.
#[derive(Clone, Debug)]
pub(super) struct Trajectory {
    /// The commanded position at the last call.
    here: SetPoint,
    /// The start of the current line.
    from: SetPoint,
    points: VecDeque<SetPoint>,
    /// The maximum number of queued set-points.
    queue_len: usize,
}

impl Trajectory {
    /// Creates a trajectory that holds the position in mm from `now` on.
    pub(super) const fn at(position: f32, now: Instant, queue_len: usize) -> Self {
        let here = SetPoint { position, at: now };
        Self { here, from: here, points: VecDeque::new(), queue_len }
    }

    /// Moves to the position at the speed limit and discards all set-points.
    pub(super) fn set_target(&mut self, now: Instant, position: f32, speed_limit: f32) {
        self.advance(now, speed_limit);
        self.points.clear();
        self.from = SetPoint { position, at: now };
    }

    /// Adds a set-point and replaces all at the same or a later time. One in the past becomes a target.
    ///
    /// # Errors
    /// [`Rejected::Full`], and nothing changes.
    pub(super) fn schedule(
        &mut self,
        now: Instant,
        position: f32,
        ahead: Ahead,
        speed_limit: f32,
    ) -> Result<(), Rejected> {
        let Ahead(ahead_ms @ 1..) = ahead else {
            self.set_target(now, position, speed_limit);
            return Ok(());
        };
        let at = now.plus(ahead_ms);
        self.advance(now, speed_limit);
        let earlier = self.points.partition_point(|point| at.signed_since(point.at) > 0);
        if earlier >= self.queue_len {
            return Err(Rejected::Full { queue_len: self.queue_len });
        }
        self.points.truncate(earlier);
        self.points.push_back(SetPoint { position, at });
        self.from = self.here;
        Ok(())
    }

    /// Advances the time and returns the position to command at `now`, in mm. The speed limit is in mm/s.
    pub(super) fn advance(&mut self, now: Instant, speed_limit: f32) -> f32 {
        while let Some(next) = self.points.front().copied().filter(|next| now.has_reached(next.at)) {
            self.from = next;
            self.points.pop_front();
        }
        self.here = SetPoint { position: self.position_at(now, speed_limit), at: now };
        self.here.position
    }

    /// Returns the position to command at `moment`, now or in the future, if nothing changes.
    pub(super) fn position_at(&self, moment: Instant, speed_limit: f32) -> f32 {
        let (mut from, mut next) = (self.from, None);
        for point in &self.points {
            if !moment.has_reached(point.at) {
                next = Some(*point);
                break;
            }
            from = *point;
        }
        let wanted = next.map_or(from.position, |next| {
            // The time since the start of the line never exceeds its duration, so the part is at most 1.
            let whole = next.at.since(from.at).max(1);
            let part = moment.since(from.at).min(whole) as f32 / whole as f32;
            let (least, greatest) = (from.position.min(next.position), from.position.max(next.position));
            (from.position + (next.position - from.position) * part).max(least).min(greatest)
        });
        let reach = speed_limit * moment.since(self.here.at) as f32 / 1_000.0;
        let here = self.here.position;
        // Not `here + way`, which may round beyond the wanted position.
        wanted.max(here - reach).min(here + reach)
    }

    /// Continues after a gap from the last `ordered` position to the next set-point, or else to the last one. Begins at
    /// `here`, the measured position, if the fingers are already further on this way. The time of the gap gives no reach, so
    /// the position does not jump after it.
    pub(super) fn resume(&mut self, now: Instant, ordered: f32, here: f32) {
        while let Some(missed) = self.points.front().copied().filter(|next| now.has_reached(next.at)) {
            self.from = missed;
            self.points.pop_front();
        }
        let goal = self.points.front().unwrap_or(&self.from).position;
        let is_further = ordered.min(goal) <= here && here <= ordered.max(goal);
        self.here = SetPoint { position: if is_further { here } else { ordered }, at: now };
        if !self.points.is_empty() {
            self.from = self.here;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Near the end of the clock's range, so that every test also covers wrapping.
    const BEGIN: Instant = Instant::from_millis(u32::MAX - 50);
    const FAST: f32 = 10_000.0;
    const QUEUE_LEN: usize = 64;

    fn after(ms: u32) -> Instant {
        BEGIN.plus(ms)
    }

    fn at(position: f32) -> Trajectory {
        Trajectory::at(position, BEGIN, QUEUE_LEN)
    }

    impl Trajectory {
        /// Schedules a position `at_ms` after the beginning.
        fn schedule_at(
            &mut self,
            now: Instant,
            position: f32,
            at_ms: u32,
            limit: f32,
        ) -> Result<(), Rejected> {
            self.schedule(now, position, Ahead::of(now, after(at_ms))?, limit)
        }
    }

    #[test]
    fn set_points_are_joined_by_straight_lines_and_the_last_is_held() {
        let mut trajectory = at(10.0);
        trajectory.schedule_at(BEGIN, 20.0, 100, FAST).unwrap();
        trajectory.schedule_at(BEGIN, 16.0, 200, FAST).unwrap();
        let way: Vec<f32> = [0, 50, 100, 150, 200, 60_000]
            .into_iter()
            .map(|ms| trajectory.advance(after(ms), FAST))
            .collect();
        assert_eq!(way, [10.0, 15.0, 20.0, 18.0, 16.0, 16.0]);
    }

    #[test]
    fn later_set_point_replaces_what_follows_it_without_a_jump() {
        let mut trajectory = at(0.0);
        trajectory.schedule_at(BEGIN, 10.0, 100, FAST).unwrap();
        trajectory.schedule_at(BEGIN, 50.0, 200, FAST).unwrap();
        assert_eq!(trajectory.advance(after(50), FAST), 5.0);
        trajectory.schedule_at(after(50), 9.0, 90, FAST).unwrap();
        assert_eq!(trajectory.advance(after(50), FAST), 5.0);
        assert_eq!(trajectory.advance(after(70), FAST), 7.0);
        assert_eq!(trajectory.advance(after(150), FAST), 9.0);
    }

    #[test]
    fn speed_limit_holds_for_targets_and_for_set_points() {
        let mut trajectory = at(0.0);
        trajectory.set_target(BEGIN, 50.0, 20.0);
        assert_eq!(trajectory.advance(after(100), 20.0), 2.0);
        trajectory.schedule_at(after(100), 22.0, 200, 20.0).unwrap();
        assert_eq!(trajectory.advance(after(200), 20.0), 4.0);
        assert_eq!(trajectory.advance(after(2_000), 20.0), 22.0);
    }

    #[test]
    fn set_point_in_the_past_is_a_target() {
        for past_ms in [0, 5, HORIZON_MS] {
            let mut trajectory = at(0.0);
            trajectory.schedule_at(BEGIN, 80.0, 100, FAST).unwrap();
            let now = after(10);
            let past = Ahead::of(now, now.plus(past_ms.wrapping_neg())).unwrap();
            trajectory.schedule(now, 10.0, past, 100.0).unwrap();
            assert_eq!(trajectory.advance(after(20), 100.0), 2.0);
            assert_eq!(trajectory.advance(after(500), 100.0), 10.0);
        }
    }

    #[test]
    fn time_beyond_the_horizon_is_rejected_in_both_directions() {
        for now in [0, 50, u32::MAX, 1 << 31].map(Instant::from_millis) {
            for ahead_ms in [0, 1, 500, HORIZON_MS.cast_signed()] {
                assert_eq!(Ahead::of(now, now.plus(ahead_ms as u32)), Ok(Ahead(ahead_ms as u32)));
                assert_eq!(Ahead::of(now, now.plus(-ahead_ms as u32)).unwrap().0, 0);
            }
            // The last three are 500 ms in units of another kind, modulo 2^32.
            let beyond =
                [HORIZON_MS + 1, (1 << 31) - 1, 1 << 31, (1 << 31) + 1, HORIZON_MS.wrapping_neg() - 1];
            for ahead_ms in beyond.into_iter().chain([500_000_000, 3_999_999, 500_000_000_000_u64 as u32]) {
                let rejected = Rejected::BeyondHorizon { ahead_ms: ahead_ms as i32 };
                assert_eq!(Ahead::of(now, now.plus(ahead_ms)), Err(rejected));
            }
        }
    }

    /// Distances that span the range of the clock, with each edge of a comparison that wraps.
    fn distances() -> impl Iterator<Item = u32> {
        let edges = [0, 1, 2, 500, HORIZON_MS, (1 << 31) - 1, 1 << 31, (1 << 31) + 1, u32::MAX - 500];
        edges.into_iter().chain((0..32).map(|bit| 3 << bit)).chain([u32::MAX])
    }

    #[test]
    fn no_time_leads_out_of_the_interval_between_two_set_points() {
        let starts = [0, 50, (1 << 31) - 1, 1 << 31, u32::MAX - 50];
        for begin in starts.map(Instant::from_millis) {
            for (start, end) in [(70.0, 72.0), (70.0, 40.0), (0.1, 110.0)] {
                for duration_ms in distances() {
                    // Not even a time that no caller can pass.
                    let mut trajectory = Trajectory::at(start, begin, QUEUE_LEN);
                    trajectory.schedule(begin, end, Ahead(duration_ms), FAST).unwrap();
                    for later_ms in distances() {
                        for limit in [5.0, FAST, f32::INFINITY] {
                            let mut trajectory = trajectory.clone();
                            let now = begin.plus(later_ms);
                            let (ahead, here) =
                                (trajectory.position_at(now, limit), trajectory.advance(now, limit));
                            let next = trajectory.advance(now.plus(1), limit);
                            let (least, greatest) = (start.min(end), start.max(end));
                            for position in [ahead, here, next] {
                                assert!(
                                    (least..=greatest).contains(&position),
                                    "{start} to {end} mm in {duration_ms} ms, after {later_ms} ms: {position} mm"
                                );
                            }
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn position_ahead_is_the_one_that_is_reached() {
        let mut trajectory = at(10.0);
        for (position, at_ms) in [(20.0, 100), (16.0, 200), (30.0, 210)] {
            trajectory.schedule_at(BEGIN, position, at_ms, FAST).unwrap();
        }
        for limit in [50.0, FAST] {
            for ms in [0, 50, 100, 150, 205, 300] {
                assert_eq!(
                    trajectory.position_at(after(ms), limit),
                    trajectory.clone().advance(after(ms), limit)
                );
            }
        }
    }

    #[test]
    fn after_a_gap_the_path_continues_from_where_the_fingers_held() {
        for (points, resumed_ms, later) in [
            // To the next set-point.
            (&[(20.0, 100), (40.0, 600)][..], 400, [(400, 0.0), (500, 20.0), (600, 40.0), (700, 40.0)]),
            // To the last one, within the speed limit.
            (&[(20.0, 100), (40.0, 200)], 400, [(400, 0.0), (500, 10.0), (600, 20.0), (900, 40.0)]),
            (&[], 400, [(400, 0.0), (500, 0.0), (600, 0.0), (900, 0.0)]),
        ] {
            let limit = if points.last() == Some(&(40.0, 600)) { FAST } else { 100.0 };
            let mut trajectory = at(0.0);
            for (position, at_ms) in points {
                trajectory.schedule_at(BEGIN, *position, *at_ms, limit).unwrap();
            }
            trajectory.advance(after(390), limit);
            trajectory.resume(after(resumed_ms), 0.0, 0.0);
            for (ms, position) in later {
                let reached = trajectory.advance(after(ms), limit);
                assert!((reached - position).abs() < 1e-3, "{points:?} at {ms} ms: {reached} mm");
            }
        }
    }

    #[test]
    fn set_point_without_room_is_rejected_and_changes_nothing() {
        for queue_len in [1, QUEUE_LEN, 4_096] {
            let mut trajectory = Trajectory::at(0.0, BEGIN, queue_len);
            for ms in 1..=queue_len as u32 {
                trajectory.schedule_at(BEGIN, 1.0, ms, FAST).unwrap();
            }
            assert_eq!(trajectory.schedule_at(BEGIN, 5.0, 5_000, FAST), Err(Rejected::Full { queue_len }));
            // It replaces the last one.
            trajectory.schedule_at(BEGIN, 2.0, queue_len as u32, FAST).unwrap();
            assert_eq!(trajectory.advance(after(5_000), FAST), 2.0);
        }
    }
}
