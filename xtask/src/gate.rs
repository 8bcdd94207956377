//! A measured figure and its limit.

use std::fmt;

use anyhow::{Result, bail};

/// The unit of a figure: the number of decimals to print, and the suffix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Unit(usize, &'static str);

impl Unit {
    pub(crate) const BYTES: Self = Self(0, " B");
    pub(crate) const INSTRUCTIONS_PER_BYTE: Self = Self(1, "");
    pub(crate) const INSTRUCTIONS: Self = Self(0, "");
    pub(crate) const MICROSECONDS: Self = Self(1, " µs");
    /// 10⁹ bytes per second; more is better.
    pub(crate) const GIGABYTES_PER_SECOND: Self = Self(2, " GB/s");
    /// Speed relative to a reference; more is better.
    pub(crate) const TIMES_AS_FAST: Self = Self(1, " times");
    /// Duration relative to a reference.
    pub(crate) const TIMES_AS_LONG: Self = Self(2, " times");
    /// Share of a processor core.
    pub(crate) const PERCENT_OF_CORE: Self = Self(2, " %");

    fn text(self, value: f64) -> String {
        format!("{value:.*}{}", self.0, self.1)
    }
}

/// A measured figure and its limit.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    /// Name of the figure.
    pub(crate) what: String,
    /// Measured value, in the unit below.
    pub(crate) measured: f64,
    /// Maximum, or minimum for units where more is better.
    pub(crate) limit: f64,
    /// Unit of both values.
    pub(crate) unit: Unit,
}

impl Gate {
    /// Creates a gate in bytes.
    pub(crate) fn bytes(what: impl Into<String>, measured: u64, limit: u64) -> Self {
        Self::new(what, measured as f64, limit as f64, Unit::BYTES)
    }

    /// Creates a gate in any unit.
    pub(crate) fn new(what: impl Into<String>, measured: f64, limit: f64, unit: Unit) -> Self {
        Self { what: what.into(), measured, limit, unit }
    }

    /// Formats the measured value for a table.
    pub(crate) fn measured_text(&self) -> String {
        self.unit.text(self.measured)
    }

    /// Formats the limit for a table.
    pub(crate) fn limit_text(&self) -> String {
        if self.limit.is_infinite() {
            return "none".to_owned();
        }
        let kib = self.limit / 1024.0;
        match self.unit {
            Unit::BYTES if kib >= 1.0 && kib.fract() == 0.0 => format!("{kib:.0} KiB"),
            unit => unit.text(self.limit),
        }
    }

    /// Returns whether the measured value is within its limit.
    pub(crate) fn holds(&self) -> bool {
        match self.unit {
            Unit::GIGABYTES_PER_SECOND | Unit::TIMES_AS_FAST => self.measured >= self.limit,
            _ => self.measured <= self.limit,
        }
    }
}

impl fmt::Display for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = if self.holds() { "ok" } else { "PAST ITS LIMIT" };
        write!(f, "{:<56} {:>10} of {:>10}  {verdict}", self.what, self.measured_text(), self.limit_text())
    }
}

/// Prints each gate. Fails if one exceeds its limit.
pub(crate) fn check(gates: &[Gate]) -> Result<()> {
    for gate in gates {
        println!("{gate}");
    }
    let past = gates.iter().filter(|gate| !gate.holds());
    let past: Vec<&str> = past.map(|gate| gate.what.as_str()).collect();
    if !past.is_empty() {
        bail!("past the limit: {}", past.join(", "));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gate_holds_up_to_its_limit_and_not_past_it() {
        assert!(check(&[Gate::bytes("flash", 0, 100), Gate::bytes("flash", 100, 100)]).is_ok());
        let error = check(&[Gate::bytes("RAM", 100, 100), Gate::bytes("flash", 101, 100)]).unwrap_err();
        assert_eq!(error.to_string(), "past the limit: flash");
    }
}
