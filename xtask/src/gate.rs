//! A measured figure and its limit.

use std::fmt;

use anyhow::{Result, bail};

/// The unit of a figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Unit {
    /// Bytes of memory.
    Bytes,
    /// Instructions per byte on the line.
    InstructionsPerByte,
    /// Number of instructions.
    Instructions,
    /// Time in microseconds.
    Microseconds,
    /// 10⁹ bytes per second; more is better.
    GigabytesPerSecond,
    /// Speed relative to a reference; more is better.
    TimesAsFast,
    /// Duration relative to a reference.
    TimesAsLong,
    /// Share of a processor core in percent.
    PercentOfCore,
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
        Self::new(what, measured as f64, limit as f64, Unit::Bytes)
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
            Unit::Bytes if kib >= 1.0 && kib.fract() == 0.0 => format!("{kib:.0} KiB"),
            unit => unit.text(self.limit),
        }
    }

    /// Returns whether the measured value is within its limit.
    pub(crate) fn holds(&self) -> bool {
        match self.unit {
            Unit::GigabytesPerSecond | Unit::TimesAsFast => self.measured >= self.limit,
            _ => self.measured <= self.limit,
        }
    }
}

impl Unit {
    fn text(self, value: f64) -> String {
        match self {
            Self::Bytes => format!("{value:.0} B"),
            Self::InstructionsPerByte => format!("{value:.1}"),
            Self::Instructions => format!("{value:.0}"),
            Self::Microseconds => format!("{value:.1} µs"),
            Self::GigabytesPerSecond => format!("{value:.2} GB/s"),
            Self::TimesAsFast => format!("{value:.1} times"),
            Self::TimesAsLong => format!("{value:.2} times"),
            Self::PercentOfCore => format!("{value:.2} %"),
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

    #[test]
    fn throughput_must_reach_its_limit() {
        let gate = |measured| Gate::new("bulk", measured, 1.0, Unit::GigabytesPerSecond);

        assert!(check(&[gate(1.5)]).is_ok());
        assert!(check(&[gate(0.99)]).is_err());
    }
}
