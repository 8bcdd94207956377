//! A transport over any byte stream.

use crate::driver::readiness::{AsPollable, duplicate};
use crate::driver::{StopLine, Stoppable, second};
use core::future::poll_fn;
use core::pin::Pin;
use core::task::{Poll, ready};
use embedded_io_async::ErrorType;
use std::io;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// A transport over a byte stream with tokio's traits, such as a port of the crate `tokio-serial` or a Unix socket. Its
/// reads and writes are cancel-safe, as the driver requires.
///
/// For TCP use [`Tcp`](super::Tcp), which announces its end.
#[derive(Debug)]
pub struct Stream<T> {
    stream: T,
}

impl<T: AsyncRead + AsyncWrite + Unpin> Stream<T> {
    /// Creates a transport over this stream.
    #[must_use]
    pub const fn new(stream: T) -> Self {
        Self { stream }
    }
}

impl<T> Stream<T> {
    /// Returns the stream and drops the transport.
    #[must_use]
    pub fn into_inner(self) -> T {
        self.stream
    }

    pub(super) const fn get_mut(&mut self) -> &mut T {
        &mut self.stream
    }
}

impl<T> ErrorType for Stream<T> {
    type Error = io::Error;
}

impl<T: AsyncRead + Unpin> embedded_io_async::Read for Stream<T> {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        poll_fn(|context| {
            let mut buffer = ReadBuf::new(buffer);
            ready!(Pin::new(&mut self.stream).poll_read(context, &mut buffer))?;
            Poll::Ready(Ok(buffer.filled().len()))
        })
        .await
    }
}

impl<T: AsyncWrite + Unpin> embedded_io_async::Write for Stream<T> {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        poll_fn(|context| Pin::new(&mut self.stream).poll_write(context, bytes)).await
    }

    async fn flush(&mut self) -> io::Result<()> {
        poll_fn(|context| Pin::new(&mut self.stream).poll_flush(context)).await
    }
}

/// On Unix for any stream with a file descriptor, on Windows for a socket.
impl<T: AsPollable> Stoppable for Stream<T> {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        Ok(StopLine::new(second::stream(duplicate(&self.stream)?), || {}))
    }
}
