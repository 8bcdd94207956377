//! Transport to a gripper on a CAN bus through an SLCAN adapter.

use std::collections::VecDeque;
use std::io::{self, Read, Write};

use bus_slcan::{ClassicFrame, Decoder, Line, encode};
use embedded_can::StandardId;
use wsg_protocol::can::{HALF_MESSAGE_MS, Identifiers, MAX_FRAMES, Reassembler, Segmenter};
use wsg_protocol::driver::{Clock, host::StdClock};
use wsg_protocol::{Event, FrameEncoder};

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

/// Encodes gripper messages as CAN frames in SLCAN, and writes them to a port.
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
}

impl<S: Write> Write for Encoder<S> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let segments = bytes.iter().filter_map(|byte| self.segmenter.push(*byte));
        let frames = segments.filter_map(|segment| segment.frame::<ClassicFrame>(self.identifier));
        let lines: Vec<u8> = frames.flat_map(|frame| encode(&frame).as_bytes().to_vec()).collect();
        self.port.write_all(&lines)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

/// A byte stream of gripper messages, carried in CAN frames over SLCAN.
pub(crate) struct Slcan<S: Read + Write> {
    encoder: Encoder<S>,
    decoder: Decoder,
    reassembler: Reassembler<MAX_FRAMES>,
    clock: StdClock,
    received: VecDeque<u8>,
}

impl<S: Read + Write> Slcan<S> {
    /// Closes any channel that is open on the adapter, sets the rate and opens the channel.
    pub(crate) fn open(mut port: S, kbit: u16, identifiers: Identifiers) -> io::Result<Self> {
        let rate =
            rate_of(kbit).ok_or_else(|| io::Error::other(format!("SLCAN does not support {kbit} kbit/s")))?;
        write!(port, "\rC\rS{rate}\rO\r")?;
        Ok(Self {
            encoder: Encoder::new(port, identifiers),
            decoder: Decoder::new(),
            reassembler: Reassembler::new(identifiers.controller().receive, HALF_MESSAGE_MS),
            clock: StdClock::new(),
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
            let Self { decoder, reassembler, clock, received, .. } = self;
            for &byte in chunk.iter().take(count) {
                // Replies of the adapter are skipped: if it failed to open the channel, the gripper does not answer.
                if let Some(Line::Frame(frame)) = decoder.push::<ClassicFrame>(byte) {
                    reassembler.receive(clock.now(), &frame, |event| {
                        if let Event::Frame(frame) = event {
                            received.extend(FrameEncoder::new(frame.id, frame.payload));
                        }
                    });
                }
            }
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
