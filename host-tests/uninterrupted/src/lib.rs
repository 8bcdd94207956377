//! Reads that a signal cannot fail: a system call that it interrupts is made again.
//!
//! Each call has its own time-out, so many signals make a wait longer; [`read_within`] has a bound that they leave alone.
//!
//! With a time-out on a socket, a process that was merely stopped and continued (a debugger, a job of a shell, a frozen
//! container) gets `Interrupted` from such a call, without any handler of its own. `read_exact`, `read_line`, `write_all`,
//! `accept` and the like of the standard library make the call again by themselves; those here do not, so clippy refuses
//! them everywhere else (`clippy.toml`).
#![allow(clippy::disallowed_methods, reason = "this is the place for them")]

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
#[cfg(unix)]
use std::time::{Duration, Instant};

/// One `read`: it may give less than there is room for. 0 is the end.
///
/// ```
/// use std::io::{self, ErrorKind, Read};
///
/// /// Interrupted before each byte, which come one by one.
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
/// Those of [`Read::read`] but `Interrupted`.
pub fn read(mut from: impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    again(|| from.read(buffer))
}

/// One `write`: it may take less than there is.
///
/// # Errors
/// Those of [`Write::write`] but `Interrupted`.
pub fn write(mut to: impl Write, bytes: &[u8]) -> io::Result<usize> {
    again(|| to.write(bytes))
}

/// As [`read`], and what is read stays there.
///
/// # Errors
/// Those of [`TcpStream::peek`] but `Interrupted`.
pub fn peek(from: &TcpStream, buffer: &mut [u8]) -> io::Result<usize> {
    again(|| from.peek(buffer))
}

/// The next datagram: its length and who sent it.
///
/// # Errors
/// Those of [`UdpSocket::recv_from`] but `Interrupted`.
pub fn recv_from(socket: &UdpSocket, buffer: &mut [u8]) -> io::Result<(usize, SocketAddr)> {
    again(|| socket.recv_from(buffer))
}

/// Sends a datagram.
///
/// # Errors
/// Those of [`UdpSocket::send_to`] but `Interrupted`.
pub fn send_to(socket: &UdpSocket, bytes: &[u8], to: SocketAddr) -> io::Result<usize> {
    again(|| socket.send_to(bytes, to))
}

/// One `read` in this time, which becomes the line's time-out; `None`: nothing came.
///
/// # Errors
/// Those of [`Read::read`] but `Interrupted` and that of the time-out.
#[cfg(unix)]
pub fn read_within(
    line: &std::os::unix::net::UnixStream,
    buffer: &mut [u8],
    time: Duration,
) -> io::Result<Option<usize>> {
    let end = Instant::now() + time;
    loop {
        // A time-out of 0 would be none.
        let left = end.saturating_duration_since(Instant::now()).max(Duration::from_micros(1));
        line.set_read_timeout(Some(left))?;
        match (&*line).read(buffer) {
            Err(error) if error.kind() == ErrorKind::Interrupted && Instant::now() < end => {}
            Err(error) if is_over(&error) => return Ok(None),
            result => return result.map(Some),
        }
    }
}

/// Whether a read would return at once, or does so within this time: some microseconds are kept, which a socket's own
/// time-out makes milliseconds of.
///
/// # Errors
/// Those of `poll` but `Interrupted`.
#[cfg(unix)]
pub fn is_readable_within(line: &std::os::unix::net::UnixStream, time: Duration) -> io::Result<bool> {
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

/// Whether this is how a read with a time-out says that nothing came.
#[cfg(unix)]
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
