//! `wsg gateway`: the bridge without a board, between PLCs on Modbus/TCP, PROFINET or EtherNet/IP and grippers at any address of
//! the binary protocol.
//!
//! The bridge is the application of the board's firmware, with the same registers, settings and rules. Each gripper has its own. It
//! has no wires: `FAST_STOP_OK` is high. All tasks run in one thread, and none waits for a line or a file. A request runs a turn of
//! the bridge at once; without one, a turn runs every few milliseconds, and when bytes of the gripper arrive.

mod bridge;
mod config;
mod line;
mod master;
mod page;
#[cfg(unix)]
mod port;
mod profinet;
mod service;
mod status;

use std::cell::RefCell;
use std::io::{self, Write};
use std::net::{SocketAddr, SocketAddrV4};
use std::panic;
use std::path::PathBuf;
use std::process;
use std::rc::Rc;

use anyhow::{Context, Result};
use clap::{ArgGroup, Args, Subcommand};
use fieldbus_host::ethernetip::{Adapter, EthernetIpLine};
use tokio::net::TcpListener;
use tokio::runtime;
use tokio::task::{JoinSet, LocalSet};
use wsg_bridge_fw::gripper::BAUD;
use wsg_sim::text::one_line;

use crate::bridge::client::GatewayAddress;
use crate::gripper::{Address, Signals};
use crate::{listen_address, print_error};
use bridge::Gateway;
use config::GripperConfig;
use master::{Master, Port};
use page::Shown;
use profinet::{Profinet, serve_adapter};

/// Lowest rate of a board's CAN bus in kbit/s.
const MIN_KBIT: u16 = 125;

/// Exit status after a mistake in the configuration, as after one in the command line. systemd does not restart the service then.
const MISCONFIGURED: u8 = 2;

/// Connects PLCs on Modbus/TCP, PROFINET or EtherNet/IP to grippers through the bridge's software, until Ctrl-C; see docs/gateway.md
#[derive(Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    disable_help_subcommand = true
)]
#[command(override_usage = "\
wsg gateway --gripper <ADDRESS> <--modbus <ADDR>|--profinet <INTERFACE>|--ethernetip <ADDR>> [--settings <FILE>] [--page <ADDR>]
       wsg gateway --config <FILE> [--check-config]
       wsg gateway status [--json] <ADDR>...")]
pub(crate) struct Arguments {
    #[command(flatten)]
    serving: Serving,
    #[command(subcommand)]
    task: Option<Task>,
}

#[derive(Subcommand)]
enum Task {
    /// Shows health, gripper and PLC of gateways that run. The exit status is 0 if all are healthy, 1 if not, and 6 if one does
    /// not answer within 2 s
    Status(status::Arguments),
}

/// Grippers to serve, from options or from a file.
#[derive(Args)]
#[command(group = ArgGroup::new("grippers").required(true).args(["gripper", "config"]))]
#[command(group = ArgGroup::new("plc").required(true).multiple(true).args(["modbus", "profinet", "ethernetip", "config"]))]
struct Serving {
    #[command(flatten)]
    options: Options,
    /// Address of a page for browsers that shows the status, such as 127.0.0.1:8080. It has no commands
    #[arg(long, value_name = "ADDR", value_parser = listen_address)]
    page: Option<SocketAddr>,
    /// TOML file with one or more grippers, instead of the options for one
    #[arg(long, value_name = "FILE", conflicts_with_all = ["modbus", "profinet", "ethernetip", "settings", "page"])]
    config: Option<PathBuf>,
    /// Check the file and print its grippers, without opening a port
    #[arg(long, conflicts_with = "gripper")]
    check_config: bool,
}

/// The options for one gripper, which are also keys of the file.
#[derive(Args)]
struct Options {
    /// Address of the gripper, such as tcp://192.168.1.20
    #[arg(long, value_name = "ADDRESS", value_parser = gripper_address)]
    gripper: Option<Address>,
    /// Address on which Modbus/TCP masters connect, such as 192.168.1.10:502
    #[arg(long, value_name = "ADDR", value_parser = listen_address)]
    modbus: Option<SocketAddr>,
    /// Network interface on which a PROFINET controller finds the gateway, such as eth0; Linux only
    #[arg(long, value_name = "INTERFACE")]
    profinet: Option<String>,
    /// Address on which EtherNet/IP scanners connect, such as 192.168.1.10; the port is 44818 unless the address has one
    #[arg(long, value_name = "ADDR", value_parser = adapter_address)]
    ethernetip: Option<SocketAddrV4>,
    /// Vendor number on EtherNet/IP; 0 unless given
    #[arg(long, value_name = "NUMBER", requires = "ethernetip")]
    ethernetip_vendor: Option<u16>,
    /// File that stores the bridge's settings; FILE.profinet stores name and address of the PROFINET station. Without it, they are
    /// lost at the end
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
}

impl Serving {
    /// Returns the grippers of the options or of the file, and the address of the page.
    fn read(&self) -> Result<(Vec<GripperConfig>, Option<SocketAddr>)> {
        match &self.config {
            Some(file) => config::read(file),
            None => Ok((vec![GripperConfig::new(&self.options)?], self.page)),
        }
    }
}

/// Parses the address of a gripper that a gateway can command. A line must be as fast as a board's, for its times to hold.
fn gripper_address(text: &str) -> Result<Address, String> {
    match text.parse()? {
        address @ (Address::Tcp(_) | Address::Udp { .. }) => Ok(address),
        Address::Serial { rate, .. } if rate < BAUD => {
            Err(format!("rate={rate}: a gateway requires {BAUD} bit/s or more"))
        }
        Address::Slcan { kbit, .. } if kbit < MIN_KBIT => {
            Err(format!("kbit={kbit}: a gateway requires {MIN_KBIT} kbit/s or more"))
        }
        address @ (Address::Serial { .. } | Address::Slcan { .. }) if cfg!(unix) => Ok(address),
        Address::Serial { .. } | Address::Slcan { .. } => {
            Err("a gateway uses no serial port on this system; expected tcp:// or udp://".to_owned())
        }
        address @ Address::SocketCan { .. } if cfg!(target_os = "linux") => Ok(address),
        Address::SocketCan { .. } => Err("SocketCAN requires Linux; expected tcp:// or udp://".to_owned()),
        Address::Gcl { .. } | Address::GclUdp { .. } => {
            Err("a gateway uses the binary protocol, not GCL; expected tcp://, udp://, serial:, slcan: or socketcan:"
                .to_owned())
        }
    }
}

fn adapter_address(text: &str) -> Result<SocketAddrV4, &'static str> {
    EthernetIpLine::address_of_text(text)
        .ok_or("expected the IP address of a network card, such as 192.168.1.10")
}

/// Runs the gateway until a signal is caught, checks its configuration, or runs a task.
pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let Arguments { serving, task } = arguments;
    if let Some(Task::Status(arguments)) = task {
        return status::run(arguments);
    }
    end_with_any_panic();
    let signals = Signals::catch()?;
    let served = match serving.read().and_then(|(grippers, page)| Served::open(grippers, page)) {
        Ok(served) => served,
        Err(error) => {
            print_error(format_args!("{error:#}"));
            return Ok(MISCONFIGURED);
        }
    };
    if serving.check_config {
        io::stdout().write_all(served.addresses().as_bytes())?;
        return Ok(0);
    }
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    let ended = LocalSet::new().block_on(&runtime, served.serve(&signals));
    // Does not wait for a look-up of a gripper's name.
    runtime.shutdown_background();
    ended.map(|()| 0)
}

/// Lets a panic in any task end the process, so that grippers on TCP enter FAST STOP.
fn end_with_any_panic() {
    let print = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        print(panic);
        process::abort();
    }));
}

/// The grippers of one process, and the ports on which masters reach them.
struct Served {
    grippers: Vec<(GripperConfig, Rc<Gateway>)>,
    ports: Vec<Port>,
    page: Option<SocketAddr>,
}

impl Served {
    /// Starts the bridges. Opens no port.
    fn open(configs: Vec<GripperConfig>, page: Option<SocketAddr>) -> Result<Self> {
        let (mut grippers, mut ports) = (Vec::<(GripperConfig, Rc<Gateway>)>::new(), Vec::<Port>::new());
        for config in configs {
            let other = grippers.iter().find(|(other, _)| config.shares_port(other));
            let shared = match other {
                Some((_, other)) => ports.iter_mut().find(|port| port.serves(other)),
                None => None,
            };
            let gateway = match (shared, config.modbus) {
                (Some(port), _) => port.add(&config)?,
                (None, Some(address)) => {
                    let mut port = Port::new(address);
                    let gateway = port.add(&config)?;
                    ports.push(port);
                    gateway
                }
                (None, None) => Rc::new(Gateway::open(&config, &Rc::default())?),
            };
            grippers.push((config, gateway));
        }
        Ok(Self { grippers, ports, page })
    }

    /// Returns the addresses of page and grippers, each in a line.
    fn addresses(&self) -> String {
        let mut text = self.page.map(|page| format!("page     http://{page}/\n")).unwrap_or_default();
        for (config, gateway) in &self.grippers {
            let name = config.name.as_ref().map(|name| format!(" ({})", one_line(name))).unwrap_or_default();
            text += &format!("gripper  {}{name}\n", config.gripper);
            if let Some(port) = self.ports.iter().find(|port| port.serves(gateway)) {
                let unit = config.unit.map(|unit| format!(", unit {unit}")).unwrap_or_default();
                text += &format!("modbus   {}{unit}\n", port.address);
            }
            if let Some(line) = &config.profinet {
                text += &format!("profinet {}\n", one_line(&line.interface));
            }
            if let Some(line) = &config.ethernetip {
                text += &format!("ethernetip {}\n", line.address);
            }
        }
        text
    }

    async fn serve(mut self, signals: &Signals) -> Result<()> {
        // All bridges, because each runs its turns from its first one on.
        let settling = self.grippers.iter().map(|(_, gateway)| gateway.settling()).max().unwrap_or_default();
        self.together(|gateway| async move { gateway.settle(settling).await }).await?;
        let mut listeners = Vec::new();
        for port in &mut self.ports {
            listeners.push(listen("Modbus/TCP", &mut port.address).await?);
        }
        let page = match &mut self.page {
            Some(address) => Some(listen("the page", address).await?),
            None => None,
        };
        let mut tasks = JoinSet::new();
        for (config, gateway) in &mut self.grippers {
            if let Some(line) = config.profinet.clone() {
                tasks.spawn_local(Profinet::open(line)?.serve(Rc::clone(gateway)));
            }
            if let Some(line) = &mut config.ethernetip {
                let adapter = Adapter::open(*line).await?;
                line.address = adapter.address();
                tasks.spawn_local(serve_adapter(adapter, Rc::clone(gateway)));
            }
        }
        let addresses = self.addresses();
        io::stdout().write_all(addresses.as_bytes())?;
        service::ready(&addresses.split_whitespace().collect::<Vec<_>>().join(" "));
        if let Some(listener) = page {
            tasks.spawn_local(page::serve(listener, self.shown()));
        }
        for (port, listener) in std::mem::take(&mut self.ports).into_iter().zip(listeners) {
            let port = Rc::new(port);
            tasks.spawn_local(async move {
                fieldbus_host::tcp::serve(listener, |peer| Master::connect(&port, peer.ip())).await
            });
        }
        for (config, gateway) in &self.grippers {
            let (gateway, gripper) = (Rc::clone(gateway), config.gripper.clone());
            tasks.spawn_local(async move { gateway.keep_connected(&gripper).await });
        }
        let watched: Vec<_> = self.grippers.iter().map(|(_, gateway)| Rc::clone(gateway)).collect();
        tasks.spawn_local(async move { service::feed_watchdog(&watched).await });
        self.together(|gateway| {
            let signals = signals.clone();
            async move {
                while signals.check().is_ok() {
                    gateway.pass_time().await;
                }
            }
        })
        .await?;
        service::stopping();
        // No connection is accepted or made from here on.
        tasks.abort_all();
        self.together(|gateway| async move { gateway.end().await }).await
    }

    /// Returns the grippers for the page.
    fn shown(&self) -> Vec<Shown> {
        let shown = self.grippers.iter().map(|(config, gateway)| {
            let port = self.ports.iter().find(|port| port.serves(gateway));
            let address = port.map_or(config.gripper.to_string(), |port| {
                GatewayAddress::new(port.address, config.unit).to_string()
            });
            let name = config.name.as_ref().map(|name| format!("{}, ", one_line(name))).unwrap_or_default();
            let heading = name + &address;
            Shown { heading, address, gateway: Rc::clone(gateway), latest: RefCell::default() }
        });
        shown.collect()
    }

    /// Runs a future for each gripper, all at the same time, until all have ended.
    async fn together<F: Future<Output = ()> + 'static>(&self, run: impl Fn(Rc<Gateway>) -> F) -> Result<()> {
        let mut tasks = JoinSet::new();
        for (_, gateway) in &self.grippers {
            tasks.spawn_local(run(Rc::clone(gateway)));
        }
        while let Some(ended) = tasks.join_next().await {
            ended?;
        }
        Ok(())
    }
}

/// Opens a port, and sets its number if the system chooses it.
async fn listen(what: &str, address: &mut SocketAddr) -> Result<TcpListener> {
    let listener = TcpListener::bind(*address).await;
    let listener = listener.with_context(|| format!("{what} cannot listen on {address}"))?;
    *address = listener.local_addr()?;
    Ok(listener)
}
