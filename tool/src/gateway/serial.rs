//! A serial port to a gripper, or to an SLCAN adapter, whose reads and writes never wait.

use std::collections::VecDeque;
use std::io;
use std::os::fd::AsFd;
use std::task::{Context, Poll};

use serial2::SerialPort;
use tokio::net::unix::pipe;
use tokio::task::spawn_blocking;
use wsg_protocol::can::Identifiers;

use crate::gripper::slcan::{self, Decoder, Encoder};
use crate::gripper::wire::open_port;

/// Closes the channel of an SLCAN adapter, after the rest of an earlier line.
const CLOSING: &[u8] = b"\rC\r";

/// An open port, which no other gateway and no `wsg gripper` uses.
pub(super) struct Port {
    port: SerialPort,
    // Tokio's unchecked pipes read and write any descriptor.
    reader: pipe::Receiver,
    writer: pipe::Sender,
    /// SLCAN, if an adapter is connected to the port.
    codec: Option<Box<(Encoder<()>, Decoder)>>,
}

impl Port {
    /// Opens a port with a gripper, with 8N1.
    pub(super) async fn open(device: &str, rate: u32) -> io::Result<Self> {
        let device = device.to_owned();
        // In a thread, which an adapter that hangs delays.
        let port = spawn_blocking(move || open_port(&device, rate, true)).await??;
        Self::new(port, None)
    }

    /// Opens a port with an SLCAN adapter, and the adapter's channel.
    pub(super) async fn open_slcan(device: &str, kbit: u16, identifiers: Identifiers) -> io::Result<Self> {
        let device = device.to_owned();
        let port = spawn_blocking(move || {
            let mut port = open_port(&device, slcan::PORT_RATE, true)?;
            slcan::open_channel(&mut port, kbit)?;
            io::Result::Ok(port)
        });
        Self::new(port.await??, Some((Encoder::new((), identifiers), Decoder::new(identifiers))))
    }

    fn new(port: SerialPort, codec: Option<(Encoder<()>, Decoder)>) -> io::Result<Self> {
        let reader = pipe::Receiver::from_owned_fd_unchecked(port.as_fd().try_clone_to_owned()?)?;
        let writer = pipe::Sender::from_owned_fd_unchecked(port.as_fd().try_clone_to_owned()?)?;
        Ok(Self { port, reader, writer, codec: codec.map(Box::new) })
    }

    pub(super) fn try_read(&self, chunk: &mut [u8]) -> io::Result<usize> {
        self.reader.try_read(chunk)
    }

    pub(super) fn try_write(&self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.try_write(bytes)
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

    pub(super) fn decode(&mut self, bytes: &[u8], received: &mut VecDeque<u8>) {
        match self.codec.as_deref_mut() {
            Some((_, decoder)) => decoder.decode(bytes, received),
            None => received.extend(bytes),
        }
    }

    /// Closes the port, after discarding both of its queues if requested. An SLCAN adapter then gives up the frames that the bus
    /// has not taken.
    pub(super) fn close(self, discards: bool) {
        if discards {
            // An error means that the adapter has vanished.
            let _ = self.port.discard_buffers();
        }
        if self.codec.is_some() {
            let _ = self.writer.try_write(CLOSING);
        }
        // In a thread: the system waits for a USB adapter that takes no bytes.
        drop(spawn_blocking(move || drop(self)));
    }
}
