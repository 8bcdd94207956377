//! The demo program of the fieldbus manual (appendix D) as a Modbus master for the virtual gripper or the bridge.
//! Homes, then repeats pre-position, grip, hold, release and start position.

mod master;

use anyhow::{Context, Result, bail};
use clap::{ArgGroup, Parser};
use host_tests::gripping_cycle::{Cycle, Phase};
use master::{Master, Target};
use std::net::SocketAddr;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Scan interval.
const SCAN: Duration = Duration::from_millis(10);

/// The gripping cycle of the fieldbus manual, as a Modbus master
#[derive(Parser)]
#[command(group = ArgGroup::new("target").required(true).args(["tcp", "rtu"]))]
struct Options {
    /// Modbus/TCP address of a real or virtual gripper, such as 127.0.0.1:1502
    #[arg(long, value_name = "ADDR", conflicts_with = "baud")]
    tcp: Option<SocketAddr>,
    /// Serial line to the bridge, 8N1, such as /dev/ttyUSB0
    #[arg(long, value_name = "DEVICE")]
    rtu: Option<String>,
    /// Bit rate of the serial line in bit/s
    #[arg(long, value_name = "N", default_value_t = 19_200)]
    baud: u32,
    /// Unit address
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=247))]
    unit: u8,
    /// Number of cycles
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    cycles: u32,
    /// Time limit for an answer in seconds, after which the request is repeated
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    answer_within: u64,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let done =
        runtime.context("cannot start the async runtime").and_then(|runtime| runtime.block_on(run(options)));
    done.map_or_else(
        |error| {
            eprintln!("gripping_cycle: {error:#}");
            ExitCode::FAILURE
        },
        |()| ExitCode::SUCCESS,
    )
}

async fn run(options: Options) -> Result<()> {
    let Options { tcp, rtu, baud, unit, cycles, answer_within } = options;
    let target = tcp.map(Target::Tcp).or(rtu.map(|device| Target::Rtu { device, baud }));
    let target = target.context("expected one of --tcp ADDR and --rtu DEVICE")?;
    let mut master = Master::new(target, unit, Duration::from_secs(answer_within));
    let mut cycle = Cycle::new(cycles);
    let begin = Instant::now();
    let outcome = scan(&mut master, &mut cycle, begin).await;
    let (counters, traffic) = (cycle.counters(), master.traffic());
    println!(
        "{} cycles in {:.1} s: {} parts held, {} not found, {} lost; {} homings, {} errors",
        counters.cycles,
        begin.elapsed().as_secs_f64(),
        counters.held,
        counters.not_found,
        counters.lost,
        counters.homings,
        counters.errors,
    );
    println!(
        "{} requests, {} repeated; slowest answer {:.1} ms",
        traffic.requests,
        traffic.repeated,
        traffic.slowest.as_secs_f64() * 1e3,
    );
    outcome
}

async fn scan(master: &mut Master, cycle: &mut Cycle, begin: Instant) -> Result<()> {
    let mut written = None;
    let mut errors = 0;
    loop {
        let input = master.read().await?;
        let now_ms = u64::try_from(begin.elapsed().as_millis())?;
        let output = cycle.scan(now_ms, &input);
        if written != Some(output) {
            master.write(&output).await?;
            written = Some(output);
        }
        if cycle.counters().errors > errors {
            errors = cycle.counters().errors;
            eprintln!("error {errors}: {}", cycle.last_error().unwrap_or_default());
        }
        match cycle.phase() {
            Phase::Finished => return Ok(()),
            Phase::GivenUp => bail!("given up: {}", cycle.last_error().unwrap_or_default()),
            _ => tokio::time::sleep(SCAN).await,
        }
    }
}
