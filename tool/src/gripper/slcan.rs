//! A gripper on a CAN bus, behind an adapter that speaks SLCAN.

use std::collections::VecDeque;
use std::io::{self, Read, Write};

use bus_slcan::{ClassicFrame, Decoder, Line, encode};
use wsg_protocol::can::{Endpoint, HALF_MESSAGE_MS, Identifiers, MAX_FRAMES, Reassembler, Segmenter};
use wsg_protocol::driver::{Clock, host::StdClock};
use wsg_protocol::{Event, FrameEncoder};

/// Bytes read at a time.
const CHUNK_LEN: usize = 512;

/// The digit of the command `S` for so many kbit/s, if there is one.
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

/// The messages of a gripper, carried by frames that an adapter carries.
pub(crate) struct Slcan<S: Read + Write> {
    port: S,
    endpoint: Endpoint,
    decoder: Decoder,
    reassembler: Reassembler<MAX_FRAMES>,
    segmenter: Segmenter,
    clock: StdClock,
    received: VecDeque<u8>,
}

impl<S: Read + Write> Slcan<S> {
    /// Opens the adapter's channel. What the adapter was doing before ends.
    pub(crate) fn open(mut port: S, kbit: u16, identifiers: Identifiers) -> io::Result<Self> {
        let rate = rate_of(kbit).ok_or_else(|| io::Error::other(format!("SLCAN has no {kbit} kbit/s")))?;
        write!(port, "\rC\rS{rate}\rO\r")?;
        let endpoint = identifiers.controller();
        Ok(Self {
            port,
            endpoint,
            decoder: Decoder::new(),
            reassembler: Reassembler::new(endpoint.receive, HALF_MESSAGE_MS),
            segmenter: Segmenter::new(),
            clock: StdClock::new(),
            received: VecDeque::new(),
        })
    }
}

impl<S: Read + Write> Read for Slcan<S> {
    #[expect(clippy::disallowed_methods, reason = "the caller takes a signal for silence")]
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.received.is_empty() {
            let mut chunk = [0; CHUNK_LEN];
            let count = self.port.read(&mut chunk)?;
            if count == 0 {
                return Ok(0);
            }
            let Self { decoder, reassembler, clock, received, .. } = self;
            for &byte in chunk.iter().take(count) {
                // What the adapter answers to commands is read over: without a channel there is no gripper.
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
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let segments = bytes.iter().filter_map(|byte| self.segmenter.push(*byte));
        let frames = segments.filter_map(|segment| segment.frame::<ClassicFrame>(self.endpoint.transmit));
        let lines: Vec<u8> = frames.flat_map(|frame| encode(&frame).as_bytes().to_vec()).collect();
        self.port.write_all(&lines)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

impl<S: Read + Write> Drop for Slcan<S> {
    fn drop(&mut self) {
        // Nobody is left to be told of an error.
        let _ = self.port.write_all(b"C\r");
    }
}

#[cfg(unix)]
impl<S: Read + Write + std::os::fd::AsFd> std::os::fd::AsFd for Slcan<S> {
    fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
        self.port.as_fd()
    }
}
