//! The blocking driver on a computer: transports and a clock over the standard library, by feature `std`.
//!
//! | type | is | the gripper's address |
//! |---|---|---|
//! | [`Tcp`] | a TCP connection, whose end is announced | `192.168.1.20:1000` |
//! | [`Udp`] | a UDP socket | `192.168.1.20:1500` |
//! | [`PolledStream`] | a byte stream with a file descriptor: a port of the crate `serial2`, a Unix socket | |
//! | [`Stream`] | anything else that reads and writes, with a read time-out: a port of the crate `serialport`, any port on Windows | |
//! | [`StdClock`] | the clock | |
//!
//! [`connect`] takes them together, for the binary protocol over TCP. For anything else give the parts to the driver:
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

/// How long a read may take that has nothing to read although the system reported bytes, such as a datagram whose checksum
/// then proved wrong.
const SPURIOUS: Duration = Duration::from_millis(1);

/// Connects to the gripper at this address, over TCP and the binary protocol, and waits until it answers.
///
/// When the gripper is dropped, it announces the end of the connection, whatever ends the scope: a return, `?`, or `break`.
/// Otherwise a gripper on TCP enters FAST STOP. Only a program that panics, or that has requested a FAST STOP, leaves it
/// there; see [`Tcp`].
///
/// A gripper that is in FAST STOP already stays there: [`acknowledge`](super::blocking::GripperOver::acknowledge) unlocks
/// it, when the fingers may move.
///
/// ```
/// # use wsg_sim::{Config, Part, server::{Lines, ServerThread}};
/// # let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
/// # let config = Config { part: Part::of_width(20.0), ..Config::default() };
/// # let server = ServerThread::start(config, &lines, None).unwrap();
/// # let address = server.tcp_address().unwrap();
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::{Grip, Mm, MmPerS, N, host};
///
/// // A real one: "192.168.1.20:1000".
/// let mut gripper = host::connect(address)?;
/// gripper.home(HomingDirection::Default)?;
/// gripper.set_force_limit(N(40.0))?;
/// assert_eq!(gripper.grip(Mm(20.0), MmPerS(200.0))?, Grip::Held);
/// # Ok::<(), wsg_protocol::driver::Error<std::io::Error>>(())
/// ```
///
/// # Errors
/// - [`Error::Transport`]: no connection within [`Tcp::CONNECT_TIMEOUT`]; the address is wrong, the gripper is off, or its
///   command interface is not TCP.
/// - [`Error::NotConnected`]: the connection stands and nothing answers; the interface is perhaps set to the text protocol.
/// - [`Error::Closed`]: the gripper has closed it; another client perhaps holds the connection.
pub fn connect(address: impl ToSocketAddrs) -> Result<Gripper<Tcp, StdClock>, Error<io::Error>> {
    let line = Tcp::connect(address).map_err(Error::Transport)?;
    let mut gripper = Gripper::new(line, StdClock::new());
    gripper.connect()?;
    Ok(gripper)
}

/// As [`connect`], over the text protocol (GCL).
///
/// # Errors
/// As [`connect`].
#[cfg(feature = "gcl")]
pub fn connect_gcl(
    address: impl ToSocketAddrs,
) -> Result<super::blocking::GclGripper<Tcp, StdClock>, Error<io::Error>> {
    let line = Tcp::connect(address).map_err(Error::Transport)?;
    let mut gripper = super::blocking::GclGripper::new(line, StdClock::new());
    gripper.connect()?;
    Ok(gripper)
}

/// Runs a program with the gripper at this address, as [`connect`] does, and also waits until the gripper has confirmed the
/// end of the connection. For a program with errors of its own take [`connect`], or
/// [`with_connection`](super::blocking::GripperOver::with_connection).
///
/// ```
/// # use wsg_sim::{Config, server::{Lines, ServerThread}};
/// # let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
/// # let server = ServerThread::start(Config::default(), &lines, None).unwrap();
/// # let address = server.tcp_address().unwrap();
/// use wsg_protocol::driver::host;
///
/// let _ = host::with_gripper(address, |gripper| {
///     println!("{:.1}", gripper.width()?);
///     Ok(())
/// });
/// ```
///
/// # Errors
/// Those of [`connect`], of the program, and of the announcement.
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
    /// A clock that shows 0 now.
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
        // A driver's clock may wrap, so the low 32 bits will do.
        Instant::from_millis(self.start.elapsed().as_millis() as u32)
    }
}
