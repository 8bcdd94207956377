//! `candump` logs: the format of `candump -l` and the terminal output. For the mapping to CAN frames see `docs/can.md`.

use std::ops::RangeInclusive;

use embedded_can::{Frame as CanFrame, Id, StandardId};
use wsg_protocol::can::{FULL, HALF_MESSAGE_MS, Identifiers, MAX_FRAMES, Reassembler};
use wsg_protocol::frame::PREAMBLE_BYTE;
use wsg_protocol::{Direction, Event, FrameEncoder, Instant};

use super::entry::{Entry, EntryKind, count, of_binary};

/// A classic CAN frame from the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Logged {
    /// Time and bus, as written in the log.
    place: String,
    /// Time in microseconds; 0 if the log has none.
    time_us: u64,
    id: u32,
    is_extended: bool,
    /// Data bytes, or `None` for a remote frame.
    data: Option<Vec<u8>>,
}

impl CanFrame for Logged {
    fn new(_: impl Into<Id>, _: &[u8]) -> Option<Self> {
        None
    }

    fn new_remote(_: impl Into<Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        self.is_extended
    }

    fn is_remote_frame(&self) -> bool {
        self.data.is_none()
    }

    fn id(&self) -> Id {
        // The value of an extended identifier is irrelevant: no gripper uses one.
        let standard = StandardId::new(self.id as u16).filter(|_| !self.is_extended);
        standard.map_or(Id::Extended(embedded_can::ExtendedId::ZERO), Id::Standard)
    }

    fn dlc(&self) -> usize {
        self.data().len()
    }

    fn data(&self) -> &[u8] {
        self.data.as_deref().unwrap_or(&[])
    }
}

pub(crate) fn parse_line(line: &str) -> Option<Logged> {
    let line = line.trim();
    let (time, rest) = match line.strip_prefix('(') {
        Some(rest) => rest.split_once(')').map(|(time, rest)| (time.trim(), rest.trim()))?,
        None => ("", line),
    };
    let time_us = micros(time)?;
    let (bus, rest) = rest.split_once(char::is_whitespace)?;
    let place = if time.is_empty() { bus.to_owned() } else { format!("{time} {bus}") };
    let rest = rest.trim();
    let (id, data) = match rest.split_once('#') {
        // `120#AAAAAA2200000E76`, optionally followed by a direction. `120#R` is a remote frame, `120##...` CAN FD.
        Some((id, data)) => {
            let data = data.split_whitespace().next().unwrap_or("");
            (id, if data.starts_with('R') { None } else { Some(pairs(data)?) })
        }
        // `120   [8]  AA AA AA 22 00 00 0E 76`
        None => {
            let mut words = rest.split_whitespace().skip_while(|word| matches!(*word, "TX" | "RX" | "-"));
            let id = words.next()?;
            let words = words.skip_while(|word| matches!(*word, "-")).collect::<Vec<_>>();
            let (len, data) = words.split_first()?;
            let len: usize = len.strip_prefix('[')?.strip_suffix(']')?.parse().ok()?;
            if data.first() == Some(&"remote") {
                (id, None)
            } else {
                let data = data.get(..len)?.iter().map(|word| pairs(word)).collect::<Option<Vec<_>>>()?;
                (id, Some(data.concat()))
            }
        }
    };
    let is_extended = id.len() == 8;
    let is_id = (is_extended || id.len() == 3) && id.bytes().all(|digit| digit.is_ascii_hexdigit());
    let id = u32::from_str_radix(id, 16).ok().filter(|_| is_id)?;
    let fits = data.as_ref().is_none_or(|data| data.len() <= FULL);
    fits.then_some(Logged { place, time_us, id, is_extended, data })
}

/// Parses a time with six decimals to microseconds. Empty text is 0.
fn micros(time: &str) -> Option<u64> {
    if time.is_empty() {
        return Some(0);
    }
    // `candump -t A` writes the date before the time.
    let time = time.rsplit(' ').next().unwrap_or(time);
    let (seconds, fraction) = time.split_once('.')?;
    let fraction: u64 = fraction.get(..6).filter(|rest| rest.len() == fraction.len())?.parse().ok()?;
    let seconds = match seconds.parse::<u64>() {
        Ok(seconds) => seconds,
        Err(_) => seconds
            .split(':')
            .try_fold(0u64, |sum, part| Some(sum * 60 + u64::from(part.parse::<u16>().ok()?)))?,
    };
    seconds.checked_mul(1_000_000)?.checked_add(fraction)
}

fn pairs(digits: &str) -> Option<Vec<u8>> {
    let is_pairs = digits.len().is_multiple_of(2) && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    let pair = |pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    is_pairs.then(|| digits.as_bytes().chunks(2).map(pair).collect()).flatten()
}

/// Detects the gripper's identifiers: the pair of which at least one carries message beginnings. Prefers the default pair.
fn identifiers(frames: &[&Logged]) -> Option<Identifiers> {
    let begins = |id: u32| {
        frames.iter().any(|frame| {
            let is_beginning = frame.data().starts_with(&[PREAMBLE_BYTE; 3]) && frame.data().len() == FULL;
            frame.id == id && !frame.is_extended && is_beginning
        })
    };
    let delivered = u32::from(Identifiers::DEFAULT.base());
    if begins(delivered) || begins(delivered + 1) {
        return Some(Identifiers::DEFAULT);
    }
    let mut bases = (0..0x7FF).filter(|base| begins(*base));
    bases.next().and_then(|base| Identifiers::from_base(u16::try_from(base).ok()?))
}

/// Decodes the messages among the CAN frames of a bus. The gripper's identifiers are detected if `asked` is `None`.
///
/// A message is never joined across lines that could not be read.
pub(crate) fn decode(
    log: &[Result<Logged, RangeInclusive<usize>>],
    asked: Option<Identifiers>,
) -> Vec<Entry> {
    let frames: Vec<&Logged> = log.iter().filter_map(|frame| frame.as_ref().ok()).collect();
    let mut found = Vec::new();
    let pair = asked.or_else(|| identifiers(&frames));
    let ids = pair.map(|pair| (pair.gripper().receive, pair.gripper().transmit));
    let mut entries = vec![Entry::note(
        String::new(),
        match ids {
            Some((to, from)) => {
                format!("{:03X}h to the gripper, {:03X}h from it", to.as_raw(), from.as_raw())
            }
            None => format!("none of the {} CAN frames starts a message", frames.len()),
        },
    )];
    let mut lines: Vec<Traffic> = ids
        .into_iter()
        .flat_map(|(to, from)| [(to, Direction::ToGripper), (from, Direction::FromGripper)])
        .map(|(id, direction)| Traffic::new(id, direction))
        .collect();
    let mut foreign = 0;
    for (at, frame) in log.iter().enumerate() {
        match frame {
            Ok(frame) => match lines.iter_mut().find(|line| frame.id() == Id::Standard(line.id)) {
                Some(line) => line.receive(at, frame, &mut found),
                None => foreign += 1,
            },
            Err(unread) => {
                for line in &mut lines {
                    line.end(Some("its rest may be in a line that could not be read"), &mut found);
                }
                found.push((at, Entry::unread(unread, "candump")));
            }
        }
    }
    for line in &mut lines {
        line.end(None, &mut found);
    }
    found.sort_by_key(|(at, _)| *at);
    entries.extend(found.into_iter().map(|(_, entry)| entry));
    if foreign > 0 && pair.is_some() {
        entries.push(Entry::note(
            String::new(),
            format!("skipped {} with other identifiers", count(foreign, "CAN frame")),
        ));
    }
    entries
}

/// The frames of one direction.
struct Traffic {
    id: StandardId,
    direction: Direction,
    reassembler: Reassembler<MAX_FRAMES>,
    /// Frames not reported yet, with their positions in the log.
    held: Vec<(usize, Logged)>,
}

impl Traffic {
    fn new(id: StandardId, direction: Direction) -> Self {
        Self { id, direction, reassembler: Reassembler::new(id, HALF_MESSAGE_MS), held: Vec::new() }
    }

    fn receive(&mut self, at: usize, frame: &Logged, found: &mut Vec<(usize, Entry)>) {
        let now = Instant::from_millis((frame.time_us / 1_000) as u32);
        self.step(None, found, |reassembler, deliver| reassembler.handle_timeout(now, deliver));
        self.held.push((at, frame.clone()));
        self.step(None, found, |reassembler, deliver| reassembler.receive(now, frame, deliver));
    }

    /// Drops an incomplete message, for this reason or because the log ends.
    fn end(&mut self, reason: Option<&str>, found: &mut Vec<(usize, Entry)>) {
        if let Some(at) = self.reassembler.poll_timeout() {
            self.step(reason, found, |reassembler, deliver| reassembler.handle_timeout(at, deliver));
        }
    }

    /// Runs a step of the reassembler and reports its messages and dropped frames.
    ///
    /// The reassembler consumes frames in order. Without a known reason for dropping them, the counter that it increments gives it.
    fn step(
        &mut self,
        known_reason: Option<&str>,
        found: &mut Vec<(usize, Entry)>,
        step: impl FnOnce(&mut Reassembler<MAX_FRAMES>, &mut dyn FnMut(Event<'_>)),
    ) {
        let before = self.reassembler.counters();
        let mut messages: Vec<Vec<u8>> = Vec::new();
        step(&mut self.reassembler, &mut |event| {
            if let Event::Frame(message) = event {
                messages.push(FrameEncoder::new(message.id, message.payload).collect());
            }
        });
        let after = self.reassembler.counters();
        let grew = |of: fn(&wsg_protocol::can::ReassemblerCounters) -> u16| of(&after) != of(&before);
        let reasons = [
            (
                grew(|it| it.miscut),
                "the CAN frames do not match the message size: one was lost or duplicated",
            ),
            (grew(|it| it.bad_checksum), "wrong checksum"),
            (grew(|it| it.oversize), "the payload size exceeds the maximum"),
            (grew(|it| it.expired), "the rest of the message was not received in time"),
        ];
        let counted = reasons.iter().find(|(grew, _)| *grew).map(|(_, why)| *why);
        let reason = known_reason.or(counted).unwrap_or("not the start of a message");
        let mut dropped = usize::from(after.dropped.saturating_sub(before.dropped));
        for message in messages {
            let frames = message.len().div_ceil(FULL);
            // Frames before the start of the message were dropped.
            let begins = |held: &[(usize, Logged)]| {
                let bytes = held.iter().flat_map(|(_, frame)| frame.data().iter());
                held.len() >= frames && bytes.take(message.len()).eq(&message)
            };
            let at = (0..self.held.len()).find(|at| begins(self.held.get(*at..).unwrap_or(&[])));
            dropped = dropped.saturating_sub(at.unwrap_or(0));
            self.drop_frames(at.unwrap_or(0), reason, found);
            let used: Vec<_> = self.held.drain(..frames.min(self.held.len())).collect();
            let Some((first, frame)) = used.first() else { continue };
            let entries = of_binary(&message, Some(self.direction), |_| frame.place.clone());
            found.extend(entries.into_iter().map(|entry| (*first, entry)));
        }
        if self.reassembler.poll_timeout().is_some() {
            self.drop_frames(dropped, reason, found);
        } else {
            self.drop_frames(self.held.len(), reason, found);
            // Start afresh, because its counters saturate.
            self.reassembler = Reassembler::new(self.id, HALF_MESSAGE_MS);
        }
    }

    fn drop_frames(&mut self, count: usize, reason: &str, found: &mut Vec<(usize, Entry)>) {
        for (at, frame) in self.held.drain(..count.min(self.held.len())) {
            let entry = Entry {
                place: frame.place.clone(),
                direction: Some(self.direction),
                kind: EntryKind::Dropped,
                words: format!("dropped a CAN frame of {} bytes: {reason}", frame.data().len()),
                bytes: frame.data().to_vec(),
            };
            found.push((at, entry));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_format_is_parsed_to_the_same_frame() {
        let stop = [0xAA, 0xAA, 0xAA, 0x22, 0x00, 0x00, 0x0E, 0x76];
        for (line, place, time_us) in [
            (
                "(1436509052.249713) vcan0 120#AAAAAA2200000E76",
                "1436509052.249713 vcan0",
                1_436_509_052_249_713,
            ),
            (
                "(1436509052.249713) vcan0 120#AAAAAA2200000E76 T",
                "1436509052.249713 vcan0",
                1_436_509_052_249_713,
            ),
            ("  can0  120   [8]  AA AA AA 22 00 00 0E 76", "can0", 0),
            (" (000.000200)  can0  120   [8]  AA AA AA 22 00 00 0E 76   '...\"...v'", "000.000200 can0", 200),
            (" (000.000200)  can0  TX - -  120   [8]  AA AA AA 22 00 00 0E 76", "000.000200 can0", 200),
        ] {
            let frame = parse_line(line).unwrap_or_else(|| panic!("{line}"));
            assert_eq!((frame.data(), frame.id, frame.is_extended), (&stop[..], 0x120, false), "{line}");
            assert_eq!((frame.place.as_str(), frame.time_us), (place, time_us));
        }
        let remote = parse_line("can0 00000120#R").unwrap();
        assert!(remote.is_remote_frame() && remote.is_extended());
        assert!(parse_line("  can0  120   [0]  remote request").unwrap().is_remote_frame());
        for line in
            ["can0 120##1AA", "can0 120#AAAAAA2200000E7600", "can0 12#AA", "can0 120 [8] AA", "GRIP(20)", "#"]
        {
            assert_eq!(parse_line(line), None, "{line}");
        }
    }
}
