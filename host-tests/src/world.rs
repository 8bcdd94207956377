//! The complete bridge, its lines, a virtual gripper and a PLC in virtual time, without an emulator or a clock. A million
//! milliseconds take seconds.
//!
//! | module | content |
//! |---|---|
//! | [`can`] | the CAN bus: a controller that fails on request, a gripper, a PLC |
//! | [`canopen`] | a CANopen master |
//! | [`modbus`] | a Modbus master on the PLC's bus and on the service port |
//! | [`plc`] | a PLC on any bus |
//! | [`profibus`] | a PROFIBUS master |
//! | [`service_line`] | the service port, connected to a program by a socket |
//!
//! This is the library that the image is built from. Board-specific parts (interrupts, registers, queue sizes) are
//! tested in the emulator.

pub mod can;
pub mod canopen;
pub mod modbus;
pub mod plc;
pub mod profibus;
#[cfg(unix)]
pub mod service_line;

use bus_profibus::Baud;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::gripper::GripperLink;
use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::canopen::Node;
use wsg_bridge_fw::plc::{Action, DpBuffers, DpResponder, UartStatus};
use wsg_bridge_fw::{BoardId, Bridge, BusPort, Config, Counters, GripperLine, PlcBus, ResetCause, Station};
use wsg_protocol::{Command, CommandId, PrePositionFlags};
use wsg_sim::{Part, PortKind, Time, VirtualGripper};

use crate::flash_model::FlashModel;
use crate::operation::{GripperEvent, Operation};
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::{BYTES_PER_MS, Carry, Disturbance, SerialGripper, motions};
use crate::slot_model::BOARD_NAME;
use can::{CanDouble, CanLine};

/// Outputs at rest, with referenced fingers.
pub const IDLE: Outputs = Outputs::READY.union(Outputs::REFERENCED).union(Outputs::LINK_OK);

/// A bridge whose PLC uses wires only.
pub const WIRES: Config = Config { plc_bus: PlcBus::Off, ..Config::DEFAULT };

/// Identity of the bridge's board.
pub const BOARD: BoardId = BoardId { name: BOARD_NAME, serial: 0x1234_5678 };

/// Buffers of all stations without PROFIBUS.
pub static NO_PROFIBUS: DpBuffers = DpBuffers::new();

/// Returns the configuration of a gripper that moves ten times as fast. Every phase of a motion still exceeds the 10 ms
/// period of its reports by far.
#[must_use]
pub fn quick() -> wsg_sim::Config {
    wsg_sim::Config { time_scale: 10.0, ..wsg_sim::Config::default() }
}

/// Returns the configuration of a quick gripper with a part of this width in mm.
#[must_use]
pub fn with_part(width: f32) -> wsg_sim::Config {
    wsg_sim::Config { part: Part::of_width(width), ..quick() }
}

/// A bridge with its lines and flash, its gripper, and the PLC signals driven by a test. A turn takes one millisecond.
#[derive(Clone)]
pub struct World<W = Option<Disturbance>> {
    station: Station<CanDouble>,
    delivered: Config,
    policy: BusOffPolicy,
    /// The bridge's settings at its last start.
    pub config: Config,
    /// The gripper and its RS-232 line.
    pub far: SerialGripper<W>,
    /// The CAN bus.
    pub can: CanLine,
    /// The settings flash.
    pub flash: FlashModel,
    /// The PLC's Modbus line.
    pub modbus: RtuDouble,
    /// The line of the service port.
    pub service: RtuDouble,
    /// The interrupt side of PROFIBUS.
    responder: DpResponder,
    /// The line's rate, as the responder requested it last.
    rate: Option<Baud>,
    /// Image that a Modbus master writes every 20 ms to registers 0 to 3 (CMDFLAGS to FORCELIMIT).
    repeated: Option<[u16; 4]>,
    now_ms: u32,
    /// Whether the bridge's clock is stopped.
    is_frozen: bool,
    /// The wires from the PLC.
    pub inputs: Inputs,
    outputs: Outputs,
}

impl World {
    /// Powers up a bridge with these settings, and a gripper. All wires are low.
    #[must_use]
    pub fn new(config: Config, gripper: wsg_sim::Config) -> Self {
        Self::with_policy(config, gripper, BusOffPolicy::DEFAULT)
    }

    /// Does the same as [`new`](Self::new), with a CAN bus that recovers according to `policy`.
    #[must_use]
    pub fn with_policy(config: Config, gripper: wsg_sim::Config, policy: BusOffPolicy) -> Self {
        let kind = match config.gripper_line {
            GripperLine::Serial => PortKind::Serial,
            GripperLine::Can => PortKind::Can,
        };
        let far = SerialGripper::over(gripper, kind, BYTES_PER_MS, [None, None]);
        Self::start(config, far, FlashModel::new(), ResetCause::PowerOn, policy)
    }

    /// Creates a world that is READY: connected, with FAST STOP acknowledged.
    #[must_use]
    pub fn ready(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut world = Self::new(config, gripper);
        world.get_ready();
        world
    }

    /// Creates a world that is READY and REFERENCED.
    #[must_use]
    pub fn homed(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut world = Self::new(config, gripper);
        world.get_homed();
        world
    }

    /// Cuts or restores the line from gripper to bridge.
    pub fn set_cut(&mut self, cut: bool) {
        self.far.to_bridge = if cut { Some(Box::new(Vec::clear)) } else { None };
    }
}

impl<W: Carry> World<W> {
    /// Starts a bridge with these delivered settings, unless the flash stores others, after this reset.
    ///
    /// # Panics
    /// Panics when the settings are rejected.
    #[must_use]
    pub fn with(delivered: Config, far: SerialGripper<W>, flash: FlashModel, cause: ResetCause) -> Self {
        Self::start(delivered, far, flash, cause, BusOffPolicy::DEFAULT)
    }

    fn start(
        delivered: Config,
        far: SerialGripper<W>,
        mut flash: FlashModel,
        cause: ResetCause,
        policy: BusOffPolicy,
    ) -> Self {
        let double = CanDouble::default();
        let (station, responder, config) =
            boot(&delivered, &mut flash, CanBus::new(double.clone(), policy), cause);
        Self {
            station,
            delivered,
            policy,
            config,
            far,
            can: CanLine::new(double, config.can.gripper),
            flash,
            modbus: RtuDouble::default(),
            service: RtuDouble::default(),
            responder,
            rate: None,
            repeated: None,
            now_ms: 0,
            is_frozen: false,
            inputs: Inputs::empty(),
            outputs: Outputs::empty(),
        }
    }

    /// Restarts the bridge with the settings in the flash, or the delivered ones; it loses all other state.
    ///
    /// # Panics
    /// Panics when the settings are rejected.
    pub fn restart_bridge(&mut self, cause: ResetCause) {
        let can = CanBus::new(self.can.double.clone(), self.policy);
        (self.station, self.responder, self.config) = boot(&self.delivered, &mut self.flash, can, cause);
    }

    /// Power-cycles the gripper; it loses all state, and its clock restarts at zero.
    pub fn restart_gripper(&mut self, config: wsg_sim::Config) {
        self.far.restart(config, self.now());
    }

    /// Stops the bridge's clock.
    pub const fn freeze(&mut self) {
        self.is_frozen = true;
    }

    /// Writes this image over Modbus now and every 20 ms, or stops doing so.
    pub fn repeat(&mut self, image: Option<[u16; 4]>) {
        self.repeated = image;
        self.write_repeated();
    }

    fn write_repeated(&mut self) {
        if let Some(image) = self.repeated {
            self.modbus.put(&modbus::sealed(&modbus::write_request(0, &image)));
        }
    }

    /// Advances by one millisecond.
    pub fn step(&mut self) {
        let mut service = std::mem::take(&mut self.service);
        service.pass_ms();
        self.turn(&mut service);
        self.service = service;
    }

    /// Does the same as [`step`](Self::step), with another line at the service port.
    pub fn turn(&mut self, service: &mut dyn BusPort) {
        self.turn_alone(service);
        let now = self.now();
        if self.far.kind == PortKind::Can {
            self.far.gripper.advance(now);
            self.can.fetch(&mut self.far);
        } else {
            self.far.advance(now);
        }
    }

    /// Does the same as [`turn`](Self::turn) while the gripper is off.
    pub fn turn_alone(&mut self, service: &mut dyn BusPort) {
        self.can.beat(self.now_ms);
        self.now_ms += u32::from(!self.is_frozen);
        self.modbus.pass_ms();
        if self.now_ms.is_multiple_of(20) {
            self.write_repeated();
        }
        self.poll(service);
        if self.station.uses_can() {
            for _ in 0..can::FRAMES_PER_MS {
                self.can.carry_frame(self.now_ms, &mut self.far);
                // A transmitted frame raises an interrupt, which wakes the main loop.
                self.poll(service);
            }
        }
    }

    /// Runs one turn of the main loop.
    fn poll(&mut self, service: &mut dyn BusPort) {
        let Self { station, far, flash, modbus, now_ms, inputs, .. } = self;
        self.outputs = station.turn(*now_ms, *inputs, &mut far.line, modbus, service, flash);
    }

    /// Runs the handler of PROFIBUS at a time in microseconds, within or after the current millisecond.
    pub fn interrupt(&mut self, status: UartStatus, now_us: u32) -> Action {
        let action = self.responder.step(status, self.now_ms, now_us);
        self.rate = action.rate.or(self.rate);
        action
    }

    /// Returns the rate of PROFIBUS.
    #[must_use]
    pub const fn rate(&self) -> Option<Baud> {
        self.rate
    }

    /// Returns the bridge.
    pub fn bridge(&mut self) -> &mut Bridge {
        self.station.bridge()
    }

    /// Returns the bridge with its lines.
    pub fn station(&mut self) -> &mut Station<CanDouble> {
        &mut self.station
    }

    /// Returns the bridge's view of the CAN bus.
    pub fn can_bus(&mut self) -> &mut CanBus<CanDouble> {
        self.station.can()
    }

    /// Returns the bridge's link to a gripper on CAN.
    #[must_use]
    pub fn link(&self) -> &GripperLink {
        self.station.link()
    }

    /// Returns the bridge's CANopen node; it is silent without a PLC on the bus.
    #[must_use]
    pub fn node(&self) -> &Node {
        self.station.node()
    }

    /// Returns the gripper.
    pub fn gripper(&mut self) -> &mut VirtualGripper<1> {
        &mut self.far.gripper
    }

    /// Returns the current time on the gripper's clock.
    #[must_use]
    pub fn now(&self) -> Time {
        Time::from_millis(self.now_ms.into())
    }

    /// Returns the current time in milliseconds.
    #[must_use]
    pub const fn now_ms(&self) -> u32 {
        self.now_ms
    }

    /// Moves the bridge's clock ahead of everything else.
    pub const fn skip_ms(&mut self, ms: u32) {
        self.now_ms += ms;
    }

    /// Returns the bridge's error counters.
    pub fn counters(&mut self) -> Counters {
        self.bridge().counters()
    }

    /// Returns the state shown by the LED.
    pub fn indication(&mut self) -> Indication {
        self.bridge().indication()
    }

    /// Returns the wires to the PLC.
    #[must_use]
    pub const fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// Returns the commands that the bridge has sent since the last call.
    pub fn take_sent(&mut self) -> Vec<CommandId> {
        if self.far.kind == PortKind::Can { self.can.take_sent() } else { self.far.take_sent() }
    }

    /// Returns the motion commands that the bridge has sent since the last call.
    pub fn take_motions(&mut self) -> Vec<CommandId> {
        motions(self.take_sent())
    }

    /// Sets wires from the PLC.
    pub fn set(&mut self, wires: Inputs, high: bool) {
        self.inputs.set(wires, high);
    }

    /// Lets time pass.
    pub fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            self.step();
        }
    }

    /// Executes operations of time, wires, a Modbus master that repeats its last image, and third parties.
    ///
    /// # Panics
    /// Panics at other operations.
    pub fn play(&mut self, operations: &[Operation]) {
        for operation in operations {
            match *operation {
                Operation::Pass(ms) => self.pass(ms),
                Operation::Wires(levels) => self.inputs = levels,
                Operation::Toggle(wires) => self.inputs.toggle(wires),
                Operation::Write(image) => self.repeat(Some(modbus::registers_of(&image))),
                Operation::FallSilent => self.repeat(None),
                Operation::Gripper(GripperEvent::ThirdPartyStops) => {
                    let now = self.now();
                    self.gripper().command(&Command::Stop, now);
                }
                Operation::Gripper(GripperEvent::ThirdPartyBegins(CommandId::PrePosition)) => {
                    let (flags, now) = (PrePositionFlags::empty(), self.now());
                    self.gripper().command(&Command::PrePosition { flags, width: 20.0, speed: 50.0 }, now);
                }
                _ => panic!("a world does not execute {operation:?}"),
            }
        }
    }

    /// Raises wires for 5 ms and lowers them for 5 ms.
    pub fn pulse(&mut self, wires: Inputs) {
        self.set(wires, true);
        self.pass(5);
        self.set(wires, false);
        self.pass(5);
    }

    /// Waits at most `bound_ms` until the outputs satisfy `wanted`. Returns whether they do.
    pub fn until(&mut self, bound_ms: u32, wanted: impl Fn(Outputs) -> bool) -> bool {
        (0..bound_ms).any(|_| {
            self.step();
            wanted(self.outputs)
        })
    }

    /// Proceeds from power-up to READY: connects and acknowledges FAST STOP.
    ///
    /// # Panics
    /// Panics when READY does not become high.
    pub fn get_ready(&mut self) {
        self.set(Inputs::FAST_STOP_OK, true);
        self.pass(200);
        self.pulse(Inputs::STOP_ACK);
        assert!(self.until(1_000, |outputs| outputs.contains(Outputs::READY)), "{:?}", self.outputs);
    }

    /// Proceeds from power-up to READY and references the fingers.
    ///
    /// # Panics
    /// Panics when homing fails.
    pub fn get_homed(&mut self) {
        self.get_ready();
        let outputs = self.command(Inputs::HOME);
        assert!(outputs.contains(Outputs::REFERENCED | Outputs::READY), "{outputs:?}");
    }

    /// Issues a motion command by wire and waits until it completes. Returns the outputs at that time.
    ///
    /// # Panics
    /// Panics when it is not accepted, or not completed within a minute.
    pub fn command(&mut self, wire: Inputs) -> Outputs {
        self.set(wire, true);
        let taken = self.until(1_000, |outputs| outputs.contains(Outputs::BUSY));
        let outputs = self.outputs;
        assert!(taken, "{wire:?} is not accepted: {outputs:?}, sent {:?}", self.take_sent());
        self.set(wire, false);
        assert!(self.until(60_000, |outputs| !outputs.contains(Outputs::BUSY)), "{wire:?} does not complete");
        self.outputs
    }
}

impl<W> std::fmt::Debug for World<W> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("now_ms", &self.now_ms)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}

/// Powers up a bridge without a gripper and a bus. Returns it, and the settings of this start.
///
/// # Panics
/// Panics when the settings are rejected.
pub fn start(delivered: &Config, flash: &mut FlashModel) -> (Station<CanDouble>, Config) {
    let can = CanBus::new(CanDouble::default(), BusOffPolicy::DEFAULT);
    let (station, _, config) = boot(delivered, flash, can, ResetCause::PowerOn);
    (station, config)
}

/// Starts a bridge. Returns its two sides, and the settings of this start.
fn boot(
    delivered: &Config,
    flash: &mut FlashModel,
    can: CanBus<CanDouble>,
    cause: ResetCause,
) -> (Station<CanDouble>, DpResponder, Config) {
    flash.reboot();
    // Only a bridge on PROFIBUS needs buffers of its own. As on a board, they are never freed.
    let has_buffers = delivered.plc_bus == PlcBus::Profibus;
    let buffers = if has_buffers { Box::leak(Box::default()) } else { &NO_PROFIBUS };
    let mut station = Station::new(can, buffers);
    let config = station.load(&delivered.record(), flash).expect("the settings are valid");
    station.start(&config, BOARD, cause);
    (station, DpResponder::new(buffers), config)
}
