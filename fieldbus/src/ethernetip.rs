//! The register interface as an EtherNet/IP adapter, which the real gripper does not have: the device profile for
//! `bus_ethernetip`. The images equal the images of the other buses, byte for byte.

use bus_ethernetip::Profile;

use super::{GripperFlags, InputImage, OutputImage};
use wsg_protocol::types::{Status, SystemFlags};

/// An EtherNet/IP adapter with both images.
pub type Device = bus_ethernetip::Device<{ OutputImage::LEN }, { InputImage::LEN }>;

/// The gripper's profile. ODVA has assigned no vendor number. With 0, the only matching keys have vendor 0, which accepts any
/// vendor.
/// Each image is one assembly, so an edge and its values are never separated.
///
/// The class of the registers has an instance for each Modbus function that reads registers: 3 (holding registers) and 4
/// (input registers). Its attributes are the addresses of the registers.
pub const PROFILE: Profile = Profile {
    vendor_id: 0,
    device_type: 0x2B,
    product_code: 1,
    revision: [1, 1],
    serial_number: 1,
    product_name: "WSG",
    output: 150,
    input: 100,
    configuration: 151,
    input_only: 152,
    listen_only: 153,
    register_class: Some(0x64),
    min_interval_us: 2_000,
    allows_multicast: true,
};
const _: () = assert!(PROFILE.is_valid());

/// The inputs while no gripper is connected. The bus has no mark for bad inputs, and zeros would look like a gripper at rest.
pub const NO_INPUTS: InputImage = InputImage {
    state: GripperFlags::ERROR,
    user: 0,
    system: SystemFlags::empty(),
    width: 0,
    force: 0,
    status: Status::IoError,
};
