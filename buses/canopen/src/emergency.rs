//! EMCY: which faults are told, by which codes (CiA 301, 7.2.7).

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
    /// The device: the controller was bus-off, and is back. Told once.
    BusOff,
    /// The device: an RPDO had another length than its mapping says. Told once.
    PdoLength,
}

/// A set of faults: bit n is fault n of the table.
pub(crate) type Set = u16;

/// Which faults there are, which have been told, and what is to be told.
#[derive(Clone, Debug, Default)]
pub(crate) struct Emergency {
    present: Set,
    told: Set,
    /// Faults of a moment, to be told once.
    momentary: Set,
}

impl Emergency {
    pub(crate) const fn new() -> Self {
        Self { present: 0, told: 0, momentary: 0 }
    }

    /// The faults that last, as they are now.
    pub(crate) fn see(&mut self, faults: &[Fault], application: Set, master_silent: bool) {
        self.present = set_of(faults, Cause::Application) & application;
        if master_silent {
            self.present |= set_of(faults, Cause::MasterSilent);
        }
    }

    /// Something that is over already.
    pub(crate) fn happened(&mut self, faults: &[Fault], cause: Cause) {
        self.momentary |= set_of(faults, cause);
    }

    /// Object 1001h.
    pub(crate) fn register(&self, faults: &[Fault]) -> u8 {
        let mut register = 0;
        for (bit, fault) in bits().zip(faults) {
            if self.present & bit != 0 {
                register |= fault.register | 1;
            }
        }
        register
    }

    /// The next code to tell: that of a fault, the first of the table first, or 0 when one is over.
    pub(crate) fn next(&mut self, faults: &[Fault]) -> Option<u16> {
        let new = self.present & !self.told | self.momentary;
        if new != 0 {
            let lowest = new & new.wrapping_neg();
            self.told |= self.present & lowest;
            self.momentary &= !lowest;
            return faults.get(lowest.trailing_zeros() as usize).map(|fault| fault.code);
        }
        let over = self.told & !self.present;
        self.told &= self.present;
        (over != 0).then_some(0)
    }
}

/// The bits of a set, one after the other.
fn bits() -> impl Iterator<Item = Set> {
    (0..Set::BITS).map(|n| 1u16.wrapping_shl(n))
}

/// The faults with this cause.
fn set_of(faults: &[Fault], cause: Cause) -> Set {
    bits().zip(faults).filter(|(_, fault)| fault.cause == cause).fold(0, |set, (bit, _)| set | bit)
}
