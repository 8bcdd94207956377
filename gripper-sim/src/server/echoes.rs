//! What comes back: a peer that answers answers, such as another virtual gripper, would have this one answer for ever.
//!
//! A datagram may name as its sender whoever its author likes, and what makes no sense is answered with an error, which
//! makes no sense either. The form does not tell an answer from a request: `VERBOSE=1` is both.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

/// How many of the latest answers are compared.
const REMEMBERED: usize = 8;

/// How many datagrams in a row may be what was just sent: clients do repeat a setting that is answered by itself.
const TOLERATED: u32 = 16;

/// After so long without one it begins anew: what comes in a loop comes at once.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(1);

/// Tells datagrams that only come back from those that ask.
#[derive(Debug, Default)]
pub(super) struct Echoes {
    sent: VecDeque<Vec<u8>>,
    in_a_row: u32,
    /// When the last one came, and from whom.
    last: Option<(Instant, SocketAddr)>,
}

impl Echoes {
    /// Notes what is sent.
    pub(super) fn sent(&mut self, datagram: &[u8]) {
        if self.sent.len() == REMEMBERED {
            self.sent.pop_front();
        }
        self.sent.push_back(datagram.to_owned());
    }

    /// Whether what is received at `now` must not be answered: it only comes back, and not for the first time. What
    /// others ask meanwhile does not keep a loop alive.
    pub(super) fn must_end(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) -> bool {
        if !self.sent.iter().any(|sent| sent == datagram) {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// What a gripper says to what it does not understand, and to what it has said.
    const ANSWER: &[u8] = b"ERR ? 15\n";

    fn peer(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    #[test]
    fn loop_between_two_that_answer_answers_ends() {
        let now = Instant::now();
        let mut ends = [Echoes::default(), Echoes::default()];
        let mut sent = 0;
        ends[0].sent(ANSWER);
        while !ends[(sent + 1) % 2].must_end(now, peer(1), ANSWER) {
            ends[(sent + 1) % 2].sent(ANSWER);
            sent += 1;
            assert!(sent < 100, "for ever");
        }
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
    fn client_that_asks_meanwhile_is_answered_and_keeps_no_loop_alive() {
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
