//! The async driver on tokio: transports and a timer, by feature `tokio`.
//!
//! | type | is | the gripper's address |
//! |---|---|---|
//! | [`Tcp`] | a TCP connection, whose end is announced | `192.168.1.20:1000` |
//! | [`Udp`] | a UDP socket | `192.168.1.20:1500` |
//! | [`Stream`] | anything that reads and writes: a port of the crate `tokio-serial`, a Unix socket | |
//! | [`TokioTimer`] | the timer | |
//!
//! [`connect`] takes them together, for the binary protocol over TCP.

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

/// Connects to the gripper at this address, over TCP and the binary protocol, and waits until it answers.
///
/// When the gripper is dropped, also with a future, it announces the end of the connection without waiting, as
/// [the blocking one](super::host::connect) does.
///
/// A gripper that is in FAST STOP already stays there: [`acknowledge`](super::asynch::GripperOver::acknowledge) unlocks
/// it, when the fingers may move.
///
/// ```
/// # use wsg_sim::{Config, Part, server::{Lines, ServerThread}};
/// # let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
/// # let config = Config { part: Part::of_width(20.0), ..Config::default() };
/// # let server = ServerThread::start(config, &lines, None).unwrap();
/// # let address = server.tcp_address().unwrap();
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::{Grip, Mm, MmPerS, N, tokio::connect};
///
/// # tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(async {
/// // A real one: "192.168.1.20:1000".
/// let mut gripper = connect(address).await?;
/// gripper.home(HomingDirection::Default).await?;
/// gripper.set_force_limit(N(40.0)).await?;
/// assert_eq!(gripper.grip(Mm(20.0), MmPerS(200.0)).await?, Grip::Held);
/// # Ok::<(), wsg_protocol::driver::Error<std::io::Error>>(())
/// # }).unwrap();
/// ```
///
/// # Errors
/// As [the blocking one](super::host::connect).
pub async fn connect(address: impl ToSocketAddrs) -> Result<Gripper<Tcp, TokioTimer>, Error<io::Error>> {
    let line = Tcp::connect(address).await.map_err(Error::Transport)?;
    let mut gripper = Gripper::new(line, TokioTimer::new());
    gripper.connect().await?;
    Ok(gripper)
}

/// As [`connect`], over the text protocol (GCL).
///
/// # Errors
/// As [`connect`].
#[cfg(feature = "gcl")]
pub async fn connect_gcl(
    address: impl ToSocketAddrs,
) -> Result<super::asynch::GclGripper<Tcp, TokioTimer>, Error<io::Error>> {
    let line = Tcp::connect(address).await.map_err(Error::Transport)?;
    let mut gripper = super::asynch::GclGripper::new(line, TokioTimer::new());
    gripper.connect().await?;
    Ok(gripper)
}

/// Runs a program with the gripper at this address, as [`connect`] does, and also waits until the gripper has confirmed the
/// end of the connection. For a program with errors of its own take [`connect`], or
/// [`with_connection`](super::asynch::GripperOver::with_connection).
///
/// # Errors
/// Those of [`connect`], of the program, and of the announcement.
pub async fn with_gripper<T>(
    address: impl ToSocketAddrs,
    program: impl AsyncFnOnce(&mut Gripper<Tcp, TokioTimer>) -> Result<T, Error<io::Error>>,
) -> Result<T, Error<io::Error>> {
    let line = Tcp::connect(address).await.map_err(Error::Transport)?;
    Gripper::new(line, TokioTimer::new()).with_connection(program).await
}

/// Tokio's clock, which a test may pause.
#[derive(Clone, Copy, Debug)]
pub struct TokioTimer {
    start: tokio::time::Instant,
}

impl TokioTimer {
    /// A clock that shows 0 now.
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
        // A driver's clock may wrap, so the low 32 bits will do.
        Instant::from_millis(self.start.elapsed().as_millis() as u32)
    }
}

impl Timer for TokioTimer {
    async fn wait_until(&mut self, moment: Instant) {
        tokio::time::sleep(self.now().until(moment)).await;
    }
}
