//! The connection to the controller: its progress, its alarms, and the call that reports the device as ready.

use super::blocks::{ControlBlock, block, command};
use crate::alarm::{Alarms, Ends};
use crate::connect::{AlarmCr, Configuration, Iocr, Relation};
use crate::cursor::{Order, Writer};
use crate::frame::MacAddress;
use crate::profile::{Fault, Priority, Profile};
use crate::rpc::{self, CONTROLLER_INTERFACE, Header, kind, operation};

/// Interval and number of the calls that request the controller's confirmation that the device is ready.
const CALL_INTERVAL_US: u64 = 2_000_000;
pub(super) const CALL_TRIES: u8 = 5;

/// Progress of the connection to the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
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
pub(super) struct Connection {
    pub(super) relation: Relation,
    pub(super) input: Iocr,
    pub(super) output: Iocr,
    pub(super) expected: Configuration,
    pub(super) phase: Phase,
    pub(super) ends: Ends,
    pub(super) low: Alarms,
    pub(super) high: Alarms,
    /// Faults last reported to the controller as present.
    pub(super) reported: u32,
    /// Time of the next inputs.
    pub(super) next_inputs: u64,
    /// Time of the last valid outputs, or of the controller's confirmation.
    pub(super) received: u64,
    pub(super) last_counter: Option<u16>,
    /// Whether the last outputs were good.
    pub(super) has_outputs: bool,
    /// Sequence number of the device's call to the controller.
    pub(super) sequence: u32,
}

impl Connection {
    pub(super) fn new(
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
            reported: 0,
            next_inputs: now,
            received: now,
            last_counter: None,
            has_outputs: false,
            sequence: 0,
        }
    }

    /// Returns when the controller's hold time expires without further outputs.
    pub(super) const fn silent_at(&self) -> u64 {
        self.received.saturating_add(self.output.hold_us)
    }

    /// Restarts the time-out for parameters.
    pub(super) fn go_on(&mut self, now: u64) {
        if let Phase::Parameters { until } = &mut self.phase {
            *until = now.saturating_add(self.relation.activity_us);
        }
    }

    /// Starts alarms for unreported changes of faults, one at a time per priority.
    pub(super) fn report_faults(&mut self, now: u64, faults: u32, profile: &Profile) {
        if self.phase != Phase::Data {
            return;
        }
        let cr = self.ends.cr;
        for (alarms, priority) in [(&mut self.high, Priority::High), (&mut self.low, Priority::Low)] {
            let is_of =
                |fault: &Fault| priority == if cr.is_low_only { Priority::Low } else { fault.priority };
            let is_unreported = |bit: u32| (faults ^ self.reported).checked_shr(bit).unwrap_or(0) & 1 == 1;
            let mut places = (0_u8..32).zip(profile.faults);
            let found = places.find(|(bit, fault)| is_unreported((*bit).into()) && is_of(fault));
            if let Some((bit, _)) = found.filter(|_| alarms.is_idle()) {
                let appears = faults.checked_shr(bit.into()).unwrap_or(0) & 1 == 1;
                alarms.send(now, bit, appears, faults != 0, &cr);
            }
        }
    }

    /// Writes the call that reports the device as ready, if it is due.
    pub(super) fn call(
        &mut self,
        now: u64,
        buffer: &mut [u8],
        session: u32,
        mac: MacAddress,
    ) -> Option<usize> {
        let Phase::Ready { due, tries } = &mut self.phase else { return None };
        if *due > now || *tries == 0 {
            return None;
        }
        *due = now.saturating_add(CALL_INTERVAL_US);
        *tries = tries.saturating_sub(1);
        let header = Header {
            kind: kind::REQUEST,
            order: Order::BigEndian,
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
pub(super) const fn activity(session: u32, mac: MacAddress) -> [u8; 16] {
    let [s0, s1, s2, s3] = session.to_be_bytes();
    let [a, b, c, d, e, f] = mac.0;
    [s0, s1, s2, s3, 0, 0, 0x10, 0, 0x80, 0, a, b, c, d, e, f]
}
