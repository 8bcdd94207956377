//! Bounded queue of samples for the broker. Sent samples are kept until the broker has confirmed them.
//!
//! Sparkplug sends data without acknowledgement (QoS 0). MQTT preserves the order within a connection, so a PINGRESP confirms
//! everything sent before its PINGREQ. Unconfirmed samples are sent again after a reconnect. A sample may therefore arrive twice,
//! but none is lost.

use std::collections::VecDeque;

use super::metrics::Value;

/// An entry of the queue.
#[derive(Debug)]
pub(super) enum Entry {
    /// Changed values of a device, by their index in its table.
    Sample { device: u16, at: u64, values: Vec<(u8, Option<Value>)> },
    /// A device was found while the broker was connected.
    Found { device: u16 },
    /// A device was lost while the broker was connected.
    Lost { device: u16 },
}

impl Entry {
    const fn is_sample(&self) -> bool {
        matches!(self, Self::Sample { .. })
    }
}

#[derive(Debug)]
pub(super) struct Store {
    entries: VecDeque<Entry>,
    /// Number of entries at the front that were sent but not confirmed.
    sent: usize,
    /// Number of entries removed so far, which is the position of the first entry.
    gone: u64,
    samples: usize,
    capacity: usize,
    dropped: u64,
    /// Number of samples dropped after sending and before confirmation.
    at_risk: u64,
}

impl Store {
    /// Creates a store for `capacity` samples.
    pub(super) const fn new(capacity: usize) -> Self {
        Self { entries: VecDeque::new(), sent: 0, gone: 0, samples: 0, capacity, dropped: 0, at_risk: 0 }
    }

    /// Adds an entry. Drops the oldest sample if the store is full.
    pub(super) fn push(&mut self, entry: Entry) {
        if entry.is_sample() {
            if self.samples >= self.capacity {
                self.drop_oldest();
            }
            self.samples += 1;
        }
        self.entries.push_back(entry);
    }

    fn drop_oldest(&mut self) {
        let Some(place) = self.entries.iter().position(Entry::is_sample) else { return };
        self.entries.remove(place);
        self.samples -= 1;
        self.gone += 1;
        if place < self.sent {
            self.sent -= 1;
            self.at_risk += 1;
        } else {
            self.dropped += 1;
        }
    }

    /// Returns the next entry to send. It is kept until confirmed.
    pub(super) fn send(&mut self) -> Option<&Entry> {
        let entry = self.entries.get(self.sent)?;
        self.sent += 1;
        Some(entry)
    }

    /// Returns the position of the next entry to send, to pass to [`confirm`](Self::confirm) once all earlier ones have arrived.
    pub(super) fn mark(&self) -> u64 {
        self.gone + self.sent as u64
    }

    /// Returns whether sent entries are still unconfirmed.
    pub(super) const fn is_unconfirmed(&self) -> bool {
        self.sent > 0
    }

    /// Removes the entries before a position, which the broker has received.
    pub(super) fn confirm(&mut self, mark: u64) {
        if self.gone <= mark {
            self.at_risk = 0;
        }
        while self.gone < mark && self.sent > 0 {
            let entry = self.entries.pop_front();
            self.samples -= usize::from(entry.is_some_and(|entry| entry.is_sample()));
            self.sent -= 1;
            self.gone += 1;
        }
    }

    /// Prepares for a new connection: unconfirmed samples will be sent again. `Found` and `Lost` entries are removed, because the
    /// births on the next connection replace them.
    pub(super) fn rewind(&mut self) {
        self.sent = 0;
        self.dropped += std::mem::take(&mut self.at_risk);
        let before = self.entries.len();
        self.entries.retain(Entry::is_sample);
        self.gone += (before - self.entries.len()) as u64;
    }

    /// Returns the device of each stored sample.
    pub(super) fn devices(&self) -> impl Iterator<Item = u16> {
        self.entries.iter().filter_map(|entry| match entry {
            Entry::Sample { device, .. } => Some(*device),
            Entry::Found { .. } | Entry::Lost { .. } => None,
        })
    }

    /// Returns the number of entries still to be sent.
    pub(super) fn waiting(&self) -> usize {
        self.entries.len() - self.sent
    }

    /// Returns the number of samples dropped so far.
    pub(super) const fn dropped(&self) -> u64 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(at: u64) -> Entry {
        Entry::Sample { device: 0, at, values: Vec::new() }
    }

    fn store_of(capacity: usize, moments: impl IntoIterator<Item = u64>) -> Store {
        let mut store = Store::new(capacity);
        moments.into_iter().for_each(|at| store.push(sample(at)));
        store
    }

    /// Sends all entries and returns their times; 0 for entries without one.
    fn sent_by(store: &mut Store) -> Vec<u64> {
        std::iter::from_fn(|| match store.send()? {
            Entry::Sample { at, .. } => Some(*at),
            Entry::Found { .. } | Entry::Lost { .. } => Some(0),
        })
        .collect()
    }

    #[test]
    fn oldest_samples_beyond_the_capacity_are_dropped_and_counted() {
        let mut store = store_of(3, 1..=5);
        assert_eq!((sent_by(&mut store), store.dropped()), (vec![3, 4, 5], 2));
    }

    #[test]
    fn unconfirmed_samples_are_sent_again_in_order_after_a_rewind() {
        let mut store = store_of(10, 1..=2);
        assert_eq!(sent_by(&mut store), [1, 2]);
        let mark = store.mark();
        store.push(sample(3));
        assert_eq!(sent_by(&mut store), [3]);

        store.confirm(mark);
        store.rewind();

        store.push(sample(4));
        assert_eq!((sent_by(&mut store), store.dropped()), (vec![3, 4], 0));
    }

    #[test]
    fn samples_dropped_unconfirmed_count_only_if_connection_breaks() {
        let mut confirmed = store_of(2, 1..=2);
        sent_by(&mut confirmed);
        let mark = confirmed.mark();
        confirmed.push(sample(3));
        confirmed.confirm(mark);
        confirmed.rewind();
        assert_eq!((sent_by(&mut confirmed), confirmed.dropped()), (vec![3], 0));

        let mut broken = store_of(2, 1..=2);
        sent_by(&mut broken);
        broken.push(sample(3));
        broken.rewind();
        assert_eq!((sent_by(&mut broken), broken.dropped()), (vec![2, 3], 1));
    }

    #[test]
    fn found_and_lost_entries_use_no_capacity_and_end_on_disconnect() {
        let mut store = store_of(2, []);
        store.push(Entry::Lost { device: 0 });
        store.push(sample(1));
        store.push(Entry::Found { device: 0 });
        store.push(sample(2));
        store.push(sample(3));
        assert_eq!((sent_by(&mut store), store.dropped()), (vec![0, 0, 2, 3], 1));

        store.rewind();

        assert_eq!(sent_by(&mut store), [2, 3]);
        assert!(store.is_unconfirmed());
        store.confirm(store.mark());
        assert!(!store.is_unconfirmed());
        assert_eq!(store.devices().count(), 0);
    }
}
