//! The gateway's line to a gripper: a TCP connection, which no turn of the bridge waits for.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::net::Shutdown;
use std::task::{Context, Poll};
use std::time::Duration;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use socket2::SockRef;
use tokio::net::TcpStream;

/// Room for sent bytes, and for received ones. A burst of FAST STOPs has less.
const ROOM: usize = 2_048;

/// The line, with or without a connection.
#[derive(Default)]
pub(super) struct GripperLine {
    stream: Option<TcpStream>,
    received: VecDeque<u8>,
    unsent: Vec<u8>,
    /// The socket has not taken all bytes of the last turn, so the bridge keeps further commands.
    is_full: bool,
}

impl GripperLine {
    pub(super) const fn is_open(&self) -> bool {
        self.stream.is_some()
    }

    /// Uses a new connection.
    pub(super) fn open(&mut self, stream: TcpStream) -> io::Result<()> {
        stream.set_nodelay(true)?;
        // Closing it, even by the end of the process, resets the connection: unsent commands are discarded, and the gripper enters
        // FAST STOP.
        SockRef::from(&stream).set_linger(Some(Duration::ZERO))?;
        *self = Self { stream: Some(stream), ..Self::default() };
        Ok(())
    }

    /// Resets the connection. Bytes that wait in the socket are never sent.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Closes the connection after its end was announced.
    pub(super) fn finish(&mut self) {
        if let Some(stream) = self.stream.take() {
            let socket = SockRef::from(&stream);
            // An error means that the gripper has closed its end first.
            let _ = socket.set_linger(None);
            let _ = socket.shutdown(Shutdown::Write);
        }
    }

    /// Ready when bytes have arrived, or the connection has ended. Never ready without a connection.
    pub(super) fn poll_arrival(&self, context: &mut Context<'_>) -> Poll<()> {
        match &self.stream {
            Some(stream) => stream.poll_read_ready(context).map(drop),
            None => Poll::Pending,
        }
    }

    /// Takes the received bytes from the socket. Returns whether there is a connection.
    pub(super) fn receive(&mut self) -> bool {
        let Some(stream) = &self.stream else { return false };
        let mut chunk = [0; 256];
        while self.received.len() < ROOM {
            match stream.try_read(&mut chunk) {
                Ok(0) => return false,
                Ok(count) => self.received.extend(chunk.get(..count).unwrap_or(&[])),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
        }
        true
    }

    /// Passes the bytes of a turn to the socket. Returns whether there is a connection.
    pub(super) fn send(&mut self) -> bool {
        let Some(stream) = &self.stream else { return false };
        while !self.unsent.is_empty() {
            match stream.try_write(&self.unsent) {
                Ok(0) => return false,
                Ok(count) => drop(self.unsent.drain(..count)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
        }
        self.is_full = !self.unsent.is_empty();
        true
    }
}

impl ErrorType for GripperLine {
    type Error = io::Error;
}

impl ReadReady for GripperLine {
    fn read_ready(&mut self) -> io::Result<bool> {
        Ok(!self.received.is_empty())
    }
}

impl Read for GripperLine {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = buffer.len().min(self.received.len());
        buffer.iter_mut().zip(self.received.drain(..count)).for_each(|(place, byte)| *place = byte);
        Ok(count)
    }
}

impl WriteReady for GripperLine {
    fn write_ready(&mut self) -> io::Result<bool> {
        Ok(self.stream.is_some() && !self.is_full && self.unsent.len() < ROOM)
    }
}

impl Write for GripperLine {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.unsent.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
