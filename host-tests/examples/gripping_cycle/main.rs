//! The demo program of the fieldbus manual (appendix D) as a Modbus master for the virtual gripper or the bridge.
//! Homes, then repeats pre-position, grip, hold, release and start position.

mod cycle;
mod master;

use anyhow::{Context, Result, anyhow, bail, ensure};
use cycle::{Cycle, Phase};
use lexopt::{Arg, Parser, ValueExt};
use master::{Master, Target};
use std::process::ExitCode;
use std::time::{Duration, Instant};

const USAGE: &str = "\
The gripping cycle of the fieldbus manual, as a Modbus master.

Usage: gripping_cycle --tcp ADDR | --rtu DEVICE [OPTION]...

  --tcp ADDR      Modbus/TCP address of a real or virtual gripper, such as 127.0.0.1:1502
  --rtu DEVICE    serial line to the bridge, 8N1, such as /dev/ttyUSB0
  --baud N        bit rate of the serial line in bit/s (default 19200)
  --unit N        unit address, 1 to 247 (default 1)
  --cycles N      number of cycles (default 3)
  --help          show this
";

/// Scan interval.
const SCAN: Duration = Duration::from_millis(10);

struct Options {
    target: Target,
    unit: u8,
    cycles: u32,
}

fn main() -> ExitCode {
    let options = match parse(Parser::from_env()) {
        Ok(Some(options)) => options,
        Ok(None) => {
            print!("{USAGE}");
            return ExitCode::SUCCESS;
        }
        Err(error) => return fail(&error, 2),
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let done =
        runtime.context("cannot start the async runtime").and_then(|runtime| runtime.block_on(run(options)));
    done.map_or_else(|error| fail(&error, 1), |()| ExitCode::SUCCESS)
}

async fn run(options: Options) -> Result<()> {
    let mut master = Master::new(options.target, options.unit);
    let mut cycle = Cycle::new(options.cycles);
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

fn parse(mut parser: Parser) -> Result<Option<Options>> {
    let (mut tcp, mut device, mut baud) = (None, None, None);
    let (mut unit, mut cycles) = (1, 3);
    while let Some(argument) = parser.next()? {
        match argument {
            Arg::Long("tcp") => {
                tcp = Some(parser.value()?.parse().context("--tcp expects an address with a port")?)
            }
            Arg::Long("rtu") => device = Some(parser.value()?.string()?),
            Arg::Long("baud") => {
                baud = Some(parser.value()?.parse().context("--baud expects a rate in bit/s")?)
            }
            Arg::Long("unit") => unit = parser.value()?.parse().context("--unit expects 1 to 247")?,
            Arg::Long("cycles") => {
                cycles = parser.value()?.parse().context("--cycles expects a number above 0")?
            }
            Arg::Long("help") => return Ok(None),
            _ => return Err(anyhow!(argument.unexpected()).context("expected options as --help lists them")),
        }
    }
    ensure!((1..=247).contains(&unit), "--unit is {unit}; expected 1 to 247");
    ensure!(cycles > 0, "--cycles is 0; expected a number above 0");
    let target = match (tcp, device, baud) {
        (Some(address), None, None) => Target::Tcp(address),
        (None, Some(device), baud) => Target::Rtu { device, baud: baud.unwrap_or(19_200) },
        (Some(_), None, Some(_)) => bail!("--baud requires --rtu DEVICE"),
        _ => bail!("expected one of --tcp ADDR and --rtu DEVICE"),
    };
    Ok(Some(Options { target, unit, cycles }))
}

fn fail(error: &anyhow::Error, status: u8) -> ExitCode {
    eprintln!("gripping_cycle: {error:#}");
    ExitCode::from(status)
}
