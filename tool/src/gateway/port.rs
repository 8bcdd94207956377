//! A serial port to a gripper or an SLCAN adapter, or a CAN interface, whose reads and writes never wait.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::os::fd::AsFd;
use std::task::{Context, Poll};

use serial2::SerialPort;
use tokio::net::unix::pipe;
use tokio::task::spawn_blocking;
use wsg_protocol::can::Identifiers;

use crate::gripper::can::{self, Carrier, Decoder, Encoder, STRUCT_LEN, is_full};
use crate::gripper::wire::{open_interface, open_port};

/// An open port. No other gateway and no `wsg gripper` uses the same serial port.
pub(super) struct Port {
    /// The serial port, unless this is a CAN interface.
    serial: Option<SerialPort>,
    // Tokio's unchecked pipes read and write any descriptor.
    reader: pipe::Receiver,
    writer: pipe::Sender,
    /// The CAN frames on an adapter or interface.
    codec: Option<Box<(Encoder<()>, Decoder)>>,
    /// The frame that a CAN interface has taken, until the bus has taken it.
    in_flight: Vec<u8>,
}

impl Port {
    /// Opens a port with a gripper, with 8N1.
    pub(super) async fn open(device: &str, rate: u32) -> io::Result<Self> {
        let device = device.to_owned();
        // In a thread, which an adapter that hangs delays.
        let port = spawn_blocking(move || open_port(&device, rate, true)).await??;
        Self::new(&port, None).map(|it| Self { serial: Some(port), ..it })
    }

    /// Opens a port with an SLCAN adapter, and the adapter's channel.
    pub(super) async fn open_slcan(device: &str, kbit: u16, identifiers: Identifiers) -> io::Result<Self> {
        let device = device.to_owned();
        let port = spawn_blocking(move || {
            let mut port = open_port(&device, can::PORT_RATE, true)?;
            can::open_channel(&mut port, kbit)?;
            io::Result::Ok(port)
        });
        let port = port.await??;
        Self::new(&port, Some((Carrier::Slcan, identifiers))).map(|it| Self { serial: Some(port), ..it })
    }

    /// Opens a CAN interface, which other programs may use, too.
    pub(super) fn open_interface(name: &str, identifiers: Identifiers) -> io::Result<Self> {
        Self::new(&open_interface(name, identifiers, false)?, Some((Carrier::SocketCan, identifiers)))
    }

    fn new(port: &impl AsFd, codec: Option<(Carrier, Identifiers)>) -> io::Result<Self> {
        let reader = pipe::Receiver::from_owned_fd_unchecked(port.as_fd().try_clone_to_owned()?)?;
        let writer = pipe::Sender::from_owned_fd_unchecked(port.as_fd().try_clone_to_owned()?)?;
        let codec = codec.map(|(carrier, identifiers)| {
            Box::new((Encoder::new((), carrier, identifiers), Decoder::new(carrier, identifiers)))
        });
        Ok(Self { serial: None, reader, writer, codec, in_flight: Vec::new() })
    }

    fn carrier(&self) -> Option<Carrier> {
        self.codec.as_ref().map(|codec| codec.0.carrier)
    }

    pub(super) fn try_read(&self, chunk: &mut [u8]) -> io::Result<usize> {
        self.reader.try_read(chunk)
    }

    /// Writes without waiting. A CAN interface gets one frame at a time: without a bus, it would send all later.
    pub(super) fn try_write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.carrier() != Some(Carrier::SocketCan) {
            return self.writer.try_write(bytes);
        }
        if !self.in_flight.is_empty() {
            return Err(ErrorKind::WouldBlock.into());
        }
        let frame = bytes.get(..STRUCT_LEN).unwrap_or(bytes);
        match self.writer.try_write(frame) {
            Ok(count) => {
                self.in_flight.extend(frame);
                Ok(count)
            }
            Err(error) if is_full(&error) => Err(ErrorKind::WouldBlock.into()),
            Err(error) => Err(error),
        }
    }

    pub(super) fn poll_arrival(&self, context: &mut Context<'_>) -> Poll<()> {
        self.reader.poll_read_ready(context).map(drop)
    }

    pub(super) fn encode(&mut self, bytes: &[u8], unsent: &mut Vec<u8>) {
        match self.codec.as_deref_mut() {
            Some((encoder, _)) => unsent.extend(encoder.encode(bytes)),
            None => unsent.extend(bytes),
        }
    }

    pub(super) fn decode(&mut self, bytes: &[u8], received: &mut VecDeque<u8>) -> io::Result<()> {
        if self.in_flight == bytes {
            self.in_flight.clear();
        }
        match self.codec.as_deref_mut() {
            Some((_, decoder)) => decoder.decode(bytes, received),
            None => {
                received.extend(bytes);
                Ok(())
            }
        }
    }

    /// Closes the port, after discarding both queues of a serial port if requested. An SLCAN adapter then gives up the frames that
    /// the bus has not taken.
    pub(super) fn close(self, discards: bool) {
        if let Some(serial) = self.serial.as_ref().filter(|_| discards) {
            // An error means that the adapter has vanished.
            let _ = serial.discard_buffers();
        }
        if let Some(carrier) = self.carrier() {
            let _ = self.writer.try_write(carrier.closing());
        }
        // In a thread: the system waits for a USB adapter that takes no bytes.
        drop(spawn_blocking(move || drop(self)));
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixDatagram;
    use std::time::{Duration, Instant};

    use embedded_io::{Read, Write, WriteReady};
    use tokio::time::sleep;
    use wsg_protocol::can::Segments;
    use wsg_protocol::{Command, FrameEncoder};

    use super::super::line::{GripperLine, Stream};
    use super::*;

    fn frame_of(identifier: u32, data: &[u8]) -> Vec<u8> {
        let mut frame = [&identifier.to_ne_bytes()[..], &[data.len() as u8, 0, 0, 0], data].concat();
        frame.resize(STRUCT_LEN, 0);
        frame
    }

    /// Moves bytes between line and socket until a condition holds.
    async fn until(line: &mut GripperLine, mut holds: impl FnMut(&mut GripperLine) -> bool) {
        let start = Instant::now();
        while !holds(line) {
            assert!(start.elapsed() < Duration::from_secs(60), "time-out");
            sleep(Duration::from_millis(1)).await;
            line.receive().unwrap();
            line.send().unwrap();
        }
    }

    /// A pair of datagram sockets takes the place of a CAN interface.
    #[tokio::test]
    async fn interface_gets_a_frame_after_the_bus_has_taken_the_one_before() {
        let (interface, bus) = UnixDatagram::pair().unwrap();
        interface.set_nonblocking(true).unwrap();
        bus.set_nonblocking(true).unwrap();
        let port = Port::new(&interface, Some((Carrier::SocketCan, Identifiers::DEFAULT))).unwrap();
        let mut line = GripperLine::default();
        line.open(Stream::Port(port));
        let grip = Command::GripPart { width: 20.0, speed: 50.0 };
        let grip: Vec<u8> = FrameEncoder::new(grip.id().code(), grip).collect();
        assert_eq!(line.write(&grip).unwrap(), grip.len());
        for segment in Segments::new(grip.iter().copied()) {
            let mut frame = [0; STRUCT_LEN];
            until(&mut line, |_| bus.recv(&mut frame).is_ok()).await;
            assert_eq!(frame[..], frame_of(0x120, segment.data()));
            // The frame of another program is no confirmation.
            bus.send(&[&frame[..15], &[!frame[15]]].concat()).unwrap();
            let mut turns = 0;
            until(&mut line, |_| {
                turns += 1;
                turns > 20
            })
            .await;
            assert_eq!(bus.recv(&mut [0; STRUCT_LEN]).unwrap_err().kind(), ErrorKind::WouldBlock);
            bus.send(&frame).unwrap();
        }
        let reply: Vec<u8> = FrameEncoder::new(0x25, &[0_u8, 0][..]).collect();
        for segment in Segments::new(reply.iter().copied()) {
            bus.send(&frame_of(0x121, segment.data())).unwrap();
        }
        let mut received = Vec::<u8>::new();
        until(&mut line, |line| {
            let mut chunk = [0; 64];
            let count = line.read(&mut chunk).unwrap();
            received.extend(&chunk[..count]);
            received == reply
        })
        .await;
        assert!(line.write_ready().unwrap());
    }
}
