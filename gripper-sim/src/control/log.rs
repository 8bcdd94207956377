//! The log: one line per frame with time, direction, line, hex and meaning.

use crate::config::Config;
use crate::deframer::Deframer;
use crate::port::{PortId, PortKind, Protocol};
use crate::text::one_line;
use crate::time::Time;
use bus_modbus::Function;
use bus_modbus::tcp::{self, HEADER_LEN, MAX_FRAME_LEN, Receiver};
use std::fmt::Write as _;
use std::sync::Arc;
use wsg_protocol::frame::PREAMBLE_LEN;
use wsg_protocol::{CommandId, Direction, Event, Frame, FrameEncoder, Meaning};

/// Offset of the payload in a frame.
const PAYLOAD_AT: usize = PREAMBLE_LEN + 3;
/// The longest piece of a text protocol line logged in one line, in bytes.
const LINE_LEN: usize = 512;
/// Length of the checksum in bytes.
const CHECKSUM_LEN: usize = 2;

/// Takes one line with its line end.
pub(crate) type Sink = Box<dyn FnMut(String) + Send>;

/// Writes one line per frame:
///
/// ```text
/// 12.345678 s tcp 127.0.0.1:40000 -> AA AA AA 22 00 00 D3 5A  22h Stop
/// ```
///
/// `->` is sent to the gripper, `<-` is sent by it. GCL is logged as text, Modbus/TCP with its header, and PROFIBUS as
/// the received bytes.
pub struct Log {
    output: Output,
    clients: Vec<LoggedClient>,
}

/// A client whose requests are logged. The log decodes its frames a second time.
struct LoggedClient {
    id: PortId,
    name: Arc<str>,
    kind: PortKind,
    requests: Requests,
}

enum Requests {
    Frames(Box<Frames>),
    /// Of the text protocol: the incomplete line.
    Lines(Vec<u8>),
    /// Of Modbus/TCP: the frame decoder.
    Registers(Box<Receiver>),
    /// Bytes of PROFIBUS, logged as received.
    Telegrams,
}

/// Decodes frames together with their received checksums.
struct Frames {
    deframer: Deframer,
    /// The last two bytes taken: the checksum of a frame that ends there.
    last: [u8; CHECKSUM_LEN],
    /// Whether a frame may have a wrong checksum.
    is_unchecked: bool,
}

impl Frames {
    fn new(kind: PortKind, config: &Config) -> Self {
        Self {
            deframer: Deframer::new(kind, config),
            last: [0; CHECKSUM_LEN],
            is_unchecked: !config.check_checksum,
        }
    }
}

/// The received checksum of a frame.
#[derive(Clone, Copy, Debug)]
enum Checksum {
    /// The checksum was correct.
    Right,
    /// The checksum was wrong and had these bytes.
    Sent([u8; CHECKSUM_LEN]),
    /// Unknown: the frame was inside another one that proved invalid.
    Unknown,
}

/// Formats lines for the log and for pages.
struct Output {
    /// `None` if no log is written.
    writer: Option<Sink>,
    /// Lines for the pages that show the log, if any.
    watched: Option<Watched>,
}

/// Lines queued for pages.
#[derive(Debug, Default)]
pub(crate) struct Watched {
    pub(crate) lines: Vec<String>,
    /// Number of lines dropped because the queue was full.
    pub(crate) lost: u64,
}

/// Capacity of the queue for pages, in lines: more than anyone can read.
const MAX_WATCHED: usize = 200;

impl Log {
    /// Creates a log that writes its lines there, or that only pages show.
    pub(crate) fn new(writer: Option<Sink>) -> Self {
        Self { output: Output { writer, watched: None }, clients: Vec::new() }
    }

    /// Starts or stops keeping lines for pages.
    pub(crate) fn watch(&mut self, on: bool) {
        self.output.watched = on.then(Watched::default);
    }

    /// Takes the lines that pages have not received yet.
    pub(crate) fn take_watched(&mut self) -> Watched {
        self.output.watched.as_mut().map(std::mem::take).unwrap_or_default()
    }

    pub(crate) fn connect(&mut self, id: PortId, kind: PortKind, name: Arc<str>, config: &Config) {
        let requests = match kind.protocol() {
            Protocol::Binary => Requests::Frames(Box::new(Frames::new(kind, config))),
            Protocol::Text => Requests::Lines(Vec::new()),
            Protocol::Modbus => Requests::Registers(Box::default()),
            Protocol::Profibus | Protocol::Images => Requests::Telegrams,
        };
        self.clients.push(LoggedClient { id, name, kind, requests });
    }

    /// Decodes requests as a gripper with these settings does.
    pub(crate) fn reconfigure(&mut self, config: &Config) {
        for client in &mut self.clients {
            if let Requests::Frames(frames) = &mut client.requests
                && frames.is_unchecked == config.check_checksum
            {
                **frames = Frames::new(client.kind, config);
            }
        }
    }

    pub(crate) fn disconnect(&mut self, id: PortId) {
        self.clients.retain(|client| client.id != id);
    }

    pub(crate) fn received(&mut self, id: PortId, now: Time, bytes: &[u8]) {
        self.expire(now);
        let Self { output, clients } = self;
        let Some(client) = clients.iter_mut().find(|client| client.id == id) else { return };
        match &mut client.requests {
            Requests::Frames(frames) => {
                let Frames { deframer, last, is_unchecked } = &mut **frames;
                let mut rest = bytes;
                loop {
                    let (taken, event) = deframer.push_slice(now, rest);
                    for byte in rest.iter().take(taken) {
                        *last = [last[1], *byte];
                    }
                    rest = rest.get(taken..).unwrap_or(&[]);
                    let checksum = match taken {
                        _ if !*is_unchecked => Checksum::Right,
                        0 => Checksum::Unknown,
                        _ => Checksum::Sent(*last),
                    };
                    match event {
                        Some(event) => output.event(now, &client.name, event, checksum),
                        None if rest.is_empty() => break,
                        None => {}
                    }
                }
                deframer.pause(now);
                self.expire(now);
            }
            Requests::Lines(line) => {
                for byte in bytes.iter().chain(client.kind.is_datagram().then_some(&b'\n')) {
                    if !matches!(byte, b'\n' | b'\r') && line.len() < LINE_LEN {
                        line.push(*byte);
                    } else if !line.is_empty() {
                        output.line(now, Direction::ToGripper, &client.name, line);
                        line.clear();
                    }
                }
            }
            Requests::Registers(receiver) => {
                let mut rest = bytes;
                while !rest.is_empty() {
                    let (taken, event) = receiver.push_slice(rest);
                    rest = rest.get(taken..).unwrap_or(&[]);
                    if let Some(event) = event {
                        output.modbus_event(now, &client.name, event);
                    }
                }
            }
            Requests::Telegrams => output.bytes(now, Direction::ToGripper, &client.name, bytes),
        }
    }

    /// Expires incomplete frames as the gripper does.
    pub(crate) fn expire(&mut self, now: Time) {
        let Self { output, clients } = self;
        for client in clients {
            let Requests::Frames(frames) = &mut client.requests else { continue };
            let checksum = if frames.is_unchecked { Checksum::Unknown } else { Checksum::Right };
            while let Some(event) = frames.deframer.expire(now) {
                output.event(now, &client.name, event, checksum);
            }
        }
    }

    /// Logs one frame with its meaning, or one line of the text protocol as text.
    pub(crate) fn sent(&mut self, now: Time, id: PortId, line: &str, bytes: &[u8]) {
        if !self.output.is_wanted() {
            return;
        }
        let requests = self.clients.iter().find(|client| client.id == id).map(|client| &client.requests);
        let (output, direction) = (&mut self.output, Direction::FromGripper);
        match requests {
            Some(Requests::Lines(_)) => output.line(now, direction, line, bytes),
            Some(Requests::Registers(_)) => output.modbus(now, direction, line, bytes),
            Some(Requests::Telegrams) => output.bytes(now, direction, line, bytes),
            Some(Requests::Frames(_)) | None => output.frame(now, direction, line, &hex(bytes), bytes),
        }
    }

    /// Logs a note that is not a frame.
    pub(crate) fn note(&mut self, now: Time, line: &str, what: std::fmt::Arguments<'_>) {
        self.output.write(format_args!("{now} {line} {what}"));
    }
}

impl Output {
    fn event(&mut self, now: Time, line: &str, event: Event<'_>, checksum: Checksum) {
        if !self.is_wanted() {
            return;
        }
        match event {
            Event::Frame(frame) => {
                let whole: Vec<u8> = FrameEncoder::new(frame.id, frame.payload).collect();
                let before = whole.get(..whole.len().saturating_sub(CHECKSUM_LEN)).unwrap_or(&[]);
                let shown = match checksum {
                    Checksum::Right => hex(&whole),
                    Checksum::Sent(bytes) => hex(before) + &hex(&bytes),
                    Checksum::Unknown => hex(before) + "?? ?? ",
                };
                self.frame(now, Direction::ToGripper, line, &shown, &whole);
            }
            Event::BadChecksum { id, size } => self.refused(now, line, "wrong checksum", id, size),
            Event::Oversize { id, size } => self.refused(now, line, "too long", id, size),
        }
    }

    fn frame(&mut self, now: Time, direction: Direction, line: &str, hex: &str, bytes: &[u8]) {
        let id = bytes.get(PREAMBLE_LEN).copied().unwrap_or(0);
        let payload = bytes.get(PAYLOAD_AT..bytes.len().saturating_sub(CHECKSUM_LEN)).unwrap_or(&[]);
        let frame = Frame { id, payload };
        let meaning = Meaning { direction, frame };
        self.write(format_args!("{now} {line} {direction} {hex} {meaning}"));
    }

    fn line(&mut self, now: Time, direction: Direction, line: &str, bytes: &[u8]) {
        let text = bytes.trim_ascii_end().escape_ascii();
        self.write(format_args!("{now} {line} {direction} {text}"));
    }

    fn bytes(&mut self, now: Time, direction: Direction, line: &str, bytes: &[u8]) {
        self.write(format_args!("{now} {line} {direction} {}\n", hex(bytes).trim_end()));
    }

    fn modbus_event(&mut self, now: Time, line: &str, event: tcp::Event<'_>) {
        match event {
            tcp::Event::Request(request) => {
                let mut frame = [0; MAX_FRAME_LEN];
                // Restores the received frame: its own PDU in its own header.
                let whole = request.answer(&mut frame, |pdu, place| {
                    for (slot, byte) in place.iter_mut().zip(pdu) {
                        *slot = *byte;
                    }
                    pdu.len()
                });
                self.modbus(now, Direction::ToGripper, line, whole);
            }
            tcp::Event::Foreign { len } => {
                self.write(format_args!("{now} {line} -> {len} bytes of another protocol"));
            }
            tcp::Event::Lost => self.write(format_args!("{now} {line} -> a length that no frame has")),
        }
    }

    fn modbus(&mut self, now: Time, direction: Direction, line: &str, bytes: &[u8]) {
        let hex = hex(bytes);
        let (code, data) = match bytes.get(HEADER_LEN..) {
            Some([code, data @ ..]) => (*code, data),
            _ => (0, &[][..]),
        };
        let exception =
            (direction == Direction::FromGripper && code & 0x80 != 0).then(|| data.first()).flatten();
        let code = if exception.is_some() { code & 0x7F } else { code };
        let name = Function::from_code(code).map(|function| format!(" {function:?}")).unwrap_or_default();
        let refused = exception.map(|number| format!(", exception {number}")).unwrap_or_default();
        self.write(format_args!("{now} {line} {direction} {hex} FC {code}{name}{refused}"));
    }

    fn refused(&mut self, now: Time, line: &str, why: &str, id: u8, size: u16) {
        let id = CommandId::from_code(id);
        self.write(format_args!("{now} {line} -> {why}: {id} with {size} bytes of payload"));
    }

    /// Writes one line. Names of lines and the output of scripts can contain anything.
    fn write(&mut self, text: std::fmt::Arguments<'_>) {
        if !self.is_wanted() {
            return;
        }
        let text = text.to_string();
        let text = one_line(text.trim_end());
        if let Some(Watched { lines, lost }) = &mut self.watched {
            if lines.len() < MAX_WATCHED {
                lines.push(text.clone().into_owned());
            } else {
                *lost += 1;
            }
        }
        if let Some(writer) = &mut self.writer {
            writer(text.into_owned() + "\n");
        }
    }

    /// Returns whether the line has a destination. Otherwise it need not be formatted.
    const fn is_wanted(&self) -> bool {
        self.writer.is_some() || self.watched.is_some()
    }
}

fn hex(bytes: &[u8]) -> String {
    let mut hex = String::with_capacity(3 * bytes.len());
    for byte in bytes {
        // Writing to a string cannot fail.
        let _ = write!(hex, "{byte:02X} ");
    }
    hex
}

impl std::fmt::Debug for Log {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Log").finish_non_exhaustive()
    }
}
