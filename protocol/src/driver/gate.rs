//! Who may write to the line: the driver, and stop handles if there are any.
//!
//! Every write takes place while one mutex is held. Under the same mutex
//! - a handle writes nothing into a message of the driver that is half sent, so messages never interleave;
//! - the driver begins no message while the request of a handle is not taken over. By taking it over it withdraws what waits,
//!   so nothing that was requested before a stop is sent after it.
//!
//! A handle stores its request before it wakes the driver, and a driver that was woken looks for a request before it waits
//! again, so no wake-up is lost. Without a handle, and without feature `std`, there is no mutex.

use super::StopRequest;
#[cfg(feature = "embedded-io-async")]
use core::task::Context;
use core::task::Poll;

/// The driver's side of the gate.
#[derive(Debug)]
pub(super) struct Gate {
    /// What it shares with its handles.
    #[cfg(feature = "std")]
    pub(super) shared: Option<std::sync::Arc<super::stop::Shared>>,
}

#[cfg(feature = "std")]
impl Gate {
    /// Without handles.
    pub(super) const OPEN: Self = Self { shared: None };

    /// Has the driver write `len` bytes of a message, from its beginning if `is_first`. `None` if it must take a request
    /// over instead.
    pub(super) fn poll_write<E>(
        &self,
        is_first: bool,
        len: usize,
        write: impl FnOnce() -> Poll<Result<usize, E>>,
    ) -> Poll<Option<Result<usize, E>>> {
        match &self.shared {
            Some(shared) => shared.poll_write(is_first, len, write),
            None => write().map(Some),
        }
    }

    /// Takes over what was requested.
    pub(super) fn take(&self) -> Option<StopRequest> {
        self.shared.as_ref()?.take()
    }

    /// Is ready when something is requested.
    #[cfg(feature = "embedded-io-async")]
    pub(super) fn poll_request(&self, context: &mut Context<'_>) -> Poll<()> {
        self.shared.as_ref().map_or(Poll::Pending, |shared| shared.poll_request(context))
    }
}

#[cfg(not(feature = "std"))]
#[expect(clippy::unused_self, reason = "there are no handles")]
impl Gate {
    pub(super) const OPEN: Self = Self {};

    pub(super) fn poll_write<E>(
        &self,
        _is_first: bool,
        _len: usize,
        write: impl FnOnce() -> Poll<Result<usize, E>>,
    ) -> Poll<Option<Result<usize, E>>> {
        write().map(Some)
    }

    pub(super) const fn take(&self) -> Option<StopRequest> {
        None
    }

    #[cfg(feature = "embedded-io-async")]
    pub(super) const fn poll_request(&self, _context: &mut Context<'_>) -> Poll<()> {
        Poll::Pending
    }
}
