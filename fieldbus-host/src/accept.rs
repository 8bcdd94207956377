//! Accepts connections even while the system has no file descriptor left.

use std::future::poll_fn;
use std::io;
use std::net::SocketAddr;
use std::task::Poll;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::sleep;

/// Pause after the system refused a connection, so that a lasting error does not use up processor time.
const RECOVERY: Duration = Duration::from_millis(100);

/// An accepted connection, or one to be rejected.
#[derive(Debug)]
pub enum Accepted {
    /// A client to serve.
    Client(TcpStream, SocketAddr),
    /// A connection to reject immediately, because it uses the last descriptor.
    Refused(TcpStream),
}

/// A listener with a reserve descriptor. Without the reserve, connections would wait in the system's queue while no
/// descriptor is available, and their clients with them.
#[derive(Debug)]
pub struct Acceptor {
    listener: TcpListener,
    /// A duplicate of the listener, which occupies a descriptor and accepts nothing.
    reserve: Option<socket2::Socket>,
}

impl Acceptor {
    /// Creates an acceptor for this listener.
    #[must_use]
    pub fn new(listener: TcpListener) -> Self {
        let mut acceptor = Self { listener, reserve: None };
        acceptor.keep_reserve();
        acceptor
    }

    /// Returns the next connection. Continues after every error of the system.
    pub async fn accept(&mut self) -> Accepted {
        loop {
            self.keep_reserve();
            if let Ok((stream, peer)) = self.listener.accept().await {
                return Accepted::Client(stream, peer);
            }
            // The probable cause is a lack of descriptors, which the system reports even without a pending connection.
            // The freed descriptor is used or reserved again before another port can take it.
            let has_reserve = self.reserve.take().is_some();
            match self.accept_at_once().await {
                Poll::Ready(Ok((stream, _))) => return Accepted::Refused(stream),
                Poll::Pending if has_reserve => {}
                Poll::Pending | Poll::Ready(Err(_)) => {
                    self.keep_reserve();
                    sleep(RECOVERY).await;
                }
            }
        }
    }

    /// Returns a pending connection without waiting.
    async fn accept_at_once(&self) -> Poll<io::Result<(TcpStream, SocketAddr)>> {
        poll_fn(|context| Poll::Ready(self.listener.poll_accept(context))).await
    }

    fn keep_reserve(&mut self) {
        if self.reserve.is_none() {
            self.reserve = socket2::SockRef::from(&self.listener).try_clone().ok();
        }
    }
}

/// Returns the next connection of a listener without a reserve, such as a Unix socket. Clients wait while there is no descriptor.
#[cfg(unix)]
pub async fn insist<T, F: Future<Output = io::Result<T>>>(mut accept: impl FnMut() -> F) -> T {
    loop {
        match accept().await {
            Ok(accepted) => return accepted,
            Err(_) => sleep(RECOVERY).await,
        }
    }
}
