//! The checks and their findings: one line of text each, or one JSON object for all.

use std::fmt::Display;
use std::io::{self, Write};

use serde_json::{Map, Value, json};
use wsg_sim::text::one_line;

use crate::gripper::trouble::Trouble;

/// The checks, in the order of the report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Check {
    Reachability,
    Port,
    Protocol,
    Checksum,
    OtherClients,
    Firmware,
    Referenced,
    FastStop,
    Faults,
    Script,
    RoundTrip,
    UpdateRate,
    TcpDisconnect,
}

impl Check {
    pub(crate) const ALL: [Self; 13] = [
        Self::Reachability,
        Self::Port,
        Self::Protocol,
        Self::Checksum,
        Self::OtherClients,
        Self::Firmware,
        Self::Referenced,
        Self::FastStop,
        Self::Faults,
        Self::Script,
        Self::RoundTrip,
        Self::UpdateRate,
        Self::TcpDisconnect,
    ];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Reachability => "reachability",
            Self::Port => "port",
            Self::Protocol => "protocol",
            Self::Checksum => "checksum",
            Self::OtherClients => "other clients",
            Self::Firmware => "firmware",
            Self::Referenced => "referenced",
            Self::FastStop => "FAST STOP",
            Self::Faults => "faults",
            Self::Script => "script",
            Self::RoundTrip => "round trip",
            Self::UpdateRate => "update rate",
            Self::TcpDisconnect => "TCP disconnect",
        }
    }

    /// Returns what to change when the check does not pass.
    pub(crate) const fn remedy(self) -> &'static str {
        match self {
            Self::Reachability => {
                "check power, cable and address; the factory address is 192.168.1.20, and this computer needs an address in the same \
                 subnet"
            }
            Self::Port => {
                "select this interface and port under Settings -> Command Interface, or close the client that holds the connection"
            }
            Self::Protocol => {
                "select the interface and protocol of this address under Settings -> Command Interface, or use an address for the \
                 detected protocol: tcp:// or udp:// for the binary protocol, gcl:// or gcl+udp:// for GCL"
            }
            Self::Checksum => "enable checksum evaluation under Settings -> Command Interface",
            Self::OtherClients => {
                "close other connected programs, such as WSG Commander, and stop scripts; if a connected computer was switched off, restart \
                 the gripper"
            }
            Self::Firmware => "restart the gripper; its web interface shows the version",
            Self::Referenced => {
                "run `home` when it is safe to move the fingers, or enable homing at start-up under Settings -> Motion Configuration"
            }
            Self::FastStop => "remove the cause, then run `ack` when it is safe to move the fingers",
            Self::Faults => "check supply voltage, temperature and load; `finger-flags` shows finger faults",
            Self::Script => "correct or stop the script in the web interface",
            Self::RoundTrip | Self::UpdateRate => {
                "connect by cable instead of Wi-Fi, and close other clients; over a serial line or CAN, use the highest bit rate"
            }
            Self::TcpDisconnect => {
                "switch on the error state on TCP disconnect under Settings -> Command Interface"
            }
        }
    }

    /// Returns the exit status of a failed check: 4 if the gripper refuses motions, 6 if it cannot be used.
    const fn exit_status(self) -> u8 {
        match self {
            Self::FastStop | Self::Faults => 4,
            _ => 6,
        }
    }
}

/// Reason for a check that was not run.
pub(super) const EARLIER: &str = "an earlier check failed";

/// The outcome of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Ok,
    Warning,
    Failed,
    Skipped,
}

impl Verdict {
    const fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
        }
    }
}

/// The results so far. Text is printed after each check, JSON at the end.
pub(super) struct Report {
    is_json: bool,
    checks: Vec<Value>,
    /// Figures for the check that is recorded next.
    values: Map<String, Value>,
    /// The exit status, set by the first failed check.
    status: u8,
}

impl Report {
    pub(super) fn new(is_json: bool) -> Self {
        Self { is_json, checks: Vec::new(), values: Map::new(), status: 0 }
    }

    pub(super) fn ok(&mut self, check: Check, found: &str) -> Result<(), Trouble> {
        self.record(check, Verdict::Ok, found)
    }

    /// Records a finding that should be corrected but does not prevent use of the gripper.
    pub(super) fn warn(&mut self, check: Check, found: &str) -> Result<(), Trouble> {
        self.record(check, Verdict::Warning, found)
    }

    pub(super) fn fail(&mut self, check: Check, found: &str) -> Result<(), Trouble> {
        if self.status == 0 {
            self.status = check.exit_status();
        }
        self.record(check, Verdict::Failed, found)
    }

    /// Records a check that was not run, and the reason.
    pub(super) fn skip(&mut self, check: Check, reason: &str) -> Result<(), Trouble> {
        self.record(check, Verdict::Skipped, reason)
    }

    /// Records the error that ended the checks as the failure of the next check.
    pub(super) fn fail_next(&mut self, error: &impl Display) -> Result<(), Trouble> {
        match Check::ALL.get(self.checks.len()) {
            Some(check) => self.fail(*check, &error.to_string()),
            // All checks have run; the error occurred while closing the connection.
            None => {
                self.status = 6;
                writeln!(io::stderr(), "wsg: doctor: {}", one_line(&error.to_string()))?;
                Ok(())
            }
        }
    }

    /// Adds a figure to the JSON of the check that is recorded next, rounded to three decimals.
    pub(super) fn value(&mut self, name: &str, value: f64) {
        self.values.insert(name.to_owned(), json!((value * 1e3).round() / 1e3));
    }

    fn record(&mut self, check: Check, verdict: Verdict, found: &str) -> Result<(), Trouble> {
        let needs_remedy = matches!(verdict, Verdict::Warning | Verdict::Failed);
        let remedy = needs_remedy.then(|| check.remedy());
        let mut object = std::mem::take(&mut self.values);
        object.insert("check".to_owned(), json!(check.name()));
        object.insert("verdict".to_owned(), json!(verdict.name()));
        object.insert("found".to_owned(), json!(found));
        object.insert("remedy".to_owned(), json!(remedy));
        self.checks.push(Value::Object(object));
        if !self.is_json {
            let mut stdout = io::stdout().lock();
            let remedy = remedy.map(|remedy| format!("; {remedy}")).unwrap_or_default();
            let (verdict, found) = (verdict.name(), one_line(found));
            writeln!(stdout, "{verdict:<8} {:<14} {found}{remedy}", check.name())?;
            stdout.flush()?;
        }
        Ok(())
    }

    /// Marks the remaining checks as skipped, prints the conclusion, and returns the exit status.
    pub(super) fn finish(mut self) -> Result<u8, Trouble> {
        for check in Check::ALL.iter().skip(self.checks.len()) {
            self.skip(*check, EARLIER)?;
        }
        let (result, words) = match self.status {
            0 => ("done", "the gripper is usable"),
            4 => ("refused", "the gripper responds but refuses motions"),
            _ => ("no_connection", "the gripper is not usable at this address"),
        };
        let mut stdout = io::stdout().lock();
        if self.is_json {
            writeln!(stdout, "{}", json!({"command": "doctor", "result": result, "checks": self.checks}))?;
        } else {
            writeln!(stdout, "{words}")?;
        }
        stdout.flush()?;
        Ok(self.status)
    }
}
