//! A second write path to the socket or port of a transport, for a stop handle.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, TcpStream, UdpSocket};

use super::farewell::Farewell;
use super::readiness::{AsPollable, Owned, is_writable};

/// Writes only if the source is ready, so that the call returns immediately.
fn if_writable<S: AsPollable>(source: &S, write: impl FnOnce(&S) -> io::Result<usize>) -> io::Result<usize> {
    if is_writable(source)? { write(source) } else { Err(ErrorKind::WouldBlock.into()) }
}

/// Creates a write path to a TCP connection and records each message in its farewell.
pub(super) fn tcp(second: Owned, farewell: Farewell) -> impl Fn(&[u8]) -> io::Result<usize> {
    let socket = TcpStream::from(second);
    move |bytes| {
        #[expect(clippy::disallowed_methods, reason = "the handle calls it again")]
        let count = if_writable(&socket, |mut socket| io::Write::write(&mut socket, bytes))?;
        farewell.note(bytes);
        Ok(count)
    }
}

/// Creates a write path to a gripper on UDP.
pub(super) fn udp(second: Owned, gripper: SocketAddr) -> impl Fn(&[u8]) -> io::Result<usize> {
    let socket = UdpSocket::from(second);
    move |bytes| {
        #[expect(clippy::disallowed_methods, reason = "the handle calls it again")]
        if_writable(&socket, |socket| socket.send_to(bytes, gripper))
    }
}

/// Creates a write path to any source with a descriptor.
pub(super) fn stream(second: Owned) -> impl Fn(&[u8]) -> io::Result<usize> {
    #[cfg(unix)]
    let second = std::fs::File::from(second);
    // On Windows, a descriptor is a socket.
    #[cfg(windows)]
    let second = TcpStream::from(second);
    move |bytes| {
        #[expect(clippy::disallowed_methods, reason = "the handle calls it again")]
        if_writable(&second, |mut second| io::Write::write(&mut second, bytes))
    }
}
