//! Where a gripper is served: addresses, serial lines and CAN buses, as its user names them.

#[cfg(feature = "profinet")]
use bus_profinet::{IpParameters, Maintenance, Stored};
#[cfg(feature = "profinet")]
use std::net::Ipv4Addr;
use std::net::SocketAddr;
use std::path::PathBuf;
use wsg_protocol::can::Identifiers;

/// Where a gripper is served.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lines {
    /// TCP: the address to listen on. Port 0 lets the system choose.
    pub tcp: Option<SocketAddr>,
    /// UDP: the address to listen on.
    pub udp: Option<UdpLine>,
    /// A serial line.
    pub serial: Option<SerialLine>,
    /// A CAN bus.
    pub can: Option<CanLine>,
    /// The text protocol (GCL) over TCP: the address to listen on.
    pub gcl: Option<SocketAddr>,
    /// The text protocol (GCL) over UDP: the address to listen on. Answers go to the port that asked.
    pub gcl_udp: Option<SocketAddr>,
    /// How many datagrams a UDP client is sent while it sends nothing; then its updates end. `None`: 1000 for clients on other
    /// machines, since the sender of a datagram can be forged. 0: any number, as the manual has it.
    pub udp_unanswered: Option<u32>,
    /// Modbus/TCP: the address to listen on; port 502 on the real one.
    pub modbus: Option<SocketAddr>,
    /// PROFIBUS DP over a serial line; a device is set to 115200 8N1, which no real bus has.
    pub profibus: Option<SerialLine>,
    /// PROFINET.
    #[cfg(feature = "profinet")]
    pub profinet: Option<ProfinetLine>,
    /// The control interface, HTTP with JSON: the address to listen on. Whoever reaches it can do with the gripper
    /// what a hand beside it can, so keep it on the loopback interface.
    pub control: Option<SocketAddr>,
    /// Hosts that requests to the control interface may be for, by their header `Host`. `localhost` and the address that a
    /// request came to need not be named. What else a browser is led here by is refused, against DNS rebinding.
    pub control_hosts: Vec<String>,
    /// A Lua script that runs on the gripper from the start on.
    #[cfg(feature = "script")]
    pub script: Option<PathBuf>,
    /// How soon the command interface answers.
    pub profile: Profile,
    /// Decides which frames the faults hit that the control interface lets loose on the lines.
    pub seed: u64,
}

/// How soon the command interface (the binary protocol and GCL) answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Profile {
    /// At once.
    #[default]
    Instant,
    /// As real grippers do by field reports: a client that asks for three values in turn, one request at a time, gets
    /// them 15 times a second. Each frame comes 22 ms late and 5 ms behind the one before it at the soonest.
    Real,
}

/// A UDP address, and where answers go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UdpLine {
    /// The address to listen on; grippers in the field use port 1500.
    pub address: SocketAddr,
    /// The port that answers go to, whatever port the request came from; 1501 in the field.
    pub remote_port: u16,
}

/// Where a gripper is on PROFINET.
#[cfg(feature = "profinet")]
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProfinetLine {
    /// The network interface, such as `eth0`. Its Ethernet address is the gripper's; its IP address is not, and must differ.
    pub interface: String,
    /// What it has from the start: name, IP parameters, I&M 1 to 3.
    pub stored: Stored,
    /// The configuration file that keeps these.
    pub keep: Option<PathBuf>,
}

#[cfg(feature = "profinet")]
impl ProfinetLine {
    /// What the name is called in the configuration file.
    pub const STATION: &str = "station";
    /// What the IP parameters are called there.
    pub const IP: &str = "profinet-ip";
    /// What I&M 1 is called there (function, location), I&M 2 (date) and I&M 3 (descriptor).
    pub const MAINTENANCE: [&str; 4] = ["im-function", "im-location", "im-date", "im-descriptor"];

    /// All that is kept in the configuration file: its name there, and its text. Empty: it is as delivered.
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

    /// A field of I&M as text, without the blanks that fill it up. Its bytes are Latin-1: a controller may write any.
    fn maintenance_text(field: &[u8]) -> String {
        let text: String = field.iter().copied().map(char::from).collect();
        text.trim_end_matches(' ').to_owned()
    }

    /// The field of I&M that a text says, if it has room for it.
    #[must_use]
    pub fn maintenance_of_text<const N: usize>(text: &str) -> Option<[u8; N]> {
        let mut field = [b' '; N];
        let mut places = field.iter_mut();
        for letter in text.chars() {
            *places.next()? = u8::try_from(letter).ok()?;
        }
        Some(field)
    }

    /// IP parameters as text, such as `192.168.0.5/24` or `192.168.0.5/24,192.168.0.1` with a router.
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

    /// The IP parameters that a text says, if a station can have them.
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

/// A serial line that is to be served.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SerialLine {
    /// A pseudo terminal, made for the purpose. Only on Unix: elsewhere opening it is an error.
    Pty,
    /// A Unix socket at this path, to which clients connect. Only on Unix, likewise.
    Unix(PathBuf),
    /// A serial port that exists, such as `/dev/ttyUSB0` or `COM3`; set to 115200 8N1.
    Device(PathBuf),
}

/// Where a gripper is on a CAN bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanLine {
    /// What leads to the bus.
    pub bus: CanBus,
    /// The gripper's two identifiers.
    pub identifiers: Identifiers,
}

/// What leads to a CAN bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CanBus {
    /// A network interface of Linux SocketCAN, such as `can0`.
    Interface(String),
    /// A serial line that carries CAN frames by SLCAN. A pseudo terminal and a Unix socket are an adapter for whoever
    /// opens them; behind a device an adapter is expected.
    Slcan(SerialLine),
}
