//! Automatic updates of width, speed and force: a thread receives them, and a reader takes the newest.

use std::sync::Arc;
use std::thread;

use pyo3::exceptions::PyStopIteration;
use pyo3::prelude::*;
use wsg_protocol::AutoUpdate;
use wsg_protocol::driver::Error;

use crate::core::{Core, Failed};
use crate::error;
use crate::feed::{Feed, Row, Stage};
use crate::interpreter::{SIGNALS, detach, try_attach};

/// Shortest mean time between two values, in ms. In field reports, real grippers send up to 140 values per second. If more are
/// requested, they delay all answers, until the connection counts as lost.
const SHORTEST_MS: u16 = 8;
/// Longest interval, in s. A program that needs fewer values can query them.
const LONGEST: f64 = 1.0;

/// The reader's end of a subscription.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Updates {
    core: Arc<Core>,
    feed: Arc<Feed>,
}

impl Updates {
    /// Begins automatic updates at an interval in s, by default at the shortest.
    pub(crate) fn begin(
        py: Python<'_>,
        core: &Arc<Core>,
        interval: Option<f64>,
        wanted: [bool; 3],
        is_pulled: bool,
    ) -> PyResult<Self> {
        let invalid = |text: &str| Err(error::exception(py, "InvalidError", text, None));
        let values = wanted.iter().map(|is_wanted| u16::from(*is_wanted)).sum::<u16>();
        if values == 0 {
            return invalid("no value to subscribe to; expected width, speed or force");
        }
        let shortest = f64::from((SHORTEST_MS * values).max(AutoUpdate::MIN_PERIOD_MS)) / 1e3;
        let interval = interval.unwrap_or(shortest);
        if !(shortest..=LONGEST).contains(&interval) {
            return invalid(&format!(
                "interval is {interval} s; expected {shortest} to {LONGEST} s for {values} values"
            ));
        }
        let feed = Arc::new(Feed::new(wanted, (interval * 1e3).round() as u16, is_pulled));
        let begun = detach(py, || core.begin_updates(&feed)).map_err(|failed| failed.into_exception(py))?;
        if !begun {
            let text = "the connection has a subscription: close it first";
            return Err(error::exception(py, "BusyError", text, None));
        }
        if !is_pulled {
            let (core, received) = (Arc::clone(core), Arc::clone(&feed));
            let spawned = thread::Builder::new().name("wsg updates".to_owned()).spawn(move || {
                while core.receive_updates(&received) {}
                core.unsubscribe(&received);
                // The connection may end here, before the reader's `close` returns.
                drop(core);
                received.set_over();
            });
            if let Err(failure) = spawned {
                feed.set_over();
                return Err(failure.into());
            }
        }
        Ok(Self { core: Arc::clone(core), feed })
    }
}

#[pymethods]
impl Updates {
    /// Waits for the next reading. Raises StopIteration after `close`, and the cause of another end.
    fn next(&self, py: Python<'_>) -> PyResult<Row> {
        loop {
            if self.core.is_foreign() {
                return Err(Failed::from(Error::NotConnected).into_exception(py));
            }
            // Exceptions are made by Python code, which may let another thread run: not under the lock of the feed.
            match self.feed.take() {
                (Stage::Running, Some(row), _) => return Ok(row),
                (Stage::Running, None, _) => {}
                (_, _, Some(failure)) => return Err(error::of_driver(py, &failure)),
                (_, _, None) => return Err(PyStopIteration::new_err(())),
            }
            detach(py, || {
                if self.feed.is_pulled {
                    self.core.receive_updates(&self.feed);
                } else {
                    self.feed.wait(SIGNALS);
                }
            });
            py.check_signals()?;
        }
    }

    /// Ends the updates.
    fn close(&self, py: Python<'_>) {
        if !self.core.is_foreign() {
            detach(py, || self.core.end_updates(&self.feed, None));
        }
    }
}

impl Drop for Updates {
    fn drop(&mut self) {
        if !self.core.is_foreign() {
            // Without the interpreter lock, which another user of the driver may need before it yields the driver.
            try_attach(|py| py.detach(|| self.core.end_updates(&self.feed, None)));
        }
    }
}
