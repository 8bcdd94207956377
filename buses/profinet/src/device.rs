//! The device: its state, its connections, and the schedule of its frames.

use crate::alarm::{self, Alarms, Ends, Heard};
use crate::connect::{AlarmCr, Configuration, Iocr, Relation, Request};
use crate::cursor::{Reader, Writer};
use crate::cyclic::{self, Inputs, Received};
use crate::dcp::{self, About, Dcp, Reset};
use crate::epm;
use crate::frame::{ETHERTYPE_PROFINET, Frame, MAX_FRAME_LEN, MacAddress};
use crate::lldp;
use crate::profile::{Priority, Profile};
use crate::records::{self, Address, View};
use crate::rpc::{
    self, CONTROLLER_INTERFACE, DEVICE_INTERFACE, EPM_INTERFACE, Endpoint, Header, PnioStatus, RPC_PORT,
};
use crate::rpc::{access, kind, operation, server, status};
use crate::state::{Cause, Event, State};
use crate::station::{IpParameters, StationName, Stored};

/// Maximum length of a sent datagram in bytes.
const MAX_DATAGRAM_LEN: usize = 1_472;

/// Interval and number of the calls that request the controller's confirmation that the device is ready.
const CALL_INTERVAL_US: u64 = 2_000_000;
const CALL_TRIES: u8 = 5;

/// Block types of Control, of Release and of records.
mod block {
    pub(super) const WRITE: u16 = 0x0008;
    pub(super) const READ: u16 = 0x0009;
    pub(super) const END_OF_PARAMETERS: u16 = 0x0110;
    pub(super) const READY: u16 = 0x0112;
    pub(super) const RELEASE: u16 = 0x0114;
    /// Flag of a block in an answer.
    pub(super) const ANSWER: u16 = 0x8000;
    pub(super) const AR: u16 = 0x8101;
    pub(super) const IOCR: u16 = 0x8102;
    pub(super) const ALARM_CR: u16 = 0x8103;
}

/// Commands of Control and Release blocks.
mod command {
    pub(super) const END_OF_PARAMETERS: u16 = 1;
    pub(super) const READY: u16 = 2;
    pub(super) const RELEASE: u16 = 4;
    pub(super) const DONE: u16 = 8;
}

/// Index of a record with multiple writes.
const MULTIPLE_WRITE: u16 = 0xE040;

/// Error locations: the Control or Release block, counted over all block types.
const CONTROL_BLOCK: u8 = 22;
const RELEASE_BLOCK: u8 = 40;
/// Error location: ControlCommand in such a block.
const COMMAND_PARAMETER: u8 = 8;

/// Data to send, in the caller's buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transmit {
    /// An Ethernet frame of this length.
    Frame(usize),
    /// A UDP datagram of this length, from port [`RPC_PORT`] to this endpoint.
    Datagram(usize, Endpoint),
}

/// Progress of the connection to the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Waits for parameters, at most until `until`.
    Parameters {
        until: u64,
    },
    /// Waits for the confirmation of the controller; the next call is due at `due`.
    Ready {
        due: u64,
        tries: u8,
    },
    Data,
}

/// The connection to the controller.
#[derive(Clone, Debug)]
struct Connection {
    relation: Relation,
    input: Iocr,
    output: Iocr,
    expected: Configuration,
    phase: Phase,
    ends: Ends,
    low: Alarms,
    high: Alarms,
    /// Faults last reported to the controller as present.
    told: u32,
    /// Time of the next inputs.
    next_inputs: u64,
    /// Time of the last valid outputs, or of the controller's confirmation.
    heard: u64,
    last_counter: Option<u16>,
    /// Whether the last outputs were good.
    has_outputs: bool,
    /// Sequence number of the device's call to the controller.
    sequence: u32,
}

/// The last RPC response, kept for repeated requests.
#[derive(Clone, Debug)]
struct Response {
    to: Endpoint,
    activity: [u8; 16],
    sequence: u32,
    bytes: [u8; MAX_DATAGRAM_LEN],
    len: usize,
    is_due: bool,
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
        let unset = Endpoint { address: [0; 4], port: 0 };
        Self {
            profile,
            mac,
            session,
            name: stored.name,
            ip: stored.ip,
            stored,
            outputs: [0; OUT],
            inputs: [0; IN],
            faults: 0,
            dcp: Dcp::new(),
            connection: None,
            reader: None,
            connections: 0,
            response: Response {
                to: unset,
                activity: [0; 16],
                sequence: 0,
                bytes: [0; MAX_DATAGRAM_LEN],
                len: 0,
                is_due: false,
            },
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
                    self.refuse(from, &header, kind::REJECT, status);
                }
                return None;
            }
        };
        match header.kind {
            kind::REQUEST => self.serve(now, from, &header, body),
            kind::RESPONSE => self.confirm(now, from, &header, body),
            kind::PING => {
                if self.is_repeated(from, &header) {
                    self.response.is_due = true;
                } else {
                    self.answer(from, &Header { kind: kind::NO_CALL, ..header }, |_| {});
                }
                None
            }
            _ => None,
        }
    }

    /// Handles time-outs and starts alarms at time `now`. Returns the next event, if any.
    pub fn poll(&mut self, now: u64) -> Option<Event> {
        if core::mem::take(&mut self.is_stored_due) {
            return Some(Event::Stored);
        }
        if self
            .reader
            .as_ref()
            .is_some_and(|(relation, heard)| now >= heard.saturating_add(relation.activity_us))
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
        if core::mem::take(&mut self.response.is_due) {
            let Response { to, bytes, len, .. } = &self.response;
            let bytes = bytes.get(..*len)?;
            buffer.get_mut(..*len)?.copy_from_slice(bytes);
            return Some(Transmit::Datagram(*len, *to));
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
        consider(self.reader.as_ref().map(|(relation, heard)| heard.saturating_add(relation.activity_us)));
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
            Heard::Acknowledged(alarm) => {
                let bit = 1_u32.checked_shl(alarm.fault.into()).unwrap_or(0);
                connection.told = if alarm.appears { connection.told | bit } else { connection.told & !bit };
                None
            }
            Heard::Aborted => self.leave(Cause::Aborted),
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
        let Connection { output, last_counter, heard, has_outputs, .. } = connection;
        let received = cyclic::receive(payload, output, last_counter, profile, outputs)?;
        *heard = now;
        match received {
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
        let Self { connection, profile, inputs, mac, faults, .. } = self;
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

    /// Returns whether this request was the last one answered.
    fn is_repeated(&self, from: Endpoint, header: &Header) -> bool {
        let Response { to, activity, sequence, len, .. } = &self.response;
        *len > 0 && (*to, *activity, *sequence) == (from, header.activity, header.sequence)
    }

    /// Queues an answer.
    fn answer(&mut self, to: Endpoint, header: &Header, body: impl FnOnce(&mut Writer<'_>)) {
        let Response { bytes, .. } = &mut self.response;
        let mut writer = Writer::new(bytes);
        Header { boot_time: self.session, ..*header }.write(&mut writer, body);
        let len = writer.finish();
        let Response { to: peer, activity, sequence, len: place, is_due, .. } = &mut self.response;
        (*peer, *activity, *sequence) = (to, header.activity, header.sequence);
        *place = len.unwrap_or(0);
        *is_due = len.is_some();
    }

    fn refuse(&mut self, to: Endpoint, header: &Header, kind: u8, status: u32) {
        self.rpc_refused = self.rpc_refused.saturating_add(1);
        self.answer(to, &Header { kind, ..*header }, |writer| writer.u32_in(header.order, status));
    }

    /// Serves a request. Repeats the last answer for a repeated request.
    fn serve(&mut self, now: u64, from: Endpoint, header: &Header, body: &[u8]) -> Option<Event> {
        if self.is_repeated(from, header) {
            self.response.is_due = true;
            return None;
        }
        let header = Header { kind: kind::RESPONSE, ..*header };
        if header.interface == EPM_INTERFACE {
            self.serve_lookup(from, &header, body);
            return None;
        }
        if header.interface != DEVICE_INTERFACE {
            self.refuse(from, &header, kind::REJECT, status::NO_SUCH_INTERFACE);
            return None;
        }
        // Rejects a controller that addresses another device. All other calls identify the connection.
        if header.operation == operation::CONNECT && header.object != epm::object(self.profile) {
            self.refuse(from, &header, kind::REJECT, status::NO_SUCH_OBJECT);
            return None;
        }
        let Some((max_len, blocks)) = rpc::arguments(body, header.order) else {
            self.refuse(from, &header, kind::FAULT, status::PROTOCOL);
            return None;
        };
        let call = Call { now, from, header, max_len };
        match header.operation {
            operation::CONNECT => self.connect(&call, blocks),
            operation::RELEASE => self.release(&call, blocks),
            operation::READ => self.read(&call, blocks, false),
            operation::READ_IMPLICIT => self.read(&call, blocks, true),
            operation::WRITE => self.write(&call, blocks),
            operation::CONTROL => self.control(&call, blocks),
            _ => {
                self.refuse(from, &header, kind::REJECT, status::NO_SUCH_OPERATION);
                None
            }
        }
    }

    fn serve_lookup(&mut self, from: Endpoint, header: &Header, body: &[u8]) {
        let (profile, address, order) = (self.profile, self.ip.address, header.order);
        match header.operation {
            epm::LOOKUP => {
                let mut is_read = true;
                self.answer(from, header, |writer| {
                    is_read = epm::lookup(body, order, writer, profile, address).is_some();
                });
                if !is_read {
                    self.refuse(from, header, kind::FAULT, status::PROTOCOL);
                }
            }
            epm::FREE_HANDLE => self.answer(from, header, |writer| writer.fill(0, 24)),
            _ => self.refuse(from, header, kind::REJECT, status::NO_SUCH_OPERATION),
        }
    }

    /// Answers a call with a status and blocks.
    fn respond(&mut self, call: &Call, status: PnioStatus, body: impl FnOnce(&mut Writer<'_>)) {
        let Call { from, header, max_len, .. } = *call;
        self.answer(from, &header, |writer| rpc::response(writer, header.order, max_len, status, body));
    }

    fn connect(&mut self, call: &Call, blocks: &[u8]) -> Option<Event> {
        let request = match Request::parse(blocks, call.from, self.profile) {
            Ok(request) => request,
            Err(status) => {
                self.respond(call, status, |_| {});
                return None;
            }
        };
        let (Request::Access(relation) | Request::Io { relation, .. }) = request;
        // A repeated Connect means that the controller has lost the connection.
        let is_again = |other: &Relation| other.uuid == relation.uuid;
        let mut event = None;
        if self.connection.as_ref().is_some_and(|connection| is_again(&connection.relation)) {
            event = self.leave(Cause::Aborted);
        }
        if self.reader.as_ref().is_some_and(|(reader, _)| is_again(reader)) {
            self.reader = None;
        }
        let mac = self.mac;
        let reference = self.connections.wrapping_add(1);
        match request {
            Request::Access(_) if self.reader.is_none() => {
                self.reader = Some((relation, call.now));
                self.respond(call, PnioStatus::OK, |writer| ar_answer(writer, &relation, mac));
            }
            Request::Io { input, output, alarms, expected, .. } if self.connection.is_none() => {
                self.connections = reference;
                let connection =
                    Connection::new(call.now, relation, (input, output), alarms, expected, (mac, reference));
                let profile = self.profile;
                self.respond(call, PnioStatus::OK, |writer| {
                    ar_answer(writer, &relation, mac);
                    for (kind, iocr) in [(1, input), (2, output)] {
                        writer.block(block::IOCR, 0, |writer| {
                            writer.u16(kind);
                            writer.u16(iocr.reference);
                            writer.u16(iocr.frame_id);
                        });
                    }
                    writer.block(block::ALARM_CR, 0, |writer| {
                        writer.u16(1);
                        writer.u16(reference);
                        writer.u16(200);
                    });
                    if records::differs(&expected, profile) {
                        records::module_diff(writer, &expected, profile);
                    }
                });
                self.connection = Some(connection);
            }
            _ => self.respond(call, PnioStatus::connect_server(server::OUT_OF_ARS), |_| {}),
        }
        event
    }

    /// Parses a block of Control or Release of a known connection. Also returns whether that is the controller's.
    fn control_block(&self, blocks: &[u8], kind: u16) -> Option<(ControlBlock, bool)> {
        let block = ControlBlock::parse(blocks).filter(|block| block.kind == kind)?;
        let is_it =
            |relation: &Relation| (relation.uuid, relation.session_key) == (block.uuid, block.session_key);
        let is_controller = self.connection.as_ref().is_some_and(|connection| is_it(&connection.relation));
        let is_known = is_controller || self.reader.as_ref().is_some_and(|(relation, _)| is_it(relation));
        is_known.then_some((block, is_controller))
    }

    fn release(&mut self, call: &Call, blocks: &[u8]) -> Option<Event> {
        let Some((block, is_controller)) = self.control_block(blocks, block::RELEASE) else {
            self.respond(call, PnioStatus::release(0x40, server::AR_UNKNOWN), |_| {});
            return None;
        };
        if block.command != command::RELEASE {
            self.respond(call, PnioStatus::release(RELEASE_BLOCK, COMMAND_PARAMETER), |_| {});
            return None;
        }
        self.respond(call, PnioStatus::OK, |writer| block.answer(writer));
        if is_controller {
            return self.leave(Cause::Released);
        }
        self.reader = None;
        None
    }

    fn control(&mut self, call: &Call, blocks: &[u8]) -> Option<Event> {
        let Some((block, true)) = self.control_block(blocks, block::END_OF_PARAMETERS) else {
            self.respond(call, PnioStatus::control(0x40, server::AR_UNKNOWN), |_| {});
            return None;
        };
        let connection = self.connection.as_mut()?;
        let status = if block.command != command::END_OF_PARAMETERS {
            PnioStatus::control(CONTROL_BLOCK, COMMAND_PARAMETER)
        } else if !matches!(connection.phase, Phase::Parameters { .. }) {
            PnioStatus::control(0x40, server::STATE_CONFLICT)
        } else {
            connection.sequence = u32::from(connection.ends.reference);
            connection.phase = Phase::Ready { due: call.now, tries: CALL_TRIES };
            PnioStatus::OK
        };
        self.respond(call, status, |writer| {
            if status == PnioStatus::OK {
                block.answer(writer);
            }
        });
        None
    }

    /// Processes the controller's confirmation that the device is ready.
    fn confirm(&mut self, now: u64, from: Endpoint, header: &Header, body: &[u8]) -> Option<Event> {
        let activity = activity(self.session, self.mac);
        let connection = self.connection.as_mut()?;
        let Phase::Ready { tries, .. } = connection.phase else { return None };
        let is_it = from.address == connection.relation.host.address
            && (header.activity, header.sequence) == (activity, connection.sequence)
            && tries < CALL_TRIES;
        let mut reader = Reader::new(body);
        let status = reader.u32_in(header.order)?;
        reader.skip(16)?;
        let block = ControlBlock::parse(reader.rest())?;
        let is_done = status == 0
            && (block.kind, block.command) == (block::READY | block::ANSWER, command::DONE)
            && block.uuid == connection.relation.uuid;
        if !is_it || !is_done {
            return None;
        }
        connection.phase = Phase::Data;
        connection.heard = now;
        Some(Event::Connected)
    }

    fn read(&mut self, call: &Call, blocks: &[u8], is_implicit: bool) -> Option<Event> {
        let Some(record) = Record::parse(&mut Reader::new(blocks), block::READ) else {
            self.respond(call, PnioStatus::read(access::WRITE_LENGTH), |_| {});
            return None;
        };
        let is_controller =
            self.connection.as_ref().is_some_and(|connection| connection.relation.uuid == record.uuid);
        let is_reader = self.reader.as_ref().is_some_and(|(relation, _)| relation.uuid == record.uuid);
        if let Some((_, heard)) = self.reader.as_mut().filter(|_| is_reader) {
            *heard = call.now;
        }
        if let Some(connection) = self.connection.as_mut().filter(|_| is_controller) {
            connection.go_on(call.now);
        }
        let mut data = [0; MAX_RECORD_LEN];
        let max_len = call.max_len.saturating_sub(Record::ANSWER_LEN).min(record.len).min(data.len());
        let mut writer = Writer::new(data.get_mut(..max_len).unwrap_or(&mut []));
        let expected =
            self.connection.as_ref().filter(|_| is_controller).map(|connection| &connection.expected);
        let view = View {
            profile: self.profile,
            mac: self.mac,
            name: &self.name,
            ip: &self.ip,
            maintenance: &self.stored.maintenance,
            faults: self.faults,
            expected,
        };
        let result = if is_implicit || is_controller || is_reader {
            records::read(&view, record.address, &mut writer)
        } else {
            Err(access::DENIED)
        };
        // A record that does not fit is not returned at all.
        let result = result.and_then(|()| writer.finish().ok_or(access::WRITE_LENGTH));
        let status = result.map_or_else(PnioStatus::read, |_| PnioStatus::OK);
        let len = result.unwrap_or(0);
        self.respond(call, status, |writer| {
            record.answer(writer, block::READ, len, PnioStatus::OK);
            writer.bytes(data.get(..len).unwrap_or(&[]));
        });
        None
    }

    fn write(&mut self, call: &Call, blocks: &[u8]) -> Option<Event> {
        let mut reader = Reader::new(blocks);
        let Some((record, data)) = Record::parse_with_data(&mut reader) else {
            self.respond(call, PnioStatus::write(access::WRITE_LENGTH), |_| {});
            return None;
        };
        let before = self.stored.maintenance;
        let is_controller =
            self.connection.as_ref().is_some_and(|connection| connection.relation.uuid == record.uuid);
        if let Some(connection) = self.connection.as_mut().filter(|_| is_controller) {
            connection.go_on(call.now);
        }
        let mut maintenance = before;
        let profile = self.profile;
        let mut one = |record: &Record, data: &[u8]| {
            if is_controller {
                records::write(profile, record.address, data, &mut maintenance)
            } else {
                Err(access::DENIED)
            }
        };
        if record.address.index == MULTIPLE_WRITE && is_controller {
            let mut answers = Answers::default();
            let mut rest = Reader::new(data);
            while let Some((part, data)) = Record::parse_with_data(&mut rest) {
                let is_last = !answers.add(part, one(&part, data));
                // Parts start at multiples of four bytes.
                let filler = data.len().wrapping_neg() & 3;
                if is_last || rest.skip(filler).is_none() {
                    break;
                }
            }
            self.respond(call, PnioStatus::OK, |writer| {
                let len = answers.count.saturating_mul(Record::ANSWER_LEN);
                record.answer_write(writer, len, Ok(()));
                for (part, result) in answers.places.iter().flatten() {
                    part.answer_write(writer, 0, *result);
                }
            });
        } else {
            let result = one(&record, data);
            let status = result.map_or_else(PnioStatus::write, |()| PnioStatus::OK);
            self.respond(call, status, |writer| record.answer_write(writer, data.len(), result));
        }
        self.stored.maintenance = maintenance;
        (maintenance != before).then_some(Event::Stored)
    }
}

/// A request with the data for its answer.
#[derive(Clone, Copy, Debug)]
struct Call {
    now: u64,
    from: Endpoint,
    /// Header of the answer.
    header: Header,
    max_len: usize,
}

impl Connection {
    fn new(
        now: u64,
        relation: Relation,
        (input, output): (Iocr, Iocr),
        cr: AlarmCr,
        expected: Configuration,
        (mac, reference): (MacAddress, u16),
    ) -> Self {
        Self {
            relation,
            input,
            output,
            expected,
            phase: Phase::Parameters { until: now.saturating_add(relation.activity_us) },
            ends: Ends { mac, peer: relation.mac, reference, cr },
            low: Alarms::new(Priority::Low),
            high: Alarms::new(Priority::High),
            told: 0,
            next_inputs: now,
            heard: now,
            last_counter: None,
            has_outputs: false,
            sequence: 0,
        }
    }

    /// Returns when the controller's hold time expires without further outputs.
    const fn silent_at(&self) -> u64 {
        self.heard.saturating_add(self.output.hold_us)
    }

    /// Restarts the time-out for parameters.
    fn go_on(&mut self, now: u64) {
        if let Phase::Parameters { until } = &mut self.phase {
            *until = now.saturating_add(self.relation.activity_us);
        }
    }

    /// Starts alarms for unreported changes of faults, one at a time per priority.
    fn report_faults(&mut self, now: u64, faults: u32, profile: &Profile) {
        if self.phase != Phase::Data {
            return;
        }
        let cr = self.ends.cr;
        for (alarms, priority) in [(&mut self.high, Priority::High), (&mut self.low, Priority::Low)] {
            let is_of = |fault: &crate::Fault| {
                priority == if cr.is_low_only { Priority::Low } else { fault.priority }
            };
            let is_unreported = |bit: u32| (faults ^ self.told).checked_shr(bit).unwrap_or(0) & 1 == 1;
            let mut places = (0_u8..32).zip(profile.faults);
            let found = places.find(|(bit, fault)| is_unreported((*bit).into()) && is_of(fault));
            if let Some((bit, _)) = found.filter(|_| alarms.is_idle()) {
                let appears = faults.checked_shr(bit.into()).unwrap_or(0) & 1 == 1;
                alarms.send(now, bit, appears, faults != 0, &cr);
            }
        }
    }

    /// Writes the call that reports the device as ready, if it is due.
    fn call(&mut self, now: u64, buffer: &mut [u8], session: u32, mac: MacAddress) -> Option<usize> {
        let Phase::Ready { due, tries } = &mut self.phase else { return None };
        if *due > now || *tries == 0 {
            return None;
        }
        *due = now.saturating_add(CALL_INTERVAL_US);
        *tries = tries.saturating_sub(1);
        let header = Header {
            kind: kind::REQUEST,
            order: crate::cursor::Order::BigEndian,
            object: self.relation.object,
            interface: CONTROLLER_INTERFACE,
            activity: activity(session, mac),
            boot_time: session,
            version: 1,
            sequence: self.sequence,
            operation: operation::CONTROL,
        };
        let block = ControlBlock {
            kind: block::READY,
            uuid: self.relation.uuid,
            session_key: self.relation.session_key,
            command: command::READY,
        };
        let mut writer = Writer::new(buffer);
        header.write(&mut writer, |writer| {
            // Maximum length of the answer.
            writer.u32(ControlBlock::LEN as u32);
            rpc::counted(writer, header.order, ControlBlock::LEN, |writer| block.write(writer));
        });
        writer.finish()
    }
}

/// Returns the activity UUID of the device's calls, unique to the device and its start.
const fn activity(session: u32, mac: MacAddress) -> [u8; 16] {
    let [s0, s1, s2, s3] = session.to_be_bytes();
    let [a, b, c, d, e, f] = mac.0;
    [s0, s1, s2, s3, 0, 0, 0x10, 0, 0x80, 0, a, b, c, d, e, f]
}

/// Maximum length of a record that fits into an answer.
const MAX_RECORD_LEN: usize = 1_308;
const _: () = assert!(rpc::HEADER_LEN + 20 + Record::ANSWER_LEN + MAX_RECORD_LEN == MAX_DATAGRAM_LEN);

fn ar_answer(writer: &mut Writer<'_>, relation: &Relation, mac: MacAddress) {
    writer.block(block::AR, 0, |writer| {
        writer.u16(relation.kind);
        writer.bytes(&relation.uuid);
        writer.u16(relation.session_key);
        writer.bytes(&mac.0);
        // UDP port for real time over UDP, which is not supported.
        writer.u16(0x8892);
    });
}

/// A block of Control or Release.
#[derive(Clone, Copy, Debug)]
struct ControlBlock {
    kind: u16,
    uuid: [u8; 16],
    session_key: u16,
    command: u16,
}

impl ControlBlock {
    const LEN: usize = 32;

    fn parse(blocks: &[u8]) -> Option<Self> {
        let mut reader = Reader::new(blocks);
        let (kind, body) = crate::connect::next_block(&mut reader)?;
        let mut body = Reader::new(body);
        body.skip(2)?;
        let uuid = body.array()?;
        let session_key = body.u16()?;
        body.skip(2)?;
        let command = body.u16()?;
        body.skip(2)?;
        Some(Self { kind, uuid, session_key, command })
    }

    fn write(&self, writer: &mut Writer<'_>) {
        writer.block(self.kind, 0, |writer| {
            writer.u16(0);
            writer.bytes(&self.uuid);
            writer.u16(self.session_key);
            writer.u16(0);
            writer.u16(self.command);
            writer.u16(0);
        });
    }

    /// Writes the answer that the command is done.
    fn answer(&self, writer: &mut Writer<'_>) {
        Self { kind: self.kind | block::ANSWER, command: command::DONE, ..*self }.write(writer);
    }
}

/// Header of a record to read or write.
#[derive(Clone, Copy, Debug)]
struct Record {
    sequence: u16,
    uuid: [u8; 16],
    address: Address,
    len: usize,
}

impl Record {
    /// Length of the header in requests and answers.
    const ANSWER_LEN: usize = 64;

    fn parse(reader: &mut Reader<'_>, kind: u16) -> Option<Self> {
        let (found, body) = crate::connect::next_block(reader)?;
        let mut body = Reader::new(body);
        let sequence = body.u16()?;
        let uuid = body.array()?;
        let api = body.u32()?;
        let slot = body.u16()?;
        let subslot = body.u16()?;
        body.skip(2)?;
        let index = body.u16()?;
        let len = usize::try_from(body.u32()?).ok()?;
        body.skip(24)?;
        (found == kind).then_some(Self {
            sequence,
            uuid,
            address: Address { api, slot, subslot, index },
            len,
        })
    }

    /// Parses the next write with its data.
    fn parse_with_data<'a>(reader: &mut Reader<'a>) -> Option<(Self, &'a [u8])> {
        let record = Self::parse(reader, block::WRITE)?;
        Some((record, reader.bytes(record.len)?))
    }

    /// Writes the header of an answer. An answer to a read has no status of its own; pass OK.
    fn answer(&self, writer: &mut Writer<'_>, kind: u16, len: usize, status: PnioStatus) {
        writer.block(kind | block::ANSWER, 0, |writer| {
            writer.u16(self.sequence);
            writer.bytes(&self.uuid);
            writer.u32(self.address.api);
            writer.u16(self.address.slot);
            writer.u16(self.address.subslot);
            writer.u16(0);
            writer.u16(self.address.index);
            writer.u32(len as u32);
            writer.u32(0);
            writer.u32(status.0);
            writer.fill(0, 16);
        });
    }

    /// Writes the answer to a write.
    fn answer_write(&self, writer: &mut Writer<'_>, len: usize, result: Result<(), u8>) {
        let status = result.map_or_else(PnioStatus::write, |()| PnioStatus::OK);
        self.answer(writer, block::WRITE, len, status);
    }
}

/// Results of the parts of a multiple write.
#[derive(Default)]
struct Answers {
    places: [Option<(Record, Result<(), u8>)>; 16],
    count: usize,
}

impl Answers {
    /// Adds a result. Returns whether there is room for another one.
    fn add(&mut self, record: Record, result: Result<(), u8>) -> bool {
        if let Some(place) = self.places.get_mut(self.count) {
            *place = Some((record, result));
            self.count = self.count.saturating_add(1);
        }
        self.count < self.places.len()
    }
}

#[cfg(test)]
pub(crate) mod tests;
