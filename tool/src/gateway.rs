//! `wsg gateway`: the bridge without a board, between PLCs on Modbus/TCP or PROFINET and a gripper on TCP.
//!
//! The bridge is the application of the board's firmware, with the same registers, settings and rules. It has no wires:
//! `FAST_STOP_OK` is high. All tasks run in one thread. A request runs a turn of the bridge at once; without one, a turn runs
//! every few milliseconds, and when bytes of the gripper arrive.

mod bridge;
mod line;
mod master;
mod profinet;

use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Context, Result};
use bus_profinet::Stored;
use clap::Args;
use fieldbus_host::profinet::ProfinetLine;
use tokio::net::TcpListener;
use tokio::runtime;
use tokio::task::{JoinSet, LocalSet};

use crate::gripper::{Address, Signals};
use crate::listen_address;
use bridge::Gateway;
use master::Master;
use profinet::Profinet;

/// Connects PLCs on Modbus/TCP or PROFINET to a gripper through the bridge's software, until Ctrl-C; see docs/gateway.md
#[derive(Args)]
pub(crate) struct Arguments {
    /// Address of the gripper, such as tcp://192.168.1.20
    #[arg(long, value_name = "ADDRESS", value_parser = gripper_address)]
    gripper: String,
    /// Address on which Modbus/TCP masters connect, such as 192.168.1.10:502
    #[arg(long, value_name = "ADDR", value_parser = listen_address, required_unless_present = "profinet")]
    modbus: Option<SocketAddr>,
    /// Network interface on which a PROFINET controller finds the gateway, such as eth0; Linux only
    #[arg(long, value_name = "INTERFACE")]
    profinet: Option<String>,
    /// File that stores the bridge's settings; FILE.profinet stores name and address of the PROFINET station. Without it, they are
    /// lost at the end
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
}

/// Returns host and port of an address over TCP. Only TCP shows the gripper that the gateway has ended.
fn gripper_address(text: &str) -> Result<String, String> {
    match text.parse::<Address>()? {
        Address::Tcp(host) => Ok(host),
        _ => Err("expected tcp://HOST[:1000]: a gateway supports no other line".to_owned()),
    }
}

/// Runs the gateway until a signal is caught. Returns 0.
pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let signals = Signals::catch()?;
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    let served = LocalSet::new().block_on(&runtime, serve(arguments, &signals));
    // Does not wait for a look-up of the gripper's name.
    runtime.shutdown_background();
    served.map(|()| 0)
}

async fn serve(arguments: &Arguments, signals: &Signals) -> Result<()> {
    let Arguments { gripper, modbus, profinet, settings } = arguments;
    let gateway = Rc::new(Gateway::open(settings.as_deref())?);
    gateway.settle().await;
    let mut tasks = JoinSet::new();
    let mut lines = format!("gripper  tcp://{gripper}\n");
    if let Some(modbus) = modbus {
        let refused = || format!("Modbus/TCP cannot listen on {modbus}");
        let listener = TcpListener::bind(modbus).await.with_context(refused)?;
        lines += &format!("modbus   {}\n", listener.local_addr()?);
        let masters = Rc::clone(&gateway);
        let serve = async move { fieldbus_host::tcp::serve(listener, |_| Master::connect(&masters)).await };
        tasks.spawn_local(serve);
    }
    if let Some(interface) = profinet {
        let keep = settings.as_deref().map(station_file);
        let line = ProfinetLine { interface: interface.clone(), stored: Stored::NONE, keep };
        tasks.spawn_local(Profinet::open(line)?.serve(Rc::clone(&gateway)));
        lines += &format!("profinet {interface}\n");
    }
    // In one piece: a reader may close its end after the line that it needs.
    io::stdout().write_all(lines.as_bytes())?;
    let (line, gripper) = (Rc::clone(&gateway), gripper.clone());
    tasks.spawn_local(async move { line.keep_connected(&gripper).await });
    while signals.check().is_ok() {
        gateway.pass_time().await;
    }
    // No connection is accepted or made from here on.
    tasks.abort_all();
    gateway.end().await;
    Ok(())
}

/// Returns the file for the PROFINET station of a bridge with this settings file.
fn station_file(settings: &Path) -> PathBuf {
    let mut file = settings.to_owned().into_os_string();
    file.push(".profinet");
    file.into()
}
