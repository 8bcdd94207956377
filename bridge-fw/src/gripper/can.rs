//! The gripper on the bus: to the bridge a line that it reads and writes byte by byte.

use embedded_can::{Frame, Id};
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::{Deque, Vec};
use wsg_protocol::can::{Endpoint, FULL, HALF_MESSAGE_MS, Identifiers, Reassembler, Segment, Segmenter};
use wsg_protocol::frame::{OVERHEAD, PREAMBLE_LEN};
use wsg_protocol::{Command, CommandId, Event, FrameEncoder, Instant, Kind, checksum};

use super::MAX_REPLY_LEN;
use super::would_block::WouldBlock;
use crate::can::{CanNode, LinkCounters, MAX_ON_THE_WAY};

/// CAN frames of the longest reply that a bridge asks for.
const REPLY_FRAMES: usize = (MAX_REPLY_LEN + OVERHEAD).div_ceil(FULL);

/// CAN frames of the longest message that the bridge sends.
const REQUEST_FRAMES: usize = (Command::MAX_FIXED_LEN + OVERHEAD).div_ceil(FULL);

/// What the bus brings between two turns of the bridge, and a reply that was held back until then. The bridge takes 256
/// bytes in a turn, so nothing is left over.
const RECEIVED_MAX: usize = 256;
const _: () = assert!(RECEIVED_MAX >= REPLY_FRAMES * FULL + 20 * FULL);

/// How long frames wait for the controller to take one, in milliseconds, before they and what it holds are given up. Less
/// than the time in which a session expects an answer, and more than a bus at 125 kbit/s needs for 90 frames of others.
const STUCK_MS: u32 = 100;

/// Frames that the bus may have, and the message after them. Every unsent frame is among them.
const FRAMES_MAX: usize = MAX_ON_THE_WAY + REQUEST_FRAMES;

/// Index of the command's id in a message.
const ID_AT: usize = PREAMBLE_LEN;

/// One CAN frame of a message to the gripper.
#[derive(Clone, Copy, Debug)]
struct Piece {
    segment: Segment,
    /// The motion or acknowledgement that it belongs to, unless that is spoilt.
    motion: Option<CommandId>,
    /// The running checksum before it.
    checksum: u16,
    is_first: bool,
    is_last: bool,
}

/// Which unsent frames the link takes back from the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TakesBack {
    /// All of them, for good.
    All,
    /// Those of motions and acknowledgements. The others are sent after all.
    Motions,
}

/// The bridge's end of a gripper on CAN.
///
/// It takes the next message once the bus has all frames of the one before, so a FAST STOP waits for the rest of one message at
/// most, and for none that it [withdraws](Self::withdraw). What was on its way when the bus was lost is never sent.
#[derive(Debug)]
pub struct GripperLink {
    endpoint: Endpoint,
    reassembler: Reassembler<REPLY_FRAMES>,
    received: Deque<u8, RECEIVED_MAX>,
    segmenter: Segmenter,
    /// The last frames that the bus was given, and those that it was not given yet.
    frames: Vec<Piece, FRAMES_MAX>,
    /// How many of them it was given.
    given: usize,
    /// Since when frames wait and none was taken, looked at once a turn.
    stuck_since: Option<Instant>,
    is_on: bool,
    is_connected: bool,
    takes_back: Option<TakesBack>,
    /// The gripper will not get this command whole, which the bridge does not know yet.
    withdrawn: Option<CommandId>,
    /// Truncated message: the writer must get an error.
    is_broken: bool,
    overflows: u16,
    broken: u16,
}

impl GripperLink {
    /// A link to the gripper with these identifiers, on a bus that is there.
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
            takes_back: None,
            withdrawn: None,
            is_broken: false,
            overflows: 0,
            broken: 0,
        }
    }

    /// What could not be used so far.
    #[must_use]
    pub const fn counters(&self) -> LinkCounters {
        LinkCounters { frames: self.reassembler.counters(), overflows: self.overflows, broken: self.broken }
    }

    /// Takes whether the gripper answers, after each turn of the bridge. When it no longer does, all unsent frames are taken
    /// back from the controller. Without a node that acknowledges them they would wait there, and be sent when the gripper
    /// returns.
    pub fn set_connected(&mut self, is_connected: bool) {
        if self.is_connected && !is_connected {
            self.abandon();
            self.takes_back = Some(TakesBack::All);
        }
        self.is_connected = is_connected;
    }

    /// Withdraws motions and acknowledgements of which unsent frames may wait for the bus. No message is taken until that is
    /// decided. The gripper never gets such a message whole then, and [`take_withdrawn`](Self::take_withdrawn) reports it. Does
    /// nothing if all of them are known to be sent.
    ///
    /// A message of which the gripper has the first frame is not just cut: the gripper would take the following FAST STOP for
    /// its rest. Its other frames are sent [spoilt](Segment::spoil), in at most two frames, and the gripper hears the FAST STOP
    /// after them.
    pub fn withdraw(&mut self) {
        if self.takes_back.is_none() && self.frames.iter().any(|piece| piece.motion.is_some()) {
            self.takes_back = Some(TakesBack::Motions);
        }
    }

    /// Returns the command that was withdrawn last, once.
    pub const fn take_withdrawn(&mut self) -> Option<CommandId> {
        self.withdrawn.take()
    }

    /// Lets time pass: gives up half a message of the gripper whose rest did not come, and messages to it that the bus
    /// does not take, because nobody is there who acknowledges them. Whoever sent them is waiting for answers, and has to
    /// notice that there are none.
    pub fn expire(&mut self, now: Instant) {
        if !self.has_frames_to_give() {
            self.stuck_since = None;
        } else if now.since(*self.stuck_since.get_or_insert(now)) >= STUCK_MS {
            self.abandon();
            self.takes_back = Some(TakesBack::All);
        }
        let Self { reassembler, received, overflows, .. } = self;
        reassembler.handle_timeout(now, |event| keep(received, overflows, event));
    }

    /// Whether there are frames that the bus was not given.
    fn has_frames_to_give(&self) -> bool {
        self.given < self.frames.len()
    }

    /// Gives up what is being sent.
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

    /// Forgets so many frames that were sent.
    #[inline(never)]
    fn forget_sent(&mut self, count: usize) {
        let mut number = 0usize;
        self.frames.retain(|_| {
            number = number.saturating_add(1);
            number > count
        });
        self.given = self.given.saturating_sub(count);
    }

    /// The bus has given the last `count` frames back.
    #[inline(never)]
    fn resume(&mut self, count: usize) {
        if self.takes_back.take() != Some(TakesBack::Motions) {
            return self.forget_frames();
        }
        self.forget_sent(self.given.saturating_sub(count));
        self.given = 0;
        // Of a message that is cut only the rest is there, before the others.
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

    /// Keeps the next segment of the message that is being written; whether there is room, which every message of the bridge
    /// has.
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
                // The bus has the last of the others at most.
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

/// Keeps an intact message for the bridge, whole or not at all.
fn keep(received: &mut Deque<u8, RECEIVED_MAX>, overflows: &mut u16, event: Event<'_>) {
    let Event::Frame(message) = event else { return };
    let bytes = FrameEncoder::new(message.id, message.payload);
    if received.capacity().saturating_sub(received.len()) < bytes.len() {
        *overflows = overflows.saturating_add(1);
        return;
    }
    for byte in bytes {
        // There is room for all of them.
        let _ = received.push_back(byte);
    }
}

impl<F: Frame> CanNode<F> for GripperLink {
    fn on_frame(&mut self, now: Instant, frame: &F) {
        let Self { reassembler, received, overflows, .. } = self;
        reassembler.receive(now, frame, |event| keep(received, overflows, event));
    }

    fn poll_transmit(&mut self, _: Instant) -> Option<F> {
        if self.takes_back.is_some() {
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
        self.takes_back.map(|_| self.endpoint.transmit.into())
    }

    fn taken_back(&mut self, count: usize) {
        self.resume(count);
    }

    fn bus_changed(&mut self, is_on: bool) {
        self.is_on = is_on;
        self.abandon();
        self.takes_back = None;
        self.reassembler.reset();
        // Whole messages that came before stay: they were true then, and the session knows what it still waits for.
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
        // Also when the message is broken: writing tells.
        let goes_on = self.segmenter.is_mid_message() || !self.has_frames_to_give();
        Ok(self.is_broken || (self.is_on && self.takes_back.is_none() && goes_on))
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
