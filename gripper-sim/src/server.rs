//! Servers around the gripper: TCP, UDP, serial lines, CAN, fieldbuses, and the control interface (feature `std`).
//!
//! One thread serves all lines on a current-thread runtime; a script runs in a second thread. Each frame is sent in one
//! write with `TCP_NODELAY`, which suits clients that expect one frame per `recv`. Programs with a current-thread
//! runtime use [`Server`], all others [`ServerThread`].

mod can;
mod control;
mod echoes;
mod ethernetip;
mod folder;
mod hub;
mod lines;
mod log;
mod log_writer;
mod open_line;
mod options;
mod profinet;
mod restart;
mod script;
mod serial;
mod slcan;
mod system_log;
mod tcp;
mod thread;
mod udp;

pub use control::serve_read_only;
pub use fieldbus_host::ethernetip::EthernetIpLine;
pub use fieldbus_host::profinet::ProfinetLine;
pub use lines::{CanBus, CanLine, Lines, Profile, SerialLine, UdpLine};
pub use log::Log;
pub use options::{Options, command};
pub use restart::{Ending, Restart};
pub use thread::ServerThread;

use crate::config::Config;
use crate::model::Model;
use crate::port::PortKind;
use crate::time::Time;
use anyhow::Result;
use hub::{BusLine, Hub, Running};
use open_line::{Listen, OpenLine, Places};
use serial::{Carried, SerialPort};
use std::net::SocketAddr;
use std::sync::Arc;
use system_log::{Severity, SystemLog};
use tokio::task::{JoinSet, LocalSet};

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
///     println!("tcp {}", server.address("tcp").expect("TCP is enabled"));
///     // The server runs until this future is ready, here immediately.
///     server.run(std::future::ready(())).await
/// })
/// # }
/// ```
#[derive(Debug)]
pub struct Server {
    hub: Arc<Hub>,
    lines: Vec<OpenLine>,
    script: Option<script::Script>,
}

impl Server {
    /// Opens the lines and powers up the gripper.
    ///
    /// # Errors
    /// Returns an error that names the line that cannot be opened.
    pub async fn bind(config: Config, lines: &Lines, log: Option<Log>) -> Result<Self> {
        let system_log = system_log::open(lines.system_log.as_deref())?;
        Self::open(config, lines, &mut { log }, system_log, None, &Places::default()).await
    }

    /// Opens the lines of these options and powers up the gripper. Its page can change settings and restart it.
    ///
    /// # Errors
    /// Returns an error that names the line that cannot be opened.
    pub async fn bind_options(options: &Options, log: Option<Log>) -> Result<Self> {
        // Built before any line waits for this thread.
        let _ = options::settings();
        let system_log = system_log::open(options.lines.system_log.as_deref())?;
        let places = Places::default();
        Self::open(options.config, &options.lines, &mut { log }, system_log, Some(options), &places).await
    }

    /// Opens the lines again, with the changed settings. A line whose option has not changed keeps its address. If a line
    /// cannot be opened, the system log says why, and the earlier settings count.
    ///
    /// # Errors
    /// Returns an error if the earlier lines cannot be opened either.
    pub async fn restart(restart: Box<Restart>) -> Result<Self> {
        let Restart { running: Running { options, at_start }, mut log, system_log, places } = *restart;
        let kept = places.kept(|name| at_start.given.get(name) == options.given.get(name));
        let mut open = async |options: &Options, kept: &Places| {
            let system_log = system_log.clone();
            Self::open(options.config, &options.lines, &mut log, system_log, Some(options), kept).await
        };
        let error = match open(&options, &kept).await {
            Ok(server) => return Ok(server),
            Err(error) => error,
        };
        let text = format!("the restart failed, and the earlier settings count: {error:#}");
        system_log.write(Time::ZERO, Severity::Error, "gripper", &text);
        open(&at_start, &places).await
    }

    /// Opens the lines. A line in `kept` gets the address that it had before. Takes the log once nothing can fail any
    /// more.
    async fn open(
        config: Config,
        lines: &Lines,
        log: &mut Option<Log>,
        system_log: SystemLog,
        options: Option<&Options>,
        kept: &Places,
    ) -> Result<Self> {
        let opened = open_lines(config, lines, kept).await?;
        let script = lines.script.as_deref().map(script::Script::read).transpose()?;
        // Pages show the log even if it is written nowhere.
        let log = log.take().or_else(|| lines.control.is_some().then(|| Log::new(None)));
        let hub = Arc::new(Hub::new(config, lines.profile, lines.seed, log, system_log, options));
        hub.report_event(Severity::Info, "gripper", &format!("started as {}", config.model));
        for bus in opened.iter().filter_map(|line| line.bus.clone()) {
            hub.set_bus(bus);
        }
        Ok(Self { hub, lines: opened, script })
    }

    /// Returns the model.
    #[must_use]
    pub fn model(&self) -> Model {
        self.hub.config().model
    }

    /// Returns the address of the line with this name, such as `tcp` or `gcl-udp`: the option of `wsg-sim` that sets it.
    ///
    /// `None` if the line is not served or has no address; with port 0, it contains the port that the system chose.
    #[must_use]
    pub fn address(&self, line: &str) -> Option<SocketAddr> {
        self.places().address(line)
    }

    /// Returns each served line by name and the place where clients reach it: an address, a path, or an interface.
    pub fn served(&self) -> impl Iterator<Item = (&'static str, String)> {
        self.lines.iter().map(|line| (line.name, line.place.to_string()))
    }

    fn places(&self) -> Places {
        Places::of(&self.lines)
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
        let places = self.places();
        let hub = Arc::clone(&self.hub);
        // Declared before the tasks of the lines, so that it is dropped after them.
        let _powered = Powered(Arc::clone(&hub));
        let is_restart = self.serve(end).await?;
        let taken_over = hub.end().filter(|_| is_restart);
        Ok(taken_over.map_or(Ending::Stopped, |(running, log, system_log)| {
            Ending::Restart(Box::new(Restart { running, log, system_log, places }))
        }))
    }

    /// Serves, and returns whether a restart is requested.
    async fn serve(self, end: impl Future<Output = ()>) -> Result<bool> {
        let Self { hub, lines, script } = self;
        let local = LocalSet::new();
        local
            .run_until(async move {
                let mut tasks = JoinSet::new();
                tasks.spawn_local(Arc::clone(&hub).keep_time());
                for line in lines {
                    tasks.spawn_local(line.serve(Arc::clone(&hub)));
                }
                if let Some(script) = script {
                    script.start(Arc::clone(&hub))?;
                }
                let ended = tokio::select! {
                    () = end => Ok(false),
                    () = hub.restart_requested() => Ok(true),
                    Some(ended) = tasks.join_next() => ended?.map(|()| false),
                };
                // From here on, the end of a connection is no event.
                hub.set_off();
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

/// Opens the lines that are given, in the order in which the program prints them. To add a line, add its value.
async fn open_lines(config: Config, lines: &Lines, kept: &Places) -> Result<Vec<OpenLine>> {
    let listen = |name, title, given| Listen { name, title, given, kept };
    let (udp, unanswered) = (lines.udp.as_ref(), lines.udp_unanswered);
    let opened = [
        tcp::open(listen("tcp", "TCP", lines.tcp), PortKind::Tcp).await?,
        udp::open(
            listen("udp", "UDP", udp.map(|udp| udp.address)),
            PortKind::Udp,
            udp.map(|udp| udp.remote_port),
            unanswered,
        )
        .await?,
        lines.serial.as_ref().map(open_serial).transpose()?,
        lines.can.as_ref().map(open_can).transpose()?,
        tcp::open(listen("gcl", "GCL over TCP", lines.gcl), PortKind::GclTcp).await?,
        udp::open(listen("gcl-udp", "GCL over UDP", lines.gcl_udp), PortKind::GclUdp, None, unanswered)
            .await?,
        tcp::open(listen("modbus", "Modbus/TCP", lines.modbus), PortKind::ModbusTcp).await?.map(on_modbus),
        lines.profibus.as_ref().map(|line| open_profibus(line, config.profibus_address)).transpose()?,
        lines.profinet.as_ref().map(profinet::open).transpose()?,
        ethernetip::open(
            listen("ethernetip", "EtherNet/IP", lines.ethernetip.map(|line| line.address.into())),
            lines.ethernetip,
        )
        .await?,
        control::open(listen("control", "the control interface", lines.control), &lines.control_hosts)
            .await?,
    ];
    Ok(opened.into_iter().flatten().collect())
}

fn open_serial(line: &SerialLine) -> Result<OpenLine> {
    Ok(SerialPort::open(line)?.into_line("serial", Carried::Bytes))
}

fn open_can(CanLine { bus, identifiers }: &CanLine) -> Result<OpenLine> {
    match bus {
        CanBus::Interface(name) => can::open(name, *identifiers),
        CanBus::Slcan(line) => {
            let side = match line {
                SerialLine::Pty | SerialLine::Unix(_) => slcan::Side::Adapter,
                SerialLine::Device(_) => slcan::Side::Host,
            };
            Ok(SerialPort::open(line)?.into_line("slcan", Carried::Slcan(*identifiers, side)))
        }
    }
}

fn open_profibus(line: &SerialLine, address: u8) -> Result<OpenLine> {
    let port = SerialPort::open(line)?;
    let (line, rate) = (port.path().display().to_string(), port.rate());
    let bus = BusLine { bus: "PROFIBUS", line, address: address.to_string(), rate, ..BusLine::default() };
    Ok(port.into_line("profibus", Carried::Profibus).on_bus(bus))
}

/// Adds the bus of a Modbus/TCP line, whose address on the bus is the IP address.
fn on_modbus(line: OpenLine) -> OpenLine {
    let place = line.place.to_string();
    let address = line.place.address().map(|address| address.ip().to_string()).unwrap_or_default();
    line.on_bus(BusLine { bus: "Modbus/TCP", line: place, address, ..BusLine::default() })
}
