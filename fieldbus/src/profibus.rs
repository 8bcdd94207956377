//! The register interface as a PROFIBUS slave (fieldbus, chapter 2): the profile for `bus_profibus`. The diagnosis is
//! [`Diagnosis::device_part`].

use bus_profibus::{Address, Profile, identifiers_fit};

use super::{Diagnosis, InputImage, OutputImage};

/// A PROFIBUS slave with both images and the diagnosis.
pub type Slave =
    bus_profibus::Slave<{ OutputImage::LEN }, { InputImage::LEN }, { Diagnosis::DEVICE_PART_LEN as usize }>;

/// The factory default address (fieldbus, 2.2).
pub const ADDRESS: Address = Address::new(7);

/// The gripper's profile. The ident number is from the manual, which prints no configuration. Each image is one
/// module with consistency over its whole length, so an edge and its values are never separated.
///
/// Sync is not supported: it would delay a FAST STOP.
pub static PROFILE: Profile = Profile {
    ident: Diagnosis::IDENT,
    config: &CONFIG,
    sync: false,
    freeze: false,
    fail_safe: true,
    set_address: false,
};

/// 8 bytes out and 12 bytes in, each consistent over its whole length.
const CONFIG: [u8; 2] = [0xA7, 0x9B];
const _: () = assert!(identifiers_fit(&CONFIG, OutputImage::LEN, InputImage::LEN));
