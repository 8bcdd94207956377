//! From CAN frames to intact messages.
//!
//! Like the parser's, the rule is that of a reader with the whole recording: try a message at the first CAN frame; when
//! it proves false go on one CAN frame further, never skipping what the false one held.

use embedded_can::{Frame as CanFrame, Id, StandardId};

use super::FULL;
use crate::checksum;
use crate::frame::{Event, Frame, OVERHEAD, PREAMBLE_BYTE};
use crate::time::Instant;

/// After how long without its next CAN frame half a message is given up, in milliseconds, where nothing else is known:
/// a bus at 125 kbit/s that others fill for 40 frames in between.
pub const HALF_MESSAGE_MS: u32 = 50;

/// What a reassembler has refused so far; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct ReassemblerCounters {
    /// CAN frames that cannot be part of a message to this side: another identifier, remote frames, no data.
    pub foreign: u16,
    /// CAN frames that belonged to no intact message.
    pub dropped: u16,
    /// Messages in which a CAN frame had another length than the size field asks for: one was lost or doubled.
    pub miscut: u16,
    /// Messages with a wrong checksum.
    pub bad_checksum: u16,
    /// Messages that announced more than the reassembler holds.
    pub oversize: u16,
    /// Messages whose rest did not come in time.
    pub expired: u16,
}

/// Finds messages of up to `FRAMES` CAN frames, so with up to 8 `FRAMES` - 8 bytes of payload, among the frames of a bus.
///
/// Intact messages, and what proved to be none, go to a closure as the [`Event`]s of the byte-wise
/// [`FrameParser`](crate::FrameParser), so a [`Session`](crate::session::Session) takes them as they are. One CAN frame
/// may bring several: what was held back behind a lost frame is looked through again.
///
/// The caller says what time it is. Half a message is given up after a time without its next frame, at the latest when
/// another frame comes; a caller that wants it earlier asks for [`poll_timeout`](Self::poll_timeout).
///
/// Work per CAN frame is bounded: a look at the message's first frame, at its end one pass over its bytes. Where a
/// message proves false, each held frame that looks like a beginning costs one pass over what is held behind it.
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
    /// How many are held: the beginning of a message, whose frames so far are full.
    count: u16,
    id: StandardId,
    /// When the last of them came.
    heard_at: Instant,
    half_message_ms: u32,
    counters: ReassemblerCounters,
}

/// What the held frames are, from one of them on.
enum Found {
    /// A message of so many frames.
    Message(usize),
    /// A message whose rest has not come.
    Half,
    /// No beginning of a message.
    Nothing,
    Miscut,
    BadChecksum(u8, u16),
    Oversize(u8, u16),
}

impl<const FRAMES: usize> Reassembler<FRAMES> {
    /// A reassembler for the frames with identifier `id` that gives up half a message after `half_message_ms` without its
    /// next frame.
    #[must_use]
    pub const fn new(id: StandardId, half_message_ms: u32) -> Self {
        const { assert!(FRAMES >= 1 && FRAMES <= 8_192, "a message has 1 to 8 193 CAN frames") };
        Self {
            held: [[0; FULL]; FRAMES],
            count: 0,
            id,
            heard_at: Instant::from_millis(0),
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

    /// What has been refused so far.
    #[must_use]
    pub const fn counters(&self) -> ReassemblerCounters {
        self.counters
    }

    /// Takes a frame of the bus, whoever it is for, and gives `deliver` what it completes.
    pub fn receive<F: CanFrame>(&mut self, now: Instant, frame: &F, mut deliver: impl FnMut(Event<'_>)) {
        let data = frame.data();
        let is_ours = frame.id() == Id::Standard(self.id) && frame.is_data_frame();
        if !is_ours || data.is_empty() || data.len() > FULL {
            add(&mut self.counters.foreign, 1);
            return;
        }
        self.handle_timeout(now, &mut deliver);
        self.heard_at = now;
        // There is always a place: as many frames as there are places are a whole message.
        if let Some(place) = self.held.get_mut(usize::from(self.count)) {
            for (place, byte) in place.iter_mut().zip(data) {
                *place = *byte;
            }
            self.count = self.count.saturating_add(1);
        }
        self.scan(data.len(), false, deliver);
    }

    /// When half a message is to be given up; `None` while there is none.
    #[must_use]
    pub const fn poll_timeout(&self) -> Option<Instant> {
        if self.count == 0 { None } else { Some(self.heard_at.plus(self.half_message_ms)) }
    }

    /// Gives up half a message if it is time. `deliver` gets what was held back behind its beginning.
    pub fn handle_timeout(&mut self, now: Instant, deliver: impl FnMut(Event<'_>)) {
        if self.poll_timeout().is_some_and(|at| now.has_reached(at)) {
            self.scan(FULL, true, deliver);
        }
    }

    /// Forgets half a message, as when the bus was left. Its frames count as dropped.
    pub fn reset(&mut self) {
        add(&mut self.counters.dropped, self.count);
        self.count = 0;
    }

    /// Looks through the held frames, of which the last has `last_len` bytes and the others are full. What is left then
    /// is half a message or nothing, and nothing if `ended`: no more frames will come.
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
        // Not `copy_within`, which can panic.
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

/// What the frames of `held` are, from the first on. The last of them has `last_len` bytes, the others are full; a message
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

/// The message that `held` begins with.
fn message(held: &[[u8; FULL]]) -> Option<Frame<'_>> {
    let [_, _, _, id, low, high, rest @ ..] = held.as_flattened() else { return None };
    let size = u16::from_le_bytes([*low, *high]);
    Some(Frame { id: *id, payload: rest.get(..size.into())? })
}

/// Adds to a count that stops at its maximum.
fn add(count: &mut u16, more: u16) {
    *count = count.saturating_add(more);
}
