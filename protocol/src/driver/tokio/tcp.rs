//! A TCP transport that announces the end of its connection.

use super::Stream;
use crate::driver::farewell::{Farewell, LINGER, linger};
use crate::driver::readiness::duplicate;
use crate::driver::{StopLine, Stoppable, host, second};
use crate::frame::OVERHEAD;
use core::pin::Pin;
use core::task::{Context, Waker};
use core::time::Duration;
use embedded_io_async::ErrorType;
use std::io::{self, ErrorKind};
use tokio::io::AsyncWrite;
use tokio::net::{TcpStream, ToSocketAddrs, lookup_host};

/// A TCP connection to a gripper, for either protocol. The binary protocol uses port 1000.
///
/// Dropping it, alone or with a future, announces the end of the connection, like [the blocking version](host::Tcp). A
/// short-lived thread waits for the gripper to close its end.
#[derive(Debug)]
pub struct Tcp {
    stream: Stream<TcpStream>,
    farewell: Farewell,
}

impl Tcp {
    /// Time-out of [`connect`](Self::connect) for each address.
    pub const CONNECT_TIMEOUT: Duration = host::Tcp::CONNECT_TIMEOUT;

    /// Connects to the first reachable address, such as `"192.168.1.20:1000"`.
    ///
    /// # Errors
    /// Returns the error for the last address.
    pub async fn connect(address: impl ToSocketAddrs) -> io::Result<Self> {
        let mut result =
            Err(io::Error::new(ErrorKind::AddrNotAvailable, "the name does not resolve to an address"));
        for address in lookup_host(address).await? {
            let connecting = tokio::time::timeout(Self::CONNECT_TIMEOUT, TcpStream::connect(address));
            result = connecting.await.unwrap_or_else(|_| Err(ErrorKind::TimedOut.into()));
            if result.is_ok() {
                break;
            }
        }
        Self::new(result?)
    }

    /// Creates a transport over an existing connection.
    ///
    /// # Errors
    /// Returns the error if the socket options cannot be set.
    pub fn new(stream: TcpStream) -> io::Result<Self> {
        // Each frame is one segment, sent immediately.
        stream.set_nodelay(true)?;
        Ok(Self { stream: Stream::new(stream), farewell: Farewell::default() })
    }
}

impl ErrorType for Tcp {
    type Error = io::Error;
}

impl embedded_io_async::Read for Tcp {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.stream.read(buffer).await
    }
}

impl embedded_io_async::Write for Tcp {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.stream.write(bytes).await?;
        self.farewell.note(bytes);
        Ok(count)
    }

    async fn flush(&mut self) -> io::Result<()> {
        self.stream.flush().await
    }
}

impl Stoppable for Tcp {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        let second = duplicate(self.stream.get_mut())?;
        Ok(StopLine::new(second::tcp(second, self.farewell.clone()), || {}))
    }
}

impl Drop for Tcp {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        let mut buffer = [0; OVERHEAD];
        let Some(message) = self.farewell.due(&mut buffer) else { return };
        let stream = self.stream.get_mut();
        // A single attempt without waiting. There is no caller to report an error to.
        if stream.try_write(message).is_ok() {
            let _ = Pin::new(&mut *stream).poll_shutdown(&mut Context::from_waker(Waker::noop()));
            // The runtime must not block.
            if let Ok(second) = duplicate(stream) {
                let _ = std::thread::Builder::new().spawn(move || linger(&second.into(), LINGER));
            }
        }
    }
}
