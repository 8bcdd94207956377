//! Width, speed and force of the last 30 s, for the plot of a page that opens.

use crate::server::hub::Hub;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;
use tokio::time::{Duration, MissedTickBehavior, interval};

/// Duration of the history in seconds.
pub(super) const WINDOW_S: f64 = 30.0;
/// Interval between two samples.
const PERIOD: Duration = Duration::from_millis(50);
/// Number of samples of the window.
const MAX_SAMPLES: usize = 601;

/// Time in s, width in mm, speed in mm/s, force in N.
pub(super) type Sample = [f64; 4];

/// The samples, oldest first. A sample stands until the next one: equal values are not repeated.
#[derive(Debug, Default)]
pub(super) struct History(RefCell<VecDeque<Sample>>);

impl History {
    pub(super) fn samples(&self) -> Vec<Sample> {
        self.0.borrow().iter().copied().collect()
    }

    /// Samples the gripper for as long as it runs.
    pub(super) async fn record(self: Rc<Self>, hub: Arc<Hub>) {
        let mut ticks = interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            ticks.tick().await;
            let (now, state) = hub.look(|gripper| (gripper.now(), gripper.state()));
            let rounded = |value: f32| (f64::from(value) * 100.0).round() / 100.0;
            let time_s = (now.as_micros() as f64 / 1e4).round() / 100.0;
            self.add([time_s, rounded(state.width), rounded(state.speed), rounded(state.force)]);
        }
    }

    fn add(&self, sample: Sample) {
        let mut samples = self.0.borrow_mut();
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
        let history = History::default();
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
