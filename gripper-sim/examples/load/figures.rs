//! Lists of durations, and the limits that are held.

use anyhow::{Result, bail};
use std::fmt;

/// Durations in microseconds, in order.
pub(crate) struct Durations(Vec<u32>);

impl Durations {
    pub(crate) fn new(mut micros: Vec<u32>) -> Self {
        micros.sort_unstable();
        Self(micros)
    }

    pub(crate) const fn count(&self) -> usize {
        self.0.len()
    }

    /// The least of them that `share` of all do not exceed, in milliseconds.
    pub(crate) fn quantile(&self, share: f64) -> f64 {
        let last = self.0.len().saturating_sub(1);
        let at = (last as f64 * share).round() as usize;
        self.0.get(at).map_or(f64::NAN, |micros| f64::from(*micros) / 1e3)
    }
}

impl fmt::Display for Durations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [median, p99, max] = [0.5, 0.99, 1.0].map(|share| self.quantile(share));
        write!(f, "p50 {median:.3} ms, p99 {p99:.3} ms, max {max:.3} ms")
    }
}

/// The limits that were passed.
#[derive(Default)]
pub(crate) struct Verdict(Vec<String>);

impl Verdict {
    /// Something that must hold; otherwise `broken` says what was wrong.
    pub(crate) fn must(&mut self, holds: bool, broken: String) {
        if !holds {
            self.0.push(broken);
        }
    }

    pub(crate) fn give(self) -> Result<()> {
        if !self.0.is_empty() {
            bail!("{}", self.0.join("; "));
        }
        println!("all limits held");
        Ok(())
    }
}
