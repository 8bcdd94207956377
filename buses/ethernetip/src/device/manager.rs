//! The connection manager (volume 1, chapter 3): opens and closes connections.

use core::net::SocketAddrV4;

use super::router::Context;
use super::{CONNECTIONS, Device, IO_CONNECTIONS, OWNER};
use crate::connection::Connection;
use crate::cursor::{Reader, Writer};
use crate::encapsulation::IO_PORT;
use crate::forward_open::{Failure, Kind, Open, Served, exact_path};
use crate::profile::Status;
use crate::state::Cause;

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    /// Serves Forward_Open and Large_Forward_Open.
    pub(super) fn open(
        &mut self,
        context: &mut Context<'_>,
        open: &Open<'_>,
        out: &mut Writer<'_>,
    ) -> Served {
        context.triad = Some(open.triad);
        let (consumed_id, produced_id) = self.establish(context, open).inspect_err(|_| {
            self.counters.opens_refused = self.counters.opens_refused.saturating_add(1);
        })?;
        out.u32(consumed_id);
        out.u32(produced_id);
        out.bytes(&open.triad);
        out.u32(open.output.interval_us);
        out.u32(open.input.interval_us);
        // No application reply.
        out.u16(0);
        Ok(())
    }

    /// Opens a connection. Returns its identifiers of packets to this device and to the originator.
    fn establish(&mut self, context: &mut Context<'_>, open: &Open<'_>) -> Result<(u32, u32), Failure> {
        let refused = |code| Err(Failure::Connection(code, None));
        if !open.is_null() && self.connections().any(|it| it.triad == open.triad) {
            return refused(0x0100);
        }
        let kind = open.check(&self.profile, (OUT, IN))?;
        let Context { now, client, .. } = *context;
        let group = open.input.is_multicast().then(|| SocketAddrV4::new(self.network.group(), IO_PORT));
        let target = match (group, context.target) {
            (Some(group), _) => group,
            // Data for a third station would make the device an amplifier.
            (None, Some(target)) if !target.ip().is_unspecified() && *target.ip() != client.address => {
                return refused(0x0205);
            }
            (None, Some(target)) if target.port() != 0 => SocketAddrV4::new(client.address, target.port()),
            _ => SocketAddrV4::new(client.address, IO_PORT),
        };
        let running = group.and_then(|group| self.connections().find(|it| it.target == group).cloned());
        let (places, status_if_full) = match kind {
            Kind::ExclusiveOwner => (OWNER..1, 0x0106),
            Kind::ListenOnly if !self.has_stream() => return refused(0x0119),
            // Never the owner's place.
            Kind::InputOnly | Kind::ListenOnly => (1..IO_CONNECTIONS, 0x0113),
            Kind::Explicit => (IO_CONNECTIONS..CONNECTIONS, 0x0113),
        };
        let mut free = self.connections.iter_mut().zip(0..).skip(places.start).take(places.len());
        let Some((free, place)) = free.find(|(free, _)| free.is_none()) else {
            return refused(status_if_full);
        };
        let mut connection = Connection::new(now, kind, open, client, target);
        if let Some(running) = running {
            if running.interval_us != connection.interval_us {
                return refused(0x0112);
            }
            let Connection { produced_id, next, sent, .. } = running;
            connection = Connection { produced_id, next, sent, ..connection };
        } else if group.is_some() {
            connection.produced_id = self.random.id(place);
        }
        let ids = (self.random.id(place), connection.produced_id);
        *free = Some(Connection { consumed_id: ids.0, ..connection });
        if kind == Kind::Explicit {
            let answer = place.checked_sub(IO_CONNECTIONS).and_then(|place| self.answers.get_mut(place));
            answer.into_iter().for_each(|answer| answer.1 = 0);
        } else {
            self.has_timed_out = false;
            self.pending.is_connected |= kind == Kind::ExclusiveOwner;
            context.has_opened_io = true;
            context.target = group;
        }
        Ok(ids)
    }

    /// Serves Forward_Close. Only the station that opened a connection may close it, over any session.
    pub(super) fn close(&mut self, context: &mut Context<'_>, data: &[u8], out: &mut Writer<'_>) -> Served {
        let mut reader = Reader::new(data);
        let mut fields = || {
            let (_tick, _ticks, triad) = (reader.u8()?, reader.u8()?, reader.array()?);
            let (words, _reserved) = (reader.u8()?, reader.u8()?);
            Some((triad, words))
        };
        let (triad, words) = fields().ok_or(Status::TooShort)?;
        exact_path(&reader, words)?;
        context.triad = Some(triad);
        match self.connections().find(|it| it.triad == triad) {
            Some(it) if it.client.address == context.client.address => {}
            Some(_) => return Err(Status::PrivilegeViolation.into()),
            None => return Err(Failure::Connection(0x0107, None)),
        }
        self.end(triad, Cause::Closed);
        out.bytes(&triad);
        out.u16(0);
        Ok(())
    }
}
