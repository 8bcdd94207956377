//! A connected driver that several threads share.
//!
//! A request locks the driver. A motion yields it within [`Line`]'s time-out when another request waits, so state queries
//! pass while the fingers move. Stop and FAST STOP do not wait: the [`StopHandle`] sends them at once.

use std::mem;
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::{self, ThreadId};

use pyo3::prelude::*;
use wsg_protocol::driver::blocking::{GclGripper, Gripper};
use wsg_protocol::driver::{Error, MotionResult, Pending, StopHandle, StopKind};

use crate::error::{self, Failure};
use crate::feed::Feed;
use crate::interpreter::process;
use crate::line::{Calls, Clock, Line};

/// A driver of either protocol.
pub(crate) enum Driver {
    Binary(Box<Gripper<Line, Clock>>),
    Gcl(Box<GclGripper<Line, Clock>>),
}

/// Evaluates an expression with the gripper of a [`Driver`] of either protocol.
macro_rules! each {
    ($driver:expr, $gripper:ident => $value:expr) => {
        match $driver {
            $crate::core::Driver::Binary($gripper) => $value,
            $crate::core::Driver::Gcl($gripper) => $value,
        }
    };
}
pub(crate) use each;

/// A driver, and the state that its callers share.
pub(crate) struct Core {
    driver: Mutex<Option<Driver>>,
    calls: Arc<Calls>,
    handle: StopHandle,
    /// Number of stops that this program requested.
    stops: AtomicUsize,
    /// The thread that uses the driver.
    owner: Mutex<Option<ThreadId>>,
    /// The subscription of this connection.
    feed: Mutex<Option<Arc<Feed>>>,
    /// The process that opened the line. A forked child must not use it.
    process: usize,
}

/// A connection that the interpreter's end closes.
pub(crate) trait Close: Send + Sync {
    /// Stops the fingers and ends the connection, within a bounded time.
    fn close_at_exit(&self);
}

static OPEN: Mutex<Vec<Weak<dyn Close>>> = Mutex::new(Vec::new());

/// Registers a connection that the interpreter's end closes.
pub(crate) fn close_at_exit(connection: Weak<dyn Close>) {
    let mut open = lock(&OPEN);
    open.retain(|other| other.strong_count() > 0);
    open.push(connection);
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The part that a call has in a motion.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Query,
    Begin,
    Wait,
}

pub(crate) enum Failed {
    Driver(Failure),
    /// A signal handler raised this exception.
    Raised(PyErr),
    /// The wait for a motion ended to let another request pass.
    Yielded,
}

impl Failed {
    pub(crate) fn into_exception(self, py: Python<'_>) -> PyErr {
        match self {
            Self::Driver(failure) => error::of_driver(py, &failure),
            Self::Raised(raised) => raised,
            Self::Yielded => error::of_driver(py, &Error::MotionRunning),
        }
    }
}

impl From<Failure> for Failed {
    fn from(failure: Failure) -> Self {
        Self::Driver(failure)
    }
}

impl Core {
    pub(crate) fn connect(mut driver: Driver, calls: Arc<Calls>) -> Result<Arc<Self>, Failed> {
        let handle = each!(&mut driver, gripper => gripper.stop_handle()).map_err(Error::Transport)?;
        let core = Arc::new(Self {
            driver: Mutex::new(Some(driver)),
            calls,
            handle,
            stops: AtomicUsize::new(0),
            owner: Mutex::new(None),
            feed: Mutex::new(None),
            process: process(),
        });
        core.with(true, |driver| each!(driver, gripper => gripper.connect()))?;
        let open = Arc::downgrade(&core);
        close_at_exit(open);
        Ok(core)
    }

    /// Calls `act` with the driver. If a signal handler raises an exception meanwhile, stops the fingers.
    pub(crate) fn with<T>(
        &self,
        handles_signals: bool,
        act: impl FnOnce(&mut Driver) -> Result<T, Failure>,
    ) -> Result<T, Failed> {
        self.with_calls(None, handles_signals, Stage::Query, act)
    }

    fn with_calls<T>(
        &self,
        held: Option<MutexGuard<'_, Option<Driver>>>,
        handles_signals: bool,
        stage: Stage,
        act: impl FnOnce(&mut Driver) -> Result<T, Failure>,
    ) -> Result<T, Failed> {
        let Self { calls, owner, .. } = self;
        if self.is_foreign() {
            return Err(Error::NotConnected.into());
        }
        if self.is_called_by_this_thread() {
            // A signal handler within a call cannot wait for the end of that call.
            return Err(Error::MotionRunning.into());
        }
        let mut driver = held.unwrap_or_else(|| {
            calls.waiting.fetch_add(1, SeqCst);
            let driver = lock(&self.driver);
            calls.waiting.fetch_sub(1, SeqCst);
            driver
        });
        let driver = driver.as_mut().ok_or(Error::NotConnected)?;
        *lock(owner) = Some(thread::current().id());
        calls.handles_signals.store(handles_signals, SeqCst);
        calls.is_motion.store(stage == Stage::Wait, SeqCst);
        let mut result = act(driver).map_err(Failed::Driver);
        calls.is_motion.store(false, SeqCst);
        if calls.take_yielded() && result.is_err() {
            result = Err(Failed::Yielded);
        }
        if let Some(raised) = calls.take_raised() {
            // A second Ctrl-C must not prevent the stop, which has a time-out.
            calls.handles_signals.store(false, SeqCst);
            each!(driver, gripper => if stage != Stage::Query || gripper.motion().is_some() {
                let _ = gripper.stop();
            });
            result = Err(Failed::Raised(raised));
        }
        *lock(owner) = None;
        result
    }

    /// Begins a motion that was requested after `stops`, unless the gripper has been stopped since.
    pub(crate) fn begin<T>(
        &self,
        handles_signals: bool,
        stops: usize,
        act: impl FnOnce(&mut Driver) -> Result<T, Failure>,
    ) -> Result<T, Failed> {
        self.with_calls(None, handles_signals, Stage::Begin, |driver| {
            self.check_stops(stops)?;
            act(driver)
        })
    }

    /// Acknowledges a FAST STOP, unless the gripper has been stopped since `stops`.
    pub(crate) fn acknowledge(&self, handles_signals: bool, stops: usize) -> Result<(), Failed> {
        self.with(handles_signals, |driver| {
            self.check_stops(stops)?;
            each!(driver, gripper => gripper.acknowledge())
        })
    }

    /// Fails if the gripper was stopped while a request waited for the driver. The driver has reported the stop to the call that
    /// used it meanwhile, such as a subscription, and not to this one.
    fn check_stops(&self, stops: usize) -> Result<(), Failure> {
        if self.stops() == stops { Ok(()) } else { Err(Error::Stopped(StopKind::Stop)) }
    }

    /// Waits for the end of a motion that began after `stops`, and lets other requests pass.
    pub(crate) fn wait<T: MotionResult>(
        &self,
        handles_signals: bool,
        pending: &Pending<T>,
        stops: usize,
    ) -> Result<T, Failed> {
        loop {
            let wait = |driver: &mut Driver| each!(driver, gripper => gripper.wait(pending));
            match self.with_calls(None, handles_signals, Stage::Wait, wait) {
                Err(Failed::Yielded) => self.let_pass(),
                // The thread that stopped the gripper received the confirmation before this one.
                Err(Failed::Driver(Error::Aborted)) if self.stops() != stops => {
                    return Err(Error::Stopped(StopKind::Stop).into());
                }
                result => return result,
            }
        }
    }

    /// Lets the waiting requests pass.
    fn let_pass(&self) {
        while self.calls.waiting.load(SeqCst) > 0 {
            thread::yield_now();
        }
    }

    /// Registers a subscription. Returns whether there is no other one.
    pub(crate) fn begin_updates(&self, feed: &Arc<Feed>) -> Result<bool, Failed> {
        if !self.is_open() {
            return Err(Error::NotConnected.into());
        }
        let mut current = lock(&self.feed);
        let is_free = current.as_ref().is_none_or(|other| other.is_over());
        if is_free {
            *current = Some(Arc::clone(feed));
        }
        Ok(is_free)
    }

    /// Receives updates for a moment, and lets other requests pass. Returns whether the subscription continues.
    pub(crate) fn receive_updates(&self, feed: &Feed) -> bool {
        let receive = |driver: &mut Driver| each!(driver, gripper => feed.receive(gripper));
        if let Err(Failed::Driver(failure)) = self.with_calls(None, false, Stage::Wait, receive) {
            feed.end(Some(failure));
        }
        self.let_pass();
        feed.is_running()
    }

    /// Makes the gripper send no more updates.
    pub(crate) fn unsubscribe(&self, feed: &Feed) {
        // Without a connection there is nothing to end.
        let _ = self.with(false, |driver| each!(driver, gripper => feed.unsubscribe(gripper)));
    }

    /// Ends a subscription, with a failure unless its reader has closed it, and waits for the end.
    pub(crate) fn end_updates(&self, feed: &Feed, failure: Option<Failure>) {
        feed.end(failure);
        if self.is_foreign() || self.is_called_by_this_thread() {
            return;
        }
        if feed.is_pulled && !feed.is_over() {
            self.unsubscribe(feed);
            feed.set_over();
        }
        feed.wait_for_end();
    }

    /// Ends the subscription of this connection.
    fn end_own_updates(&self) {
        if self.is_foreign() {
            return;
        }
        let feed = lock(&self.feed).take();
        if let Some(feed) = feed {
            self.end_updates(&feed, Some(Error::NotConnected));
        }
    }

    /// Stops the fingers at once, even while another thread waits in a motion.
    pub(crate) fn stop(&self, handles_signals: bool, kind: StopKind) -> Result<(), Failed> {
        self.stops.fetch_add(1, SeqCst);
        self.confirm_stop(handles_signals, kind)
    }

    /// Waits until a stop that was requested before has its confirmation, and sends it again if necessary. Withdraws no requests that
    /// were made in the meantime.
    pub(crate) fn confirm_stop(&self, handles_signals: bool, kind: StopKind) -> Result<(), Failed> {
        if self.is_foreign() {
            return Err(Error::NotConnected.into());
        }
        // Kept until the stop, so that no other thread takes the driver first.
        let held = self.driver.try_lock().ok();
        let is_busy = held.is_none();
        if is_busy {
            // The driver repeats it if the line does not accept it now.
            let _ = self.hand_over(kind);
        }
        if is_busy && self.is_called_by_this_thread() {
            return Ok(());
        }
        // Returns once the stop is confirmed, whether it was sent by the handle or is sent here.
        self.with_calls(held, handles_signals, Stage::Query, |driver| match kind {
            StopKind::Stop => each!(driver, gripper => gripper.stop()),
            StopKind::FastStop => each!(driver, gripper => gripper.fast_stop()),
        })
    }

    /// Returns the number of stops that this program requested.
    pub(crate) fn stops(&self) -> usize {
        self.stops.load(SeqCst)
    }

    /// Sends a stop without waiting for its confirmation.
    pub(crate) fn send_stop(&self, kind: StopKind) -> std::io::Result<()> {
        self.stops.fetch_add(1, SeqCst);
        self.hand_over(kind)
    }

    fn hand_over(&self, kind: StopKind) -> std::io::Result<()> {
        match kind {
            StopKind::Stop => self.handle.stop(),
            StopKind::FastStop => self.handle.fast_stop(),
        }
    }

    /// Announces the end of the connection and closes it. Does nothing if it is closed.
    pub(crate) fn close(&self) {
        if self.is_foreign() || self.is_called_by_this_thread() {
            return;
        }
        self.end_own_updates();
        self.calls.waiting.fetch_add(1, SeqCst);
        let driver = lock(&self.driver).take();
        self.calls.waiting.fetch_sub(1, SeqCst);
        if let Some(mut driver) = driver {
            self.calls.handles_signals.store(false, SeqCst);
            // Lines other than TCP have nothing to announce, so the motion is stopped here.
            each!(&mut driver, gripper => {
                if gripper.motion().is_some() {
                    let _ = gripper.stop();
                }
                let _ = gripper.announce_disconnect();
            });
        }
    }

    /// Returns whether the driver is open and belongs to this process. Does not wait.
    pub(crate) fn is_open(&self) -> bool {
        // A driver that a thread uses is open.
        !self.is_foreign() && self.driver.try_lock().map_or(true, |driver| driver.is_some())
    }

    /// Returns whether another process opened the line.
    pub(crate) fn is_foreign(&self) -> bool {
        self.process != process()
    }

    fn is_called_by_this_thread(&self) -> bool {
        *lock(&self.owner) == Some(thread::current().id())
    }
}

impl Drop for Core {
    fn drop(&mut self) {
        if self.is_foreign() {
            // The parent still uses the connection, so a forked child must announce nothing.
            mem::forget(self.driver.get_mut().unwrap_or_else(PoisonError::into_inner).take());
        }
    }
}

impl Close for Core {
    fn close_at_exit(&self) {
        // They would keep the driver in use.
        self.end_own_updates();
        if !self.is_foreign() && self.driver.try_lock().is_err() {
            let _ = self.send_stop(StopKind::Stop);
        }
        self.close();
    }
}

/// Closes all open connections, at the end of the interpreter.
pub(crate) fn close_all() {
    let open = mem::take(&mut *lock(&OPEN));
    open.iter().filter_map(Weak::upgrade).for_each(|connection| connection.close_at_exit());
}
