//! The gripper on CAN, as a line that the bridge reads and writes byte by byte.

use embedded_can::{Frame, Id};
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::{Deque, Vec};
use wsg_protocol::can::{Endpoint, FULL, HALF_MESSAGE_MS, Identifiers, Reassembler, Segment, Segmenter};
use wsg_protocol::frame::{OVERHEAD, PREAMBLE_LEN};
use wsg_protocol::{Command, CommandId, Event, FrameEncoder, Instant, Kind, checksum};

use super::MAX_REPLY_LEN;
use super::would_block::WouldBlock;
use crate::can::{CanNode, LinkCounters, MAX_ON_THE_WAY};

/// CAN frames of the longest reply that the bridge requests.
const REPLY_FRAMES: usize = (MAX_REPLY_LEN + OVERHEAD).div_ceil(FULL);

/// CAN frames of the longest message that the bridge sends.
const REQUEST_FRAMES: usize = (Command::MAX_FIXED_LEN + OVERHEAD).div_ceil(FULL);

/// Bytes that the bus delivers between two turns of the bridge, plus a reply that was completed only then. The bridge reads
/// 256 bytes per turn, so nothing is left over.
const RECEIVED_MAX: usize = 256;
const _: () = assert!(RECEIVED_MAX >= REPLY_FRAMES * FULL + 20 * FULL);

/// Longest wait for the controller to accept a frame, in milliseconds. Then all frames are discarded. It is shorter than the
/// session's time-out for a reply, and longer than a bus at 125 kbit/s needs for 90 other frames.
const STUCK_MS: u32 = 100;

/// Capacity for the frames on the bus and the next message, which are all unsent frames.
const FRAMES_MAX: usize = MAX_ON_THE_WAY + REQUEST_FRAMES;

/// Index of the command's id in a message.
const ID_AT: usize = PREAMBLE_LEN;

/// One CAN frame of a message to the gripper.
#[derive(Clone, Copy, Debug)]
struct Piece {
    segment: Segment,
    /// Motion or acknowledgement that the frame belongs to, unless it is spoilt.
    motion: Option<CommandId>,
    /// Running checksum before this frame.
    checksum: u16,
    is_first: bool,
    is_last: bool,
}

/// The bridge's end of a gripper on CAN.
///
/// It accepts the next message after the bus has taken all frames of the previous one. So a FAST STOP waits for the rest of
/// at most one message, and not for a message that it [withdraws](Self::withdraw). Unsent frames are discarded when the bus
/// is lost.
#[derive(Clone, Debug)]
pub struct GripperLink {
    endpoint: Endpoint,
    reassembler: Reassembler<REPLY_FRAMES>,
    received: Deque<u8, RECEIVED_MAX>,
    segmenter: Segmenter,
    /// The last frames passed to the bus, followed by the pending ones.
    frames: Vec<Piece, FRAMES_MAX>,
    /// Number of these frames passed to the bus.
    given: usize,
    /// Start of the current wait for the controller, checked once per turn.
    stuck_since: Option<Instant>,
    is_on: bool,
    is_connected: bool,
    /// The link withdraws its unsent frames from the bus. Those that it still keeps are sent later.
    takes_back: bool,
    /// Command that the gripper will not receive completely. Not yet reported to the bridge.
    withdrawn: Option<CommandId>,
    /// A message was truncated, and the next write must fail.
    is_broken: bool,
    overflows: u16,
    broken: u16,
}

impl GripperLink {
    /// Creates a link to the gripper with these identifiers, on a working bus.
    #[must_use]
    pub const fn new(identifiers: Identifiers) -> Self {
        let endpoint = identifiers.controller();
        Self {
            endpoint,
            reassembler: Reassembler::new(endpoint.receive, HALF_MESSAGE_MS),
            received: Deque::new(),
            segmenter: Segmenter::new(),
            frames: Vec::new(),
            given: 0,
            stuck_since: None,
            is_on: true,
            is_connected: false,
            takes_back: false,
            withdrawn: None,
            is_broken: false,
            overflows: 0,
            broken: 0,
        }
    }

    /// Returns the counters of the link.
    #[must_use]
    pub const fn counters(&self) -> LinkCounters {
        LinkCounters { frames: self.reassembler.counters(), overflows: self.overflows, broken: self.broken }
    }

    /// Sets whether the gripper answers, after each turn of the bridge. When it stops answering, all unsent frames are
    /// withdrawn from the controller. Otherwise they would wait there for an acknowledgement, and be sent when the gripper
    /// returns.
    pub fn set_connected(&mut self, is_connected: bool) {
        if self.is_connected && !is_connected {
            self.withdraw_all();
        }
        self.is_connected = is_connected;
    }

    /// Withdraws motions and acknowledgements with unsent frames. No message is accepted until the withdrawal is decided. The
    /// gripper never receives such a message completely, and [`take_withdrawn`](Self::take_withdrawn) reports it. Does
    /// nothing if all frames have been sent.
    ///
    /// A message whose first frame was sent cannot simply be cut, because the gripper would take the following FAST STOP for
    /// its rest. Its other frames are sent [spoilt](Segment::spoil), in at most two frames, followed by the FAST STOP.
    pub fn withdraw(&mut self) {
        self.takes_back |= self.frames.iter().any(|piece| piece.motion.is_some());
    }

    /// Returns the last withdrawn command, once.
    pub const fn take_withdrawn(&mut self) -> Option<CommandId> {
        self.withdrawn.take()
    }

    /// Discards an incomplete message of the gripper after its time-out. Also discards messages to the gripper that the bus
    /// does not accept, because no node acknowledges them. The session then times out.
    pub fn expire(&mut self, now: Instant) {
        if !self.has_frames_to_give() {
            self.stuck_since = None;
        } else if now.since(*self.stuck_since.get_or_insert(now)) >= STUCK_MS {
            self.withdraw_all();
        }
        let Self { reassembler, received, overflows, .. } = self;
        reassembler.handle_timeout(now, |event| keep(received, overflows, event));
    }

    /// Returns whether frames are pending for the bus.
    fn has_frames_to_give(&self) -> bool {
        self.given < self.frames.len()
    }

    /// Withdraws all unsent frames permanently.
    fn withdraw_all(&mut self) {
        self.abandon();
        self.takes_back = true;
    }

    /// Discards the message in transmission.
    #[inline(never)]
    fn abandon(&mut self) {
        if self.segmenter.is_mid_message() {
            self.is_broken = true;
        }
        if self.segmenter.is_mid_message() || self.has_frames_to_give() {
            self.broken = self.broken.saturating_add(1);
        }
        self.segmenter.reset();
        self.forget_frames();
        self.stuck_since = None;
    }

    /// Removes the first `count` frames, which were sent.
    #[inline(never)]
    fn forget_sent(&mut self, count: usize) {
        let mut number = 0usize;
        self.frames.retain(|_| {
            number = number.saturating_add(1);
            number > count
        });
        self.given = self.given.saturating_sub(count);
    }

    /// Handles the withdrawal of the last `count` frames by the bus.
    #[inline(never)]
    fn resume(&mut self, count: usize) {
        self.takes_back = false;
        self.forget_sent(self.given.saturating_sub(count));
        self.given = 0;
        // Of a message that was partly sent, only the rest is left, before the other messages.
        let mut is_cut = true;
        let mut checksum = self.frames.first().map_or(checksum::START, |piece| piece.checksum);
        let withdrawn = &mut self.withdrawn;
        self.frames.retain_mut(|piece| {
            is_cut &= !piece.is_first;
            if piece.motion.is_some() {
                *withdrawn = piece.motion.take();
                checksum = piece.segment.spoil(checksum, piece.is_last);
                is_cut
            } else {
                true
            }
        });
    }

    /// Queues the next segment of the written message. Returns whether there was room, which suffices for every message of
    /// the bridge.
    #[inline(never)]
    fn keep_to_send(&mut self, segment: Segment) -> bool {
        if self.frames.len().saturating_sub(self.given) >= REQUEST_FRAMES {
            return false;
        }
        let is_last = !self.segmenter.is_mid_message();
        let piece = match (self.frames.last(), segment.data()) {
            (Some(before), _) if !before.is_last => {
                let checksum = checksum::push_slice(before.checksum, before.segment.data());
                Piece { segment, motion: before.motion, checksum, is_first: false, is_last }
            }
            (_, data) => {
                let id = data.get(ID_AT).map(|code| CommandId::from_code(*code));
                let motion = id.filter(|id| matches!(id.kind(), Kind::Motion | Kind::Acknowledge));
                // At most the last frames of earlier messages are still on the bus.
                self.forget_sent(self.given.saturating_sub(MAX_ON_THE_WAY));
                Piece { segment, motion, checksum: checksum::START, is_first: true, is_last }
            }
        };
        self.frames.push(piece).is_ok()
    }

    fn forget_frames(&mut self) {
        self.frames.clear();
        self.given = 0;
    }
}

/// Queues an intact message for the bridge, completely or not at all.
fn keep(received: &mut Deque<u8, RECEIVED_MAX>, overflows: &mut u16, event: Event<'_>) {
    let Event::Frame(message) = event else { return };
    let bytes = FrameEncoder::new(message.id, message.payload);
    if received.capacity().saturating_sub(received.len()) < bytes.len() {
        *overflows = overflows.saturating_add(1);
        return;
    }
    for byte in bytes {
        // Cannot fail: the room was checked.
        let _ = received.push_back(byte);
    }
}

impl<F: Frame> CanNode<F> for GripperLink {
    fn on_frame(&mut self, now: Instant, frame: &F) {
        let Self { reassembler, received, overflows, .. } = self;
        reassembler.receive(now, frame, |event| keep(received, overflows, event));
    }

    fn poll_transmit(&mut self, _: Instant) -> Option<F> {
        if self.takes_back {
            return None;
        }
        self.stuck_since = None;
        let frame = self.frames.get(self.given)?.segment.frame(self.endpoint.transmit);
        self.given = self.given.saturating_add(1);
        frame
    }

    fn sends(&self, id: Id) -> bool {
        id == Id::Standard(self.endpoint.transmit)
    }

    fn lost(&mut self) {
        self.abandon();
    }

    fn takes_back(&self) -> Option<Id> {
        self.takes_back.then(|| self.endpoint.transmit.into())
    }

    fn taken_back(&mut self, count: usize) {
        self.resume(count);
    }

    fn bus_changed(&mut self, is_on: bool) {
        self.is_on = is_on;
        self.abandon();
        self.takes_back = false;
        self.reassembler.reset();
        // Complete messages received before the loss stay: they were valid, and the session knows its pending requests.
    }
}

impl ErrorType for GripperLink {
    type Error = WouldBlock;
}

impl ReadReady for GripperLink {
    fn read_ready(&mut self) -> Result<bool, WouldBlock> {
        Ok(!self.received.is_empty())
    }
}

impl Read for GripperLink {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, WouldBlock> {
        let mut count = 0;
        for place in buffer.iter_mut() {
            let Some(byte) = self.received.pop_front() else { break };
            *place = byte;
            count += 1;
        }
        if count == 0 && !buffer.is_empty() { Err(WouldBlock) } else { Ok(count) }
    }
}

impl WriteReady for GripperLink {
    fn write_ready(&mut self) -> Result<bool, WouldBlock> {
        // Also true for a truncated message, because the write reports it.
        let goes_on = self.segmenter.is_mid_message() || !self.has_frames_to_give();
        Ok(self.is_broken || (self.is_on && !self.takes_back && goes_on))
    }
}

impl Write for GripperLink {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, WouldBlock> {
        if core::mem::take(&mut self.is_broken) {
            return Err(WouldBlock);
        }
        let mut count = 0;
        for &byte in bytes {
            if !self.write_ready().unwrap_or(false) {
                break;
            }
            if let Some(segment) = self.segmenter.push(byte)
                && !self.keep_to_send(segment)
            {
                // Longer than any message of the bridge.
                self.abandon();
                self.is_broken = false;
                return Err(WouldBlock);
            }
            count += 1;
        }
        if count == 0 && !bytes.is_empty() { Err(WouldBlock) } else { Ok(count) }
    }

    fn flush(&mut self) -> Result<(), WouldBlock> {
        if !self.has_frames_to_give() && !self.segmenter.is_mid_message() { Ok(()) } else { Err(WouldBlock) }
    }
}
