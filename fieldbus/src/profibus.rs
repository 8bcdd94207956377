//! The register interface as a PROFIBUS slave (fieldbus, chapter 2): what a slave of `bus_profibus` has to be. The diagnosis is
//! [`Diagnosis::device_part`].

use bus_profibus::{Address, Profile, identifiers_fit};

use super::{Diagnosis, InputImage, OutputImage};

/// A slave with both images and the diagnosis.
pub type Slave =
    bus_profibus::Slave<{ OutputImage::LEN }, { InputImage::LEN }, { Diagnosis::DEVICE_PART_LEN as usize }>;

/// The address as delivered (fieldbus, 2.2).
pub const ADDRESS: Address = Address::new(7);

/// The ident number is the manual's. The configuration is not printed there: one module for each image, consistent as a
/// whole, because an edge and the values that it goes with must not be torn apart.
///
/// There is no Sync: outputs that wait for it may be a FAST STOP, which waits for nothing.
pub static PROFILE: Profile = Profile {
    ident: Diagnosis::IDENT,
    config: &CONFIG,
    sync: false,
    freeze: false,
    fail_safe: true,
    set_address: false,
};

/// 8 bytes out, 12 bytes in.
const CONFIG: [u8; 2] = [0xA7, 0x9B];
const _: () = assert!(identifiers_fit(&CONFIG, OutputImage::LEN, InputImage::LEN));
