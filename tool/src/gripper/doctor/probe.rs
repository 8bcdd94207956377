//! Protocol and checksum detection without a driver, which would report only that the peer does not answer.

use std::io::{self, Write as _};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use embedded_io::{Read, ReadReady, Write};
use wsg_protocol::driver::blocking::Transport;
use wsg_protocol::gcl::{Answer, LineEvent, LineReader, Request};
use wsg_protocol::{Command, CommandId, Event, FrameEncoder, FrameParser, Reply, Status};

use crate::gripper::address::Address;
use crate::gripper::line::Connection;
use crate::gripper::trouble::Trouble;

/// Time-out for an answer in each protocol.
const ANSWER: Duration = Duration::from_secs(1);
/// Time-out for the answer to a query with a wrong checksum, which a gripper normally ignores.
const NO_ANSWER: Duration = Duration::from_millis(300);

/// The payload of the Loop with a wrong checksum. It identifies the answer.
const WRONG: &[u8] = b"wrong checksum";

/// The protocol that a peer uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Speech {
    Binary,
    Gcl,
}

impl Speech {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Binary => "the binary protocol",
            Self::Gcl => "the text protocol (GCL)",
        }
    }
}

/// How the peer reacts to queries.
pub(super) enum Peer {
    Answers(Speech),
    IsSilent,
    HasClosed,
}

/// Whether a gripper evaluates checksums (command set, 1.4.1).
pub(super) enum Checksums {
    Evaluated,
    Ignored,
}

/// The outcome of a bounded wait for an answer.
enum Received<T> {
    Answer(T),
    Nothing,
    End,
}

/// Detects the protocol. Queries in the protocol of the address first, then in the other one.
///
/// Both queries use the same connection, because the gripper may refuse a second one, and closing a connection without an
/// announcement causes a FAST STOP (command set, 1.4.2).
pub(super) fn speech(line: &mut Connection, address: &Address) -> Result<Peer, Trouble> {
    let order = match address {
        Address::Gcl { .. } | Address::GclUdp { .. } => &[Speech::Gcl, Speech::Binary][..],
        Address::Tcp(_) | Address::Udp { .. } => &[Speech::Binary, Speech::Gcl],
        // Only Ethernet carries GCL.
        Address::Serial { .. } | Address::Slcan { .. } | Address::SocketCan { .. } => &[Speech::Binary],
    };
    for speech in order {
        let is_sent = match speech {
            Speech::Binary => send(line, &info_query())?,
            Speech::Gcl => send(line, &text_query())?,
        };
        if !is_sent {
            return Ok(Peer::HasClosed);
        }
        let mut frames = FrameParser::<64>::new();
        let mut lines = LineReader::<128>::new();
        let answer = receive(line, ANSWER, |byte| {
            if let Some(Event::Frame(_)) = frames.push(byte) {
                return Some(Speech::Binary);
            }
            match lines.push(byte) {
                Some(LineEvent::Line(line)) if Answer::parse(line).is_ok() => Some(Speech::Gcl),
                _ => None,
            }
        })?;
        match answer {
            Received::Answer(speech) => return Ok(Peer::Answers(speech)),
            Received::Nothing => {}
            Received::End => return Ok(Peer::HasClosed),
        }
    }
    Ok(Peer::IsSilent)
}

/// Sends a Loop with a wrong checksum, which a gripper that evaluates checksums discards or rejects.
pub(super) fn checksums(line: &mut Connection) -> Result<Checksums, Trouble> {
    let mut query: Vec<u8> = FrameEncoder::new(CommandId::Loop.code(), WRONG).collect();
    if let Some(last) = query.last_mut() {
        *last ^= 0xFF;
    }
    send(line, &query)?;
    let mut frames = FrameParser::<64>::new();
    let answer = receive(line, NO_ANSWER, |byte| match frames.push(byte) {
        Some(Event::Frame(frame)) if frame.id == CommandId::Loop.code() => {
            Some(Reply::decode(&frame).is_ok_and(|reply| reply.status() == Status::Success))
        }
        _ => None,
    })?;
    Ok(if matches!(answer, Received::Answer(true)) { Checksums::Ignored } else { Checksums::Evaluated })
}

/// Announces the end of the connection in both protocols, for a peer whose protocol is unknown.
///
/// The peer may be a gripper that reads this later. The connection closes next, so errors are ignored.
pub(super) fn leave(line: &mut Connection) {
    let mut text = [0; Request::MAX_LEN + 1];
    let bye = Request::Bye.write_line_into(&mut text).unwrap_or_default();
    let messages = [encode(Command::DisconnectAnnouncement), vec![b'\n'], text[..bye].to_vec()];
    let _ = send(line, &messages.concat());
}

/// Queries a gripper over a connection of its own, and ends the connection without an announcement, as a client does that fails.
pub(super) fn lose_connection(host: &str, speech: Speech) -> io::Result<()> {
    let address = host.to_socket_addrs()?.next().ok_or(io::ErrorKind::AddrNotAvailable)?;
    let mut stream = TcpStream::connect_timeout(&address, ANSWER)?;
    stream.set_read_timeout(Some(ANSWER))?;
    stream.write_all(&match speech {
        Speech::Binary => info_query(),
        Speech::Gcl => text_query(),
    })?;
    // The gripper has accepted this client when it answers.
    io::Read::read_exact(&mut stream, &mut [0])
}

fn encode(command: Command<'_>) -> Vec<u8> {
    FrameEncoder::new(command.id().code(), command).collect()
}

fn info_query() -> Vec<u8> {
    encode(Command::GetSystemInfo)
}

/// Builds a GCL query. The leading empty line terminates any binary bytes that a GCL gripper has read as text.
fn text_query() -> Vec<u8> {
    let mut text = [0; Request::MAX_LEN + 1];
    let len = Request::Devtype.write_line_into(&mut text).unwrap_or_default();
    [b"\n", &text[..len]].concat()
}

/// Sends bytes. Returns whether the peer still accepts them.
fn send(line: &mut Connection, mut bytes: &[u8]) -> Result<bool, Trouble> {
    while !bytes.is_empty() {
        match line.write(bytes).map(|count| bytes.get(count.max(1)..)) {
            Ok(rest) => bytes = rest.unwrap_or(&[]),
            Err(error) => return end(error).map(|()| false),
        }
    }
    Ok(true)
}

/// Passes received bytes to `take` until it returns a value or the time `within` has elapsed.
fn receive<T>(
    line: &mut Connection,
    within: Duration,
    mut take: impl FnMut(u8) -> Option<T>,
) -> Result<Received<T>, Trouble> {
    let begin = Instant::now();
    let mut read = || -> Result<Received<T>, std::io::Error> {
        let mut chunk = [0; 256];
        loop {
            let is_ready = line.read_ready()?;
            if is_ready {
                let count = line.read(&mut chunk)?;
                if count == 0 {
                    return Ok(Received::End);
                }
                if let Some(answer) = chunk.iter().take(count).find_map(|byte| take(*byte)) {
                    return Ok(Received::Answer(answer));
                }
            }
            // Also reached when the peer never stops sending.
            let left = within.saturating_sub(begin.elapsed());
            if left.is_zero() {
                return Ok(Received::Nothing);
            }
            if !is_ready {
                line.wait(left.as_millis() as u32 + 1)?;
            }
        }
    };
    read().or_else(|error| end(error).map(|()| Received::End))
}

/// Treats a transport error as the end of the line, and passes on a signal, which ends the program.
fn end(error: std::io::Error) -> Result<(), Trouble> {
    match Trouble::from(wsg_protocol::driver::Error::Transport(error)) {
        Trouble::Driver(_) => Ok(()),
        trouble => Err(trouble),
    }
}
