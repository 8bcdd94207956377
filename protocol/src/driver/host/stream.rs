//! A transport over anything that reads and writes.

use crate::driver::blocking::Transport;
use crate::driver::received::Received;
use crate::driver::{StopLine, Stoppable};
use core::time::Duration;
use embedded_io::{ErrorType, ReadReady};
use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Bytes read at a time.
const CHUNK_LEN: usize = 512;

/// For how long silence counts after a read that has found it.
const SILENCE: Duration = Duration::from_millis(10);

/// A transport over a byte stream that the operating system cannot wait for, such as a port of the crate `serialport`, or
/// any serial port on Windows. For all others [`PolledStream`](super::PolledStream) is better.
///
/// Its `read` must end with `TimedOut` or `WouldBlock` when no byte arrives for about a millisecond, as that of a port with
/// `timeout(Duration::from_millis(1))`. The driver sends and returns that much later while it waits for a read: a longer
/// time-out delays it, and with a time-out of 0 it spins. A write that takes nothing should end with `TimedOut` as well.
///
/// Over TCP use [`Tcp`](super::Tcp), which announces its end.
#[derive(Debug)]
pub struct Stream<T, S = NoSecond> {
    stream: T,
    received: Received<CHUNK_LEN>,
    /// When a read found silence, or the driver took the last byte.
    silent_at: Option<Instant>,
    second: S,
}

/// The second handle of a [`Stream`] without a stop handle.
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
    /// Creates a transport whose gripper another thread can stop ([`StopHandle`](crate::driver::StopHandle)). `second`
    /// writes to the same port, such as the result of the port's `try_clone`. A stop waits for as long as a read of `stream`
    /// where the port allows one operation at a time, and for as long as a write of `second` when the port takes no bytes.
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
        // A read ends by itself soon, so nothing has to wake the driver.
        Ok(StopLine::new(write, || {}))
    }
}

impl<T, S> Stream<T, S> {
    /// The stream. Bytes that were received and not taken by the driver are lost.
    #[must_use]
    pub fn into_inner(self) -> T {
        self.stream
    }
}

impl<T, S> ErrorType for Stream<T, S> {
    type Error = io::Error;
}

impl<T: io::Read, S> Stream<T, S> {
    /// Reads, unless there is something to take already; whether there is now.
    fn fill(&mut self) -> io::Result<bool> {
        let Self { stream, received, .. } = self;
        #[expect(
            clippy::disallowed_methods,
            reason = "a signal is taken for silence, and the driver asks again"
        )]
        let is_filled = received.fill(|buffer| io::Read::read(stream, buffer))?;
        self.silent_at = (!is_filled || self.received.len() < CHUNK_LEN).then(Instant::now);
        Ok(is_filled)
    }
}

impl<T: io::Read, S> ReadReady for Stream<T, S> {
    /// Waits as long as a read of the stream does, unless the last one is only just over.
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
    /// Waits as long as a read of the stream does.
    fn wait(&mut self, _at_most_ms: u32) -> io::Result<()> {
        self.fill().map(|_| ())
    }
}

impl<T: io::Write, S> embedded_io::Write for Stream<T, S> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            #[expect(
                clippy::disallowed_methods,
                reason = "the call is made again; the driver sends the rest"
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
