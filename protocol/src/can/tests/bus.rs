//! A CAN bus in memory that keeps frames in order.

use super::*;

/// The identifier received by the reassembler under test.
pub(super) const RECEIVED: StandardId = StandardId::MAX;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct CanFrame {
    pub(super) id: Id,
    pub(super) remote: bool,
    pub(super) data: Vec<u8>,
}

impl CanFrame {
    pub(super) fn ours(data: &[u8]) -> Self {
        Self { id: RECEIVED.into(), remote: false, data: data.to_vec() }
    }
}

impl embedded_can::Frame for CanFrame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        (data.len() <= 8).then(|| Self { id: id.into(), remote: false, data: data.to_vec() })
    }

    fn new_remote(id: impl Into<Id>, _dlc: usize) -> Option<Self> {
        Some(Self { id: id.into(), remote: true, data: Vec::new() })
    }

    fn is_extended(&self) -> bool {
        matches!(self.id, Id::Extended(_))
    }

    fn is_remote_frame(&self) -> bool {
        self.remote
    }

    fn id(&self) -> Id {
        self.id
    }

    fn dlc(&self) -> usize {
        self.data.len()
    }

    fn data(&self) -> &[u8] {
        &self.data
    }
}

/// An event by value, for comparison.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Seen {
    Message(Message),
    BadChecksum(u8, u16),
    Oversize(u8, u16),
}

impl From<Event<'_>> for Seen {
    fn from(event: Event<'_>) -> Self {
        match event {
            Event::Frame(frame) => Self::Message(Message { id: frame.id, payload: frame.payload.to_vec() }),
            Event::BadChecksum { id, size } => Self::BadChecksum(id, size),
            Event::Oversize { id, size } => Self::Oversize(id, size),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Message {
    pub(super) id: u8,
    pub(super) payload: Vec<u8>,
}

impl Message {
    pub(super) fn new(id: u8, payload: &[u8]) -> Self {
        Self { id, payload: payload.to_vec() }
    }

    pub(super) fn command(command: Command<'_>) -> Self {
        let bytes: Vec<u8> = FrameEncoder::new(command.id().code(), command).collect();
        Self { id: bytes[3], payload: bytes[6..bytes.len() - 2].to_vec() }
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        FrameEncoder::new(self.id, &self.payload[..]).collect()
    }

    /// Divides the message into CAN frames, independently of the code under test.
    pub(super) fn frames(&self) -> Vec<CanFrame> {
        self.bytes().chunks(8).map(CanFrame::ours).collect()
    }
}

/// A reassembler and its delivered events.
pub(super) struct Wire<const FRAMES: usize> {
    pub(super) reassembler: Reassembler<FRAMES>,
    pub(super) seen: Vec<Seen>,
    pub(super) now: Instant,
}

pub(super) const HALF_MS: u32 = 20;

impl<const FRAMES: usize> Wire<FRAMES> {
    pub(super) fn new() -> Self {
        let reassembler = Reassembler::new(RECEIVED, HALF_MS);
        Self { reassembler, seen: Vec::new(), now: Instant::from_millis(u32::MAX - 7) }
    }

    pub(super) fn receive<'a>(&mut self, frames: impl IntoIterator<Item = &'a CanFrame>) {
        for frame in frames {
            self.reassembler.receive(self.now, frame, |event| self.seen.push(event.into()));
        }
    }

    pub(super) fn pass(&mut self, millis: u32) {
        self.now = self.now.plus(millis);
        self.reassembler.handle_timeout(self.now, |event| self.seen.push(event.into()));
    }

    pub(super) fn messages(&self) -> Vec<Message> {
        let message = |seen: &Seen| match seen {
            Seen::Message(message) => Some(message.clone()),
            _ => None,
        };
        self.seen.iter().filter_map(message).collect()
    }
}
