//! Addresses of grippers, as written on the command line.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

use wsg_protocol::SystemLimits;
use wsg_protocol::can::Identifiers;
use wsg_protocol::driver::host::Udp;

/// Default TCP port of both protocols.
const TCP_PORT: u16 = 1000;
/// Default rate of a serial line in bit/s.
const RATE: u32 = 115_200;
/// Default rate of a CAN bus in kbit/s.
const KBIT: u16 = 500;

/// The address forms, for help and error messages.
pub(crate) const FORMS: &str = "\
tcp://HOST[:1000]                         binary protocol over TCP
udp://HOST[:1500][?answer=1501]           over UDP; the gripper replies to port 1501
serial:DEVICE[?rate=115200]               over RS-232
slcan:DEVICE[?kbit=500&id=120]            over CAN through an SLCAN adapter; id in hex
socketcan:INTERFACE[?id=120]              over CAN through an interface of Linux
gcl://HOST[:1000][?force=5..80&speed=5..420]
                                          text protocol (GCL) over TCP; the gripper reports neither limit
gcl+udp://HOST[:1500][?force=5..80&speed=5..420]
                                          text protocol (GCL) over UDP";

/// An address of a gripper: line, location and protocol.
///
/// ```
/// use wsg_tool::Address;
///
/// let address: Address = "tcp://192.168.1.20".parse()?;
/// assert_eq!(address.to_string(), "tcp://192.168.1.20:1000");
/// assert!("192.168.1.20".parse::<Address>().unwrap_err().contains("tcp://HOST"));
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum Address {
    /// The binary protocol over TCP, at `HOST:PORT`.
    Tcp(String),
    /// The binary protocol over UDP.
    Udp {
        /// `HOST:PORT`.
        gripper: String,
        /// The local port to which the gripper replies.
        answer_port: u16,
    },
    /// The binary protocol over RS-232.
    Serial {
        /// The serial port.
        device: String,
        /// The rate in bit/s.
        rate: u32,
    },
    /// The binary protocol over CAN, through an SLCAN adapter.
    Slcan {
        /// The serial port of the adapter.
        device: String,
        /// The rate of the bus in kbit/s.
        kbit: u16,
        /// The CAN identifiers of the gripper.
        identifiers: Identifiers,
    },
    /// The binary protocol over CAN, through an interface of Linux SocketCAN.
    SocketCan {
        /// The name of the interface, whose rate its administrator has set.
        interface: String,
        /// The CAN identifiers of the gripper.
        identifiers: Identifiers,
    },
    /// The text protocol (GCL) over TCP.
    Gcl {
        /// `HOST:PORT`.
        gripper: String,
        /// The limits of force and speed that the user states.
        limits: Option<SystemLimits>,
    },
    /// The text protocol (GCL) over UDP.
    GclUdp {
        /// `HOST:PORT`.
        gripper: String,
        /// The limits of force and speed that the user states.
        limits: Option<SystemLimits>,
    },
}

impl Address {
    /// Returns whether the address selects the text protocol (GCL).
    #[must_use]
    pub const fn is_gcl(&self) -> bool {
        matches!(self, Self::Gcl { .. } | Self::GclUdp { .. })
    }

    /// Returns the limits of force and speed for
    /// [`assume_limits`](wsg_protocol::driver::blocking::GclGripper::assume_limits), if the address states any.
    #[must_use]
    pub const fn limits(&self) -> Option<SystemLimits> {
        match self {
            Self::Gcl { limits, .. } | Self::GclUdp { limits, .. } => *limits,
            _ => None,
        }
    }
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let unknown = || format!("not a gripper address; expected one of:\n{FORMS}");
        let (scheme, rest) = text.split_once(':').ok_or_else(unknown)?;
        let (place, query) = rest.split_once('?').map_or((rest, None), |(place, query)| (place, Some(query)));
        let mut query = Query::new(query)?;
        let host = |port| {
            let wrong =
                || format!("wrong address `{text}`; expected {}://HOST[:PORT]", scheme.to_lowercase());
            with_port(place.strip_prefix("//").unwrap_or(place), port, wrong)
        };
        let name = |missing| {
            let name = place.strip_prefix("//").unwrap_or(place);
            if name.is_empty() { Err(missing) } else { Ok(name.to_owned()) }
        };
        let device = || name("missing device; expected a serial port such as /dev/ttyUSB0");
        let id = |query: &mut Query<'_>| {
            query.take("id", Identifiers::DEFAULT, identifiers, "an identifier in hex, up to 7FE")
        };
        // Schemes are not case-sensitive (RFC 3986, 3.1).
        let address = match scheme.to_ascii_lowercase().as_str() {
            "tcp" => Self::Tcp(host(TCP_PORT)?),
            "udp" => Self::Udp {
                gripper: host(Udp::GRIPPER_PORT)?,
                answer_port: query.take(
                    "answer",
                    Udp::ANSWER_PORT,
                    |text| text.parse().ok(),
                    "a port number",
                )?,
            },
            "serial" => Self::Serial {
                device: device()?,
                rate: query.take(
                    "rate",
                    RATE,
                    |text| text.parse().ok().filter(|rate| *rate > 0),
                    "a rate in bit/s",
                )?,
            },
            "slcan" => Self::Slcan {
                device: device()?,
                kbit: query.take("kbit", KBIT, |text| text.parse().ok().filter(is_kbit), KBIT_CHOICES)?,
                identifiers: id(&mut query)?,
            },
            "socketcan" => Self::SocketCan {
                interface: name("missing interface; expected its name, such as can0")?,
                identifiers: id(&mut query)?,
            },
            "gcl" => Self::Gcl { gripper: host(TCP_PORT)?, limits: query.limits()? },
            "gcl+udp" => Self::GclUdp { gripper: host(Udp::GRIPPER_PORT)?, limits: query.limits()? },
            _ => return Err(unknown()),
        };
        query.end()?;
        Ok(address)
    }
}

impl Display for Address {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(host) => write!(f, "tcp://{host}"),
            Self::Udp { gripper, .. } => write!(f, "udp://{gripper}"),
            Self::Serial { device, .. } => write!(f, "serial:{device}"),
            Self::Slcan { device, .. } => write!(f, "slcan:{device}"),
            Self::SocketCan { interface, .. } => write!(f, "socketcan:{interface}"),
            Self::Gcl { gripper, .. } => write!(f, "gcl://{gripper}"),
            Self::GclUdp { gripper, .. } => write!(f, "gcl+udp://{gripper}"),
        }
    }
}

/// Appends the default port to a host without one.
pub(crate) fn with_port(host: &str, port: u16, wrong: impl Fn() -> String) -> Result<String, String> {
    if host.trim_end_matches('/').is_empty() {
        return Err("missing host; expected a name or address such as 192.168.1.20".to_owned());
    }
    let host = host.strip_suffix('/').unwrap_or(host);
    let is_of_a_host = |char: char| char.is_alphanumeric() || "-._:[]%".contains(char);
    if host.is_empty() || !host.chars().all(is_of_a_host) || host.starts_with('[') != host.contains(']') {
        return Err(wrong());
    }
    // An IPv6 address contains colons, and needs brackets if a port follows.
    let has_port = match host.rsplit_once(':') {
        Some((before, port)) if !before.contains(':') || before.ends_with(']') => {
            port.parse::<u16>().map_err(|_| format!("invalid port `{port}`; expected 0 to 65535"))?;
            true
        }
        _ => false,
    };
    match (has_port, host.contains(':') && !host.starts_with('[')) {
        (true, _) => Ok(host.to_owned()),
        (false, true) => Ok(format!("[{host}]:{port}")),
        (false, false) => Ok(format!("{host}:{port}")),
    }
}

const KBIT_CHOICES: &str = "10, 20, 50, 100, 125, 250, 500, 800 or 1000";

fn is_kbit(kbit: &u16) -> bool {
    super::can::rate_of(*kbit).is_some()
}

fn identifiers(text: &str) -> Option<Identifiers> {
    Identifiers::from_base(u16::from_str_radix(text, 16).ok()?)
}

/// Parses `5..80`.
fn range(text: &str) -> Option<[f32; 2]> {
    let (least, greatest) = text.split_once("..")?;
    let (least, greatest) = (least.parse::<f32>().ok()?, greatest.parse::<f32>().ok()?);
    (0.0 <= least && least < greatest && greatest.is_finite()).then_some([least, greatest])
}

/// The `key=value` pairs after the `?`.
struct Query<'a> {
    pairs: Vec<(&'a str, &'a str)>,
}

impl<'a> Query<'a> {
    fn new(query: Option<&'a str>) -> Result<Self, String> {
        let pairs = query.into_iter().flat_map(|query| query.split('&'));
        let pairs = pairs.map(|pair| {
            pair.split_once('=').ok_or_else(|| format!("invalid parameter `{pair}`; expected key=value"))
        });
        Ok(Self { pairs: pairs.collect::<Result<_, _>>()? })
    }

    fn take<T>(
        &mut self,
        key: &str,
        default: T,
        parse: impl Fn(&str) -> Option<T>,
        expected: &str,
    ) -> Result<T, String> {
        let Some(place) = self.pairs.iter().position(|(name, _)| *name == key) else { return Ok(default) };
        let (_, value) = self.pairs.remove(place);
        parse(value).ok_or_else(|| format!("{key}={value}: expected {expected}"))
    }

    /// Takes the limits of force in N and speed in mm/s.
    fn limits(&mut self) -> Result<Option<SystemLimits>, String> {
        let mut take = |key| self.take(key, None, |text| range(text).map(Some), "two numbers such as 5..80");
        let (force, speed) = (take("force")?, take("speed")?);
        let mut limits = SystemLimits::UNKNOWN;
        if let Some([least, greatest]) = force {
            // GCL cannot turn overdrive on.
            limits = SystemLimits {
                min_force: least,
                nominal_force: greatest,
                overdrive_force: greatest,
                ..limits
            };
        }
        if let Some([least, greatest]) = speed {
            limits = SystemLimits { min_speed: least, max_speed: greatest, ..limits };
        }
        Ok((force.is_some() || speed.is_some()).then_some(limits))
    }

    fn end(self) -> Result<(), String> {
        match self.pairs.first() {
            Some((key, _)) => Err(format!("unknown or repeated parameter `{key}`")),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_parsed_with_its_defaults() {
        for (text, whole) in [
            ("tcp://192.168.1.20", "tcp://192.168.1.20:1000"),
            ("tcp://gripper.local:1001/", "tcp://gripper.local:1001"),
            ("tcp://::1", "tcp://[::1]:1000"),
            ("tcp://[::1]:1001", "tcp://[::1]:1001"),
            ("udp://10.0.0.1", "udp://10.0.0.1:1500"),
            ("serial:/dev/ttyUSB0", "serial:/dev/ttyUSB0"),
            ("serial:COM3?rate=57600", "serial:COM3"),
            ("slcan:/dev/ttyACM0?kbit=1000&id=60", "slcan:/dev/ttyACM0"),
            ("socketcan:can0?id=60", "socketcan:can0"),
            ("gcl://10.0.0.1", "gcl://10.0.0.1:1000"),
            ("gcl+udp://10.0.0.1", "gcl+udp://10.0.0.1:1500"),
            ("gcl://10.0.0.1?force=5..80", "gcl://10.0.0.1:1000"),
            ("TCP://Gripper.local", "tcp://Gripper.local:1000"),
            ("Serial:/dev/ttyUSB0", "serial:/dev/ttyUSB0"),
            ("GCL+UDP://10.0.0.1", "gcl+udp://10.0.0.1:1500"),
            ("tcp:10.0.0.1", "tcp://10.0.0.1:1000"),
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), whole);
        }
        let slcan = Address::Slcan {
            device: "/dev/ttyACM0".to_owned(),
            kbit: 1000,
            identifiers: Identifiers::from_base(0x60).unwrap(),
        };
        assert_eq!("slcan:/dev/ttyACM0?kbit=1000&id=60".parse(), Ok(slcan));
        let can = Address::SocketCan { interface: "can0".to_owned(), identifiers: Identifiers::DEFAULT };
        assert_eq!("SocketCAN:can0".parse(), Ok(can));
        let udp = Address::Udp { gripper: "h:1500".to_owned(), answer_port: 7 };
        assert_eq!("udp://h?answer=7".parse(), Ok(udp));
        let force = SystemLimits {
            min_force: 5.0,
            nominal_force: 80.0,
            overdrive_force: 80.0,
            ..SystemLimits::UNKNOWN
        };
        for (text, limits) in [
            ("gcl://h", None),
            ("gcl://h?force=5..80", Some(force)),
            (
                "gcl+udp://h?speed=2.5..420&force=5..80",
                Some(SystemLimits { min_speed: 2.5, max_speed: 420.0, ..force }),
            ),
        ] {
            assert_eq!(text.parse::<Address>().unwrap().limits(), limits, "{text}");
        }
    }

    #[test]
    fn invalid_address_is_rejected_with_the_expected_form() {
        for (text, expected) in [
            ("192.168.1.20", "tcp://HOST"),
            ("http://h", "tcp://HOST"),
            ("tcp://", "missing host"),
            ("tcp:/127.0.0.1", "wrong address `tcp:/127.0.0.1`; expected tcp://HOST[:PORT]"),
            ("tcp:///127.0.0.1", "wrong address"),
            ("UDP://http://h", "expected udp://HOST[:PORT]"),
            ("gcl://user@h", "wrong address `gcl://user@h`"),
            ("tcp://[::1", "wrong address"),
            ("tcp://h/x", "wrong address"),
            ("tcp://h h", "wrong address"),
            ("tcp://h:port", "invalid port `port`"),
            ("tcp://h?rate=1", "parameter `rate`"),
            ("serial:", "missing device"),
            ("serial:/dev/x?rate=fast", "a rate in bit/s"),
            ("serial:/dev/x?57600", "key=value"),
            ("slcan:/dev/x?kbit=400", "10, 20, 50"),
            ("slcan:/dev/x?id=7FF", "up to 7FE"),
            ("slcan:/dev/x?id=60&id=62", "repeated parameter `id`"),
            ("socketcan:", "missing interface; expected its name, such as can0"),
            // The interface has its own rate.
            ("socketcan:can0?kbit=500", "parameter `kbit`"),
            ("gcl://h?force=80", "force=80: expected two numbers such as 5..80"),
            ("gcl://h?force=80..5", "two numbers"),
            ("gcl://h?speed=-1..5", "two numbers"),
            ("gcl+udp://h?speed=5..inf", "two numbers"),
            // Over the binary protocol, the gripper reports them.
            ("tcp://h?force=5..80", "parameter `force`"),
        ] {
            let error = text.parse::<Address>().unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
