//! `wsg decode`: prints a recording as annotated frames.

mod candump;
mod capture;
mod entry;
mod hex_dump;
mod scan;
mod sim_log;
mod tcp;

use std::fs;
use std::io::{self, Read, Write};
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use wsg_protocol::Direction;
use wsg_protocol::can::Identifiers;

use self::entry::{Entry, EntryKind};

/// Number of leading lines examined to detect the format of a file.
const LINES_LOOKED_AT: usize = 50;
/// Maximum number of skipped lines listed by number.
const NAMED: usize = 5;

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
    /// For captures: TCP or UDP port of the gripper, if not 1000 or 1500
    #[arg(long, value_name = "PORT")]
    port: Option<u16>,
    /// For candump logs: identifier that the gripper receives on, such as 0x120; it sends on the next one
    #[arg(long, value_name = "ID", value_parser = can_id)]
    can_id: Option<Identifiers>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Detect by the contents
    #[default]
    Auto,
    /// Hex dump: xxd, hexdump -C, od -A x -t x1, or plain hex digits
    Hex,
    /// Log of wsg-sim or wsg gripper
    Sim,
    /// Log of candump, from candump -l or a terminal
    Candump,
    /// Ethernet or IP capture (pcap or pcapng)
    Capture,
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

/// Prints the recording. Returns a failure status if it holds no intact frame and no GCL line.
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
    let is_understood = |entry: &Entry| matches!(entry.kind, EntryKind::Frame | EntryKind::Line);
    Ok(if entries.iter().any(is_understood) { 0 } else { 1 })
}

/// Decodes the whole recording.
fn decode(bytes: Vec<u8>, arguments: &Arguments) -> Result<Vec<Entry>> {
    let gcl = arguments.protocol.gcl();
    let direction = arguments.direction.direction();
    let format = match arguments.format {
        Format::Auto => format_of(&bytes),
        format => format,
    };
    let text = String::from_utf8_lossy(&bytes);
    Ok(match format {
        Format::Capture => {
            drop(text);
            if !capture::is_capture(&bytes) {
                bail!("not a capture file; expected pcap or pcapng");
            }
            capture::decode(bytes, arguments.port, gcl)?
        }
        Format::Candump => {
            let (frames, strange) = lines(&text, candump::parse_line);
            let mut entries = candump::decode(&frames, arguments.can_id);
            entries.extend(skipped(&strange, "candump"));
            entries
        }
        Format::Sim => {
            let (lines, strange) = lines(&text, sim_log::parse_line);
            let mut entries = of_sim_log(&lines);
            entries.extend(skipped(&strange, "log"));
            entries
        }
        Format::Hex => {
            let dump = hex_dump::parse(&text);
            let mut entries = of_stream(&dump.bytes, dump.offset, gcl, direction);
            entries.extend(skipped(&dump.strange, "hex dump"));
            entries
        }
        Format::Raw | Format::Auto => of_stream(&bytes, 0, gcl, direction),
    })
}

/// Detects the format of a file by its contents.
fn format_of(bytes: &[u8]) -> Format {
    if capture::is_capture(bytes) {
        return Format::Capture;
    }
    let Ok(text) = std::str::from_utf8(bytes) else { return Format::Raw };
    let has = |is_line: fn(&str) -> bool| text.lines().take(LINES_LOOKED_AT).any(is_line);
    if has(|line| candump::parse_line(line).is_some()) {
        Format::Candump
    } else if has(|line| sim_log::parse_line(line).is_some()) {
        Format::Sim
    } else if has(hex_dump::is_line) {
        Format::Hex
    } else {
        Format::Raw
    }
}

/// Parses all lines that are not blank. Returns the results, and the numbers of the lines that failed.
fn lines<'a, T>(text: &'a str, parse: impl Fn(&'a str) -> Option<T>) -> (Vec<T>, Vec<usize>) {
    let mut parsed = Vec::new();
    let mut strange = Vec::new();
    for (at, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        match parse(line) {
            Some(line) => parsed.push(line),
            None => strange.push(at + 1),
        }
    }
    (parsed, strange)
}

/// Lists skipped lines by number, or returns `None` if there are none.
fn skipped(lines: &[usize], format: &str) -> Option<Entry> {
    let named: Vec<String> = lines.iter().take(NAMED).map(usize::to_string).collect();
    let more = lines.len().saturating_sub(NAMED);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    let noun = if lines.len() == 1 { "line" } else { "lines" };
    let words = || format!("skipped {noun} {}{more}: not in {format} format", named.join(", "));
    (!lines.is_empty()).then(|| Entry::note(String::new(), words()))
}

fn of_stream(bytes: &[u8], offset: u64, gcl: Option<bool>, direction: Option<Direction>) -> Vec<Entry> {
    let place = |range: std::ops::Range<usize>| format!("{:08X}", offset.saturating_add(range.start as u64));
    if gcl.unwrap_or_else(|| entry::is_gcl(bytes)) {
        entry::of_gcl(bytes, direction, place)
    } else {
        entry::of_binary(bytes, direction, place)
    }
}

fn of_sim_log(lines: &[sim_log::Line<'_>]) -> Vec<Entry> {
    let mut entries = Vec::new();
    let mut of_buses = 0;
    for sim_log::Line { place, direction, content } in lines {
        let place = || (*place).to_owned();
        let direction = Some(*direction);
        match content {
            sim_log::Content::Frame(bytes) => entries.extend(entry::of_binary(bytes, direction, |_| place())),
            sim_log::Content::Text(text) => {
                let (direction, words) = entry::gcl_meaning(text, direction);
                let bytes = text.clone();
                entries.push(Entry { place: place(), direction, kind: EntryKind::Line, words, bytes });
            }
            sim_log::Content::Remark(remark) => {
                let words = format!("log: {remark}");
                let (place, kind) = (place(), EntryKind::Dropped);
                entries.push(Entry { place, direction, kind, words, bytes: Vec::new() });
            }
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
    format!(
        "{}, {} with a wrong checksum, {} of GCL, {} dropped",
        entry::count(of(EntryKind::Frame).count(), "intact frame"),
        of(EntryKind::BadChecksum).count(),
        entry::count(of(EntryKind::Line).count(), "line"),
        entry::count(dropped, "byte"),
    )
}

#[cfg(test)]
mod tests;
