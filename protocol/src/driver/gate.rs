//! Controls write access to the line by the driver and its stop handles.
//!
//! Every write takes place under one mutex, which ensures that:
//! - a handle never writes into a partially sent message of the driver, so messages do not interleave;
//! - the driver starts no message while a handle's request is pending. It takes the request over first, which withdraws
//!   all unsent requests. Nothing requested before a stop is sent after it.
//!
//! A handle stores its request before it wakes the driver, and the driver checks for a request before it waits again,
//! so no wake-up is lost. Without a handle, and without feature `std`, there is no mutex.

use super::StopRequest;
#[cfg(feature = "embedded-io-async")]
use core::task::Context;
use core::task::Poll;

/// The driver's side of the gate.
#[derive(Debug)]
pub(super) struct Gate {
    /// The state shared with the handles.
    #[cfg(feature = "std")]
    pub(super) shared: Option<std::sync::Arc<super::stop::Shared>>,
}

#[cfg_attr(not(feature = "std"), expect(clippy::unused_self, reason = "there are no handles"))]
impl Gate {
    /// A gate without handles.
    pub(super) const OPEN: Self = Self {
        #[cfg(feature = "std")]
        shared: None,
    };

    /// Lets the driver write the last `len` bytes of a message. Returns `None` if the driver must first take over a
    /// stop request. It then sends the rest of a begun message, and the stop after it.
    pub(super) fn poll_write<E>(
        &self,
        len: usize,
        write: impl FnOnce() -> Poll<Result<usize, E>>,
    ) -> Poll<Option<Result<usize, E>>> {
        #[cfg(feature = "std")]
        if let Some(shared) = &self.shared {
            return shared.poll_write(len, write);
        }
        let _ = len;
        write().map(Some)
    }

    /// Takes the pending stop request, if any.
    pub(super) fn take(&self) -> Option<StopRequest> {
        #[cfg(feature = "std")]
        if let Some(shared) = &self.shared {
            return shared.take();
        }
        None
    }

    /// Completes when a stop is requested.
    #[cfg(feature = "embedded-io-async")]
    pub(super) fn poll_request(&self, context: &mut Context<'_>) -> Poll<()> {
        #[cfg(feature = "std")]
        if let Some(shared) = &self.shared {
            return shared.poll_request(context);
        }
        let _ = context;
        Poll::Pending
    }
}
