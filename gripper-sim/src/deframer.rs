//! From the bytes of one client to frames: the protocol's parser, with the time that half a frame is waited for, and with
//! clients that send no checksum at all.
//!
//! Where checksums are not evaluated (command set, 1.4.1), clients in the field leave the two bytes out. A parser that
//! waits for them would take the first two of the next frame. So a frame that is whole but for its checksum is taken
//! when the next preamble follows at once, when its datagram ends, or when nothing comes for [`CHECKSUM_WAIT_MS`].

use crate::time::Time;
use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};
use wsg_protocol::{Event, FrameCounters, FrameParser};

/// The most payload in a frame that is taken.
const MAX_PAYLOAD: usize = MAX_MESSAGE_LEN - OVERHEAD;
/// Bytes of a checksum.
const CHECKSUM_LEN: usize = 2;
/// How long a frame that lacks only its checksum waits for it. Assumed: longer than a serial adapter holds bytes back.
const CHECKSUM_WAIT_MS: u64 = 20;

/// Finds the frames in what one client sends.
#[derive(Clone, Debug)]
pub(crate) struct Deframer {
    parser: FrameParser<MAX_PAYLOAD>,
    check_checksum: bool,
    timeout_ms: u16,
    /// When what is held of a frame is given up, or taken without its checksum.
    due: Option<Time>,
}

impl Deframer {
    pub(crate) const fn new(check_checksum: bool, timeout_ms: u16) -> Self {
        let parser = if check_checksum { FrameParser::new() } else { FrameParser::ignoring_checksums() };
        Self { parser, check_checksum, timeout_ms, due: None }
    }

    pub(crate) const fn counters(&self) -> FrameCounters {
        self.parser.counters()
    }

    /// Takes bytes up to the first event, or some of them; how many. When none are left and there is no event, all is
    /// told: call [`pause`](Self::pause) then.
    pub(crate) fn push_slice(&mut self, bytes: &[u8]) -> (usize, Option<Event<'_>>) {
        if self.check_checksum {
            return self.parser.push_slice(bytes);
        }
        if opens_a_frame(bytes) && self.missing_checksum() == Some(CHECKSUM_LEN) {
            return (0, self.complete(CHECKSUM_LEN));
        }
        let stretch = (1..bytes.len()).find(|at| opens_a_frame(bytes.get(*at..).unwrap_or(&[])));
        self.parser.push_slice(bytes.get(..stretch.unwrap_or(bytes.len())).unwrap_or(&[]))
    }

    /// No more bytes for now. When those so far were a datagram, none of its frames goes on in the next one.
    pub(crate) fn pause(&mut self, now: Time, is_datagram: bool) {
        let wait_ms = if is_datagram {
            0
        } else if !self.check_checksum && self.missing_checksum().is_some() {
            CHECKSUM_WAIT_MS.min(self.timeout_ms.into())
        } else {
            self.timeout_ms.into()
        };
        self.due = self.parser.is_mid_frame().then(|| now.plus_millis(wait_ms));
    }

    /// When [`expire`](Self::expire) is to be called next.
    pub(crate) const fn due(&self) -> Option<Time> {
        self.due
    }

    /// Gives up the frame whose rest has not come by `now`, and scans what it held again; or takes it if all but its
    /// checksum has come and nobody checks that. Call until it gives `None`.
    pub(crate) fn expire(&mut self, now: Time) -> Option<Event<'_>> {
        if self.due.is_none_or(|due| due > now) {
            return None;
        }
        if !self.check_checksum
            && let Some(missing) = self.missing_checksum()
        {
            return self.complete(missing);
        }
        let event = self.parser.expire();
        if event.is_none() {
            self.due = None;
        }
        event
    }

    /// How many bytes of its checksum the frame being received lacks, when it lacks nothing else.
    fn missing_checksum(&self) -> Option<usize> {
        let mut probe = self.parser.clone();
        // Otherwise there is more to tell about bytes that came before.
        let is_settled = probe.poll().is_none();
        (is_settled && probe.is_mid_frame())
            .then(|| (1..=CHECKSUM_LEN).find(|_| matches!(probe.push(0), Some(Event::Frame(_)))))
            .flatten()
    }

    /// The frame being received, with bytes that nobody looks at in place of its checksum.
    fn complete(&mut self, missing: usize) -> Option<Event<'_>> {
        let [zeros @ .., last] = [0; CHECKSUM_LEN].get(..missing)? else { return None };
        for zero in zeros {
            // The probe has shown that these lead to no event.
            let _ = self.parser.push(*zero);
        }
        self.parser.push(*last)
    }
}

/// Whether these bytes begin a frame for certain. A fourth AAh leaves open where the preamble begins: a checksum of
/// AAAAh may stand before it.
fn opens_a_frame(bytes: &[u8]) -> bool {
    let (Some(preamble), Some(id)) = (bytes.get(..PREAMBLE_LEN), bytes.get(PREAMBLE_LEN)) else {
        return false;
    };
    preamble.iter().all(|byte| *byte == PREAMBLE_BYTE) && *id != PREAMBLE_BYTE
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
        frame.truncate(frame.len() - CHECKSUM_LEN + checksum);
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
    fn frames_without_a_checksum_in_one_segment_are_all_taken() {
        let mut deframer = unchecked();
        let segment = [frame(0x24, b"ack", 0), frame(0x40, &[0, 0, 0], 0), frame(0x22, &[], 0)].concat();
        assert_eq!(take(&mut deframer, &segment), [0x24, 0x40]);
        deframer.pause(Time::ZERO, false);
        assert_eq!(deframer.due(), Some(Time::from_millis(CHECKSUM_WAIT_MS)));
        assert!(ids_at(&mut deframer, Time::from_millis(CHECKSUM_WAIT_MS - 1)).is_empty());
        assert_eq!(ids_at(&mut deframer, Time::from_millis(CHECKSUM_WAIT_MS)), [0x22]);
        assert_eq!(deframer.due(), None);
    }

    #[test]
    fn frame_that_lacks_one_byte_of_its_checksum_is_taken_when_nothing_follows() {
        let mut deframer = unchecked();
        assert!(take(&mut deframer, &frame(0x22, &[], 1)).is_empty());
        deframer.pause(Time::ZERO, false);
        assert_eq!(ids_at(&mut deframer, Time::from_millis(CHECKSUM_WAIT_MS)), [0x22]);
        assert_eq!(take(&mut deframer, &frame(0x24, b"ack", 2)), [0x24]);
    }

    #[test]
    fn frame_that_lacks_payload_is_given_up_at_its_own_time() {
        let mut deframer = unchecked();
        assert!(take(&mut deframer, &[0xAA, 0xAA, 0xAA, 0x24, 3, 0, b'a', b'c']).is_empty());
        deframer.pause(Time::ZERO, false);
        assert_eq!(deframer.due(), Some(Time::from_millis(TIMEOUT_MS.into())));
        assert!(ids_at(&mut deframer, Time::from_millis(TIMEOUT_MS.into())).is_empty());
        assert_eq!(deframer.due(), None);
        assert_eq!(take(&mut deframer, &frame(0x22, &[], 2)), [0x22]);
    }

    #[test]
    fn checksum_of_aaaah_is_no_part_of_a_preamble() {
        let mut deframer = unchecked();
        let mut first = frame(0x22, &[], 0);
        first.extend_from_slice(&[0xAA, 0xAA]).unwrap();
        assert_eq!(take(&mut deframer, &[first, frame(0x23, &[], 2)].concat()), [0x22, 0x23]);
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
