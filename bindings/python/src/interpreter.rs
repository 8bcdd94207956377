//! Leaving and entering the interpreter, its end, and its forks.
//!
//! An interpreter that ends terminates each thread that attaches to it. The termination unwinds the frames of Rust, which can
//! crash the process. So threads that are detached when the end begins stay detached.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst, fence};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant, SystemTime};

use pyo3::prelude::*;

/// Longest wait for the threads that are attaching when the end begins.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Interval at which a thread that waits handles Python's signals.
pub(crate) const SIGNALS: Duration = Duration::from_millis(50);

/// The thread that ends the interpreter.
static ENDING: OnceLock<ThreadId> = OnceLock::new();
/// Number of threads that are attaching.
static ATTACHING: AtomicUsize = AtomicUsize::new(0);

/// Calls `act` without the interpreter lock. Never returns if the interpreter has ended meanwhile.
pub(crate) fn detach<T: Send>(py: Python<'_>, act: impl FnOnce() -> T + Send) -> T {
    let value = py.detach(|| {
        let value = act();
        while !begin_attaching() {
            thread::park();
        }
        value
    });
    ATTACHING.fetch_sub(1, SeqCst);
    value
}

/// Calls `act` with the interpreter lock. Returns `None` if the interpreter has ended.
pub(crate) fn try_attach<T>(act: impl FnOnce(Python<'_>) -> T) -> Option<T> {
    if !begin_attaching() {
        return None;
    }
    let value = Python::try_attach(act);
    ATTACHING.fetch_sub(1, SeqCst);
    value
}

/// Returns whether this thread may attach, and counts it until then.
fn begin_attaching() -> bool {
    ATTACHING.fetch_add(1, SeqCst);
    fence(SeqCst);
    let may = ENDING.get().is_none_or(|ending| *ending == thread::current().id());
    if !may {
        ATTACHING.fetch_sub(1, SeqCst);
    }
    may
}

/// Begins the end of the interpreter on this thread, which must be detached. No other thread attaches afterwards.
pub(crate) fn end() {
    // A second call has no effect.
    let _ = ENDING.set(thread::current().id());
    fence(SeqCst);
    let begin = Instant::now();
    while ATTACHING.load(SeqCst) > 0 && begin.elapsed() < TIMEOUT {
        thread::yield_now();
    }
}

/// Number of forks between the first process and this one.
static FORKS: AtomicUsize = AtomicUsize::new(0);

/// Identifies this process among its ancestors, without a system call.
pub(crate) fn process() -> usize {
    FORKS.load(SeqCst)
}

/// Counts a fork. Python calls it in each child.
pub(crate) fn count_fork() {
    FORKS.fetch_add(1, SeqCst);
}

/// Returns the value of `time.time()`.
pub(crate) fn unix_now() -> f64 {
    SystemTime::UNIX_EPOCH.elapsed().map_or(0.0, |elapsed| elapsed.as_secs_f64())
}
