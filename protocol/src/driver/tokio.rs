//! The async driver on tokio: transports and a timer (feature `tokio`).
//!
//! | type | description | address of the gripper |
//! |---|---|---|
//! | [`Tcp`] | a TCP connection that announces its end | `192.168.1.20:1000` |
//! | [`Udp`] | a UDP socket | `192.168.1.20:1500` |
//! | [`Stream`] | any byte stream, such as a port of the crate `tokio-serial` or a Unix socket | |
//! | [`TokioTimer`] | tokio's timer | |
//!
//! [`connect`] combines them for the binary protocol over TCP.

mod stream;
mod tcp;
mod udp;

pub use stream::Stream;
pub use tcp::Tcp;
pub use udp::Udp;

use super::asynch::Gripper;
use super::{Clock, Error, Timer};
use crate::time::Instant;
use std::io;
use tokio::net::ToSocketAddrs;

/// Connects to the gripper at this address over TCP and the binary protocol, and waits for its first reply.
///
/// Dropping the gripper, alone or with a future, announces the end of the connection without waiting, as in [the
/// blocking version](super::host::connect).
///
/// A gripper that is already in FAST STOP stays there. Call [`acknowledge`](super::asynch::GripperOver::acknowledge) to
/// unlock it once the fingers may move.
///
/// ```no_run
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::{Grip, Mm, MmPerS, N, tokio::connect};
///
/// # tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(async {
/// let mut gripper = connect("192.168.1.20:1000").await?;
/// gripper.home(HomingDirection::Default).await?;
/// gripper.set_force_limit(N(40.0)).await?;
/// assert_eq!(gripper.grip(Mm(20.0), MmPerS(200.0)).await?, Grip::Held);
/// # Ok::<(), wsg_protocol::driver::Error<std::io::Error>>(())
/// # }).unwrap();
/// ```
///
/// # Errors
/// Returns the same errors as [the blocking version](super::host::connect).
pub async fn connect(address: impl ToSocketAddrs) -> Result<Gripper<Tcp, TokioTimer>, Error<io::Error>> {
    let line = Tcp::connect(address).await.map_err(Error::Transport)?;
    let mut gripper = Gripper::new(line, TokioTimer::new());
    gripper.connect().await?;
    Ok(gripper)
}

/// Connects like [`connect`], over the text protocol (GCL).
///
/// # Errors
/// Returns the same errors as [`connect`].
#[cfg(feature = "gcl")]
pub async fn connect_gcl(
    address: impl ToSocketAddrs,
) -> Result<super::asynch::GclGripper<Tcp, TokioTimer>, Error<io::Error>> {
    let line = Tcp::connect(address).await.map_err(Error::Transport)?;
    let mut gripper = super::asynch::GclGripper::new(line, TokioTimer::new());
    gripper.connect().await?;
    Ok(gripper)
}

/// Runs a closure with the gripper at this address, connecting like [`connect`], and waits for the gripper to confirm
/// the end of the connection. For a closure with its own error type, use [`connect`] or
/// [`with_connection`](super::asynch::GripperOver::with_connection).
///
/// # Errors
/// Returns the errors of [`connect`], of the closure and of the announcement.
pub async fn with_gripper<T>(
    address: impl ToSocketAddrs,
    program: impl AsyncFnOnce(&mut Gripper<Tcp, TokioTimer>) -> Result<T, Error<io::Error>>,
) -> Result<T, Error<io::Error>> {
    let line = Tcp::connect(address).await.map_err(Error::Transport)?;
    Gripper::new(line, TokioTimer::new()).with_connection(program).await
}

/// Tokio's clock, which tests may pause.
#[derive(Clone, Copy, Debug)]
pub struct TokioTimer {
    start: tokio::time::Instant,
}

impl TokioTimer {
    /// Creates a clock that starts at 0.
    #[must_use]
    pub fn new() -> Self {
        Self { start: tokio::time::Instant::now() }
    }
}

impl Default for TokioTimer {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for TokioTimer {
    fn now(&mut self) -> Instant {
        // A driver's clock may wrap, so the low 32 bits suffice.
        Instant::from_millis(self.start.elapsed().as_millis() as u32)
    }
}

impl Timer for TokioTimer {
    async fn wait_until(&mut self, moment: Instant) {
        tokio::time::sleep(self.now().until(moment)).await;
    }
}
