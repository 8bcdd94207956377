//! Width, speed and force of the last 30 s, for the plot of a page that opens.

use crate::gripper::State;
use crate::time::Time;
use std::collections::VecDeque;

/// Duration of the history in seconds.
pub(crate) const WINDOW_S: f64 = 30.0;
/// Number of samples of the window: one every 50 ms.
const MAX_SAMPLES: usize = 601;

/// Time in s, width in mm, speed in mm/s, force in N.
pub(crate) type Sample = [f64; 4];

/// The samples, oldest first. A sample stands until the next one: equal values are not repeated.
#[derive(Debug, Default)]
pub(crate) struct History(VecDeque<Sample>);

impl History {
    pub(crate) fn samples(&self) -> Vec<Sample> {
        self.0.iter().copied().collect()
    }

    /// Adds a sample.
    pub(crate) fn record(&mut self, now: Time, state: &State) {
        let rounded = |value: f32| (f64::from(value) * 100.0).round() / 100.0;
        let time_s = (now.as_micros() as f64 / 1e4).round() / 100.0;
        self.add([time_s, rounded(state.width), rounded(state.speed), rounded(state.force)]);
    }

    fn add(&mut self, sample: Sample) {
        let Self(samples) = self;
        if samples.back().is_some_and(|last| last[1..] == sample[1..]) {
            return;
        }
        // The latest sample before the window is where its curve begins.
        while samples.get(1).is_some_and(|next| next[0] <= sample[0] - WINDOW_S)
            || samples.len() >= MAX_SAMPLES
        {
            samples.pop_front();
        }
        samples.push_back(sample);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn history_holds_the_changes_of_its_window_and_the_value_before() {
        let mut history = History::default();
        for time_s in [0.0, 1.0, 2.0] {
            history.add([time_s, 50.0, 0.0, 0.0]);
        }
        assert_eq!(history.samples(), [[0.0, 50.0, 0.0, 0.0]]);
        history.add([10.0, 60.0, 0.0, 0.0]);
        history.add([35.0, 70.0, 0.0, 0.0]);
        assert_eq!(history.samples().len(), 3, "the curve begins with the sample at 0 s");
        history.add([41.0, 80.0, 0.0, 0.0]);
        assert_eq!(history.samples()[0][0], 10.0);
        for step in 0..2_000 {
            history.add([42.0, f64::from(step), 0.0, 0.0]);
        }
        assert_eq!(history.samples().len(), MAX_SAMPLES);
    }
}
