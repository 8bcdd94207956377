//! The lines of a gripper: addresses, serial lines and CAN buses, as the user specifies them.

use bus_profinet::{IpParameters, Maintenance, Stored};
use std::net::Ipv4Addr;
use std::net::SocketAddr;
use std::path::PathBuf;
use wsg_protocol::can::Identifiers;

/// The lines on which a gripper is served. Each is optional.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lines {
    /// TCP: the address to listen on. With port 0, the system chooses the port.
    pub tcp: Option<SocketAddr>,
    /// UDP: the address to listen on.
    pub udp: Option<UdpLine>,
    /// RS-232, on a real or emulated serial line.
    pub serial: Option<SerialLine>,
    /// The folder with the scripts that the page lists, edits and runs.
    pub scripts: Option<PathBuf>,
    /// The file to which the system log is appended.
    pub system_log: Option<PathBuf>,
    /// The CAN bus and the gripper's identifiers on it.
    pub can: Option<CanLine>,
    /// The text protocol (GCL) over TCP: the address to listen on.
    pub gcl: Option<SocketAddr>,
    /// The text protocol (GCL) over UDP: the address to listen on. Answers go to the source port of the request.
    pub gcl_udp: Option<SocketAddr>,
    /// How many datagrams are sent to a UDP client that sends nothing before its updates end. `None`: 1000 for clients
    /// on other machines, because the sender of a datagram can be forged. 0: unlimited, as the manual specifies.
    pub udp_unanswered: Option<u32>,
    /// Modbus/TCP: the address to listen on. The real gripper uses port 502.
    pub modbus: Option<SocketAddr>,
    /// PROFIBUS DP over a serial line. A device is set to 115200 8N1, a rate that no real PROFIBUS uses.
    pub profibus: Option<SerialLine>,
    /// PROFINET IO on a network interface.
    pub profinet: Option<ProfinetLine>,
    /// The control interface, HTTP with JSON: the address to listen on. A client has the same control as an operator
    /// beside the gripper, so keep it on the loopback interface.
    pub control: Option<SocketAddr>,
    /// Hosts accepted in the `Host` header of requests to the control interface, in addition to `localhost` and the
    /// address that received the request. Other hosts are rejected as a protection against DNS rebinding.
    pub control_hosts: Vec<String>,
    /// A Lua script that runs on the gripper from power-up.
    pub script: Option<PathBuf>,
    /// The latency of the command interface.
    pub profile: Profile,
    /// Seed that selects the frames hit by line faults, which the control interface sets.
    pub seed: u64,
}

/// The latency of the command interface (the binary protocol and GCL).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Profile {
    /// Answers are sent immediately.
    #[default]
    Instant,
    /// The latency of real grippers according to field reports: a client that requests three values in turn, one
    /// request at a time, gets them 15 times a second. Each frame is sent 22 ms late and at least 5 ms after the previous one.
    Real,
}

/// A UDP address and the port for answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UdpLine {
    /// The address to listen on; grippers in the field use port 1500.
    pub address: SocketAddr,
    /// The port for answers, regardless of the source port of the request; 1501 in the field.
    pub remote_port: u16,
}

/// The network interface of a PROFINET device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProfinetLine {
    /// The network interface, such as `eth0`. The gripper uses its Ethernet address but must have a different IP address.
    pub interface: String,
    /// The initial data of the station: name, IP parameters, I&M 1 to 3.
    pub stored: Stored,
    /// The configuration file in which changes are saved.
    pub keep: Option<PathBuf>,
}

impl ProfinetLine {
    /// The key of the station name in the configuration file.
    pub const STATION: &str = "station";
    /// The key of the IP parameters in the configuration file.
    pub const IP: &str = "profinet-ip";
    /// The keys of I&M 1 (function, location), I&M 2 (date) and I&M 3 (descriptor) in the configuration file.
    pub const MAINTENANCE: [&str; 4] = ["im-function", "im-location", "im-date", "im-descriptor"];

    /// Returns all entries saved in the configuration file: key and text. An empty text is the factory setting.
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

/// A serial line to serve.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SerialLine {
    /// A pseudo terminal created by the server. Unix only; opening it fails elsewhere.
    Pty,
    /// A Unix socket at this path, to which clients connect. Unix only; opening it fails elsewhere.
    Unix(PathBuf),
    /// An existing serial port, such as `/dev/ttyUSB0` or `COM3`; set to 115200 8N1.
    Device(PathBuf),
}

/// The CAN bus of a gripper.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanLine {
    /// The connection to the bus.
    pub bus: CanBus,
    /// The gripper's receive and transmit identifiers.
    pub identifiers: Identifiers,
}

/// The connection to a CAN bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CanBus {
    /// A network interface of Linux SocketCAN, such as `can0`.
    Interface(String),
    /// A serial line that carries CAN frames by SLCAN. A pseudo terminal or Unix socket acts as an adapter to its
    /// client; a device must have an adapter connected.
    Slcan(SerialLine),
}
