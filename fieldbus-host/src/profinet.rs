//! PROFINET: the device of `bus_profinet` on a network interface of Linux, with its own IP stack in addition to that of
//! the system.

#[cfg(target_os = "linux")]
mod interface;
#[cfg(target_os = "linux")]
mod ip;

#[cfg(target_os = "linux")]
pub use interface::Interface;

#[cfg(not(target_os = "linux"))]
use crate::Owner;
use bus_profinet::{IpParameters, Maintenance, StationName, Stored};
use std::net::Ipv4Addr;
use std::path::PathBuf;

/// An interface of a system without packet sockets, which never opens.
#[cfg(not(target_os = "linux"))]
#[derive(Debug)]
pub enum Interface {}

#[cfg(not(target_os = "linux"))]
impl Interface {
    /// Reports that this system does not have packet sockets.
    ///
    /// # Errors
    /// Always.
    pub fn open(name: &str) -> anyhow::Result<Self> {
        anyhow::bail!("PROFINET on {name}: packet sockets require Linux")
    }

    /// Is never called.
    pub async fn serve(self, _: Stored, _: u32, _: impl Owner) -> anyhow::Result<()> {
        match self {}
    }
}

/// The network interface of a PROFINET device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProfinetLine {
    /// The network interface, such as `eth0`. The gripper uses its Ethernet address but must have a different IP address.
    pub interface: String,
    /// The initial data of the station: name, IP parameters, I&M 1 to 3.
    pub stored: Stored,
    /// The file in which the owner saves changes.
    pub keep: Option<PathBuf>,
}

impl ProfinetLine {
    /// The key of the station name in a configuration file.
    pub const STATION: &str = "station";
    /// The key of the IP parameters in a configuration file.
    pub const IP: &str = "profinet-ip";
    /// The keys of I&M 1 (function, location), I&M 2 (date) and I&M 3 (descriptor) in a configuration file.
    pub const MAINTENANCE: [&str; 4] = ["im-function", "im-location", "im-date", "im-descriptor"];

    /// Returns all entries to save: key and text. An empty text is the factory setting.
    #[must_use]
    pub fn kept(stored: &Stored) -> [(&'static str, String); 6] {
        let Stored { name, ip, maintenance: Maintenance { function, location, date, descriptor } } = stored;
        let [function_key, location_key, date_key, descriptor_key] = Self::MAINTENANCE;
        [
            (Self::STATION, name.as_str().to_owned()),
            (Self::IP, if ip.is_set() { Self::ip_text(ip) } else { String::new() }),
            (function_key, Self::maintenance_text(function)),
            (location_key, Self::maintenance_text(location)),
            (date_key, Self::maintenance_text(date)),
            (descriptor_key, Self::maintenance_text(descriptor)),
        ]
    }

    /// Parses the entries of [`kept`](Self::kept) by their keys. A missing one is the factory setting.
    ///
    /// # Errors
    /// Returns the key of an invalid entry.
    pub fn stored_of<'a>(text: impl Fn(&str) -> Option<&'a str>) -> Result<Stored, &'static str> {
        fn field<const N: usize>(key: &'static str, text: Option<&str>) -> Result<[u8; N], &'static str> {
            ProfinetLine::maintenance_of_text(text.unwrap_or("")).ok_or(key)
        }
        let [function, location, date, descriptor] = Self::MAINTENANCE;
        let ip = text(Self::IP).filter(|text| !text.is_empty());
        Ok(Stored {
            name: StationName::new(text(Self::STATION).unwrap_or("")).ok_or(Self::STATION)?,
            ip: ip.map_or(Some(IpParameters::NONE), Self::ip_of_text).ok_or(Self::IP)?,
            maintenance: Maintenance {
                function: field(function, text(function))?,
                location: field(location, text(location))?,
                date: field(date, text(date))?,
                descriptor: field(descriptor, text(descriptor))?,
            },
        })
    }

    /// Converts a field of I&M to text without its padding blanks. A controller may write any bytes; they are Latin-1.
    fn maintenance_text(field: &[u8]) -> String {
        let text: String = field.iter().copied().map(char::from).collect();
        text.trim_end_matches(' ').to_owned()
    }

    /// Converts a text to a field of I&M; `None` if it does not fit.
    #[must_use]
    pub fn maintenance_of_text<const N: usize>(text: &str) -> Option<[u8; N]> {
        let mut field = [b' '; N];
        let mut places = field.iter_mut();
        for letter in text.chars() {
            *places.next()? = u8::try_from(letter).ok()?;
        }
        Some(field)
    }

    /// Formats IP parameters, such as `192.168.0.5/24`, or `192.168.0.5/24,192.168.0.1` with a router.
    #[must_use]
    pub fn ip_text(ip: &IpParameters) -> String {
        let address = Ipv4Addr::from(ip.address);
        let router = Ipv4Addr::from(ip.gateway);
        let bits = ip.prefix_len();
        if router.is_unspecified() {
            format!("{address}/{bits}")
        } else {
            format!("{address}/{bits},{router}")
        }
    }

    /// Parses IP parameters; `None` if they are invalid for a station.
    #[must_use]
    pub fn ip_of_text(text: &str) -> Option<IpParameters> {
        let (own, router) = text.split_once(',').map_or((text, None), |(own, router)| (own, Some(router)));
        let (address, bits) = own.split_once('/')?;
        let bits = bits.parse::<u32>().ok().filter(|bits| (1..=30).contains(bits))?;
        let mask = u32::MAX << (32 - bits);
        let router = router.map_or(Some(Ipv4Addr::UNSPECIFIED), |router| router.parse().ok())?;
        let ip = IpParameters {
            address: address.parse::<Ipv4Addr>().ok()?.octets(),
            mask: mask.to_be_bytes(),
            gateway: router.octets(),
        };
        ip.are_valid().then_some(ip)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maintenance_fields_survive_the_round_trip_through_text() {
        let mut stored = Stored::NONE;
        for (at, byte) in stored.maintenance.descriptor.iter_mut().enumerate() {
            *byte = (at * 5) as u8;
        }
        stored.ip = ProfinetLine::ip_of_text("10.0.0.5/8,10.0.0.1").unwrap();
        let kept = ProfinetLine::kept(&stored);
        let text_of = |key: &str| kept.iter().find(|(name, _)| *name == key).map(|(_, text)| text.as_str());
        assert_eq!(ProfinetLine::stored_of(text_of), Ok(stored));
        assert_eq!(ProfinetLine::stored_of(|_| None), Ok(Stored::NONE));
        assert_eq!(ProfinetLine::stored_of(|key| (key == "im-date").then_some("\u{100}")), Err("im-date"));
        assert_eq!(ProfinetLine::maintenance_of_text::<2>("abc"), None, "too long");
        assert_eq!(ProfinetLine::maintenance_of_text::<3>("a"), Some(*b"a  "));
    }
}
