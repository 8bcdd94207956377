//! The bridge's end of the gripper's link: records received bytes and parses sent messages.

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{CommandId, FrameParser};

use crate::gripper_states::{self, Message};

/// Length of a frame up to and including its id.
const UP_TO_ID: usize = 4;

/// A link and its traffic. A slow one starts a frame only in a millisecond with room up to its id, so the command is
/// known at its first byte.
pub(crate) struct Tap<L> {
    pub(crate) link: L,
    /// Capacity of a slow link in bytes per millisecond.
    per_ms: Option<usize>,
    /// Remaining capacity in this millisecond.
    left: usize,
    /// The frame in transmission on a slow link.
    frame: Vec<u8>,
    received: Vec<u8>,
    begun: Vec<CommandId>,
    /// Complete frames, and their parser.
    whole: Vec<u8>,
    parser: FrameParser<64>,
}

impl<L> Tap<L> {
    pub(crate) fn new(link: L, per_ms: Option<usize>) -> Self {
        Self {
            link,
            per_ms,
            left: 0,
            frame: Vec::new(),
            received: Vec::new(),
            begun: Vec::new(),
            whole: Vec::new(),
            parser: FrameParser::new(),
        }
    }

    pub(crate) const fn is_slow(&self) -> bool {
        self.per_ms.is_some()
    }

    /// Returns the link for one turn of the bridge.
    pub(crate) fn turn(&mut self) -> &mut Self {
        self.left = self.per_ms.unwrap_or(usize::MAX);
        self
    }

    /// Returns the bytes that the bridge has read.
    pub(crate) fn take_received(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.received)
    }

    /// Returns the commands whose transmission has started on a slow link.
    pub(crate) fn take_begun(&mut self) -> Vec<CommandId> {
        std::mem::take(&mut self.begun)
    }

    /// Returns the sent messages, all of which must be intact.
    pub(crate) fn take_messages(&mut self) -> Vec<Message> {
        gripper_states::messages(&mut self.parser, &std::mem::take(&mut self.whole))
    }

    /// Drops the rest of the frame in transmission, unless it is a FAST STOP.
    pub(crate) fn cut(&mut self) {
        if self.frame.get(UP_TO_ID - 1) != Some(&CommandId::FastStop.code()) {
            self.frame.clear();
        }
    }

    fn take(&mut self, byte: u8) {
        self.frame.push(byte);
        if self.frame.len() == UP_TO_ID {
            self.begun.push(CommandId::from_code(byte));
        }
        if let [_, _, _, _, low, high, ..] = self.frame[..]
            && self.frame.len() == OVERHEAD + usize::from(u16::from_le_bytes([low, high]))
        {
            self.whole.append(&mut self.frame);
        }
    }
}

impl<L: ErrorType> ErrorType for Tap<L> {
    type Error = L::Error;
}

impl<L: ReadReady> ReadReady for Tap<L> {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        self.link.read_ready()
    }
}

impl<L: Read> Read for Tap<L> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
        let count = self.link.read(buffer)?;
        self.received.extend_from_slice(&buffer[..count]);
        Ok(count)
    }
}

impl<L: WriteReady> WriteReady for Tap<L> {
    fn write_ready(&mut self) -> Result<bool, Self::Error> {
        let room = if self.frame.is_empty() { UP_TO_ID } else { 1 };
        Ok(self.left >= room && self.link.write_ready()?)
    }
}

impl<L: Write> Write for Tap<L> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        let count = self.link.write(&bytes[..bytes.len().min(self.left)])?;
        if self.is_slow() {
            self.left -= count;
            bytes[..count].iter().for_each(|byte| self.take(*byte));
        } else {
            self.whole.extend_from_slice(&bytes[..count]);
        }
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        self.link.flush()
    }
}
