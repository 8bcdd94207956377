//! A faulty line loses, delays, corrupts, truncates or duplicates frames.
//!
//! Independent of sockets and clocks. The fate of a frame depends only on the seed, the connection, the number of the
//! frame on it, and the rates. Runs are therefore repeatable, and changing one rate does not affect the frames hit by the others.

use super::json::{members, names};
use crate::time::Time;
use std::collections::VecDeque;
use wsg_protocol::Number;

/// Capacity of the line for a client with flow control, in frames.
const MAX_WAITING: usize = 64;
/// Absolute capacity of the line in frames: the frames of one read may exceed [`MAX_WAITING`].
const MAX_HELD: usize = 512;
/// Maximum number of copies of one frame of the gripper.
const MAX_COPIES: usize = 2;

/// The direction in which a line is faulty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum FaultDirection {
    /// Only frames to the gripper.
    Requests,
    /// Only frames from the gripper.
    Replies,
    #[default]
    Both,
}
names!(FaultDirection: Requests "requests", Replies "replies", Both "both");

/// How often each fault hits a frame, from 0 (never) to 1 (always).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct LineFaults {
    pub(crate) direction: FaultDirection,
    pub(crate) drop: f32,
    pub(crate) delay: f32,
    /// Delay of a delayed frame, in ms.
    pub(crate) delay_ms: u32,
    /// Rate of frames with one wrong bit.
    pub(crate) corrupt: f32,
    /// Rate of frames without their end.
    pub(crate) truncate: f32,
    /// Rate of frames sent twice.
    pub(crate) duplicate: f32,
}
members!(LineFaults: direction, drop, delay, delay_ms, corrupt, truncate, duplicate);

impl LineFaults {
    /// The longest delay in ms.
    pub(crate) const MAX_DELAY_MS: u32 = 60_000;

    /// Returns the faults of frames to the gripper.
    pub(crate) fn of_requests(self) -> Self {
        if self.direction == FaultDirection::Replies { Self::default() } else { self }
    }

    /// Returns the faults of frames from the gripper.
    pub(crate) fn of_replies(self) -> Self {
        if self.direction == FaultDirection::Requests { Self::default() } else { self }
    }

    pub(crate) fn are_none(&self) -> bool {
        self.rates().iter().all(|rate| *rate <= 0.0)
    }

    const fn rates(&self) -> [f32; 5] {
        [self.drop, self.delay, self.corrupt, self.truncate, self.duplicate]
    }
}

impl std::fmt::Display for LineFaults {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { direction, delay_ms, .. } = self;
        let [drop, delay, corrupt, truncate, duplicate] = self.rates().map(Number);
        let of = match direction {
            FaultDirection::Requests => "of requests",
            FaultDirection::Replies => "of replies",
            FaultDirection::Both => "of both directions",
        };
        write!(f, "drop {drop}, delay {delay} by {delay_ms} ms, corrupt {corrupt}, ")?;
        write!(f, "truncate {truncate}, duplicate {duplicate}, {of}")
    }
}

/// The effect of the line on one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Fate {
    pub(crate) dropped: bool,
    /// The delay in ms.
    pub(crate) delayed: Option<u32>,
    /// Index of the corrupted byte, and the value it is XORed with.
    pub(crate) corrupted: Option<(usize, u8)>,
    /// The number of bytes left.
    pub(crate) truncated: Option<usize>,
    pub(crate) duplicated: bool,
}

impl Fate {
    /// Draws the fate of a frame of `len` bytes. Every random number is drawn even if unused, so that each fault
    /// depends on its own rate alone.
    fn draw(faults: &LineFaults, chance: &mut Chance, len: usize) -> Self {
        let dropped = chance.hits(faults.drop);
        let delayed = chance.hits(faults.delay);
        let corrupted = chance.hits(faults.corrupt);
        let corruption = (chance.below(len), 1 << chance.below(8));
        let truncated = chance.hits(faults.truncate);
        // At least one byte arrives and at least one is missing.
        let kept_len = 1 + chance.below(len.saturating_sub(1));
        let duplicated = chance.hits(faults.duplicate);
        if dropped {
            return Self { dropped, ..Self::default() };
        }
        Self {
            dropped,
            delayed: delayed.then_some(faults.delay_ms),
            corrupted: corrupted.then_some(corruption),
            truncated: truncated.then_some(kept_len),
            duplicated,
        }
    }

    /// Returns whether the line does not affect the frame.
    pub(crate) fn is_harmless(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the bytes that arrive.
    fn apply(&self, frame: &[u8]) -> Vec<u8> {
        let mut bytes = frame.to_vec();
        if let Some((at, flipped)) = self.corrupted
            && let Some(byte) = bytes.get_mut(at)
        {
            *byte ^= flipped;
        }
        bytes.truncate(self.truncated.unwrap_or(bytes.len()));
        bytes
    }
}

impl std::fmt::Display for Fate {
    /// Formats the fate, such as `delayed by 50 ms, byte 3 changed by 10h`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let parts = [
            self.dropped.then(|| "dropped".to_owned()),
            self.delayed.map(|ms| format!("delayed by {ms} ms")),
            self.corrupted.map(|(at, flipped)| format!("byte {at} changed by {flipped:02X}h")),
            self.truncated.map(|len| format!("cut to {len} bytes")),
            self.duplicated.then(|| "sent twice".to_owned()),
        ];
        f.write_str(&parts.into_iter().flatten().collect::<Vec<_>>().join(", "))
    }
}

/// Number of frames on the lines, and of frames hit by each fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LineCounts {
    pub(crate) frames: u64,
    pub(crate) dropped: u64,
    pub(crate) delayed: u64,
    pub(crate) corrupted: u64,
    pub(crate) truncated: u64,
    pub(crate) duplicated: u64,
}
members!(LineCounts: frames, dropped, delayed, corrupted, truncated, duplicated);

impl LineCounts {
    pub(crate) fn count(&mut self, fate: &Fate) {
        self.frames += 1;
        self.dropped += u64::from(fate.dropped);
        self.delayed += u64::from(fate.delayed.is_some());
        self.corrupted += u64::from(fate.corrupted.is_some());
        self.truncated += u64::from(fate.truncated.is_some());
        self.duplicated += u64::from(fate.duplicated);
    }
}

/// The counts of both directions.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LineCountsByDirection {
    pub(crate) requests: LineCounts,
    pub(crate) replies: LineCounts,
}
members!(LineCountsByDirection: requests, replies);

/// How a frame passes the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Passage {
    /// Immediately and unchanged.
    Through,
    /// Held in the line, as far as anything arrives.
    Held(Fate),
}

/// The latency of a line without faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Latency {
    /// Delay of each frame, in ms.
    pub(crate) delay_ms: u16,
    /// Minimum distance between two frames, in ms.
    pub(crate) gap_ms: u16,
}

impl Latency {
    /// Zero delay and distance.
    pub(crate) const NONE: Self = Self { delay_ms: 0, gap_ms: 0 };
}

/// The line to one client, or from it.
#[derive(Debug)]
pub(crate) struct FaultyLine {
    latency: Latency,
    /// Earliest time of the next arrival.
    next_at: Time,
    seed: u64,
    /// Number of frames so far.
    frames: u64,
    waiting: VecDeque<(Time, Vec<u8>)>,
}

impl FaultyLine {
    /// Returns the line of the connection with this number.
    pub(crate) const fn new(seed: u64, connection: u64) -> Self {
        Self {
            latency: Latency::NONE,
            next_at: Time::ZERO,
            seed: mixed(mixed(seed) ^ connection),
            frames: 0,
            waiting: VecDeque::new(),
        }
    }

    /// Returns the line with this latency.
    pub(crate) fn with_latency(self, latency: Latency) -> Self {
        Self { latency, ..self }
    }

    /// Returns whether [`pass`](Self::pass) has room for all copies of a frame.
    pub(crate) fn has_room(&self) -> bool {
        self.waiting.len() + MAX_COPIES <= MAX_WAITING
    }

    /// Returns whether the line has reached its absolute capacity.
    pub(crate) fn is_full(&self) -> bool {
        self.waiting.len() >= MAX_HELD
    }

    /// Returns the fate of the next frame, which has `len` bytes.
    pub(crate) fn fate(&mut self, faults: &LineFaults, len: usize) -> Fate {
        let mut chance = Chance(mixed(self.seed ^ self.frames));
        self.frames = self.frames.wrapping_add(1);
        if faults.are_none() { Fate::default() } else { Fate::draw(faults, &mut chance, len) }
    }

    /// Takes the gripper's next frame.
    pub(crate) fn pass(&mut self, faults: &LineFaults, now: Time, frame: &[u8]) -> Passage {
        let fate = self.fate(faults, frame.len());
        if fate.is_harmless() && self.waiting.is_empty() && self.latency == Latency::NONE {
            return Passage::Through;
        }
        self.hold(&fate, now, frame);
        Passage::Held(fate)
    }

    /// Holds a frame, or other bytes, with this fate. Frames never overtake each other: frames after a delayed one wait.
    pub(crate) fn hold(&mut self, fate: &Fate, now: Time, frame: &[u8]) {
        if !fate.dropped {
            let Latency { delay_ms, gap_ms } = self.latency;
            let late_ms = u64::from(fate.delayed.unwrap_or(0)) + u64::from(delay_ms);
            let due = now.plus_millis(late_ms).max(self.next_at);
            let due = self.waiting.back().map_or(due, |(before, _)| due.max(*before));
            self.next_at = due.plus_millis(gap_ms.into());
            let bytes = fate.apply(frame);
            if fate.duplicated {
                self.waiting.push_back((due, bytes.clone()));
            }
            self.waiting.push_back((due, bytes));
        }
    }

    /// Returns the next bytes that have arrived by `now`.
    pub(crate) fn arrive(&mut self, now: Time) -> Option<Vec<u8>> {
        let (due, _) = self.waiting.front()?;
        if *due > now {
            return None;
        }
        self.waiting.pop_front().map(|(_, bytes)| bytes)
    }

    /// Returns the time of the next arrival.
    pub(crate) fn next_arrival(&self) -> Option<Time> {
        self.waiting.front().map(|(due, _)| *due)
    }
}

/// Pseudo-random numbers: SplitMix64, whose output is [`mixed`] of a counter.
#[derive(Clone, Copy, Debug)]
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(STEP);
        mixed(self.0)
    }

    /// Returns `true` at this rate.
    fn hits(&mut self, rate: f32) -> bool {
        const TWO_TO_53: f64 = (1u64 << 53) as f64;
        ((self.next() >> 11) as f64) < f64::from(rate) * TWO_TO_53
    }

    /// Returns a number from 0 to `bound` - 1; 0 for a bound of 0.
    fn below(&mut self, bound: usize) -> usize {
        let drawn = self.next();
        drawn.checked_rem(bound as u64).map_or(0, |value| value as usize)
    }
}

/// The increment of SplitMix64's counter.
const STEP: u64 = 0x9E37_79B9_7F4A_7C15;

/// The output function of SplitMix64: every bit of the value reaches every bit of the result.
const fn mixed(value: u64) -> u64 {
    let value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    value ^ (value >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: [u8; 10] = [0xAA, 0xAA, 0xAA, 0x22, 0x02, 0, 0, 0, 0x12, 0x34];
    const SOME: LineFaults = LineFaults {
        direction: FaultDirection::Both,
        drop: 0.1,
        delay: 0.2,
        delay_ms: 7,
        corrupt: 0.3,
        truncate: 0.1,
        duplicate: 0.05,
    };

    fn fates(faults: LineFaults, seed: u64, connection: u64, count: usize) -> Vec<Fate> {
        let mut line = FaultyLine::new(seed, connection);
        (0..count)
            .map(|_| {
                let passage = line.pass(&faults, Time::ZERO, &FRAME);
                while line.arrive(Time::from_millis(60_000)).is_some() {}
                match passage {
                    Passage::Through => Fate::default(),
                    Passage::Held(fate) => fate,
                }
            })
            .collect()
    }

    fn arrivals(line: &mut FaultyLine, now: Time) -> Vec<Vec<u8>> {
        std::iter::from_fn(|| line.arrive(now)).collect()
    }

    #[test]
    fn frames_of_a_paced_line_come_late_and_apart() {
        let mut line = FaultyLine::new(0, 0).with_latency(Latency { delay_ms: 22, gap_ms: 5 });
        let arrivals_at = |line: &mut FaultyLine, ms| arrivals(line, Time::from_millis(ms)).len();
        for _ in 0..2 {
            assert!(matches!(line.pass(&LineFaults::default(), Time::ZERO, &FRAME), Passage::Held(_)));
        }
        assert_eq!([21, 22, 26, 27].map(|ms| arrivals_at(&mut line, ms)), [0, 1, 0, 1]);
        // 5 ms after a frame that has already arrived.
        line.pass(&LineFaults::default(), Time::from_millis(5), &FRAME);
        assert_eq!([31, 32].map(|ms| arrivals_at(&mut line, ms)), [0, 1]);
    }

    #[test]
    fn same_seed_gives_each_connection_the_same_faults_again() {
        let fates_of = |seed, connection| fates(SOME, seed, connection, 200);
        assert_eq!(fates_of(1, 0), fates_of(1, 0));
        assert_ne!(fates_of(1, 0), fates_of(2, 0));
        assert_ne!(fates_of(1, 0), fates_of(1, 1));
    }

    #[test]
    fn each_fault_hits_as_often_as_its_rate_says() {
        let mut counts = LineCounts::default();
        for fate in fates(SOME, 5, 0, 10_000) {
            counts.count(&fate);
        }
        // A lost frame reports no other fault.
        for (count, expected) in [
            (counts.dropped, 1_000),
            (counts.delayed, 1_800),
            (counts.corrupted, 2_700),
            (counts.truncated, 900),
            (counts.duplicated, 450),
        ] {
            assert!(count.abs_diff(expected) < 150, "{counts:?}");
        }
    }

    #[test]
    fn rate_that_changes_does_not_change_what_the_others_hit() {
        let with = fates(LineFaults { delay: 0.0, duplicate: 0.9, ..SOME }, 9, 3, 500);
        for (before, after) in fates(SOME, 9, 3, 500).iter().zip(with) {
            assert_eq!(
                (before.dropped, before.corrupted, before.truncated),
                (after.dropped, after.corrupted, after.truncated)
            );
        }
    }

    #[test]
    fn line_without_faults_passes_every_frame_through() {
        assert!(fates(LineFaults::default(), 1, 1, 100).iter().all(Fate::is_harmless));
    }

    #[test]
    fn corrupted_frame_has_one_wrong_bit() {
        let mut line = FaultyLine::new(1, 0);
        for _ in 0..40 {
            line.pass(&LineFaults { corrupt: 1.0, ..LineFaults::default() }, Time::ZERO, &FRAME);
            let got = arrivals(&mut line, Time::ZERO).remove(0);
            let wrong: u32 = got.iter().zip(FRAME).map(|(got, sent)| (got ^ sent).count_ones()).sum();
            assert_eq!((got.len(), wrong), (FRAME.len(), 1));
        }
    }

    #[test]
    fn truncated_frame_is_shorter_and_duplicate_arrives_twice() {
        let mut line = FaultyLine::new(1, 0);
        for _ in 0..40 {
            let faults = LineFaults { truncate: 1.0, duplicate: 1.0, ..LineFaults::default() };
            line.pass(&faults, Time::ZERO, &FRAME);
            let got = arrivals(&mut line, Time::ZERO);
            assert_eq!(got.len(), 2);
            assert_eq!(got[0], got[1]);
            assert!((1..FRAME.len()).contains(&got[0].len()) && FRAME.starts_with(&got[0]));
        }
    }

    #[test]
    fn delayed_frame_delays_the_following_frames() {
        let mut line = FaultyLine::new(1, 0);
        let late = LineFaults { delay: 1.0, delay_ms: 50, ..LineFaults::default() };
        assert!(matches!(line.pass(&late, Time::ZERO, &FRAME), Passage::Held(_)));
        assert!(matches!(line.pass(&LineFaults::default(), Time::ZERO, &FRAME[..9]), Passage::Held(_)));
        assert_eq!(line.next_arrival(), Some(Time::from_millis(50)));
        assert_eq!(arrivals(&mut line, Time::from_millis(49)), Vec::<Vec<u8>>::new());
        assert_eq!(arrivals(&mut line, Time::from_millis(50)), [&FRAME[..], &FRAME[..9]]);
        assert_eq!(line.pass(&LineFaults::default(), Time::ZERO, &FRAME), Passage::Through);
    }

    #[test]
    fn line_holds_a_bounded_number_of_frames() {
        let mut line = FaultyLine::new(1, 0);
        let faults = LineFaults { delay: 1.0, delay_ms: 1_000, duplicate: 1.0, ..LineFaults::default() };
        let mut passed = 0;
        while line.has_room() {
            line.pass(&faults, Time::ZERO, &FRAME);
            passed += 1;
        }
        assert_eq!(passed, MAX_WAITING / MAX_COPIES);
    }
}
