//! What the device and its clients share: who asks, over which kind of line, and who gets a second answer.

use crate::time::Time;
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{CommandId, FrameCounters, LoopData, Status};

/// The longest frame that a gripper sends, in bytes: Loop with all its data.
pub const MAX_FRAME_LEN: usize = OVERHEAD + STATUS_LEN + LoopData::MAX_LEN;

/// A frame to be sent has room in this.
pub type FrameBuffer = [u8; MAX_FRAME_LEN];

const STATUS_LEN: usize = 2;

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
    /// CAN: give the data of each CAN frame to [`receive`](crate::VirtualGripper::receive) by itself. A message begins and
    /// ends with a CAN frame, and all its frames but the last are full; what is cut otherwise is none.
    Can,
    /// The text protocol (GCL) over TCP/IP.
    GclTcp,
    /// The text protocol (GCL) over UDP/IP: a datagram holds whole lines.
    GclUdp,
    /// Modbus/TCP.
    ModbusTcp,
    /// PROFIBUS DP, over a line that shows no silence between characters; a pause of some milliseconds is one.
    Profibus,
    /// PROFINET: its frames are the caller's, who gives images to
    /// [`write_image`](crate::VirtualGripper::write_image).
    Profinet,
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

    /// Whether the binary protocol is spoken on it, to which the commands of scripts belong.
    #[cfg(feature = "script")]
    pub(crate) fn is_binary(self) -> bool {
        self.protocol() == Protocol::Binary
    }

    /// What is spoken on it.
    pub(crate) const fn protocol(self) -> Protocol {
        match self {
            Self::Tcp | Self::Udp | Self::Serial | Self::Can => Protocol::Binary,
            Self::GclTcp | Self::GclUdp => Protocol::Text,
            Self::ModbusTcp => Protocol::Modbus,
            Self::Profibus => Protocol::Profibus,
            Self::Profinet => Protocol::Images,
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
    /// PROFIBUS DP.
    Profibus,
    /// None that the gripper reads: it gets images.
    Images,
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
            Self::Profibus => "profibus",
            Self::Profinet => "profinet",
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
    /// Nobody's: a hand beside the gripper, or a script on it, which are told nothing more.
    pub(crate) const HAND: Self = Self { index: u16::MAX, generation: 1 };

    /// Nobody's: the register interface, whose answers go to no line.
    pub(crate) const FIELDBUS: Self = Self { index: u16::MAX, generation: 0 };
}

/// What went wrong on a line so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    /// Bytes and frames that were refused.
    pub parser: FrameCounters,
    /// Automatic updates that found no room because the client does not read.
    pub updates_lost: u32,
    /// Answers that found no room because the client does not read.
    pub replies_lost: u32,
}

/// Who sent a request, and when.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Request {
    pub(crate) port: PortId,
    pub(crate) now: Time,
}

/// The second answer to a command.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Completion {
    pub(crate) port: PortId,
    pub(crate) id: CommandId,
    pub(crate) status: Status,
}
