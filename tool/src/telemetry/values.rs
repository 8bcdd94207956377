//! The values of a device: as they are, and which of them were not told yet.

use tokio::time::Instant;
use wsg_protocol::SystemFlags;

use super::{
    metrics::{Metric, Value},
    report::What,
};

/// What keeps the fingers from doing their work, FAST STOP aside.
const FAULTS: SystemFlags = SystemFlags::TEMP_FAULT
    .union(SystemFlags::POWER_FAULT)
    .union(SystemFlags::CURR_FAULT)
    .union(SystemFlags::FINGER_FAULT);

/// By the places of a table.
#[derive(Debug)]
pub(super) struct Values {
    latest: Vec<Option<Value>>,
    /// As they were told last.
    told: Vec<Option<Value>>,
    is_changed: bool,
    told_at: Instant,
}

impl Values {
    /// Nothing is known.
    pub(super) fn new(table: &[Metric]) -> Self {
        let nothing = vec![None; table.len()];
        Self { latest: nothing.clone(), told: nothing, is_changed: false, told_at: Instant::now() }
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

    /// Takes a measured value; one that is nearer to the one that was told than the deadband is taken for that.
    pub(super) fn measured(&mut self, of: impl Into<usize>, number: f32, deadband: f32) {
        let place = of.into();
        let value = match self.told.get(place) {
            Some(Some(Value::Float(told))) if (number - told).abs() < deadband => *told,
            _ => number,
        };
        self.set(place, Some(Value::Float(value)));
    }

    /// Takes the system state flags: the word, whether the fingers are referenced, whether they move, FAST STOP, and faults.
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

    /// Whether something may be to be told.
    pub(super) const fn is_changed(&self) -> bool {
        self.is_changed
    }

    /// In how many ms what changed is to be told; `None` when nothing has.
    pub(super) fn due_in(&self, period_ms: u16) -> Option<u32> {
        let since = u32::try_from(self.told_at.elapsed().as_millis()).unwrap_or(u32::MAX);
        self.is_changed.then(|| u32::from(period_ms).saturating_sub(since))
    }

    /// The values that changed since they were told.
    pub(super) fn changed(&mut self) -> Option<What> {
        let mut changed = Vec::new();
        for (place, (told, latest)) in (0_u8..).zip(self.told.iter().zip(&self.latest)) {
            if told != latest {
                changed.push((place, latest.clone()));
            }
        }
        self.all();
        (!changed.is_empty()).then_some(What::Changed(changed))
    }

    /// All values, which count as told.
    pub(super) fn all(&mut self) -> Vec<Option<Value>> {
        self.told.clone_from(&self.latest);
        self.is_changed = false;
        self.told_at = Instant::now();
        self.told.clone()
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
    fn measured_values_are_told_when_they_left_the_deadband_around_the_one_that_was_told() {
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
    fn value_that_left_and_came_back_before_it_was_told_is_not_told() {
        let mut values = Values::new(GRIPPER);
        values.measured(OfGripper::Width, 10.0, 0.5);
        changed(&mut values);

        values.measured(OfGripper::Width, 20.0, 0.5);
        values.measured(OfGripper::Width, 10.1, 0.5);

        assert_eq!(changed(&mut values), []);
    }

    #[tokio::test(start_paused = true)]
    async fn change_is_due_a_period_after_the_last_one_was_told() {
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
