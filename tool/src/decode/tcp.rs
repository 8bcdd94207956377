//! One direction of a TCP connection: bytes in the order in which they were sent, whatever order the capture has.

use std::collections::BTreeMap;

/// The most that is held behind a gap. A receiver's window is smaller, so what is missing does not come any more.
const MAX_HELD: usize = 1 << 20;

/// A run of bytes without a gap.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Stretch {
    /// Offset of the first byte in the stream.
    pub(crate) offset: u64,
    pub(crate) bytes: Vec<u8>,
    /// From which byte on they came with which packet.
    pub(crate) packets: Vec<(usize, usize)>,
    /// Bytes of the stream before it that the capture does not have.
    pub(crate) missing_before: u64,
}

impl Stretch {
    /// The packet that a byte came with.
    pub(crate) fn packet_of(&self, at: usize) -> usize {
        let behind = self.packets.partition_point(|(start, _)| *start <= at);
        self.packets.get(behind.saturating_sub(1)).map_or(0, |(_, packet)| *packet)
    }
}

/// A direction that is being put together.
#[derive(Debug, Default)]
pub(crate) struct Stream {
    /// The sequence number that is wanted next, counted on over the wrap; `None` before the first packet.
    next: Option<i64>,
    /// That of the first byte.
    first: i64,
    /// Segments that came before those in front of them: packet and bytes, by their sequence numbers.
    held: BTreeMap<i64, (usize, Vec<u8>)>,
    held_len: usize,
    stretches: Vec<Stretch>,
    /// Segments that brought nothing new.
    pub(crate) repeated: usize,
}

impl Stream {
    /// A segment with SYN: its first byte has the next number.
    pub(crate) fn start(&mut self, sequence: u32) {
        let first = self.place(sequence.wrapping_add(1));
        self.begin(first);
    }

    /// A segment with payload.
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

    /// All of it, and whatever waits behind gaps.
    pub(crate) fn finish(mut self) -> Vec<Stretch> {
        while !self.held.is_empty() {
            self.skip_gap();
        }
        self.stretches
    }

    /// The number without its wrap: nearest to the one that is wanted.
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

    /// Goes on with what is held first, though bytes before it are missing.
    fn skip_gap(&mut self) {
        let (Some(next), Some(start)) = (self.next, self.held.keys().next().copied()) else { return };
        if start > next {
            let (offset, missing_before) = ((start - self.first) as u64, (start - next) as u64);
            self.stretches.push(Stretch { offset, missing_before, ..Stretch::default() });
            self.next = Some(start);
        }
        self.take_held();
    }

    /// Takes what is held as far as there is no gap.
    fn take_held(&mut self) {
        while let (Some(next), Some(entry)) = (self.next, self.held.first_entry()) {
            let start = *entry.key();
            if start > next {
                return;
            }
            let (packet, bytes) = entry.remove();
            self.held_len -= bytes.len();
            // Its beginning may have come with another one.
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
    fn gap_is_told_once_nothing_can_fill_it_and_the_stream_goes_on() {
        let mut stream = Stream::default();
        stream.start(u32::MAX - 3);
        stream.receive(1, u32::MAX - 2, b"ab");
        // Two bytes are missing, over the wrap of the numbers.
        stream.receive(2, 1, b"ef");
        assert_eq!(bytes(&stream.stretches), [(0, 0, &b"ab"[..])], "they may still come");
        let stretches = stream.finish();
        assert_eq!(bytes(&stretches), [(0, 0, &b"ab"[..]), (2, 4, &b"ef"[..])]);
        assert_eq!((stretches[0].packet_of(1), stretches[1].packet_of(0)), (1, 2));
    }

    #[test]
    fn no_more_is_held_behind_a_gap_than_a_receiver_has_room_for() {
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
    fn capture_that_begins_late_begins_with_its_first_segment() {
        let mut stream = Stream::default();
        stream.receive(1, 1_000, b"abc");
        stream.receive(2, 999, b"x");
        assert_eq!((stream.repeated, bytes(&stream.finish())), (1, vec![(0, 0, &b"abc"[..])]));
    }

    proptest! {
        #[test]
        fn segments_in_any_order_doubled_and_overlapping_give_the_stream(
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
