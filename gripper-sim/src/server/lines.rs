//! The lines of a gripper: addresses, serial lines and CAN buses, as the user specifies them.

use fieldbus_host::ethernetip::EthernetIpLine;
use fieldbus_host::profinet::ProfinetLine;
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
    /// EtherNet/IP on an IP address.
    pub ethernetip: Option<EthernetIpLine>,
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
