//! The connection manager (volume 1, chapter 3): opens and closes connections.

use core::net::SocketAddrV4;

use super::router::Context;
use super::{Device, IO_CONNECTIONS, OWNER};
use crate::connection::{Client, Explicit, Io, Link};
use crate::cursor::{Reader, Writer};
use crate::encapsulation::{IO_PORT, MAX_SIZE};
use crate::forward_open::{Failure, Kind, Open, Served, Triad, exact_path};
use crate::profile::Status;
use crate::state::{Cause, State};

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    /// Serves Forward_Open and Large_Forward_Open.
    pub(super) fn open(
        &mut self,
        context: &mut Context<'_>,
        open: &Open<'_>,
        out: &mut Writer<'_>,
    ) -> Served {
        let id = self.establish(context, open).map_err(|failure| {
            self.counters.opens_refused = self.counters.opens_refused.saturating_add(1);
            Failure { triad: Some(open.triad), ..failure }
        })?;
        out.u32(id);
        out.u32(open.produced_id);
        open.triad.write(out);
        out.u32(open.output_us);
        out.u32(open.input_us);
        // No application reply.
        out.u16(0);
        Ok(())
    }

    /// Opens a connection. Returns its identifier for packets to this device.
    fn establish(&mut self, context: &mut Context<'_>, open: &Open<'_>) -> Result<u32, Failure> {
        let Context { now, client, .. } = *context;
        let refused = |code| Err(Failure::refused(code));
        if !open.is_null() && self.links().any(|link| link.triad == open.triad) {
            return refused(0x0100);
        }
        let Some(kind) = open.check(&self.profile, (OUT, IN))? else {
            let Some(place) = self.explicit.iter().position(Option::is_none) else {
                return refused(0x0113);
            };
            let id = self.random.id(IO_CONNECTIONS.saturating_add(place));
            let (link, answer) = (Link::new(now, open, client, id), ([0; MAX_SIZE as usize], 0));
            let explicit = Explicit { link, size: open.input.size, answer };
            self.explicit.get_mut(place).map(|free| free.replace(explicit));
            return Ok(id);
        };
        let target = match context.target {
            // Data for a third station would make the device an amplifier.
            Some(target) if !target.ip().is_unspecified() && *target.ip() != client.address => {
                return refused(0x0205);
            }
            Some(target) if target.port() != 0 => SocketAddrV4::new(client.address, target.port()),
            _ => SocketAddrV4::new(client.address, IO_PORT),
        };
        let is_free = |place: &usize| self.io.get(*place).is_some_and(Option::is_none);
        let place = match kind {
            Kind::ExclusiveOwner => Some(OWNER).filter(is_free).ok_or(0x0106),
            Kind::ListenOnly if self.io.iter().flatten().all(|io| io.kind == Kind::ListenOnly) => Err(0x0119),
            // Never the owner's place.
            _ => (1..IO_CONNECTIONS).find(is_free).ok_or(0x0113),
        };
        let place = place.map_err(Failure::refused)?;
        let id = self.random.id(place);
        let io = Io {
            link: Link::new(now, open, client, id),
            kind,
            size: open.output.size,
            target,
            mode: State::Waiting,
            received: None,
            count: None,
            interval_us: open.input_us.into(),
            next: now,
            sent: 0,
        };
        self.io.get_mut(place).map(|free| free.replace(io));
        self.has_timed_out = false;
        self.pending.is_connected |= kind == Kind::ExclusiveOwner;
        context.has_opened_io = true;
        Ok(id)
    }

    /// Serves Forward_Close. Only the station that opened a connection may close it, over any session.
    pub(super) fn close(&mut self, client: Client, data: &[u8], out: &mut Writer<'_>) -> Served {
        let mut reader = Reader::new(data);
        let mut fields = || {
            let (_tick, _ticks, triad) = (reader.u8()?, reader.u8()?, Triad::read(&mut reader)?);
            let (words, _reserved) = (reader.u8()?, reader.u8()?);
            Some((triad, words))
        };
        let (triad, words) = fields().ok_or(Status::TooShort)?;
        exact_path(&reader, words)?;
        match self.links().find(|link| link.triad == triad) {
            Some(link) if link.client.address == client.address => {}
            Some(_) => return Err(Failure { triad: Some(triad), ..Status::PrivilegeViolation.into() }),
            None => return Err(Failure { triad: Some(triad), ..Failure::refused(0x0107) }),
        }
        self.end_link(triad, Cause::Closed);
        triad.write(out);
        out.u16(0);
        Ok(())
    }
}
