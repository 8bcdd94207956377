//! Accepting connections, also while the system has no descriptor left for another one.

use std::future::poll_fn;
use std::io;
use std::net::SocketAddr;
use std::task::Poll;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::sleep;

/// How long no connection is accepted after the system refused one, so that a lasting error costs no processor time.
const RECOVERY: Duration = Duration::from_millis(100);

/// A connection, or one that there is no room for.
#[derive(Debug)]
pub(super) enum Accepted {
    /// To be served.
    Client(TcpStream, SocketAddr),
    /// To be refused at once: its descriptor is the last one.
    Refused(TcpStream),
}

/// A listener with a descriptor in reserve. Without one, connections that find no descriptor would wait in the system's queue, and
/// their clients with them.
#[derive(Debug)]
pub(super) struct Acceptor {
    listener: TcpListener,
    /// The listener once more: a descriptor that takes nothing else.
    reserve: Option<socket2::Socket>,
}

impl Acceptor {
    pub(super) fn new(listener: TcpListener) -> Self {
        let mut acceptor = Self { listener, reserve: None };
        acceptor.keep_reserve();
        acceptor
    }

    /// The next connection. Lasts through every error of the system.
    pub(super) async fn accept(&mut self) -> Accepted {
        loop {
            self.keep_reserve();
            if let Ok((stream, peer)) = self.listener.accept().await {
                return Accepted::Client(stream, peer);
            }
            // For want of descriptors, probably: the system says so even if nobody waits to be accepted. The free descriptor is
            // used at once, or kept again, before another port can take it.
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

    /// A connection that waits already.
    async fn accept_at_once(&self) -> Poll<io::Result<(TcpStream, SocketAddr)>> {
        poll_fn(|context| Poll::Ready(self.listener.poll_accept(context))).await
    }

    fn keep_reserve(&mut self) {
        if self.reserve.is_none() {
            self.reserve = socket2::SockRef::from(&self.listener).try_clone().ok();
        }
    }
}

/// The next connection of a listener that has no reserve, such as one on a Unix socket: its clients wait while there is no descriptor.
#[cfg(unix)]
pub(super) async fn insist<T, F: Future<Output = io::Result<T>>>(mut accept: impl FnMut() -> F) -> T {
    loop {
        match accept().await {
            Ok(accepted) => return accepted,
            Err(_) => sleep(RECOVERY).await,
        }
    }
}
