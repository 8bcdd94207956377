//! A transport over anything that reads and writes.

use crate::driver::received::Received;
use embedded_io::{ErrorType, ReadReady};
use std::io::{self, ErrorKind};

/// Bytes read at a time.
const CHUNK_LEN: usize = 512;

/// A transport over a byte stream of the standard library's traits: a port of the crate `serialport`, a Unix socket.
///
/// Its `read` must end with `TimedOut` or `WouldBlock` when no byte comes for about a millisecond, as that of a port with
/// `timeout(Duration::from_millis(1))`, or of a socket with `set_read_timeout`. A read that waits without an end would
/// keep the driver from sending; one that does not wait has it spin. A write that takes nothing should end with
/// `TimedOut`, too.
///
/// Over TCP use [`Tcp`](super::Tcp), which announces its end.
#[derive(Debug)]
pub struct Stream<T> {
    stream: T,
    received: Received<CHUNK_LEN>,
}

impl<T: io::Read + io::Write> Stream<T> {
    /// A transport over this stream.
    #[must_use]
    pub const fn new(stream: T) -> Self {
        Self { stream, received: Received::new() }
    }
}

impl<T> Stream<T> {
    /// The stream. Bytes that were received and not taken by the driver are lost.
    #[must_use]
    pub fn into_inner(self) -> T {
        self.stream
    }

    pub(super) const fn get_ref(&self) -> &T {
        &self.stream
    }
}

impl<T> ErrorType for Stream<T> {
    type Error = io::Error;
}

impl<T: io::Read> ReadReady for Stream<T> {
    /// Waits as long as a read of the stream does.
    fn read_ready(&mut self) -> io::Result<bool> {
        let Self { stream, received } = self;
        #[expect(
            clippy::disallowed_methods,
            reason = "a signal is taken for silence, and the driver asks again"
        )]
        received.fill(|buffer| io::Read::read(stream, buffer))
    }
}

impl<T: io::Read> embedded_io::Read for Stream<T> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.read_ready()? {}
        Ok(self.received.take(buffer))
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
