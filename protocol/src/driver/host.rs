//! The blocking driver on a PC: transports and a clock of the standard library (feature `std`).
//!
//! | type | description | address of the gripper |
//! |---|---|---|
//! | [`Tcp`] | a TCP connection that announces its end | `192.168.1.20:1000` |
//! | [`Udp`] | a UDP socket | `192.168.1.20:1500` |
//! | [`PolledStream`] | a byte stream with a file descriptor, such as a port of the crate `serial2` or a Unix socket | |
//! | [`Stream`] | any other byte stream with a read time-out, such as a port of the crate `serialport` or any port on Windows | |
//! | [`StdClock`] | the standard library's monotonic clock | |
//!
//! [`connect`] combines them for the binary protocol over TCP. In all other cases pass the parts to the driver:
//!
//! ```no_run
//! use std::time::Duration;
//! use wsg_protocol::driver::blocking::Gripper;
//! use wsg_protocol::driver::host::{StdClock, Stream};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let port = serialport::new("/dev/ttyUSB0", 115_200).timeout(Duration::from_millis(1)).open()?;
//! let mut gripper = Gripper::new(Stream::new(port), StdClock::new());
//! gripper.with_connection(|gripper| gripper.stop())?;
//! # Ok(())
//! # }
//! ```

mod polled_stream;
mod stream;
mod tcp;
mod udp;

pub use polled_stream::PolledStream;
pub use stream::{NoSecond, Stream};
pub use tcp::Tcp;
pub use udp::Udp;

use super::blocking::Gripper;
use super::{Clock, Error};
use crate::time::Instant;
use core::time::Duration;
use std::io;
use std::net::ToSocketAddrs;

/// Read time-out in case the system reports bytes that are then missing, such as a datagram with a wrong checksum.
const SPURIOUS: Duration = Duration::from_millis(1);

/// Connects to the gripper at this address over TCP and the binary protocol, and waits for its first reply.
///
/// Dropping the gripper announces the end of the connection, whether the scope ends by return, `?` or `break`.
/// Otherwise a gripper on TCP enters FAST STOP. Only a program that panics or has requested a FAST STOP leaves it
/// there; see [`Tcp`].
///
/// A gripper that is already in FAST STOP stays there. Call [`acknowledge`](super::blocking::GripperOver::acknowledge)
/// to unlock it once the fingers may move.
///
/// ```no_run
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::{Grip, Mm, MmPerS, N, host};
///
/// let mut gripper = host::connect("192.168.1.20:1000")?;
/// gripper.home(HomingDirection::Default)?;
/// gripper.set_force_limit(N(40.0))?;
/// assert_eq!(gripper.grip(Mm(20.0), MmPerS(200.0))?, Grip::Held);
/// # Ok::<(), wsg_protocol::driver::Error<std::io::Error>>(())
/// ```
///
/// # Errors
/// - [`Error::Transport`]: no connection within [`Tcp::CONNECT_TIMEOUT`]. The address is wrong, the gripper is off, or
///   its command interface is not TCP.
/// - [`Error::NotConnected`]: there is a connection but no reply. The interface may be set to the text protocol.
/// - [`Error::Closed`]: the gripper closed the connection. Another client may already be connected.
pub fn connect(address: impl ToSocketAddrs) -> Result<Gripper<Tcp, StdClock>, Error<io::Error>> {
    let line = Tcp::connect(address).map_err(Error::Transport)?;
    let mut gripper = Gripper::new(line, StdClock::new());
    gripper.connect()?;
    Ok(gripper)
}

/// Connects like [`connect`], over the text protocol (GCL).
///
/// # Errors
/// Returns the same errors as [`connect`].
#[cfg(feature = "gcl")]
pub fn connect_gcl(
    address: impl ToSocketAddrs,
) -> Result<super::blocking::GclGripper<Tcp, StdClock>, Error<io::Error>> {
    let line = Tcp::connect(address).map_err(Error::Transport)?;
    let mut gripper = super::blocking::GclGripper::new(line, StdClock::new());
    gripper.connect()?;
    Ok(gripper)
}

/// Runs a closure with the gripper at this address, connecting like [`connect`], and waits for the gripper to confirm
/// the end of the connection. For a closure with its own error type, use [`connect`] or
/// [`with_connection`](super::blocking::GripperOver::with_connection).
///
/// ```no_run
/// use wsg_protocol::driver::host;
///
/// let _ = host::with_gripper("192.168.1.20:1000", |gripper| {
///     println!("{:.1}", gripper.width()?);
///     Ok(())
/// });
/// ```
///
/// # Errors
/// Returns the errors of [`connect`], of the closure and of the announcement.
pub fn with_gripper<T>(
    address: impl ToSocketAddrs,
    program: impl FnOnce(&mut Gripper<Tcp, StdClock>) -> Result<T, Error<io::Error>>,
) -> Result<T, Error<io::Error>> {
    let line = Tcp::connect(address).map_err(Error::Transport)?;
    Gripper::new(line, StdClock::new()).with_connection(program)
}

/// The standard library's monotonic clock.
#[derive(Clone, Copy, Debug)]
pub struct StdClock {
    start: std::time::Instant,
}

impl StdClock {
    /// Creates a clock that starts at 0.
    #[must_use]
    pub fn new() -> Self {
        Self { start: std::time::Instant::now() }
    }
}

impl Default for StdClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for StdClock {
    fn now(&mut self) -> Instant {
        // A driver's clock may wrap, so the low 32 bits suffice.
        Instant::from_millis(self.start.elapsed().as_millis() as u32)
    }
}
