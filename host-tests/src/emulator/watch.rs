//! Externally visible state of the board, updated by a thread.

use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use wsg_bridge_fw::io::Outputs;

use super::{OutputChange, lock};

/// Number of output lines kept in addition to the trace.
#[cfg(unix)]
const PRINTED_MAX: usize = 4;

#[derive(Debug)]
pub(super) struct Watch {
    pub(super) seen: Mutex<Seen>,
    changed: Condvar,
}

#[derive(Debug)]
pub(super) struct Seen {
    /// Name of the emulator program.
    emulator: &'static str,
    pub(super) outputs: Outputs,
    /// Whether the firmware has written levels to driven wires, which is the main loop's first action.
    pub(super) is_served: bool,
    changes: Vec<OutputChange>,
    subscribers: Vec<Sender<OutputChange>>,
    /// First output lines of the emulator, which usually explain why it does not start.
    printed: Vec<String>,
    pub(super) has_ended: bool,
}

impl Watch {
    pub(super) fn of(emulator: &'static str) -> Self {
        let seen = Seen {
            emulator,
            outputs: Outputs::empty(),
            is_served: false,
            changes: Vec::new(),
            subscribers: Vec::new(),
            printed: Vec::new(),
            has_ended: false,
        };
        Self { seen: Mutex::new(seen), changed: Condvar::new() }
    }

    /// Reports the current levels of the wires.
    pub(super) fn show(&self, outputs: Outputs, is_served: bool) {
        let mut seen = lock(&self.seen);
        seen.is_served |= is_served;
        if outputs != seen.outputs {
            seen.outputs = outputs;
            let change = OutputChange { at: Instant::now(), outputs };
            seen.changes.push(change);
            seen.subscribers.retain(|subscriber| subscriber.send(change).is_ok());
        }
        self.changed.notify_all();
    }

    /// Records an output line. A CPU lock-up dumps all registers; the first lines give the reason.
    #[cfg(unix)]
    pub(super) fn receive(&self, line: &str) {
        let mut seen = lock(&self.seen);
        if seen.printed.len() < PRINTED_MAX && !line.trim().is_empty() {
            seen.printed.push(line.trim().to_owned());
        }
    }

    /// Reports that the emulator has ended.
    pub(super) fn end(&self) {
        let mut seen = lock(&self.seen);
        seen.has_ended = true;
        seen.subscribers.clear();
        self.changed.notify_all();
    }

    /// Reports that the machine has stopped permanently, and why.
    #[cfg(unix)]
    pub(super) fn fail(&self, why: &str) {
        let mut seen = lock(&self.seen);
        // An intentional end is not a failure.
        if !seen.has_ended {
            seen.printed.push(why.to_owned());
            seen.has_ended = true;
            seen.subscribers.clear();
        }
        self.changed.notify_all();
    }

    pub(super) fn subscribe(&self) -> Receiver<OutputChange> {
        let (sender, receiver) = mpsc::channel();
        let mut seen = lock(&self.seen);
        for &change in &seen.changes {
            // The receiver still exists, so sending cannot fail.
            let _ = sender.send(change);
        }
        if !seen.has_ended {
            seen.subscribers.push(sender);
        }
        receiver
    }

    pub(super) fn wait(
        &self,
        timeout: Duration,
        wanted: impl Fn(&Seen) -> bool,
    ) -> Result<MutexGuard<'_, Seen>> {
        let (seen, _) = self
            .changed
            .wait_timeout_while(lock(&self.seen), timeout, |seen| !seen.has_ended && !wanted(seen))
            .unwrap_or_else(PoisonError::into_inner);
        if wanted(&seen) {
            Ok(seen)
        } else if seen.has_ended {
            bail!("{}", seen.last_words())
        } else {
            bail!("waited {timeout:?}; {}", seen.last_words())
        }
    }
}

impl Seen {
    pub(super) fn last_words(&self) -> String {
        let (emulator, state) = (self.emulator, if self.has_ended { "has ended" } else { "is running" });
        match self.printed.as_slice() {
            [] if self.has_ended => {
                format!("{emulator} {state} without output: the firmware has reset itself")
            }
            [] => format!("{emulator} {state}"),
            printed => format!("{emulator} {state}; output: {}", printed.join("; ")),
        }
    }
}
