//! Fixed properties of a device, its network interface, and the register map of its application.

use core::net::Ipv4Addr;

/// Group of the first host in a network (239.192.1.0), number of groups for a host, and mask of the hosts that differ.
const FIRST_GROUP: u32 = 0xEFC0_0100;
const GROUPS: u32 = 32;
const HOSTS: u32 = 0x3FF;

/// Fixed properties of a device. They must equal its EDS file.
#[derive(Clone, Copy, Debug)]
pub struct Profile {
    /// Vendor number, assigned by ODVA.
    pub vendor_id: u16,
    /// Device profile; 2Bh for a generic device.
    pub device_type: u16,
    /// Product number, assigned by the vendor.
    pub product_code: u16,
    /// Major and minor revision, each from 1; the major revision up to 127.
    pub revision: [u8; 2],
    /// Serial number, unique for all devices of the vendor.
    pub serial_number: u32,
    /// Product name, up to 32 ASCII characters.
    pub product_name: &'static str,
    /// Assembly with the outputs: connection point of the exclusive owner.
    pub output: u16,
    /// Assembly with the inputs: connection point of all connections.
    pub input: u16,
    /// Configuration assembly, of size 0.
    pub configuration: u16,
    /// Heartbeat assembly that makes a connection input only.
    pub input_only: u16,
    /// Heartbeat assembly that makes a connection listen only.
    pub listen_only: u16,
    /// Class of the application's [`Registers`], if any: vendor-specific, 64h to C7h or 300h to 4FFh.
    pub register_class: Option<u16>,
    /// Minimum requested packet interval (RPI) in µs.
    pub min_interval_us: u32,
    /// Whether originators may request inputs by multicast.
    pub allows_multicast: bool,
}

impl Profile {
    /// Returns whether the profile is valid. Intended for a `const` assertion.
    #[must_use]
    pub const fn is_valid(&self) -> bool {
        let Self { output: a, input: b, configuration: c, input_only: d, listen_only: e, .. } = *self;
        let are_different = a != b && a != c && a != d && a != e && b != c && b != d && b != e;
        are_different
            && c != d
            && c != e
            && d != e
            && self.product_name.len() <= 32
            && matches!(self.revision, [1..=127, 1..=255])
            && matches!(self.register_class, None | Some(0x64..=0xC7 | 0x300..=0x4FF))
            && self.min_interval_us >= 100
    }
}

/// The network interface of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Network {
    /// IPv4 address.
    pub address: Ipv4Addr,
    /// Mask of the subnet.
    pub mask: Ipv4Addr,
    /// Router; unspecified without one.
    pub gateway: Ipv4Addr,
    /// Ethernet address.
    pub mac: [u8; 6],
    /// Speed in Mbit/s, full duplex; 0 if unknown.
    pub speed: u32,
}

impl Network {
    /// Returns the group for inputs, as the number of the host in its network determines it (volume 2, chapter 3).
    pub(crate) fn group(&self) -> Ipv4Addr {
        // If the network is unknown, the whole address.
        let network = if self.mask == Ipv4Addr::BROADCAST { 0 } else { self.mask.to_bits() };
        let host = (self.address.to_bits() & !network).wrapping_sub(1) & HOSTS;
        Ipv4Addr::from_bits(FIRST_GROUP.saturating_add(host.saturating_mul(GROUPS)))
    }
}

/// General status of CIP (volume 1, appendix B): reason for a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    /// The connection manager refuses, with an extended status.
    ConnectionFailure = 0x01,
    /// The path is malformed.
    PathSegment = 0x04,
    /// The class does not exist.
    PathUnknown = 0x05,
    /// The object does not support the service.
    ServiceUnsupported = 0x08,
    /// The value is not allowed.
    InvalidValue = 0x09,
    /// The attribute is read-only.
    NotSettable = 0x0E,
    /// The client has no right to do this.
    PrivilegeViolation = 0x0F,
    /// The state of the device does not allow this now.
    StateConflict = 0x10,
    /// The answer does not fit into the connection.
    ReplyTooLarge = 0x11,
    /// The data is too short.
    TooShort = 0x13,
    /// The attribute does not exist.
    AttributeUnsupported = 0x14,
    /// The data is too long.
    TooLong = 0x15,
    /// The instance does not exist.
    NoInstance = 0x16,
    /// The electronic key in the path is of another device.
    KeyFailure = 0x25,
}

/// The application's values for explicit messages: an object class of the vendor.
///
/// Instances and attributes are the application's choice. Instance 0 stands for the class itself.
pub trait Registers {
    /// Writes a value to the front of `value` and returns its length.
    ///
    /// # Errors
    /// Returns the reason for a refusal.
    fn read(&mut self, instance: u16, attribute: u16, value: &mut [u8]) -> Result<usize, Status>;

    /// Sets a value. `is_owned` reports whether an exclusive owner is connected.
    ///
    /// # Errors
    /// Returns the reason for a refusal, which must change nothing.
    fn write(&mut self, instance: u16, attribute: u16, value: &[u8], is_owned: bool) -> Result<(), Status>;
}

/// No register map.
impl Registers for () {
    fn read(&mut self, _: u16, _: u16, _: &mut [u8]) -> Result<usize, Status> {
        Err(Status::NoInstance)
    }

    fn write(&mut self, _: u16, _: u16, _: &[u8], _: bool) -> Result<(), Status> {
        Err(Status::NoInstance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn group_follows_the_low_10_bits_of_the_host() {
        for (address, mask, group) in [
            ([192, 168, 0, 1], [255, 255, 255, 0], [239, 192, 1, 0]),
            ([192, 168, 7, 5], [255, 255, 255, 0], [239, 192, 1, 128]),
            ([10, 0, 4, 0], [255, 0, 0, 0], [239, 192, 128, 224]),
            ([10, 0, 4, 1], [255, 0, 0, 0], [239, 192, 1, 0]),
            // The network is unknown.
            ([192, 168, 1, 9], [255; 4], [239, 192, 34, 0]),
        ] {
            let [address, mask, group] = [address, mask, group].map(Ipv4Addr::from);
            let network = Network { address, mask, gateway: address, mac: [0; 6], speed: 100 };
            assert_eq!(network.group(), group);
        }
    }

    #[test]
    fn each_wrong_field_makes_a_profile_invalid() {
        let valid = crate::device::tests::PROFILE;
        // Pairs of numbers that are equal.
        let numbers = [valid.output, valid.input, valid.configuration, valid.input_only, valid.listen_only];
        for (at, other) in (0..5).flat_map(|at| (0..at).map(move |other| (at, other))) {
            let mut numbers = numbers;
            numbers[at] = numbers[other];
            let [output, input, configuration, input_only, listen_only] = numbers;
            let profile = Profile { output, input, configuration, input_only, listen_only, ..valid };
            assert!(!profile.is_valid(), "{numbers:?}");
        }
        for (profile, is_valid) in [
            (Profile { product_name: "12345678901234567890123456789012", ..valid }, true),
            (Profile { product_name: "123456789012345678901234567890123", ..valid }, false),
            (Profile { revision: [0, 1], ..valid }, false),
            (Profile { revision: [1, 0], ..valid }, false),
            (Profile { revision: [128, 1], ..valid }, false),
            (Profile { register_class: Some(0x63), ..valid }, false),
            (Profile { register_class: Some(0xC8), ..valid }, false),
            (Profile { min_interval_us: 99, ..valid }, false),
            (Profile { min_interval_us: 100, ..valid }, true),
        ] {
            assert_eq!(profile.is_valid(), is_valid, "{profile:?}");
        }
    }

    #[test]
    fn unit_has_no_registers() {
        assert_eq!(().read(1, 1, &mut [0; 8]), Err(Status::NoInstance));
        assert_eq!(().write(1, 1, &[0], false), Err(Status::NoInstance));
    }
}
