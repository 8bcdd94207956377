//! Distributions of durations, and the verdict on limits.

use anyhow::{Result, bail};
use std::fmt;

/// Durations in microseconds, sorted.
pub(crate) struct Durations(Vec<u32>);

impl Durations {
    pub(crate) fn new(mut micros: Vec<u32>) -> Self {
        micros.sort_unstable();
        Self(micros)
    }

    pub(crate) const fn count(&self) -> usize {
        self.0.len()
    }

    /// Returns the smallest duration that `share` of all do not exceed, in milliseconds.
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

/// The limits that were exceeded.
#[derive(Default)]
pub(crate) struct Verdict {
    broken: Vec<String>,
    /// Why time limits cannot be judged, if they cannot.
    load: Option<String>,
    /// The exceeded time limits that are not judged.
    not_judged: Vec<String>,
}

impl Verdict {
    /// Creates a verdict. With `load`, a description of other load on the machine, exceeded time limits are not judged.
    pub(crate) fn under(load: Option<String>) -> Self {
        Self { load, ..Self::default() }
    }

    /// Requires a condition; `broken` describes its violation.
    pub(crate) fn must(&mut self, holds: bool, broken: String) {
        if !holds {
            self.broken.push(broken);
        }
    }

    /// Requires a condition that depends on processor time.
    pub(crate) fn must_in_time(&mut self, holds: bool, broken: String) {
        if !holds && self.load.is_some() {
            self.not_judged.push(broken);
        } else {
            self.must(holds, broken);
        }
    }

    pub(crate) fn give(self) -> Result<()> {
        if !self.broken.is_empty() {
            bail!("{}", self.broken.join("; "));
        }
        match self.load {
            Some(load) if !self.not_judged.is_empty() => {
                println!("NOT JUDGED, the machine was loaded ({load}): {}", self.not_judged.join("; "));
                println!("all other limits held");
            }
            _ => println!("all limits held"),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(load: Option<&str>, holds: [bool; 2]) -> Result<()> {
        let mut verdict = Verdict::under(load.map(str::to_owned));
        verdict.must(holds[0], "too much memory".into());
        verdict.must_in_time(holds[1], "too late".into());
        verdict.give()
    }

    #[test]
    fn machine_load_excuses_late_data_only() {
        assert!(verdict(None, [true, true]).is_ok());
        assert_eq!(verdict(None, [true, false]).unwrap_err().to_string(), "too late");
        assert!(verdict(Some("others"), [true, false]).is_ok());
        assert_eq!(verdict(Some("others"), [false, false]).unwrap_err().to_string(), "too much memory");
    }
}
