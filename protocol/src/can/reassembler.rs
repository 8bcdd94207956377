//! Reassembles intact messages from CAN frames.
//!
//! The rule is the same as for the byte parser. The reassembler tries a message at the first CAN frame. If the message
//! proves false, it retries one CAN frame later and never skips the frames of the false message.

use embedded_can::{Frame as CanFrame, Id, StandardId};

use super::FULL;
use crate::checksum;
use crate::frame::{Event, Frame, OVERHEAD, PREAMBLE_BYTE};
use crate::time::Instant;

/// Default time-out for the next CAN frame of an incomplete message, in milliseconds. It covers a 125 kbit/s bus with
/// 40 frames of other traffic in between.
pub const HALF_MESSAGE_MS: u32 = 50;

/// Counters of rejected input. Each counter saturates at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct ReassemblerCounters {
    /// CAN frames that cannot be part of a message to this side: other identifiers, remote frames, no data or more than
    /// 8 bytes.
    pub foreign: u16,
    /// CAN frames that were not part of an intact message.
    pub dropped: u16,
    /// Messages with a CAN frame whose length contradicts the size field: a frame was lost or duplicated.
    pub miscut: u16,
    /// Messages with a wrong checksum.
    pub bad_checksum: u16,
    /// Messages whose size field exceeds the capacity of the reassembler.
    pub oversize: u16,
    /// Incomplete messages discarded after the time-out.
    pub expired: u16,
}

/// Reassembles messages of up to `FRAMES` CAN frames (8 `FRAMES` - 8 bytes of payload) from the frames of a bus.
///
/// A closure receives intact messages and rejected ones as the same [`Event`]s that [`FrameParser`](crate::FrameParser)
/// reports, so a [`Session`](crate::session::Session) accepts them directly. One CAN frame may cause several events,
/// because frames held after a lost frame are scanned again.
///
/// The caller provides the time. An incomplete message is discarded after the time-out, at the latest when another
/// frame arrives. To discard it on time, use [`poll_timeout`](Self::poll_timeout).
///
/// Work per CAN frame is bounded: one look at the message's first frame, and one pass over its bytes at its end. If a
/// message proves false, each held frame that looks like a first frame costs one pass over the frames held after it.
///
/// ```
/// use embedded_can::Frame as _;
/// # use embedded_can::Id;
/// # struct Frame(Id, Vec<u8>);
/// # impl embedded_can::Frame for Frame {
/// #     fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> { Some(Self(id.into(), data.to_vec())) }
/// #     fn new_remote(_: impl Into<Id>, _: usize) -> Option<Self> { None }
/// #     fn is_extended(&self) -> bool { matches!(self.0, Id::Extended(_)) }
/// #     fn is_remote_frame(&self) -> bool { false }
/// #     fn id(&self) -> Id { self.0 }
/// #     fn dlc(&self) -> usize { self.1.len() }
/// #     fn data(&self) -> &[u8] { &self.1 }
/// # }
/// use wsg_protocol::can::{HALF_MESSAGE_MS, Identifiers, Reassembler};
/// use wsg_protocol::{Event, Instant};
///
/// let gripper = Identifiers::from_base(0x100).unwrap().gripper();
/// let mut reassembler = Reassembler::<4>::new(gripper.receive, HALF_MESSAGE_MS);
/// let stop = Frame::new(gripper.receive, &[0xAA, 0xAA, 0xAA, 0x22, 0x00, 0x00, 0x0E, 0x76]).unwrap();
/// let mut stops = 0;
/// reassembler.receive(Instant::from_millis(0), &stop, |event| {
///     stops += u32::from(matches!(event, Event::Frame(message) if message.id == 0x22));
/// });
/// assert_eq!(stops, 1);
/// ```
#[derive(Clone, Debug)]
pub struct Reassembler<const FRAMES: usize> {
    held: [[u8; FULL]; FRAMES],
    /// Number of frames held: the full frames at the start of a message.
    count: u16,
    id: StandardId,
    /// Arrival time of the last held frame.
    received_at: Instant,
    half_message_ms: u32,
    counters: ReassemblerCounters,
}

/// The classification of the held frames from a given one on.
enum Found {
    /// A message of this number of frames.
    Message(usize),
    /// The start of an incomplete message.
    Half,
    /// Not the start of a message.
    Nothing,
    Miscut,
    BadChecksum(u8, u16),
    Oversize(u8, u16),
}

impl<const FRAMES: usize> Reassembler<FRAMES> {
    /// Creates a reassembler for the frames with identifier `id`. It discards an incomplete message after
    /// `half_message_ms` without a next frame.
    #[must_use]
    pub const fn new(id: StandardId, half_message_ms: u32) -> Self {
        const { assert!(FRAMES >= 1 && FRAMES <= 8_192, "FRAMES must be from 1 to 8 192") };
        Self {
            held: [[0; FULL]; FRAMES],
            count: 0,
            id,
            received_at: Instant::from_millis(0),
            half_message_ms,
            counters: ReassemblerCounters {
                foreign: 0,
                dropped: 0,
                miscut: 0,
                bad_checksum: 0,
                oversize: 0,
                expired: 0,
            },
        }
    }

    /// Returns the counters of rejected input since the reassembler was created.
    #[must_use]
    pub const fn counters(&self) -> ReassemblerCounters {
        self.counters
    }

    /// Processes a frame of the bus with any identifier, and passes the resulting events to `deliver`.
    pub fn receive<F: CanFrame>(&mut self, now: Instant, frame: &F, mut deliver: impl FnMut(Event<'_>)) {
        let data = frame.data();
        let is_ours = frame.id() == Id::Standard(self.id) && frame.is_data_frame();
        if !is_ours || data.is_empty() || data.len() > FULL {
            add(&mut self.counters.foreign, 1);
            return;
        }
        self.handle_timeout(now, &mut deliver);
        self.received_at = now;
        // There is always a free slot: once all are occupied, the message is complete.
        if let Some(place) = self.held.get_mut(usize::from(self.count)) {
            for (place, byte) in place.iter_mut().zip(data) {
                *place = *byte;
            }
            self.count = self.count.saturating_add(1);
        }
        self.scan(data.len(), false, deliver);
    }

    /// Returns when the incomplete message times out, or `None` if no message is incomplete.
    #[must_use]
    pub const fn poll_timeout(&self) -> Option<Instant> {
        if self.count == 0 { None } else { Some(self.received_at.plus(self.half_message_ms)) }
    }

    /// Discards an incomplete message whose time-out has expired. `deliver` receives the messages found in the frames
    /// held after its first.
    pub fn handle_timeout(&mut self, now: Instant, deliver: impl FnMut(Event<'_>)) {
        if self.poll_timeout().is_some_and(|at| now.has_reached(at)) {
            self.scan(FULL, true, deliver);
        }
    }

    /// Discards an incomplete message, for example after leaving the bus. Its frames count as dropped.
    pub fn reset(&mut self) {
        add(&mut self.counters.dropped, self.count);
        self.count = 0;
    }

    /// Scans the held frames, of which the last has `last_len` bytes and all others are full. Afterwards an incomplete
    /// message may remain, but not if `ended`, which means that no more frames will arrive.
    fn scan(&mut self, last_len: usize, ended: bool, mut deliver: impl FnMut(Event<'_>)) {
        let count = usize::from(self.count);
        let mut first = 0usize;
        while first < count {
            let rest = self.held.get(first..count).unwrap_or(&[]);
            let mut passed = 1;
            match judge(rest, last_len, FRAMES) {
                Found::Message(frames) => {
                    if let Some(message) = message(rest) {
                        deliver(Event::Frame(message));
                    }
                    first = first.saturating_add(frames);
                    passed = 0;
                }
                Found::Half if !ended => break,
                Found::Half => add(&mut self.counters.expired, 1),
                Found::Nothing => {}
                Found::Miscut => add(&mut self.counters.miscut, 1),
                Found::BadChecksum(id, size) => {
                    add(&mut self.counters.bad_checksum, 1);
                    deliver(Event::BadChecksum { id, size });
                }
                Found::Oversize(id, size) => {
                    add(&mut self.counters.oversize, 1);
                    deliver(Event::Oversize { id, size });
                }
            }
            first = first.saturating_add(passed.into());
            add(&mut self.counters.dropped, passed);
        }
        // `copy_within` can panic.
        for (to, from) in (first..count).enumerate() {
            if let Some(&frame) = self.held.get(from)
                && let Some(place) = self.held.get_mut(to)
            {
                *place = frame;
            }
        }
        self.count = self.count.saturating_sub(first as u16);
    }
}

/// Classifies the frames of `held` from the first on. The last has `last_len` bytes and all others are full. A message
/// has at most `limit` frames.
fn judge(held: &[[u8; FULL]], last_len: usize, limit: usize) -> Found {
    let len_of = |frame: usize| if frame == held.len() { last_len } else { FULL };
    let beginning = held.first().filter(|_| len_of(1) == FULL);
    let Some(&[PREAMBLE_BYTE, PREAMBLE_BYTE, PREAMBLE_BYTE, id, low, high, ..]) = beginning else {
        return Found::Nothing;
    };
    let size = u16::from_le_bytes([low, high]);
    let message_len = usize::from(size).saturating_add(OVERHEAD);
    let frames = message_len.div_ceil(FULL);
    if frames > limit {
        return Found::Oversize(id, size);
    }
    if held.len() < frames {
        return if last_len == FULL { Found::Half } else { Found::Miscut };
    }
    let before_last = frames.saturating_sub(1).saturating_mul(FULL);
    if before_last.saturating_add(len_of(frames)) != message_len {
        return Found::Miscut;
    }
    let (covered, received) =
        held.as_flattened().get(..message_len).unwrap_or(&[]).split_last_chunk().unwrap_or((&[], &[0; 2]));
    if checksum::push_slice(checksum::START, covered).to_le_bytes() != *received {
        return Found::BadChecksum(id, size);
    }
    Found::Message(frames)
}

/// Returns the message at the start of `held`.
fn message(held: &[[u8; FULL]]) -> Option<Frame<'_>> {
    let [_, _, _, id, low, high, rest @ ..] = held.as_flattened() else { return None };
    let size = u16::from_le_bytes([*low, *high]);
    Some(Frame { id: *id, payload: rest.get(..size.into())? })
}

/// Adds to a counter, saturating at its maximum.
fn add(count: &mut u16, more: u16) {
    *count = count.saturating_add(more);
}
