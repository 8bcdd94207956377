//! `wsg gateway status`: reads gateways over Modbus/TCP, as one more master that never writes, and judges them.

use std::io::{self, Write};
use std::str::FromStr;
use std::sync::mpsc::channel;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow};
use clap::Args;
use serde_json::{Map, Value, json};
use wsg_sim::text::one_line;

use crate::bridge::client::GatewayAddress;
use crate::bridge::gateway_reports::{Reported, reported};
use crate::bridge::{State, read_gateway};
use crate::print_error;

/// Time-out for the answers of all gateways.
const TIME_OUT: Duration = Duration::from_secs(2);

/// Exit status if a gateway is not healthy.
const NOT_HEALTHY: u8 = 1;
/// Exit status if a gateway does not answer, as of `wsg gripper`.
const NO_CONNECTION: u8 = 6;

/// What to read.
#[derive(Args)]
pub(super) struct Arguments {
    /// Addresses of gateways, such as 192.168.1.10 or 192.168.1.10:1502?unit=2; the port is 502 unless the address has one
    #[arg(required = true, value_name = "ADDR", value_parser = GatewayAddress::from_str)]
    gateways: Vec<GatewayAddress>,
    /// Print one JSON object per gateway, with raw register values
    #[arg(long)]
    json: bool,
}

/// Prints the status of each gateway. Returns the highest exit status.
pub(super) fn run(arguments: &Arguments) -> Result<u8> {
    let end = Instant::now() + TIME_OUT;
    let readings = arguments.gateways.iter().map(|gateway| {
        let (sender, reading) = channel();
        let address = gateway.clone();
        // In a thread, which ends with the process: nothing limits the look-up of a name.
        thread::spawn(move || drop(sender.send(read_gateway(&address))));
        (gateway, reading)
    });
    let readings: Vec<_> = readings.collect();
    let mut status = 0;
    for (gateway, reading) in readings {
        let read = reading.recv_timeout(end.saturating_duration_since(Instant::now()));
        let read = read.unwrap_or_else(|_| Err(anyhow!("no answer within {} s", TIME_OUT.as_secs())));
        let read = Reading::new(read);
        status = status.max(read.status);
        let gateway = &gateway.to_string();
        match read.text(gateway) {
            _ if arguments.json => writeln!(io::stdout(), "{}", read.json(gateway))?,
            Ok(text) => io::stdout().write_all(text.as_bytes())?,
            Err(error) => print_error(format_args!("{error}")),
        }
    }
    Ok(status)
}

/// The judged values of a gateway.
pub(super) struct Reading {
    /// Exit status.
    status: u8,
    health: &'static str,
    reason: Option<String>,
    /// Bridge, and the gateway's reports on itself.
    values: Option<(State, Map<String, Value>)>,
}

impl Reading {
    /// Judges the read values, or the reason for their absence.
    pub(super) fn new(read: Result<(State, Vec<u16>)>) -> Self {
        let (status, health, reason) = match read.as_ref().map(|(state, _)| state.fault()) {
            Ok(None) => (0, "healthy", None),
            Ok(Some(fault)) => (NOT_HEALTHY, "not healthy", Some(fault)),
            Err(error) => (NO_CONNECTION, "no connection", Some(format!("{error:#}"))),
        };
        let values = read.ok().map(|(state, registers)| (state, map(&registers)));
        Self { status, health, reason, values }
    }

    /// Returns a JSON object. `gateway` is its address.
    pub(super) fn json(&self, gateway: &str) -> Value {
        let (reports, bridge, events) = match &self.values {
            Some((state, reports)) => (json!(reports), state.json(), state.events_json()),
            None => (Value::Null, Value::Null, Value::Null),
        };
        json!({
            "gateway": gateway, "health": self.health, "reason": self.reason,
            "reports": reports, "bridge": bridge, "events": events,
        })
    }

    /// Returns lines, each with a word for its topic. The first one names the gateway. Without values, returns why as an error.
    pub(super) fn text(&self, gateway: &str) -> Result<String, String> {
        let reason = self.reason.as_ref().map(|reason| format!(": {}", one_line(reason))).unwrap_or_default();
        let (state, reports) = self.values.as_ref().ok_or_else(|| format!("{gateway}{reason}"))?;
        let (health, summary, lines) = (self.health, state.summary(), lines(state, reports));
        Ok(format!("gateway    {gateway} is {health}{reason}\n{summary}{lines}"))
    }
}

/// Returns the reports by name.
fn map(registers: &[u16]) -> Map<String, Value> {
    let value = |reported| match reported {
        Reported::Number(number) => json!(number),
        Reported::Address(address) => json!(address),
    };
    reported(registers).map(|(report, reported)| (report.name.to_owned(), value(reported))).collect()
}

/// Formats the reports, and the bridge's counters and latest event.
fn lines(state: &State, reports: &Map<String, Value>) -> String {
    let of = |name: &str| reports.get(name).and_then(Value::as_u64).unwrap_or_default();
    let ms = |name: &str| of(name) as f64 / 1e3;
    let plc = match reports.get("PLC_ADDRESS").and_then(Value::as_str) {
        Some(address) => {
            let address = if address == "0.0.0.0" { "a PROFINET controller" } else { address };
            format!("{address}, cycle {:.3} ms, jitter {:.3} ms", ms("CYCLE_TIME"), ms("JITTER"))
        }
        None => "none writes".to_owned(),
    };
    let [timeouts, refused, losses] =
        ["BUS_TIMEOUTS", "COMMANDS_REFUSED", "DISCONNECTS"].map(|name| state.report(name));
    let rows = [
        ("PLC", plc),
        ("cycles", format!("missed {}, time-outs {timeouts}", of("MISSED_CYCLES"))),
        ("masters", format!("connected {}, connections {}", of("MASTERS"), of("MASTER_CONNECTIONS"))),
        ("line", format!("connections to the gripper {}, losses {losses}", of("GRIPPER_CONNECTIONS"))),
        ("computer", format!("pauses {}, longest {} ms", of("PAUSES"), of("LONGEST_PAUSE"))),
        ("commands", format!("refused {refused}")),
        ("event", state.latest_event()),
    ];
    rows.map(|(name, words)| format!("{name:<11}{words}\n")).concat()
}
