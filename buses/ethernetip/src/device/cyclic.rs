//! Cyclic data (class 1): packets from the originator (O->T) and to it (T->O).

use core::net::Ipv4Addr;

use super::{Device, Transmit};
use crate::connection::{Connection, Packet};
use crate::cursor::Reader;
use crate::encapsulation::MAX_FRAME_LEN;
use crate::forward_open::Kind;
use crate::state::State;

/// Bit of the run/idle header.
const RUN: u32 = 1;

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    /// Processes a datagram to UDP port [`IO_PORT`](crate::IO_PORT). Call [`poll`](Self::poll) before the next one: outputs
    /// that were not taken are replaced by newer ones. Returns whether the packet is the owner's and counts, even if it repeats
    /// old outputs: the owner is alive.
    pub fn receive_packet(&mut self, now: u64, from: Ipv4Addr, datagram: &[u8]) -> bool {
        self.expire(now);
        let last = self.owner().and_then(|owner| owner.received);
        if self.consume(now, from, datagram).is_none() {
            self.counters.packets_dropped = self.counters.packets_dropped.saturating_add(1);
        }
        self.owner().and_then(|owner| owner.received) != last
    }

    /// Takes a packet. Returns `None` if it must be dropped, which changes nothing.
    fn consume(&mut self, now: u64, from: Ipv4Addr, datagram: &[u8]) -> Option<()> {
        let Self { connections, outputs, pending, .. } = self;
        let packet = Packet::parse(datagram)?;
        let ids = (from, packet.id);
        let mut cyclic = connections.iter_mut().flatten().filter(|it| it.kind != Kind::Explicit);
        let io = cyclic.find(|it| (it.client.address, it.consumed_id) == ids)?;
        // Nothing in the data has a meaning before this check.
        if packet.data.len() != usize::from(io.size) {
            return None;
        }
        let ahead = |last: u32| packet.sequence.wrapping_sub(last);
        if io.received.is_some_and(|last| !(1..0x8000_0000).contains(&ahead(last))) {
            return None;
        }
        io.received = Some(packet.sequence);
        io.restart(now);
        if io.kind != Kind::ExclusiveOwner {
            return Some(());
        }
        let mut reader = Reader::new(packet.data);
        let (count, header) = (reader.u16()?, reader.u32()?);
        let mode = if header & RUN == 0 { State::Idle } else { State::Run };
        let (old_mode, old_count) = (core::mem::replace(&mut io.mode, mode), io.count.replace(count));
        // The same count in the same mode is the same data, which keeps the connection alive.
        if (old_mode, old_count) == (mode, Some(count)) {
            return Some(());
        }
        if mode == State::Run {
            *outputs = reader.array()?;
            pending.has_outputs = true;
        } else if old_mode == State::Run {
            outputs.fill(0);
            (pending.is_idle, pending.has_outputs) = (true, false);
        }
        Some(())
    }

    /// Writes a packet with inputs that is due.
    pub(super) fn transmit_inputs(&mut self, now: u64, buffer: &mut [u8; MAX_FRAME_LEN]) -> Option<Transmit> {
        let Self { connections, inputs, .. } = self;
        let io = connections.iter_mut().flatten().find(|io| io.next <= now)?;
        // Skips packets that were missed completely.
        let missed = now.saturating_sub(io.next).checked_div(io.interval_us).unwrap_or(0);
        io.next = io.next.saturating_add(io.interval_us.saturating_mul(missed.saturating_add(1)));
        io.sent = io.sent.wrapping_add(1);
        let Connection { produced_id, target, next, sent, .. } = *io;
        // The consumers of a group share its packets.
        let is_in_group = |it: &&mut Connection| it.target == target && target.ip().is_multicast();
        for it in connections.iter_mut().flatten().filter(is_in_group) {
            (it.next, it.sent) = (next, sent);
        }
        Packet::write(buffer, (produced_id, sent), inputs).map(|len| Transmit::Io(len, target))
    }
}
