//! Decodes frames from the bytes of one client: the protocol's parser with a time-out for incomplete frames, or the
//! protocol's reassembler over CAN.
//!
//! Frames carry two checksum bytes even where checksums are not evaluated (command set, 1.4.1). As with the real
//! gripper, a client that omits them loses the first two bytes of its next frame.

use crate::config::Config;
use crate::port::PortKind;
use crate::time::Time;
use bus_slcan::ClassicFrame;
use embedded_can::{Frame as _, StandardId};
use wsg_protocol::can::{FULL, MAX_FRAMES, Reassembler};
use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD};
use wsg_protocol::{Event, Frame, FrameCounters, FrameParser, Instant};

/// Longest payload of an accepted frame.
const MAX_PAYLOAD: usize = MAX_MESSAGE_LEN - OVERHEAD;

/// Finds the frames in the bytes of one client.
#[derive(Clone, Debug)]
pub(crate) struct Deframer {
    finder: Finder,
    is_datagram: bool,
    timeout_ms: u16,
    /// When the incomplete frame is discarded.
    due: Option<Time>,
}

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "the core allocates nothing, and neither is small")]
enum Finder {
    /// For a stream or datagrams.
    Bytes(FrameParser<MAX_PAYLOAD>),
    /// For the data of CAN frames, each on its own.
    Can(Reassembler<MAX_FRAMES>, Found),
}

impl Deframer {
    pub(crate) const fn new(kind: PortKind, config: &Config) -> Self {
        let timeout_ms = config.frame_timeout_ms;
        let finder = match kind {
            // The reassembler rejects messages with a wrong checksum. Without checksums it cannot verify frame boundaries.
            PortKind::Can if config.check_checksum => {
                Finder::Can(Reassembler::new(ID, timeout_ms as u32), Found::NOTHING)
            }
            _ if config.check_checksum => Finder::Bytes(FrameParser::new()),
            _ => Finder::Bytes(FrameParser::ignoring_checksums()),
        };
        Self { finder, is_datagram: kind.is_datagram(), timeout_ms, due: None }
    }

    pub(crate) fn counters(&self) -> FrameCounters {
        match &self.finder {
            Finder::Bytes(parser) => parser.counters(),
            Finder::Can(reassembler, _) => {
                let counters = reassembler.counters();
                FrameCounters {
                    dropped: counters.dropped.saturating_mul(FULL as u16),
                    bad_checksum: counters.bad_checksum,
                    oversize: counters.oversize,
                }
            }
        }
    }

    /// Takes bytes up to the first event, or some of them, and returns how many. The number is 0 if the event belongs
    /// to earlier bytes. When no bytes are left and there is no event, all events have been returned; call
    /// [`pause`](Self::pause) then.
    pub(crate) fn push_slice(&mut self, now: Time, bytes: &[u8]) -> (usize, Option<Event<'_>>) {
        match &mut self.finder {
            Finder::Bytes(parser) => parser.push_slice(bytes),
            Finder::Can(reassembler, found) => {
                let taken = if found.is_empty() { bytes.len().min(FULL) } else { 0 };
                if let Some(data @ [_, ..]) = bytes.get(..taken)
                    && let Some(frame) = ClassicFrame::new(ID, data)
                {
                    reassembler.receive(instant(now), &frame, |event| found.keep(&event));
                }
                (taken, found.next())
            }
        }
    }

    /// Marks the end of the available bytes. A frame never continues in the next datagram.
    pub(crate) fn pause(&mut self, now: Time) {
        let is_mid_frame = match &self.finder {
            Finder::Bytes(parser) => parser.is_mid_frame(),
            Finder::Can(reassembler, _) => reassembler.poll_timeout().is_some(),
        };
        let wait_ms = if self.is_datagram { 0 } else { self.timeout_ms };
        self.due = is_mid_frame.then(|| now.plus_millis(wait_ms.into()));
    }

    /// Returns when to call [`expire`](Self::expire).
    pub(crate) const fn due(&self) -> Option<Time> {
        self.due
    }

    /// Discards a frame that is incomplete at its time-out and rescans its bytes. Call until it returns `None`.
    pub(crate) fn expire(&mut self, now: Time) -> Option<Event<'_>> {
        if self.due.is_none_or(|due| due > now) {
            return None;
        }
        let event = match &mut self.finder {
            Finder::Bytes(parser) => parser.expire(),
            Finder::Can(reassembler, found) => {
                if found.is_empty() {
                    reassembler.handle_timeout(instant(now), |event| found.keep(&event));
                }
                found.next()
            }
        };
        if event.is_none() {
            self.due = None;
        }
        event
    }
}

/// Returns the reassembler's clock, which may wrap.
const fn instant(now: Time) -> Instant {
    Instant::from_millis((now.as_micros() / 1_000) as u32)
}

/// The identifier of all CAN frames here; the caller has already filtered them.
const ID: StandardId = StandardId::ZERO;

/// Events of one CAN frame, taken one at a time. There are several if an earlier CAN frame was lost.
#[derive(Clone, Debug)]
struct Found {
    /// Kind, id and size of each event, and the payload of a frame. They are shorter than the CAN frames they came from.
    events: heapless::Vec<u8, MAX_MESSAGE_LEN>,
    /// Index of the first event that has not been taken.
    next: usize,
}

impl Found {
    const NOTHING: Self = Self { events: heapless::Vec::new(), next: 0 };
    const FRAME: u8 = 0;
    const BAD_CHECKSUM: u8 = 1;
    const OVERSIZE: u8 = 2;

    fn is_empty(&self) -> bool {
        self.next == self.events.len()
    }

    fn keep(&mut self, event: &Event<'_>) {
        if self.is_empty() {
            (self.events, self.next) = (heapless::Vec::new(), 0);
        }
        let (kind, id, size, payload) = match *event {
            Event::Frame(Frame { id, payload }) => (Self::FRAME, id, payload.len() as u16, payload),
            Event::BadChecksum { id, size } => (Self::BAD_CHECKSUM, id, size, &[][..]),
            Event::Oversize { id, size } => (Self::OVERSIZE, id, size, &[][..]),
        };
        let [low, high] = size.to_le_bytes();
        // There is room: each event came from at least one CAN frame of eight bytes, and all of those were held at once.
        let _ = self.events.extend_from_slice(&[kind, id, low, high]);
        let _ = self.events.extend_from_slice(payload);
    }

    fn next(&mut self) -> Option<Event<'_>> {
        let rest = self.events.get(self.next..).unwrap_or(&[]);
        let [kind, id, low, high, behind @ ..] = rest else { return None };
        let (id, size) = (*id, u16::from_le_bytes([*low, *high]));
        let payload = if *kind == Self::FRAME { behind.get(..size.into()).unwrap_or(&[]) } else { &[] };
        self.next += rest.len() - behind.len() + payload.len();
        Some(match *kind {
            Self::FRAME => Event::Frame(Frame { id, payload }),
            Self::BAD_CHECKSUM => Event::BadChecksum { id, size },
            _ => Event::Oversize { id, size },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_protocol::FrameEncoder;

    const TIMEOUT_MS: u16 = 500;

    fn on_can() -> Deframer {
        Deframer::new(PortKind::Can, &Config { frame_timeout_ms: TIMEOUT_MS, ..Config::default() })
    }

    fn frame(id: u8, payload: &[u8]) -> heapless::Vec<u8, 64> {
        FrameEncoder::new(id, payload).collect()
    }

    /// Returns the ids of the frames found in these bytes.
    fn take(deframer: &mut Deframer, bytes: &[u8]) -> heapless::Vec<u8, 16> {
        let mut ids = heapless::Vec::new();
        let mut rest = bytes;
        loop {
            let (taken, event) = deframer.push_slice(Time::ZERO, rest);
            rest = &rest[taken..];
            match event {
                Some(Event::Frame(frame)) => ids.push(frame.id).unwrap(),
                Some(_) => {}
                None if rest.is_empty() => return ids,
                None => {}
            }
        }
    }

    fn ids_at(deframer: &mut Deframer, now: Time) -> heapless::Vec<u8, 16> {
        let mut ids = heapless::Vec::new();
        while let Some(event) = deframer.expire(now) {
            if let Event::Frame(frame) = event {
                ids.push(frame.id).unwrap();
            }
        }
        ids
    }

    /// Returns the bytes received around a lost CAN frame: the start of a message without its rest, and complete messages.
    fn held_back() -> (heapless::Vec<u8, 64>, [heapless::Vec<u8, 64>; 2]) {
        let mut beginning = frame(0x06, &[7; 40]);
        beginning.truncate(FULL);
        (beginning, [frame(0x22, &[]), frame(0x40, &[0, 0, 0])])
    }

    #[test]
    fn messages_after_a_lost_can_frame_are_recovered() {
        let mut deframer = on_can();
        let (beginning, [stop, state]) = held_back();
        for bytes in [&beginning, &stop] {
            assert!(take(&mut deframer, bytes).is_empty());
        }
        // The second CAN frame is short, which the message in progress cannot have at that position.
        assert_eq!(take(&mut deframer, &state), [0x22, 0x40]);
    }

    #[test]
    fn incomplete_can_message_releases_the_frames_it_held() {
        let mut deframer = on_can();
        let (beginning, [stop, _]) = held_back();
        for bytes in [&beginning, &stop, &stop] {
            assert!(take(&mut deframer, bytes).is_empty());
        }
        deframer.pause(Time::ZERO);
        let due = deframer.due().unwrap();
        assert_eq!(due, Time::from_millis(TIMEOUT_MS.into()));
        assert_eq!(ids_at(&mut deframer, due), [0x22, 0x22]);
        assert_eq!(deframer.due(), None);
    }

    #[test]
    fn message_over_can_that_is_cut_otherwise_is_none() {
        let mut deframer = on_can();
        let message = frame(0x40, &[0, 0, 0]);
        for cut in 1..message.len() {
            let (one, other) = message.split_at(cut);
            let ids = [take(&mut deframer, one), take(&mut deframer, other)].concat();
            assert_eq!(ids.is_empty(), cut != FULL, "{cut}");
            // A complete message after it is always found.
            take(&mut deframer, &frame(0x22, &[]));
            deframer.pause(Time::ZERO);
            ids_at(&mut deframer, Time::from_millis(TIMEOUT_MS.into()));
        }
    }
}
