//! A transport over a byte stream whose readiness the operating system reports.

use crate::driver::blocking::Transport;
use crate::driver::readiness::{AsPollable, LONG_MS, Readiness, duplicate};
use crate::driver::received::Received;
use crate::driver::{StopLine, Stoppable, second};
use embedded_io::{ErrorType, ReadReady};
use std::io::{self, ErrorKind};

/// Number of bytes per read.
const CHUNK_LEN: usize = 512;

/// A transport over a byte stream whose readiness the operating system reports. On Unix this is any stream with a file
/// descriptor, such as a serial port of the crate `serial2` or a Unix socket. On Windows it is a TCP socket.
///
/// It reads only available bytes, so the stream's read time-out is irrelevant. A blocked write should fail with
/// `TimedOut` after a while.
///
/// For TCP use [`Tcp`](super::Tcp), which announces its end. For streams without a file descriptor use
/// [`Stream`](super::Stream).
#[derive(Debug)]
pub struct PolledStream<T> {
    stream: T,
    received: Received<CHUNK_LEN>,
    readiness: Readiness,
}

impl<T: io::Read + io::Write + AsPollable> PolledStream<T> {
    /// Creates a transport over this stream.
    #[must_use]
    pub const fn new(stream: T) -> Self {
        Self { stream, received: Received::new(), readiness: Readiness::new() }
    }
}

impl<T> PolledStream<T> {
    /// Returns the stream. Received bytes that the driver has not yet taken are lost.
    #[must_use]
    pub fn into_inner(self) -> T {
        self.stream
    }

    pub(super) const fn get_ref(&self) -> &T {
        &self.stream
    }

    pub(super) const fn readiness(&mut self) -> &mut Readiness {
        &mut self.readiness
    }
}

impl<T> ErrorType for PolledStream<T> {
    type Error = io::Error;
}

impl<T: io::Read + AsPollable> ReadReady for PolledStream<T> {
    fn read_ready(&mut self) -> io::Result<bool> {
        let Self { stream, received, readiness } = self;
        if !received.is_empty() {
            return Ok(true);
        }
        if !readiness.may_read(stream)? {
            return Ok(false);
        }
        #[expect(clippy::disallowed_methods, reason = "a signal counts as no input, and the driver retries")]
        let is_filled = received.fill(|buffer| io::Read::read(stream, buffer))?;
        if received.len() < CHUNK_LEN {
            readiness.is_emptied();
        }
        Ok(is_filled)
    }
}

impl<T: io::Read + AsPollable> embedded_io::Read for PolledStream<T> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.read_ready()? {
            self.readiness.wait(&self.stream, LONG_MS)?;
        }
        Ok(self.received.take(buffer))
    }
}

impl<T: io::Write> embedded_io::Write for PolledStream<T> {
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

impl<T: io::Read + io::Write + AsPollable> Transport for PolledStream<T> {
    fn wait(&mut self, at_most_ms: u32) -> io::Result<()> {
        if !self.received.is_empty() {
            return Ok(());
        }
        self.readiness.wait(&self.stream, at_most_ms)
    }
}

impl<T: AsPollable> Stoppable for PolledStream<T> {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        let waker = self.readiness.waker()?;
        Ok(StopLine::new(second::stream(duplicate(&self.stream)?), move || waker.wake()))
    }
}
