//! What is told of a recording: an entry for each frame, each line of GCL and each run of bytes that is neither.

use std::fmt::{self, Display, Formatter};

use wsg_protocol::gcl::{Answer, CommandName, ParseError, Request};
use wsg_protocol::{Command, Direction, Frame, Kind as CommandKind, Meaning, Reply, Status};

use super::scan::{self, Kind, MAX_PAYLOAD_LEN};

/// Bytes in a line.
const BYTES_A_LINE: usize = 16;
/// Where the lines below the first of an entry begin.
const INDENT: &str = "              ";

/// Part of a recording, in words and in bytes.
#[derive(Debug)]
pub(crate) struct Entry {
    /// Where it is.
    pub(crate) place: String,
    /// Its direction, as far as it is known.
    pub(crate) direction: Option<Direction>,
    pub(crate) kind: EntryKind,
    /// What it says, or why it was dropped.
    pub(crate) words: String,
    /// Its bytes.
    pub(crate) bytes: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EntryKind {
    /// An intact frame.
    Frame,
    /// A frame that has no right checksum.
    BadChecksum,
    /// A line of GCL.
    Line,
    /// Bytes that belong to no frame or line.
    Dropped,
    /// No bytes of the recording.
    Note,
}

impl Entry {
    pub(crate) fn note(place: String, words: String) -> Self {
        Self { place, direction: None, kind: EntryKind::Note, words, bytes: Vec::new() }
    }
}

impl Display for Entry {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { place, kind, words, bytes, .. } = self;
        let separator = if place.is_empty() { "" } else { "  " };
        let mark = match (kind, self.direction) {
            (EntryKind::Dropped | EntryKind::BadChecksum, _) => "!!".to_owned(),
            (EntryKind::Note, _) => "..".to_owned(),
            (_, Some(direction)) => direction.to_string(),
            (_, None) => "--".to_owned(),
        };
        write!(f, "{place}{separator}{mark}  {words}")?;
        if *kind == EntryKind::Line {
            return write!(f, "\n{INDENT}{}", bytes.escape_ascii());
        }
        for line in bytes.chunks(BYTES_A_LINE) {
            write!(f, "\n{INDENT}")?;
            for (at, byte) in line.iter().enumerate() {
                write!(f, "{}{byte:02X}", if at == 0 { "" } else { " " })?;
            }
        }
        if *kind == EntryKind::Frame { f.write_str("  checksum right") } else { Ok(()) }
    }
}

/// Whether a recording is in GCL or in the binary protocol, by its bytes: frames have preambles, and GCL is text.
pub(crate) fn is_gcl(bytes: &[u8]) -> bool {
    let is_text = |byte: &u8| matches!(byte, b' '..=b'~' | b'\t' | b'\r' | b'\n');
    bytes.iter().any(u8::is_ascii_alphabetic) && bytes.iter().all(is_text)
}

/// The entries of a recording in the binary protocol, each with where it begins and ends. `place` gives words to that.
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
                "wrong checksum {:02X} {:02X}, right were {low:02X} {high:02X}; with that: {words}",
                came[0], came[1]
            );
            (EntryKind::BadChecksum, direction, words)
        }
        Kind::TooLong(size) => (
            EntryKind::Dropped,
            direction,
            format!(
                "dropped {dropped}: a preamble, but {size} bytes of payload announced; a message has at most {MAX_PAYLOAD_LEN}"
            ),
        ),
        Kind::Incomplete(missing) => (
            EntryKind::Dropped,
            direction,
            format!(
                "dropped {dropped}: the beginning of a frame without its end, {} or more",
                count(missing, "byte")
            ),
        ),
        Kind::Noise => (EntryKind::Dropped, direction, format!("dropped {dropped}: no preamble")),
    };
    Entry { place, direction, kind, words, bytes: bytes.to_vec() }
}

/// `1 byte`, `2 bytes`.
pub(crate) fn count(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// The words of a whole frame with preamble and checksum, and its direction where that follows from it.
fn meaning(bytes: &[u8], direction: Option<Direction>) -> (Option<Direction>, String) {
    let [_, _, _, id, _, _, payload @ .., _, _] = bytes else { return (direction, String::new()) };
    let frame = Frame { id: *id, payload };
    let said = |direction| Meaning { direction, frame }.to_string();
    if let Some(direction) = direction {
        return (Some(direction), said(direction));
    }
    let is_request = Command::decode(&frame).is_ok();
    let reply = Reply::decode(&frame);
    let is_reply = reply.is_ok();
    let has_known_status = reply.is_ok_and(|reply| !matches!(reply.status(), Status::Unknown(_)));
    match (is_request, is_reply) {
        (true, _) if !has_known_status => (Some(Direction::ToGripper), said(Direction::ToGripper)),
        (false, true) => (Some(Direction::FromGripper), said(Direction::FromGripper)),
        _ => {
            let (request, reply) = (said(Direction::ToGripper), said(Direction::FromGripper));
            (None, if request == reply { request } else { format!("{request}, or {reply}") })
        }
    }
}

/// The entries of a recording in GCL: one for each line that is not blank.
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
            let (direction, words) = gcl_meaning(text, direction);
            let place = place(range);
            entries.push(Entry { place, direction, kind: EntryKind::Line, words, bytes: text.to_vec() });
        }
    }
    entries
}

/// What a line of GCL says, and its direction where that follows from it.
pub(crate) fn gcl_meaning(line: &[u8], direction: Option<Direction>) -> (Option<Direction>, String) {
    let request =
        Request::parse(line).map(|request| request_words(&request)).map_err(|refused| refused.mistake);
    let answer = Answer::parse(line).map(|answer| answer_words(&answer));
    let refused = |mistake: ParseError| format!("not understood: {mistake}");
    match (direction, request, answer) {
        (Some(Direction::ToGripper), request, _) => (direction, request.unwrap_or_else(refused)),
        (Some(Direction::FromGripper), _, answer) => (direction, answer.unwrap_or_else(refused)),
        (None, Err(_), Ok(answer)) => (Some(Direction::FromGripper), answer),
        (None, Ok(request), Err(_)) => (Some(Direction::ToGripper), request),
        (None, Ok(request), Ok(answer)) => (None, format!("{request}, or {answer}")),
        (None, Err(mistake), Err(_)) => (None, refused(mistake)),
    }
}

fn request_words(request: &Request) -> String {
    let name = request.name();
    let what = match request.kind() {
        CommandKind::Connection => "ends the connection",
        CommandKind::Motion => "asks for a motion",
        CommandKind::Stop => "stops",
        CommandKind::Acknowledge => "acknowledges a FAST STOP",
        CommandKind::Setting => "sets",
        CommandKind::Query => "asks for a value",
    };
    format!("{name} {what} (GCL, {})", name.section())
}

fn answer_words(answer: &Answer<'_>) -> String {
    let name = answer.name();
    match answer {
        Answer::Ack(ack) if ack.is_finished() => format!("{name} understood: the motion begins"),
        Answer::Ack(_) => format!("{name} done"),
        Answer::Fin(_) => format!("{name} finished"),
        Answer::Err { status, .. } => format!("{name} refused or failed: {} ({})", status, status.code()),
        Answer::Value(value) => format!("{name} is told{}", unit(value.name())),
        Answer::Update(value) => format!("{name} is told by itself{}", unit(value.name())),
    }
}

/// The unit of a value, as words behind it.
const fn unit(name: CommandName) -> &'static str {
    match name {
        CommandName::Pos | CommandName::Pwt | CommandName::Clt => ", in mm",
        CommandName::Speed => ", in mm/s",
        CommandName::Force => ", in N",
        CommandName::Temp => ", in °C",
        _ => "",
    }
}
