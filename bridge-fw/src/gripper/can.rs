//! The gripper on the bus: to the bridge a line that it reads and writes byte by byte.

use embedded_can::{Frame, Id};
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::Deque;
use wsg_protocol::can::{Endpoint, FULL, HALF_MESSAGE_MS, Identifiers, Reassembler, Segment, Segmenter};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{Command, Event, FrameEncoder, Instant};

use super::would_block::WouldBlock;
use crate::can::{CanNode, LinkCounters};
use crate::config::MAX_REPLY_LEN;

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

/// The bridge's end of a gripper on CAN.
///
/// One message is on its way at a time: the next is taken once all of its frames are with the controller, so a FAST STOP
/// waits for the rest of one at the most. What was on its way when the bus was lost is never sent.
#[derive(Debug)]
pub struct GripperLink {
    endpoint: Endpoint,
    reassembler: Reassembler<REPLY_FRAMES>,
    received: Deque<u8, RECEIVED_MAX>,
    segmenter: Segmenter,
    to_send: Deque<Segment, REQUEST_FRAMES>,
    /// Since when frames wait and none was taken, looked at once a turn.
    stuck_since: Option<Instant>,
    is_on: bool,
    is_connected: bool,
    /// What left this link before the connection was lost must not leave the controller.
    withdraws: bool,
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
            to_send: Deque::new(),
            stuck_since: None,
            is_on: true,
            is_connected: false,
            withdraws: false,
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

    /// Says whether the gripper answers, behind each turn of the bridge. When it does no more, nothing that was said to
    /// it leaves any more: without anybody on the bus who acknowledges them, frames wait in the controller, and would
    /// leave when the gripper comes back.
    pub fn set_connected(&mut self, is_connected: bool) {
        if self.is_connected && !is_connected {
            self.abandon();
            self.withdraws = true;
        }
        self.is_connected = is_connected;
    }

    /// Lets time pass: gives up half a message of the gripper whose rest did not come, and messages to it that the bus
    /// does not take, because nobody is there who acknowledges them. Whoever sent them is waiting for answers, and has to
    /// notice that there are none.
    pub fn expire(&mut self, now: Instant) {
        if self.to_send.is_empty() {
            self.stuck_since = None;
        } else if now.since(*self.stuck_since.get_or_insert(now)) >= STUCK_MS {
            self.abandon();
            self.withdraws = true;
        }
        let Self { reassembler, received, overflows, .. } = self;
        reassembler.handle_timeout(now, |event| keep(received, overflows, event));
    }

    /// Gives up what is being sent.
    fn abandon(&mut self) {
        if self.segmenter.is_mid_message() {
            self.is_broken = true;
        }
        if self.segmenter.is_mid_message() || !self.to_send.is_empty() {
            self.broken = self.broken.saturating_add(1);
        }
        self.segmenter.reset();
        self.to_send.clear();
        self.stuck_since = None;
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
        self.stuck_since = None;
        self.to_send.pop_front()?.frame(self.endpoint.transmit)
    }

    fn sends(&self, id: Id) -> bool {
        id == Id::Standard(self.endpoint.transmit)
    }

    fn lost(&mut self) {
        self.abandon();
    }

    fn withdraws(&mut self) -> bool {
        core::mem::take(&mut self.withdraws)
    }

    fn bus_changed(&mut self, is_on: bool) {
        self.is_on = is_on;
        self.abandon();
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
        let goes_on = self.segmenter.is_mid_message() || self.to_send.is_empty();
        Ok(self.is_broken || (self.is_on && goes_on))
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
                && self.to_send.push_back(segment).is_err()
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
        if self.to_send.is_empty() && !self.segmenter.is_mid_message() { Ok(()) } else { Err(WouldBlock) }
    }
}
