//! The gateway's line to a gripper, which no turn of the bridge waits for.
//!
//! Only a gripper on TCP notices the end of its line.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::mem;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, Shutdown, SocketAddr};
use std::task::{Context, Poll};
use std::time::Duration;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use socket2::SockRef;
use tokio::net::{TcpStream, UdpSocket, lookup_host};
use tokio::time::timeout;
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{Event, FrameParser};

#[cfg(unix)]
use super::port::Port;
use crate::gripper::Address;

/// Room for sent bytes, and for received ones. A burst of FAST STOPs has less, even as SLCAN.
const ROOM: usize = 4_096;

/// Maximum number of reads in a turn: datagrams of other senders must not hold the bridge.
const MAX_READS: usize = 64;

/// Maximum number of bytes in a read. It is longer than any message, and the size of a datagram over Ethernet.
const CHUNK_LEN: usize = 1_500;

/// Maximum payload of a message that shows that the gripper answers. A longer one would delay the detection of the next messages
/// after a damaged length.
const ANSWER_LEN: usize = 16;

/// Time-out of an attempt to connect to one address of the gripper.
const CONNECT_TIME: Duration = Duration::from_secs(3);

/// An open line. A new one contains no bytes of an earlier one.
pub(super) enum Stream {
    Tcp(TcpStream),
    Udp(UdpSocket, SocketAddr),
    #[cfg(unix)]
    Port(Port),
}

impl Stream {
    /// Opens the line to an address.
    pub(super) async fn open(address: &Address) -> io::Result<Self> {
        match address {
            Address::Tcp(host) => {
                let stream = connect(host).await?;
                stream.set_nodelay(true)?;
                // Closing it, even by the end of the process, resets the connection: unsent commands are discarded, and the gripper
                // enters FAST STOP.
                SockRef::from(&stream).set_linger(Some(Duration::ZERO))?;
                Ok(Self::Tcp(stream))
            }
            Address::Udp { gripper, answer_port } => {
                let gripper = lookup_host(gripper).await?.next().ok_or_else(unresolved)?;
                let any: IpAddr = match gripper {
                    SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
                    SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
                };
                Ok(Self::Udp(UdpSocket::bind((any, *answer_port)).await?, gripper))
            }
            #[cfg(unix)]
            Address::Serial { device, rate } => Port::open(device, *rate).await.map(Self::Port),
            #[cfg(unix)]
            Address::Slcan { device, kbit, identifiers } => {
                Port::open_slcan(device, *kbit, *identifiers).await.map(Self::Port)
            }
            #[cfg(unix)]
            Address::SocketCan { interface, identifiers } => {
                Port::open_interface(interface, *identifiers).map(Self::Port)
            }
            _ => Err(io::Error::new(ErrorKind::Unsupported, "a gateway does not support this line")),
        }
    }

    /// Reads without waiting. 0 bytes are the end of the line. `Interrupted` means that the next read may succeed.
    fn try_read(&self, chunk: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.try_read(chunk),
            Self::Udp(socket, gripper) => match socket.try_recv_from(chunk) {
                // The manual does not state the source port of an answer.
                Ok((count @ 1.., sender)) if sender.ip() == gripper.ip() => Ok(count),
                Ok(_) => Err(ErrorKind::Interrupted.into()),
                Err(error) if is_unheard(&error) => Err(ErrorKind::Interrupted.into()),
                Err(error) => Err(error),
            },
            #[cfg(unix)]
            Self::Port(port) => port.try_read(chunk),
        }
    }

    /// Writes without waiting.
    fn try_write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.try_write(bytes),
            Self::Udp(socket, gripper) => match socket.try_send_to(bytes, *gripper) {
                Err(error) if is_unheard(&error) => Ok(bytes.len()),
                result => result,
            },
            #[cfg(unix)]
            Self::Port(port) => port.try_write(bytes),
        }
    }

    /// Returns the bytes of the next write.
    fn next_write<'a>(&self, unsent: &'a [u8]) -> &'a [u8] {
        match self {
            Self::Udp(..) => first_message(unsent),
            _ => unsent,
        }
    }

    fn poll_arrival(&self, context: &mut Context<'_>) -> Poll<()> {
        match self {
            Self::Tcp(stream) => stream.poll_read_ready(context).map(drop),
            Self::Udp(socket, _) => socket.poll_recv_ready(context).map(drop),
            #[cfg(unix)]
            Self::Port(port) => port.poll_arrival(context),
        }
    }

    /// Appends bytes of messages, as the line carries them.
    fn encode(&mut self, bytes: &[u8], unsent: &mut Vec<u8>) {
        match self {
            #[cfg(unix)]
            Self::Port(port) => port.encode(bytes, unsent),
            _ => unsent.extend(bytes),
        }
    }

    /// Appends the bytes of messages in bytes of the line.
    fn decode(&mut self, bytes: &[u8], received: &mut VecDeque<u8>) -> io::Result<()> {
        match self {
            #[cfg(unix)]
            Self::Port(port) => return port.decode(bytes, received),
            _ => received.extend(bytes),
        }
        Ok(())
    }
}

/// Connects to the first address that accepts the connection.
async fn connect(host: &str) -> io::Result<TcpStream> {
    let mut result = Err(unresolved());
    for address in lookup_host(host).await? {
        result = timeout(CONNECT_TIME, TcpStream::connect(address)).await.unwrap_or_else(|_| {
            let why = format!("{address} has not answered within {} s", CONNECT_TIME.as_secs());
            Err(io::Error::new(ErrorKind::TimedOut, why))
        });
        if result.is_ok() {
            break;
        }
    }
    result
}

/// Returns the first message, which is the content of a datagram; nothing while it is incomplete.
fn first_message(bytes: &[u8]) -> &[u8] {
    let size = match bytes {
        [_, _, _, _, low, high, ..] => u16::from_le_bytes([*low, *high]),
        _ => 0,
    };
    bytes.get(..OVERHEAD + usize::from(size)).unwrap_or(&[])
}

fn unresolved() -> io::Error {
    io::Error::new(ErrorKind::AddrNotAvailable, "the name does not resolve to an address")
}

/// Returns whether the error of a UDP socket means that nothing listened at the gripper's address.
fn is_unheard(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset)
}

fn closed() -> io::Error {
    io::Error::new(ErrorKind::UnexpectedEof, "the line was closed")
}

/// The line, open or not.
#[derive(Default)]
pub(super) struct GripperLine {
    stream: Option<Stream>,
    received: VecDeque<u8>,
    /// Finds messages among the received bytes.
    answers: FrameParser<ANSWER_LEN>,
    unsent: Vec<u8>,
    /// The line has not taken all bytes of the last turn, so the bridge keeps further commands.
    is_full: bool,
}

impl GripperLine {
    pub(super) const fn is_open(&self) -> bool {
        self.stream.is_some()
    }

    /// Returns whether the gripper notices the end of the line.
    pub(super) const fn is_connection(&self) -> bool {
        matches!(self.stream, Some(Stream::Tcp(_)))
    }

    /// Uses a new stream.
    pub(super) fn open(&mut self, stream: Stream) {
        *self = Self { stream: Some(stream), ..Self::default() };
    }

    /// Resets the connection, or closes socket or port. Bytes that wait in the system's queues are never sent.
    pub(super) fn reset(&mut self) {
        match mem::take(self).stream {
            #[cfg(unix)]
            Some(Stream::Port(port)) => port.close(true),
            stream => drop(stream),
        }
    }

    /// Closes the line after the last command, which is still sent. The end of a connection was announced.
    pub(super) fn finish(&mut self) {
        match mem::take(self).stream {
            Some(Stream::Tcp(stream)) => {
                let socket = SockRef::from(&stream);
                // An error means that the gripper has closed its end first.
                let _ = socket.set_linger(None);
                let _ = socket.shutdown(Shutdown::Write);
            }
            #[cfg(unix)]
            Some(Stream::Port(port)) => port.close(false),
            stream => drop(stream),
        }
    }

    /// Ready when bytes have arrived, or the line has ended. Never ready without a line.
    pub(super) fn poll_arrival(&self, context: &mut Context<'_>) -> Poll<()> {
        self.stream.as_ref().map_or(Poll::Pending, |stream| stream.poll_arrival(context))
    }

    /// Takes the received bytes from the system. Returns whether an intact message of the gripper is among them, or an error without
    /// a line.
    pub(super) fn receive(&mut self) -> io::Result<bool> {
        let known = self.received.len();
        let stream = self.stream.as_mut().ok_or_else(closed)?;
        let mut chunk = [0; CHUNK_LEN];
        for _ in 0..MAX_READS {
            if self.received.len() >= ROOM {
                break;
            }
            match stream.try_read(&mut chunk) {
                Ok(0) => return Err(closed()),
                Ok(count) => stream.decode(chunk.get(..count).unwrap_or(&[]), &mut self.received)?,
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        let new = self.received.iter().skip(known);
        Ok(new.filter(|byte| matches!(self.answers.push(**byte), Some(Event::Frame(_)))).count() > 0)
    }

    /// Passes the bytes of a turn to the system. Returns an error without a line.
    pub(super) fn send(&mut self) -> io::Result<()> {
        let stream = self.stream.as_mut().ok_or_else(closed)?;
        self.is_full = false;
        loop {
            let bytes = stream.next_write(&self.unsent);
            if bytes.is_empty() {
                return Ok(());
            }
            match stream.try_write(bytes) {
                Ok(0) => return Err(closed()),
                Ok(count) => drop(self.unsent.drain(..count)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    self.is_full = true;
                    return Ok(());
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
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
        self.stream.as_mut().ok_or_else(closed)?.encode(bytes, &mut self.unsent);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_protocol::{Command, FrameEncoder};

    #[test]
    fn datagram_has_one_complete_message() {
        let [grip, stop] = [Command::GripPart { width: 20.0, speed: 50.0 }, Command::Stop]
            .map(|command| FrameEncoder::new(command.id().code(), command).collect::<Vec<u8>>());
        let both = [&grip[..], &stop].concat();
        for len in 0..=both.len() {
            let expected = if len < grip.len() { &[] } else { &grip[..] };
            assert_eq!(first_message(&both[..len]), expected, "{len}");
        }
        assert_eq!(first_message(&both[grip.len()..]), stop);
    }
}
