//! A TCP transport that announces the end of its connection.

use super::{PolledStream, SPURIOUS};
use crate::driver::blocking::Transport;
use crate::driver::farewell::{Farewell, LINGER, linger};
use crate::driver::readiness::duplicate;
use crate::driver::{StopLine, Stoppable, second};
use crate::frame::OVERHEAD;
use core::time::Duration;
use embedded_io::{ErrorType, ReadReady};
use std::io::{self, ErrorKind};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};

/// Time-out of a write, for a gripper that does not read.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// A TCP connection to a gripper, for either protocol. The binary protocol uses port 1000.
///
/// Dropping it announces the end of the connection unless that was done before (Disconnect Announcement, or `BYE`), and
/// waits up to 100 ms for the gripper to close its end. A dropped gripper therefore does not enter FAST STOP. No
/// announcement is sent, and the gripper enters FAST STOP, if the program panics, if FAST STOP was the last request, or
/// if the process is killed. [`with_connection`](crate::driver::blocking::GripperOver::with_connection) also waits for
/// the gripper's confirmation.
#[derive(Debug)]
pub struct Tcp {
    stream: PolledStream<TcpStream>,
    farewell: Farewell,
}

impl Tcp {
    /// Time-out of [`connect`](Self::connect) for each address.
    pub const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);

    /// Connects to the first reachable address, such as `"192.168.1.20:1000"`.
    ///
    /// # Errors
    /// Returns the error for the last address.
    pub fn connect(address: impl ToSocketAddrs) -> io::Result<Self> {
        let mut result =
            Err(io::Error::new(ErrorKind::AddrNotAvailable, "the name does not resolve to an address"));
        for address in address.to_socket_addrs()? {
            result = TcpStream::connect_timeout(&address, Self::CONNECT_TIMEOUT);
            if result.is_ok() {
                break;
            }
        }
        Self::new(result?)
    }

    /// Creates a transport over an existing connection.
    ///
    /// # Errors
    /// Returns the error if the socket options cannot be set.
    pub fn new(stream: TcpStream) -> io::Result<Self> {
        // Each frame is one segment, sent immediately.
        stream.set_nodelay(true)?;
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(SPURIOUS))?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        Ok(Self { stream: PolledStream::new(stream), farewell: Farewell::default() })
    }
}

impl ErrorType for Tcp {
    type Error = io::Error;
}

impl ReadReady for Tcp {
    fn read_ready(&mut self) -> io::Result<bool> {
        self.stream.read_ready()
    }
}

impl Transport for Tcp {
    fn wait(&mut self, at_most_ms: u32) -> io::Result<()> {
        self.stream.wait(at_most_ms)
    }
}

impl embedded_io::Read for Tcp {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        embedded_io::Read::read(&mut self.stream, buffer)
    }
}

impl embedded_io::Write for Tcp {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = embedded_io::Write::write(&mut self.stream, bytes)?;
        self.farewell.note(bytes);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        embedded_io::Write::flush(&mut self.stream)
    }
}

impl Stoppable for Tcp {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        let waker = self.stream.readiness().waker()?;
        let write = second::tcp(duplicate(self.stream.get_ref())?, self.farewell.clone());
        Ok(StopLine::new(write, move || waker.wake()))
    }
}

impl Drop for Tcp {
    #[expect(clippy::disallowed_methods, reason = "there is one attempt")]
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        let mut buffer = [0; OVERHEAD];
        let Some(message) = self.farewell.due(&mut buffer) else { return };
        let mut stream = self.stream.get_ref();
        // A single attempt. There is no caller to report an error to.
        if stream.set_nonblocking(true).is_ok() && io::Write::write(&mut stream, message).is_ok() {
            let _ = stream.shutdown(Shutdown::Write);
            linger(stream, LINGER);
        }
    }
}
