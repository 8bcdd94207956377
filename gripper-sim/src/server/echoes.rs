//! Detection of answer loops: a peer that answers answers, such as another virtual gripper, would otherwise keep this
//! one answering forever.
//!
//! The sender of a datagram can be forged, and an invalid datagram is answered with an error, which is itself invalid.
//! The format does not distinguish answers from requests: `VERBOSE=1` is both.

use crate::script::SCRIPT_IDS;
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use wsg_protocol::gcl::{Answer, Request};
use wsg_protocol::{Command, CommandId, Frame, Reply};

/// How many of the latest answers are compared. A loop contains at most this many messages that are valid both as a
/// request and as an answer.
const REMEMBERED: usize = 64;

/// How many consecutive datagrams may be echoes: clients may repeat a setting whose answer is identical to the request.
const TOLERATED: u32 = 16;

/// Time without an echo after which the count restarts. Echoes in a loop follow immediately.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(1);

/// Distinguishes echoes from requests.
#[derive(Debug, Default)]
pub(super) struct Echoes {
    sent: VecDeque<Vec<u8>>,
    in_a_row: u32,
    /// Time and sender of the last echo.
    last: Option<(Instant, SocketAddr)>,
}

impl Echoes {
    /// Records a sent datagram.
    pub(super) fn sent(&mut self, datagram: &[u8]) {
        if self.sent.len() == REMEMBERED {
            self.sent.pop_front();
        }
        self.sent.push_back(datagram.to_owned());
    }

    /// Returns whether the datagram received at `now` is a repeated echo and must not be answered. Requests of other
    /// peers in between do not keep a loop alive.
    pub(super) fn must_end(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) -> bool {
        if !is_answer(datagram) && !self.sent.iter().any(|sent| is_echo(sent, datagram)) {
            if self.last.is_some_and(|(_, peer)| peer == from) {
                self.in_a_row = 0;
            }
            return false;
        }
        if self.last.is_none_or(|(last, _)| now.duration_since(last) >= FORGOTTEN_AFTER) {
            self.in_a_row = 0;
        }
        self.last = Some((now, from));
        self.in_a_row = self.in_a_row.saturating_add(1);
        self.in_a_row > TOLERATED
    }
}

/// Returns whether a datagram is an echo: identical to the sent one or, for Loop (06h), the sent payload after the
/// status of the peer's answer.
fn is_echo(sent: &[u8], datagram: &[u8]) -> bool {
    let of_loop = |bytes| match whole_frame(bytes) {
        Some(Frame { id, payload }) if id == CommandId::Loop.code() => Some(payload),
        _ => None,
    };
    sent == datagram || of_loop(sent).zip(of_loop(datagram)).is_some_and(|(sent, echo)| echo.ends_with(sent))
}

/// Returns whether a datagram has the form of a gripper's answer and not of a request: a frame or lines of text.
fn is_answer(datagram: &[u8]) -> bool {
    if let Some(frame) = whole_frame(datagram) {
        let is_request = match Command::decode(&frame) {
            Ok(Command::Unknown { id, .. }) => SCRIPT_IDS.contains(&id),
            request => request.is_ok(),
        };
        return !is_request && Reply::decode(&frame).is_ok();
    }
    let mut lines =
        datagram.split(|byte| matches!(byte, b'\n' | b'\r')).filter(|line| !line.is_empty()).peekable();
    lines.peek().is_some() && lines.all(|line| Request::parse(line).is_err() && Answer::parse(line).is_ok())
}

/// Returns the frame in a datagram, regardless of its checksum.
fn whole_frame(datagram: &[u8]) -> Option<Frame<'_>> {
    let [0xAA, 0xAA, 0xAA, id, l0, l1, payload @ .., _, _] = datagram else { return None };
    (payload.len() == usize::from(u16::from_le_bytes([*l0, *l1]))).then_some(Frame { id: *id, payload })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The answer of a gripper to any line it does not understand, including this answer.
    const ANSWER: &[u8] = b"ERR ? 15\n";

    fn peer(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    #[test]
    fn several_answers_in_a_loop_end_as_well() {
        let now = Instant::now();
        let mut echoes = Echoes::default();
        let answered = (0..1_000u32)
            .map(|n| [b"one\n", b"two\n", b"six\n"][(n % 3) as usize])
            .filter(|datagram| {
                let is_answered = !echoes.must_end(now, peer(1), *datagram);
                if is_answered {
                    echoes.sent(*datagram);
                }
                is_answered
            })
            .count();
        assert!(answered <= 3 + TOLERATED as usize, "{answered}");
    }

    /// Returns the number of answers exchanged by two peers until none is in transit.
    fn exchanged(begin: impl Iterator<Item = Vec<u8>>, answer: impl Fn(&[u8]) -> Vec<u8>) -> usize {
        let now = Instant::now();
        let mut ends = [Echoes::default(), Echoes::default()];
        let mut under_way: VecDeque<(usize, Vec<u8>)> = begin.map(|datagram| (0, datagram)).collect();
        let mut answered = 0;
        while let Some((to, datagram)) = under_way.pop_front() {
            if ends[to].must_end(now, peer(1), &datagram) {
                continue;
            }
            answered += 1;
            assert!(answered < 10_000, "for ever");
            let answer = answer(&datagram);
            ends[to].sent(&answer);
            under_way.push_back((1 - to, answer));
        }
        answered
    }

    fn encoded(id: u8, payload: &[u8]) -> Vec<u8> {
        wsg_protocol::FrameEncoder::new(id, payload).collect()
    }

    #[test]
    fn exchange_of_more_answers_than_are_remembered_ends() {
        let frames = (0..=0xFF).filter(|id| *id != CommandId::Loop.code()).map(|id| encoded(id, &[14, 0]));
        let answered = exchanged(frames, |request| encoded(request[3], &[14, 0]));
        assert!(answered < 200, "{answered}");
        let lines = (0..200).map(|number| format!("POS={number}.5\n").into_bytes());
        let answered = exchanged(lines, <[u8]>::to_vec);
        assert!(answered < 200, "{answered}");
    }

    #[test]
    fn loop_that_grows_with_each_answer_ends() {
        let requests = (0..6u8).map(|number| encoded(0x06, &[number]));
        let answered = exchanged(requests, |request| {
            let payload = [&[0, 0], &request[6..request.len() - 2]].concat();
            encoded(0x06, &payload)
        });
        assert!(answered < 100, "{answered}");
    }

    #[test]
    fn setting_that_is_answered_by_itself_may_be_repeated() {
        let mut now = Instant::now();
        let mut echoes = Echoes::default();
        for n in 0..100 {
            assert!(!echoes.must_end(now, peer(1), b"VERBOSE=1\n"), "{n}");
            echoes.sent(b"VERBOSE=1\n");
            now += Duration::from_millis(if n % 10 == 0 { 1_000 } else { 5 });
        }
    }

    #[test]
    fn client_that_asks_for_something_is_answered_again() {
        let now = Instant::now();
        let mut echoes = Echoes::default();
        echoes.sent(ANSWER);
        while !echoes.must_end(now, peer(1), ANSWER) {}
        assert!(!echoes.must_end(now, peer(1), b"POS?\n"));
        assert!(!echoes.must_end(now, peer(1), ANSWER));
    }

    #[test]
    fn requests_of_another_client_do_not_keep_a_loop_alive() {
        let now = Instant::now();
        let mut echoes = Echoes::default();
        echoes.sent(ANSWER);
        let mut answered = 0;
        while !echoes.must_end(now, peer(1), ANSWER) {
            assert!(!echoes.must_end(now, peer(2), b"POS?\n"));
            answered += 1;
            assert!(answered < 100, "for ever");
        }
        assert!(!echoes.must_end(now, peer(2), b"POS?\n"));
    }
}
