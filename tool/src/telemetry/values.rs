//! The values of a device, and which of them have changed since the last report.

use tokio::time::Instant;
use wsg_protocol::SystemFlags;

use super::{
    metrics::{Metric, Value},
    report::What,
};

/// The faults that `Fault` summarizes. FAST STOP has a metric of its own.
const FAULTS: SystemFlags = SystemFlags::TEMP_FAULT
    .union(SystemFlags::POWER_FAULT)
    .union(SystemFlags::CURR_FAULT)
    .union(SystemFlags::FINGER_FAULT);

/// Values, by their index in a metric table.
#[derive(Debug)]
pub(super) struct Values {
    latest: Vec<Option<Value>>,
    /// The values last reported.
    published: Vec<Option<Value>>,
    is_changed: bool,
    published_at: Instant,
}

impl Values {
    /// Creates values that are all unknown.
    pub(super) fn new(table: &[Metric]) -> Self {
        let nothing = vec![None; table.len()];
        Self { latest: nothing.clone(), published: nothing, is_changed: false, published_at: Instant::now() }
    }

    pub(super) fn get(&self, of: impl Into<usize>) -> Option<&Value> {
        self.latest.get(of.into())?.as_ref()
    }

    pub(super) fn set(&mut self, of: impl Into<usize>, value: Option<Value>) {
        if let Some(slot) = self.latest.get_mut(of.into())
            && *slot != value
        {
            *slot = value;
            self.is_changed = true;
        }
    }

    /// Sets a measured value. Within the deadband around the last reported value, that value is kept.
    pub(super) fn measured(&mut self, of: impl Into<usize>, number: f32, deadband: f32) {
        let place = of.into();
        let value = match self.published.get(place) {
            Some(Some(Value::Float(published))) if (number - published).abs() < deadband => *published,
            _ => number,
        };
        self.set(place, Some(Value::Float(value)));
    }

    /// Sets the values derived from the system state flags: the flags word, referenced, moving, FAST STOP, fault.
    pub(super) fn set_flags<I: Into<usize>>(&mut self, places: [I; 5], flags: SystemFlags) {
        let values = [
            Value::Unsigned(flags.bits().into()),
            Value::Boolean(flags.contains(SystemFlags::REFERENCED)),
            Value::Boolean(flags.contains(SystemFlags::MOVING)),
            Value::Boolean(flags.contains(SystemFlags::FAST_STOP)),
            Value::Boolean(flags.intersects(FAULTS)),
        ];
        for (of, value) in places.into_iter().zip(values) {
            self.set(of, Some(value));
        }
    }

    /// Returns whether a value may have changed since the last report.
    pub(super) const fn is_changed(&self) -> bool {
        self.is_changed
    }

    /// Returns the time in ms until changes are due to be reported, or `None` if there are none.
    pub(super) fn due_in(&self, period_ms: u16) -> Option<u32> {
        let since = u32::try_from(self.published_at.elapsed().as_millis()).unwrap_or(u32::MAX);
        self.is_changed.then(|| u32::from(period_ms).saturating_sub(since))
    }

    /// Returns the values that have changed since the last report, and marks them as reported.
    pub(super) fn changed(&mut self) -> Option<What> {
        let mut changed = Vec::new();
        for (place, (published, latest)) in (0_u8..).zip(self.published.iter().zip(&self.latest)) {
            if published != latest {
                changed.push((place, latest.clone()));
            }
        }
        self.all();
        (!changed.is_empty()).then_some(What::Changed(changed))
    }

    /// Returns all values and marks them as reported.
    pub(super) fn all(&mut self) -> Vec<Option<Value>> {
        self.published.clone_from(&self.latest);
        self.is_changed = false;
        self.published_at = Instant::now();
        self.published.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry::metrics::{GRIPPER, OfGripper};

    fn changed(values: &mut Values) -> Vec<(u8, Option<Value>)> {
        match values.changed() {
            Some(What::Changed(changed)) => changed,
            None => Vec::new(),
            Some(other) => panic!("{other:?}"),
        }
    }

    #[test]
    fn measured_values_are_reported_when_they_leave_the_deadband() {
        let mut values = Values::new(GRIPPER);
        values.measured(OfGripper::Width, 10.0, 0.5);
        assert_eq!(changed(&mut values), [(0, Some(Value::Float(10.0)))]);

        for width in [10.4, 9.6, 10.49] {
            values.measured(OfGripper::Width, width, 0.5);
            assert_eq!(changed(&mut values), [], "{width}");
        }
        values.measured(OfGripper::Width, 10.5, 0.5);
        assert_eq!(changed(&mut values), [(0, Some(Value::Float(10.5)))]);
    }

    #[test]
    fn value_that_returns_before_the_next_report_is_not_reported() {
        let mut values = Values::new(GRIPPER);
        values.measured(OfGripper::Width, 10.0, 0.5);
        changed(&mut values);

        values.measured(OfGripper::Width, 20.0, 0.5);
        values.measured(OfGripper::Width, 10.1, 0.5);

        assert_eq!(changed(&mut values), []);
    }

    #[tokio::test(start_paused = true)]
    async fn change_is_due_one_period_after_the_last_report() {
        let mut values = Values::new(GRIPPER);
        assert_eq!(values.due_in(100), None);
        values.set(OfGripper::State, Some(Value::Text("IDLE".to_owned())));
        values.changed();
        values.set(OfGripper::State, None);
        assert_eq!(values.due_in(100), Some(100));
        tokio::time::advance(std::time::Duration::from_millis(30)).await;
        assert_eq!(values.due_in(100), Some(70));
        tokio::time::advance(std::time::Duration::from_millis(100)).await;
        assert_eq!(values.due_in(100), Some(0));
    }
}
