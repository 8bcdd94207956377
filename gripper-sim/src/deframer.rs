//! From the bytes of one client to frames: the protocol's parser, with the time that half a frame is waited for.
//!
//! Where checksums are not evaluated their two bytes must be there all the same (command set, 1.4.1). A client that leaves
//! them out loses the first two bytes of its next frame to them, as at the real gripper.

use crate::time::Time;
use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD};
use wsg_protocol::{Event, FrameCounters, FrameParser};

/// The most payload in a frame that is taken.
const MAX_PAYLOAD: usize = MAX_MESSAGE_LEN - OVERHEAD;

/// Finds the frames in what one client sends.
#[derive(Clone, Debug)]
pub(crate) struct Deframer {
    parser: FrameParser<MAX_PAYLOAD>,
    timeout_ms: u16,
    /// When what is held of a frame is given up.
    due: Option<Time>,
}

impl Deframer {
    pub(crate) const fn new(check_checksum: bool, timeout_ms: u16) -> Self {
        let parser = if check_checksum { FrameParser::new() } else { FrameParser::ignoring_checksums() };
        Self { parser, timeout_ms, due: None }
    }

    pub(crate) const fn counters(&self) -> FrameCounters {
        self.parser.counters()
    }

    /// Takes bytes up to the first event, or some of them; how many: none where the event is about bytes that came before.
    /// When none are left and there is no event, all is told: call [`pause`](Self::pause) then.
    pub(crate) fn push_slice(&mut self, bytes: &[u8]) -> (usize, Option<Event<'_>>) {
        self.parser.push_slice(bytes)
    }

    /// No more bytes for now. When those so far were a datagram, none of its frames goes on in the next one.
    pub(crate) fn pause(&mut self, now: Time, is_datagram: bool) {
        let wait_ms = if is_datagram { 0 } else { self.timeout_ms };
        self.due = self.parser.is_mid_frame().then(|| now.plus_millis(wait_ms.into()));
    }

    /// When [`expire`](Self::expire) is to be called next.
    pub(crate) const fn due(&self) -> Option<Time> {
        self.due
    }

    /// Gives up the frame whose rest has not come by `now`, and scans what it held again. Call until it gives `None`.
    pub(crate) fn expire(&mut self, now: Time) -> Option<Event<'_>> {
        if self.due.is_none_or(|due| due > now) {
            return None;
        }
        let event = self.parser.expire();
        if event.is_none() {
            self.due = None;
        }
        event
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_protocol::FrameEncoder;

    const TIMEOUT_MS: u16 = 500;

    fn unchecked() -> Deframer {
        Deframer::new(false, TIMEOUT_MS)
    }

    /// A frame, and how many bytes of its checksum are left.
    fn frame(id: u8, payload: &[u8], checksum: usize) -> heapless::Vec<u8, 64> {
        let mut frame: heapless::Vec<u8, 64> = FrameEncoder::new(id, payload).collect();
        frame.truncate(frame.len() - 2 + checksum);
        frame
    }

    /// The ids of the frames found in these bytes.
    fn take(deframer: &mut Deframer, bytes: &[u8]) -> heapless::Vec<u8, 16> {
        let mut ids = heapless::Vec::new();
        let mut rest = bytes;
        loop {
            let (taken, event) = deframer.push_slice(rest);
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

    #[test]
    fn checksum_that_is_left_out_is_taken_from_the_next_frame() {
        let mut deframer = unchecked();
        let segment = [frame(0x24, b"ack", 0), frame(0x40, &[0, 0, 0], 0), frame(0x22, &[], 2)].concat();
        // Two bytes of the second one's preamble are the first one's checksum, so it is none; the third one is whole.
        assert_eq!(take(&mut deframer, &segment), [0x24, 0x22]);
        deframer.pause(Time::ZERO, false);
        assert_eq!(deframer.due(), None);
    }

    #[test]
    fn frame_that_lacks_a_byte_of_its_checksum_or_payload_waits_and_is_given_up() {
        for lacking in
            [&frame(0x22, &[], 0)[..], &frame(0x22, &[], 1)[..], &[0xAA, 0xAA, 0xAA, 0x24, 3, 0, b'a', b'c']]
        {
            let mut deframer = unchecked();
            assert!(take(&mut deframer, lacking).is_empty());
            deframer.pause(Time::ZERO, false);
            assert_eq!(deframer.due(), Some(Time::from_millis(TIMEOUT_MS.into())));
            assert!(ids_at(&mut deframer, Time::from_millis(TIMEOUT_MS.into())).is_empty());
            assert_eq!(deframer.due(), None);
            assert_eq!(take(&mut deframer, &frame(0x22, &[], 2)), [0x22]);
        }
    }

    #[test]
    fn preamble_inside_a_payload_is_payload() {
        let mut deframer = unchecked();
        let payload = [0xAA, 0xAA, 0xAA, 0x22, 0, 0, 7, 7];
        assert_eq!(take(&mut deframer, &frame(0x06, &payload, 2)), [0x06]);
    }

    #[test]
    fn frames_with_any_checksum_are_taken_when_nobody_checks() {
        let mut deframer = unchecked();
        let mut zero = frame(0x22, &[], 0);
        zero.extend_from_slice(&[0, 0]).unwrap();
        assert_eq!(take(&mut deframer, &[zero.clone(), zero].concat()), [0x22, 0x22]);
        deframer.pause(Time::ZERO, false);
        assert_eq!(deframer.due(), None);
    }

    #[test]
    fn frame_without_a_checksum_is_refused_where_checksums_count() {
        let mut deframer = Deframer::new(true, TIMEOUT_MS);
        let segment = [frame(0x22, &[], 0), frame(0x24, b"ack", 2)].concat();
        assert_eq!(take(&mut deframer, &segment), [0x24]);
        assert!(take(&mut deframer, &frame(0x22, &[], 0)).is_empty());
        deframer.pause(Time::ZERO, false);
        assert_eq!(deframer.due(), Some(Time::from_millis(TIMEOUT_MS.into())));
        assert!(ids_at(&mut deframer, Time::from_millis(TIMEOUT_MS.into())).is_empty());
    }
}
