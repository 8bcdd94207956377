//! Modbus RTU as a PLC side: converts requests to output images, and answers them with the input image and the bridge's
//! registers. The service port is the same without output images.

mod config;
mod port;
mod tcp;
mod uart;

pub use config::{BusConfig, Format};
pub use port::BusPort;
pub use tcp::{ModbusTcp, TcpInput, TcpTurn};
pub use uart::{Interrupts, RtuBuffers, RtuPort, RtuUart};

use super::side::{BoardId, PlcEvent, PlcSide, Shown, has_fallen_silent};
use super::{Config, Listed, View};
use crate::register::{
    BusCounts, COMMANDS, FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, Link, RegisterCommand, RegisterError,
    UpdateRefusal, report_rows,
};
use crate::update::Master;
use bus_modbus::rtu::{self, Character, Event, Mode, Server};
use bus_modbus::{Bits, Device, Exception, FileRecord, FileRecords, Identification, Words};
use wsg_fieldbus::Images;
use wsg_protocol::Instant;

/// Identification of the bridge (FC 43/14).
pub const IDENTIFICATION: Identification = Identification {
    vendor_name: "wsg-bridge",
    product_code: env!("CARGO_PKG_NAME"),
    revision: concat!("V", env!("CARGO_PKG_VERSION")),
    regular: None,
};

/// Reports on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct ModbusReports {
    baud: u32,
    format: Format,
}

impl ModbusReports {
    pub(crate) const fn new(config: &Config) -> Self {
        Self { baud: config.bus.baud, format: config.bus.format }
    }
}

report_rows! { ModbusReports as it:
    109 "BUS_RATE" "rate of Modbus RTU in 100 bit/s"
        u16::try_from(it.baud / 100).unwrap_or(u16::MAX);
    110 "BUS_FORMAT" "character format of Modbus RTU: 0 8E1, 1 8N1, 2 8N2" it.format as u16;
}

report_rows! { BusCounts as it:
    118 "BUS_MESSAGES" "intact frames on the bus (FC 8, 0Bh)" it.messages;
    119 "BUS_ERRORS" "damaged frames on the bus (FC 8, 0Ch)" it.errors;
    120 "BUS_EXCEPTIONS" "exception responses (FC 8, 0Dh)" it.exceptions;
    121 "SERVER_MESSAGES" "frames for this unit, and broadcasts (FC 8, 0Eh)" it.own_messages;
    122 "NO_RESPONSES" "frames for this unit without a response (FC 8, 0Fh)" it.no_responses;
    123 "SERVER_BUSY" "exception responses 06, busy (FC 8, 11h)" it.busy;
    124 "BUS_OVERRUNS" "frames with a damaged or lost character (FC 8, 12h)" it.overruns;
    211 "BUS_STRAYS" "characters 00h, FFh or breaks directly before or after intact frames, ignored" it.strays;
}

/// Maximum characters read from a line per event. A continuously sending line must not delay the rest of the turn. One
/// millisecond at 230 400 bit/s is 23 characters.
const MAX_CHARACTERS: usize = 64;

/// Input from the line.
#[derive(Clone, Copy, Debug)]
enum RxEvent {
    /// A character, and the preceding silence in microseconds.
    Character(Character, u32),
    /// Silence since the last character, in microseconds.
    Silence(u32),
}

/// Purpose of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Role {
    /// The PLC's bus. It accepts output images, and its configuration is in the settings.
    Plc,
    /// The service port. It only reads the output image, and its configuration is fixed.
    Service,
}

/// Server of a Modbus line. The line itself stays outside: [`over`](Self::over) combines both for a turn.
#[derive(Clone, Debug, Hash)]
pub struct Modbus {
    role: Role,
    server: Server,
    images: Images,
    /// Time of the last request for this unit; `None` after a time-out.
    received_at: Option<Instant>,
}

impl Modbus {
    /// Creates a server for the PLC's bus with the configuration's settings.
    #[must_use]
    pub const fn new(config: &Config) -> Self {
        Self::with_role(Role::Plc, &config.bus)
    }

    /// Creates a server for the service port ([`BusConfig::SERVICE`]). It reads all registers of the PLC's bus and writes
    /// settings. It cannot command: a write to the output image is exception 01.
    #[must_use]
    pub const fn service() -> Self {
        Self::with_role(Role::Service, &BusConfig::SERVICE)
    }

    const fn with_role(role: Role, config: &BusConfig) -> Self {
        Self {
            role,
            server: Server::new(server_config(config), config.timing()),
            images: Images::new(config.swap_bytes),
            received_at: None,
        }
    }

    /// Returns the server's counters (FC 8).
    const fn counts(&self) -> BusCounts {
        let rtu::Counters {
            bus_messages: messages,
            bus_errors: errors,
            exceptions,
            server_messages: own_messages,
            no_responses,
            busy,
            overruns,
            strays,
        } = self.server.counters();
        BusCounts { messages, errors, exceptions, own_messages, no_responses, busy, overruns, strays }
    }

    /// Combines the server with its line: a PLC side for one turn.
    pub const fn over<'a>(&'a mut self, port: &'a mut dyn BusPort) -> ModbusLine<'a> {
        ModbusLine { modbus: self, port }
    }

    /// Updates settings and images before a request.
    fn update(&mut self, view: &View<'_>) {
        match self.role {
            Role::Plc => {
                let config = view.settings.bus();
                self.server.configure(server_config(&config));
                self.images.set_swap_bytes(config.swap_bytes);
            }
            Role::Service => self.images.set_output(view.bus_image()),
        }
        self.images.set_input(&view.image());
    }

    /// Serves the request that `event` completes. Returns `None` if it completes none.
    fn serve(
        &mut self,
        now: Instant,
        event: RxEvent,
        counts: BusCounts,
        port: &mut dyn BusPort,
        view: &mut View<'_>,
    ) -> Option<PlcEvent> {
        let Self { role, server, images, .. } = self;
        let mut device = BridgeDevice { role: *role, images, view, counts, configured: false };
        let served = match event {
            RxEvent::Character(character, silence_us) => server.push(character, silence_us, &mut device),
            RxEvent::Silence(silence_us) => server.silence(silence_us, &mut device),
        };
        let configured = device.configured;
        match served {
            Some(Event::Answer(answer)) => port.send(answer),
            Some(Event::Served) => {}
            Some(Event::Passed | Event::Damaged(_)) | None => return None,
        }
        self.received_at = Some(now);
        if configured {
            return Some(PlcEvent::Configured);
        }
        Some(self.images.take_written().map_or(PlcEvent::Served, PlcEvent::Output))
    }

    /// Returns, once per silence, whether a PLC has been silent for `timeout_ms`.
    fn has_fallen_silent(&mut self, now: Instant, timeout_ms: u32) -> bool {
        self.role == Role::Plc && has_fallen_silent(&mut self.received_at, now, timeout_ms)
    }
}

impl Listed for Modbus {
    type Turn<'a> = ModbusLine<'a>;

    // Not inlined: the new server would be on the stack together with the frames of the other sides.
    #[inline(never)]
    fn start(&mut self, config: &Config, _: BoardId) {
        *self = Self::new(config);
    }

    fn over<'a>(&'a mut self, port: &'a mut dyn BusPort) -> ModbusLine<'a> {
        self.over(port)
    }
}

/// Returns the configuration of the protocol server.
const fn server_config(config: &BusConfig) -> rtu::Config {
    let mode = match config.character_timeout_ms {
        0 => Mode::Strict,
        ms => Mode::Tolerant { character_timeout_us: ms as u32 * 1_000 },
    };
    rtu::Config { unit: config.unit, mode, broadcast: config.broadcast }
}

/// A [`Modbus`] server and its line.
// `dyn`: PLC's bus and service port share one copy of the code.
pub struct ModbusLine<'a> {
    modbus: &'a mut Modbus,
    port: &'a mut dyn BusPort,
}

impl ModbusLine<'_> {
    /// Returns the next input of the line; usually `None`, because nothing is to be served.
    fn listen(&mut self) -> Option<RxEvent> {
        match self.port.receive() {
            Some((character, silence_us)) => Some(RxEvent::Character(character, silence_us)),
            None if self.modbus.server.is_idle() => None,
            None => Some(RxEvent::Silence(self.port.silence_us())),
        }
    }
}

impl PlcSide for ModbusLine<'_> {
    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
        if let Some(mut event) = self.listen() {
            self.modbus.update(view);
            let counts = self.modbus.counts();
            for left in (0..MAX_CHARACTERS).rev() {
                if let Some(event) = self.modbus.serve(now, event, counts, self.port, view) {
                    return Some(event);
                }
                if left == 0 || matches!(event, RxEvent::Silence(_)) {
                    break;
                }
                let Some(next) = self.listen() else { break };
                event = next;
            }
        }
        let is_silent = self.modbus.has_fallen_silent(now, view.settings.timeout_ms());
        is_silent.then_some(PlcEvent::Left { silent: true })
    }

    /// Does nothing: each request is answered with the state at its time.
    fn show(&mut self, _: Instant, _: &Shown) {}
}

/// The bridge as a Modbus device, for one request.
struct BridgeDevice<'a, 'b> {
    role: Role,
    images: &'a mut Images,
    view: &'a mut View<'b>,
    counts: BusCounts,
    configured: bool,
}

impl BridgeDevice<'_, '_> {
    /// Checks a write to `count` of the `all` items of the output image. The service port rejects it with exception 01, or 02
    /// if an item does not exist.
    fn may_command(&self, first: u16, count: u16, all: u16) -> Result<(), Exception> {
        match self.role {
            Role::Service if first.saturating_add(count) <= all => Err(Exception::IllegalFunction),
            Role::Service => Err(Exception::IllegalDataAddress),
            Role::Plc => Ok(()),
        }
    }

    /// Writes to one command register.
    fn command(&mut self, index: u16, values: Words<'_>) -> Result<(), Exception> {
        let mut keys = values.iter();
        let (Some(key), None) = (keys.next(), keys.next()) else { return Err(Exception::IllegalDataValue) };
        match RegisterCommand::of_register(index, key).map_err(exception)? {
            RegisterCommand::Store(command) => self.view.command_store(command).map_err(exception),
            RegisterCommand::Update(command) => {
                self.view.command_update(self.master(), command).map_err(refused)
            }
        }
    }

    const fn master(&self) -> Master {
        match self.role {
            Role::Plc => Master::Bus,
            Role::Service => Master::Service,
        }
    }

    /// Checks that the gripper answers. Without a gripper there is no input image.
    fn gripper_answers(&self) -> Result<(), Exception> {
        match self.view.link() {
            Link::Never => Err(Exception::GatewayPathUnavailable),
            Link::Silent => Err(Exception::GatewayTargetDeviceFailedToRespond),
            Link::Up => Ok(()),
        }
    }
}

/// Returns the exception for an error.
const fn exception(error: RegisterError) -> Exception {
    match error {
        RegisterError::Missing => Exception::IllegalDataAddress,
        RegisterError::Value => Exception::IllegalDataValue,
        RegisterError::Moving | RegisterError::Saving | RegisterError::Updating => {
            Exception::ServerDeviceBusy
        }
    }
}

/// Returns the exception for a refused block or command of an update. The register UPDATE_REFUSAL has the reason.
const fn refused(why: UpdateRefusal) -> Exception {
    use UpdateRefusal as Why;
    match why {
        Why::NoBootLoader => Exception::IllegalFunction,
        Why::Moving | Why::Saving | Why::OtherMaster | Why::Busy | Why::OnTrial => {
            Exception::ServerDeviceBusy
        }
        Why::OutOfOrder | Why::TooLong => Exception::IllegalDataAddress,
        _ => Exception::ServerDeviceFailure,
    }
}

/// Registers of a file of an update. The files follow each other without a gap.
const FILE_RECORDS: u32 = 10_000;

impl Device for BridgeDevice<'_, '_> {
    fn coil(&self, address: u16) -> Result<bool, Exception> {
        self.images.coil(address)
    }

    fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        let value = self.images.discrete_input(address)?;
        self.gripper_answers().map(|()| value)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        if let Some(index) = address.checked_sub(FIRST_COMMAND) {
            return COMMANDS.get(usize::from(index)).map(|_| 0).ok_or(Exception::IllegalDataAddress);
        }
        match address.checked_sub(FIRST_SETTING) {
            None => self.images.holding_register(address),
            Some(index) => self.view.setting(index).map_err(exception),
        }
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        if let Some(index) = address.checked_sub(FIRST_REPORT) {
            return self.view.report(index, self.counts).map_err(exception);
        }
        let value = self.images.input_register(address)?;
        self.gripper_answers().map(|()| value)
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        self.may_command(first, values.len(), Images::COILS)?;
        self.images.write_coils(first, values)
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        let Some(index) = first.checked_sub(FIRST_SETTING) else {
            self.may_command(first, values.len() as u16, Images::COILS / 16)?;
            return self.images.write_registers(first, values);
        };
        match first.checked_sub(FIRST_COMMAND) {
            None => self.view.write_settings(index, values.iter()).map_err(exception)?,
            Some(index) => self.command(index, values)?,
        }
        self.configured = true;
        Ok(())
    }

    /// Takes a block of an image, which is one group: a repeated request must not be accepted in part.
    fn write_file_records(&mut self, records: FileRecords<'_>) -> Result<(), Exception> {
        let mut groups = records.iter();
        let (Some(FileRecord { file, first, values }), None) = (groups.next(), groups.next()) else {
            return Err(Exception::IllegalDataValue);
        };
        let record = u32::from(file).saturating_sub(1) * FILE_RECORDS + u32::from(first);
        self.view.write_image(self.master(), 2 * record, values.as_bytes()).map_err(refused)
    }

    fn outcome(&self) -> Option<Result<(), Exception>> {
        self.view.facts.update.outcome().map(|done| done.map_err(refused))
    }

    fn identification(&self) -> Identification {
        IDENTIFICATION
    }
}
