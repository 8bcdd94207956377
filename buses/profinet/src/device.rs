//! The device: its state, its connections, and the schedule of its frames.

mod blocks;
mod connection;
mod context_manager;

use self::connection::{Connection, Phase};
use self::context_manager::Response;
use crate::alarm::{self, AlarmEvent, Ends};
use crate::connect::Relation;
use crate::cursor::Reader;
use crate::cyclic::{self, Inputs, Received};
use crate::dcp::{self, About, Dcp, Reset};
use crate::frame::{ETHERTYPE_PROFINET, Frame, MAX_FRAME_LEN, MacAddress};
use crate::lldp;
use crate::profile::Profile;
use crate::rpc::{Endpoint, Header, RPC_PORT, kind};
use crate::state::{Cause, Event, State};
use crate::station::{IpParameters, StationName, Stored};

/// Data to send, in the caller's buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transmit {
    /// An Ethernet frame of this length.
    Frame(usize),
    /// A UDP datagram of this length, from port [`RPC_PORT`] to this endpoint.
    Datagram(usize, Endpoint),
}

/// Counters of requests that the device could not serve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// DCP requests without a free place for their answer.
    pub dcp_lost: u32,
    /// RPC datagrams that were rejected: damaged, fragmented, or for an unknown interface, object or operation.
    pub rpc_refused: u32,
}

/// An IO device with `OUT` bytes of outputs and `IN` bytes of inputs, which its profile must [fit](Profile::fits).
///
/// Sans-I/O: the caller transfers frames and datagrams, and passes the time in microseconds,
/// which must never run backwards.
/// - Pass Ethernet frames except IP to [`receive`](Self::receive), and UDP datagrams
///   to port [`RPC_PORT`] to [`receive_datagram`](Self::receive_datagram).
/// - Call [`poll_transmit`](Self::poll_transmit) until it returns `None`. Each call returns one
///   frame or datagram to send.
/// - Call [`poll`](Self::poll) until it returns `None`. It handles time-outs.
/// - [`poll_timeout`](Self::poll_timeout) returns when to call the two again.
#[derive(Clone, Debug)]
pub struct Device<const OUT: usize, const IN: usize> {
    profile: &'static Profile,
    mac: MacAddress,
    /// Number that differs between starts of the device.
    session: u32,
    name: StationName,
    ip: IpParameters,
    stored: Stored,
    outputs: [u8; OUT],
    inputs: [u8; IN],
    has_inputs: bool,
    faults: u32,
    dcp: Dcp,
    connection: Option<Connection>,
    /// The read-only connection, and the time of its last call.
    reader: Option<(Relation, u64)>,
    /// Number of connections so far.
    connections: u16,
    response: Response,
    farewell: Option<(Ends, u8)>,
    next_lldp: u64,
    /// Whether [`Event::Stored`] is pending, because a reset has reported [`Event::Left`] first.
    is_stored_due: bool,
    rpc_refused: u32,
}

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    /// Creates a device after power-up. `session` must differ between starts, so that controllers can distinguish them.
    #[must_use]
    pub const fn new(profile: &'static Profile, mac: MacAddress, stored: Stored, session: u32) -> Self {
        Self {
            profile,
            mac,
            session,
            name: stored.name,
            ip: stored.ip,
            stored,
            outputs: [0; OUT],
            inputs: [0; IN],
            has_inputs: true,
            faults: 0,
            dcp: Dcp::new(),
            connection: None,
            reader: None,
            connections: 0,
            response: Response::new(),
            farewell: None,
            next_lldp: 0,
            is_stored_due: false,
            rpc_refused: 0,
        }
    }

    /// Returns the present name of the station.
    #[must_use]
    pub const fn name(&self) -> &StationName {
        &self.name
    }

    /// Returns the present IP parameters.
    #[must_use]
    pub const fn ip(&self) -> &IpParameters {
        &self.ip
    }

    /// Returns the persistent data, to be saved by the caller.
    #[must_use]
    pub const fn stored(&self) -> &Stored {
        &self.stored
    }

    /// Returns the outputs; zeros without good outputs from a controller.
    #[must_use]
    pub const fn outputs(&self) -> &[u8; OUT] {
        &self.outputs
    }

    /// Sets the inputs for subsequent frames.
    pub const fn show_inputs(&mut self, inputs: &[u8; IN]) {
        self.inputs = *inputs;
        self.has_inputs = true;
    }

    /// Sends zeros that are marked as bad, until [`show_inputs`](Self::show_inputs). A controller does not use bad inputs.
    pub const fn show_bad_inputs(&mut self) {
        self.inputs = [0; IN];
        self.has_inputs = false;
    }

    /// Sets the present faults, bit n for entry n of [`Profile::faults`]. The controller gets an alarm when a fault
    /// appears or disappears. A fault that disappears before its alarm could be sent is not reported.
    pub const fn show_faults(&mut self, faults: u32) {
        self.faults = faults;
    }

    /// Returns the state of the connection to a controller.
    #[must_use]
    pub fn state(&self) -> State {
        match self.connection.as_ref().map(|connection| connection.phase) {
            None => State::Unconnected,
            Some(Phase::Parameters { .. }) => State::Parameters,
            Some(Phase::Ready { .. }) => State::Ready,
            Some(Phase::Data) => State::Data,
        }
    }

    /// Returns the counters since the start.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        Counters { dcp_lost: self.dcp.lost, rpc_refused: self.rpc_refused }
    }

    /// Processes an Ethernet frame without its checksum. Ignores other frames than PROFINET's.
    pub fn receive(&mut self, now: u64, frame: &[u8]) -> Option<Event> {
        let frame = Frame::parse(frame).filter(|frame| frame.ethertype == ETHERTYPE_PROFINET)?;
        let mut reader = Reader::new(frame.payload);
        let frame_id = reader.u16()?;
        match frame_id {
            dcp::GET_SET | dcp::IDENTIFY => self.receive_dcp(now, frame_id, &frame, reader.rest()),
            _ if frame.destination != self.mac => None,
            alarm::HIGH | alarm::LOW => self.receive_alarm(frame_id, &frame, reader.rest()),
            _ => self.receive_outputs(now, frame_id, &frame, reader.rest()),
        }
    }

    /// Processes a UDP datagram to port [`RPC_PORT`].
    pub fn receive_datagram(&mut self, now: u64, from: Endpoint, datagram: &[u8]) -> Option<Event> {
        let (header, body) = match Header::parse(datagram)? {
            Ok(request) => request,
            Err((header, status)) => {
                if header.kind == kind::REQUEST {
                    self.refuse(from, &header, (kind::REJECT, status));
                }
                return None;
            }
        };
        match header.kind {
            kind::REQUEST => self.serve(now, from, &header, body),
            kind::RESPONSE => self.confirm(now, from, &header, body),
            kind::PING => {
                if self.response.is_to(from, &header) {
                    self.response.is_due = true;
                } else {
                    self.answer(from, &Header { kind: kind::NO_CALL, ..header }, |_| {});
                }
                None
            }
            _ => None,
        }
    }

    /// Ends the connection to the controller as if the controller had been silent, for a caller that has missed frames. The controller
    /// may connect again.
    pub fn disconnect(&mut self) -> Option<Event> {
        self.leave(Cause::Silence)
    }

    /// Handles time-outs and starts alarms at time `now`. Returns the next event, if any.
    pub fn poll(&mut self, now: u64) -> Option<Event> {
        if core::mem::take(&mut self.is_stored_due) {
            return Some(Event::Stored);
        }
        if self
            .reader
            .as_ref()
            .is_some_and(|(relation, received)| now >= received.saturating_add(relation.activity_us))
        {
            self.reader = None;
        }
        let connection = self.connection.as_mut()?;
        if connection.low.has_failed(now) || connection.high.has_failed(now) {
            return self.leave(Cause::AlarmFailed);
        }
        match connection.phase {
            Phase::Parameters { until } if now >= until => self.leave(Cause::Silence),
            Phase::Ready { due, tries: 0 } if now >= due => self.leave(Cause::NotConfirmed),
            Phase::Data if now >= connection.silent_at() => self.leave(Cause::Silence),
            _ => {
                connection.report_faults(now, self.faults, self.profile);
                None
            }
        }
    }

    /// Writes the next frame or datagram that is due at time `now`.
    pub fn poll_transmit(&mut self, now: u64, buffer: &mut [u8; MAX_FRAME_LEN]) -> Option<Transmit> {
        if let Some((ends, reason)) = self.farewell.take() {
            return alarm::abort(buffer, &ends, reason).map(Transmit::Frame);
        }
        // Cyclic data first, because it has a deadline.
        if let Some(len) = self.transmit_inputs(now, buffer) {
            return Some(Transmit::Frame(len));
        }
        if let Some(datagram) = self.response.transmit(buffer) {
            return Some(datagram);
        }
        let (profile, session, mac) = (self.profile, self.session, self.mac);
        if let Some(connection) = &mut self.connection {
            for alarms in [&mut connection.high, &mut connection.low] {
                if let Some(len) = alarms.transmit(now, buffer, &connection.ends, profile) {
                    return Some(Transmit::Frame(len));
                }
            }
            if let Some(len) = connection.call(now, buffer, session, mac) {
                let to = Endpoint { address: connection.relation.host.address, port: RPC_PORT };
                return Some(Transmit::Datagram(len, to));
            }
        }
        let about = About { profile, mac, name: &self.name, ip: &self.ip };
        if let Some(len) = self.dcp.transmit(now, buffer, &about) {
            return Some(Transmit::Frame(len));
        }
        if now >= self.next_lldp {
            self.next_lldp = now.saturating_add(lldp::INTERVAL_US);
            return lldp::transmit(buffer, mac, &self.name, &self.ip).map(Transmit::Frame);
        }
        None
    }

    /// Returns the time at which [`poll`](Self::poll) and [`poll_transmit`](Self::poll_transmit) must be
    /// called again without a reception.
    #[must_use]
    pub fn poll_timeout(&self, now: u64) -> u64 {
        if self.is_stored_due || self.farewell.is_some() || self.response.is_due {
            return now;
        }
        let mut next = self.next_lldp;
        let mut consider = |due: Option<u64>| next = due.map_or(next, |due| next.min(due));
        consider(self.dcp.next_due());
        consider(
            self.reader.as_ref().map(|(relation, received)| received.saturating_add(relation.activity_us)),
        );
        if let Some(connection) = &self.connection {
            consider(Some(connection.next_inputs));
            consider(connection.low.next_due(now));
            consider(connection.high.next_due(now));
            consider(Some(match connection.phase {
                Phase::Parameters { until } => until,
                Phase::Ready { due, .. } => due,
                Phase::Data => connection.silent_at(),
            }));
        }
        next
    }

    fn receive_dcp(&mut self, now: u64, frame_id: u16, frame: &Frame<'_>, payload: &[u8]) -> Option<Event> {
        let about = About { profile: self.profile, mac: self.mac, name: &self.name, ip: &self.ip };
        let is_busy = self.connection.is_some();
        let wishes = self.dcp.receive(now, frame_id, frame, payload, &about, is_busy)?;
        let before = self.stored;
        let (name, ip) = (self.name, self.ip);
        if let Some((name, is_permanent)) = wishes.name {
            self.name = name;
            self.stored.name = if is_permanent { name } else { StationName::NONE };
        }
        if let Some((ip, is_permanent)) = wishes.ip {
            self.ip = ip;
            self.stored.ip = if is_permanent { ip } else { IpParameters::NONE };
        }
        let mut left = None;
        if let Some(reset) = wishes.reset {
            self.name = StationName::NONE;
            self.ip = IpParameters::NONE;
            self.stored = match reset {
                Reset::Communication => Stored { maintenance: before.maintenance, ..Stored::NONE },
                Reset::All => Stored::NONE,
            };
            self.reader = None;
            left = self.leave(Cause::Reset);
        }
        let is_changed = self.stored != before || self.name != name || self.ip != ip;
        // Reports the end of outputs immediately; a later event must not replace it.
        if left.is_some() {
            self.is_stored_due |= is_changed;
            return left;
        }
        if is_changed {
            return Some(Event::Stored);
        }
        wishes.signal.then_some(Event::Signal)
    }

    fn receive_alarm(&mut self, frame_id: u16, frame: &Frame<'_>, payload: &[u8]) -> Option<Event> {
        let connection =
            self.connection.as_mut().filter(|connection| connection.relation.mac == frame.source)?;
        let alarms = if frame_id == alarm::HIGH { &mut connection.high } else { &mut connection.low };
        match alarms.receive(payload, &connection.ends)? {
            AlarmEvent::Acknowledged(alarm) => {
                let bit = 1_u32.checked_shl(alarm.fault.into()).unwrap_or(0);
                connection.reported =
                    if alarm.appears { connection.reported | bit } else { connection.reported & !bit };
                None
            }
            AlarmEvent::Aborted => self.leave(Cause::Aborted),
        }
    }

    fn receive_outputs(
        &mut self,
        now: u64,
        frame_id: u16,
        frame: &Frame<'_>,
        payload: &[u8],
    ) -> Option<Event> {
        let Self { connection, profile, outputs, .. } = self;
        let connection = connection.as_mut().filter(|connection| {
            (connection.relation.mac, connection.output.frame_id) == (frame.source, frame_id)
        })?;
        if connection.phase != Phase::Data {
            return None;
        }
        // If the caller polls late, the hold time has expired all the same. A late frame
        // must not revive the connection.
        if now >= connection.silent_at() {
            return self.leave(Cause::Silence);
        }
        let Connection { output, last_counter, received, has_outputs, .. } = connection;
        let outcome = cyclic::receive(payload, output, last_counter, profile, outputs)?;
        *received = now;
        match outcome {
            Received::Good => {
                *has_outputs = true;
                Some(Event::Outputs)
            }
            Received::Bad => {
                outputs.fill(0);
                core::mem::take(has_outputs).then_some(Event::Cleared)
            }
        }
    }

    fn transmit_inputs(&mut self, now: u64, buffer: &mut [u8]) -> Option<usize> {
        let Self { connection, profile, inputs, has_inputs, mac, faults, .. } = self;
        let connection = connection.as_mut().filter(|connection| connection.next_inputs <= now)?;
        let cycle_us = connection.input.cycle_us().max(1);
        // The cycle counter is the scheduled time of this frame in 31.25 µs.
        let cycles = connection.next_inputs.checked_div(cycle_us).unwrap_or(0);
        let counter = cycles.wrapping_mul(connection.input.cycle.into()) as u16;
        // Skips cycles that were missed completely.
        let missed = now.saturating_sub(connection.next_inputs).checked_div(cycle_us).unwrap_or(0);
        connection.next_inputs =
            connection.next_inputs.saturating_add(cycle_us.saturating_mul(missed.saturating_add(1)));
        let inputs = Inputs {
            mac: *mac,
            peer: connection.relation.mac,
            data: inputs,
            has_data: *has_inputs,
            is_ready: !matches!(connection.phase, Phase::Parameters { .. }),
            has_problem: *faults != 0,
            counter,
        };
        cyclic::transmit(buffer, &connection.input, profile, &inputs)
    }

    /// Ends the connection to the controller.
    fn leave(&mut self, cause: Cause) -> Option<Event> {
        let connection = self.connection.take()?;
        if let Some(reason) = cause.reason() {
            self.farewell = Some((connection.ends, reason));
        }
        self.outputs = [0; OUT];
        Some(Event::Left(cause))
    }
}

#[cfg(test)]
pub(crate) mod tests;
