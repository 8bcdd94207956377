//! EMCY: which faults are told, by which codes (CiA 301, 7.2.7), and which there were (1003h).

use crate::clock::since;

/// A fault that is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The emergency error code.
    pub code: u16,
    /// The bit of the error register (1001h), beside bit 0, which every fault sets.
    pub register: u8,
    /// Who sees it.
    pub cause: Cause,
}

/// Who sees a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The application, which says so by [`Device::show_faults`](crate::Device::show_faults).
    Application,
    /// The device: the heartbeat of the master, or its RPDO, did not come in time.
    MasterSilent,
    /// The device: the controller was bus-off, and is back. Told once, and that it is over.
    BusOff,
    /// The device: an RPDO had another length than its mapping says. Told once, and that it is over.
    PdoLength,
}

/// Bit 0 of the error register.
const GENERIC: u8 = 1;

/// A set of faults: bit n is fault n of the table.
pub(crate) type Set = u16;

/// Faults that are remembered (1003h): a number that divides 256, because their counter wraps there.
pub(crate) const HISTORY: usize = 8;
const _: () = assert!(256 % HISTORY == 0);

/// An emergency to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    /// The emergency error code; 0 when a fault is over.
    pub(crate) code: u16,
    /// The error register with it.
    pub(crate) register: u8,
}

/// Which faults there are, which are to be told, and which were.
#[derive(Clone, Debug)]
pub(crate) struct Emergency {
    present: Set,
    /// To be told, even those that are over meanwhile.
    new: Set,
    /// Told, and their end was not.
    told: Set,
    sent_at: Option<u32>,
    /// The last that came, as a ring: where the next goes, and how many there are.
    past: [u32; HISTORY],
    next: u8,
    count: u8,
}

impl Emergency {
    pub(crate) const fn new() -> Self {
        Self { present: 0, new: 0, told: 0, sent_at: None, past: [0; HISTORY], next: 0, count: 0 }
    }

    /// The faults that last, as they are now. `info` is remembered with those that are new.
    pub(crate) fn see(&mut self, faults: &[Fault], application: Set, master_silent: bool, info: u8) {
        let mut present = set_of(faults, Cause::Application) & application;
        if master_silent {
            present |= set_of(faults, Cause::MasterSilent);
        }
        self.come(faults, present & !self.present, info);
        self.present = present;
    }

    /// Something that is over already. Where it was not told yet, it is told once.
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

    /// Object 1001h.
    pub(crate) fn register(&self, faults: &[Fault]) -> u8 {
        register_of(faults, self.present)
    }

    /// How many faults are remembered.
    pub(crate) const fn count(&self) -> u8 {
        self.count
    }

    /// One of them, the last first.
    pub(crate) fn past(&self, number: u8) -> Option<u32> {
        let at = usize::from(self.next.wrapping_sub(1).wrapping_sub(number)) % HISTORY;
        self.past.get(at).filter(|_| number < self.count).copied()
    }

    /// Forgets them.
    pub(crate) const fn forget_past(&mut self) {
        self.count = 0;
    }

    /// The next to send, so many milliseconds after the last at the soonest: a fault, the first of the table first, or that
    /// some are over.
    pub(crate) fn next(&mut self, faults: &[Fault], now_ms: u32, inhibit_ms: u32) -> Option<Message> {
        let over = self.told & !self.present & !self.new;
        if self.new | over == 0 || self.sent_at.is_some_and(|at| since(now_ms, at) < inhibit_ms) {
            return None;
        }
        self.sent_at = Some(now_ms);
        if self.new == 0 {
            self.told &= self.present;
            return Some(Message { code: 0, register: self.register(faults) });
        }
        let lowest = self.new & self.new.wrapping_neg();
        self.new &= !lowest;
        self.told |= lowest;
        let code = faults.get(lowest.trailing_zeros() as usize)?.code;
        Some(Message { code, register: register_of(faults, self.present | lowest) })
    }
}

/// The error register with these faults.
fn register_of(faults: &[Fault], present: Set) -> u8 {
    let those = bits().zip(faults).filter(|(bit, _)| present & bit != 0);
    those.fold(0, |register, (_, fault)| register | fault.register | GENERIC)
}

/// The bits of a set, one after the other.
fn bits() -> impl Iterator<Item = Set> {
    (0..Set::BITS).map(|n| 1u16.wrapping_shl(n))
}

/// The faults with this cause.
fn set_of(faults: &[Fault], cause: Cause) -> Set {
    bits().zip(faults).filter(|(_, fault)| fault.cause == cause).fold(0, |set, (bit, _)| set | bit)
}
