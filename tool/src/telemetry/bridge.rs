//! Reads a bridge and its gripper over the service port, which cannot move the fingers (docs/commissioning.md), or a gateway over
//! Modbus/TCP, without any write (docs/gateway.md).

use std::time::Duration;

use anyhow::{Context as _, Result, anyhow, bail};
use tokio::{
    sync::watch,
    time::{MissedTickBehavior, interval, sleep, timeout},
};
use tokio_modbus::{
    ExceptionCode, Request, Response,
    client::{Client, Context},
};
use wsg_bridge_fw::registers::{EVENTS, FIRST_REPORT, MAP_VERSION, REPORTS};
use wsg_fieldbus::{ForceUnit, GripperFlags, InputImage};
use wsg_protocol::{DeviceType, GripperState};
use wsg_sim::command_line::after_scheme;

use super::{
    config::Data,
    metrics::{BRIDGE, GATEWAY, Metric, OfBridge, Value, of_reported},
    report::{Messages, Reporter, What, stopped},
    values::Values,
};
use crate::bridge::{client::connect, gateway_reports};

/// Number of registers of the input image.
const IMAGE_REGISTERS: u16 = (InputImage::LEN / 2) as u16;
/// Number of report registers read, up to and including the event counter.
const REPORT_REGISTERS: u16 = place("EVENTS") as u16 + 1;
/// Response time-out. The bridge responds within milliseconds, but a busy computer may be slow.
const PATIENCE: Duration = Duration::from_millis(1_500);
/// Delay before reconnecting to a bridge.
const RETRY: Duration = Duration::from_secs(1);
/// Interval between two readings of the reports.
const REPORTS_EVERY: Duration = Duration::from_secs(1);

/// Returns the index of a report at compile time.
const fn place(name: &str) -> usize {
    let mut at = 0;
    while at < REPORTS.len() {
        if is_same(REPORTS[at].name, name) {
            return at;
        }
        at += 1;
    }
    panic!("unknown report name")
}

const fn is_same(one: &str, other: &str) -> bool {
    let (one, other) = (one.as_bytes(), other.as_bytes());
    let mut at = 0;
    while at < one.len() && at < other.len() && one[at] == other[at] {
        at += 1;
    }
    at == one.len() && at == other.len()
}

/// The rows derived from the system state flags.
const FLAGS: [OfBridge; 5] =
    [OfBridge::Flags, OfBridge::Referenced, OfBridge::Moving, OfBridge::FastStop, OfBridge::Fault];

/// Returns the metrics of the bridge or gateway at this port.
pub(super) fn table(port: &str) -> &'static [Metric] {
    if after_scheme(port, "tcp://").is_some() { GATEWAY } else { BRIDGE }
}

/// Reads the bridge until `stop` is set, and reconnects after errors.
pub(super) async fn read(port: String, data: Data, reporter: Reporter, mut stop: watch::Receiver<bool>) {
    let mut messages = Messages::default();
    loop {
        tokio::select! {
            // Can be cancelled anywhere: reading never moves the fingers, and dropping the future closes the port.
            end = serve(&port, &data, &reporter, &mut messages) => {
                if let Err(error) = end {
                    messages.print(format!("{} ({port}): {error:#}", reporter.name));
                }
            }
            () = stopped(&mut stop) => return,
        }
        tokio::select! {
            () = sleep(RETRY) => {}
            () = stopped(&mut stop) => return,
        }
    }
}

async fn serve(port: &str, data: &Data, reporter: &Reporter, messages: &mut Messages) -> Result<()> {
    let table = table(port);
    let mut bridge = connect(port).await?;
    let mut reports = reports(&mut bridge).await.context("no bridge responds")?;
    let version = reports.first().copied().unwrap_or_default();
    if version != MAP_VERSION {
        bail!("the bridge has register map version {version}; expected {MAP_VERSION}");
    }
    let mut values = Values::new(table);
    values.take_reports(&reports);
    take_own_reports(&mut bridge, &mut values, table).await?;
    values.take_image(image(&mut bridge).await?, &reports, data);
    messages.print(format!("{}: connected", reporter.name));
    reporter.send(What::Found { values: values.all(), ranges: vec![None; table.len()] }).await;
    let end = async {
        let mut looks = interval(Duration::from_millis(data.period_ms.into()));
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut next_reports = interval(REPORTS_EVERY);
        loop {
            tokio::select! {
                _ = looks.tick() => values.take_image(image(&mut bridge).await?, &reports, data),
                _ = next_reports.tick() => {
                    reports = self::reports(&mut bridge).await?;
                    values.take_reports(&reports);
                    take_own_reports(&mut bridge, &mut values, table).await?;
                }
            }
            if let Some(changed) = values.changed() {
                reporter.send(changed).await;
            }
        }
    };
    let end: Result<()> = end.await;
    reporter.send(What::Lost).await;
    end
}

/// Reads the report registers.
async fn reports(bridge: &mut Context) -> Result<Vec<u16>> {
    let reports = read_registers(bridge, FIRST_REPORT, REPORT_REGISTERS).await?;
    reports.map_err(|exception| anyhow!("the bridge rejected the request for reports: {exception}"))
}

/// Reads the reports of a gateway on itself. They stay null if it is a board, connected by a converter.
async fn take_own_reports(bridge: &mut Context, values: &mut Values, table: &[Metric]) -> Result<()> {
    let first = BRIDGE.len();
    if table.len() > first
        && let Ok(registers) = read_registers(bridge, gateway_reports::FIRST, gateway_reports::LEN).await?
    {
        for (row, (report, reported)) in (first..).zip(gateway_reports::reported(&registers)) {
            values.set(row, of_reported(report, reported));
        }
    }
    Ok(())
}

/// Reads the input image, as a PLC does. Returns `None` while no gripper responds.
async fn image(bridge: &mut Context) -> Result<Option<InputImage>> {
    match read_registers(bridge, 0, IMAGE_REGISTERS).await? {
        Ok(registers) => {
            let bytes: Vec<u8> = registers.iter().flat_map(|register| register.to_be_bytes()).collect();
            Ok(bytes.try_into().ok().map(InputImage::from_bytes))
        }
        Err(ExceptionCode::GatewayPathUnavailable | ExceptionCode::GatewayTargetDevice) => Ok(None),
        Err(exception) => bail!("the bridge rejected the request for the input image: {exception}"),
    }
}

/// Reads `count` input registers, or returns the bridge's exception.
///
/// Does not use the read method of `tokio_modbus`, which panics on a response of unexpected length, such as a late response to an
/// earlier request.
async fn read_registers(
    bridge: &mut Context,
    first: u16,
    count: u16,
) -> Result<Result<Vec<u16>, ExceptionCode>> {
    let answered = timeout(PATIENCE, bridge.call(Request::ReadInputRegisters(first, count))).await;
    match answered.map_err(|_| anyhow!("no response within {} ms", PATIENCE.as_millis()))?? {
        Ok(Response::ReadInputRegisters(registers)) if registers.len() == usize::from(count) => {
            Ok(Ok(registers))
        }
        Ok(_) => bail!("unexpected response"),
        Err(exception) => Ok(Err(exception)),
    }
}

impl Values {
    fn take_reports(&mut self, reports: &[u16]) {
        let of = |place: usize| reports.get(place).copied().unwrap_or_default();
        let [major, minor] = of(const { place("BRIDGE_VERSION") }).to_be_bytes();
        let serial = u64::from(of(const { place("SERIAL_HIGH") })) << 16;
        let serial = serial | u64::from(of(const { place("SERIAL_LOW") }));
        let cause = of(const { place("ERROR_CAUSE") });
        let cause = EVENTS.iter().find(|event| u16::from(event.code as u8) == cause);
        let link = match of(const { place("GRIPPER_LINK") }) {
            0 => "never answered",
            1 => "silent",
            _ => "answers",
        };
        let device = DeviceType::from_code(of(const { place("GRIPPER_TYPE") }).to_le_bytes()[0]);
        let text = |text: &str| Some(Value::Text(text.to_owned()));
        self.set(OfBridge::Link, text(link));
        self.set(OfBridge::Cause, text(cause.map_or("", |event| event.name)));
        self.set(OfBridge::Device, text(&device.to_string()));
        self.set(OfBridge::Serial, Some(Value::Unsigned(serial)));
        self.set(OfBridge::Bridge, text(&format!("{major}.{minor}.{}", of(const { place("BRIDGE_PATCH") }))));
        for (row, count) in [
            (OfBridge::Events, of(const { place("EVENTS") })),
            (OfBridge::Disconnects, of(const { place("DISCONNECTS") })),
            (OfBridge::BadFrames, of(const { place("LINE_CHECKSUM") })),
            (OfBridge::Repeated, of(const { place("REPEATED") })),
            (OfBridge::Timeouts, of(const { place("BUS_TIMEOUTS") })),
        ] {
            self.set(row, Some(Value::Unsigned(count.into())));
        }
    }

    fn take_image(&mut self, image: Option<InputImage>, reports: &[u16], data: &Data) {
        let Some(image) = image else {
            for row in
                FLAGS.into_iter().chain([OfBridge::Width, OfBridge::Force, OfBridge::State, OfBridge::Status])
            {
                self.set(row, None);
            }
            return;
        };
        let device = reports.get(const { place("GRIPPER_TYPE") }).copied().unwrap_or_default();
        let unit = ForceUnit::of(DeviceType::from_code(device.to_le_bytes()[0]));
        self.set_flags(FLAGS, image.system);
        if self.get(OfBridge::Referenced) == Some(&Value::Boolean(true)) {
            self.measured(OfBridge::Width, f32::from(image.width) / 100.0, data.width_deadband);
        } else {
            self.set(OfBridge::Width, None);
        }
        self.measured(OfBridge::Force, f32::from(image.force) / unit.per_newton(), data.force_deadband);
        let states = GripperState::ALL.iter().filter(|state| GripperFlags::from(**state) == image.state);
        let state = states.map(|state| Value::Text(state.to_string())).next();
        self.set(OfBridge::State, state);
        self.set(OfBridge::Status, Some(Value::Text(image.status.to_string())));
    }
}
