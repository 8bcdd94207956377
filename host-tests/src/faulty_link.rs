//! Fault injection for any byte link, to test programs that use a gripper.
//!
//! [`FaultyWay`] is one direction: bytes and a time in, arriving bytes out. It has no clock and no I/O. Faults are
//! random with a seed or scripted byte by byte, so every run is reproducible.
//!
//! The servers of `wsg-sim` inject faults into whole frames; these faults hit bytes at any position.
//!
//! ```
//! use host_tests::faulty_link::{Fault, FaultyWay, Rates};
//!
//! // The third byte is lost; in addition, five bits in a million are flipped.
//! let mut way = FaultyWay::new(Rates { flip: 5e-6, ..Rates::NONE }, 1).with(2, Fault::Drop);
//! way.pass(0, b"ABCD");
//! assert_eq!(way.arrive(0), b"ABD");
//! assert_eq!(way.counts().faults, 1);
//! ```

use std::collections::{BTreeMap, VecDeque};

use crate::chance::Chance;

/// Probability of each fault per byte, from 0 (never) to 1 (always).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rates {
    /// The byte is lost.
    pub drop: f64,
    /// One bit is flipped.
    pub flip: f64,
    /// The byte is duplicated.
    pub duplicate: f64,
    /// Another byte is inserted before it.
    pub insert: f64,
    /// The byte and the rest of its transmission are lost.
    pub truncate: f64,
    /// The byte is delayed, and so are all later bytes.
    pub delay: f64,
    /// Delay in milliseconds.
    pub delay_ms: u32,
}

impl Rates {
    /// A line without faults.
    pub const NONE: Self =
        Self { drop: 0.0, flip: 0.0, duplicate: 0.0, insert: 0.0, truncate: 0.0, delay: 0.0, delay_ms: 0 };

    /// Returns rates that damage a fraction `rate` of all bytes, with equal shares of the first four faults.
    #[must_use]
    pub const fn of_bytes(rate: f64) -> Self {
        let each = rate / 4.0;
        Self { drop: each, flip: each, duplicate: each, insert: each, ..Self::NONE }
    }
}

/// A fault of one byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The byte is lost.
    Drop,
    /// These bits are flipped.
    Flip(u8),
    /// The byte is duplicated.
    Duplicate,
    /// This byte is inserted before it.
    Insert(u8),
    /// The byte and the rest of its transmission are lost.
    Truncate,
    /// The byte is delayed by this many milliseconds, and so are all later bytes.
    Delay(u32),
}

/// Number of bytes passed and of faults injected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes passed.
    pub bytes: u64,
    /// Faults injected. A truncation counts once.
    pub faults: u64,
}

/// One direction of a line.
#[derive(Clone, Debug)]
pub struct FaultyWay {
    rates: Rates,
    chance: Chance,
    /// Scripted faults by byte index from 0, independent of the rates.
    script: BTreeMap<u64, Fault>,
    counts: Counts,
    /// Bytes in transit with their arrival times.
    waiting: VecDeque<(u32, u8)>,
}

impl FaultyWay {
    /// Creates a direction with random faults at these rates, reproducible by seed.
    #[must_use]
    pub const fn new(rates: Rates, seed: u64) -> Self {
        Self {
            rates,
            chance: Chance::new(seed),
            script: BTreeMap::new(),
            counts: Counts { bytes: 0, faults: 0 },
            waiting: VecDeque::new(),
        }
    }

    /// Creates a direction without faults.
    #[must_use]
    pub const fn perfect() -> Self {
        Self::new(Rates::NONE, 0)
    }

    /// Adds a fault of the byte with this index, counted from 0.
    #[must_use]
    pub fn with(mut self, number: u64, fault: Fault) -> Self {
        self.hit(number, fault);
        self
    }

    /// Schedules a fault of the byte with this index, counted from 0; [`Counts::bytes`] is the next byte's index.
    pub fn hit(&mut self, number: u64, fault: Fault) {
        self.script.insert(number, fault);
    }

    /// Returns the counts so far.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.counts
    }

    /// Accepts bytes sent together at `now_ms`, in milliseconds of any monotonic clock.
    pub fn pass(&mut self, now_ms: u32, bytes: &[u8]) {
        let first = self.counts.bytes;
        self.counts.bytes += bytes.len() as u64;
        for (number, &byte) in (first..).zip(bytes) {
            // Always draws all chances, so a script does not shift the random sequence.
            let drawn = self.draw();
            let fault = self.script.remove(&number).or(drawn);
            self.counts.faults += u64::from(fault.is_some());
            match fault {
                None => self.send(now_ms, byte),
                Some(Fault::Drop) => {}
                Some(Fault::Flip(bits)) => self.send(now_ms, byte ^ bits),
                Some(Fault::Duplicate) => {
                    self.send(now_ms, byte);
                    self.send(now_ms, byte);
                }
                Some(Fault::Insert(other)) => {
                    self.send(now_ms, other);
                    self.send(now_ms, byte);
                }
                Some(Fault::Truncate) => return,
                Some(Fault::Delay(ms)) => self.send(now_ms.wrapping_add(ms), byte),
            }
        }
    }

    /// Returns the bytes that have arrived since the last call, in the order of sending.
    pub fn arrive(&mut self, now_ms: u32) -> Vec<u8> {
        let is_there = |due: &u32| now_ms.wrapping_sub(*due) <= u32::MAX / 2;
        let count = self.waiting.iter().take_while(|(due, _)| is_there(due)).count();
        self.waiting.drain(..count).map(|(_, byte)| byte).collect()
    }

    fn draw(&mut self) -> Option<Fault> {
        let Rates { drop, flip, duplicate, insert, truncate, delay, delay_ms } = self.rates;
        let value = self.chance.number();
        let faults = [
            (drop, Fault::Drop),
            (flip, Fault::Flip(1 << (value % 8))),
            (duplicate, Fault::Duplicate),
            (insert, Fault::Insert((value >> 8) as u8)),
            (truncate, Fault::Truncate),
            (delay, Fault::Delay(delay_ms)),
        ];
        let hit = faults.map(|(rate, fault)| self.chance.hits(rate).then_some(fault));
        hit.into_iter().flatten().next()
    }

    /// Queues a byte; bytes never overtake each other.
    fn send(&mut self, due: u32, byte: u8) {
        let due = match self.waiting.back() {
            Some((before, _)) if before.wrapping_sub(due) <= u32::MAX / 2 => *before,
            _ => due,
        };
        self.waiting.push_back((due, byte));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(fault: Fault) -> Vec<u8> {
        let mut way = FaultyWay::perfect().with(2, fault);
        way.pass(0, b"ABCDE");
        way.pass(0, b"FG");
        way.arrive(0)
    }

    #[test]
    fn each_fault_has_the_effect_of_its_name() {
        assert_eq!(after(Fault::Drop), b"ABDEFG");
        assert_eq!(after(Fault::Flip(0x20)), b"ABcDEFG");
        assert_eq!(after(Fault::Duplicate), b"ABCCDEFG");
        assert_eq!(after(Fault::Insert(b'x')), b"ABxCDEFG");
        assert_eq!(after(Fault::Truncate), b"ABFG");
        assert_eq!(after(Fault::Delay(5)), b"AB");
    }

    #[test]
    fn a_delayed_byte_delays_all_later_bytes() {
        let mut way = FaultyWay::perfect().with(1, Fault::Delay(50));
        way.pass(u32::MAX - 9, b"AB");
        way.pass(u32::MAX, b"C");
        assert_eq!(way.arrive(u32::MAX), b"A");
        assert_eq!(way.arrive(39), b"");
        assert_eq!(way.arrive(40), b"BC");
        way.pass(41, b"D");
        assert_eq!(way.arrive(41), b"D");
    }

    #[test]
    fn faults_match_their_rates_and_are_reproducible_by_seed() {
        let run = |rates, seed| {
            let mut way = FaultyWay::new(rates, seed);
            for ms in 0..1_000 {
                way.pass(ms, &[0x55; 100]);
            }
            (way.arrive(1_000), way.counts())
        };
        // Each fault with the number of bytes that it adds.
        for (rates, added) in [
            (Rates { drop: 0.01, ..Rates::NONE }, -1),
            (Rates { flip: 0.01, ..Rates::NONE }, 0),
            (Rates { duplicate: 0.01, ..Rates::NONE }, 1),
            (Rates { insert: 0.01, ..Rates::NONE }, 1),
        ] {
            let (bytes, Counts { bytes: passed, faults }) = run(rates, 1);
            assert!(faults.abs_diff(1_000) < 120, "{rates:?}: {faults}");
            assert_eq!(passed, 100_000);
            assert_eq!(bytes.len() as i64, 100_000 + added * faults as i64, "{rates:?}");
        }
        let truncated = run(Rates { truncate: 0.001, ..Rates::NONE }, 1).1.faults;
        assert!((60..140).contains(&truncated), "{truncated}");
        let rates = Rates { truncate: 0.001, ..Rates::of_bytes(0.04) };
        assert_eq!(run(rates, 1), run(rates, 1));
        assert_ne!(run(rates, 2).0, run(rates, 1).0);
    }
}
