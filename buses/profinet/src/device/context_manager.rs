//! The context manager: RPC calls that open, control and end connections and access records.

use super::blocks::{ControlBlock, Record, block, command};
use super::connection::{CALL_TRIES, Connection, Phase, activity};
use super::{Device, Transmit};
use crate::connect::{Relation, Request};
use crate::cursor::{Reader, Writer};
use crate::epm;
use crate::frame::MacAddress;
use crate::records::{self, View};
use crate::rpc::{self, DEVICE_INTERFACE, EPM_INTERFACE, Endpoint, Header, PnioStatus};
use crate::rpc::{access, kind, operation, server, status};
use crate::state::{Cause, Event};

/// Maximum length of a sent datagram in bytes.
const MAX_DATAGRAM_LEN: usize = 1_472;

/// Maximum length of a record that fits into an answer.
const MAX_RECORD_LEN: usize = 1_308;
const _: () = assert!(rpc::HEADER_LEN + 20 + Record::ANSWER_LEN + MAX_RECORD_LEN == MAX_DATAGRAM_LEN);

/// Index of a record with multiple writes.
const MULTIPLE_WRITE: u16 = 0xE040;

/// Error locations: the Control or Release block, counted over all block types.
const CONTROL_BLOCK: u8 = 22;
const RELEASE_BLOCK: u8 = 40;
/// Error location: ControlCommand in such a block.
const COMMAND_PARAMETER: u8 = 8;

/// The last RPC response, kept for repeated requests.
#[derive(Clone, Debug)]
pub(super) struct Response {
    to: Endpoint,
    activity: [u8; 16],
    sequence: u32,
    bytes: [u8; MAX_DATAGRAM_LEN],
    len: usize,
    pub(super) is_due: bool,
}

impl Response {
    pub(super) const fn new() -> Self {
        let to = Endpoint { address: [0; 4], port: 0 };
        Self { to, activity: [0; 16], sequence: 0, bytes: [0; MAX_DATAGRAM_LEN], len: 0, is_due: false }
    }

    /// Returns whether this request was the last one answered.
    pub(super) fn is_to(&self, from: Endpoint, header: &Header) -> bool {
        self.len > 0 && (self.to, self.activity, self.sequence) == (from, header.activity, header.sequence)
    }

    /// Writes the datagram if it is due.
    pub(super) fn transmit(&mut self, buffer: &mut [u8]) -> Option<Transmit> {
        if !core::mem::take(&mut self.is_due) {
            return None;
        }
        buffer.get_mut(..self.len)?.copy_from_slice(self.bytes.get(..self.len)?);
        Some(Transmit::Datagram(self.len, self.to))
    }
}

/// Datagram type and status that refuse an RPC request.
type Refusal = (u8, u32);
/// The event of a call, or the error to answer it with.
type Served = Result<Option<Event>, PnioStatus>;

/// A request with the data for its answer.
#[derive(Clone, Copy, Debug)]
struct Call {
    now: u64,
    from: Endpoint,
    /// Header of the answer.
    header: Header,
    max_len: usize,
}

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    pub(super) fn answer(&mut self, to: Endpoint, header: &Header, body: impl FnOnce(&mut Writer<'_>)) {
        let response = &mut self.response;
        let mut writer = Writer::new(&mut response.bytes);
        Header { boot_time: self.session, ..*header }.write(&mut writer, body);
        let len = writer.finish();
        (response.to, response.activity, response.sequence) = (to, header.activity, header.sequence);
        (response.len, response.is_due) = (len.unwrap_or(0), len.is_some());
    }

    pub(super) fn refuse(&mut self, to: Endpoint, header: &Header, (kind, status): Refusal) {
        self.rpc_refused = self.rpc_refused.saturating_add(1);
        self.answer(to, &Header { kind, ..*header }, |writer| writer.u32_in(header.order, status));
    }

    /// Serves a request. Repeats the last answer for a repeated request.
    pub(super) fn serve(&mut self, now: u64, from: Endpoint, header: &Header, body: &[u8]) -> Option<Event> {
        if self.response.is_to(from, header) {
            self.response.is_due = true;
            return None;
        }
        let header = Header { kind: kind::RESPONSE, ..*header };
        let served = match header.interface {
            EPM_INTERFACE => self.look_up(from, &header, body).map(|()| None),
            DEVICE_INTERFACE => self.call(now, from, header, body),
            _ => Err((kind::REJECT, status::NO_SUCH_INTERFACE)),
        };
        served.unwrap_or_else(|refusal| {
            self.refuse(from, &header, refusal);
            None
        })
    }

    fn look_up(&mut self, from: Endpoint, header: &Header, body: &[u8]) -> Result<(), Refusal> {
        let (profile, address, order) = (self.profile, self.ip.address, header.order);
        let mut is_read = Some(());
        match header.operation {
            epm::LOOKUP => self.answer(from, header, |writer| {
                is_read = epm::lookup(body, order, writer, profile, address);
            }),
            epm::FREE_HANDLE => self.answer(from, header, |writer| writer.fill(0, 24)),
            _ => return Err((kind::REJECT, status::NO_SUCH_OPERATION)),
        }
        is_read.ok_or((kind::FAULT, status::PROTOCOL))
    }

    fn call(
        &mut self,
        now: u64,
        from: Endpoint,
        header: Header,
        body: &[u8],
    ) -> Result<Option<Event>, Refusal> {
        // Rejects a controller that addresses another device. All other calls identify the connection.
        if header.operation == operation::CONNECT && header.object != epm::object(self.profile) {
            return Err((kind::REJECT, status::NO_SUCH_OBJECT));
        }
        let (max_len, blocks) = rpc::arguments(body, header.order).ok_or((kind::FAULT, status::PROTOCOL))?;
        let call = Call { now, from, header, max_len };
        let served = match header.operation {
            operation::CONNECT => self.connect(&call, blocks),
            operation::RELEASE => self.release(&call, blocks),
            operation::READ => self.read(&call, blocks, false),
            operation::READ_IMPLICIT => self.read(&call, blocks, true),
            operation::WRITE => self.write(&call, blocks),
            operation::CONTROL => self.control(&call, blocks),
            _ => return Err((kind::REJECT, status::NO_SUCH_OPERATION)),
        };
        Ok(served.unwrap_or_else(|status| {
            self.respond(&call, status, |_| {});
            None
        }))
    }

    /// Answers a call with a status and blocks.
    fn respond(&mut self, call: &Call, status: PnioStatus, body: impl FnOnce(&mut Writer<'_>)) {
        let Call { from, header, max_len, .. } = *call;
        self.answer(from, &header, |writer| rpc::response(writer, header.order, max_len, status, body));
    }

    fn connect(&mut self, call: &Call, blocks: &[u8]) -> Served {
        let request = Request::parse(blocks, call.from, self.profile)?;
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
                        let numbers = [kind, iocr.reference, iocr.frame_id];
                        writer.block(block::IOCR, 0, |writer| writer.u16s(&numbers));
                    }
                    writer.block(block::ALARM_CR, 0, |writer| writer.u16s(&[1, reference, 200]));
                    if records::differs(&expected, profile) {
                        records::module_diff(writer, &expected, profile);
                    }
                });
                self.connection = Some(connection);
            }
            _ => self.respond(call, PnioStatus::connect_server(server::OUT_OF_ARS), |_| {}),
        }
        Ok(event)
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

    fn release(&mut self, call: &Call, blocks: &[u8]) -> Served {
        let (block, is_controller) = self
            .control_block(blocks, block::RELEASE)
            .ok_or(PnioStatus::release(0x40, server::AR_UNKNOWN))?;
        if block.command != command::RELEASE {
            return Err(PnioStatus::release(RELEASE_BLOCK, COMMAND_PARAMETER));
        }
        self.respond(call, PnioStatus::OK, |writer| block.answer(writer));
        if is_controller {
            return Ok(self.leave(Cause::Released));
        }
        self.reader = None;
        Ok(None)
    }

    fn control(&mut self, call: &Call, blocks: &[u8]) -> Served {
        let (Some((block, true)), Some(connection)) =
            (self.control_block(blocks, block::END_OF_PARAMETERS), &mut self.connection)
        else {
            return Err(PnioStatus::control(0x40, server::AR_UNKNOWN));
        };
        if block.command != command::END_OF_PARAMETERS {
            return Err(PnioStatus::control(CONTROL_BLOCK, COMMAND_PARAMETER));
        }
        if !matches!(connection.phase, Phase::Parameters { .. }) {
            return Err(PnioStatus::control(0x40, server::STATE_CONFLICT));
        }
        connection.sequence = u32::from(connection.ends.reference);
        connection.phase = Phase::Ready { due: call.now, tries: CALL_TRIES };
        self.respond(call, PnioStatus::OK, |writer| block.answer(writer));
        Ok(None)
    }

    /// Processes the controller's confirmation that the device is ready.
    pub(super) fn confirm(
        &mut self,
        now: u64,
        from: Endpoint,
        header: &Header,
        body: &[u8],
    ) -> Option<Event> {
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
        connection.received = now;
        Some(Event::Connected)
    }

    /// Returns whether this is the controller's connection. Restarts its time-out for parameters.
    fn is_controller(&mut self, uuid: [u8; 16], now: u64) -> bool {
        let connection = self.connection.as_mut().filter(|connection| connection.relation.uuid == uuid);
        connection.map(|connection| connection.go_on(now)).is_some()
    }

    fn read(&mut self, call: &Call, blocks: &[u8], is_implicit: bool) -> Served {
        let record = Record::parse(&mut Reader::new(blocks), block::READ)
            .ok_or(PnioStatus::read(access::WRITE_LENGTH))?;
        let is_controller = self.is_controller(record.uuid, call.now);
        let reader = self.reader.as_mut().filter(|(relation, _)| relation.uuid == record.uuid);
        let is_reader = reader.map(|(_, received)| *received = call.now).is_some();
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
        Ok(None)
    }

    fn write(&mut self, call: &Call, blocks: &[u8]) -> Served {
        let (record, data) = Record::parse_with_data(&mut Reader::new(blocks))
            .ok_or(PnioStatus::write(access::WRITE_LENGTH))?;
        let before = self.stored.maintenance;
        let is_controller = self.is_controller(record.uuid, call.now);
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
        Ok((maintenance != before).then_some(Event::Stored))
    }
}

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
