//! I/O calls that signals cannot interrupt: an interrupted system call is repeated.
//!
//! Each repetition restarts its time-out, so frequent signals extend a wait, except in [`read_within`].
//!
//! With a time-out on a socket, stopping and continuing a process (debugger, shell job control, container freeze)
//! makes such a call return `Interrupted`, even without signal handlers. The standard library's `read_exact`,
//! `read_line`, `write_all`, `accept` and similar functions repeat the call themselves. The functions wrapped here do
//! not, so clippy rejects them everywhere else (`clippy.toml`).
#![allow(clippy::disallowed_methods, reason = "this crate wraps them")]

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

/// One end of a line between threads or programs: a Unix socket, or TCP on Windows, where the standard library has no Unix
/// sockets.
#[cfg(not(unix))]
pub type Socket = TcpStream;
/// One end of a line between threads or programs: a Unix socket, or TCP on Windows, where the standard library has no Unix
/// sockets.
#[cfg(unix)]
pub type Socket = std::os::unix::net::UnixStream;

/// Performs one `read`, which may be partial; 0 is the end.
///
/// ```
/// use std::io::{self, ErrorKind, Read};
///
/// /// A reader that is interrupted before each byte.
/// struct Nervous(u8);
///
/// impl Read for Nervous {
///     fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
///         self.0 += 1;
///         if self.0 % 2 == 1 {
///             return Err(ErrorKind::Interrupted.into());
///         }
///         buffer[0] = self.0;
///         Ok(1)
///     }
/// }
///
/// let (mut line, mut buffer) = (Nervous(0), [0; 8]);
/// assert_eq!((uninterrupted::read(&mut line, &mut buffer)?, buffer[0]), (1, 2));
/// assert_eq!((uninterrupted::read(&mut line, &mut buffer)?, buffer[0]), (1, 4));
/// # Ok::<(), io::Error>(())
/// ```
///
/// # Errors
/// Returns the errors of [`Read::read`] except `Interrupted`.
pub fn read(mut from: impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    again(|| from.read(buffer))
}

/// Performs one `write`, which may be partial.
///
/// # Errors
/// Returns the errors of [`Write::write`] except `Interrupted`.
pub fn write(mut to: impl Write, bytes: &[u8]) -> io::Result<usize> {
    again(|| to.write(bytes))
}

/// Performs one [`read`] without consuming the bytes.
///
/// # Errors
/// Returns the errors of [`TcpStream::peek`] except `Interrupted`.
pub fn peek(from: &TcpStream, buffer: &mut [u8]) -> io::Result<usize> {
    again(|| from.peek(buffer))
}

/// Receives a datagram. Returns its length and sender.
///
/// # Errors
/// Returns the errors of [`UdpSocket::recv_from`] except `Interrupted`.
pub fn recv_from(socket: &UdpSocket, buffer: &mut [u8]) -> io::Result<(usize, SocketAddr)> {
    again(|| socket.recv_from(buffer))
}

/// Sends a datagram.
///
/// # Errors
/// Returns the errors of [`UdpSocket::send_to`] except `Interrupted`.
pub fn send_to(socket: &UdpSocket, bytes: &[u8], to: SocketAddr) -> io::Result<usize> {
    again(|| socket.send_to(bytes, to))
}

/// Performs one `read` within `time`, which becomes the line's time-out; returns `None` if no byte arrived.
///
/// # Errors
/// Returns the errors of [`Read::read`] except `Interrupted` and the time-out.
pub fn read_within(line: &Socket, buffer: &mut [u8], time: Duration) -> io::Result<Option<usize>> {
    let end = Instant::now() + time;
    loop {
        // A time-out of 0 would disable it.
        let left = end.saturating_duration_since(Instant::now()).max(Duration::from_micros(1));
        line.set_read_timeout(Some(left))?;
        match (&*line).read(buffer) {
            Err(error) if error.kind() == ErrorKind::Interrupted && Instant::now() < end => {}
            Err(error) if is_over(&error) => return Ok(None),
            result => return result.map(Some),
        }
    }
}

/// Returns whether a read would return within `time`. Microseconds are honoured, unlike a socket's own time-out,
/// which has milliseconds.
///
/// # Errors
/// Returns the errors of `poll` except `Interrupted`.
pub fn is_readable_within(line: &Socket, time: Duration) -> io::Result<bool> {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let end = Instant::now() + time;
    loop {
        let left = end.saturating_duration_since(Instant::now());
        let left = Timespec::try_from(left).map_err(|_| ErrorKind::InvalidInput)?;
        match poll(&mut [PollFd::new(line, PollFlags::IN)], Some(&left)) {
            Err(rustix::io::Errno::INTR) if Instant::now() < end => {}
            Err(rustix::io::Errno::INTR) => return Ok(false),
            ready => return Ok(ready? > 0),
        }
    }
}

/// Returns whether a read with a time-out received nothing.
fn is_over(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

fn again<T>(mut call: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    loop {
        match call() {
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}
