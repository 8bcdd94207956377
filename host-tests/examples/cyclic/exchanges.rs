//! The exchanges, and the busy loops beside them.

use std::hint;
use std::process::{Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use host_tests::ethernetip::{Reception, Scanner, Times, own_address, until};
use host_tests::example::{self, Process};
use host_tests::gateway::Gateway;
use host_tests::masters::{PYTHON_VARIABLE, printed};
use host_tests::namespaces::{Network, at_controller, prioritize_grippers, prioritize_threads};
use wsg_fieldbus::OutputImage;
use wsg_protocol::Status;
use wsg_sim::Config;
use wsg_sim::server::{Lines, ServerThread};

/// The unit that asks for the gateway's priority.
const UNIT: &str = include_str!("../../../tool/service/wsg-gateway.service");
/// The PROFINET controller.
const CONTROLLER: &str = include_str!("../../tests/end_to_end/profinet/profinet_py.py");
/// The connection ends after 8 intervals without a packet.
const TIMES: Times = Times { interval: Duration::from_millis(10), multiplier: 1 };
/// Time limit of every wait.
const BOUND: Duration = Duration::from_secs(60);

type Exchange = fn(&Options) -> Result<Reception>;

const EXCHANGES: [(&str, Exchange); 3] = [
    ("ethernetip-wsg-sim", ethernetip_with_wsg_sim),
    ("ethernetip-gateway", ethernetip_through_gateway),
    ("profinet-gateway", profinet_through_gateway),
];

/// Measures cyclic exchange.
#[derive(Parser)]
pub(crate) struct Options {
    /// Duration of each exchange.
    #[arg(long, default_value_t = 5)]
    seconds: u64,
    /// Numbers of busy loops. Each exchange runs beside each number.
    #[arg(long, value_delimiter = ',', default_value = "0,2")]
    loops: Vec<usize>,
    /// Runs only the exchanges with this text in their names.
    #[arg(long, default_value = "")]
    only: String,
    /// Runs `wsg-sim` and the gateway without real-time priority.
    #[arg(long)]
    ordinary: bool,
}

/// Runs the exchanges. Returns exit status 1 when a connection timed out.
pub(crate) fn measure(options: &Options) -> Result<ExitCode> {
    let selected: Vec<_> = EXCHANGES.iter().filter(|(name, _)| name.contains(&options.only)).collect();
    ensure!(!selected.is_empty(), "no exchange has {:?} in its name", options.only);
    let mut time_outs = 0;
    println!(
        "{:20} {:>10} {:>9} {:>9} {:>11}",
        "exchange", "busy loops", "packets", "time-outs", "longest gap"
    );
    for loops in &options.loops {
        for (name, exchange) in &selected {
            let _busy = BusyLoops::start(*loops);
            let found = exchange(options)?;
            let gap = found.longest_gap.as_secs_f64() * 1e3;
            println!("{name:20} {loops:>10} {:>9} {:>9} {gap:>8.1} ms", found.packets, found.time_outs);
            time_outs += found.time_outs;
        }
    }
    Ok(ExitCode::from(u8::from(time_outs > 0)))
}

/// Threads that use as much processor time as they get. They end on drop.
struct BusyLoops(Arc<AtomicBool>);

impl BusyLoops {
    fn start(count: usize) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        for _ in 0..count {
            let is_over = Arc::clone(&is_over);
            thread::spawn(move || {
                while !is_over.load(Ordering::Relaxed) {
                    hint::black_box(());
                }
            });
        }
        Self(is_over)
    }
}

impl Drop for BusyLoops {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn ethernetip_with_wsg_sim(options: &Options) -> Result<Reception> {
    let address = own_address();
    let mut command = Command::new(example::program("wsg-sim"));
    command.args(["--ethernetip", &address.to_string()]).stdin(Stdio::null()).stdout(Stdio::null());
    let gripper = Process(command.spawn()?);
    let scanner = Scanner::with(address, OutputImage::ZERO, TIMES);
    received(&scanner, gripper.0.id(), options)
}

fn ethernetip_through_gateway(options: &Options) -> Result<Reception> {
    let address = own_address();
    let (_gripper, gateway) = gateway("--ethernetip", &address.to_string())?;
    let scanner = Scanner::with(address, OutputImage::ZERO, TIMES);
    received(&scanner, gateway.process.id(), options)
}

fn profinet_through_gateway(options: &Options) -> Result<Reception> {
    let network = Network::new();
    let (_gripper, gateway) = gateway("--profinet", &network.take_gripper_end())?;
    prioritize(gateway.process.id(), options)?;
    let python = std::env::var(PYTHON_VARIABLE).with_context(|| format!("{PYTHON_VARIABLE} is not set"))?;
    let mut controller = at_controller(network.number(), &python);
    let output = controller.args(["-c", CONTROLLER, "exchange", &options.seconds.to_string()]).output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let numbers: Vec<&str> = text.split_whitespace().collect();
    ensure!(output.status.success() && numbers.len() == 3, "{}", printed(&output));
    Ok(Reception {
        packets: numbers[0].parse()?,
        time_outs: numbers[1].parse()?,
        longest_gap: Duration::from_secs_f64(numbers[2].parse::<f64>()? / 1e3),
    })
}

/// Starts a gripper and its gateway on a bus.
fn gateway(option: &str, bus: &str) -> Result<(ServerThread, Gateway)> {
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let gripper = ServerThread::start(Config::default(), &lines, None)?;
    prioritize_grippers();
    let gateway = Gateway::start(gripper.tcp_address().context("it has a port")?, &[option, bus]);
    Ok((gripper, gateway))
}

/// Exchanges images with a gripper for some time.
fn received(scanner: &Scanner, adapter: u32, options: &Options) -> Result<Reception> {
    prioritize(adapter, options)?;
    let is_connected = || scanner.read(BOUND).is_some_and(|inputs| inputs.status != Status::IoError);
    until("the gripper is connected", is_connected);
    prioritize_threads(Scanner::THREAD);
    let _ = scanner.take_reception();
    thread::sleep(Duration::from_secs(options.seconds));
    Ok(scanner.take_reception())
}

/// Gives a process the priority of the gateway's unit, unless the options refuse it.
fn prioritize(process: u32, options: &Options) -> Result<()> {
    if options.ordinary {
        return Ok(());
    }
    let value = |key| UNIT.lines().find_map(|line| line.strip_prefix(key)).context(key);
    let policy = format!("--{}", value("CPUSchedulingPolicy=")?);
    let priority = value("CPUSchedulingPriority=")?;
    let mut chrt = Command::new("chrt");
    chrt.args(["--all-tasks", &policy, "--pid", priority, &process.to_string()]);
    let output = chrt.output().context("chrt of Debian's util-linux")?;
    ensure!(output.status.success(), "{}", printed(&output));
    Ok(())
}
