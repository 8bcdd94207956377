//! The line of a driver and its clock, over any transport or in virtual time.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use embedded_io::{ErrorType, Read, ReadReady, Write};
use pyo3::prelude::*;
use wsg_protocol::driver::blocking::Transport;
use wsg_protocol::driver::{self, StopLine, Stoppable};
use wsg_sim::VirtualRig;
use wsg_tool::Wire;

use crate::interpreter::try_attach;

/// Interval at which a waiting call handles Python's signals, and with them Ctrl-C.
const SIGNALS: Duration = Duration::from_millis(50);
/// Longest wait of a motion before it lets the requests of other threads pass, in ms.
const YIELD_MS: u32 = 5;

/// The state that the callers of a driver share with its line.
#[derive(Default)]
pub(crate) struct Calls {
    /// Whether the running call handles signals. Cleared while the fingers are being stopped.
    pub(crate) handles_signals: AtomicBool,
    /// Whether the running call is a motion, which lets other requests pass.
    pub(crate) is_motion: AtomicBool,
    /// Number of threads that wait for the driver.
    pub(crate) waiting: AtomicUsize,
    /// Whether the running call ended to let other requests pass.
    has_yielded: AtomicBool,
    /// The exception that a signal handler raised, such as `KeyboardInterrupt`.
    raised: Mutex<Option<PyErr>>,
}

impl Calls {
    /// Returns whether the running call ended to let other requests pass.
    pub(crate) fn take_yielded(&self) -> bool {
        self.has_yielded.swap(false, SeqCst)
    }

    /// Returns the exception of a signal handler.
    pub(crate) fn take_raised(&self) -> Option<PyErr> {
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Runs the handlers of pending signals. Fails if one raised an exception.
    fn handle_signals(&self) -> io::Result<()> {
        // There is nothing to handle once the interpreter has ended.
        let Some(Err(raised)) = try_attach(|py| py.check_signals()) else { return Ok(()) };
        *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(raised);
        Err(io::Error::other("a signal handler raised an exception"))
    }
}

/// A transport that handles signals while it waits.
pub(crate) struct Line {
    wire: Box<dyn Wire>,
    calls: Arc<Calls>,
    handled_at: Instant,
}

impl Line {
    pub(crate) fn new(wire: Box<dyn Wire>, calls: Arc<Calls>) -> Self {
        Self { wire, calls, handled_at: Instant::now() }
    }
}

impl ErrorType for Line {
    type Error = io::Error;
}

impl Transport for Line {
    fn wait(&mut self, at_most_ms: u32) -> io::Result<()> {
        let is_motion = self.calls.is_motion.load(SeqCst);
        let handles_signals = self.calls.handles_signals.load(SeqCst);
        let most = if is_motion {
            YIELD_MS
        } else if handles_signals {
            SIGNALS.as_millis() as u32
        } else {
            u32::MAX
        };
        self.wire.wait(at_most_ms.min(most))?;
        if handles_signals && self.handled_at.elapsed() >= SIGNALS {
            self.handled_at = Instant::now();
            self.calls.handle_signals()?;
        }
        if is_motion && self.calls.waiting.load(SeqCst) > 0 {
            self.calls.has_yielded.store(true, SeqCst);
            return Err(io::Error::other("another request is waiting"));
        }
        Ok(())
    }
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> io::Result<bool> {
        self.wire.read_ready()
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.wire.read(buffer)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.wire.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.wire.flush()
    }
}

impl Stoppable for Line {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        self.wire.stop_line()
    }
}

/// The line to a virtual gripper, and whether it is in use. It ends its connection when it is dropped.
pub(crate) struct VirtualWire(pub(crate) VirtualRig, pub(crate) Arc<AtomicBool>);

impl Drop for VirtualWire {
    fn drop(&mut self) {
        self.0.close_line();
        self.1.store(false, SeqCst);
    }
}

impl ErrorType for VirtualWire {
    type Error = io::Error;
}

impl Transport for VirtualWire {
    fn wait(&mut self, at_most_ms: u32) -> io::Result<()> {
        self.0.wait(at_most_ms).map_err(|never| match never {})
    }
}

impl ReadReady for VirtualWire {
    fn read_ready(&mut self) -> io::Result<bool> {
        self.0.read_ready().map_err(|never| match never {})
    }
}

impl Read for VirtualWire {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer).map_err(|never| match never {})
    }
}

impl Write for VirtualWire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes).map_err(|never| match never {})
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Stoppable for VirtualWire {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        self.0.stop_line()
    }
}

/// The clock of a driver.
#[derive(Clone, Debug)]
pub(crate) enum Clock {
    /// Monotonic time since this instant.
    Real(Instant),
    /// The time of a virtual gripper.
    Virtual(VirtualRig),
}

impl driver::Clock for Clock {
    fn now(&mut self) -> wsg_protocol::Instant {
        match self {
            // A driver's clock may wrap, so the low 32 bits suffice.
            Self::Real(start) => wsg_protocol::Instant::from_millis(start.elapsed().as_millis() as u32),
            Self::Virtual(rig) => driver::Clock::now(rig),
        }
    }
}
