//! A faulty line from one client to the gripper: received bytes are split into frames, and each frame gets a fate.
//!
//! Frames are split by their lengths alone, so a request that is invalid in itself passes unchanged. Independent of
//! sockets and clocks.

use super::faulty_line::{Fate, FaultyLine, LineFaults};
use crate::port::{PortKind, Protocol};
use crate::time::Time;
use bus_modbus::tcp;
use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};

/// Time-out for the rest of a frame while nothing else is in transit; afterwards its bytes pass unchanged. It is long,
/// so that a busy machine does not affect the framing.
const REST_WAIT_MS: u64 = 1_000;
/// The longest line of the text protocol that is recognized as one.
const MAX_LINE_LEN: usize = 512;

/// The line from one client.
#[derive(Debug)]
pub(crate) struct RequestLine {
    kind: PortKind,
    /// Bytes of the incomplete frame.
    held: Vec<u8>,
    /// When the time-out of its rest expires.
    due: Option<Time>,
    line: FaultyLine,
}

/// The kind of data at the start of the received bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cut {
    /// A complete frame of this length.
    Frame(usize),
    /// Number of bytes that belong to no frame.
    Other(usize),
    /// The start of an incomplete frame.
    Part,
}

impl RequestLine {
    /// Returns the line of the connection with this number.
    pub(crate) const fn new(kind: PortKind, seed: u64, connection: u64) -> Self {
        // Other random numbers than the replies use.
        let line = FaultyLine::new(seed, !connection);
        Self { kind, held: Vec::new(), due: None, line }
    }

    /// Returns whether nothing is in transit, so that the line may be bypassed.
    pub(crate) fn is_empty(&self) -> bool {
        self.held.is_empty() && self.line.next_arrival().is_none()
    }

    /// Returns whether the line accepts more from a client with flow control.
    pub(crate) fn has_room(&self) -> bool {
        self.line.has_room()
    }

    /// Takes bytes from the client and passes the fate of each frame to `report`. Bytes without room are lost.
    pub(crate) fn take(
        &mut self,
        faults: &LineFaults,
        now: Time,
        bytes: &[u8],
        mut report: impl FnMut(&Fate),
    ) {
        if self.kind.is_datagram() || self.kind == PortKind::Can {
            // Faults hit whole datagrams, or single CAN frames.
            return self.pass(faults, now, bytes, &mut report);
        }
        let mut all = std::mem::take(&mut self.held);
        all.extend_from_slice(bytes);
        let mut rest = &all[..];
        while !rest.is_empty() {
            match cut(self.kind.protocol(), rest) {
                Cut::Frame(len) => {
                    let (frame, following) = rest.split_at(len);
                    self.pass(faults, now, frame, &mut report);
                    rest = following;
                }
                Cut::Other(len) => {
                    let (other, following) = rest.split_at(len);
                    self.let_by(now, other);
                    rest = following;
                }
                // A line without faults does not wait for the rest.
                Cut::Part if faults.are_none() => {
                    self.let_by(now, rest);
                    rest = &[];
                }
                Cut::Part => break,
            }
        }
        self.held = rest.to_vec();
        self.due = (!rest.is_empty()).then(|| now.plus_millis(REST_WAIT_MS));
    }

    /// Returns the next bytes that have reached the gripper by `now`.
    pub(crate) fn arrive(&mut self, now: Time) -> Option<Vec<u8>> {
        if let Some(bytes) = self.line.arrive(now) {
            // The rest could not arrive while the line was full.
            self.due = self.due.map(|_| now.plus_millis(REST_WAIT_MS));
            return Some(bytes);
        }
        if self.line.next_arrival().is_some() || self.due.is_none_or(|due| due > now) {
            return None;
        }
        self.due = None;
        Some(std::mem::take(&mut self.held))
    }

    /// Returns when the next bytes reach the gripper.
    pub(crate) fn next_arrival(&self) -> Option<Time> {
        self.line.next_arrival().or(self.due)
    }

    /// Passes bytes that are not a frame and get no fate.
    fn let_by(&mut self, now: Time, bytes: &[u8]) {
        if !self.line.is_full() {
            self.line.hold(&Fate::default(), now, bytes);
        }
    }

    fn pass(&mut self, faults: &LineFaults, now: Time, frame: &[u8], report: &mut impl FnMut(&Fate)) {
        let drawn = self.line.fate(faults, frame.len());
        let fate = if self.line.is_full() { Fate { dropped: true, ..Fate::default() } } else { drawn };
        self.line.hold(&fate, now, frame);
        report(&fate);
    }
}

/// Classifies the start of `bytes`, which must not be empty.
fn cut(protocol: Protocol, bytes: &[u8]) -> Cut {
    let len = match protocol {
        Protocol::Binary => {
            let preamble = bytes.iter().take(PREAMBLE_LEN).take_while(|byte| **byte == PREAMBLE_BYTE).count();
            let is_preamble = preamble == bytes.len().min(PREAMBLE_LEN);
            let len = match *bytes {
                [_, _, _, _, low, high, ..] => OVERHEAD + usize::from(u16::from_le_bytes([low, high])),
                _ if is_preamble => return Cut::Part,
                _ => 0,
            };
            if !is_preamble || len > MAX_MESSAGE_LEN {
                // Up to the possible start of the next frame.
                let following = bytes.iter().skip(preamble.max(1));
                let noise = following.take_while(|byte| **byte != PREAMBLE_BYTE).count();
                return Cut::Other(preamble.max(1) + noise);
            }
            len
        }
        Protocol::Text => match bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r')) {
            // The second half of CR LF, or an empty line.
            Some(0) => return Cut::Other(1),
            Some(end) => end + 1,
            None if bytes.len() > MAX_LINE_LEN => return Cut::Other(bytes.len()),
            None => return Cut::Part,
        },
        Protocol::Modbus => {
            let [_, _, _, _, high, low, ..] = *bytes else { return Cut::Part };
            let len = tcp::HEADER_LEN - 1 + usize::from(u16::from_be_bytes([high, low]));
            if !(tcp::HEADER_LEN + 1..=tcp::MAX_FRAME_LEN).contains(&len) {
                return Cut::Other(bytes.len());
            }
            len
        }
        Protocol::Images => bytes.len(),
        Protocol::Profibus => match *bytes {
            [0xE5, ..] => 1,
            [0xDC, ..] => 3,
            [0x10, ..] => 6,
            [0xA2, ..] => 14,
            [0x68, len, ..] => usize::from(len) + 6,
            [0x68] => return Cut::Part,
            _ => return Cut::Other(bytes.len()),
        },
    };
    if len <= bytes.len() { Cut::Frame(len) } else { Cut::Part }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STOP: [u8; 8] = [0xAA, 0xAA, 0xAA, 0x22, 0, 0, 0xD3, 0x5A];
    const READ: [u8; 12] = [0, 1, 0, 0, 0, 6, 1, 3, 0, 0, 0, 1];

    fn late() -> LineFaults {
        LineFaults { delay: 1.0, delay_ms: 10, ..LineFaults::default() }
    }

    fn arrivals(line: &mut RequestLine, now: Time) -> Vec<Vec<u8>> {
        std::iter::from_fn(|| line.arrive(now)).collect()
    }

    /// Returns the pieces in which bytes arrive that are all delayed.
    fn pieces(kind: PortKind, bytes: &[u8]) -> (Vec<Vec<u8>>, usize) {
        let mut line = RequestLine::new(kind, 1, 0);
        let mut frames = 0;
        line.take(&late(), Time::ZERO, bytes, |_| frames += 1);
        (arrivals(&mut line, Time::from_millis(10)), frames)
    }

    #[test]
    fn frames_are_split_by_length_and_other_bytes_pass() {
        let noisy = [&[0x01, 0xAA, 0x02][..], &STOP, &STOP, &[0xAA]].concat();
        let (arrived, frames) = pieces(PortKind::Tcp, &noisy);
        assert_eq!(frames, 2);
        assert_eq!(
            arrived.concat(),
            noisy[..noisy.len() - 1],
            "in order, and the last byte may begin a frame"
        );
        assert_eq!(pieces(PortKind::ModbusTcp, &READ.repeat(3)), (vec![READ.to_vec(); 3], 3));
        let lines = b"POS?\r\nSPEED?\nhalf";
        assert_eq!(
            pieces(PortKind::GclTcp, lines),
            (vec![b"POS?\r".to_vec(), b"\n".to_vec(), b"SPEED?\n".to_vec()], 2)
        );
        assert_eq!(
            pieces(PortKind::Udp, &STOP.repeat(2)),
            (vec![STOP.repeat(2)], 1),
            "a datagram counts as one frame"
        );
    }

    #[test]
    fn lengths_that_no_frame_has_pass() {
        for (kind, bytes) in [
            (PortKind::Tcp, vec![0xAA, 0xAA, 0xAA, 0x22, 0xFF, 0xFF, 1, 2]),
            (PortKind::ModbusTcp, vec![0, 1, 0, 0, 0, 1, 9]),
            (PortKind::GclTcp, vec![b'x'; MAX_LINE_LEN + 1]),
        ] {
            let (arrived, frames) = pieces(kind, &bytes);
            assert_eq!((arrived.concat(), frames), (bytes, 0), "{kind}");
        }
    }

    #[test]
    fn every_cut_of_the_stream_gives_the_same_frames() {
        let stream = [&STOP[..], &[7, 7], &STOP].concat();
        for at in 0..stream.len() {
            let mut line = RequestLine::new(PortKind::Serial, 1, 0);
            let mut frames = 0;
            for piece in [&stream[..at], &stream[at..]] {
                line.take(&late(), Time::ZERO, piece, |_| frames += 1);
            }
            assert_eq!(frames, 2, "{at}");
            assert_eq!(arrivals(&mut line, Time::from_millis(10)).concat(), stream, "{at}");
        }
    }

    #[test]
    fn partial_frame_passes_after_a_time_out_or_without_faults() {
        let mut line = RequestLine::new(PortKind::Tcp, 1, 0);
        line.take(&late(), Time::ZERO, &STOP[..5], |_| panic!("no frame"));
        assert_eq!(line.next_arrival(), Some(Time::from_millis(REST_WAIT_MS)));
        assert_eq!(arrivals(&mut line, Time::from_millis(REST_WAIT_MS)), [&STOP[..5]]);
        assert!(line.is_empty());
        line.take(&late(), Time::ZERO, &STOP[..5], |_| panic!("no frame"));
        line.take(&LineFaults::default(), Time::ZERO, &STOP[5..7], |_| panic!("no frame"));
        assert_eq!(arrivals(&mut line, Time::ZERO), [&STOP[..7]]);
        assert!(line.is_empty());
    }

    #[test]
    fn flood_on_a_line_without_flow_control_is_bounded() {
        let mut line = RequestLine::new(PortKind::Udp, 1, 0);
        let mut lost = 0;
        for _ in 0..10_000 {
            line.take(&late(), Time::ZERO, &STOP, |fate| lost += u32::from(fate.dropped));
        }
        let arrived = arrivals(&mut line, Time::from_millis(10)).len();
        assert!(arrived < 1_000 && arrived + lost as usize == 10_000, "{arrived} and {lost}");
    }
}
