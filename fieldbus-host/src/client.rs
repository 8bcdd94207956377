//! The contract between a connection and the owner of the image, and the activity of a connection.

use std::future::pending;
use std::sync::{Mutex, PoisonError};
use tokio::sync::Notify;
use tokio::time::{Duration, Instant, sleep_until};

/// Idle time-out of a Modbus/TCP connection. A master that loses power does not close its connection.
pub const IDLE_LIMIT: Duration = Duration::from_secs(300);

/// One client, as the owner of the image serves it. Dropping it disconnects the client.
///
/// `FRAME_LEN` is the maximum length of a frame in bytes.
pub trait Client<const FRAME_LEN: usize> {
    /// Takes bytes from the client.
    fn receive(&self, bytes: &[u8]);

    /// Returns the next frame for the client.
    fn transmit<'a>(&self, buffer: &'a mut [u8; FRAME_LEN]) -> Option<&'a [u8]>;

    /// Returns whether the connection is over: synchronization is lost, and all frames for the client are sent.
    fn is_over(&self) -> bool;

    /// Ready when there may be a frame.
    fn frame_waits(&self) -> impl Future<Output = ()>;

    /// Ready when the connection must be closed, because it is idle for too long or its place is needed.
    fn dismissed(&self) -> impl Future<Output = ()>;

    /// Returns whether there is room for answers.
    fn has_room(&self) -> bool {
        true
    }

    /// Returns whether there is room for answers and requests.
    fn takes_more(&self) -> bool {
        true
    }

    /// Ready when a request that the owner has delayed is due. Then [`arrive`](Self::arrive) passes it on.
    fn request_waits(&self) -> impl Future<Output = ()> {
        pending()
    }

    /// Passes on the next request that the owner has delayed.
    fn arrive(&self) {}
}

/// Reason for closing a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dismissal {
    /// The client has sent nothing for [`IDLE_LIMIT`].
    Idle,
    /// The owner has displaced the client.
    Displaced,
}

/// The activity of a connection. It decides when the connection must be closed.
#[derive(Debug)]
pub struct Activity {
    received_at: Mutex<Instant>,
    displaced: Notify,
}

impl Default for Activity {
    /// A connection that begins now.
    fn default() -> Self {
        Self { received_at: Mutex::new(Instant::now()), displaced: Notify::new() }
    }
}

impl Activity {
    /// Records that bytes were received now.
    pub fn note(&self) {
        *self.received_at.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }

    /// Returns when bytes were last received, or when the connection began.
    #[must_use]
    pub fn received_at(&self) -> Instant {
        *self.received_at.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Closes the connection.
    pub fn displace(&self) {
        self.displaced.notify_one();
    }

    /// Ready when the connection must be closed. A call after further bytes waits for the full [`IDLE_LIMIT`] again.
    pub async fn dismissed(&self) -> Dismissal {
        tokio::select! {
            () = self.displaced.notified() => Dismissal::Displaced,
            () = sleep_until(self.received_at() + IDLE_LIMIT) => Dismissal::Idle,
        }
    }
}
