//! One client: what comes from it, its frames to be sent, its subscriptions.

use crate::config::Config;
use crate::deframer::Deframer;
use crate::device::Completion;
use crate::gcl;
use crate::modbus;
use crate::time::Time;
use crate::updates::{Readings, Subscriptions};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{Counters, FrameEncoder, LoopData, Reply};

/// The longest frame that a gripper sends, in bytes: Loop with all its data.
pub const MAX_FRAME_LEN: usize = OVERHEAD + STATUS_LEN + LoopData::MAX_LEN;

/// A frame to be sent has room in this.
pub type FrameBuffer = [u8; MAX_FRAME_LEN];

const STATUS_LEN: usize = 2;
/// Bytes of frames that wait for a client to read them.
const QUEUE_LEN: usize = 2_048;
/// Updates leave this much room for answers.
const RESERVED_FOR_REPLIES: usize = 512;
/// Where the size stands in a frame.
const SIZE_AT: usize = 4;

const _: () = assert!(QUEUE_LEN >= RESERVED_FOR_REPLIES + MAX_FRAME_LEN);

/// The kind of line that a client uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PortKind {
    /// Ethernet TCP/IP: connection oriented, so its end is noticed.
    Tcp,
    /// Ethernet UDP/IP: no frame goes over the end of a datagram; give each to
    /// [`receive`](crate::VirtualGripper::receive) by itself.
    Udp,
    /// RS-232.
    Serial,
    /// CAN, as a stream of bytes.
    Can,
    /// The text protocol (GCL) over TCP/IP.
    GclTcp,
    /// The text protocol (GCL) over UDP/IP: a datagram holds whole lines.
    GclUdp,
    /// Modbus/TCP.
    ModbusTcp,
}

impl PortKind {
    /// Whether its end is noticed, and is an error unless it was announced.
    pub(crate) const fn is_connection(self) -> bool {
        matches!(self, Self::Tcp | Self::GclTcp)
    }

    /// Whether what arrives together is a whole.
    pub(crate) const fn is_datagram(self) -> bool {
        matches!(self, Self::Udp | Self::GclUdp)
    }

    /// What is spoken on it.
    pub(crate) const fn protocol(self) -> Protocol {
        match self {
            Self::Tcp | Self::Udp | Self::Serial | Self::Can => Protocol::Binary,
            Self::GclTcp | Self::GclUdp => Protocol::Text,
            Self::ModbusTcp => Protocol::Modbus,
        }
    }
}

/// What is spoken on a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Protocol {
    /// The binary command set.
    Binary,
    /// The text protocol (GCL).
    Text,
    /// Modbus/TCP.
    Modbus,
}

impl core::fmt::Display for PortKind {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Tcp => "tcp",
            Self::Udp => "udp",
            Self::Serial => "serial",
            Self::Can => "can",
            Self::GclTcp => "gcl-tcp",
            Self::GclUdp => "gcl-udp",
            Self::ModbusTcp => "modbus",
        })
    }
}

/// Which client: valid from [`connect`](crate::VirtualGripper::connect) to
/// [`disconnect`](crate::VirtualGripper::disconnect), harmless afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PortId {
    pub(crate) index: u16,
    pub(crate) generation: u32,
}

impl PortId {
    /// Nobody's: the register interface, whose answers go to no line.
    pub(crate) const FIELDBUS: Self = Self { index: u16::MAX, generation: 0 };
}

/// What went wrong on a line so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    /// Bytes and frames that were refused.
    pub parser: Counters,
    /// Automatic updates that found no room because the client does not read.
    pub updates_lost: u32,
    /// Answers that found no room because the client does not read.
    pub replies_lost: u32,
}

/// A client.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "the core allocates nothing, and neither is small")]
pub(crate) enum Port {
    /// It speaks the binary protocol.
    Frames(Framed),
    /// It speaks the text protocol.
    Lines(gcl::Client),
    /// It speaks Modbus/TCP.
    Registers(modbus::Client),
}

/// A client that speaks the binary protocol.
#[derive(Clone, Debug)]
pub(crate) struct Framed {
    pub(crate) deframer: Deframer,
    pub(crate) line: Line,
}

/// All of a client of the binary protocol but what finds its frames.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    pub(crate) id: PortId,
    pub(crate) kind: PortKind,
    pub(crate) subscriptions: Subscriptions,
    /// Whether the client has announced its disconnection.
    pub(crate) announced: bool,
    queue: FrameQueue,
    updates_lost: u32,
    replies_lost: u32,
}

impl Port {
    pub(crate) fn new(id: PortId, kind: PortKind, config: &Config) -> Self {
        match kind.protocol() {
            Protocol::Text => return Self::Lines(gcl::Client::new(id, kind, config)),
            Protocol::Modbus => return Self::Registers(modbus::Client::new(id)),
            Protocol::Binary => {}
        }
        Self::Frames(Framed {
            deframer: Deframer::new(config.check_checksum, config.frame_timeout_ms),
            line: Line {
                id,
                kind,
                subscriptions: Subscriptions::default(),
                announced: false,
                queue: FrameQueue::new(),
                updates_lost: 0,
                replies_lost: 0,
            },
        })
    }

    pub(crate) const fn id(&self) -> PortId {
        match self {
            Self::Frames(client) => client.line.id,
            Self::Lines(client) => client.line.id,
            Self::Registers(client) => client.line.id,
        }
    }

    /// Whether it is an error that the client is gone.
    pub(crate) const fn is_missed(&self) -> bool {
        match self {
            Self::Frames(client) => client.line.kind.is_connection() && !client.line.announced,
            Self::Lines(client) => client.line.kind.is_connection() && !client.line.announced,
            // Masters that connect for each request are common.
            Self::Registers(_) => false,
        }
    }

    /// Whether nothing more can be understood of what the client sends.
    pub(crate) const fn is_lost(&self) -> bool {
        match self {
            Self::Frames(_) | Self::Lines(_) => false,
            Self::Registers(client) => client.line.lost,
        }
    }

    pub(crate) fn counters(&self) -> PortCounters {
        match self {
            Self::Frames(client) => PortCounters {
                parser: client.deframer.counters(),
                updates_lost: client.line.updates_lost,
                replies_lost: client.line.replies_lost,
            },
            Self::Lines(client) => client.counters(),
            Self::Registers(client) => client.counters(),
        }
    }

    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        match self {
            Self::Frames(client) => {
                crate::device::earlier(client.line.subscriptions.next_due(now), client.deframer.due())
            }
            Self::Lines(client) => client.line.next_due(now),
            Self::Registers(_) => None,
        }
    }

    /// Sends the second answer to a command.
    pub(crate) fn complete(&mut self, done: Completion) {
        match self {
            Self::Frames(client) => client.line.reply(Reply::status_only(done.id, done.status)),
            Self::Lines(client) => client.line.complete(done),
            Self::Registers(_) => {}
        }
    }

    /// Sends the updates that are due.
    pub(crate) fn publish(&mut self, now: Time, readings: &Readings) {
        match self {
            Self::Frames(client) => client.line.publish(now, readings),
            Self::Lines(client) => client.line.publish(now, readings),
            Self::Registers(_) => {}
        }
    }

    pub(crate) fn has_frame(&self) -> bool {
        match self {
            Self::Frames(client) => client.line.has_frame(),
            Self::Lines(client) => client.line.has_line(),
            Self::Registers(client) => client.line.has_frame(),
        }
    }

    /// The next frame, or line, whole.
    pub(crate) fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        match self {
            Self::Frames(client) => client.line.next_frame(buffer),
            Self::Lines(client) => client.line.next_line(buffer),
            Self::Registers(client) => client.line.next_frame(buffer),
        }
    }
}

impl Line {
    pub(crate) fn reply(&mut self, reply: Reply<'_>) {
        if !self.queue.push(reply, QUEUE_LEN) {
            self.replies_lost = self.replies_lost.saturating_add(1);
        }
    }

    fn publish(&mut self, now: Time, readings: &Readings) {
        let Self { subscriptions, queue, updates_lost, .. } = self;
        subscriptions.publish(now, readings, |value| {
            let found_room = queue.push(Reply::success(value), QUEUE_LEN - RESERVED_FOR_REPLIES);
            if !found_room {
                *updates_lost = updates_lost.saturating_add(1);
            }
            found_room
        });
    }

    const fn has_frame(&self) -> bool {
        self.queue.len > 0
    }

    fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let len = self.queue.pop(buffer)?;
        buffer.get(..len)
    }
}

/// Frames in a ring of bytes. A frame tells its own length.
#[derive(Clone, Debug)]
struct FrameQueue {
    bytes: [u8; QUEUE_LEN],
    first: usize,
    len: usize,
}

impl FrameQueue {
    const fn new() -> Self {
        Self { bytes: [0; QUEUE_LEN], first: 0, len: 0 }
    }

    /// Appends a frame unless the queue would hold more than `limit` bytes; whether it did.
    fn push(&mut self, reply: Reply<'_>, limit: usize) -> bool {
        let frame = FrameEncoder::new(reply.id().code(), reply);
        if self.len + frame.frame_len() > limit {
            return false;
        }
        for byte in frame {
            self.bytes[(self.first + self.len) % QUEUE_LEN] = byte;
            self.len += 1;
        }
        true
    }

    /// Takes the oldest frame; its length.
    fn pop(&mut self, buffer: &mut FrameBuffer) -> Option<usize> {
        if self.len == 0 {
            return None;
        }
        let size = u16::from_le_bytes([self.byte(SIZE_AT), self.byte(SIZE_AT + 1)]);
        let len = usize::from(size) + OVERHEAD;
        for (at, slot) in buffer.iter_mut().enumerate().take(len) {
            *slot = self.byte(at);
        }
        self.first = (self.first + len) % QUEUE_LEN;
        self.len -= len;
        Some(len)
    }

    fn byte(&self, at: usize) -> u8 {
        self.bytes[(self.first + at) % QUEUE_LEN]
    }
}
