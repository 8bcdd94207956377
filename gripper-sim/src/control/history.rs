//! Width, speed and force of the last 30 s, for the plot of a page that opens.

use crate::gripper::State;
use crate::time::Time;
use std::collections::VecDeque;

/// Duration of the history in ms.
const WINDOW_MS: u64 = 30_000;
/// Number of samples of the window: one every 50 ms.
const MAX_SAMPLES: usize = 601;

/// Time, width in mm, speed in mm/s, force in N.
pub(crate) type Sample = (Time, f32, f32, f32);

/// The samples, oldest first. A sample stands until the next one: equal values are not repeated.
#[derive(Debug, Default)]
pub(crate) struct History(VecDeque<Sample>);

impl History {
    pub(crate) fn samples(&self) -> Vec<Sample> {
        self.0.iter().copied().collect()
    }

    /// Adds a sample.
    pub(crate) fn record(&mut self, now: Time, state: &State) {
        let rounded = |value: f32| (value * 100.0).round() / 100.0;
        let time = Time::from_micros((now.as_micros() + 5_000) / 10_000 * 10_000);
        self.add((time, rounded(state.width), rounded(state.speed), rounded(state.force)));
    }

    fn add(&mut self, sample: Sample) {
        let Self(samples) = self;
        if samples.back().is_some_and(|last| (sample.0, last.1, last.2, last.3) == sample) {
            return;
        }
        // The latest sample before the window is where its curve begins.
        while samples.get(1).is_some_and(|next| next.0.plus_millis(WINDOW_MS) <= sample.0)
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
        let mut add = |s: u64, width| history.add((Time::from_millis(s * 1_000), width, 0.0, 0.0));
        for s in [0, 1, 2] {
            add(s, 50.0);
        }
        add(10, 60.0);
        add(35, 70.0);
        assert_eq!(history.samples().len(), 3, "the curve begins with the sample at 0 s");
        history.add((Time::from_millis(41_000), 80.0, 0.0, 0.0));
        assert_eq!(history.samples()[0].0, Time::from_millis(10_000));
        for step in 0..2_000u16 {
            history.add((Time::from_millis(42_000), step.into(), 0.0, 0.0));
        }
        assert_eq!(history.samples().len(), MAX_SAMPLES);
    }
}
