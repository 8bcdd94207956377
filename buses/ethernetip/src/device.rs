//! The device: its state, its tables, and the schedule of its packets.

mod cyclic;
mod manager;
mod objects;
mod router;
mod session;

use core::net::SocketAddrV4;

pub use self::objects::DSCP;
use self::session::Session;
use crate::connection::Connection;
use crate::encapsulation::{Header, MAX_FRAME_LEN, MAX_MESSAGE_LEN, MAX_SIZE};
use crate::forward_open::{Kind, Triad};
use crate::profile::{Network, Profile};
use crate::state::{Cause, Event, Reset, State};

/// Maximum number of sessions.
pub const SESSIONS: usize = 8;
/// Maximum number of connections with cyclic data. One place is reserved for the owner.
pub const IO_CONNECTIONS: usize = 8;
/// Maximum number of connections with explicit messages (class 3).
pub const EXPLICIT_CONNECTIONS: usize = 8;
const CONNECTIONS: usize = IO_CONNECTIONS + EXPLICIT_CONNECTIONS;
/// Inactivity time-out: the default of the specification. Read-only, because a set value would have to survive power-off.
const INACTIVITY_S: u16 = 120;
/// Maximum number of delayed answers to broadcasts.
const IDENTITIES: usize = 4;
/// Place of the owner in the table of connections.
const OWNER: usize = 0;
/// Number of low bits of an identifier that hold its place in the tables.
const PLACE_BITS: u32 = 5;
const _: () = assert!(CONNECTIONS < 1 << PLACE_BITS && SESSIONS < 1 << PLACE_BITS);

/// A datagram to send, in the caller's buffer: its length and its destination.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transmit {
    /// Cyclic data, to be sent from port [`IO_PORT`](crate::IO_PORT); to a group with time to live (TTL) 1.
    Io(usize, SocketAddrV4),
    /// Answer to a broadcast, to be sent from port [`PORT`](crate::PORT).
    Answer(usize, SocketAddrV4),
}

/// Counters of messages that the device could not serve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Dropped packets: of another source or an unknown connection, malformed, of a wrong length, or old.
    pub packets_dropped: u32,
    /// Refused requests for a connection.
    pub opens_refused: u32,
    /// Broadcasts without a free place for their answer.
    pub identities_lost: u32,
}

/// Numbers that other stations cannot guess without effort (SplitMix64).
#[derive(Clone, Debug)]
struct Random(u64);

impl Random {
    const fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// Returns an identifier for a place of a table, which no other place has.
    const fn id(&mut self, place: usize) -> u32 {
        ((self.next() as u32) << PLACE_BITS) | (place as u32).saturating_add(1)
    }
}

/// Events that the application has not taken yet.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Pending {
    left: Option<Cause>,
    is_connected: bool,
    is_idle: bool,
    has_outputs: bool,
    reset: Option<Reset>,
}

/// An adapter with `OUT` bytes of outputs and `IN` bytes of inputs.
///
/// Sans-I/O: the caller transfers frames and datagrams, and passes the time in microseconds, which must never run
/// backwards.
/// - Pass each frame of a TCP connection, as cut by a [`Receiver`](crate::Receiver), to [`request`](Self::request), and
///   report the end of the connection to [`closed`](Self::closed). Limit the number of connections and close those that
///   stay without a session: the device does not know them.
/// - Pass datagrams of UDP port [`PORT`](crate::PORT) to [`receive_datagram`](Self::receive_datagram), and datagrams of UDP
///   port [`IO_PORT`](crate::IO_PORT) to [`receive_packet`](Self::receive_packet).
/// - After each of these calls, call [`poll`](Self::poll) until it returns `None`. It handles time-outs, too.
/// - Call [`poll_transmit`](Self::poll_transmit) until it returns `None`. Each call returns one datagram to send.
/// - [`poll_timeout`](Self::poll_timeout) returns when to call the two again.
#[derive(Clone, Debug)]
pub struct Device<const OUT: usize, const IN: usize> {
    profile: Profile,
    network: Network,
    random: Random,
    outputs: [u8; OUT],
    inputs: [u8; IN],
    sessions: [Option<Session>; SESSIONS],
    /// The owner's place, further ones for cyclic data, and those for explicit messages.
    connections: [Option<Connection>; CONNECTIONS],
    /// The last answer in each connection with explicit messages, with its sequence count, and its length.
    answers: [([u8; MAX_SIZE as usize], usize); EXPLICIT_CONNECTIONS],
    /// Delayed answers: their time, their receiver, its request.
    identities: [Option<(u64, SocketAddrV4, Header)>; IDENTITIES],
    /// Whether the last connection with cyclic data has timed out.
    has_timed_out: bool,
    pending: Pending,
    counters: Counters,
}

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    /// Creates a device after power-up. Identifiers derive from `seed`, which must not be predictable.
    #[must_use]
    pub const fn new(profile: Profile, network: Network, seed: u64) -> Self {
        // An assembly fits into an answer, with a header as long as the one of outputs in a packet.
        const { assert!(OUT + 4 <= MAX_MESSAGE_LEN && IN + 4 <= MAX_MESSAGE_LEN) };
        Self {
            profile,
            network,
            random: Random(seed),
            outputs: [0; OUT],
            inputs: [0; IN],
            sessions: [const { None }; SESSIONS],
            connections: [const { None }; CONNECTIONS],
            answers: [([0; MAX_SIZE as usize], 0); EXPLICIT_CONNECTIONS],
            identities: [const { None }; IDENTITIES],
            has_timed_out: false,
            pending: Pending {
                left: None,
                is_connected: false,
                is_idle: false,
                has_outputs: false,
                reset: None,
            },
            counters: Counters { packets_dropped: 0, opens_refused: 0, identities_lost: 0 },
        }
    }

    /// Returns the outputs; zeros without an owner in run mode.
    #[must_use]
    pub const fn outputs(&self) -> &[u8; OUT] {
        &self.outputs
    }

    /// Sets the inputs for subsequent packets.
    pub const fn show_inputs(&mut self, inputs: &[u8; IN]) {
        self.inputs = *inputs;
    }

    /// Returns the state of the owner's connection.
    #[must_use]
    pub fn state(&self) -> State {
        self.owner().map_or(State::Unowned, |owner| owner.mode)
    }

    /// Returns the counters since the start.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Handles time-outs at time `now`. Returns the next event, if any.
    pub fn poll(&mut self, now: u64) -> Option<Event> {
        self.expire(now);
        let pending = &mut self.pending;
        if let Some(cause) = pending.left.take() {
            return Some(Event::Left(cause));
        }
        if core::mem::take(&mut pending.is_connected) {
            return Some(Event::Connected);
        }
        // Before the outputs that follow it, so that their first is known.
        if core::mem::take(&mut pending.is_idle) {
            return Some(Event::Idle);
        }
        if core::mem::take(&mut pending.has_outputs) {
            return Some(Event::Outputs);
        }
        if let Some(kind) = pending.reset.take() {
            return Some(Event::Reset(kind));
        }
        let is_over = |session: &&mut Option<Session>| session.as_ref().is_some_and(|it| it.is_over);
        self.sessions.iter_mut().find(is_over)?.take().map(|session| Event::Close(session.client))
    }

    /// Writes the next datagram that is due at time `now`.
    pub fn poll_transmit(&mut self, now: u64, buffer: &mut [u8; MAX_FRAME_LEN]) -> Option<Transmit> {
        self.expire(now);
        // Cyclic data first, because it has a deadline.
        self.transmit_inputs(now, buffer).or_else(|| self.transmit_identity(now, buffer))
    }

    /// Returns the time at which [`poll`](Self::poll) and [`poll_transmit`](Self::poll_transmit) must be called again
    /// without a reception.
    #[must_use]
    pub fn poll_timeout(&self, now: u64) -> u64 {
        if self.pending != Pending::default() || self.sessions.iter().flatten().any(|session| session.is_over)
        {
            return now;
        }
        let connections = self.connections().map(|it| it.until.min(it.next));
        let identities = self.identities.iter().flatten().map(|(due, ..)| *due);
        let sessions = self.sessions.iter().flatten().map(|session| session.until());
        connections.chain(identities).chain(sessions).min().unwrap_or(u64::MAX)
    }

    fn owner(&self) -> Option<&Connection> {
        self.connections.get(OWNER)?.as_ref()
    }

    fn connections(&self) -> impl Iterator<Item = &Connection> {
        self.connections.iter().flatten()
    }

    /// Returns whether inputs are sent for a connection that is not listen only.
    fn has_stream(&self) -> bool {
        self.connections().any(|it| matches!(it.kind, Kind::ExclusiveOwner | Kind::InputOnly))
    }

    /// Ends everything whose time has passed. Called before each reception and transmission, so that a late packet revives
    /// nothing and a new owner replaces one that has timed out.
    fn expire(&mut self, now: u64) {
        let is_over = |it: &&Connection| now >= it.until;
        while let Some(over) = self.connections.iter().flatten().find(is_over) {
            let (triad, client) = (over.triad, over.client.number);
            self.end(triad, Cause::Silence);
            // The TCP connection of an originator ends with the last connection that it has opened.
            if !self.connections().any(|it| it.client.number == client) {
                self.end_session(client);
            }
        }
        let is_idle = |it: &&Session| !it.is_over && now >= it.until();
        while let Some(client) = self.sessions.iter().flatten().find(is_idle).map(|it| it.client) {
            self.end_session(client);
        }
    }

    /// Ends a connection. Listen-only connections end with the last connection of another kind.
    fn end(&mut self, triad: Triad, cause: Cause) {
        let mut places = self.connections.iter_mut();
        let Some(ended) = places.find_map(|place| place.take_if(|it| it.triad == triad)) else { return };
        self.has_timed_out |= cause == Cause::Silence && ended.kind != Kind::Explicit;
        if ended.kind == Kind::ExclusiveOwner {
            self.outputs = [0; OUT];
            // Outputs that the application has not taken yet, and an owner that it does not know yet, are discarded.
            let Pending { left, is_connected, reset, .. } = self.pending;
            let left = if is_connected { left } else { Some(cause) };
            self.pending = Pending { left, reset, ..Pending::default() };
        }
        if !self.has_stream() {
            self.end_all(|it| it.kind == Kind::ListenOnly);
        }
    }

    /// Removes connections without an event.
    fn end_all(&mut self, is_it: impl Fn(&Connection) -> bool) {
        for place in &mut self.connections {
            place.take_if(|it| is_it(it));
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
