//! The keys of the latest commands: a command that arrives twice is executed once.

use std::collections::VecDeque;

/// Number of keys that are kept.
const MAX_KEYS: usize = 64;

/// The keys of the latest commands.
#[derive(Debug, Default)]
pub(crate) struct Executed(VecDeque<u64>);

impl Executed {
    pub(crate) fn contains(&self, key: u64) -> bool {
        self.0.contains(&key)
    }

    pub(crate) fn keep(&mut self, key: u64) {
        self.0.truncate(MAX_KEYS - 1);
        self.0.push_front(key);
    }
}
