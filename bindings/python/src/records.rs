//! The records of the drivers in Python's `logging`, as the logger `wsg_gripper`.
//!
//! A thread passes them on, so that no driver waits for the interpreter lock or for a handler.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use log::{Level, LevelFilter, Log, Metadata, Record};
use pyo3::prelude::*;

use crate::interpreter::{process, try_attach};

/// Maximum number of waiting records. Later ones are dropped.
const MAX_WAITING: usize = 256;

/// The queues of this process and of its ancestors: a fork copies locked mutexes, and no threads.
static QUEUES: [Queue; 16] = [const { Queue::new() }; 16];

struct Queue {
    state: Mutex<State>,
    added: Condvar,
}

struct State {
    waiting: VecDeque<(Level, String)>,
    has_thread: bool,
}

/// Receives the records of the drivers.
struct Receiver;

/// Begins to receive records.
pub(crate) fn receive() {
    if log::set_logger(&Receiver).is_ok() {
        log::set_max_level(LevelFilter::Info);
    }
}

/// Passes the waiting records to Python on this thread, at the end of the interpreter.
pub(crate) fn pass_on(py: Python<'_>) {
    if let Some(queue) = QUEUES.get(process()) {
        queue.pass_on(py);
    }
}

impl Log for Receiver {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target() == "wsg_protocol"
    }

    fn log(&self, record: &Record<'_>) {
        if let Some(queue) = QUEUES.get(process())
            && self.enabled(record.metadata())
        {
            queue.add(record.level(), record.args().to_string());
        }
    }

    fn flush(&self) {}
}

impl Queue {
    const fn new() -> Self {
        let state = Mutex::new(State { waiting: VecDeque::new(), has_thread: false });
        Self { state, added: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add(&'static self, level: Level, text: String) {
        let mut state = self.lock();
        if state.waiting.len() < MAX_WAITING {
            state.waiting.push_back((level, text));
        }
        if !state.has_thread {
            let thread = thread::Builder::new().name("wsg records".to_owned());
            state.has_thread = thread.spawn(|| self.pass_on_until_the_end()).is_ok();
        }
        drop(state);
        self.added.notify_one();
    }

    fn pass_on_until_the_end(&self) {
        loop {
            let waited = self.added.wait_while(self.lock(), |state| state.waiting.is_empty());
            drop(waited);
            if try_attach(|py| self.pass_on(py)).is_none() {
                return;
            }
        }
    }

    fn pass_on(&self, py: Python<'_>) {
        let next = || self.lock().waiting.pop_front();
        while let Some((level, text)) = next() {
            let number = match level {
                Level::Error => 40,
                Level::Warn => 30,
                _ => 20,
            };
            let logged = py.import("logging").and_then(|logging| {
                logging.call_method1("getLogger", ("wsg_gripper",))?.call_method1("log", (number, text))
            });
            if let Err(failure) = logged {
                failure.write_unraisable(py, None);
            }
        }
    }
}
