//! A UDP transport.

use crate::driver::readiness::duplicate;
use crate::driver::received::Received;
use crate::driver::udp::{self, MAX_DATAGRAM_LEN};
use crate::driver::{StopLine, Stoppable, second};
use embedded_io_async::ErrorType;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use tokio::net::{ToSocketAddrs, UdpSocket, lookup_host};

/// A UDP transport to a gripper, for either protocol, with one message per datagram. See [the blocking
/// version](crate::driver::host::Udp) for the ports.
#[derive(Debug)]
pub struct Udp {
    socket: UdpSocket,
    gripper: SocketAddr,
    received: Received<MAX_DATAGRAM_LEN>,
}

impl Udp {
    /// Opens a socket to the gripper at this address, such as `"192.168.1.20:1500"`. It receives replies on
    /// `answer_port` of all local addresses; 0 selects a free port.
    ///
    /// # Errors
    /// Returns an error if the name does not resolve or the port is in use.
    pub async fn connect(gripper: impl ToSocketAddrs, answer_port: u16) -> io::Result<Self> {
        let gripper = lookup_host(gripper).await?.next();
        let gripper = gripper.ok_or_else(|| {
            io::Error::new(ErrorKind::AddrNotAvailable, "the name does not resolve to an address")
        })?;
        Ok(Self::new(UdpSocket::bind((udp::any_like(gripper), answer_port)).await?, gripper))
    }

    /// Creates a transport over a socket that is bound to the gripper's reply port.
    #[must_use]
    pub const fn new(socket: UdpSocket, gripper: SocketAddr) -> Self {
        Self { socket, gripper, received: Received::new() }
    }
}

impl ErrorType for Udp {
    type Error = io::Error;
}

impl embedded_io_async::Read for Udp {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.received.is_empty() {
            match self.socket.recv_from(self.received.space()).await {
                Ok((len, sender)) if udp::is_message(len, sender, self.gripper) => self.received.filled(len),
                Ok(_) => {}
                Err(error) if udp::is_silence(&error) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(self.received.take(buffer))
    }
}

impl embedded_io_async::Write for Udp {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.socket.send_to(bytes, self.gripper).await {
            Err(error) if udp::is_silence(&error) => Ok(bytes.len()),
            result => result,
        }
    }

    async fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Stoppable for Udp {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        Ok(StopLine::new(second::udp(duplicate(&self.socket)?, self.gripper), || {}))
    }
}
