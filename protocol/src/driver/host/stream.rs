//! A transport over anything that reads and writes.

use crate::driver::blocking::Transport;
use crate::driver::received::Received;
use core::time::Duration;
use embedded_io::{ErrorType, ReadReady};
use std::io::{self, ErrorKind};
use std::time::Instant;

/// Bytes read at a time.
const CHUNK_LEN: usize = 512;

/// For how long silence counts after a read that has found it.
const SILENCE: Duration = Duration::from_millis(10);

/// A transport over a byte stream that the operating system cannot wait for, such as a port of the crate `serialport`, or
/// any serial port on Windows. For all others [`PolledStream`](super::PolledStream) is better.
///
/// Its `read` must end with `TimedOut` or `WouldBlock` when no byte comes for about a millisecond, as that of a port with
/// `timeout(Duration::from_millis(1))`. That time-out is how late the driver sends and returns while it waits for a read: a
/// longer one delays it, and one of 0 has it spin. A write that takes nothing should end with `TimedOut`, too.
///
/// Over TCP use [`Tcp`](super::Tcp), which announces its end.
#[derive(Debug)]
pub struct Stream<T> {
    stream: T,
    received: Received<CHUNK_LEN>,
    /// When a read has found silence, or the driver has taken the last byte.
    silent_at: Option<Instant>,
}

impl<T: io::Read + io::Write> Stream<T> {
    /// A transport over this stream.
    #[must_use]
    pub const fn new(stream: T) -> Self {
        Self { stream, received: Received::new(), silent_at: None }
    }
}

impl<T> Stream<T> {
    /// The stream. Bytes that were received and not taken by the driver are lost.
    #[must_use]
    pub fn into_inner(self) -> T {
        self.stream
    }
}

impl<T> ErrorType for Stream<T> {
    type Error = io::Error;
}

impl<T: io::Read> Stream<T> {
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

impl<T: io::Read> ReadReady for Stream<T> {
    /// Waits as long as a read of the stream does, unless the last one is only just over.
    fn read_ready(&mut self) -> io::Result<bool> {
        if self.received.is_empty() && self.silent_at.is_some_and(|at| at.elapsed() < SILENCE) {
            return Ok(false);
        }
        self.fill()
    }
}

impl<T: io::Read> embedded_io::Read for Stream<T> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.fill()? {}
        Ok(self.received.take(buffer))
    }
}

impl<T: io::Read + io::Write> Transport for Stream<T> {
    /// Waits as long as a read of the stream does.
    fn wait(&mut self, _at_most_ms: u32) -> io::Result<()> {
        self.fill().map(|_| ())
    }
}

impl<T: io::Write> embedded_io::Write for Stream<T> {
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
