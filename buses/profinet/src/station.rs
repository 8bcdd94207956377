//! Individual data of a device in its network: name, IP parameters, and I&M 1 to 3.

use core::fmt;

/// Name of a station: labels of `a` to `z`, `0` to `9` and `-`, separated by dots. Empty if not assigned.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct StationName {
    bytes: [u8; Self::MAX_LEN],
    len: u8,
}

impl StationName {
    /// Maximum length of a name in bytes.
    pub const MAX_LEN: usize = 240;

    /// No name, the factory setting.
    pub const NONE: Self = Self { bytes: [0; Self::MAX_LEN], len: 0 };

    /// Creates a name, or returns `None` if PROFINET does not permit it. A name has up to 240 characters in labels of 1
    /// to 63, none of which starts or ends with a hyphen. IP addresses and names of ports (`port-001`) are invalid.
    ///
    /// ```
    /// use bus_profinet::StationName;
    ///
    /// assert_eq!(StationName::new("wsg-50.cell").unwrap().as_str(), "wsg-50.cell");
    /// for wrong in ["WSG", "wsg_50", "-wsg", "wsg-", "a..b", "192.168.0.1", "port-001", "port-001-00000"] {
    ///     assert_eq!(StationName::new(wrong), None, "{wrong}");
    /// }
    /// ```
    #[must_use]
    pub fn new(name: &str) -> Option<Self> {
        Self::from_bytes(name.as_bytes())
    }

    /// Creates a name from received bytes, with the same rules as [`new`](Self::new).
    #[must_use]
    pub fn from_bytes(name: &[u8]) -> Option<Self> {
        let mut bytes = [0; Self::MAX_LEN];
        bytes.get_mut(..name.len())?.copy_from_slice(name);
        let mut labels = name.split(|byte| *byte == b'.');
        let is_name = name.is_empty() || (labels.all(is_label) && !is_address(name) && !is_port(name));
        is_name.then_some(Self { bytes, len: name.len() as u8 })
    }

    /// Returns the name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(self.as_bytes()).unwrap_or("")
    }

    pub(crate) fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }

    /// Returns whether no name is assigned.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }
}

impl fmt::Debug for StationName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_str().fmt(f)
    }
}

fn is_label(label: &[u8]) -> bool {
    let is_allowed = |byte: &u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || *byte == b'-';
    (1..=63).contains(&label.len())
        && label.iter().all(is_allowed)
        && !label.starts_with(b"-")
        && !label.ends_with(b"-")
}

fn is_address(name: &[u8]) -> bool {
    let dots = name.iter().filter(|byte| **byte == b'.').count();
    dots == 3 && name.iter().all(|byte| *byte == b'.' || byte.is_ascii_digit())
}

/// Returns whether the name has the form `port-xyz` or `port-xyz-abcde`.
fn is_port(name: &[u8]) -> bool {
    let are_digits = |text: &[u8]| text.iter().all(u8::is_ascii_digit);
    match name.strip_prefix(b"port-") {
        Some([x, y, z]) => are_digits(&[*x, *y, *z]),
        Some([x, y, z, b'-', slot @ ..]) => slot.len() == 5 && are_digits(&[*x, *y, *z]) && are_digits(slot),
        _ => false,
    }
}

/// IP parameters; all zero if not assigned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IpParameters {
    /// IPv4 address of the station.
    pub address: [u8; 4],
    /// Mask of its subnet.
    pub mask: [u8; 4],
    /// Router. Without one, the station's own address or zeros.
    pub gateway: [u8; 4],
}

impl IpParameters {
    /// No parameters, the factory setting.
    pub const NONE: Self = Self { address: [0; 4], mask: [0; 4], gateway: [0; 4] };

    /// Returns whether parameters are assigned.
    #[must_use]
    pub fn is_set(&self) -> bool {
        *self != Self::NONE
    }

    /// Returns the prefix length of the subnet in bits.
    #[must_use]
    pub const fn prefix_len(&self) -> u8 {
        u32::from_be_bytes(self.mask).leading_ones() as u8
    }

    /// Returns whether the parameters are valid: all zero, or a host address with a contiguous mask.
    #[must_use]
    pub fn are_valid(&self) -> bool {
        let mask = u32::from_be_bytes(self.mask);
        let address = u32::from_be_bytes(self.address);
        let has_gaps = mask.leading_ones().saturating_add(mask.trailing_zeros()) < 32;
        let is_of_a_station = !matches!(self.address, [0 | 127 | 224..=255, ..])
            && address & !mask != 0
            && (address | mask) != u32::MAX;
        !self.is_set() || (!has_gaps && mask != 0 && is_of_a_station)
    }
}

/// I&M 1 to 3, written by users; blanks by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Maintenance {
    /// Function of the device in the plant (I&M 1).
    pub function: [u8; 32],
    /// Location of the device in the plant (I&M 1).
    pub location: [u8; 22],
    /// Installation date (I&M 2), as `YYYY-MM-DD HH:MM`.
    pub date: [u8; 16],
    /// Free text (I&M 3).
    pub descriptor: [u8; 54],
}

impl Maintenance {
    /// Blanks, the factory setting.
    pub const NONE: Self =
        Self { function: [b' '; 32], location: [b' '; 22], date: [b' '; 16], descriptor: [b' '; 54] };
}

/// Persistent data of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// Name of the station.
    pub name: StationName,
    /// IP parameters of the station.
    pub ip: IpParameters,
    /// I&M 1 to 3.
    pub maintenance: Maintenance,
}

impl Stored {
    /// The factory setting: no name, no IP parameters, blank I&M data.
    pub const NONE: Self =
        Self { name: StationName::NONE, ip: IpParameters::NONE, maintenance: Maintenance::NONE };
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    #[test]
    fn names_have_limits_per_label_and_in_total() {
        let label = "a".repeat(63);
        let longest = [label.as_str(), &label, &label, &"a".repeat(48)].join(".");
        assert_eq!(longest.len(), StationName::MAX_LEN);
        assert!(StationName::new(&longest).is_some());
        for wrong in [longest + "a", label + "a", String::from("a."), String::from(".a"), String::from("ä")]
        {
            assert_eq!(StationName::new(&wrong), None, "{wrong}");
        }
        for right in
            ["", "a", "1.2.3", "1.2.3.4.5", "a.1.2.3", "port-01", "port-0001", "port-001-0000", "port-abc"]
        {
            assert_eq!(StationName::new(right).unwrap().as_str(), right);
        }
        assert_eq!(StationName::from_bytes(&[0xFF]), None);
        assert_eq!(std::format!("{:?}", StationName::new("a-1").unwrap()), "\"a-1\"");
    }

    #[test]
    fn addresses_and_ports_are_invalid_names() {
        for wrong in ["192.168.0.1", "1.2.3.4", "port-001", "port-999", "port-001-00000", "port-123-45678"] {
            assert_eq!(StationName::new(wrong), None, "{wrong}");
        }
        for right in [
            "1.2.3.a",
            "a.2.3.4",
            "1-2.3.4.5",
            "port-00a",
            "port-a00",
            "port-001-0000a",
            "port-001-000000",
            "port-0a1-00000",
        ] {
            assert!(StationName::new(right).is_some(), "{right}");
        }
    }

    #[test]
    fn addresses_must_be_of_one_host_with_a_contiguous_mask() {
        let ip = |address, mask| IpParameters { address, mask, gateway: [0; 4] };
        for (address, mask, is_valid) in [
            ([192, 168, 0, 5], [255, 255, 255, 0], true),
            ([10, 0, 0, 1], [255, 255, 255, 252], true),
            ([223, 255, 255, 1], [255, 255, 255, 0], true),
            ([0; 4], [0; 4], true),
            ([0; 4], [255, 0, 0, 0], false),
            ([192, 168, 0, 5], [0; 4], false),
            ([192, 168, 0, 5], [255, 255, 0, 255], false),
            ([192, 168, 0, 5], [255; 4], false),
            ([192, 168, 0, 0], [255, 255, 255, 0], false),
            ([192, 168, 0, 255], [255, 255, 255, 0], false),
            ([127, 0, 0, 1], [255, 0, 0, 0], false),
            ([224, 0, 0, 1], [255, 0, 0, 0], false),
            ([255; 4], [255, 0, 0, 0], false),
        ] {
            assert_eq!(ip(address, mask).are_valid(), is_valid, "{address:?} {mask:?}");
        }
        assert_eq!(ip([10, 0, 0, 1], [255, 255, 255, 252]).prefix_len(), 30);
    }
}
