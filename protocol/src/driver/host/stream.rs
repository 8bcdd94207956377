//! A transport over any byte stream.

use crate::driver::blocking::Transport;
use crate::driver::received::Received;
use crate::driver::{StopLine, Stoppable};
use core::time::Duration;
use embedded_io::{ErrorType, ReadReady};
use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Number of bytes per read.
const CHUNK_LEN: usize = 512;

/// Time after an empty read during which no further read is attempted.
const SILENCE: Duration = Duration::from_millis(10);

/// A transport over a byte stream whose readiness the operating system does not report, such as a port of the crate
/// `serialport`, or any serial port on Windows. Prefer [`PolledStream`](super::PolledStream) for all others.
///
/// Its `read` must fail with `TimedOut` or `WouldBlock` when no byte arrives for about a millisecond, as with a port
/// with `timeout(Duration::from_millis(1))`. This time-out delays the driver's sending and returning, and 0 makes it
/// spin. A blocked write should also fail with `TimedOut`.
///
/// For TCP use [`Tcp`](super::Tcp), which announces its end.
#[derive(Debug)]
pub struct Stream<T, S = NoSecond> {
    stream: T,
    received: Received<CHUNK_LEN>,
    /// Time at which a read found no input, or at which the driver took the last byte.
    silent_at: Option<Instant>,
    second: S,
}

/// Placeholder for the second handle of a [`Stream`] without a stop handle.
#[derive(Clone, Copy, Debug)]
pub struct NoSecond;

impl<T: io::Read + io::Write> Stream<T> {
    /// Creates a transport over this stream.
    #[must_use]
    pub const fn new(stream: T) -> Self {
        Self { stream, received: Received::new(), silent_at: None, second: NoSecond }
    }
}

impl<T: io::Read + io::Write, W: io::Write + Send + 'static> Stream<T, Arc<Mutex<W>>> {
    /// Creates a transport whose gripper can be stopped from another thread
    /// ([`StopHandle`](crate::driver::StopHandle)). `second` writes to the same port, such as the result of the port's
    /// `try_clone`. A stop waits for a read of `stream` if the port allows one operation at a time, and for a write of
    /// `second` if the port accepts no bytes.
    ///
    /// ```no_run
    /// use std::time::Duration;
    /// use wsg_protocol::driver::blocking::Gripper;
    /// use wsg_protocol::driver::host::{StdClock, Stream};
    ///
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// let port = serialport::new("COM3", 115_200).timeout(Duration::from_millis(1)).open()?;
    /// let second = port.try_clone()?;
    /// let mut gripper = Gripper::new(Stream::with_second(port, second), StdClock::new());
    /// let stop = gripper.stop_handle()?;
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn with_second(stream: T, second: W) -> Self {
        Self { stream, received: Received::new(), silent_at: None, second: Arc::new(Mutex::new(second)) }
    }
}

impl<T, W: io::Write + Send + 'static> Stoppable for Stream<T, Arc<Mutex<W>>> {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        let second = Arc::clone(&self.second);
        let write = move |bytes: &[u8]| {
            let mut second = second.lock().unwrap_or_else(PoisonError::into_inner);
            #[expect(clippy::disallowed_methods, reason = "the handle calls it again")]
            match io::Write::write(&mut *second, bytes) {
                Err(error) if error.kind() == ErrorKind::TimedOut => Err(ErrorKind::WouldBlock.into()),
                written => written,
            }
        };
        // A read ends soon, so the driver need not be woken.
        Ok(StopLine::new(write, || {}))
    }
}

impl<T, S> Stream<T, S> {
    /// Returns the stream. Received bytes that the driver has not yet taken are lost.
    #[must_use]
    pub fn into_inner(self) -> T {
        self.stream
    }
}

impl<T, S> ErrorType for Stream<T, S> {
    type Error = io::Error;
}

impl<T: io::Read, S> Stream<T, S> {
    /// Reads unless bytes are already buffered. Returns whether there are any.
    fn fill(&mut self) -> io::Result<bool> {
        let Self { stream, received, .. } = self;
        #[expect(clippy::disallowed_methods, reason = "a signal counts as no input, and the driver retries")]
        let is_filled = received.fill(|buffer| io::Read::read(stream, buffer))?;
        self.silent_at = (!is_filled || self.received.len() < CHUNK_LEN).then(Instant::now);
        Ok(is_filled)
    }
}

impl<T: io::Read, S> ReadReady for Stream<T, S> {
    /// Waits for one read of the stream, unless the last one has just ended.
    fn read_ready(&mut self) -> io::Result<bool> {
        if self.received.is_empty() && self.silent_at.is_some_and(|at| at.elapsed() < SILENCE) {
            return Ok(false);
        }
        self.fill()
    }
}

impl<T: io::Read, S> embedded_io::Read for Stream<T, S> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.fill()? {}
        Ok(self.received.take(buffer))
    }
}

impl<T: io::Read + io::Write, S> Transport for Stream<T, S> {
    /// Waits for one read of the stream.
    fn wait(&mut self, _at_most_ms: u32) -> io::Result<()> {
        self.fill().map(|_| ())
    }
}

impl<T: io::Write, S> embedded_io::Write for Stream<T, S> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            #[expect(
                clippy::disallowed_methods,
                reason = "the driver repeats the call with the remaining bytes"
            )]
            match io::Write::write(&mut self.stream, bytes) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                result => return result,
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        io::Write::flush(&mut self.stream)
    }
}
