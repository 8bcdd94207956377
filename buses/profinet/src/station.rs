//! What makes a device this one in its network: name, IP parameters, and what somebody wrote about it (I&M 1 to 3).

use core::fmt;

/// The name of a station: labels of `a` to `z`, `0` to `9` and `-`, with dots between them. Empty: it has none yet.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct StationName {
    bytes: [u8; Self::MAX_LEN],
    len: u8,
}

impl StationName {
    /// The longest name, in bytes.
    pub const MAX_LEN: usize = 240;

    /// No name, as a device is delivered.
    pub const NONE: Self = Self { bytes: [0; Self::MAX_LEN], len: 0 };

    /// The name, if it is one by the rules of PROFINET: up to 240 characters, labels of 1 to 63, none of which begins or ends
    /// with a hyphen; no IP address, and nothing that begins as the name of a port (`port-001`).
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

    /// The same from the wire.
    #[must_use]
    pub fn from_bytes(name: &[u8]) -> Option<Self> {
        let mut bytes = [0; Self::MAX_LEN];
        bytes.get_mut(..name.len())?.copy_from_slice(name);
        let mut labels = name.split(|byte| *byte == b'.');
        let is_name = name.is_empty() || (labels.all(is_label) && !is_address(name) && !is_port(name));
        is_name.then_some(Self { bytes, len: name.len() as u8 })
    }

    /// The name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(self.as_bytes()).unwrap_or("")
    }

    pub(crate) fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }

    /// Whether there is none.
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

/// `port-xyz` and `port-xyz-abcde`.
fn is_port(name: &[u8]) -> bool {
    let are_digits = |text: &[u8]| text.iter().all(u8::is_ascii_digit);
    match name.strip_prefix(b"port-") {
        Some([x, y, z]) => are_digits(&[*x, *y, *z]),
        Some([x, y, z, b'-', slot @ ..]) => slot.len() == 5 && are_digits(&[*x, *y, *z]) && are_digits(slot),
        _ => false,
    }
}

/// The IP parameters; all zero: there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IpParameters {
    /// The address.
    pub address: [u8; 4],
    /// The mask of its subnet.
    pub mask: [u8; 4],
    /// The router; the station's own address or zeros: there is none.
    pub gateway: [u8; 4],
}

impl IpParameters {
    /// No parameters, as a device is delivered.
    pub const NONE: Self = Self { address: [0; 4], mask: [0; 4], gateway: [0; 4] };

    /// Whether there is an address.
    #[must_use]
    pub fn is_set(&self) -> bool {
        *self != Self::NONE
    }

    /// How many bits of the address name the subnet.
    #[must_use]
    pub const fn prefix_len(&self) -> u8 {
        u32::from_be_bytes(self.mask).leading_ones() as u8
    }

    /// Whether a station can have them: none at all, or the address of one station with a mask without gaps.
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

/// What a person wrote about the device: I&M 1 to 3, blanks as delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Maintenance {
    /// What it is there for (I&M 1).
    pub function: [u8; 32],
    /// Where it is (I&M 1).
    pub location: [u8; 22],
    /// When it was installed (I&M 2), as `YYYY-MM-DD HH:MM`.
    pub date: [u8; 16],
    /// Anything (I&M 3).
    pub descriptor: [u8; 54],
}

impl Maintenance {
    /// As delivered.
    pub const NONE: Self =
        Self { function: [b' '; 32], location: [b' '; 22], date: [b' '; 16], descriptor: [b' '; 54] };
}

/// What has to outlast a power cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// The name.
    pub name: StationName,
    /// The IP parameters.
    pub ip: IpParameters,
    /// I&M 1 to 3.
    pub maintenance: Maintenance,
}

impl Stored {
    /// As delivered.
    pub const NONE: Self =
        Self { name: StationName::NONE, ip: IpParameters::NONE, maintenance: Maintenance::NONE };
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    #[test]
    fn names_are_as_long_as_labels_and_the_field_allow() {
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
    fn addresses_and_ports_are_no_names() {
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
    fn addresses_are_those_of_one_station_with_a_mask_without_gaps() {
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
