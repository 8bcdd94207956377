//! TCP stream reassembly: restores the order in which one side of a connection sent its bytes.

use std::collections::BTreeMap;

/// Maximum number of bytes held after a gap. A receive window is smaller, so the missing bytes will not follow any more.
const MAX_HELD: usize = 1 << 20;

/// A contiguous run of bytes.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Stretch {
    /// Offset of the first byte in the stream.
    pub(crate) offset: u64,
    pub(crate) bytes: Vec<u8>,
    /// Index of the first byte of each packet, and the packet.
    pub(crate) packets: Vec<(usize, usize)>,
    /// Number of bytes before this run that are missing from the capture.
    pub(crate) missing_before: u64,
}

impl Stretch {
    /// Returns the packet that carried a byte.
    pub(crate) fn packet_of(&self, at: usize) -> usize {
        let after = self.packets.partition_point(|(start, _)| *start <= at);
        self.packets.get(after.saturating_sub(1)).map_or(0, |(_, packet)| *packet)
    }
}

/// Reassembles one direction of a connection.
#[derive(Debug, Default)]
pub(crate) struct Stream {
    /// The next expected sequence number, extended beyond 32 bits; `None` before the first packet.
    next: Option<i64>,
    /// Sequence number of the first byte.
    first: i64,
    /// Out-of-order segments by sequence number: packet and bytes.
    held: BTreeMap<i64, (usize, Vec<u8>)>,
    held_len: usize,
    stretches: Vec<Stretch>,
    /// Number of segments without new bytes, such as retransmissions.
    pub(crate) repeated: usize,
}

impl Stream {
    /// Processes a SYN segment. Its payload starts at the next sequence number.
    pub(crate) fn start(&mut self, sequence: u32) {
        let first = self.place(sequence.wrapping_add(1));
        self.begin(first);
    }

    /// Processes a segment with payload.
    pub(crate) fn receive(&mut self, packet: usize, sequence: u32, payload: &[u8]) {
        let start = self.place(sequence);
        self.begin(start);
        let next = self.next.unwrap_or(start);
        if start.saturating_add_unsigned(payload.len() as u64) <= next {
            self.repeated += 1;
            return;
        }
        match self.held.get(&start) {
            Some((_, held)) if held.len() >= payload.len() => self.repeated += 1,
            _ => {
                self.held_len += payload.len();
                self.held.insert(start, (packet, payload.to_vec()));
            }
        }
        self.take_held();
        if self.held_len > MAX_HELD {
            self.skip_gap();
        }
    }

    /// Returns all bytes, including those held after gaps.
    pub(crate) fn finish(mut self) -> Vec<Stretch> {
        while !self.held.is_empty() {
            self.skip_gap();
        }
        self.stretches
    }

    /// Extends a sequence number beyond 32 bits, to the value nearest to the expected one.
    fn place(&self, sequence: u32) -> i64 {
        let next = self.next.unwrap_or(i64::from(sequence));
        next.saturating_add(i64::from(sequence.wrapping_sub(next as u32) as i32))
    }

    fn begin(&mut self, first: i64) {
        if self.next.is_none() {
            self.next = Some(first);
            self.first = first;
        }
    }

    /// Gives up the missing bytes and continues with the first held segment.
    fn skip_gap(&mut self) {
        let (Some(next), Some(start)) = (self.next, self.held.keys().next().copied()) else { return };
        if start > next {
            let (offset, missing_before) = ((start - self.first) as u64, (start - next) as u64);
            self.stretches.push(Stretch { offset, missing_before, ..Stretch::default() });
            self.next = Some(start);
        }
        self.take_held();
    }

    /// Appends held segments up to the next gap.
    fn take_held(&mut self) {
        while let (Some(next), Some(entry)) = (self.next, self.held.first_entry()) {
            let start = *entry.key();
            if start > next {
                return;
            }
            let (packet, bytes) = entry.remove();
            self.held_len -= bytes.len();
            // Another segment may already have supplied its beginning.
            let Some(new) = usize::try_from(next - start).ok().and_then(|known| bytes.get(known..)) else {
                continue;
            };
            if new.is_empty() {
                continue;
            }
            if self.stretches.is_empty() {
                self.stretches.push(Stretch::default());
            }
            if let Some(stretch) = self.stretches.last_mut() {
                stretch.packets.push((stretch.bytes.len(), packet));
                stretch.bytes.extend_from_slice(new);
            }
            self.next = Some(next + new.len() as i64);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bytes(stretches: &[Stretch]) -> Vec<(u64, u64, &[u8])> {
        stretches.iter().map(|it| (it.missing_before, it.offset, it.bytes.as_slice())).collect()
    }

    #[test]
    fn gap_is_reported_once_nothing_can_fill_it_and_the_stream_continues() {
        let mut stream = Stream::default();
        stream.start(u32::MAX - 3);
        stream.receive(1, u32::MAX - 2, b"ab");
        // Two bytes are missing at the wraparound of the sequence numbers.
        stream.receive(2, 1, b"ef");
        assert_eq!(bytes(&stream.stretches), [(0, 0, &b"ab"[..])], "the missing bytes may still follow");
        let stretches = stream.finish();
        assert_eq!(bytes(&stretches), [(0, 0, &b"ab"[..]), (2, 4, &b"ef"[..])]);
        assert_eq!((stretches[0].packet_of(1), stretches[1].packet_of(0)), (1, 2));
    }

    #[test]
    fn bytes_held_after_a_gap_are_limited_to_a_receive_window() {
        let mut stream = Stream::default();
        stream.start(0);
        let payload = vec![7; MAX_HELD / 2];
        for number in 0..3 {
            stream.receive(number, 3 + (number * payload.len()) as u32, &payload);
        }
        assert_eq!((stream.held_len, stream.held.len()), (0, 0));
        let gaps: Vec<_> = stream.finish().iter().map(|it| (it.missing_before, it.bytes.len())).collect();
        assert_eq!(gaps, [(2, 3 * payload.len())]);
    }

    #[test]
    fn capture_that_starts_late_starts_with_its_first_segment() {
        let mut stream = Stream::default();
        stream.receive(1, 1_000, b"abc");
        stream.receive(2, 999, b"x");
        assert_eq!((stream.repeated, bytes(&stream.finish())), (1, vec![(0, 0, &b"abc"[..])]));
    }

    proptest! {
        #[test]
        fn reordered_duplicated_and_overlapping_segments_restore_the_stream(
            first in any::<u32>(),
            cuts in prop::collection::vec((0..200usize, 1..40usize), 1..60),
            order in any::<prop::sample::Index>(),
        ) {
            let whole: Vec<u8> = (0..240u8).collect();
            let mut segments: Vec<(usize, usize)> = (0..240).step_by(16).map(|at| (at, 16)).collect();
            segments.extend(cuts);
            let turn = order.index(segments.len());
            segments.rotate_left(turn);
            let mut stream = Stream::default();
            stream.start(first.wrapping_sub(1));
            for (packet, (at, len)) in segments.iter().enumerate() {
                let end = (at + len).min(240);
                stream.receive(packet, first.wrapping_add(*at as u32), &whole[*at..end]);
            }
            let stretches = stream.finish();
            prop_assert_eq!(bytes(&stretches), vec![(0, 0, whole.as_slice())]);
        }
    }
}
