//! Client for the service port of the bridge: Modbus RTU, unit 1, 115 200 bit/s, 8N1 (docs/commissioning.md); or for a gateway, which
//! has the same registers over Modbus/TCP (docs/gateway.md).

use std::fmt;
use std::future::Future;
use std::io::{self, ErrorKind};
use std::str::FromStr;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use bus_modbus::Function;
use bus_modbus::rtu::crc;
use serial2_tokio::SerialPort;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;
use tokio_modbus::client::{Client as _, Context, rtu, tcp};
use tokio_modbus::prelude::{Slave, Writer};
use tokio_modbus::{Error, ExceptionCode, Request, Response};
use wsg_bridge_fw::BusConfig;
use wsg_bridge_fw::registers::{
    COMMAND_KEY, COMMANDS, FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, MAP_VERSION, REPORTS, Record,
    RegisterCommand, SETTINGS, StoreCommand, UpdateCommand,
};
use wsg_fieldbus::InputImage;
use wsg_sim::command_line::after_scheme;

use super::names::report;
use super::strays::WithoutStrays;
use crate::bridge::gateway_reports;
use crate::gripper::with_port;

/// Response time-out. The bridge responds within milliseconds, but a busy computer may be slow.
const PATIENCE: Duration = Duration::from_millis(1_500);
/// Where the service port is. While a port does not answer, its board is unknown.
const SERVICE_PORT: &str =
    "the board's USB connector; on a board with two, such as the B-L475E-IOT01A, the one of the ST-Link";

/// Default port of Modbus/TCP.
const MODBUS_PORT: u16 = 502;

/// Number of attempts for a read request.
const TRIES: u32 = 3;

/// Longest time of a save. A board takes about 50 ms; the disk of a gateway may be slow.
const SAVE_TIME: Duration = Duration::from_secs(15);
/// Time between two requests for its end.
const SAVE_POLL: Duration = Duration::from_millis(10);

/// Delay until the gripper has reported width and force for the first time.
const FIRST_VALUES: Duration = Duration::from_millis(200);

/// Number of registers of the input image.
const IMAGE_REGISTERS: u16 = (InputImage::LEN / 2) as u16;

// Each table fits into one read request.
const _: () = assert!(SETTINGS.len() <= 123 && REPORTS.len() <= 125);

/// A connection to a bridge.
pub(crate) struct Client {
    port: String,
    runtime: Runtime,
    /// The open port, or `None` after a failure.
    context: Option<Context>,
    /// The open port while blocks are written: `tokio-modbus` does not know their response.
    block_line: Option<WithoutStrays<SerialPort>>,
    image_was_read: bool,
}

/// The address of a gateway: `HOST[:502][?unit=1]`, with or without `tcp://`.
#[derive(Clone, Debug)]
pub(crate) struct GatewayAddress {
    /// Host name or IP address, and port.
    host: String,
    unit: u8,
}

impl GatewayAddress {
    /// Returns the address of a port, with the unit that several grippers on it have.
    pub(crate) fn new(host: impl fmt::Display, unit: Option<u8>) -> Self {
        Self { host: host.to_string(), unit: unit.unwrap_or(BusConfig::SERVICE.unit) }
    }
}

impl FromStr for GatewayAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("wrong address `{text}`; expected tcp://HOST[:502][?unit=1]");
        let place = after_scheme(text, "tcp://").unwrap_or(text);
        let (host, unit) = match place.split_once("?unit=") {
            Some((host, unit)) => (host, Some(unit.parse().map_err(|_| wrong())?)),
            None => (place, None),
        };
        Ok(Self::new(with_port(host, MODBUS_PORT, wrong)?, unit))
    }
}

impl fmt::Display for GatewayAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, unit } = self;
        if *unit == BusConfig::SERVICE.unit { f.write_str(host) } else { write!(f, "{host}?unit={unit}") }
    }
}

/// Why a request was not carried out.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The bridge rejected the request.
    Refused(ExceptionCode),
    /// No response, or a corrupted one.
    NoAnswer,
    /// The serial port failed.
    Port(io::Error),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(ExceptionCode::ServerDeviceBusy) => {
                f.write_str("the fingers are moving or settings are being stored; try again later")
            }
            Self::Refused(ExceptionCode::IllegalDataValue) => f.write_str("the bridge rejected the value"),
            Self::Refused(exception) => write!(f, "the bridge rejected the request: {exception}"),
            Self::NoAnswer => f.write_str("the bridge no longer responds"),
            Self::Port(error) => write!(f, "the port failed: {error}"),
        }
    }
}

impl std::error::Error for Failure {}

impl Client {
    /// Opens the serial port, or the connection to `tcp://HOST[:502][?unit=1]`, and checks that a bridge with the supported register map
    /// responds.
    pub(crate) fn open(port: &str) -> Result<Self> {
        let mut client = Self::open_any(port)?;
        let version = match client.read_reports(1) {
            Ok(reports) => reports.first().copied().unwrap_or_default(),
            Err(Failure::NoAnswer) => bail!(
                "no response at {port}; check that it is the bridge's service port ({SERVICE_PORT}), that the board is powered, and \
                 that no other program uses the port"
            ),
            Err(Failure::Refused(exception)) => bail!("the device at {port} is not a bridge: {exception}"),
            Err(failure) => return Err(failure.into()),
        };
        if version != MAP_VERSION {
            bail!(
                "the bridge at {port} has register map version {version}, but this wsg supports version {MAP_VERSION}; \
                 use the wsg of the bridge's release, or flash the firmware of this release"
            );
        }
        Ok(client)
    }

    /// Opens a connection without a request, for a bridge with any register map.
    pub(crate) fn open_any(port: &str) -> Result<Self> {
        let runtime =
            Builder::new_current_thread().enable_all().build().context("cannot start the I/O runtime")?;
        let context = Some(runtime.block_on(connect(port))?);
        Ok(Self { port: port.to_owned(), runtime, context, block_line: None, image_was_read: false })
    }

    /// Reads all settings, in the order of `SETTINGS`.
    pub(crate) fn settings(&mut self) -> Result<Record, Failure> {
        let count = SETTINGS.len() as u16;
        let values = self.read(&Request::ReadHoldingRegisters(FIRST_SETTING, count), count)?;
        Record::try_from(values).map_err(|_| Failure::NoAnswer)
    }

    /// Reads all reports, in the order of `REPORTS`.
    pub(crate) fn reports(&mut self) -> Result<Vec<u16>, Failure> {
        self.read_reports(REPORTS.len() as u16)
    }

    /// Reads the registers of a gateway's reports on itself.
    pub(crate) fn gateway_reports(&mut self) -> Result<Vec<u16>, Failure> {
        self.read(
            &Request::ReadInputRegisters(gateway_reports::FIRST, gateway_reports::LEN),
            gateway_reports::LEN,
        )
    }

    fn read_reports(&mut self, count: u16) -> Result<Vec<u16>, Failure> {
        self.read(&Request::ReadInputRegisters(FIRST_REPORT, count), count)
    }

    /// Reads the first reports, which are the same in every register map: its version and that of the firmware.
    pub(crate) fn first_reports(&mut self) -> Result<Vec<u16>, Failure> {
        self.read_reports(1 + report("BRIDGE_PATCH") as u16)
    }

    /// Reads the firmware version, such as `0.1.0`.
    pub(crate) fn firmware(&mut self) -> Result<String, Failure> {
        let reports = self.first_reports()?;
        let of = |name: &str| reports.get(report(name)).copied().unwrap_or_default();
        let [major, minor] = of("BRIDGE_VERSION").to_be_bytes();
        Ok(format!("{major}.{minor}.{}", of("BRIDGE_PATCH")))
    }

    /// Reads the input image, as a PLC does. Returns `None` while no gripper responds.
    pub(crate) fn image(&mut self) -> Result<Option<InputImage>, Failure> {
        if !self.image_was_read {
            // The bridge starts polling width and force at the first request for them.
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

    /// Writes consecutive settings, starting at an index of the record: all of them or none.
    ///
    /// Never retries. After an error, read the settings to find out whether they were written.
    pub(crate) fn write(&mut self, place: usize, values: &[u16]) -> Result<(), Failure> {
        let first = FIRST_SETTING + place as u16;
        self.ask_once(async |context| context.write_multiple_registers(first, values).await)
    }

    /// Stores the settings, reverts to the stored ones or resets to the defaults, and waits for completion.
    pub(crate) fn command(&mut self, command: StoreCommand) -> Result<()> {
        self.write_key(RegisterCommand::Store(command))?;
        if command == StoreCommand::Restore {
            return Ok(());
        }
        let start = Instant::now();
        while start.elapsed() < SAVE_TIME {
            match self.reports()?.get(report("SAVE_STATE")) {
                Some(1) => thread::sleep(SAVE_POLL),
                Some(2) => return Ok(()),
                _ => {
                    bail!(
                        "the settings were not stored; run `events` for the cause. The stored settings are unchanged"
                    )
                }
            }
        }
        bail!("time-out: the bridge is still storing the settings");
    }

    fn write_key(&mut self, command: RegisterCommand) -> Result<(), Failure> {
        let place = COMMANDS.iter().position(|it| it.command == command).unwrap_or_default();
        let register = FIRST_COMMAND + place as u16;
        self.ask_once(async |context| context.write_single_register(register, COMMAND_KEY).await)
    }

    /// Executes a command of an update, and repeats it if there is no response: a second one has no effect.
    pub(crate) fn command_update(&mut self, command: UpdateCommand) -> Result<(), Failure> {
        match self.write_key(RegisterCommand::Update(command)) {
            Err(Failure::NoAnswer) => self.write_key(RegisterCommand::Update(command)),
            done => done,
        }
    }

    /// Writes a block of an image, of up to [`BLOCK_LEN`] bytes, at an even offset (FC 21). Never retries.
    pub(crate) fn write_block(&mut self, at: usize, bytes: &[u8]) -> Result<(), Failure> {
        self.context = None;
        let Self { port, runtime, block_line, .. } = self;
        let written = runtime.block_on(async {
            let line = match &mut *block_line {
                Some(line) => line,
                none => none.insert(open_port(port).map_err(|error| Failure::Port(io::Error::other(error)))?),
            };
            within(exchange(line, &block_request(at, bytes))).await.unwrap_or(Err(Failure::NoAnswer))
        });
        if !matches!(written, Ok(()) | Err(Failure::Refused(_))) {
            // A late response must not answer the next request.
            *block_line = None;
        }
        written
    }

    /// Reads `count` registers with one request.
    ///
    /// Does not use the read methods of `tokio_modbus`, which panic on a response of unexpected length, such as a late response
    /// to an earlier request.
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

    /// Sends a request and retries if there is no response.
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
        self.block_line = None;
        if self.context.is_none() {
            // Reopen the port, so that a late response is not mistaken for the next one.
            let opened = self.runtime.block_on(connect(&self.port));
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

/// Most bytes of a block: one group of file records. It divides a file, so no block is in two files.
pub(crate) const BLOCK_LEN: usize = 200;

/// Registers of a file, whose successor has the next bytes.
const FILE_RECORDS: usize = 10_000;
const _: () = assert!((2 * FILE_RECORDS).is_multiple_of(BLOCK_LEN));

/// Returns a frame that writes a block as file records.
fn block_request(at: usize, bytes: &[u8]) -> Vec<u8> {
    let [file, record] =
        [1 + at / 2 / FILE_RECORDS, at / 2 % FILE_RECORDS].map(|it| (it as u16).to_be_bytes());
    let [count, len] = [bytes.len() as u8 / 2, bytes.len() as u8 + 7];
    let mut frame = vec![BusConfig::SERVICE.unit, Function::WriteFileRecord.code(), len, FILE_REFERENCE];
    frame.extend(file.into_iter().chain(record).chain([0, count]).chain(bytes.iter().copied()));
    frame.extend(crc(&frame).to_le_bytes());
    frame
}

/// Reference type of file records.
const FILE_REFERENCE: u8 = 6;

/// Sends a request whose response repeats it, and waits for this or for an exception.
async fn exchange(line: &mut WithoutStrays<SerialPort>, request: &[u8]) -> Result<(), Failure> {
    line.write_all(request).await.map_err(Failure::Port)?;
    let mut answer = Vec::new();
    loop {
        let mut bytes = [0; 256];
        let count = line.read(&mut bytes).await.map_err(Failure::Port)?;
        answer.extend_from_slice(bytes.get(..count).unwrap_or_default());
        match answer[..] {
            _ if count == 0 => return Err(Failure::Port(ErrorKind::UnexpectedEof.into())),
            _ if answer == request => return Ok(()),
            [_, code, reason, _, _] if code & 0x80 != 0 && crc(&answer) == 0 => {
                return Err(Failure::Refused(ExceptionCode::new(reason)));
            }
            _ if answer.len() >= request.len() => return Err(Failure::NoAnswer),
            _ => {}
        }
    }
}

async fn within<T>(answer: impl Future<Output = T>) -> Option<T> {
    timeout(PATIENCE, answer).await.ok()
}

/// Returns whether the port failed, as opposed to a corrupted response.
fn is_of_the_port(error: &io::Error) -> bool {
    !matches!(error.kind(), ErrorKind::InvalidData | ErrorKind::InvalidInput | ErrorKind::TimedOut)
}

/// Opens the serial port of a service port, or the connection to `tcp://HOST[:502][?unit=1]`.
pub(crate) async fn connect(port: &str) -> Result<Context> {
    if after_scheme(port, "tcp://").is_some() {
        return connect_to_gateway(&port.parse().map_err(anyhow::Error::msg)?).await;
    }
    Ok(rtu::attach_slave(open_port(port)?, Slave(BusConfig::SERVICE.unit)))
}

fn open_port(port: &str) -> Result<WithoutStrays<SerialPort>> {
    let opened = SerialPort::open(port, BusConfig::SERVICE.baud);
    let opened = opened.map_err(|error| anyhow::anyhow!(not_opened(port, &error)))?;
    // Discard bytes received earlier: they respond to another program.
    let _ = opened.discard_input_buffer();
    Ok(WithoutStrays::new(opened))
}

async fn connect_to_gateway(GatewayAddress { host, unit }: &GatewayAddress) -> Result<Context> {
    let stream = within(TcpStream::connect(host)).await.unwrap_or_else(|| Err(ErrorKind::TimedOut.into()));
    let stream = stream.with_context(|| format!("cannot connect to a gateway at {host}"))?;
    Ok(tcp::attach_slave(stream, Slave(*unit)))
}

/// Describes why a port cannot be opened, and what to do.
fn not_opened(port: &str, error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => {
            let others = SerialPort::available_ports().unwrap_or_default();
            let others: Vec<String> = others.iter().map(|port| port.display().to_string()).collect();
            let others = if others.is_empty() { "none".to_owned() } else { others.join(", ") };
            format!(
                "port {port} not found; available ports: {others}. Check that the cable is in the connector of the service port \
                 ({SERVICE_PORT})"
            )
        }
        ErrorKind::PermissionDenied => format!(
            "no permission to open {port}: on Linux, add yourself to the group dialout (sudo usermod -a -G dialout $USER) and log in \
             again; on Windows, close the program that uses it"
        ),
        ErrorKind::ResourceBusy => format!("{port} is in use by another program"),
        _ => format!("cannot open {port} as a serial port: {error}"),
    }
}
