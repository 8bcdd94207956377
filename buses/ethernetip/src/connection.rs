//! Open connections and their packets.

use core::net::{Ipv4Addr, SocketAddrV4};

use crate::cursor::{Reader, Writer};
use crate::encapsulation::{item, items};
use crate::forward_open::{Kind, Open, Triad};
use crate::state::State;

/// Minimum time-out before the first packet.
const FIRST_US: u64 = 10_000_000;

/// A TCP connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Client {
    /// Number of the connection, chosen by the caller, and never used again for another connection.
    pub number: u32,
    /// Address of the other end.
    pub address: Ipv4Addr,
}

/// An open connection.
#[derive(Clone, Debug)]
pub(crate) struct Connection {
    pub(crate) kind: Kind,
    pub(crate) triad: Triad,
    /// The TCP connection that opened it.
    pub(crate) client: Client,
    /// Identifier of packets to this device, chosen here.
    pub(crate) consumed_id: u32,
    /// Identifier of packets to the originator, or to the group of all that requested multicast.
    pub(crate) produced_id: u32,
    pub(crate) timeout_us: u64,
    /// Time at which the connection ends without a packet.
    pub(crate) until: u64,
    /// Length of cyclic data to this device, or the maximum length of an answer with its sequence count.
    pub(crate) size: u16,
    /// Receiver of cyclic packets: the originator or the group.
    pub(crate) target: SocketAddrV4,
    /// Mode of an owner.
    pub(crate) mode: State,
    /// Last sequence number received.
    pub(crate) received: Option<u32>,
    /// Last sequence count received.
    pub(crate) count: Option<u16>,
    pub(crate) interval_us: u64,
    /// Time of the next cyclic packet to the target.
    pub(crate) next: u64,
    /// Last sequence number sent.
    pub(crate) sent: u32,
}

impl Connection {
    pub(crate) fn new(now: u64, kind: Kind, open: &Open<'_>, client: Client, target: SocketAddrV4) -> Self {
        let factor = 4_u64.checked_shl(open.multiplier.into()).unwrap_or(u64::MAX);
        let timeout_us = factor.saturating_mul(open.output.interval_us.into());
        let is_cyclic = kind != Kind::Explicit;
        Self {
            kind,
            triad: open.triad,
            client,
            consumed_id: 0,
            produced_id: open.produced_id,
            timeout_us,
            until: now.saturating_add(timeout_us.max(FIRST_US)),
            size: if is_cyclic { open.output.size } else { open.input.size },
            target,
            mode: State::Waiting,
            received: None,
            count: None,
            interval_us: open.input.interval_us.into(),
            next: if is_cyclic { now } else { u64::MAX },
            sent: 0,
        }
    }

    /// Restarts the time-out after a packet.
    pub(crate) const fn restart(&mut self, now: u64) {
        self.until = now.saturating_add(self.timeout_us);
    }
}

/// A packet of class 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packet<'a> {
    pub(crate) id: u32,
    pub(crate) sequence: u32,
    pub(crate) data: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Parses a datagram of exactly two items.
    pub(crate) fn parse(datagram: &'a [u8]) -> Option<Self> {
        let mut places = Default::default();
        let [(item::SEQUENCED_ADDRESS, address), (item::CONNECTED_DATA, data)] =
            *items(Reader::new(datagram), &mut places)?
        else {
            return None;
        };
        let mut reader = Reader::new(address);
        let packet = Self { id: reader.u32()?, sequence: reader.u32()?, data };
        reader.rest().is_empty().then_some(packet)
    }

    /// Writes a packet to an originator, with a sequence count and these inputs.
    pub(crate) fn write(buffer: &mut [u8], (id, sequence): (u32, u32), inputs: &[u8]) -> Option<usize> {
        let mut out = Writer::new(buffer);
        out.u16(2);
        out.u16(item::SEQUENCED_ADDRESS);
        out.counted(|out| {
            out.u32(id);
            out.u32(sequence);
        });
        out.u16(item::CONNECTED_DATA);
        out.counted(|out| {
            out.u16(sequence as u16);
            out.bytes(inputs);
        });
        out.finish()
    }
}
