//! The two ends of a line between threads.

use std::io;

pub use uninterrupted::Socket;

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
    let listener = std::net::TcpListener::bind("127.0.0.1:0")?;
    let near = Socket::connect(listener.local_addr()?)?;
    let (far, peer) = listener.accept()?;
    if peer != near.local_addr()? {
        return Err(io::Error::other("another program has connected to a line of this one"));
    }
    near.set_nodelay(true)?;
    far.set_nodelay(true)?;
    Ok((near, far))
}
