//! A transport over anything that reads and writes.

use crate::driver::readiness::{AsPollable, duplicate};
use crate::driver::{StopLine, Stoppable, second};
use core::future::poll_fn;
use core::pin::Pin;
use core::task::{Poll, ready};
use embedded_io_async::ErrorType;
use std::io;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// A transport over a byte stream of tokio's traits: a port of the crate `tokio-serial`, a Unix socket. Its reads and
/// writes may be given up, as the driver asks.
///
/// Over TCP use [`Tcp`](super::Tcp), which announces its end.
#[derive(Debug)]
pub struct Stream<T> {
    stream: T,
}

impl<T: AsyncRead + AsyncWrite + Unpin> Stream<T> {
    /// A transport over this stream.
    #[must_use]
    pub const fn new(stream: T) -> Self {
        Self { stream }
    }
}

impl<T> Stream<T> {
    /// The stream.
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

/// On Unix of any stream with a file descriptor, on Windows of a socket.
impl<T: AsPollable> Stoppable for Stream<T> {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        Ok(StopLine::new(second::stream(duplicate(&self.stream)?), || {}))
    }
}
