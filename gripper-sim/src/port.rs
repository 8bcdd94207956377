//! Types shared by the device and its clients: the sender of a request, its kind of line, and the receiver of a second answer.

use crate::time::Time;
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{CommandId, FrameCounters, LoopData, Status};

/// Longest frame that a gripper sends, in bytes: Loop with all its data.
pub const MAX_FRAME_LEN: usize = OVERHEAD + STATUS_LEN + LoopData::MAX_LEN;

/// A buffer that holds any frame to be sent.
pub type FrameBuffer = [u8; MAX_FRAME_LEN];

const STATUS_LEN: usize = 2;

/// The kind of a client's line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PortKind {
    /// Ethernet TCP/IP: connection-oriented, so its end is noticed.
    Tcp,
    /// Ethernet UDP/IP: no frame continues in the next datagram, so pass each datagram to
    /// [`receive`](crate::VirtualGripper::receive) on its own.
    Udp,
    /// RS-232 with the binary protocol.
    Serial,
    /// CAN: pass the data of each CAN frame to [`receive`](crate::VirtualGripper::receive) on its own. A message begins
    /// and ends at a CAN frame boundary, and all its CAN frames but the last are full. Messages split differently are rejected.
    Can,
    /// The text protocol (GCL) over TCP/IP.
    GclTcp,
    /// The text protocol (GCL) over UDP/IP: a datagram contains complete lines.
    GclUdp,
    /// Modbus/TCP with the registers of the fieldbus interface.
    ModbusTcp,
    /// PROFIBUS DP over a line that hides the silence between characters; a pause of some milliseconds counts as silence.
    Profibus,
    /// The command editor of the page: the binary protocol, without a line.
    Page,
    /// PROFINET: the caller handles its frames and passes images to
    /// [`write_image`](crate::VirtualGripper::write_image).
    Profinet,
    /// EtherNet/IP, with complete images like PROFINET.
    EthernetIp,
}

impl PortKind {
    /// Returns whether the gripper notices its end, which is an error unless announced.
    pub(crate) const fn is_connection(self) -> bool {
        matches!(self, Self::Tcp | Self::GclTcp)
    }

    /// Returns whether bytes that arrive together form one unit.
    pub(crate) const fn is_datagram(self) -> bool {
        matches!(self, Self::Udp | Self::GclUdp)
    }

    /// Returns whether the line carries the binary protocol, to which the commands of scripts belong.
    #[cfg(feature = "control")]
    pub(crate) fn is_binary(self) -> bool {
        self.protocol() == Protocol::Binary
    }

    /// Returns the protocol of the line.
    pub(crate) const fn protocol(self) -> Protocol {
        match self {
            Self::Tcp | Self::Udp | Self::Serial | Self::Can | Self::Page => Protocol::Binary,
            Self::GclTcp | Self::GclUdp => Protocol::Text,
            Self::ModbusTcp => Protocol::Modbus,
            Self::Profibus => Protocol::Profibus,
            Self::Profinet | Self::EthernetIp => Protocol::Images,
        }
    }
}

/// The protocol on a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Protocol {
    /// The binary command set.
    Binary,
    /// The text protocol (GCL).
    Text,
    /// Modbus/TCP with its requests and exceptions.
    Modbus,
    /// Telegrams of PROFIBUS DP.
    Profibus,
    /// No byte protocol: the gripper gets complete images.
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
            Self::Page => "page",
            Self::Profinet => "profinet",
            Self::EthernetIp => "ethernetip",
        })
    }
}

/// Identifies a client from [`connect`](crate::VirtualGripper::connect) to
/// [`disconnect`](crate::VirtualGripper::disconnect); ignored afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PortId {
    pub(crate) index: u16,
    pub(crate) generation: u32,
}

impl PortId {
    /// No client: an operator, or a script on the gripper, which gets no second answer.
    pub(crate) const HAND: Self = Self { index: u16::MAX, generation: 1 };

    /// No client: the register interface, whose answers are sent on no line.
    pub(crate) const FIELDBUS: Self = Self { index: u16::MAX, generation: 0 };
}

/// Error counters of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    /// Rejected bytes and frames.
    pub parser: FrameCounters,
    /// Automatic updates dropped because the client does not read and the queue was full.
    pub updates_lost: u32,
    /// Answers dropped because the client does not read and the queue was full.
    pub replies_lost: u32,
}

/// The sender and time of a request.
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
