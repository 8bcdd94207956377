//! Transport to a gripper on a CAN bus through an SLCAN adapter.

use std::collections::VecDeque;
use std::io::{self, Read, Write};

use bus_slcan::{ClassicFrame, Decoder as LineDecoder, Line, encode};
use embedded_can::StandardId;
use wsg_protocol::can::{HALF_MESSAGE_MS, Identifiers, MAX_FRAMES, Reassembler, Segmenter};
use wsg_protocol::driver::{Clock, host::StdClock};
use wsg_protocol::{Event, FrameEncoder};

/// Rate of the serial port of an adapter in bit/s. USB adapters ignore it; others use it as their default.
pub(crate) const PORT_RATE: u32 = 115_200;

/// Maximum number of bytes per read.
const CHUNK_LEN: usize = 512;

/// Returns the digit of the SLCAN command `S` for a rate in kbit/s, or `None` for an unsupported rate.
pub(crate) fn rate_of(kbit: u16) -> Option<char> {
    const RATES: [(u16, char); 9] = [
        (10, '0'),
        (20, '1'),
        (50, '2'),
        (100, '3'),
        (125, '4'),
        (250, '5'),
        (500, '6'),
        (800, '7'),
        (1000, '8'),
    ];
    RATES.iter().find(|(rate, _)| *rate == kbit).map(|(_, digit)| *digit)
}

/// Closes any channel that is open on the adapter, sets the rate and opens the channel.
pub(crate) fn open_channel(port: &mut impl Write, kbit: u16) -> io::Result<()> {
    let rate =
        rate_of(kbit).ok_or_else(|| io::Error::other(format!("SLCAN does not support {kbit} kbit/s")))?;
    write!(port, "\rC\rS{rate}\rO\r")
}

/// Encodes gripper messages as CAN frames in SLCAN, and writes them to a port, if it has one.
#[derive(Debug)]
pub(crate) struct Encoder<S> {
    port: S,
    identifier: StandardId,
    segmenter: Segmenter,
}

impl<S> Encoder<S> {
    pub(crate) const fn new(port: S, identifiers: Identifiers) -> Self {
        Self { port, identifier: identifiers.controller().transmit, segmenter: Segmenter::new() }
    }

    /// Returns the CAN frames that these bytes of messages complete.
    pub(crate) fn encode(&mut self, bytes: &[u8]) -> Vec<u8> {
        let segments = bytes.iter().filter_map(|byte| self.segmenter.push(*byte));
        let frames = segments.filter_map(|segment| segment.frame::<ClassicFrame>(self.identifier));
        frames.flat_map(|frame| encode(&frame).as_bytes().to_vec()).collect()
    }
}

impl<S: Write> Write for Encoder<S> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let lines = self.encode(bytes);
        self.port.write_all(&lines)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

/// Decodes the gripper's messages from CAN frames in SLCAN.
pub(crate) struct Decoder {
    lines: LineDecoder,
    reassembler: Reassembler<MAX_FRAMES>,
    clock: StdClock,
}

impl Decoder {
    pub(crate) fn new(identifiers: Identifiers) -> Self {
        Self {
            lines: LineDecoder::new(),
            reassembler: Reassembler::new(identifiers.controller().receive, HALF_MESSAGE_MS),
            clock: StdClock::new(),
        }
    }

    /// Appends the messages that these bytes complete.
    pub(crate) fn decode(&mut self, bytes: &[u8], received: &mut VecDeque<u8>) {
        let Self { lines, reassembler, clock } = self;
        for &byte in bytes {
            // Replies of the adapter are skipped: if it failed to open the channel, the gripper does not answer.
            if let Some(Line::Frame(frame)) = lines.push::<ClassicFrame>(byte) {
                reassembler.receive(clock.now(), &frame, |event| {
                    if let Event::Frame(frame) = event {
                        received.extend(FrameEncoder::new(frame.id, frame.payload));
                    }
                });
            }
        }
    }
}

/// A byte stream of gripper messages, carried in CAN frames over SLCAN.
pub(crate) struct Slcan<S: Read + Write> {
    encoder: Encoder<S>,
    decoder: Decoder,
    received: VecDeque<u8>,
}

impl<S: Read + Write> Slcan<S> {
    /// Opens the channel of the adapter.
    pub(crate) fn open(mut port: S, kbit: u16, identifiers: Identifiers) -> io::Result<Self> {
        open_channel(&mut port, kbit)?;
        Ok(Self {
            encoder: Encoder::new(port, identifiers),
            decoder: Decoder::new(identifiers),
            received: VecDeque::new(),
        })
    }
}

impl<S: Read + Write> Read for Slcan<S> {
    #[expect(clippy::disallowed_methods, reason = "the caller treats an interrupted read as no data")]
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.received.is_empty() {
            let mut chunk = [0; CHUNK_LEN];
            let count = self.encoder.port.read(&mut chunk)?;
            if count == 0 {
                return Ok(0);
            }
            self.decoder.decode(chunk.get(..count).unwrap_or(&[]), &mut self.received);
            if self.received.is_empty() {
                return Err(io::ErrorKind::WouldBlock.into());
            }
        }
        self.received.read(buffer)
    }
}

impl<S: Read + Write> Write for Slcan<S> {
    #[expect(clippy::disallowed_methods, reason = "the encoder writes everything or fails")]
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.encoder.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.encoder.flush()
    }
}

impl<S: Read + Write> Drop for Slcan<S> {
    fn drop(&mut self) {
        // An error cannot be reported from here.
        let _ = self.encoder.port.write_all(b"C\r");
    }
}
