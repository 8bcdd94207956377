//! The log: a line for each frame, with time, direction, line, hex and meaning.

use crate::port::PortId;
use crate::time::Time;
use anyhow::{Context, Result};
use std::collections::HashMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD, PREAMBLE_LEN};
use wsg_protocol::{Command, CommandId, Event, Frame, FrameEncoder, FrameParser, Reply};

/// Where the payload begins in a frame.
const PAYLOAD_AT: usize = PREAMBLE_LEN + 3;
/// Bytes of the checksum.
const CHECKSUM_LEN: usize = 2;

/// Writes a line for each frame:
///
/// ```text
/// 12.345678 s tcp 127.0.0.1:40000 -> AA AA AA 22 00 00 D3 5A  22h Stop
/// ```
///
/// `->` goes to the gripper, `<-` comes from it.
pub struct Log {
    /// `None` after writing failed.
    output: Option<Box<dyn Write>>,
    /// One for each client: what it sends is cut into frames here once more.
    parsers: HashMap<PortId, FrameParser<{ MAX_MESSAGE_LEN - OVERHEAD }>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    ToGripper,
    FromGripper,
}

impl Log {
    /// A log that is written here.
    #[must_use]
    pub fn to(output: impl Write + 'static) -> Self {
        Self { output: Some(Box::new(output)), parsers: HashMap::new() }
    }

    /// A log on standard output.
    #[must_use]
    pub fn to_stdout() -> Self {
        Self::to(io::stdout())
    }

    /// A log in this file, which is emptied.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn to_file(path: &Path) -> Result<Self> {
        let file =
            File::create(path).with_context(|| format!("the log {} cannot be written", path.display()))?;
        Ok(Self::to(BufWriter::new(file)))
    }

    pub(super) fn connect(&mut self, id: PortId, check_checksum: bool) {
        let parser = if check_checksum { FrameParser::new() } else { FrameParser::ignoring_checksums() };
        self.parsers.insert(id, parser);
    }

    pub(super) fn disconnect(&mut self, id: PortId) {
        self.parsers.remove(&id);
        self.flush();
    }

    pub(super) fn received(&mut self, id: PortId, now: Time, line: &str, bytes: &[u8]) {
        let Some(mut parser) = self.parsers.remove(&id) else { return };
        let mut rest = bytes;
        loop {
            let (taken, event) = parser.push_slice(rest);
            rest = rest.get(taken..).unwrap_or(&[]);
            match event {
                Some(Event::Frame(frame)) => {
                    let whole: Vec<u8> = FrameEncoder::new(frame.id, frame.payload).collect();
                    self.frame(now, Direction::ToGripper, line, &whole);
                }
                Some(Event::BadChecksum { id, size }) => self.refused(now, line, "wrong checksum", id, size),
                Some(Event::Oversize { id, size }) => self.refused(now, line, "too long", id, size),
                None => break,
            }
        }
        self.parsers.insert(id, parser);
    }

    /// One frame with its meaning.
    pub(super) fn frame(&mut self, now: Time, direction: Direction, line: &str, bytes: &[u8]) {
        let mut hex = String::with_capacity(3 * bytes.len());
        for byte in bytes {
            // Writing to a string does not fail.
            let _ = write!(hex, "{byte:02X} ");
        }
        let id = bytes.get(PREAMBLE_LEN).copied().unwrap_or(0);
        let payload = bytes.get(PAYLOAD_AT..bytes.len().saturating_sub(CHECKSUM_LEN)).unwrap_or(&[]);
        let frame = Frame { id, payload };
        let meaning = match direction {
            Direction::ToGripper => Command::decode(&frame).map(|command| command.to_string()),
            Direction::FromGripper => Reply::decode(&frame).map(|reply| reply.to_string()),
        };
        let meaning = meaning.unwrap_or_else(|refusal| format!("{}: {refusal}", CommandId::from_code(id)));
        let arrow = if direction == Direction::ToGripper { "->" } else { "<-" };
        self.write(format_args!("{now} {line} {arrow} {hex} {meaning}\n"));
    }

    fn refused(&mut self, now: Time, line: &str, why: &str, id: u8, size: u16) {
        let id = CommandId::from_code(id);
        self.write(format_args!("{now} {line} -> {why}: {id} with {size} bytes of payload\n"));
    }

    /// A log that cannot be written is given up with one message; the gripper goes on.
    fn write(&mut self, text: std::fmt::Arguments<'_>) {
        let Some(output) = &mut self.output else { return };
        if let Err(error) = output.write_fmt(text) {
            eprintln!("wsg-sim: the log ends here: {error}");
            self.output = None;
        }
    }

    fn flush(&mut self) {
        if let Some(output) = &mut self.output {
            // A failure shows at the next line.
            let _ = output.flush();
        }
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        self.flush();
    }
}

impl std::fmt::Debug for Log {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Log").finish_non_exhaustive()
    }
}
