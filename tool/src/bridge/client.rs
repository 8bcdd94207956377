//! The bridge over its service port: Modbus RTU, unit 1, 115 200 bit/s, 8N1 (docs/service-port.md).

use std::fmt;
use std::future::Future;
use std::io::{self, ErrorKind};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use serial2_tokio::SerialPort;
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;
use tokio_modbus::client::{Client as _, Context, rtu};
use tokio_modbus::prelude::{Slave, Writer};
use tokio_modbus::{Error, ExceptionCode, Request, Response};
use wsg_bridge_fw::BusConfig;
use wsg_bridge_fw::registers::{
    COMMAND_KEY, COMMANDS, FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, MAP_VERSION, REPORTS, Record,
    SETTINGS, StoreCommand,
};
use wsg_fieldbus::InputImage;

use super::names::report;

/// How long an answer may take: the bridge answers within milliseconds, a busy computer does not.
const PATIENCE: Duration = Duration::from_millis(1_500);
/// How often a question is asked.
const TRIES: u32 = 3;

/// How long the gripper may take to tell width and force for the first time.
const FIRST_VALUES: Duration = Duration::from_millis(200);

/// Registers of the input image.
const IMAGE_REGISTERS: u16 = (InputImage::LEN / 2) as u16;

// Each is read by one request.
const _: () = assert!(SETTINGS.len() <= 123 && REPORTS.len() <= 125);

/// A bridge.
pub(crate) struct Client {
    port: String,
    runtime: Runtime,
    /// `None` once the line is gone.
    context: Option<Context>,
    image_was_read: bool,
}

/// Why a request was not carried out.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The bridge refuses it.
    Refused(ExceptionCode),
    /// There is no answer, or a damaged one.
    NoAnswer,
    /// The port does not work any more.
    Port(io::Error),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(ExceptionCode::ServerDeviceBusy) => {
                f.write_str("the fingers move, or settings are being stored: try again when they stand")
            }
            Self::Refused(ExceptionCode::IllegalDataValue) => f.write_str("the bridge refuses the value"),
            Self::Refused(exception) => write!(f, "the bridge refuses: {exception}"),
            Self::NoAnswer => f.write_str("the bridge does not answer any more"),
            Self::Port(error) => write!(f, "the port does not work any more: {error}"),
        }
    }
}

impl std::error::Error for Failure {}

impl Client {
    /// Opens the port, and sees that a bridge with this register map answers.
    pub(crate) fn open(port: &str) -> Result<Self> {
        let runtime = Builder::new_current_thread().enable_all().build().context("cannot start")?;
        let context = Some(connect(&runtime, port)?);
        let mut client = Self { port: port.to_owned(), runtime, context, image_was_read: false };
        let version = match client.read_reports(1) {
            Ok(reports) => reports.first().copied().unwrap_or_default(),
            Err(Failure::NoAnswer) => bail!(
                "nothing answers at {port}: is it the service port of the bridge (the USB cable of the ST-Link), is the board \
                 powered, and does no other program use the port?"
            ),
            Err(Failure::Refused(exception)) => bail!("what answers at {port} is no bridge: {exception}"),
            Err(failure) => return Err(failure.into()),
        };
        if version != MAP_VERSION {
            bail!(
                "the bridge at {port} has version {version} of the register map, and this wsg knows version {MAP_VERSION}: \
                 use the wsg of the bridge's release, or flash the image of this one"
            );
        }
        Ok(client)
    }

    /// All settings.
    pub(crate) fn settings(&mut self) -> Result<Record, Failure> {
        let count = SETTINGS.len() as u16;
        let values = self.read(&Request::ReadHoldingRegisters(FIRST_SETTING, count), count)?;
        Record::try_from(values).map_err(|_| Failure::NoAnswer)
    }

    /// All reports.
    pub(crate) fn reports(&mut self) -> Result<Vec<u16>, Failure> {
        self.read_reports(REPORTS.len() as u16)
    }

    fn read_reports(&mut self, count: u16) -> Result<Vec<u16>, Failure> {
        self.read(&Request::ReadInputRegisters(FIRST_REPORT, count), count)
    }

    /// The version of the firmware.
    pub(crate) fn firmware(&mut self) -> Result<String, Failure> {
        let reports = self.reports()?;
        let of = |name: &str| reports.get(report(name)).copied().unwrap_or_default();
        let [major, minor] = of("BRIDGE_VERSION").to_be_bytes();
        Ok(format!("{major}.{minor}.{}", of("BRIDGE_PATCH")))
    }

    /// What the PLC reads; `None` while there is no gripper that answers.
    pub(crate) fn image(&mut self) -> Result<Option<InputImage>, Failure> {
        if !self.image_was_read {
            // The bridge asks the gripper for width and force from the first request for them on.
            self.read_image()?;
            self.image_was_read = true;
            thread::sleep(FIRST_VALUES);
        }
        self.read_image()
    }

    fn read_image(&mut self) -> Result<Option<InputImage>, Failure> {
        let registers = match self.read(&Request::ReadInputRegisters(0, IMAGE_REGISTERS), IMAGE_REGISTERS) {
            Err(Failure::Refused(
                ExceptionCode::GatewayPathUnavailable | ExceptionCode::GatewayTargetDevice,
            )) => return Ok(None),
            registers => registers?,
        };
        let bytes: Vec<u8> = registers.iter().flat_map(|register| register.to_be_bytes()).collect();
        Ok(bytes.try_into().ok().map(InputImage::from_bytes))
    }

    /// Writes settings from this place of a record on: all of them, or none. Not a second time by itself: what came of it is to be
    /// read.
    pub(crate) fn write(&mut self, place: usize, values: &[u16]) -> Result<(), Failure> {
        let first = FIRST_SETTING + place as u16;
        self.ask_once(async |context| context.write_multiple_registers(first, values).await)
    }

    /// Has settings stored, taken back or delivered ones taken, and waits until that is done.
    pub(crate) fn command(&mut self, command: StoreCommand) -> Result<()> {
        let place = COMMANDS.iter().position(|it| it.command == command).unwrap_or_default();
        let register = FIRST_COMMAND + place as u16;
        self.ask_once(async |context| context.write_single_register(register, COMMAND_KEY).await)?;
        if command == StoreCommand::Restore {
            return Ok(());
        }
        // A save takes some 50 ms.
        for _ in 0..200 {
            match self.reports()?.get(report("SAVE_STATE")) {
                Some(1) => {}
                Some(2) => return Ok(()),
                _ => {
                    bail!("the settings were not stored: `events` says why; what was stored before still is")
                }
            }
        }
        bail!("the bridge does not finish storing the settings");
    }

    /// So many registers. Not by the crate's own methods: those take an answer of another length, such as a late one to another
    /// request, for a bug of this program, and panic.
    fn read(&mut self, request: &Request<'static>, count: u16) -> Result<Vec<u16>, Failure> {
        self.ask(async |context| match context.call(request.clone()).await? {
            Ok(Response::ReadHoldingRegisters(registers) | Response::ReadInputRegisters(registers))
                if registers.len() == usize::from(count) =>
            {
                Ok(Ok(registers))
            }
            Ok(_) => Err(Error::Transport(ErrorKind::InvalidData.into())),
            Err(exception) => Ok(Err(exception)),
        })
    }

    /// Asks again where no answer comes.
    fn ask<T>(
        &mut self,
        mut request: impl AsyncFnMut(&mut Context) -> Result<Result<T, ExceptionCode>, Error>,
    ) -> Result<T, Failure> {
        for _ in 1..TRIES {
            match self.ask_once(&mut request) {
                Err(Failure::NoAnswer) => {}
                done => return done,
            }
        }
        self.ask_once(request)
    }

    fn ask_once<T>(
        &mut self,
        mut request: impl AsyncFnMut(&mut Context) -> Result<Result<T, ExceptionCode>, Error>,
    ) -> Result<T, Failure> {
        if self.context.is_none() {
            // Anew: what comes late must not be taken for the answer to something else.
            let opened = connect(&self.runtime, &self.port);
            self.context = Some(opened.map_err(|error| Failure::Port(io::Error::other(error)))?);
        }
        let Some(context) = &mut self.context else { return Err(Failure::NoAnswer) };
        let asked = self.runtime.block_on(within(request(context)));
        let failure = match asked {
            Some(Ok(Ok(answer))) => return Ok(answer),
            Some(Ok(Err(exception))) => return Err(Failure::Refused(exception)),
            Some(Err(Error::Transport(error))) if is_of_the_port(&error) => Failure::Port(error),
            Some(Err(_)) | None => Failure::NoAnswer,
        };
        self.context = None;
        Err(failure)
    }
}

async fn within<T>(answer: impl Future<Output = T>) -> Option<T> {
    timeout(PATIENCE, answer).await.ok()
}

/// Whether it is the port that failed, and not an answer that was damaged.
fn is_of_the_port(error: &io::Error) -> bool {
    !matches!(error.kind(), ErrorKind::InvalidData | ErrorKind::InvalidInput | ErrorKind::TimedOut)
}

fn connect(runtime: &Runtime, port: &str) -> Result<Context> {
    let _inside = runtime.enter();
    let opened = SerialPort::open(port, BusConfig::SERVICE.baud);
    let opened = opened.map_err(|error| anyhow::anyhow!(not_opened(port, &error)))?;
    // What came before is an answer to somebody else.
    let _ = opened.discard_input_buffer();
    Ok(rtu::attach_slave(opened, Slave(BusConfig::SERVICE.unit)))
}

/// Why a port cannot be opened, and what to do.
fn not_opened(port: &str, error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => {
            let others = SerialPort::available_ports().unwrap_or_default();
            let others: Vec<String> = others.iter().map(|port| port.display().to_string()).collect();
            let others = if others.is_empty() { "none".to_owned() } else { others.join(", ") };
            format!(
                "there is no port {port}; this computer has {others}. Is the cable in the USB connector of the ST-Link?"
            )
        }
        ErrorKind::PermissionDenied => format!(
            "{port} may not be opened: on Linux add yourself to the group dialout (sudo usermod -a -G dialout $USER), and log in \
             again; on Windows end the program that uses it"
        ),
        ErrorKind::ResourceBusy => format!("{port} is used by another program"),
        _ => format!("{port} cannot be opened as a serial port: {error}"),
    }
}
