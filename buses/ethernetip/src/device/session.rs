//! Encapsulation: commands, and the sessions of TCP connections.

use core::net::{Ipv4Addr, SocketAddrV4};

use super::router::Context;
use super::{Device, INACTIVITY_S, IO_CONNECTIONS, SESSIONS, Transmit};
use crate::connection::{Client, Connection};
use crate::cursor::{Writer, copy};
use crate::encapsulation::{
    Header, IO_PORT, Items, MAX_FRAME_LEN, MAX_MESSAGE_LEN, MAX_SIZE, Outcome, command, item, status,
};
use crate::forward_open::Kind;
use crate::profile::Registers;

/// Default and minimum of the longest delay of an answer to a broadcast.
const DEFAULT_DELAY_MS: u16 = 2_000;
const MIN_DELAY_MS: u16 = 500;

/// A session, bound to its TCP connection.
#[derive(Clone, Debug)]
pub(super) struct Session {
    pub(super) client: u32,
    handle: u32,
    /// Time of the last frame.
    received: u64,
    /// Whether the session has ended and the TCP connection must be closed.
    pub(super) is_over: bool,
}

impl Session {
    /// Returns when the session ends without a frame.
    pub(super) fn until(&self) -> u64 {
        self.received.saturating_add(u64::from(INACTIVITY_S).saturating_mul(1_000_000))
    }
}

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    /// Processes a frame of a TCP connection. Returns the answer to send, if any.
    pub fn request<'a>(
        &mut self,
        now: u64,
        client: Client,
        frame: &[u8],
        registers: &mut dyn Registers,
        answer: &'a mut [u8; MAX_FRAME_LEN],
    ) -> Option<&'a [u8]> {
        self.expire(now);
        for session in self.sessions.iter_mut().flatten().filter(|it| it.client == client.number) {
            session.received = now;
        }
        let (header, data) = Header::parse(frame)?;
        let is_it =
            |it: &&Session| (it.client, it.handle, it.is_over) == (client.number, header.session, false);
        header.answer(answer, |out| match header.command {
            _ if !header.is_exact(data) => self.list(&header, data, out),
            command::REGISTER_SESSION => Some(self.register(now, client, data, out)),
            command::UNREGISTER_SESSION | command::SEND_RR_DATA | command::SEND_UNIT_DATA
                if self.sessions.iter().flatten().find(is_it).is_none() =>
            {
                Some(Err(status::INVALID_SESSION))
            }
            command::UNREGISTER_SESSION => {
                self.end_session(client.number);
                None
            }
            command::SEND_RR_DATA | command::SEND_UNIT_DATA => {
                let mut context =
                    Context { now, client, target: None, registers, triad: None, has_opened_io: false };
                self.message(&mut context, &header, data, out)
            }
            _ => self.list(&header, data, out),
        })
    }

    /// Processes a datagram to UDP port [`PORT`](crate::PORT). `is_broadcast` reports whether it was sent to a broadcast
    /// address: then an answer to ListIdentity is delayed. Returns the answer to send at once, if any. Errors get no answer,
    /// so that two devices never answer each other.
    pub fn receive_datagram<'a>(
        &mut self,
        now: u64,
        from: SocketAddrV4,
        is_broadcast: bool,
        datagram: &[u8],
        answer: &'a mut [u8; MAX_FRAME_LEN],
    ) -> Option<&'a [u8]> {
        let (header, data) = Header::parse(datagram)?;
        if is_broadcast && header.command == command::LIST_IDENTITY && header.is_exact(data) {
            let [low, high, ..] = header.context;
            let longest = match u16::from_le_bytes([low, high]) {
                0 => DEFAULT_DELAY_MS,
                longest => longest.max(MIN_DELAY_MS),
            };
            let delay_ms = self.random.next().checked_rem(u64::from(longest).saturating_add(1))?;
            let due = now.saturating_add(delay_ms.saturating_mul(1_000));
            match self.identities.iter_mut().find(|place| place.is_none()) {
                Some(place) => *place = Some((due, from, header)),
                None => self.counters.identities_lost = self.counters.identities_lost.saturating_add(1),
            }
            return None;
        }
        header.answer(answer, |out| self.list(&header, data, out).filter(Result::is_ok))
    }

    /// Returns whether the TCP connection of this number has a session.
    #[must_use]
    pub fn has_session(&self, number: u32) -> bool {
        self.sessions.iter().flatten().any(|session| session.client == number)
    }

    /// Removes the session and the class 3 connections of a TCP connection that is closed. Class 1 connections remain.
    pub fn closed(&mut self, number: u32) {
        self.end_session(number);
        for place in &mut self.sessions {
            place.take_if(|session| session.client == number);
        }
    }

    /// Ends a session and its class 3 connections. The TCP connection must be closed.
    pub(super) fn end_session(&mut self, client: u32) {
        for session in self.sessions.iter_mut().flatten().filter(|it| it.client == client) {
            session.is_over = true;
        }
        self.end_all(|it| it.kind == Kind::Explicit && it.client.number == client);
    }

    /// Writes a delayed answer that is due.
    pub(super) fn transmit_identity(
        &mut self,
        now: u64,
        buffer: &mut [u8; MAX_FRAME_LEN],
    ) -> Option<Transmit> {
        let mut places = self.identities.iter_mut();
        let (_, to, header) = places.find_map(|place| place.take_if(|(due, ..)| now >= *due))?;
        let answer = header.answer(buffer, |out| self.list(&header, &[], out))?;
        Some(Transmit::Answer(answer.len(), to))
    }

    /// Executes the commands that need no session.
    fn list(&self, header: &Header, data: &[u8], out: &mut Writer<'_>) -> Outcome {
        match header.command {
            command::NOP => return None,
            _ if !header.is_exact(data) => return Some(Err(status::INVALID_LENGTH)),
            command::LIST_SERVICES | command::LIST_IDENTITY | command::LIST_INTERFACES
                if !data.is_empty() =>
            {
                return Some(Err(status::INVALID_LENGTH));
            }
            command::LIST_SERVICES => {
                out.u16(1);
                out.u16(item::SERVICES);
                out.counted(|out| {
                    // Version; explicit messages over TCP, class 0 and 1 over UDP.
                    out.u16(1);
                    out.u16(0x0120);
                    out.bytes(b"Communications\0\0");
                });
            }
            command::LIST_IDENTITY => {
                out.u16(1);
                out.u16(item::IDENTITY);
                out.counted(|out| self.identity(out));
            }
            command::LIST_INTERFACES => out.u16(0),
            _ => return Some(Err(status::INVALID_COMMAND)),
        }
        Some(Ok(header.session))
    }

    fn register(&mut self, now: u64, client: Client, data: &[u8], out: &mut Writer<'_>) -> Result<u32, u32> {
        let &[a, b, c, d] = data else { return Err(status::INVALID_LENGTH) };
        if self.has_session(client.number) {
            return Err(status::INVALID_COMMAND);
        }
        // The only version, without options.
        out.bytes(&[1, 0, 0, 0]);
        if [a, b, c, d] != [1, 0, 0, 0] {
            return Err(status::UNSUPPORTED_VERSION);
        }
        let Self { sessions, random, .. } = self;
        let free = sessions.iter_mut().zip(0..SESSIONS).find(|(session, _)| session.is_none());
        let (session, place) = free.ok_or(status::NO_RESOURCE)?;
        let handle = random.id(place);
        *session = Some(Session { client: client.number, handle, received: now, is_over: false });
        Ok(handle)
    }

    /// Serves SendRRData and SendUnitData: a message without a connection, and of a connection (class 3).
    fn message(
        &mut self,
        context: &mut Context<'_>,
        header: &Header,
        data: &[u8],
        out: &mut Writer<'_>,
    ) -> Outcome {
        let is_connected = header.command == command::SEND_UNIT_DATA;
        let Some(items) = Items::parse(data, is_connected) else { return Some(Err(status::BAD_DATA)) };
        context.target = items.target;
        let mut buffer = [0; MAX_SIZE as usize];
        let (address, kind, len) = if is_connected {
            let (produced_id, len) = self.connected(context, &items, &mut buffer)?;
            (Some(produced_id), item::CONNECTED_DATA, len)
        } else {
            let Some(len) = self.serve(context, items.message, buffer.get_mut(..MAX_MESSAGE_LEN)?) else {
                return Some(Err(status::BAD_DATA));
            };
            (None, item::UNCONNECTED_DATA, len)
        };
        out.bytes(&[0; 6]);
        let has_sockets = context.has_opened_io && !is_connected;
        let group = context.target.filter(|_| has_sockets);
        out.u16(2_u16.saturating_add(has_sockets.into()).saturating_add(group.is_some().into()));
        out.u16(if is_connected { item::CONNECTED_ADDRESS } else { item::NULL });
        out.counted(|out| address.into_iter().for_each(|id| out.u32(id)));
        out.u16(kind);
        out.counted(|out| out.bytes(buffer.get(..len).unwrap_or(&[])));
        let own = has_sockets.then_some(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, IO_PORT));
        for (kind, address) in [(item::SOCKET_O_TO_T, own), (item::SOCKET_T_TO_O, group)] {
            if let Some(address) = address {
                out.u16(kind);
                out.counted(|out| out.socket_address(address));
            }
        }
        Some(Ok(header.session))
    }

    /// Serves a message of a connection. Writes the sequence count and the answer. Returns the identifier for packets to the
    /// originator, and the length, or `None` for an unknown connection or a damaged message, which get no answer.
    fn connected(
        &mut self,
        context: &mut Context<'_>,
        items: &Items<'_>,
        out: &mut [u8; MAX_SIZE as usize],
    ) -> Option<(u32, usize)> {
        let (count, message) = items.message.split_first_chunk::<2>()?;
        let ids = (Kind::Explicit, context.client, items.connection);
        let is_it = |it: &Connection| (it.kind, it.client, it.consumed_id) == ids;
        let place = self.connections.iter().position(|place| place.as_ref().is_some_and(is_it))?;
        let connection = self.connections.get_mut(place)?.as_mut()?;
        connection.restart(context.now);
        let (id, room) = (connection.produced_id, usize::from(connection.size));
        // An equal count repeats the stored answer.
        let place = place.checked_sub(IO_CONNECTIONS)?;
        let (stored, stored_len) = self.answers.get(place)?;
        if *stored_len > 0 && stored.starts_with(count) {
            *out = *stored;
            return Some((id, *stored_len));
        }
        copy(out, 0, count)?;
        let len = self.serve(context, message, out.get_mut(2..room)?)?.saturating_add(2);
        *self.answers.get_mut(place)? = (*out, len);
        Some((id, len))
    }
}
