//! `wsg gateway`: the bridge without a board, between PLCs on Modbus/TCP and a gripper on TCP.
//!
//! The bridge is the application of the board's firmware, with the same registers, settings and rules. It has no wires:
//! `FAST_STOP_OK` is high. All tasks run in one thread. A request runs a turn of the bridge at once; without one, a turn runs
//! every few milliseconds, and when bytes of the gripper arrive.

mod bridge;
mod line;
mod master;
pub(crate) mod reports;
mod status;

use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::rc::Rc;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use tokio::net::TcpListener;
use tokio::runtime;
use tokio::task::{JoinSet, LocalSet};

use crate::gripper::{Address, Signals};
use crate::listen_address;
use bridge::Gateway;
use master::Master;

/// Connects PLCs on Modbus/TCP to a gripper through the bridge's software, until Ctrl-C; see docs/gateway.md
#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Arguments {
    #[command(flatten)]
    serving: Option<Serving>,
    #[command(subcommand)]
    task: Option<Task>,
}

#[derive(Subcommand)]
enum Task {
    /// Shows health, gripper and PLC of gateways that run. The exit status is 0 if all are healthy, 1 if not, and 6 if one does
    /// not answer within 2 s
    Status(status::Arguments),
}

/// What to serve.
#[derive(Args)]
struct Serving {
    /// Address of the gripper, such as tcp://192.168.1.20
    #[arg(long, value_name = "ADDRESS", value_parser = gripper_address)]
    gripper: String,
    /// Address on which Modbus/TCP masters connect, such as 192.168.1.10:502
    #[arg(long, value_name = "ADDR", value_parser = listen_address)]
    modbus: SocketAddr,
    /// File that stores the bridge's settings; without it, they are lost at the end
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

/// Runs the gateway until a signal is caught, and returns 0, or runs a task.
pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let serving = match arguments {
        Arguments { task: Some(Task::Status(arguments)), .. } => return status::run(arguments),
        Arguments { serving: Some(serving), .. } => serving,
        Arguments { serving: None, task: None } => bail!("expected --gripper and --modbus"),
    };
    let signals = Signals::catch()?;
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    let served = LocalSet::new().block_on(&runtime, serve(serving, &signals));
    // Does not wait for a look-up of the gripper's name.
    runtime.shutdown_background();
    served.map(|()| 0)
}

async fn serve(serving: &Serving, signals: &Signals) -> Result<()> {
    let Serving { gripper, modbus, settings } = serving;
    let gateway = Rc::new(Gateway::open(settings.as_deref())?);
    gateway.settle().await;
    let listener =
        TcpListener::bind(modbus).await.with_context(|| format!("Modbus/TCP cannot listen on {modbus}"))?;
    let address = listener.local_addr()?;
    writeln!(io::stdout(), "gripper  tcp://{gripper}\nmodbus   {address}")?;
    let mut tasks = JoinSet::new();
    let (masters, line, gripper) = (Rc::clone(&gateway), Rc::clone(&gateway), gripper.clone());
    tasks.spawn_local(async move {
        fieldbus_host::tcp::serve(listener, |peer| Master::connect(&masters, peer.ip())).await
    });
    tasks.spawn_local(async move { line.keep_connected(&gripper).await });
    while signals.check().is_ok() {
        gateway.pass_time().await;
    }
    // No connection is accepted or made from here on.
    tasks.abort_all();
    gateway.end().await;
    Ok(())
}
