//! `wsg gateway`: the bridge without a board, between PLCs on Modbus/TCP and a gripper at any address of the binary protocol.
//!
//! The bridge is the application of the board's firmware, with the same registers, settings and rules. It has no wires:
//! `FAST_STOP_OK` is high. All tasks run in one thread. A request runs a turn of the bridge at once; without one, a turn runs
//! every few milliseconds, and when bytes of the gripper arrive.

mod bridge;
mod line;
mod master;
#[cfg(unix)]
mod serial;
mod service;

use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::rc::Rc;

use anyhow::{Context, Result};
use clap::Args;
use tokio::net::TcpListener;
use tokio::runtime;
use tokio::task::{JoinSet, LocalSet};
use wsg_bridge_fw::gripper::BAUD;

use crate::gripper::{Address, Signals};
use crate::listen_address;
use bridge::Gateway;
use master::Master;

/// Lowest rate of a board's CAN bus in kbit/s.
const MIN_KBIT: u16 = 125;

/// Connects PLCs on Modbus/TCP to a gripper through the bridge's software, until Ctrl-C; see docs/gateway.md
#[derive(Args)]
pub(crate) struct Arguments {
    /// Address of the gripper, such as tcp://192.168.1.20
    #[arg(long, value_name = "ADDRESS", value_parser = gripper_address)]
    gripper: Address,
    /// Address on which Modbus/TCP masters connect, such as 192.168.1.10:502
    #[arg(long, value_name = "ADDR", value_parser = listen_address)]
    modbus: SocketAddr,
    /// File that stores the bridge's settings; without it, they are lost at the end
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
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
        Address::Gcl { .. } | Address::GclUdp { .. } => {
            Err("a gateway uses the binary protocol, not GCL; expected tcp://, udp://, serial: or slcan:"
                .to_owned())
        }
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
    let Arguments { gripper, modbus, settings } = arguments;
    let gateway = Rc::new(Gateway::open(settings.as_deref())?);
    gateway.settle().await;
    let listener =
        TcpListener::bind(modbus).await.with_context(|| format!("Modbus/TCP cannot listen on {modbus}"))?;
    let address = listener.local_addr()?;
    writeln!(io::stdout(), "gripper  {gripper}\nmodbus   {address}")?;
    service::ready(&format!("modbus {address}, gripper {gripper}"));
    let mut tasks = JoinSet::new();
    let (masters, line, gripper) = (Rc::clone(&gateway), Rc::clone(&gateway), gripper.clone());
    tasks
        .spawn_local(async move { fieldbus_host::tcp::serve(listener, |_| Master::connect(&masters)).await });
    tasks.spawn_local(async move { line.keep_connected(&gripper).await });
    let watched = [Rc::clone(&gateway)];
    tasks.spawn_local(async move { service::feed_watchdog(&watched).await });
    while signals.check().is_ok() {
        gateway.pass_time().await;
    }
    service::stopping();
    // No connection is accepted or made from here on.
    tasks.abort_all();
    gateway.end().await;
    Ok(())
}
