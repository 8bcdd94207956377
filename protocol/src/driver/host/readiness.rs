//! When a socket or a serial port has bytes, from the operating system: nothing here reads.

use core::time::Duration;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;

/// What the operating system can wait for: on Unix anything with a file descriptor, on Windows a socket.
#[cfg(unix)]
pub(super) use std::os::fd::AsFd as AsPollable;
#[cfg(windows)]
pub(super) use std::os::windows::io::AsSocket as AsPollable;

/// What is known of a source of bytes without another system call.
#[derive(Clone, Copy, Debug, Default)]
enum Seen {
    #[default]
    Nothing,
    /// Bytes are there, or the end.
    Bytes,
    /// The last read has emptied it.
    Silence,
}

/// The longest single wait of a read that has no end of its own.
pub(super) const LONG_MS: u32 = 60_000;

/// When to read from one source of bytes.
#[derive(Debug, Default)]
pub(super) struct Readiness {
    seen: Seen,
}

impl Readiness {
    pub(super) const fn new() -> Self {
        Self { seen: Seen::Nothing }
    }

    /// Whether a read would return at once.
    pub(super) fn may_read(&mut self, source: &impl AsPollable) -> io::Result<bool> {
        match core::mem::take(&mut self.seen) {
            Seen::Nothing => is_readable(source, 0),
            Seen::Bytes => Ok(true),
            Seen::Silence => Ok(false),
        }
    }

    /// A read did not fill its buffer: the next question needs no system call.
    pub(super) const fn is_emptied(&mut self) {
        self.seen = Seen::Silence;
    }

    /// Waits until bytes are there, or the end, for so many milliseconds. A signal ends the wait.
    pub(super) fn wait(&mut self, source: &impl AsPollable, at_most_ms: u32) -> io::Result<()> {
        self.seen = if is_readable(source, at_most_ms)? { Seen::Bytes } else { Seen::Nothing };
        Ok(())
    }
}

fn is_readable(source: &impl AsPollable, at_most_ms: u32) -> io::Result<bool> {
    let time = Duration::from_millis(at_most_ms.into());
    let timeout = Timespec { tv_sec: time.as_secs() as _, tv_nsec: time.subsec_nanos() as _ };
    match poll(&mut [PollFd::new(source, PollFlags::IN)], Some(&timeout)) {
        Ok(count) => Ok(count > 0),
        Err(rustix::io::Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}
