//! A master of Modbus/TCP, for the register interface of a gripper or of a gateway.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use anyhow::{Result, anyhow, ensure};
use wsg_fieldbus::{InputImage, OutputImage};

/// Error of a request without an answer within the master's time-out.
pub const LATE: &str = "no answer within the master's time-out";

/// A connection of a master.
#[derive(Debug)]
pub struct Master {
    stream: TcpStream,
    /// Unit of the requests.
    pub unit: u8,
}

impl Master {
    /// Connects a master with this time-out.
    ///
    /// # Errors
    /// Returns the error of the socket.
    pub fn connect(server: SocketAddr, timeout: Duration) -> io::Result<Self> {
        let stream = TcpStream::connect_timeout(&server, timeout)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(timeout))?;
        Ok(Self { stream, unit: 0xFF })
    }

    /// Sends a request to registers 0 to 3.
    ///
    /// # Errors
    /// Returns the error of the socket.
    pub fn send(&mut self, image: OutputImage) -> io::Result<()> {
        self.request(&[&[16, 0, 0, 0, 4, 8][..], &image.to_bytes()].concat())
    }

    /// Sends a PDU.
    ///
    /// # Errors
    /// Returns the error of the socket.
    pub fn request(&mut self, pdu: &[u8]) -> io::Result<()> {
        self.stream.write_all(&[&[0, 1, 0, 0, 0, pdu.len() as u8 + 1, self.unit], pdu].concat())
    }

    /// Returns the PDU of the next answer, which may be an exception.
    ///
    /// # Errors
    /// Returns the error of the socket.
    ///
    /// # Panics
    /// Panics when another unit answers.
    pub fn response(&mut self) -> io::Result<Vec<u8>> {
        let mut head = [0; 7];
        self.stream.read_exact(&mut head)?;
        assert_eq!(head[6], self.unit, "the unit of the answer");
        let mut pdu = vec![0; usize::from(head[5]) - 1];
        self.stream.read_exact(&mut pdu)?;
        Ok(pdu)
    }

    /// Sends a PDU, and returns that of the answer.
    ///
    /// # Errors
    /// Returns the error of the socket.
    ///
    /// # Panics
    /// Panics when another unit answers.
    pub fn ask(&mut self, pdu: &[u8]) -> io::Result<Vec<u8>> {
        self.request(pdu)?;
        self.response()
    }

    /// Returns the PDU of the next answer.
    ///
    /// # Errors
    /// Returns an error if the answer is an exception, [`LATE`] without an answer in time, or the error of the socket.
    pub fn answer(&mut self) -> Result<Vec<u8>> {
        let pdu = self.response().map_err(|error| match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => anyhow!(LATE),
            _ => error.into(),
        })?;
        ensure!(pdu[0] & 0x80 == 0, "exception {:02X}", pdu[1]);
        Ok(pdu)
    }

    /// Writes the output image.
    ///
    /// # Errors
    /// The same as [`answer`](Self::answer).
    pub fn write(&mut self, image: OutputImage) -> Result<()> {
        self.send(image)?;
        self.answer().map(drop)
    }

    /// Reads the input image.
    ///
    /// # Errors
    /// The same as [`answer`](Self::answer).
    pub fn read(&mut self) -> Result<InputImage> {
        self.request(&[4, 0, 0, 0, 6])?;
        Ok(InputImage::from_bytes(self.answer()?[2..].try_into()?))
    }
}
