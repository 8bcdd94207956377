//! TCP, whose end is announced.

use super::{PolledStream, SPURIOUS};
use crate::driver::blocking::Transport;
use crate::driver::farewell::{Farewell, linger};
use crate::driver::readiness::duplicate;
use crate::driver::{StopLine, Stoppable, second};
use crate::frame::OVERHEAD;
use core::time::Duration;
use embedded_io::{ErrorType, ReadReady};
use std::io::{self, ErrorKind};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};

/// How long a gripper may leave what is sent unread. A write that takes longer is an error.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// A TCP connection to a gripper, for either protocol; port 1000 for the binary one.
///
/// When it is dropped, it announces the end of the connection if nobody has (Disconnect Announcement, or `BYE`), and waits
/// up to 100 ms until the gripper closes its end, so that a program which drops its gripper does not leave it in FAST STOP. It announces nothing, and the
/// gripper enters FAST STOP, if the program panics, or if FAST STOP was the last that was asked for; nor can it if the
/// process is killed. [`with_connection`](crate::driver::blocking::GripperOver::with_connection) also waits for the
/// gripper's confirmation.
#[derive(Debug)]
pub struct Tcp {
    stream: PolledStream<TcpStream>,
    farewell: Farewell,
}

impl Tcp {
    /// How long [`connect`](Self::connect) waits for each address.
    pub const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);

    /// Connects to the first address that answers, such as `"192.168.1.20:1000"`.
    ///
    /// # Errors
    /// That of the last address.
    pub fn connect(address: impl ToSocketAddrs) -> io::Result<Self> {
        let mut result = Err(io::Error::new(ErrorKind::AddrNotAvailable, "the name has no address"));
        for address in address.to_socket_addrs()? {
            result = TcpStream::connect_timeout(&address, Self::CONNECT_TIMEOUT);
            if result.is_ok() {
                break;
            }
        }
        Self::new(result?)
    }

    /// Takes a connection that exists.
    ///
    /// # Errors
    /// The options of the socket cannot be set.
    pub fn new(stream: TcpStream) -> io::Result<Self> {
        // A frame is one segment, and it leaves at once.
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
        // One attempt. Nobody is left to be told of an error.
        if stream.set_nonblocking(true).is_ok() && io::Write::write(&mut stream, message).is_ok() {
            let _ = stream.shutdown(Shutdown::Write);
            linger(stream);
        }
    }
}
