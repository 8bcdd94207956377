//! What the tasks have in common: reports of devices to the task with the broker, what is said on standard error, and the end.

use std::time::{SystemTime, UNIX_EPOCH};

use tokio::sync::{mpsc, watch};

use super::metrics::{OfCommand, Value};

/// What is told about a device by whoever reads it.
#[derive(Debug)]
pub(super) struct Report {
    /// Its place in the configuration.
    pub(super) device: u16,
    /// In ms since 1970 (UTC).
    pub(super) at: u64,
    pub(super) what: What,
}

#[derive(Debug)]
pub(super) enum What {
    /// It was found: a value for each row of its table, and the range of those that have one.
    Found { values: Vec<Option<Value>>, ranges: Vec<Option<(f32, f32)>> },
    /// Values that changed, by their places in its table.
    Changed(Vec<(u8, Option<Value>)>),
    /// What a command came to.
    Outcome { of: OfCommand, text: String },
    /// It answers no more.
    Lost,
}

/// A device of the configuration, and where its reports go.
#[derive(Clone, Debug)]
pub(super) struct Reporter {
    pub(super) device: u16,
    pub(super) name: String,
    pub(super) reports: mpsc::Sender<Report>,
}

impl Reporter {
    /// Waits while the receiver is behind.
    pub(super) async fn tell(&self, what: What) {
        // Without a receiver the program ends.
        let _ = self.reports.send(Report { device: self.device, at: now_ms(), what }).await;
    }
}

/// This moment in ms since 1970 (UTC).
pub(super) fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

/// Says what a device does once, until it is something else.
#[derive(Debug, Default)]
pub(super) struct Teller {
    last: String,
}

impl Teller {
    pub(super) fn tell(&mut self, text: String) {
        if text != self.last {
            eprintln!("wsg: {text}");
            self.last = text;
        }
    }
}

/// Is ready when the program is to end.
pub(super) async fn stopped(stop: &mut watch::Receiver<bool>) {
    // Nobody is left to say so: then it ends, too.
    let _ = stop.wait_for(|stop| *stop).await;
}
