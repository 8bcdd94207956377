//! EMCY: which faults are told, by which codes (CiA 301, 7.2.7).

use wsg_protocol::SystemFlags;

/// A fault that is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The emergency error code.
    pub code: u16,
    /// The bit of the error register, beside bit 0.
    pub register: u8,
    /// What it is.
    pub meaning: &'static str,
    pub(super) cause: Cause,
}

/// Where a fault is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    /// A flag of SYSSTATE.
    System(SystemFlags),
    /// The gripper was there and is silent.
    GripperSilent,
    /// The heartbeat of the master, or its RPDO, did not come in time.
    MasterSilent,
    /// The controller was bus-off, and is back.
    BusOff,
    /// An RPDO had another length than the mapping says.
    PdoLength,
}

const COMMUNICATION: u8 = 1 << 4;
const MANUFACTURER: u8 = 1 << 7;

const fn fault(code: u16, register: u8, cause: Cause, meaning: &'static str) -> Fault {
    Fault { code, register, meaning, cause }
}

/// The faults. The first that is new is told first.
pub const FAULTS: [Fault; 10] = [
    fault(0xFF01, MANUFACTURER, Cause::System(SystemFlags::FAST_STOP), "FAST STOP"),
    fault(0x4200, 1 << 3, Cause::System(SystemFlags::TEMP_FAULT), "TEMP_FAULT"),
    fault(0x3000, 1 << 2, Cause::System(SystemFlags::POWER_FAULT), "POWER_FAULT"),
    fault(0x2000, 1 << 1, Cause::System(SystemFlags::CURR_FAULT), "CURR_FAULT"),
    fault(0x7000, MANUFACTURER, Cause::System(SystemFlags::FINGER_FAULT), "FINGER_FAULT"),
    fault(0xFF02, COMMUNICATION, Cause::GripperSilent, "the gripper is silent"),
    fault(0x8130, COMMUNICATION, Cause::MasterSilent, "the master is silent"),
    fault(0x8140, COMMUNICATION, Cause::BusOff, "the bridge was bus-off and is back (told once)"),
    fault(
        0x8210,
        COMMUNICATION,
        Cause::PdoLength,
        "an RPDO had a wrong length and was not taken (told once)",
    ),
    fault(0x4210, 1 << 3, Cause::System(SystemFlags::TEMP_WARNING), "TEMP_WARNING"),
];

/// Code, bit and cause alone, so that the words stay out of the image.
const CODES: [(u16, u8, Cause); FAULTS.len()] = {
    let mut codes = [(0, 0, Cause::BusOff); FAULTS.len()];
    let mut at = 0;
    while at < FAULTS.len() {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            codes[at] = (FAULTS[at].code, FAULTS[at].register, FAULTS[at].cause);
        }
        at += 1;
    }
    codes
};

/// A set of faults: bit n is fault n of [`FAULTS`].
pub(super) type Set = u16;
const _: () = assert!(FAULTS.len() <= Set::BITS as usize);

/// What is wrong now.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Causes {
    pub(super) system: SystemFlags,
    pub(super) gripper_silent: bool,
    pub(super) master_silent: bool,
}

/// Which faults there are, which have been told, and what is to be told.
#[derive(Clone, Debug, Default)]
pub(super) struct Emergency {
    present: Set,
    told: Set,
    /// Faults of a moment, to be told once.
    momentary: Set,
}

impl Emergency {
    pub(super) const fn new() -> Self {
        Self { present: 0, told: 0, momentary: 0 }
    }

    pub(super) fn see(&mut self, causes: &Causes) {
        self.present = 0;
        for (number, (_, _, cause)) in CODES.iter().enumerate() {
            let is_present = match cause {
                Cause::System(flag) => causes.system.intersects(*flag),
                Cause::GripperSilent => causes.gripper_silent,
                Cause::MasterSilent => causes.master_silent,
                Cause::BusOff | Cause::PdoLength => false,
            };
            self.present |= Set::from(is_present) << number;
        }
    }

    /// Something that is over already.
    pub(super) fn happened(&mut self, cause: Cause) {
        for (number, (_, _, other)) in CODES.iter().enumerate() {
            self.momentary |= Set::from(*other == cause) << number;
        }
    }

    /// Object 1001h.
    pub(super) fn register(&self) -> u8 {
        let mut register = 0;
        for (number, (_, bit, _)) in CODES.iter().enumerate() {
            if self.present >> number & 1 != 0 {
                register |= bit | 1;
            }
        }
        register
    }

    /// The next code to tell: that of a fault, or 0 when one is over.
    pub(super) fn next(&mut self) -> Option<u16> {
        let new = self.present & !self.told | self.momentary;
        if new != 0 {
            let number = new.trailing_zeros();
            self.told |= self.present & 1 << number;
            self.momentary &= !(1 << number);
            return CODES.get(number as usize).map(|(code, ..)| *code);
        }
        let over = self.told & !self.present;
        self.told &= self.present;
        (over != 0).then_some(0)
    }
}
