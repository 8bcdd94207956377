//! The two ends of a line between threads, and ports for programs.

use std::io;
use std::net::{TcpListener, UdpSocket};
use std::process::id;
use std::sync::atomic::{AtomicU16, Ordering};

pub use uninterrupted::Socket;

/// Returns a port of 127.0.0.1 that is free for TCP and UDP, for a program that binds it later. The system gives ports from 32768 on to any program
/// that asks for one, so this one is below.
///
/// # Panics
/// Panics when no port is free.
#[must_use]
pub fn free_port() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    // Programs at the same time begin at different ports.
    let first = (id() % 100 * 100) as u16;
    let mut ports = (0..10_000).map(|_| 20_000 + (first + NEXT.fetch_add(1, Ordering::Relaxed)) % 10_000);
    let is_free = |port: &u16| {
        let address = ("127.0.0.1", *port);
        TcpListener::bind(address).is_ok() && UdpSocket::bind(address).is_ok()
    };
    ports.find(is_free).expect("a port is free")
}

/// Returns the two ends of a line.
///
/// # Errors
/// Fails when the system creates no socket, and on Windows when another program connects to it first.
#[cfg(unix)]
pub fn pair() -> io::Result<(Socket, Socket)> {
    Socket::pair()
}

/// Returns the two ends of a line.
///
/// # Errors
/// Fails when the system creates no socket, or another program connects to it first.
#[cfg(not(unix))]
pub fn pair() -> io::Result<(Socket, Socket)> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let near = Socket::connect(listener.local_addr()?)?;
    let (far, peer) = listener.accept()?;
    if peer != near.local_addr()? {
        return Err(io::Error::other("another program has connected to a line of this one"));
    }
    near.set_nodelay(true)?;
    far.set_nodelay(true)?;
    Ok((near, far))
}
