//! The commanded position at any time: set-points interpolated, limited in speed and held.

use crate::time::Instant;
use heapless::Deque;

/// Maximum number of queued set-points.
pub const MAX_SET_POINTS: usize = 64;

/// A position in mm and the time at which to reach it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SetPoint {
    position: f32,
    at: Instant,
}

/// Straight lines between set-points, followed within the speed limit.
///
/// A new line begins at the commanded position, so the position never jumps. After the last set-point the position is
/// held.
#[derive(Clone, Debug)]
pub(super) struct Trajectory {
    /// The commanded position at the last call.
    here: SetPoint,
    /// The start of the current line.
    from: SetPoint,
    points: Deque<SetPoint, MAX_SET_POINTS>,
}

impl Trajectory {
    /// Creates a trajectory that holds the position in mm from `now` on.
    pub(super) const fn at(position: f32, now: Instant) -> Self {
        let here = SetPoint { position, at: now };
        Self { here, from: here, points: Deque::new() }
    }

    /// Moves to the position at the speed limit and discards all set-points.
    pub(super) fn set_target(&mut self, now: Instant, position: f32, speed_limit: f32) {
        self.advance(now, speed_limit);
        self.points.clear();
        self.from = SetPoint { position, at: now };
    }

    /// Adds a set-point and replaces all at the same or a later time. One in the past becomes a target. Returns `false`
    /// and changes nothing if [`MAX_SET_POINTS`] earlier ones are queued.
    pub(super) fn schedule(&mut self, now: Instant, position: f32, at: Instant, speed_limit: f32) -> bool {
        if now.has_reached(at) {
            self.set_target(now, position, speed_limit);
            return true;
        }
        self.advance(now, speed_limit);
        while self.points.back().is_some_and(|last| last.at.has_reached(at)) {
            self.points.pop_back();
        }
        if self.points.push_back(SetPoint { position, at }).is_err() {
            return false;
        }
        self.from = self.here;
        true
    }

    /// Advances the time and returns the position to command at `now`, in mm. The speed limit is in mm/s.
    pub(super) fn advance(&mut self, now: Instant, speed_limit: f32) -> f32 {
        while let Some(next) = self.points.front().copied().filter(|next| now.has_reached(next.at)) {
            self.from = next;
            self.points.pop_front();
        }
        let wanted = self.points.front().map_or(self.from.position, |next| {
            let part = now.since(self.from.at) as f32 / next.at.since(self.from.at).max(1) as f32;
            self.from.position + (next.position - self.from.position) * part
        });
        let reach = speed_limit * now.since(self.here.at) as f32 / 1_000.0;
        let way = (wanted - self.here.position).max(-reach).min(reach);
        self.here = SetPoint { position: self.here.position + way, at: now };
        self.here.position
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Near the end of the clock's range, so that every test also covers wrapping.
    const BEGIN: Instant = Instant::from_millis(u32::MAX - 50);
    const FAST: f32 = 10_000.0;

    fn after(ms: u32) -> Instant {
        BEGIN.plus(ms)
    }

    #[test]
    fn set_points_are_joined_by_straight_lines_and_the_last_is_held() {
        let mut trajectory = Trajectory::at(10.0, BEGIN);
        assert!(trajectory.schedule(BEGIN, 20.0, after(100), FAST));
        assert!(trajectory.schedule(BEGIN, 16.0, after(200), FAST));
        let way: Vec<f32> = [0, 50, 100, 150, 200, 60_000]
            .into_iter()
            .map(|ms| trajectory.advance(after(ms), FAST))
            .collect();
        assert_eq!(way, [10.0, 15.0, 20.0, 18.0, 16.0, 16.0]);
    }

    #[test]
    fn later_set_point_replaces_what_follows_it_without_a_jump() {
        let mut trajectory = Trajectory::at(0.0, BEGIN);
        trajectory.schedule(BEGIN, 10.0, after(100), FAST);
        trajectory.schedule(BEGIN, 50.0, after(200), FAST);
        assert_eq!(trajectory.advance(after(50), FAST), 5.0);
        trajectory.schedule(after(50), 9.0, after(90), FAST);
        assert_eq!(trajectory.advance(after(50), FAST), 5.0);
        assert_eq!(trajectory.advance(after(70), FAST), 7.0);
        assert_eq!(trajectory.advance(after(150), FAST), 9.0);
    }

    #[test]
    fn speed_limit_holds_for_targets_and_for_set_points() {
        let mut trajectory = Trajectory::at(0.0, BEGIN);
        trajectory.set_target(BEGIN, 50.0, 20.0);
        assert_eq!(trajectory.advance(after(100), 20.0), 2.0);
        trajectory.schedule(after(100), 22.0, after(200), 20.0);
        assert_eq!(trajectory.advance(after(200), 20.0), 4.0);
        assert_eq!(trajectory.advance(after(2_000), 20.0), 22.0);
    }

    #[test]
    fn set_point_in_the_past_is_a_target() {
        let mut trajectory = Trajectory::at(0.0, BEGIN);
        trajectory.schedule(BEGIN, 80.0, after(100), FAST);
        assert!(trajectory.schedule(after(10), 10.0, after(5), 100.0));
        assert_eq!(trajectory.advance(after(20), 100.0), 2.0);
        assert_eq!(trajectory.advance(after(500), 100.0), 10.0);
    }

    #[test]
    fn set_point_without_room_is_rejected_and_changes_nothing() {
        let mut trajectory = Trajectory::at(0.0, BEGIN);
        for ms in 1..=MAX_SET_POINTS as u32 {
            assert!(trajectory.schedule(BEGIN, 1.0, after(ms), FAST));
        }
        assert!(!trajectory.schedule(BEGIN, 5.0, after(500), FAST));
        assert_eq!(trajectory.advance(after(500), FAST), 1.0);
    }
}
