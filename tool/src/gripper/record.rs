//! The message log: each message in hex and decoded. It has the format of the simulator's log, which `wsg decode` reads.

use std::fmt::{self, Display, Formatter, Write as _};
use std::io::{self, Write};
use std::time::Instant;

use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD};
use wsg_protocol::gcl::{LineEvent, LineReader};
use wsg_protocol::{CommandId, Direction, Event, FrameEncoder, FrameParser, Meaning};
use wsg_sim::text::one_line;

/// Writes one line per message:
///
/// ```text
/// 12.345678 s tcp://127.0.0.1:1000 -> AA AA AA 22 00 00 D3 5A  22h Stop
/// ```
pub(crate) struct Recorder {
    sinks: Vec<Box<dyn Write>>,
    start: Instant,
    name: String,
    to_gripper: Finder,
    from_gripper: Finder,
}

/// Finds the messages in the bytes of one direction.
enum Finder {
    Frames(Box<FrameParser<{ MAX_MESSAGE_LEN - OVERHEAD }>>),
    Lines(Box<LineReader<MAX_MESSAGE_LEN>>),
}

impl Finder {
    fn new(is_gcl: bool) -> Self {
        if is_gcl {
            Self::Lines(Box::new(LineReader::new()))
        } else {
            Self::Frames(Box::new(FrameParser::new()))
        }
    }

    /// Returns the text of each message that these bytes complete.
    fn find(&mut self, direction: Direction, bytes: &[u8]) -> Vec<String> {
        let mut found = Vec::new();
        let mut rest = bytes;
        while !rest.is_empty() {
            let (taken, words) = match self {
                Self::Frames(parser) => {
                    let before = parser.counters().dropped;
                    let (taken, event) = parser.push_slice(rest);
                    let words = event.map(|event| frame_words(direction, event));
                    let dropped = parser.counters().dropped.saturating_sub(before);
                    if dropped > 0 && words.is_none() {
                        found.push(format!("{dropped} bytes of no frame"));
                    }
                    (taken, words)
                }
                Self::Lines(reader) => {
                    let (taken, event) = reader.push_slice(rest);
                    let words = event.map(|event| match event {
                        LineEvent::Line(line) => line.escape_ascii().to_string(),
                        LineEvent::TooLong(begin) => format!("a line too long: {}...", begin.escape_ascii()),
                    });
                    (taken, words)
                }
            };
            found.extend(words);
            rest = rest.get(taken..).unwrap_or(&[]);
        }
        found
    }
}

impl Recorder {
    /// Creates a log for the line with this name.
    pub(crate) fn new(name: String, is_gcl: bool, sinks: Vec<Box<dyn Write>>) -> Self {
        Self {
            sinks,
            start: Instant::now(),
            name: one_line(&name).into_owned(),
            to_gripper: Finder::new(is_gcl),
            from_gripper: Finder::new(is_gcl),
        }
    }

    /// Logs the messages in bytes that were sent or received.
    pub(crate) fn record(&mut self, direction: Direction, bytes: &[u8]) -> io::Result<()> {
        let finder = match direction {
            Direction::ToGripper => &mut self.to_gripper,
            Direction::FromGripper => &mut self.from_gripper,
        };
        let time = self.start.elapsed().as_secs_f64();
        let mut text = String::new();
        for words in finder.find(direction, bytes) {
            // Writing to a string never fails.
            let _ = writeln!(text, "{time:.6} s {} {direction} {words}", self.name);
        }
        for sink in &mut self.sinks {
            let written = sink.write_all(text.as_bytes()).and_then(|()| sink.flush());
            written.map_err(|error| io::Error::other(Unlogged(error.kind())))?;
        }
        Ok(())
    }
}

/// The log could not be written.
#[derive(Debug)]
pub(crate) struct Unlogged(pub(crate) io::ErrorKind);

impl Display for Unlogged {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "cannot write the log: {}", self.0)
    }
}

impl std::error::Error for Unlogged {}

fn frame_words(direction: Direction, event: Event<'_>) -> String {
    match event {
        Event::Frame(frame) => {
            let hex = FrameEncoder::new(frame.id, frame.payload).fold(String::new(), |mut hex, byte| {
                let _ = write!(hex, "{byte:02X} ");
                hex
            });
            format!("{hex} {}", Meaning { direction, frame })
        }
        Event::BadChecksum { id, size } => {
            format!("wrong checksum: {} with {size} bytes of payload", CommandId::from_code(id))
        }
        Event::Oversize { id, size } => {
            format!("too long: {} with {size} bytes of payload", CommandId::from_code(id))
        }
    }
}
