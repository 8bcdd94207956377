//! `wsg decode`: prints a recording as annotated frames.

mod candump;
mod entry;
mod hex_dump;
mod scan;
mod sim_log;

use std::fs;
use std::io::{self, Read, Write};
use std::ops::RangeInclusive;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use wsg_protocol::Direction;
use wsg_protocol::can::Identifiers;
use wsg_protocol::frame::{PREAMBLE_BYTE, PREAMBLE_LEN};
use wsg_sim::text;

use self::entry::{Entry, EntryKind};

/// Number of leading lines examined to detect the format of a file.
const LINES_LOOKED_AT: usize = 50;

/// The first bytes of captures: pcapng, and pcap in either byte order with microsecond or nanosecond time stamps.
const CAPTURES: [[u8; 4]; 5] = [
    [0x0A, 0x0D, 0x0D, 0x0A],
    [0xD4, 0xC3, 0xB2, 0xA1],
    [0xA1, 0xB2, 0xC3, 0xD4],
    [0x4D, 0x3C, 0xB2, 0xA1],
    [0xA1, 0xB2, 0x3C, 0x4D],
];

/// The accepted recordings, for error messages.
const EXPECTED: &str = "expected a hex dump, a candump log, a log of wsg-sim or wsg gripper, lines of GCL, or the bytes of the line; \
                        --format selects one";

/// Decodes a recording of a gripper's line: shows position, bytes, meaning and checksum of every frame, and why other bytes were
/// dropped
#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// Recording to decode; standard input if omitted or `-`
    file: Option<PathBuf>,
    /// Format of the recording
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    /// Protocol in the recording
    #[arg(long, value_enum, default_value_t)]
    protocol: Protocol,
    /// Direction of the bytes, if the recording holds only one
    #[arg(long, value_enum, default_value_t)]
    direction: Way,
    /// For candump logs: identifier that the gripper receives on, such as 0x120; it sends on the next one
    #[arg(long, value_name = "ID", value_parser = can_id)]
    can_id: Option<Identifiers>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Detect by the contents
    #[default]
    Auto,
    /// Hex dump: xxd, hexdump -C, od -t x1, Wireshark's Copy as Hex Dump, or plain hex digits
    Hex,
    /// Log of wsg-sim or wsg gripper
    Sim,
    /// Log of candump, from candump -l or a terminal
    Candump,
    /// Raw bytes of the line, or GCL text
    Raw,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Protocol {
    /// Detect by the contents
    #[default]
    Auto,
    /// Binary protocol
    Binary,
    /// Text protocol (GCL)
    Gcl,
}

impl Protocol {
    /// Returns whether GCL was selected, or `None` for automatic detection.
    const fn gcl(self) -> Option<bool> {
        match self {
            Self::Auto => None,
            Self::Binary => Some(false),
            Self::Gcl => Some(true),
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Way {
    /// Detect for each frame
    #[default]
    Auto,
    /// All bytes were sent to the gripper
    To,
    /// All bytes were sent by the gripper
    From,
}

impl Way {
    const fn direction(self) -> Option<Direction> {
        match self {
            Self::Auto => None,
            Self::To => Some(Direction::ToGripper),
            Self::From => Some(Direction::FromGripper),
        }
    }
}

fn can_id(text: &str) -> Result<Identifiers, String> {
    let digits = text.strip_prefix("0x").or_else(|| text.strip_suffix('h'));
    let number = digits.map_or_else(|| text.parse(), |digits| u16::from_str_radix(digits, 16));
    let pair = number.ok().and_then(Identifiers::from_base);
    pair.ok_or_else(|| {
        format!("`{text}` is not a CAN identifier; expected 11 bits below 0x7FF, such as 0x120 or 288")
    })
}

/// Prints the recording. Returns a failure status if it holds no intact frame and no GCL line, or if a part of it could not be
/// read.
pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let bytes = match arguments.file.as_deref().filter(|file| file.as_os_str() != "-") {
        Some(file) => fs::read(file).with_context(|| format!("cannot read {}", file.display()))?,
        None => {
            let mut bytes = Vec::new();
            io::stdin().lock().read_to_end(&mut bytes).context("cannot read standard input")?;
            bytes
        }
    };
    if bytes.is_empty() {
        bail!("the recording is empty");
    }
    let entries = decode(bytes, arguments)?;
    let mut output = io::BufWriter::new(io::stdout().lock());
    let written = entries
        .iter()
        .try_for_each(|entry| writeln!(output, "{entry}"))
        .and_then(|()| writeln!(output, "{}", summary(&entries)))
        .and_then(|()| output.flush());
    match written {
        // The reader closed the pipe, for example `head`.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
        written => written.context("cannot write standard output")?,
    }
    Ok(status(&entries))
}

/// Returns the exit status: 0 if something was understood and nothing was left unread.
fn status(entries: &[Entry]) -> u8 {
    let is_understood = entries.iter().any(|it| matches!(it.kind, EntryKind::Frame | EntryKind::Line));
    let is_unread = entries.iter().any(|it| it.kind == EntryKind::Unread);
    u8::from(!is_understood || is_unread)
}

/// Decodes the whole recording.
fn decode(bytes: Vec<u8>, arguments: &Arguments) -> Result<Vec<Entry>> {
    let gcl = arguments.protocol.gcl();
    let direction = arguments.direction.direction();
    let is_raw = match arguments.format {
        Format::Auto if CAPTURES.iter().any(|start| bytes.starts_with(start)) => bail!(
            "this is a capture (pcap); open it in Wireshark with the dissector tool/wireshark/wsg.lua (docs/tool.md)"
        ),
        // Text never contains a preamble.
        Format::Auto => bytes.windows(PREAMBLE_LEN).any(|bytes| bytes == [PREAMBLE_BYTE; PREAMBLE_LEN]),
        format => format == Format::Raw,
    };
    if is_raw {
        return Ok(of_stream(&bytes, 0, gcl, direction));
    }
    let bytes = text::unmarked(bytes).context("cannot read the recording")?;
    // A line with other bytes than UTF-8 is in no format.
    let text = String::from_utf8_lossy(&bytes);
    let format = match arguments.format {
        Format::Auto => format_of(&text, gcl).with_context(|| format!("unknown format; {EXPECTED}"))?,
        format => format,
    };
    Ok(match format {
        Format::Candump => candump::decode(&lines(&text, candump::parse_line), arguments.can_id),
        Format::Sim => of_sim_log(&lines(&text, sim_log::parse_line)),
        Format::Hex => of_hex_dump(&hex_dump::parse(&text), gcl, direction),
        Format::Raw | Format::Auto => of_stream(&bytes, 0, gcl, direction),
    })
}

/// Detects the format of a text: at least half of its first lines are in that format.
fn format_of(text: &str, gcl: Option<bool>) -> Option<Format> {
    let first: Vec<&str> =
        text.lines().filter(|line| !hex_dump::is_remark(line)).take(LINES_LOOKED_AT).collect();
    let has = |is_line: fn(&str) -> bool| {
        let count = first.iter().filter(|line| is_line(line)).count();
        count > 0 && count >= first.len() - count
    };
    if has(|line| candump::parse_line(line).is_some()) {
        Some(Format::Candump)
    } else if has(|line| sim_log::parse_line(line).is_some()) {
        Some(Format::Sim)
    } else if has(hex_dump::is_line) {
        Some(Format::Hex)
    } else {
        gcl.unwrap_or_else(|| entry::is_gcl(text.as_bytes())).then_some(Format::Raw)
    }
}

/// Parses all lines that are not blank. Returns the results, or the numbers of consecutive lines that failed.
fn lines<'a, T>(
    text: &'a str,
    parse: impl Fn(&'a str) -> Option<T>,
) -> Vec<Result<T, RangeInclusive<usize>>> {
    let mut lines: Vec<Result<T, RangeInclusive<usize>>> = Vec::new();
    for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()) {
        let parsed = parse(line);
        match lines.last_mut() {
            Some(Err(unread)) if parsed.is_none() => *unread = *unread.start()..=number,
            _ => lines.push(parsed.ok_or(number..=number)),
        }
    }
    lines
}

fn of_stream(bytes: &[u8], offset: u64, gcl: Option<bool>, direction: Option<Direction>) -> Vec<Entry> {
    let place = |range: std::ops::Range<usize>| format!("{:08X}", offset.saturating_add(range.start as u64));
    if gcl.unwrap_or_else(|| entry::is_gcl(bytes)) {
        entry::of_gcl(bytes, direction, place)
    } else {
        entry::of_binary(bytes, direction, place)
    }
}

fn of_hex_dump(parts: &[hex_dump::Part], gcl: Option<bool>, direction: Option<Direction>) -> Vec<Entry> {
    let entries = parts.iter().map(|part| match part {
        hex_dump::Part::Bytes(offset, bytes) => of_stream(bytes, *offset, gcl, direction),
        hex_dump::Part::Unread(lines) => vec![Entry::unread(lines, "hex dump")],
    });
    entries.flatten().collect()
}

fn of_sim_log(lines: &[Result<sim_log::LogLine<'_>, RangeInclusive<usize>>]) -> Vec<Entry> {
    let mut entries = Vec::new();
    let mut of_buses = 0;
    for line in lines {
        let sim_log::LogLine { place, direction, content } = match line {
            Ok(line) => line,
            Err(unread) => {
                entries.push(Entry::unread(unread, "log"));
                continue;
            }
        };
        let (place, direction) = ((*place).to_owned(), *direction);
        match content {
            sim_log::Content::Frame(bytes) => {
                entries.extend(entry::of_binary(bytes, direction, |_| place.clone()));
            }
            sim_log::Content::Text(text) => {
                // The log shows what the gripper received, even if neither understands it.
                let (direction, words) =
                    entry::gcl_meaning(text, direction).unwrap_or_else(|words| (direction, words));
                entries.push(Entry { place, direction, kind: EntryKind::Line, words, bytes: text.clone() });
            }
            sim_log::Content::Remark(remark) => {
                let words = format!("log: {remark}");
                entries.push(Entry { place, direction, kind: EntryKind::Dropped, words, bytes: Vec::new() });
            }
            sim_log::Content::Event(event) => entries.push(Entry::note(place, (*event).to_owned())),
            sim_log::Content::OfABus => of_buses += 1,
        }
    }
    if of_buses > 0 {
        entries.push(Entry::note(
            String::new(),
            format!("skipped {} of Modbus/TCP or PROFIBUS", entry::count(of_buses, "line")),
        ));
    }
    entries
}

/// Formats the last line, which counts frames, GCL lines and dropped bytes.
fn summary(entries: &[Entry]) -> String {
    let of = |kind| entries.iter().filter(move |entry| entry.kind == kind);
    let dropped: usize = of(EntryKind::Dropped).map(|entry| entry.bytes.len()).sum();
    let unread = of(EntryKind::Unread).count();
    format!(
        "{}, {} with a wrong checksum, {} of GCL, {} dropped{}",
        entry::count(of(EntryKind::Frame).count(), "intact frame"),
        of(EntryKind::BadChecksum).count(),
        entry::count(of(EntryKind::Line).count(), "line"),
        entry::count(dropped, "byte"),
        if unread > 0 { format!(", {} not read", entry::count(unread, "part")) } else { String::new() },
    )
}

#[cfg(test)]
mod tests;
