//! Servers around the gripper: TCP, UDP, serial lines, Modbus/TCP, and the control interface (feature `std`).
//!
//! One thread serves all of them on a current-thread runtime; a script runs in a second one. Every frame is one write,
//! and TCP does not delay: a client that takes what one `recv` gives for one frame is right. [`Server`] is for programs
//! that have such a runtime, [`ServerThread`] for all others.

mod accept;
mod can;
mod control;
mod echoes;
mod faulty_line;
mod hub;
mod lines;
mod log;
mod log_writer;
#[cfg(feature = "profinet")]
mod profinet;
mod request_line;
#[cfg(feature = "script")]
mod script;
mod serial;
mod slcan;
mod stream;
mod tcp;
mod thread;
mod udp;

#[cfg(feature = "profinet")]
pub use lines::ProfinetLine;
pub use lines::{CanBus, CanLine, Lines, Profile, SerialLine, UdpLine};
pub use log::Log;
pub use thread::ServerThread;

use crate::config::Config;
use crate::port::PortKind;
use anyhow::{Context, Result};
use hub::Hub;
use serial::{Carried, SerialPort};
use std::future::Future;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use tokio::net::{TcpListener, UdpSocket};
use tokio::task::{JoinSet, LocalSet};
use wsg_protocol::can::Identifiers;

/// A gripper with all its lines open, ready to [`run`](Self::run).
///
/// ```
/// # fn main() -> anyhow::Result<()> {
/// use wsg_sim::server::{Lines, Server};
/// use wsg_sim::Config;
///
/// let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
/// runtime.block_on(async {
///     let lines = Lines { tcp: Some("127.0.0.1:0".parse()?), ..Lines::default() };
///     let server = Server::bind(Config::default(), &lines, None).await?;
///     println!("tcp {}", server.tcp_address().expect("it was asked for"));
///     // Any future ends it: here one that is ready at once.
///     server.run(std::future::ready(())).await
/// })
/// # }
/// ```
#[derive(Debug)]
pub struct Server {
    hub: Arc<Hub>,
    tcp: Option<TcpListener>,
    udp: Option<(UdpSocket, u16)>,
    serial: Option<SerialPort>,
    can: Option<CanPort>,
    gcl: Option<TcpListener>,
    gcl_udp: Option<UdpSocket>,
    udp_unanswered: Option<u32>,
    modbus: Option<TcpListener>,
    profibus: Option<SerialPort>,
    #[cfg(feature = "profinet")]
    profinet: Option<profinet::Interface>,
    control: Option<(TcpListener, Vec<String>)>,
    #[cfg(feature = "script")]
    script: Option<script::Script>,
}

impl Server {
    /// Opens the lines and switches the gripper on.
    ///
    /// # Errors
    /// One for the line that cannot be opened, naming it.
    pub async fn bind(config: Config, lines: &Lines, log: Option<Log>) -> Result<Self> {
        let tcp = listen(lines.tcp, "TCP").await?;
        let udp = match lines.udp {
            Some(line) => Some((bind_udp(line.address, "UDP").await?, line.remote_port)),
            None => None,
        };
        let serial = match &lines.serial {
            Some(line) => Some(SerialPort::open(line)?),
            None => None,
        };
        let can = lines.can.as_ref().map(CanPort::open).transpose()?;
        let gcl = listen(lines.gcl, "GCL over TCP").await?;
        let gcl_udp = match lines.gcl_udp {
            Some(address) => Some(bind_udp(address, "GCL over UDP").await?),
            None => None,
        };
        let modbus = listen(lines.modbus, "Modbus/TCP").await?;
        let profibus = lines.profibus.as_ref().map(SerialPort::open).transpose()?;
        #[cfg(feature = "profinet")]
        let profinet = lines.profinet.as_ref().map(profinet::Interface::open).transpose()?;
        let control = listen(lines.control, "the control interface").await?;
        let control = control.map(|listener| (listener, lines.control_hosts.clone()));
        #[cfg(feature = "script")]
        let script = lines.script.as_deref().map(script::Script::read).transpose()?;
        // Pages watch the log, too.
        let log = log.or_else(|| control.is_some().then(Log::to_nowhere));
        let hub = Arc::new(Hub::new(config, lines.profile, lines.seed, log));
        Ok(Self {
            hub,
            tcp,
            udp,
            serial,
            can,
            gcl,
            gcl_udp,
            udp_unanswered: lines.udp_unanswered,
            modbus,
            profibus,
            #[cfg(feature = "profinet")]
            profinet,
            control,
            #[cfg(feature = "script")]
            script,
        })
    }

    /// The address that TCP listens on.
    #[must_use]
    pub fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp.as_ref()?.local_addr().ok()
    }

    /// The address that UDP listens on.
    #[must_use]
    pub fn udp_address(&self) -> Option<SocketAddr> {
        self.udp.as_ref()?.0.local_addr().ok()
    }

    /// What a client opens to get at the serial line: the pseudo terminal, the Unix socket, or the device.
    #[must_use]
    pub fn serial_path(&self) -> Option<&Path> {
        self.serial.as_ref().map(SerialPort::path)
    }

    /// What leads to the CAN bus: the interface, or what a client opens to get at the SLCAN line.
    #[must_use]
    pub fn can_path(&self) -> Option<&Path> {
        self.can.as_ref().map(CanPort::path)
    }

    /// The address that the text protocol (GCL) over TCP listens on.
    #[must_use]
    pub fn gcl_address(&self) -> Option<SocketAddr> {
        self.gcl.as_ref()?.local_addr().ok()
    }

    /// The address that the text protocol (GCL) over UDP listens on.
    #[must_use]
    pub fn gcl_udp_address(&self) -> Option<SocketAddr> {
        self.gcl_udp.as_ref()?.local_addr().ok()
    }

    /// The address that Modbus/TCP listens on.
    #[must_use]
    pub fn modbus_address(&self) -> Option<SocketAddr> {
        self.modbus.as_ref()?.local_addr().ok()
    }

    /// What a PROFIBUS master opens.
    #[must_use]
    pub fn profibus_path(&self) -> Option<&Path> {
        self.profibus.as_ref().map(SerialPort::path)
    }

    /// The network interface that is a PROFINET device.
    #[cfg(feature = "profinet")]
    #[must_use]
    pub fn profinet_path(&self) -> Option<&Path> {
        self.profinet.as_ref().map(profinet::Interface::path)
    }

    /// The address that the control interface listens on.
    #[must_use]
    pub fn control_address(&self) -> Option<SocketAddr> {
        self.control.as_ref()?.0.local_addr().ok()
    }

    /// Serves until `end` is ready, or a line fails for good.
    ///
    /// # Errors
    /// That of the line.
    pub async fn run(self, end: impl Future<Output = ()>) -> Result<()> {
        let Self {
            hub, tcp, udp, serial, can, gcl, gcl_udp, udp_unanswered, modbus, profibus, control, ..
        } = self;
        #[cfg(feature = "script")]
        let script = self.script;
        #[cfg(feature = "profinet")]
        let profinet = self.profinet;
        // Declared first, so that it is dropped after the tasks of the lines.
        let _powered = Powered(Arc::clone(&hub));
        let local = LocalSet::new();
        local
            .run_until(async move {
                let mut tasks = JoinSet::new();
                tasks.spawn_local(Arc::clone(&hub).keep_time());
                if let Some(listener) = tcp {
                    tasks.spawn_local(tcp::serve(Arc::clone(&hub), listener, PortKind::Tcp));
                }
                if let Some((socket, remote_port)) = udp {
                    let hub = Arc::clone(&hub);
                    tasks.spawn_local(udp::serve(
                        hub,
                        socket,
                        Some(remote_port),
                        PortKind::Udp,
                        udp_unanswered,
                    ));
                }
                if let Some(port) = serial {
                    tasks.spawn_local(port.serve(Arc::clone(&hub), Carried::Bytes));
                }
                match can {
                    Some(CanPort::Interface(interface, identifiers)) => {
                        tasks.spawn_local(interface.serve(Arc::clone(&hub), identifiers));
                    }
                    Some(CanPort::Slcan(port, carried)) => {
                        tasks.spawn_local(port.serve(Arc::clone(&hub), carried));
                    }
                    None => {}
                }
                if let Some(listener) = gcl {
                    tasks.spawn_local(tcp::serve(Arc::clone(&hub), listener, PortKind::GclTcp));
                }
                if let Some(socket) = gcl_udp {
                    tasks.spawn_local(udp::serve(
                        Arc::clone(&hub),
                        socket,
                        None,
                        PortKind::GclUdp,
                        udp_unanswered,
                    ));
                }
                if let Some(listener) = modbus {
                    tasks.spawn_local(tcp::serve(Arc::clone(&hub), listener, PortKind::ModbusTcp));
                }
                if let Some(port) = profibus {
                    tasks.spawn_local(port.serve(Arc::clone(&hub), Carried::Profibus));
                }
                #[cfg(feature = "profinet")]
                if let Some(interface) = profinet {
                    tasks.spawn_local(interface.serve(Arc::clone(&hub)));
                }
                #[cfg(feature = "script")]
                if let Some(script) = script {
                    script.start(Arc::clone(&hub))?;
                }
                if let Some((listener, hosts)) = control {
                    tasks.spawn_local(control::serve(hub, listener, hosts));
                }
                tokio::select! {
                    () = end => Ok(()),
                    Some(ended) = tasks.join_next() => ended?,
                }
            })
            .await
    }
}

/// Switches the gripper off when the servers end, however they end.
struct Powered(Arc<Hub>);

impl Drop for Powered {
    fn drop(&mut self) {
        self.0.switch_off();
    }
}

/// What leads to a CAN bus, open.
#[derive(Debug)]
enum CanPort {
    Interface(can::Interface, Identifiers),
    Slcan(SerialPort, Carried),
}

impl CanPort {
    fn open(line: &CanLine) -> Result<Self> {
        let CanLine { bus, identifiers } = line;
        match bus {
            CanBus::Interface(name) => Ok(Self::Interface(can::Interface::open(name)?, *identifiers)),
            CanBus::Slcan(line) => {
                let side = match line {
                    SerialLine::Pty | SerialLine::Unix(_) => slcan::Side::Adapter,
                    SerialLine::Device(_) => slcan::Side::Host,
                };
                Ok(Self::Slcan(SerialPort::open(line)?, Carried::Slcan(*identifiers, side)))
            }
        }
    }

    fn path(&self) -> &Path {
        match self {
            Self::Interface(interface, _) => interface.path(),
            Self::Slcan(port, _) => port.path(),
        }
    }
}

async fn bind_udp(address: SocketAddr, what: &str) -> Result<UdpSocket> {
    UdpSocket::bind(address).await.with_context(|| format!("{what} cannot listen on {address}"))
}

async fn listen(address: Option<SocketAddr>, what: &str) -> Result<Option<TcpListener>> {
    let Some(address) = address else { return Ok(None) };
    let listener = TcpListener::bind(address).await;
    listener.map(Some).with_context(|| format!("{what} cannot listen on {address}"))
}
