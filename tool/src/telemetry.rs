//! `wsg telemetry`: any number of grippers and bridges to an MQTT broker, by Sparkplug B. It only reads,
//! unless a gripper allows commands.
//!
//! A task for each device reads it and reports what changed; one task has the broker, and turns reports into messages:
//! `gripper` and `bridge` -> `node` and its `store` -> `broker`. Commands go back: `broker` -> `node`, which takes or refuses them by
//! `command` -> `commander` in the gripper's task. All run in one thread.

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

use std::{path::PathBuf, process::ExitCode, rc::Rc};

use anyhow::Result;
use tokio::{
    runtime,
    sync::{mpsc, watch},
    task::{JoinSet, LocalSet},
};

use config::{Source, Telemetry};
use metrics::{BRIDGE, GRIPPER, Metric};
use node::Node;
use report::{Reporter, now_ms};
use sequence::Sequence;

/// Reports that wait for the task with the broker; readers wait when there are more.
const REPORTS: usize = 4_096;

/// Sends what grippers and bridges tell to an MQTT broker, by Sparkplug B. It only reads, unless a gripper allows commands. docs/telemetry.md has the settings.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The settings, a TOML file.
    #[arg(required_unless_present = "reference")]
    config: Option<PathBuf>,
    /// Checks the settings and ends.
    #[arg(long)]
    check: bool,
    /// Prints all settings and metrics, as tables in Markdown.
    #[arg(long)]
    reference: bool,
}

/// Runs until a signal ends it: Ctrl-C or SIGTERM.
pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let Some(path) = arguments.config.as_ref().filter(|_| !arguments.reference) else {
        print!("{}", reference::text());
        return Ok(ExitCode::SUCCESS);
    };
    let telemetry = Telemetry::read(path)?;
    let broker = broker::Broker::new(&telemetry.broker)?;
    if arguments.check {
        println!(
            "{}: {} devices to {} as {}/{}",
            path.display(),
            telemetry.devices.len(),
            telemetry.broker.host,
            telemetry.group,
            telemetry.node
        );
        return Ok(ExitCode::SUCCESS);
    }
    let mut sequence = Sequence::open(&telemetry.state_file)?;
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    LocalSet::new().block_on(&runtime, send(telemetry, broker, &mut sequence))?;
    Ok(ExitCode::SUCCESS)
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
    // The broker is told NDEATH, and each gripper that its connection ends, at the same time.
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
    /// What is told of it.
    const fn table(&self) -> &'static [Metric] {
        match self {
            Self::Gripper(_) => GRIPPER,
            Self::Bridge(_) => BRIDGE,
        }
    }
}

/// Is ready when the program is asked to end.
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

/// Is ready when the program is asked to end.
#[cfg(not(unix))]
async fn signalled() -> Result<()> {
    tokio::signal::ctrl_c().await?;
    Ok(())
}
