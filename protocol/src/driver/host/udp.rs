//! A UDP transport.

use super::SPURIOUS;
use crate::driver::blocking::Transport;
use crate::driver::readiness::{LONG_MS, Readiness, duplicate};
use crate::driver::received::Received;
use crate::driver::udp::{self, MAX_DATAGRAM_LEN};
use crate::driver::{StopLine, Stoppable, second};
use embedded_io::{ErrorType, ReadReady};
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};

/// A UDP transport to a gripper, for either protocol, with one message per datagram. UDP has no end of connection, so a
/// gripper continues its last command when the program ends.
///
/// Replies of the binary protocol are sent to the port configured in the gripper, not to the source port of the
/// request. Defaults: the gripper listens on 1500 and replies to 1501. GCL replies are sent to the source port of the
/// request.
#[derive(Debug)]
pub struct Udp {
    socket: UdpSocket,
    gripper: SocketAddr,
    received: Received<MAX_DATAGRAM_LEN>,
    readiness: Readiness,
}

impl Udp {
    /// The default port on which a gripper listens.
    pub const GRIPPER_PORT: u16 = udp::GRIPPER_PORT;
    /// The default port to which a gripper replies.
    pub const ANSWER_PORT: u16 = udp::ANSWER_PORT;

    /// Opens a socket to the gripper at this address, such as `"192.168.1.20:1500"`. It receives replies on
    /// `answer_port` of all local addresses; 0 selects a free port.
    ///
    /// # Errors
    /// Returns an error if the name does not resolve or the port is in use.
    pub fn connect(gripper: impl ToSocketAddrs, answer_port: u16) -> io::Result<Self> {
        let gripper = gripper.to_socket_addrs()?.next();
        let gripper = gripper.ok_or_else(|| {
            io::Error::new(ErrorKind::AddrNotAvailable, "the name does not resolve to an address")
        })?;
        Self::new(UdpSocket::bind((udp::any_like(gripper), answer_port))?, gripper)
    }

    /// Creates a transport over a socket that is bound to the gripper's reply port.
    ///
    /// # Errors
    /// Returns the error if the socket options cannot be set.
    pub fn new(socket: UdpSocket, gripper: SocketAddr) -> io::Result<Self> {
        socket.set_read_timeout(Some(SPURIOUS))?;
        Ok(Self { socket, gripper, received: Received::new(), readiness: Readiness::new() })
    }
}

impl ErrorType for Udp {
    type Error = io::Error;
}

impl ReadReady for Udp {
    fn read_ready(&mut self) -> io::Result<bool> {
        let Self { socket, gripper, received, readiness } = self;
        if !received.is_empty() {
            return Ok(true);
        }
        if !readiness.may_read(socket)? {
            return Ok(false);
        }
        #[expect(clippy::disallowed_methods, reason = "a signal counts as no input, and the driver retries")]
        received.fill(|buffer| match socket.recv_from(buffer) {
            Ok((len, sender)) if udp::is_message(len, sender, *gripper) => Ok(len),
            Ok(_) => Err(ErrorKind::WouldBlock.into()),
            Err(error) if udp::is_silence(&error) => Err(ErrorKind::WouldBlock.into()),
            Err(error) => Err(error),
        })
    }
}

impl embedded_io::Read for Udp {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.read_ready()? {
            self.readiness.wait(&self.socket, LONG_MS)?;
        }
        Ok(self.received.take(buffer))
    }
}

impl embedded_io::Write for Udp {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            #[expect(clippy::disallowed_methods, reason = "the call is made again")]
            match self.socket.send_to(bytes, self.gripper) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if udp::is_silence(&error) => return Ok(bytes.len()),
                result => return result,
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Transport for Udp {
    fn wait(&mut self, at_most_ms: u32) -> io::Result<()> {
        if !self.received.is_empty() {
            return Ok(());
        }
        self.readiness.wait(&self.socket, at_most_ms)
    }
}

impl Stoppable for Udp {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        let waker = self.readiness.waker()?;
        Ok(StopLine::new(second::udp(duplicate(&self.socket)?, self.gripper), move || waker.wake()))
    }
}
