//! Ctrl-C and other termination signals: recorded by a handler, checked at the next access to the line.

use std::fmt::{self, Display, Formatter};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};

/// Signals that end the program or the motion in progress.
#[derive(Clone, Debug, Default)]
pub(crate) struct Signals {
    /// The last signal caught, or 0.
    caught: Arc<AtomicUsize>,
    /// Whether a caught signal is reported. Cleared while the fingers are being stopped.
    heeded: Arc<AtomicBool>,
}

/// The number of a caught signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Caught(pub(crate) u8);

impl Caught {
    /// SIGINT, sent by Ctrl-C.
    pub(crate) const INTERRUPT: Self = Self(SIGINT.unsigned_abs() as u8);
}

/// The termination signals that the operating system supports.
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
    /// Installs the signal handlers.
    pub(crate) fn catch() -> io::Result<Self> {
        let caught = Arc::new(AtomicUsize::new(0));
        for signal in SIGNALS {
            signal_hook::flag::register_usize(signal, Arc::clone(&caught), signal.unsigned_abs() as usize)?;
        }
        Ok(Self { caught, heeded: Arc::new(AtomicBool::new(true)) })
    }

    /// Sets whether [`check`](Self::check) reports caught signals.
    pub(crate) fn heed(&self, on: bool) {
        self.heeded.store(on, Ordering::Relaxed);
    }

    /// Clears a handled Ctrl-C. Returns whether the caught signal was one.
    pub(crate) fn forget_interrupt(&self) -> bool {
        let interrupt = SIGINT.unsigned_abs() as usize;
        self.caught.compare_exchange(interrupt, 0, Ordering::Relaxed, Ordering::Relaxed).is_ok()
    }

    /// Returns an error if a signal was caught and signals are heeded.
    pub(crate) fn check(&self) -> io::Result<()> {
        match self.caught.load(Ordering::Relaxed) {
            0 => Ok(()),
            _ if !self.heeded.load(Ordering::Relaxed) => Ok(()),
            signal => Err(io::Error::other(Caught(signal as u8))),
        }
    }
}
