//! Ctrl-C and the other ways to be ended: noted, and found at the next look at the line.

use std::fmt::{self, Display, Formatter};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};

/// Signals that end the program, or the motion that it waits for.
#[derive(Clone, Debug, Default)]
pub(crate) struct Signals {
    /// The number of the last one; 0: none.
    caught: Arc<AtomicUsize>,
    /// Whether a caught one counts. While the fingers are being stopped none does.
    heeded: Arc<AtomicBool>,
}

/// A signal came; its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Caught(pub(crate) u8);

impl Caught {
    /// Ctrl-C.
    pub(crate) const INTERRUPT: Self = Self(SIGINT.unsigned_abs() as u8);
}

/// What ends a program, of what the system has.
#[cfg(unix)]
const SIGNALS: [i32; 4] = [SIGINT, SIGTERM, signal_hook::consts::SIGHUP, signal_hook::consts::SIGQUIT];
#[cfg(not(unix))]
const SIGNALS: [i32; 2] = [SIGINT, SIGTERM];

impl Display for Caught {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "signal {}", self.0)
    }
}

impl std::error::Error for Caught {}

impl Signals {
    /// Catches them from now on.
    pub(crate) fn catch() -> io::Result<Self> {
        let caught = Arc::new(AtomicUsize::new(0));
        for signal in SIGNALS {
            signal_hook::flag::register_usize(signal, Arc::clone(&caught), signal.unsigned_abs() as usize)?;
        }
        Ok(Self { caught, heeded: Arc::new(AtomicBool::new(true)) })
    }

    /// Whether a caught one counts from now on.
    pub(crate) fn heed(&self, on: bool) {
        self.heeded.store(on, Ordering::Relaxed);
    }

    /// Forgets a Ctrl-C, which has had its effect; whether that is what was caught.
    pub(crate) fn forget_interrupt(&self) -> bool {
        let interrupt = SIGINT.unsigned_abs() as usize;
        self.caught.compare_exchange(interrupt, 0, Ordering::Relaxed, Ordering::Relaxed).is_ok()
    }

    /// An error if one was caught and counts.
    pub(crate) fn check(&self) -> io::Result<()> {
        match self.caught.load(Ordering::Relaxed) {
            0 => Ok(()),
            _ if !self.heeded.load(Ordering::Relaxed) => Ok(()),
            signal => Err(io::Error::other(Caught(signal as u8))),
        }
    }
}
