//! Entries of the output: one for each frame, each GCL line and each run of other bytes.

use std::fmt::{self, Display, Formatter};
use std::ops::RangeInclusive;

use wsg_protocol::gcl::{Answer, CommandName, ParseError, Request};
use wsg_protocol::{Command, Direction, Frame, Kind as CommandKind, Meaning, Reply, Status};
use wsg_sim::text::one_line;

use super::scan::{self, Kind, MAX_PAYLOAD_LEN};

/// Number of bytes per line of output.
const BYTES_A_LINE: usize = 16;
/// Indentation of the lines after the first of an entry.
const INDENT: &str = "              ";

/// A part of a recording: its bytes and their description.
#[derive(Debug)]
pub(crate) struct Entry {
    /// Position in the recording, in the form of its format: offset, time or packet.
    pub(crate) place: String,
    /// The direction, if known.
    pub(crate) direction: Option<Direction>,
    pub(crate) kind: EntryKind,
    /// The meaning of the bytes, or why they were dropped.
    pub(crate) words: String,
    /// The bytes, in the order of the recording.
    pub(crate) bytes: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EntryKind {
    Frame,
    /// A complete frame with a wrong checksum.
    BadChecksum,
    /// A line of GCL.
    Line,
    /// Bytes that belong to no frame or line.
    Dropped,
    /// A part of the recording that could not be read.
    Unread,
    /// A remark without bytes.
    Note,
}

impl Entry {
    pub(crate) fn note(place: String, words: String) -> Self {
        Self { place, direction: None, kind: EntryKind::Note, words, bytes: Vec::new() }
    }

    /// Names lines of the file that are not in its format.
    pub(crate) fn unread(lines: &RangeInclusive<usize>, format: &str) -> Self {
        let (first, last) = (lines.start(), lines.end());
        let lines = if first == last { format!("line {first}") } else { format!("lines {first} to {last}") };
        let words = format!("cannot read {lines}: not in {format} format");
        Self { kind: EntryKind::Unread, ..Self::note(String::new(), words) }
    }
}

impl Display for Entry {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { place, kind, words, bytes, .. } = self;
        let separator = if place.is_empty() { "" } else { "  " };
        let mark = match (kind, self.direction) {
            (EntryKind::Dropped | EntryKind::BadChecksum | EntryKind::Unread, _) => "!!".to_owned(),
            (EntryKind::Note, _) => "..".to_owned(),
            (_, Some(direction)) => direction.to_string(),
            (_, None) => "--".to_owned(),
        };
        // Both may contain text of the recording.
        write!(f, "{}{separator}{mark}  {}", one_line(place), one_line(words))?;
        if matches!(kind, EntryKind::Line | EntryKind::Unread) && !bytes.is_empty() {
            return write!(f, "\n{INDENT}{}", bytes.escape_ascii());
        }
        for line in bytes.chunks(BYTES_A_LINE) {
            write!(f, "\n{INDENT}")?;
            for (at, byte) in line.iter().enumerate() {
                write!(f, "{}{byte:02X}", if at == 0 { "" } else { " " })?;
            }
        }
        if *kind == EntryKind::Frame { f.write_str("  checksum ok") } else { Ok(()) }
    }
}

/// Returns whether a recording is in GCL: at least half of its lines can be parsed. Other text is not.
pub(crate) fn is_gcl(bytes: &[u8]) -> bool {
    let lines = bytes.split(|byte| matches!(byte, b'\n' | b'\r')).map(<[u8]>::trim_ascii);
    let (mut parsed, mut all) = (0_usize, 0_usize);
    for line in lines.filter(|line| !line.is_empty()) {
        all += 1;
        parsed += usize::from(Request::parse(line).is_ok() || Answer::parse(line).is_ok());
    }
    parsed > 0 && parsed >= all - parsed
}

/// Decodes a recording in the binary protocol. `place` formats the position of a byte range.
pub(crate) fn of_binary(
    bytes: &[u8],
    direction: Option<Direction>,
    mut place: impl FnMut(std::ops::Range<usize>) -> String,
) -> Vec<Entry> {
    let runs = scan::scan(bytes).into_iter();
    runs.map(|run| {
        let part = bytes.get(run.range.clone()).unwrap_or(&[]);
        of_run(place(run.range), part, run.kind, direction)
    })
    .collect()
}

fn of_run(place: String, bytes: &[u8], kind: Kind, direction: Option<Direction>) -> Entry {
    let dropped = count(bytes.len(), "byte");
    let (kind, direction, words) = match kind {
        Kind::Frame => {
            let (direction, words) = meaning(bytes, direction);
            (EntryKind::Frame, direction, words)
        }
        Kind::BadChecksum([low, high]) => {
            let came = bytes.last_chunk().unwrap_or(&[0; 2]);
            let (direction, words) = meaning(bytes, direction);
            let words = format!(
                "wrong checksum {:02X} {:02X}, expected {low:02X} {high:02X}; decoded: {words}",
                came[0], came[1]
            );
            (EntryKind::BadChecksum, direction, words)
        }
        Kind::TooLong(size) => (
            EntryKind::Dropped,
            direction,
            format!(
                "dropped {dropped}: preamble with a payload size of {size} bytes; the maximum is {MAX_PAYLOAD_LEN}"
            ),
        ),
        Kind::Incomplete(missing) => (
            EntryKind::Dropped,
            direction,
            format!("dropped {dropped}: truncated frame, at least {} missing", count(missing, "byte")),
        ),
        Kind::Noise => (EntryKind::Dropped, direction, format!("dropped {dropped}: no preamble")),
    };
    Entry { place, direction, kind, words, bytes: bytes.to_vec() }
}

/// Formats a count with its noun: `1 byte`, `2 bytes`.
pub(crate) fn count(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Describes a whole frame with preamble and checksum. Also returns its direction if given or evident from the frame.
fn meaning(bytes: &[u8], direction: Option<Direction>) -> (Option<Direction>, String) {
    let [_, _, _, id, _, _, payload @ .., _, _] = bytes else { return (direction, String::new()) };
    let frame = Frame { id: *id, payload };
    let text = |direction| Meaning { direction, frame }.to_string();
    if let Some(direction) = direction {
        return (Some(direction), text(direction));
    }
    let is_request = Command::decode(&frame).is_ok();
    let reply = Reply::decode(&frame);
    let is_reply = reply.is_ok();
    let has_known_status = reply.is_ok_and(|reply| !matches!(reply.status(), Status::Unknown(_)));
    match (is_request, is_reply) {
        (true, _) if !has_known_status => (Some(Direction::ToGripper), text(Direction::ToGripper)),
        (false, true) => (Some(Direction::FromGripper), text(Direction::FromGripper)),
        _ => {
            let (request, reply) = (text(Direction::ToGripper), text(Direction::FromGripper));
            (None, if request == reply { request } else { format!("{request}, or {reply}") })
        }
    }
}

/// Decodes a recording in GCL: one entry for each line that is not blank.
pub(crate) fn of_gcl(
    bytes: &[u8],
    direction: Option<Direction>,
    mut place: impl FnMut(std::ops::Range<usize>) -> String,
) -> Vec<Entry> {
    let mut entries = Vec::new();
    let mut start = 0;
    for line in bytes.split_inclusive(|byte| matches!(byte, b'\n' | b'\r')) {
        let range = start..start + line.len();
        start = range.end;
        let text = line.trim_ascii();
        if !text.is_empty() {
            let meaning = gcl_meaning(text, direction);
            let kind = if meaning.is_ok() { EntryKind::Line } else { EntryKind::Unread };
            let (direction, words) = meaning.unwrap_or_else(|words| (direction, words));
            entries.push(Entry { place: place(range), direction, kind, words, bytes: text.to_vec() });
        }
    }
    entries
}

/// Describes a GCL line. Also returns its direction if given or evident from the line.
///
/// # Errors
/// Neither a request nor an answer has this form. Returns the reason.
pub(crate) fn gcl_meaning(
    line: &[u8],
    direction: Option<Direction>,
) -> Result<(Option<Direction>, String), String> {
    let request =
        Request::parse(line).map(|request| request_words(&request)).map_err(|refused| refused.mistake);
    let answer = Answer::parse(line).map(|answer| answer_words(&answer));
    let refused = |mistake: ParseError| format!("not understood: {mistake}");
    match (direction, request, answer) {
        (Some(Direction::ToGripper), request, _) => request.map(|words| (direction, words)).map_err(refused),
        (Some(Direction::FromGripper), _, answer) => answer.map(|words| (direction, words)).map_err(refused),
        (None, Err(_), Ok(answer)) => Ok((Some(Direction::FromGripper), answer)),
        (None, Ok(request), Err(_)) => Ok((Some(Direction::ToGripper), request)),
        (None, Ok(request), Ok(answer)) => Ok((None, format!("{request}, or {answer}"))),
        (None, Err(mistake), Err(_)) => Err(refused(mistake)),
    }
}

fn request_words(request: &Request) -> String {
    let name = request.name();
    let what = match request.kind() {
        CommandKind::Connection => "ends the connection",
        CommandKind::Motion => "requests a motion",
        CommandKind::Stop => "stops the fingers",
        CommandKind::Acknowledge => "acknowledges a FAST STOP",
        CommandKind::Setting => "sets a value",
        CommandKind::Query => "queries a value",
    };
    format!("{name} {what} (GCL, {})", name.section())
}

fn answer_words(answer: &Answer<'_>) -> String {
    let name = answer.name();
    match answer {
        Answer::Ack(ack) if ack.is_finished() => format!("{name} accepted: the motion begins"),
        Answer::Ack(_) => format!("{name} done"),
        Answer::Fin(_) => format!("{name} finished"),
        Answer::Err { status, .. } => format!("{name} refused or failed: {} ({})", status, status.code()),
        Answer::Value(value) => format!("{name} value{}", unit(value.name())),
        Answer::Update(value) => format!("{name} automatic update{}", unit(value.name())),
    }
}

/// Returns the unit of a value, as a suffix.
const fn unit(name: CommandName) -> &'static str {
    match name {
        CommandName::Pos | CommandName::Pwt | CommandName::Clt => ", in mm",
        CommandName::Speed => ", in mm/s",
        CommandName::Force => ", in N",
        CommandName::Temp => ", in °C",
        _ => "",
    }
}
