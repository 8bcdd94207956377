//! Readiness of sockets and serial ports as reported by the operating system, and a way to end the wait. Does not read.

use core::time::Duration;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;
use std::sync::Arc;
use std::time::Instant;

/// A source that the operating system can poll: on Unix any file descriptor, on Windows a socket.
#[cfg(unix)]
pub(super) use std::os::fd::{AsFd as AsPollable, OwnedFd as Owned};
#[cfg(windows)]
pub(super) use std::os::windows::io::{AsSocket as AsPollable, OwnedSocket as Owned};

/// Duplicates the descriptor of a source.
pub(super) fn duplicate(source: &impl AsPollable) -> io::Result<Owned> {
    #[cfg(unix)]
    return source.as_fd().try_clone_to_owned();
    #[cfg(windows)]
    return source.as_socket().try_clone_to_owned();
}

/// The readiness known without another system call.
#[derive(Clone, Copy, Debug, Default)]
enum Seen {
    #[default]
    Nothing,
    /// Bytes or the end of the stream are available.
    Bytes,
    /// A read emptied the source at this time.
    Silence(Instant),
}

/// Time for which an emptied source counts as silent without a check, less than the resolution of time-outs. A burst of
/// requests thereby saves a system call or two for each of them.
const SILENCE: Duration = Duration::from_micros(500);

/// Maximum duration of a single wait without a deadline, in milliseconds.
pub(super) const LONG_MS: u32 = 60_000;

/// The read readiness of one source.
#[derive(Debug)]
pub(super) struct Readiness {
    seen: Seen,
    waker: Option<Arc<Waker>>,
}

impl Readiness {
    pub(super) const fn new() -> Self {
        Self { seen: Seen::Nothing, waker: None }
    }

    /// Returns whether a read would return immediately.
    pub(super) fn may_read(&mut self, source: &impl AsPollable) -> io::Result<bool> {
        if matches!(self.seen, Seen::Silence(since) if since.elapsed() < SILENCE) {
            return Ok(false);
        }
        match core::mem::take(&mut self.seen) {
            Seen::Nothing | Seen::Silence(_) => is_readable_within(source, 0),
            Seen::Bytes => Ok(true),
        }
    }

    /// Records a read that did not fill its buffer, so that the next checks need no system call.
    pub(super) fn is_emptied(&mut self) {
        self.seen = Seen::Silence(Instant::now());
    }

    /// Waits up to `at_most_ms` milliseconds for bytes or the end of the stream. A signal or the waker also ends the
    /// wait.
    pub(super) fn wait(&mut self, source: &impl AsPollable, at_most_ms: u32) -> io::Result<()> {
        let flags = flags_within(source, PollFlags::IN, self.waker.as_deref(), at_most_ms)?;
        self.seen = if flags.is_empty() { Seen::Nothing } else { Seen::Bytes };
        Ok(())
    }

    /// Returns a waker that ends the wait from another thread.
    pub(super) fn waker(&mut self) -> io::Result<Arc<Waker>> {
        let waker = match self.waker.take() {
            Some(waker) => waker,
            None => Arc::new(Waker::new()?),
        };
        Ok(Arc::clone(self.waker.insert(waker)))
    }
}

/// Waits up to `at_most_ms` milliseconds for bytes or the end of the stream, and returns whether they are available.
pub(super) fn is_readable_within(source: &impl AsPollable, at_most_ms: u32) -> io::Result<bool> {
    Ok(!flags_within(source, PollFlags::IN, None, at_most_ms)?.is_empty())
}

/// Returns whether a write would accept bytes immediately.
pub(super) fn is_writable(source: &impl AsPollable) -> io::Result<bool> {
    Ok(flags_within(source, PollFlags::OUT, None, 0)?.contains(PollFlags::OUT))
}

/// Polls up to `at_most_ms` milliseconds and returns the flags. They are empty after the time-out, a signal or the
/// waker.
fn flags_within(
    source: &impl AsPollable,
    flags: PollFlags,
    waker: Option<&Waker>,
    at_most_ms: u32,
) -> io::Result<PollFlags> {
    let time = Duration::from_millis(at_most_ms.into());
    let timeout = Timespec { tv_sec: time.as_secs() as _, tv_nsec: time.subsec_nanos() as _ };
    let source = PollFd::new(source, flags);
    let (polled, seen, is_woken) = match waker {
        None => {
            let mut all = [source];
            let polled = poll(&mut all, Some(&timeout));
            let [source] = all;
            (polled, source.revents(), false)
        }
        Some(waker) => {
            let mut all = [source, PollFd::new(&waker.receiver, PollFlags::IN)];
            let polled = poll(&mut all, Some(&timeout));
            let [source, woken] = all;
            (polled, source.revents(), !woken.revents().is_empty())
        }
    };
    match polled {
        Ok(_) => {}
        Err(rustix::io::Errno::INTR) => return Ok(PollFlags::empty()),
        Err(error) => return Err(error.into()),
    }
    if let Some(waker) = waker.filter(|_| is_woken) {
        waker.rest();
    }
    Ok(seen)
}

#[cfg(unix)]
type Signal = std::os::unix::net::UnixDatagram;
#[cfg(windows)]
type Signal = std::net::UdpSocket;

/// A pair of connected sockets. Sending on one ends the wait on the other.
#[derive(Debug)]
pub(super) struct Waker {
    sender: Signal,
    receiver: Signal,
}

impl Waker {
    fn new() -> io::Result<Self> {
        let (sender, receiver) = pair()?;
        sender.set_nonblocking(true)?;
        receiver.set_nonblocking(true)?;
        Ok(Self { sender, receiver })
    }

    /// Ends the current wait; without one, ends the next wait.
    #[cfg_attr(windows, expect(clippy::disallowed_methods, reason = "it does not wait"))]
    pub(super) fn wake(&self) {
        // A full socket has already woken the receiver.
        let _ = self.sender.send(&[1]);
    }

    /// Discards pending wake-ups, so they do not end the next wait.
    #[cfg_attr(windows, expect(clippy::disallowed_methods, reason = "it does not wait"))]
    fn rest(&self) {
        while self.receiver.recv(&mut [0]).is_ok() {}
    }
}

#[cfg(unix)]
fn pair() -> io::Result<(Signal, Signal)> {
    Signal::pair()
}

#[cfg(windows)]
fn pair() -> io::Result<(Signal, Signal)> {
    let [sender, receiver] = [(); 2].map(|()| Signal::bind((std::net::Ipv4Addr::LOCALHOST, 0)));
    let (sender, receiver) = (sender?, receiver?);
    sender.connect(receiver.local_addr()?)?;
    receiver.connect(sender.local_addr()?)?;
    Ok((sender, receiver))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::io::Write;
    use std::net::{Ipv4Addr, TcpListener, TcpStream};

    /// Longer than a step of any test takes.
    const FOREVER_MS: u32 = 60_000;

    /// Returns both ends of a connection.
    pub(in crate::driver) fn connected() -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let near = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        (near, listener.accept().unwrap().0)
    }

    #[test]
    fn source_is_readable_with_bytes_and_at_its_end() {
        let (near, mut far) = connected();
        assert!(!is_readable_within(&near, 0).unwrap());
        far.write_all(&[1]).unwrap();
        assert!(is_readable_within(&near, FOREVER_MS).unwrap());
        let (near, far) = connected();
        drop(far);
        assert!(is_readable_within(&near, FOREVER_MS).unwrap());
    }

    #[test]
    fn full_source_is_not_writable() {
        let (mut near, _far) = connected();
        assert!(is_writable(&near).unwrap());
        near.set_nonblocking(true).unwrap();
        while near.write_all(&[0; 4096]).is_ok() {}
        assert!(!is_writable(&near).unwrap());
    }

    #[test]
    fn waker_ends_one_wait() {
        let (near, _far) = connected();
        let mut readiness = Readiness::new();
        let begun = Instant::now();
        readiness.waker().unwrap().wake();
        readiness.wait(&near, FOREVER_MS).unwrap();
        assert!(begun.elapsed() < Duration::from_millis(FOREVER_MS.into()));
        let begun = Instant::now();
        readiness.wait(&near, 20).unwrap();
        assert!(begun.elapsed() >= Duration::from_millis(20));
        assert!(!readiness.may_read(&near).unwrap());
    }
}
