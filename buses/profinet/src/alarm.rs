//! Alarms over RTA (IEC 61158-6-10, 4.7), one at a time per priority. Each is confirmed twice: by the transport's
//! acknowledgement and by the alarm's own.

use crate::connect::{AlarmCr, next_block};
use crate::cursor::{Reader, Writer};
use crate::frame::{self, ETHERTYPE_PROFINET, MacAddress};
use crate::profile::{Fault, Module, Priority, Profile};
use crate::rpc::PnioStatus;

/// Frame identifiers of alarms, by priority.
pub(crate) const HIGH: u16 = 0xFC01;
pub(crate) const LOW: u16 = 0xFE01;

/// PDU types of version 1.
mod pdu {
    pub(super) const DATA: u8 = 0x11;
    pub(super) const ACK: u8 = 0x13;
    pub(super) const ERR: u8 = 0x14;
}

/// AddFlags: window of one, immediate acknowledgement requested.
const WINDOW: u8 = 0x01;
const ACK_AT_ONCE: u8 = 0x10;

const DIAGNOSIS: u16 = 0x0001;
const DIAGNOSIS_GONE: u16 = 0x000C;

/// UserStructureIdentifier of channel diagnosis, and the channel number of the whole submodule.
pub(crate) const CHANNEL_DIAGNOSIS: u16 = 0x8000;
pub(crate) const WHOLE_SUBMODULE: u16 = 0x8000;

/// ChannelProperties: the diagnosis appears or disappears.
pub(crate) const APPEARS: u16 = 1 << 11;
const IS_GONE: u16 = 2 << 11;

/// AlarmSpecifier: channel diagnosis; diagnosis present on this submodule; diagnosis present in this connection.
const SPECIFIER_CHANNEL: u16 = 1 << 11;
const SPECIFIER_SUBMODULE: u16 = 1 << 13;
const SPECIFIER_AR: u16 = 1 << 15;

/// Contents of an alarm: the fault, whether it appears, and whether any fault is present.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Alarm {
    pub(crate) fault: u8,
    pub(crate) appears: bool,
    pub(crate) is_any: bool,
    number: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    /// Repeated until the transport acknowledges it.
    Sending {
        alarm: Alarm,
        due: u64,
        tries: u8,
    },
    /// Acknowledged by the transport, but not yet by the alarm's own acknowledgement.
    Sent(Alarm),
}

/// Result of a received frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AlarmEvent {
    /// The controller has acknowledged the alarm.
    Acknowledged(Alarm),
    /// The controller has aborted the connection.
    Aborted,
}

/// Alarms of one priority.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Alarms {
    priority: Priority,
    state: State,
    /// Sequence numbers of the last data frames: sent and acknowledged, and received.
    arrived: u16,
    received: u16,
    ack_due: bool,
    /// Number of the next alarm, modulo 2048.
    number: u16,
}

/// Addresses and references of both ends of the connection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ends {
    pub(crate) mac: MacAddress,
    pub(crate) peer: MacAddress,
    /// The device's reference for its end.
    pub(crate) reference: u16,
    pub(crate) cr: AlarmCr,
}

impl Alarms {
    pub(crate) const fn new(priority: Priority) -> Self {
        Self { priority, state: State::Idle, arrived: 0xFFFE, received: 0xFFFE, ack_due: false, number: 0 }
    }

    pub(crate) fn is_idle(&self) -> bool {
        self.state == State::Idle
    }

    /// Starts to send an alarm.
    pub(crate) fn send(&mut self, now: u64, fault: u8, appears: bool, is_any: bool, cr: &AlarmCr) {
        let alarm = Alarm { fault, appears, is_any, number: self.number };
        self.number = self.number.wrapping_add(1) & 0x07FF;
        self.state = State::Sending { alarm, due: now, tries: cr.retries.saturating_add(1) };
    }

    /// Processes a frame after its frame identifier.
    pub(crate) fn receive(&mut self, payload: &[u8], ends: &Ends) -> Option<AlarmEvent> {
        let mut reader = Reader::new(payload);
        let destination = reader.u16()?;
        let source = reader.u16()?;
        let kind = reader.u8()?;
        reader.skip(1)?;
        let number = reader.u16()?;
        let acknowledged = reader.u16()?;
        let len = reader.u16()?;
        let data = reader.bytes(len.into())?;
        if (destination, source) != (ends.reference, ends.cr.reference) {
            return None;
        }
        match kind {
            pdu::ERR => return Some(AlarmEvent::Aborted),
            pdu::ACK | pdu::DATA if acknowledged == following(self.arrived) => {
                if let State::Sending { alarm, tries, .. } = self.state
                    && tries <= ends.cr.retries
                {
                    self.state = State::Sent(alarm);
                    self.arrived = acknowledged;
                }
            }
            _ => {}
        }
        if kind != pdu::DATA {
            return None;
        }
        self.ack_due = number == self.received || number == following(self.received);
        if number != following(self.received) {
            return None;
        }
        self.received = number;
        let (kind, body) = next_block(&mut Reader::new(data))?;
        let mut body = Reader::new(body);
        body.skip(10)?;
        let specifier = body.u16()?;
        match self.state {
            // A negative status is an answer, too: repeating the alarm would change nothing.
            State::Sent(alarm) if kind == self.ack_block() && specifier & 0x07FF == alarm.number => {
                self.state = State::Idle;
                Some(AlarmEvent::Acknowledged(alarm))
            }
            _ => None,
        }
    }

    const fn ack_block(&self) -> u16 {
        match self.priority {
            Priority::High => 0x8001,
            Priority::Low => 0x8002,
        }
    }

    /// Returns whether all retries of an alarm have timed out.
    pub(crate) fn has_failed(&self, now: u64) -> bool {
        matches!(self.state, State::Sending { due, tries: 0, .. } if due <= now)
    }

    pub(crate) fn next_due(&self, now: u64) -> Option<u64> {
        match self.state {
            _ if self.ack_due => Some(now),
            State::Sending { due, .. } => Some(due),
            State::Idle | State::Sent(_) => None,
        }
    }

    /// Writes the frame that is due. Returns its length.
    pub(crate) fn transmit(
        &mut self,
        now: u64,
        buffer: &mut [u8],
        ends: &Ends,
        profile: &Profile,
    ) -> Option<usize> {
        if core::mem::take(&mut self.ack_due) {
            return frame(buffer, ends, self.priority, pdu::ACK, (self.arrived, self.received), |_| {});
        }
        let State::Sending { alarm, due, tries } = self.state else { return None };
        if due > now || tries == 0 {
            return None;
        }
        let due = now.saturating_add(ends.cr.timeout_us);
        self.state = State::Sending { alarm, due, tries: tries.saturating_sub(1) };
        let priority = self.priority;
        frame(buffer, ends, priority, pdu::DATA, (following(self.arrived), self.received), |writer| {
            notification(writer, alarm, priority, profile);
        })
    }
}

/// Returns the next sequence number. The first are FFFEh and FFFFh.
const fn following(number: u16) -> u16 {
    match number {
        0xFFFE => 0xFFFF,
        number => number.wrapping_add(1) & 0x7FFF,
    }
}

/// Writes the frame that aborts a connection. Returns its length.
pub(crate) fn abort(buffer: &mut [u8], ends: &Ends, reason: u8) -> Option<usize> {
    frame(buffer, ends, Priority::Low, pdu::ERR, (0xFFFE, 0xFFFE), |writer| {
        writer.u32(PnioStatus::abort(reason).0);
    })
}

fn frame(
    buffer: &mut [u8],
    ends: &Ends,
    priority: Priority,
    kind: u8,
    (number, acknowledged): (u16, u16),
    body: impl FnOnce(&mut Writer<'_>),
) -> Option<usize> {
    let mut writer = Writer::new(buffer);
    let (tag, frame_id) = match priority {
        Priority::High => (ends.cr.tag_high, HIGH),
        Priority::Low => (ends.cr.tag_low, LOW),
    };
    frame::header(&mut writer, ends.peer, ends.mac, Some(tag), ETHERTYPE_PROFINET);
    writer.u16s(&[frame_id, ends.cr.reference, ends.reference]);
    writer.bytes(&[kind, if kind == pdu::DATA { WINDOW | ACK_AT_ONCE } else { WINDOW }]);
    writer.u16s(&[number, acknowledged]);
    let length_at = writer.len();
    writer.u16(0);
    body(&mut writer);
    let len = writer.len().saturating_sub(length_at).saturating_sub(2);
    writer.put_u16(length_at, len as u16);
    frame::finish(writer)
}

/// Writes an AlarmNotification of the device access point.
fn notification(writer: &mut Writer<'_>, alarm: Alarm, priority: Priority, profile: &Profile) {
    let kind = if priority == Priority::High { 0x0001 } else { 0x0002 };
    let access_point = profile.module(0);
    let first = access_point.and_then(|module| module.submodules.first());
    writer.block(kind, 0, |writer| {
        writer.u16(if alarm.appears { DIAGNOSIS } else { DIAGNOSIS_GONE });
        writer.u32(0);
        writer.u16(0);
        writer.u16(first.map_or(1, |submodule| submodule.subslot));
        writer.u32(access_point.map_or(0, |module: &Module| module.ident));
        writer.u32(first.map_or(0, |submodule| submodule.ident));
        let any = if alarm.is_any { SPECIFIER_SUBMODULE | SPECIFIER_AR } else { 0 };
        writer.u16(alarm.number | SPECIFIER_CHANNEL | any);
        writer.u16s(&[CHANNEL_DIAGNOSIS, WHOLE_SUBMODULE]);
        let fault = profile.faults.get(usize::from(alarm.fault));
        writer.u16(if alarm.appears { APPEARS } else { IS_GONE });
        writer.u16(fault.map_or(0, |fault: &Fault| fault.error_type));
    });
}
