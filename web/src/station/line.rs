//! The RS-232 line between bridge and gripper, byte by byte at its rate, with its faults and the frames on it.

use std::collections::VecDeque;
use std::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::gripper::{BAUD, TO_SEND_MAX};
use wsg_protocol::frame::MAX_MESSAGE_LEN;
use wsg_protocol::{Direction, Event, FrameEncoder, FrameParser, Meaning};
use wsg_sim::control::json::members;

/// Time of a byte with start and stop bit, in nanoseconds.
const BYTE_NS: u64 = 10 * 1_000_000_000 / BAUD as u64;

/// Number of bytes that the line carries between two turns of the bridge.
const BYTES_PER_TURN: usize = 12;

/// Bits that the injected fault flips in a byte.
const FLIPPED: u8 = 0x10;

/// A frame that was sent on the line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SentFrame {
    /// Number of the frame since the start, from 0.
    pub number: u32,
    /// End of its last byte.
    pub at_us: u64,
    /// Duration on the line.
    pub takes_us: u64,
    /// Whether the bridge sent it.
    pub to_gripper: bool,
    /// Request or reply in words.
    pub text: String,
    /// Sent bytes in hexadecimal.
    pub bytes: String,
    /// Whether a byte was changed on the line.
    pub is_damaged: bool,
    /// Whether a byte was lost, because the line was cut.
    pub is_lost: bool,
}
members!(SentFrame: number, at_us, takes_us, to_gripper, text, bytes, is_damaged, is_lost);

/// One direction of the line.
pub(super) struct Way {
    direction: Direction,
    /// Bytes that are not yet received, with the end of each in nanoseconds.
    bytes: VecDeque<(u64, u8)>,
    busy_until_ns: u64,
    /// Finds the frames in the sent bytes.
    parser: FrameParser<MAX_MESSAGE_LEN>,
    is_damaged: bool,
    is_lost: bool,
    /// Whether the line is cut.
    pub(super) is_cut: bool,
    /// Number of bytes to damage.
    pub(super) damages: u8,
}

impl Way {
    pub(super) fn new(direction: Direction) -> Self {
        Self {
            direction,
            bytes: VecDeque::new(),
            busy_until_ns: 0,
            parser: FrameParser::new(),
            is_damaged: false,
            is_lost: false,
            is_cut: false,
            damages: 0,
        }
    }

    /// Discards all bytes at a restart of the sender. The faults stay.
    pub(super) fn restart(&mut self) {
        *self = Self { is_cut: self.is_cut, damages: self.damages, ..Self::new(self.direction) };
    }

    pub(super) fn send(&mut self, now_ns: u64, bytes: &[u8]) {
        for &byte in bytes {
            self.busy_until_ns = self.busy_until_ns.max(now_ns) + BYTE_NS;
            self.bytes.push_back((self.busy_until_ns, byte));
        }
    }

    /// Returns the end of the next byte.
    pub(super) fn due_ns(&self) -> u64 {
        self.bytes.front().map_or(u64::MAX, |(end_ns, _)| *end_ns)
    }

    /// Takes the next byte at its end, `None` if it is lost, and a frame that ends with it.
    pub(super) fn receive(&mut self) -> (Option<u8>, Option<SentFrame>) {
        let Some((end_ns, byte)) = self.bytes.pop_front() else { return (None, None) };
        let is_damaged = !self.is_cut && self.damages > 0;
        self.damages -= u8::from(is_damaged);
        self.is_damaged |= is_damaged;
        self.is_lost |= self.is_cut;
        let direction = self.direction;
        let frame = self.parser.push(byte).and_then(|event| {
            let Event::Frame(frame) = event else { return None };
            let bytes: Vec<u8> = FrameEncoder::new(frame.id, frame.payload).collect();
            Some(SentFrame {
                number: 0,
                at_us: end_ns / 1_000,
                takes_us: bytes.len() as u64 * BYTE_NS / 1_000,
                to_gripper: direction == Direction::ToGripper,
                text: Meaning { direction, frame }.to_string(),
                bytes: hex(&bytes),
                is_damaged: self.is_damaged,
                is_lost: self.is_lost,
            })
        });
        if frame.is_some() {
            (self.is_damaged, self.is_lost) = (false, false);
        }
        let received = if is_damaged { byte ^ FLIPPED } else { byte };
        ((!self.is_cut).then_some(received), frame)
    }
}

/// Formats bytes as `AA 01`.
pub(super) fn hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789ABCDEF";
    let mut text = String::with_capacity(3 * bytes.len());
    for (at, byte) in bytes.iter().enumerate() {
        text.push_str(if at > 0 { " " } else { "" });
        text.extend([byte >> 4, byte & 15].map(|digit| char::from(DIGITS[usize::from(digit)])));
    }
    text
}

/// The bridge's end of the line during a turn.
pub(super) struct BridgeEnd<'a> {
    now_ns: u64,
    way: &'a mut Way,
    /// Number of bytes that the send queue still takes in this turn. It takes more once the line would become idle.
    room: usize,
    /// Received bytes that the bridge has not read.
    received: &'a mut VecDeque<u8>,
    /// Bytes that the bridge has read and written in this turn.
    read: &'a mut Vec<u8>,
    written: &'a mut Vec<u8>,
}

impl<'a> BridgeEnd<'a> {
    pub(super) fn new(
        now_ns: u64,
        way: &'a mut Way,
        received: &'a mut VecDeque<u8>,
        [read, written]: [&'a mut Vec<u8>; 2],
    ) -> Self {
        read.clear();
        written.clear();
        let room = if way.bytes.len() < BYTES_PER_TURN { TO_SEND_MAX } else { 0 };
        Self { now_ns, way, room, received, read, written }
    }
}

impl ErrorType for BridgeEnd<'_> {
    type Error = Infallible;
}

impl ReadReady for BridgeEnd<'_> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.received.is_empty())
    }
}

impl Read for BridgeEnd<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let count = buffer.len().min(self.received.len());
        for (place, byte) in buffer.iter_mut().zip(self.received.drain(..count)) {
            *place = byte;
            self.read.push(byte);
        }
        Ok(count)
    }
}

impl WriteReady for BridgeEnd<'_> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.room > 0)
    }
}

impl Write for BridgeEnd<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let count = bytes.len().min(self.room);
        self.room -= count;
        let (taken, _) = bytes.split_at(count);
        self.way.send(self.now_ns, taken);
        self.written.extend_from_slice(taken);
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
