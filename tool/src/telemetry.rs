//! `wsg telemetry`: publishes any number of grippers and bridges to an MQTT broker with Sparkplug B. Read-only, unless a gripper
//! allows commands.
//!
//! One task per device reads it and reports changes. One task serves the broker and turns reports into messages: `gripper` and
//! `bridge` -> `node` with its `store` -> `broker`. Commands take the reverse path: `broker` -> `node`, which checks them with
//! `command` -> `commander` in the gripper's task. All tasks run in one thread.

mod bridge;
mod broker;
mod command;
mod commander;
mod config;
mod gripper;
mod line;
mod metrics;
mod node;
mod payload;
mod reference;
mod report;
mod sequence;
mod settings;
mod store;
mod values;

use std::{path::PathBuf, rc::Rc};

use anyhow::Result;
use tokio::{
    runtime,
    sync::{mpsc, watch},
    task::{JoinSet, LocalSet},
};
use wsg_sim::text::one_line;

use config::{Source, Telemetry};
use metrics::{GRIPPER, Metric};
use node::Node;
use report::{Reporter, now_ms};
use sequence::Sequence;

/// Capacity of the report queue to the broker task. Readers wait while it is full.
const REPORTS: usize = 4_096;

/// Publishes grippers and bridges to an MQTT broker with Sparkplug B; read-only unless a gripper allows commands. For the settings
/// see docs/tool.md
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Settings file in TOML format; see docs/tool.md
    #[arg(required_unless_present = "reference")]
    config: Option<PathBuf>,
    /// Check the settings and exit
    #[arg(long)]
    check: bool,
    /// Print all settings and metrics as Markdown tables
    #[arg(long)]
    reference: bool,
}

/// Runs until interrupted by a signal: Ctrl-C, SIGTERM or SIGHUP.
pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let Some(path) = arguments.config.as_ref().filter(|_| !arguments.reference) else {
        print!("{}", reference::text());
        return Ok(0);
    };
    let telemetry = Telemetry::read(path)?;
    let broker = broker::Broker::new(&telemetry.broker)?;
    if arguments.check {
        let checked = format!(
            "{}: {} devices to {} as {}/{}",
            path.display(),
            telemetry.devices.len(),
            telemetry.broker.host,
            telemetry.group,
            telemetry.node
        );
        println!("{}", one_line(&checked));
        return Ok(0);
    }
    let mut sequence = Sequence::open(&telemetry.state_file)?;
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    LocalSet::new().block_on(&runtime, send(telemetry, broker, &mut sequence))?;
    Ok(0)
}

async fn send(telemetry: Telemetry, broker: broker::Broker, sequence: &mut Sequence) -> Result<()> {
    let (stop, stopping) = watch::channel(false);
    let (sender, reports) = mpsc::channel(REPORTS);
    let devices: Vec<_> =
        telemetry.devices.iter().map(|device| (device.name.clone(), device.source.table())).collect();
    let mut node = Node::new(&telemetry.group, &telemetry.node, &devices, telemetry.store);
    let sockets = Rc::new(line::Sockets::default());
    let mut readers = JoinSet::new();
    for (device, of) in (0_u16..).zip(telemetry.devices) {
        let reporter = Reporter { device, name: of.name, reports: sender.clone() };
        let (data, sockets, stopping) = (telemetry.data, Rc::clone(&sockets), stopping.clone());
        let orders = of.allows_commands.then(|| {
            let (orders, queue) = command::queue();
            node.allow_commands(device, orders, telemetry.command_age_ms, now_ms());
            queue
        });
        match of.source {
            Source::Gripper(address) => readers.spawn_local(async move {
                gripper::read(address, data, &sockets, reporter, orders, stopping).await;
            }),
            Source::Bridge(port) => readers.spawn_local(bridge::read(port, data, reporter, stopping)),
        };
    }
    drop(sender);
    // NDEATH to the broker and the disconnect announcements to the grippers are sent concurrently.
    let end = async {
        let outcome = signalled().await;
        stop.send_replace(true);
        outcome
    };
    let ((), outcome) = tokio::join!(broker.run(&mut node, reports, sequence, stopping), end);
    while readers.join_next().await.is_some() {}
    outcome
}

impl Source {
    /// Returns the metrics of this kind of device.
    fn table(&self) -> &'static [Metric] {
        match self {
            Self::Gripper(_) => GRIPPER,
            Self::Bridge(port) => bridge::table(port),
        }
    }
}

/// Completes when a signal asks the program to exit.
#[cfg(unix)]
async fn signalled() -> Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut hang_up = signal(SignalKind::hangup())?;
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
        _ = hang_up.recv() => {}
    }
    Ok(())
}

/// Completes when a signal asks the program to exit.
#[cfg(not(unix))]
async fn signalled() -> Result<()> {
    tokio::signal::ctrl_c().await?;
    Ok(())
}
