//! EMCY: fault reports and their codes (CiA 301, 7.2.7), and the fault history (1003h).

use crate::clock::age;

/// A fault reported by an emergency message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Emergency error code, by CiA 301.
    pub code: u16,
    /// Bit in the error register (1001h). Every fault also sets bit 0.
    pub register: u8,
    /// Source of the fault.
    pub cause: Cause,
}

/// Source of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Reported by the application through [`Device::show_faults`](crate::Device::show_faults).
    Application,
    /// Detected by the device: the master's heartbeat or RPDO timed out.
    MasterSilent,
    /// Detected by the device: the controller has recovered from bus-off. Reported once, then cleared.
    BusOff,
    /// Detected by the device: the length of an RPDO did not match its mapping. Reported once, then cleared.
    PdoLength,
}

/// Bit 0 of the error register: generic error.
const GENERIC: u8 = 1;

/// A set of faults: bit n is fault n of the table.
pub(crate) type Set = u16;

/// Length of the fault history (1003h). Must divide 256, because `next` wraps at 256.
pub(crate) const HISTORY: usize = 8;
const _: () = assert!(256 % HISTORY == 0);

/// An emergency message to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    /// Emergency error code; 0 reports that faults have cleared.
    pub(crate) code: u16,
    /// Error register at that time.
    pub(crate) register: u8,
}

/// Present, pending, reported and past faults.
#[derive(Clone, Debug)]
pub(crate) struct Emergency {
    present: Set,
    /// Not yet reported, including faults that have cleared since.
    new: Set,
    /// Reported as present, but not yet as cleared.
    reported: Set,
    sent_at: Option<u32>,
    /// Ring of past faults; `next` is the next position, `count` the number of valid ones.
    past: [u32; HISTORY],
    next: u8,
    count: u8,
}

impl Emergency {
    pub(crate) const fn new() -> Self {
        Self { present: 0, new: 0, reported: 0, sent_at: None, past: [0; HISTORY], next: 0, count: 0 }
    }

    /// Updates the present faults. `info` is recorded with new faults.
    pub(crate) fn see(&mut self, faults: &[Fault], application: Set, master_silent: bool, info: u8) {
        let mut present = set_of(faults, Cause::Application) & application;
        if master_silent {
            present |= set_of(faults, Cause::MasterSilent);
        }
        self.come(faults, present & !self.present, info);
        self.present = present;
    }

    /// Records a momentary fault. It is reported once, unless a report is already pending.
    pub(crate) fn happened(&mut self, faults: &[Fault], cause: Cause, info: u8) {
        self.come(faults, set_of(faults, cause) & !self.new, info);
    }

    fn come(&mut self, faults: &[Fault], coming: Set, info: u8) {
        self.new |= coming;
        for (_, fault) in bits().zip(faults).filter(|(bit, _)| coming & bit != 0) {
            if let Some(place) = self.past.get_mut(usize::from(self.next) % HISTORY) {
                *place = u32::from(info) << 16 | u32::from(fault.code);
            }
            self.next = self.next.wrapping_add(1);
            self.count = (HISTORY as u8).min(self.count.saturating_add(1));
        }
    }

    /// Returns the error register, object 1001h.
    pub(crate) fn register(&self, faults: &[Fault]) -> u8 {
        register_of(faults, self.present)
    }

    /// Returns the number of recorded faults, at most [`HISTORY`].
    pub(crate) const fn count(&self) -> u8 {
        self.count
    }

    /// Returns a recorded fault; 0 is the latest.
    pub(crate) fn past(&self, number: u8) -> Option<u32> {
        let at = usize::from(self.next.wrapping_sub(1).wrapping_sub(number)) % HISTORY;
        self.past.get(at).filter(|_| number < self.count).copied()
    }

    /// Clears the fault history.
    pub(crate) const fn forget_past(&mut self) {
        self.count = 0;
    }

    /// Returns the next message, at the earliest `inhibit_ms` after the last one. New faults come first, in order of
    /// the table, then the report that faults have cleared.
    pub(crate) fn next(&mut self, faults: &[Fault], now_ms: u32, inhibit_ms: u32) -> Option<Message> {
        let over = self.reported & !self.present & !self.new;
        let is_inhibited = self.sent_at.as_mut().is_some_and(|at| age(now_ms, at) < inhibit_ms);
        if self.new | over == 0 || is_inhibited {
            return None;
        }
        self.sent_at = Some(now_ms);
        if self.new == 0 {
            self.reported &= self.present;
            return Some(Message { code: 0, register: self.register(faults) });
        }
        let lowest = self.new & self.new.wrapping_neg();
        self.new &= !lowest;
        self.reported |= lowest;
        let code = faults.get(lowest.trailing_zeros() as usize)?.code;
        Some(Message { code, register: register_of(faults, self.present | lowest) })
    }
}

/// Returns the error register for these faults.
fn register_of(faults: &[Fault], present: Set) -> u8 {
    let those = bits().zip(faults).filter(|(bit, _)| present & bit != 0);
    those.fold(0, |register, (_, fault)| register | fault.register | GENERIC)
}

/// Iterates over the bits of a set, from the lowest.
fn bits() -> impl Iterator<Item = Set> {
    (0..Set::BITS).map(|n| 1u16.wrapping_shl(n))
}

/// Returns the faults with this cause.
fn set_of(faults: &[Fault], cause: Cause) -> Set {
    bits().zip(faults).filter(|(_, fault)| fault.cause == cause).fold(0, |set, (bit, _)| set | bit)
}
