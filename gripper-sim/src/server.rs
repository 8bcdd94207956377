//! Servers around the gripper: TCP, UDP, serial lines, CAN, fieldbuses, and the control interface (feature `std`).
//!
//! One thread serves all lines on a current-thread runtime; a script runs in a second thread. Each frame is sent in one
//! write with `TCP_NODELAY`, which suits clients that expect one frame per `recv`. Programs with a current-thread
//! runtime use [`Server`], all others [`ServerThread`].

mod accept;
mod can;
mod control;
mod echoes;
mod faulty_line;
mod folder;
mod hub;
mod lines;
mod log;
mod log_writer;
mod options;
mod profinet;
mod request_line;
mod restart;
mod script;
mod serial;
mod slcan;
mod stream;
mod system_log;
mod tcp;
mod thread;
mod udp;

pub use lines::ProfinetLine;
pub use lines::{CanBus, CanLine, Lines, Profile, SerialLine, UdpLine};
pub use log::Log;
pub use options::{Options, command};
pub use restart::{Ending, Restart};
pub use thread::ServerThread;

use crate::config::Config;
use crate::model::Model;
use crate::port::PortKind;
use anyhow::{Context, Result};
use hub::{BusLine, Hub};
use restart::Bound;
use serial::{Carried, SerialPort};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use system_log::{Severity, SystemLog};
use tokio::net::{TcpListener, UdpSocket};
use tokio::task::{JoinSet, LocalSet};
use wsg_protocol::can::Identifiers;

/// A gripper with all lines open, ready to [`run`](Self::run).
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
///     println!("tcp {}", server.tcp_address().expect("TCP is enabled"));
///     // The server runs until this future is ready, here immediately.
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
    profinet: Option<profinet::Interface>,
    control: Option<(TcpListener, Vec<String>)>,
    script: Option<script::Script>,
}

impl Server {
    /// Opens the lines and powers up the gripper.
    ///
    /// # Errors
    /// Returns an error that names the line that cannot be opened.
    pub async fn bind(config: Config, lines: &Lines, log: Option<Log>) -> Result<Self> {
        let system_log = SystemLog::open(lines.system_log.as_deref())?;
        Self::open(config, lines, &mut { log }, system_log, None).await
    }

    /// Opens the lines. Takes the log once nothing can fail any more.
    async fn open(
        config: Config,
        lines: &Lines,
        log: &mut Option<Log>,
        system_log: SystemLog,
        options: Option<&Options>,
    ) -> Result<Self> {
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
        let profinet = lines.profinet.as_ref().map(profinet::Interface::open).transpose()?;
        let control = listen(lines.control, "the control interface").await?;
        let control = control.map(|listener| (listener, lines.control_hosts.clone()));
        let script = lines.script.as_deref().map(script::Script::read).transpose()?;
        // Pages show the log even if it is written nowhere.
        let log = log.take().or_else(|| control.is_some().then(Log::to_nowhere));
        let hub = Arc::new(Hub::new(config, lines.profile, lines.seed, log, system_log, options));
        hub.report_event(Severity::Info, "gripper", &format!("started as {}", config.model));
        let server = Self {
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
            profinet,
            control,
            script,
        };
        server.report_buses(&config);
        Ok(server)
    }

    /// Passes the buses of the register interface to the hub, for the fieldbus monitor.
    fn report_buses(&self, config: &Config) {
        if let Some(address) = self.modbus_address() {
            let (line, address) = (address.to_string(), address.ip().to_string());
            self.hub.set_bus(BusLine { bus: "Modbus/TCP", line, address, ..BusLine::default() });
        }
        if let Some(port) = &self.profibus {
            let (line, address) = (port.path().display().to_string(), config.profibus_address.to_string());
            self.hub.set_bus(BusLine {
                bus: "PROFIBUS",
                line,
                address,
                rate: port.rate(),
                ..BusLine::default()
            });
        }
        if let Some(interface) = &self.profinet {
            self.hub.set_bus(interface.bus_line());
        }
    }

    /// Returns the model.
    #[must_use]
    pub fn model(&self) -> Model {
        self.hub.config().model
    }

    /// Returns whether CAN uses SLCAN, on a serial line.
    #[must_use]
    pub const fn is_slcan(&self) -> bool {
        matches!(self.can, Some(CanPort::Slcan(..)))
    }

    /// Returns the TCP address.
    ///
    /// `None` without TCP; with port 0, it contains the port that the system chose.
    #[must_use]
    pub fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp.as_ref()?.local_addr().ok()
    }

    /// Returns the UDP address; `None` without UDP.
    #[must_use]
    pub fn udp_address(&self) -> Option<SocketAddr> {
        self.udp.as_ref()?.0.local_addr().ok()
    }

    /// Returns the path that a client opens for the serial line: the pseudo terminal, the Unix socket, or the device.
    #[must_use]
    pub fn serial_path(&self) -> Option<&Path> {
        self.serial.as_ref().map(SerialPort::path)
    }

    /// Returns the CAN interface, or the path that a client opens for the SLCAN line.
    #[must_use]
    pub fn can_path(&self) -> Option<&Path> {
        self.can.as_ref().map(CanPort::path)
    }

    /// Returns the address of the text protocol (GCL) over TCP.
    #[must_use]
    pub fn gcl_address(&self) -> Option<SocketAddr> {
        self.gcl.as_ref()?.local_addr().ok()
    }

    /// Returns the address of the text protocol (GCL) over UDP.
    #[must_use]
    pub fn gcl_udp_address(&self) -> Option<SocketAddr> {
        self.gcl_udp.as_ref()?.local_addr().ok()
    }

    /// Returns the address of Modbus/TCP.
    #[must_use]
    pub fn modbus_address(&self) -> Option<SocketAddr> {
        self.modbus.as_ref()?.local_addr().ok()
    }

    /// Returns the path that a PROFIBUS master opens.
    #[must_use]
    pub fn profibus_path(&self) -> Option<&Path> {
        self.profibus.as_ref().map(SerialPort::path)
    }

    /// Returns the network interface of the PROFINET device.
    #[must_use]
    pub fn profinet_path(&self) -> Option<&Path> {
        self.profinet.as_ref().map(profinet::Interface::path)
    }

    /// Returns the address of the control interface.
    #[must_use]
    pub fn control_address(&self) -> Option<SocketAddr> {
        self.control.as_ref()?.0.local_addr().ok()
    }

    /// Serves until `end` is ready, or a line fails permanently.
    ///
    /// # Errors
    /// Returns the error of the failed line.
    pub async fn run(self, end: impl Future<Output = ()>) -> Result<()> {
        self.run_to_restart(end).await.map(drop)
    }

    /// Serves until `end` is ready, a line fails permanently, or the page requests a restart.
    ///
    /// # Errors
    /// Returns the error of the failed line.
    pub async fn run_to_restart(self, end: impl Future<Output = ()>) -> Result<Ending> {
        let bound = Bound::of(&self);
        let hub = Arc::clone(&self.hub);
        // Declared before the tasks of the lines, so that it is dropped after them.
        let _powered = Powered(Arc::clone(&hub));
        let is_restart = self.serve(end).await?;
        Ok(hub.end(bound).filter(|_| is_restart).map_or(Ending::Stopped, Ending::Restart))
    }

    /// Serves, and returns whether a restart is requested.
    async fn serve(self, end: impl Future<Output = ()>) -> Result<bool> {
        let Self {
            hub,
            tcp,
            udp,
            serial,
            can,
            gcl,
            gcl_udp,
            udp_unanswered,
            modbus,
            profibus,
            profinet,
            control,
            script,
        } = self;
        let ending = Arc::clone(&hub);
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
                if let Some(interface) = profinet {
                    tasks.spawn_local(interface.serve(Arc::clone(&hub)));
                }
                if let Some(script) = script {
                    script.start(Arc::clone(&hub))?;
                }
                if let Some((listener, hosts)) = control {
                    tasks.spawn_local(control::serve(hub, listener, hosts));
                }
                let ended = tokio::select! {
                    () = end => Ok(false),
                    () = ending.restart_requested() => Ok(true),
                    Some(ended) = tasks.join_next() => ended?.map(|()| false),
                };
                // From here on, the end of a connection is no event.
                ending.set_off();
                ended
            })
            .await
    }
}

/// Powers the gripper off when the servers end for any reason.
struct Powered(Arc<Hub>);

impl Drop for Powered {
    fn drop(&mut self) {
        self.0.switch_off();
    }
}

/// An open connection to a CAN bus.
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
