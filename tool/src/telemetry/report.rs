//! Shared by all tasks: reports to the broker task, messages on standard error, and the stop signal.

use std::time::{SystemTime, UNIX_EPOCH};

use tokio::sync::{mpsc, watch};

use super::metrics::{OfCommand, Value};
use crate::{Severity, print_message};

/// A report from a device's reader.
#[derive(Debug)]
pub(super) struct Report {
    /// Index of the device in the settings.
    pub(super) device: u16,
    /// Time in ms since 1970 (UTC).
    pub(super) at: u64,
    pub(super) what: What,
}

#[derive(Debug)]
pub(super) enum What {
    /// The device was found. Holds a value for each row of its table, and the known ranges.
    Found { values: Vec<Option<Value>>, ranges: Vec<Option<(f32, f32)>> },
    /// Changed values, by their index in its table.
    Changed(Vec<(u8, Option<Value>)>),
    /// The outcome of a command.
    Outcome { of: OfCommand, text: String },
    /// The device no longer responds.
    Lost,
}

/// Sends the reports of one device.
#[derive(Clone, Debug)]
pub(super) struct Reporter {
    pub(super) device: u16,
    pub(super) name: String,
    pub(super) reports: mpsc::Sender<Report>,
}

impl Reporter {
    /// Sends a report. Waits while the queue is full.
    pub(super) async fn send(&self, what: What) {
        // Without a receiver, the program is about to exit.
        let _ = self.reports.send(Report { device: self.device, at: now_ms(), what }).await;
    }
}

/// Returns the current time in ms since 1970 (UTC).
pub(super) fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

/// Prints messages to standard error, omitting consecutive repetitions.
#[derive(Debug, Default)]
pub(super) struct Messages {
    last: String,
}

impl Messages {
    pub(super) fn print(&mut self, text: String) {
        if text != self.last {
            print_message(Severity::Info, &text);
            self.last = text;
        }
    }
}

/// Completes when the program is to exit.
pub(super) async fn stopped(stop: &mut watch::Receiver<bool>) {
    // An error means that the sender is gone, which ends the program as well.
    let _ = stop.wait_for(|stop| *stop).await;
}
