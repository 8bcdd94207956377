//! The register interface as a PROFINET IO device (fieldbus, chapter 3): the device profile for `bus_profinet`.

use bus_profinet::{Fault, Module, Priority, Profile, Submodule};

use super::{Diagnosis, InputImage, OutputImage};
use wsg_protocol::types::SystemFlags;

/// A PROFINET device with both images.
pub type Device = bus_profinet::Device<{ OutputImage::LEN }, { InputImage::LEN }>;

/// The gripper's profile. Vendor and device ID are from the manual's GSDML file. The manual prints no ident numbers.
/// Each image is one module, so an edge and its values are never separated.
pub const PROFILE: Profile = Profile {
    vendor_id: 0x02A2,
    device_id: 0x0001,
    station_type: "WSG",
    order_id: "WSG",
    serial_number: "1",
    hardware_revision: 1,
    software_revision: [0, 1, 0],
    // In units of 31.25 us: 1 ms.
    min_interval: 32,
    modules: &MODULES,
    faults: &FAULTS,
};
const _: () = assert!(PROFILE.fits(OutputImage::LEN, InputImage::LEN));

static MODULES: [Module; 3] = [
    Module {
        slot: 0,
        ident: 0x0000_0001,
        name: "WSG",
        submodules: &[
            Submodule { subslot: 1, ident: 0x0000_0001, input_len: 0, output_len: 0 },
            Submodule { subslot: 0x8000, ident: 0x0000_8000, input_len: 0, output_len: 0 },
            Submodule { subslot: 0x8001, ident: 0x0000_8001, input_len: 0, output_len: 0 },
        ],
    },
    Module {
        slot: 1,
        ident: 0x0000_0010,
        name: "12 bytes in",
        submodules: &[Submodule {
            subslot: 1,
            ident: 0x0000_0011,
            input_len: InputImage::LEN as u16,
            output_len: 0,
        }],
    },
    Module {
        slot: 2,
        ident: 0x0000_0020,
        name: "8 bytes out",
        submodules: &[Submodule {
            subslot: 1,
            ident: 0x0000_0021,
            input_len: 0,
            output_len: OutputImage::LEN as u16,
        }],
    },
];

/// The flags that trigger the PROFIBUS diagnosis, each as a separate fault.
const FAULTS: [Fault; Diagnosis::TRIGGERS.bits().count_ones() as usize] = [
    fault(SystemFlags::SOFT_LIMIT_MINUS, "SOFT_LIMIT_MINUS"),
    fault(SystemFlags::SOFT_LIMIT_PLUS, "SOFT_LIMIT_PLUS"),
    fault(SystemFlags::FAST_STOP, "FAST_STOP"),
    fault(SystemFlags::TEMP_FAULT, "TEMP_FAULT"),
    fault(SystemFlags::POWER_FAULT, "POWER_FAULT"),
    fault(SystemFlags::CURR_FAULT, "CURR_FAULT"),
    fault(SystemFlags::FINGER_FAULT, "FINGER_FAULT"),
    fault(SystemFlags::CMD_FAILURE, "CMD_FAILURE"),
    fault(SystemFlags::SCRIPT_FAILURE, "SCRIPT_FAILURE"),
];

/// The first vendor-specific error type. The error type of a flag is this number plus its bit.
const FIRST_ERROR_TYPE: u16 = 0x0100;

const fn fault(flag: SystemFlags, name: &'static str) -> Fault {
    let error_type = FIRST_ERROR_TYPE.saturating_add(flag.bits().trailing_zeros() as u16);
    // A fault that stopped the fingers has priority.
    let priority = if flag.bits() == SystemFlags::FAST_STOP.bits() { Priority::High } else { Priority::Low };
    Fault { error_type, name, priority }
}

/// Converts a system state to a device's faults: bit n is fault n of the profile.
///
/// ```
/// use wsg_protocol::SystemFlags;
/// use wsg_fieldbus::profinet::{PROFILE, faults};
///
/// let shown = faults(SystemFlags::FAST_STOP | SystemFlags::MOVING);
/// assert_eq!(shown.count_ones(), 1);
/// let fault = &PROFILE.faults[shown.trailing_zeros() as usize];
/// assert_eq!((fault.name, fault.error_type), ("FAST_STOP", 0x010C));
/// ```
#[must_use]
pub fn faults(system: SystemFlags) -> u32 {
    let mut shown = 0;
    for (place, fault) in (0_u32..).zip(&FAULTS) {
        let bit = fault.error_type.saturating_sub(FIRST_ERROR_TYPE).into();
        let is_set = system.bits().checked_shr(bit).unwrap_or(0) & 1;
        shown |= is_set.checked_shl(place).unwrap_or(0);
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_diagnosis_flags_are_faults_each_with_its_bit_and_name() {
        for bit in 0..32 {
            let flag = SystemFlags::from_bits_retain(1 << bit);
            let shown = faults(flag);
            assert_eq!(shown.count_ones(), u32::from(Diagnosis::TRIGGERS.contains(flag)), "bit {bit}");
            if let Some(fault) = PROFILE.faults.get(shown.trailing_zeros() as usize) {
                assert_eq!(fault.error_type, 0x0100 + bit);
                assert_eq!(flag.iter_names().next().unwrap().0, fault.name);
                let stopped_the_fingers = flag == SystemFlags::FAST_STOP;
                assert_eq!(fault.priority, if stopped_the_fingers { Priority::High } else { Priority::Low });
            }
        }
    }
}
