//! EMCY: the faults that the bridge reports, and their codes.

use wsg_protocol::SystemFlags;

/// A fault that EMCY reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Emergency error code.
    pub code: u16,
    /// Bit of the error register, in addition to bit 0.
    pub register: u8,
    /// The fault in words.
    pub meaning: &'static str,
    cause: Cause,
}

/// Source of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cause {
    /// Flag of SYSSTATE.
    System(SystemFlags),
    /// The gripper has stopped answering.
    GripperSilent,
    /// Fault of the bus.
    Bus(bus_canopen::Cause),
}

const COMMUNICATION: u8 = 1 << 4;
const MANUFACTURER: u8 = 1 << 7;

const fn fault(code: u16, register: u8, cause: Cause, meaning: &'static str) -> Fault {
    Fault { code, register, meaning, cause }
}

/// All faults. Of several new ones, the first is reported first.
pub const FAULTS: [Fault; 10] = {
    use bus_canopen::Cause::{BusOff, MasterSilent, PdoLength};
    [
        fault(0xFF01, MANUFACTURER, Cause::System(SystemFlags::FAST_STOP), "FAST STOP"),
        fault(0x4200, 1 << 3, Cause::System(SystemFlags::TEMP_FAULT), "TEMP_FAULT"),
        fault(0x3000, 1 << 2, Cause::System(SystemFlags::POWER_FAULT), "POWER_FAULT"),
        fault(0x2000, 1 << 1, Cause::System(SystemFlags::CURR_FAULT), "CURR_FAULT"),
        fault(0x7000, MANUFACTURER, Cause::System(SystemFlags::FINGER_FAULT), "FINGER_FAULT"),
        fault(0xFF02, COMMUNICATION, Cause::GripperSilent, "the gripper does not answer"),
        fault(0x8130, COMMUNICATION, Cause::Bus(MasterSilent), "the master is silent"),
        fault(
            0x8140,
            COMMUNICATION,
            Cause::Bus(BusOff),
            "the bridge has recovered from bus-off (reported once)",
        ),
        fault(
            0x8210,
            COMMUNICATION,
            Cause::Bus(PdoLength),
            "an RPDO of wrong length was ignored (reported once)",
        ),
        fault(0x4210, 1 << 3, Cause::System(SystemFlags::TEMP_WARNING), "TEMP_WARNING"),
    ]
};

/// Faults without texts, which keeps the texts out of the image.
pub(super) const CODES: [bus_canopen::Fault; FAULTS.len()] = {
    let mut codes =
        [bus_canopen::Fault { code: 0, register: 0, cause: bus_canopen::Cause::Application }; FAULTS.len()];
    let mut at = 0;
    while at < FAULTS.len() {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            let Fault { code, register, cause, .. } = FAULTS[at];
            let cause = match cause {
                Cause::Bus(cause) => cause,
                Cause::System(_) | Cause::GripperSilent => bus_canopen::Cause::Application,
            };
            codes[at] = bus_canopen::Fault { code, register, cause };
        }
        at += 1;
    }
    codes
};

/// Causes without texts, for the same reason.
const CAUSES: [Cause; FAULTS.len()] = {
    let mut causes = [Cause::GripperSilent; FAULTS.len()];
    let mut at = 0;
    while at < FAULTS.len() {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            causes[at] = FAULTS[at].cause;
        }
        at += 1;
    }
    causes
};

const _: () = assert!(FAULTS.len() <= u16::BITS as usize);

/// Returns the active faults that the bridge itself detects: bit n for fault n of [`FAULTS`].
pub(super) fn present(system: SystemFlags, gripper_silent: bool) -> u16 {
    let mut present = 0;
    for (number, cause) in CAUSES.iter().enumerate() {
        let is_present = match cause {
            Cause::System(flag) => system.intersects(*flag),
            Cause::GripperSilent => gripper_silent,
            Cause::Bus(_) => false,
        };
        present |= u16::from(is_present) << number;
    }
    present
}
