//! Reads a bridge over its service port, which moves nothing (docs/service-port.md): the gripper behind it, and the bridge
//! itself.

use std::time::Duration;

use anyhow::{Context as _, Result, anyhow, bail};
use serial2_tokio::SerialPort;
use tokio::{
    sync::watch,
    time::{MissedTickBehavior, interval, sleep, timeout},
};
use tokio_modbus::{
    ExceptionCode, Request, Response,
    client::{Client, Context, rtu},
    prelude::Slave,
};
use wsg_bridge_fw::registers::{EVENTS, FIRST_REPORT, MAP_VERSION, REPORTS};
use wsg_fieldbus::{ForceUnit, GripperFlags, InputImage};
use wsg_protocol::{DeviceType, GripperState};

use super::{
    config::Data,
    metrics::{BRIDGE, OfBridge, Value},
    report::{Reporter, Teller, What, stopped},
    values::Values,
};

/// The service port's rate in bit/s, and its unit.
const RATE: u32 = 115_200;
const UNIT: Slave = Slave(1);
/// Registers of the input image.
const IMAGE_REGISTERS: u16 = (InputImage::LEN / 2) as u16;
/// How many reports are read: those before the events.
const REPORT_REGISTERS: u16 = place("EVENTS") as u16 + 1;
/// How long an answer may take: the bridge answers within milliseconds, a busy computer does not.
const PATIENCE: Duration = Duration::from_millis(1_500);
/// How long after a bridge was lost or not found it is looked for again.
const RETRY: Duration = Duration::from_secs(1);
/// How often the reports are read.
const REPORTS_EVERY: Duration = Duration::from_secs(1);

/// The place of a report, when this is compiled.
const fn place(name: &str) -> usize {
    let mut at = 0;
    while at < REPORTS.len() {
        if is_same(REPORTS[at].name, name) {
            return at;
        }
        at += 1;
    }
    panic!("there is no report of this name")
}

const fn is_same(one: &str, other: &str) -> bool {
    let (one, other) = (one.as_bytes(), other.as_bytes());
    let mut at = 0;
    while at < one.len() && at < other.len() && one[at] == other[at] {
        at += 1;
    }
    at == one.len() && at == other.len()
}

/// Where the flags and what is made of them are.
const FLAGS: [OfBridge; 5] =
    [OfBridge::Flags, OfBridge::Referenced, OfBridge::Moving, OfBridge::FastStop, OfBridge::Fault];

/// Reads the bridge until `stop` says so.
pub(super) async fn read(port: String, data: Data, reporter: Reporter, mut stop: watch::Receiver<bool>) {
    let mut teller = Teller::default();
    loop {
        tokio::select! {
            // May be given up at any place: the port moves nothing, and is closed with the future.
            end = serve(&port, &data, &reporter, &mut teller) => {
                if let Err(error) = end {
                    teller.tell(format!("{} ({port}): {error:#}", reporter.name));
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

async fn serve(port: &str, data: &Data, reporter: &Reporter, teller: &mut Teller) -> Result<()> {
    let line = SerialPort::open(port, RATE)?;
    // What is there is an answer to somebody before.
    line.discard_input_buffer()?;
    let mut bridge = rtu::attach_slave(line, UNIT);
    let mut reports = reports(&mut bridge).await.context("no bridge answers")?;
    let version = reports.first().copied().unwrap_or_default();
    if version != MAP_VERSION {
        bail!("the bridge has version {version} of the register map: expected {MAP_VERSION}");
    }
    let mut values = Values::new(BRIDGE);
    values.take_reports(&reports);
    values.take_image(image(&mut bridge).await?, &reports, data);
    teller.tell(format!("{}: found", reporter.name));
    reporter.tell(What::Found { values: values.all(), ranges: vec![None; BRIDGE.len()] }).await;
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
                }
            }
            if let Some(changed) = values.changed() {
                reporter.tell(changed).await;
            }
        }
    };
    let end: Result<()> = end.await;
    reporter.tell(What::Lost).await;
    end
}

/// The reports.
async fn reports(bridge: &mut Context) -> Result<Vec<u16>> {
    let reports = read_registers(bridge, FIRST_REPORT, REPORT_REGISTERS).await?;
    reports.map_err(|exception| anyhow!("it refuses to report: {exception}"))
}

/// What the PLC reads; `None` while no gripper answers.
async fn image(bridge: &mut Context) -> Result<Option<InputImage>> {
    match read_registers(bridge, 0, IMAGE_REGISTERS).await? {
        Ok(registers) => {
            let bytes: Vec<u8> = registers.iter().flat_map(|register| register.to_be_bytes()).collect();
            Ok(bytes.try_into().ok().map(InputImage::from_bytes))
        }
        Err(ExceptionCode::GatewayPathUnavailable | ExceptionCode::GatewayTargetDevice) => Ok(None),
        Err(exception) => bail!("it refuses the input image: {exception}"),
    }
}

/// So many input registers, or the bridge's exception. Not by the client's own method: that takes an answer of another
/// length, such as a late one to another request, for a bug of this program.
async fn read_registers(
    bridge: &mut Context,
    first: u16,
    count: u16,
) -> Result<Result<Vec<u16>, ExceptionCode>> {
    let answered = timeout(PATIENCE, bridge.call(Request::ReadInputRegisters(first, count))).await;
    match answered.map_err(|_| anyhow!("no answer within {} ms", PATIENCE.as_millis()))?? {
        Ok(Response::ReadInputRegisters(registers)) if registers.len() == usize::from(count) => {
            Ok(Ok(registers))
        }
        Ok(_) => bail!("an answer came that is none to what was asked"),
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
