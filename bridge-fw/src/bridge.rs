//! The bridge: a PLC side, the register controller, the session, and the gripper's line.

use crate::arbiter::{Arbiter, Commander};
#[cfg(feature = "can")]
use crate::can::{BusReport, Node, Served};
use crate::digital_io::DigitalIo;
use crate::io::{Inputs, Outputs};
use crate::liveness::{Liveness, Looked};
use crate::log;
use crate::modbus::{BusConfig, BusPort, CAN_REPORTS, ModbusSide, NoBus, ResetCause, Settings, Subjects};
use crate::recipe::{RECIPE_COUNT, RECIPES, Recipe};
use bus_modbus::rtu;
use embedded_io::{Read, ReadReady, Write, WriteReady};
use wsg_protocol::fieldbus::{Controller, ForceUnit, GripperFlags, InputImage};
use wsg_protocol::session::{self, Notice, Session, Signal, Timeout};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, DeviceTag, FrameEncoder, FrameParser, Instant, Status, frame,
};

/// The longest reply that a bridge asks for: a device tag behind its status code. Everything longer is not for it.
pub const MAX_REPLY_LEN: usize = DeviceTag::MAX_LEN + 2;

/// Bytes taken from the line in one turn of the main loop, at the most: a line that never falls silent must not keep
/// the wires waiting. One millisecond at 115 200 bit/s brings 12.
const MAX_RECEIVED_PER_POLL: usize = 256;

/// Requests of the bus served in one turn, at the most: the shortest takes longer to come than a turn.
const MAX_SERVED_PER_POLL: usize = 4;

/// The least time between two updates of width or force for the bus's registers: a report has 14 bytes, and the line
/// carries 115 in that time.
const MEASURED_PERIOD_MS: u16 = AutoUpdate::MIN_PERIOD_MS;

/// What can be set about a bridge.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// How long a wire must keep its level before it counts, in milliseconds.
    pub debounce_ms: u32,
    /// How long BUSY is high at least, in milliseconds: fingers that are at their goal already would show it for less than
    /// a PLC's cycle.
    pub min_busy_ms: u32,
    /// After how long without a byte half a frame is given up, in milliseconds.
    pub half_frame_ms: u32,
    /// What the recipe wires choose from.
    pub recipes: &'static [Recipe; RECIPE_COUNT],
    /// Time-outs towards the gripper.
    pub session: session::Config,
    /// The bus: Modbus RTU.
    pub bus: BusConfig,
}

/// Towards the gripper: settings are read back, because a force limit that a damaged frame changed would hurt; and a Stop
/// that is not answered soon becomes a FAST STOP while there is time for one.
const SESSION: session::Config = session::Config {
    verify_settings: true,
    timeouts: &[Timeout { id: CommandId::Stop, reply_ms: STOP_ANSWER_MS, result_ms: STOP_ANSWER_MS }],
    ..session::Config::DEFAULT
};

/// How long a gripper may take to answer a Stop, in milliseconds, before the fingers count as not stopped. A burst of FAST
/// STOPs behind it takes 90 ms, and both together may take 250 ms.
const STOP_ANSWER_MS: u32 = 100;

impl Config {
    /// Debounced for 2 ms, BUSY for 50 ms at least, the recipes as delivered, time-outs for a serial line, and a bus at
    /// 19 200 bit/s.
    pub const DEFAULT: Self = Self {
        debounce_ms: 2,
        min_busy_ms: 50,
        half_frame_ms: 20,
        recipes: &RECIPES,
        session: SESSION,
        bus: BusConfig::DEFAULT,
    };
}

/// What the bridge has met that it could not use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// On the gripper's line, below frames.
    pub line: frame::Counters,
    /// In frames and requests.
    pub session: session::Counters,
}

/// One bridge between the wires of a PLC, or its bus, and one gripper.
///
/// Board-free: [`poll`](Self::poll) it in the main loop, at least once a millisecond.
#[derive(Clone, Debug, Hash)]
pub struct Bridge {
    settings: Settings,
    parser: FrameParser<MAX_REPLY_LEN>,
    received_at: Instant,
    session: Session,
    controller: Controller,
    wires: DigitalIo,
    bus_config: BusConfig,
    bus: ModbusSide,
    /// How often a PLC on the bus was silent for too long.
    bus_timeouts: u16,
    arbiter: Arbiter,
    /// A gripper has answered since power-up.
    was_connected: bool,
    /// The way to the gripper is known to be gone, as a bus is after bus-off.
    link_is_lost: bool,
    /// What is reported about CAN.
    can: [u16; CAN_REPORTS],
    /// Why the MCU was reset last.
    reset_cause: ResetCause,
    liveness: Liveness,
    /// The frame that is being sent.
    sending: Option<FrameEncoder<Command<'static>>>,
    /// The connection was given up in this turn. Nothing more leaves in it: first the link must let go of what it was given
    /// before (a FAST STOP would go with that).
    gave_up: bool,
}

impl Bridge {
    /// A bridge at power-up: nothing is known, nothing will be sent that moves fingers.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        let settings = Settings::new(&config);
        Self {
            parser: FrameParser::new(),
            received_at: Instant::from_millis(0),
            session: Session::new(config.session),
            controller: Controller::new(),
            wires: DigitalIo::new(config.debounce_ms, config.min_busy_ms, *config.recipes),
            bus_config: config.bus,
            bus: ModbusSide::new(&config.bus, &settings),
            bus_timeouts: 0,
            arbiter: Arbiter::new(),
            was_connected: false,
            link_is_lost: false,
            can: [0; CAN_REPORTS],
            reset_cause: ResetCause::Unknown,
            liveness: Liveness::new(),
            sending: None,
            gave_up: false,
            settings,
        }
    }

    /// One turn: takes what the line and the wires brought, sends what is due, and gives the levels of the wires to the
    /// PLC. Never waits: `link` is read only when it has bytes and written only when it has room.
    pub fn poll<L: Read + ReadReady + Write + WriteReady>(
        &mut self,
        now_ms: u32,
        inputs: Inputs,
        link: &mut L,
    ) -> Outputs {
        self.poll_with_bus(now_ms, inputs, link, &mut NoBus)
    }

    /// As [`poll`](Self::poll), with a bus beside the wires.
    pub fn poll_with_bus<L: Read + ReadReady + Write + WriteReady>(
        &mut self,
        now_ms: u32,
        inputs: Inputs,
        link: &mut L,
        bus: &mut impl BusPort,
    ) -> Outputs {
        let now = Instant::from_millis(now_ms);
        self.begin_turn(now, inputs, link);
        self.take_bus(now, bus);
        self.end_turn(now, link)
    }

    fn begin_turn<L: Read + ReadReady>(&mut self, now: Instant, inputs: Inputs, link: &mut L) {
        let has_heard = self.receive(now, link) | self.expire_half_frame(now);
        self.tick(now);
        self.was_connected |= self.session.is_connected();
        self.controller.get_acquainted(self.session.known());
        self.take_wires(now, inputs, has_heard);
    }

    fn end_turn<L: Write + WriteReady>(&mut self, now: Instant, link: &mut L) -> Outputs {
        self.forward_commands();
        self.tick(now);
        if !core::mem::take(&mut self.gave_up) {
            self.transmit(now, link);
        }
        let gripper = self.shown();
        self.liveness.look(Looked::OUTPUTS);
        let motion_is_open = self.session.motion_is_open();
        let ignores_motions = motion_is_open || self.controller.ignores_motions(self.session.known());
        self.wires.outputs(now, &gripper, self.session.is_connected(), motion_is_open, ignores_motions)
    }

    /// Whether the gripper answers.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        self.session.is_connected()
    }

    /// The connection to the gripper, to look at.
    #[must_use]
    pub const fn session(&self) -> &Session {
        &self.session
    }

    /// Says whether the way to the gripper is known to be gone (bus-off), before a poll. As long as it is, the PLC sees
    /// ERROR and E_IO_ERROR, and no LINK_OK.
    ///
    /// The connection is given up at once and not after a silence: what was asked for does not leave when the way is
    /// there again.
    pub fn set_link_lost(&mut self, is_lost: bool) {
        if is_lost {
            self.sending = None;
            if !self.link_is_lost {
                self.session.disconnect();
            }
        }
        self.link_is_lost = is_lost;
    }

    /// Whether the watchdog may be fed: since this was true last, time has passed, and wires, line, bus and outputs were
    /// looked at. Ask once a turn, and feed the watchdog for no other reason.
    ///
    /// ```
    /// use wsg_bridge_fw::{Bridge, Config};
    ///
    /// let mut bridge = Bridge::new(Config::DEFAULT);
    /// assert!(!bridge.may_feed_watchdog(1), "no turn was made");
    /// ```
    pub fn may_feed_watchdog(&mut self, now_ms: u32) -> bool {
        self.liveness.take(Instant::from_millis(now_ms))
    }

    /// Takes why the MCU was reset, for the register that reports it.
    pub const fn set_reset_cause(&mut self, cause: ResetCause) {
        self.reset_cause = cause;
    }

    /// Takes what is known of the CAN bus, for the registers that report it.
    #[cfg(feature = "can")]
    pub const fn set_can_report(&mut self, report: &BusReport) {
        self.can = report.registers();
    }

    /// The image that the PLC reads.
    fn shown(&self) -> InputImage {
        let mut image = self.controller.input(self.session.known());
        if self.link_is_lost {
            image.state = GripperFlags::ERROR;
            image.status = Status::IoError;
        }
        image
    }

    /// What has been met so far that could not be used.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        Counters { line: self.parser.counters(), session: self.session.counters() }
    }

    /// What the bus has counted so far (FC 8).
    #[must_use]
    pub const fn bus_counters(&self) -> rtu::Counters {
        self.bus.counters()
    }

    /// Who gave the last motion command.
    #[must_use]
    pub const fn commander(&self) -> Commander {
        self.arbiter.commander()
    }

    /// Whether anything came.
    fn receive<L: Read + ReadReady>(&mut self, now: Instant, link: &mut L) -> bool {
        let mut received = 0;
        while received < MAX_RECEIVED_PER_POLL {
            let Ok(is_ready) = link.read_ready() else { break };
            self.liveness.look(Looked::LINE);
            if !is_ready {
                break;
            }
            let mut chunk = [0; 32];
            let Ok(count @ 1..) = link.read(&mut chunk) else { break };
            received += count;
            self.received_at = now;
            let mut rest = chunk.get(..count).unwrap_or(&[]);
            loop {
                let (taken, event) = self.parser.push_slice(rest);
                rest = rest.get(taken..).unwrap_or(&[]);
                let Some(event) = event else { break };
                let noticed = self.session.handle(now, &event);
                notice(&mut self.controller, &self.session, noticed);
            }
        }
        received > 0
    }

    /// Whether half a frame was given up, which may have held a whole one.
    fn expire_half_frame(&mut self, now: Instant) -> bool {
        if !self.parser.is_mid_frame() || now.since(self.received_at) < self.settings.half_frame_ms() {
            return false;
        }
        while let Some(event) = self.parser.expire() {
            let noticed = self.session.handle(now, &event);
            notice(&mut self.controller, &self.session, noticed);
        }
        true
    }

    fn tick(&mut self, now: Instant) {
        while let Some(noticed) = self.session.tick(now) {
            if noticed == Notice::Disconnected {
                // What has not left by now must not leave when the line comes back; but for a FAST STOP, which is owed.
                self.sending = self.sending.take().filter(|frame| frame.id() == CommandId::FastStop.code());
                self.gave_up = true;
            }
            notice(&mut self.controller, &self.session, Some(noticed));
        }
    }

    fn take_wires(&mut self, now: Instant, inputs: Inputs, has_heard: bool) {
        self.liveness.look(Looked::WIRES);
        let known = self.session.known();
        let unit = || known.info.map_or(ForceUnit::default(), |info| ForceUnit::of(info.device));
        let is_ready = self.wires.is_ready();
        if let Some(image) = self.wires.update(now, inputs, unit) {
            // Of a command that is refused, the parameters do not count. (READY was not shown to a PLC whose fingers move:
            // only what came since can tell otherwise.)
            let keeps_parameters = !is_ready || (has_heard && self.controller.is_moving(known));
            self.arbiter.take_wires(image, keeps_parameters, |image| {
                if is_ready {
                    self.controller.set_output(image, known);
                } else {
                    self.controller.set_output_refusing_motions(image, known);
                }
            });
        }
    }

    /// Serves what the bus has brought. Each request's image reaches the controller by itself, so that no edge is lost.
    fn take_bus(&mut self, now: Instant, port: &mut impl BusPort) {
        for _ in 0..MAX_SERVED_PER_POLL {
            let Some(heard) = self.bus.listen(port) else { break };
            let moving = self.controller.is_moving(self.session.known());
            let shown = self.shown();
            let subjects = Subjects {
                config: &self.bus_config,
                session: &self.session,
                was_connected: self.was_connected,
                line: self.parser.counters(),
                commander: self.arbiter.commander(),
                bus: self.bus.counters(),
                timeouts: self.bus_timeouts,
                can: self.can,
                reset_cause: self.reset_cause,
            };
            let was_heard = self.bus.is_heard();
            let settings = &mut self.settings;
            let Some(served) = self.bus.serve(now, heard, port, &shown, moving, &subjects, settings) else {
                break;
            };
            if !was_heard {
                self.subscribe_measured();
            }
            if served.configured {
                self.bus.configure(&self.settings);
                self.wires.configure(&self.settings);
            }
            if let Some(image) = served.image
                && let Some(image) = self.arbiter.take_bus(image, moving)
            {
                self.controller.set_output(&image, self.session.known());
            }
        }
        self.liveness.look(Looked::BUS);
        if self.bus.has_fallen_silent(now, self.settings.timeout_ms()) {
            self.lose_bus(true);
        }
    }

    /// As [`poll`](Self::poll), with a PLC on CAN beside the wires.
    #[cfg(feature = "can")]
    pub fn poll_with_can<L: Read + ReadReady + Write + WriteReady>(
        &mut self,
        now_ms: u32,
        inputs: Inputs,
        link: &mut L,
        node: &mut Node,
    ) -> Outputs {
        let now = Instant::from_millis(now_ms);
        self.begin_turn(now, inputs, link);
        self.take_node(now, node);
        let outputs = self.end_turn(now, link);
        let is_silent = self.was_connected && !self.session.is_connected();
        node.show(&self.shown(), is_silent);
        outputs
    }

    /// Serves what the node has heard, one thing after the other.
    #[cfg(feature = "can")]
    fn take_node(&mut self, now: Instant, node: &mut Node) {
        self.liveness.look(Looked::BUS);
        for _ in 0..Node::MAX_SERVED_PER_TURN {
            let moving = self.controller.is_moving(self.session.known());
            let subjects = Subjects {
                config: &self.bus_config,
                session: &self.session,
                was_connected: self.was_connected,
                line: self.parser.counters(),
                commander: self.arbiter.commander(),
                bus: self.bus.counters(),
                timeouts: self.bus_timeouts,
                can: self.can,
                reset_cause: self.reset_cause,
            };
            match node.serve(now, moving, &subjects, &mut self.settings) {
                Some(Served::Image(image)) => {
                    self.subscribe_measured();
                    if let Some(image) = self.arbiter.take_bus(image, moving) {
                        self.controller.set_output(&image, self.session.known());
                    }
                }
                Some(Served::Configured) => {
                    self.bus.configure(&self.settings);
                    self.wires.configure(&self.settings);
                }
                Some(Served::Left { silent }) => self.lose_bus(silent),
                None => return,
            }
        }
    }

    /// Wires alone have no use for them.
    fn subscribe_measured(&mut self) {
        let update = AutoUpdate::on_change(MEASURED_PERIOD_MS);
        self.session.subscribe(Signal::Width, update);
        self.session.subscribe(Signal::Force, update);
    }

    /// `silent`: unexpectedly, which is counted.
    fn lose_bus(&mut self, silent: bool) {
        let known = self.session.known();
        if self.arbiter.commander() == Commander::Bus {
            self.bus_timeouts = self.bus_timeouts.saturating_add(silent.into());
            self.controller.silence(self.settings.reaction(), known);
        }
        if let Some(image) = self.arbiter.lose_bus() {
            self.controller.set_output(&image, known);
        }
    }

    fn forward_commands(&mut self) {
        while let Some(command) = self.controller.poll_command() {
            if let Err(error) = self.session.request(command) {
                self.controller.refused(command.id(), error);
            }
        }
    }

    /// One byte at a time: a byte is taken from the frame, and a command from the session, only when the line has room. A
    /// command that waits in the session can be overtaken by FAST STOP, and no time-out runs for it.
    fn transmit<L: Write + WriteReady>(&mut self, now: Instant, link: &mut L) {
        while link.write_ready().unwrap_or(false) {
            let sending = match &mut self.sending {
                Some(sending) => sending,
                empty => {
                    let Some(command) = self.session.poll_transmit(now) else { return };
                    log::sent(&command);
                    empty.insert(FrameEncoder::new(command.id().code(), command))
                }
            };
            let is_sent = sending.next().is_some_and(|byte| matches!(link.write(&[byte]), Ok(1)));
            if !is_sent {
                // It has ended; or the rest of it would make no sense to the gripper, and the session misses the answer.
                self.sending = None;
            }
        }
    }
}

fn notice(controller: &mut Controller, session: &Session, notice: Option<Notice<'_>>) {
    if let Some(notice) = notice {
        log::noticed(&notice);
        controller.handle(&notice, session.known());
    }
}
