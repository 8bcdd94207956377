//! The bridge: a PLC side, the register controller, the session, and the gripper's line.

use crate::arbiter::{Arbiter, ControlSource};
use crate::can::CanReports;
use crate::gripper::MAX_REPLY_LEN;
use crate::indicator::Indication;
use crate::io::{Inputs, Outputs};
use crate::liveness::{Liveness, Served};
use crate::log;
use crate::plc::wires::{self, Wires};
use crate::plc::{
    Config, Facts, MotionEnd, PlcEvent, PlcSide, Record, Settings, Shown, SideReports, View, force_unit,
};
use crate::register::{
    EventCode, Events, Link, ResetCause, SaveState, SettingsFrom, StoreCommand, StoreReports,
};
use crate::storage::Slot;
use crate::update::Update;
use embedded_io::{Read, ReadReady, Write, WriteReady};
use wsg_fieldbus::{Controller, InputImage, SilenceReaction};
use wsg_protocol::session::{self, Event, Session, Topic};
use wsg_protocol::{AutoUpdate, Command, CommandId, FrameEncoder, FrameParser, Instant, SystemFlags, frame};

/// Maximum bytes read from the line in one turn of the main loop. A continuously sending line must not delay the wires. One
/// millisecond at 115 200 bit/s is 12 bytes.
const MAX_RECEIVED_PER_POLL: usize = 256;

/// Minimum period of width and force updates for the bus's registers. An update has 14 bytes, and the line carries 115 in
/// this period.
const MEASURED_PERIOD_MS: u16 = AutoUpdate::MIN_PERIOD_MS;

/// Faults on the way to and from the gripper since power-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Faults on the gripper's line, below frames.
    pub line: frame::FrameCounters,
    /// Faults in frames and requests.
    pub session: session::SessionCounters,
}

/// A bridge between one PLC, on wires and on a bus, and one gripper.
///
/// Independent of the board. The main loop calls [`poll`](Self::poll) at least once a millisecond.
#[derive(Clone, Debug, Hash)]
pub struct Bridge {
    settings: Settings,
    parser: FrameParser<MAX_REPLY_LEN>,
    received_at: Instant,
    session: Session,
    controller: Controller,
    wires: Wires,
    arbiter: Arbiter,
    facts: Facts,
    /// Width and force are subscribed to, because a bus or the service port shows them. The wires alone do not need them.
    is_measured: bool,
    liveness: Liveness,
    sending: Option<FrameEncoder<Command<'static>>>,
    /// The connection was lost in this turn, so nothing more is sent in it. The link must first discard its pending bytes,
    /// and would discard a FAST STOP with them.
    gave_up: bool,
}

impl Bridge {
    /// Creates a bridge at power-up. It knows nothing about the gripper and sends no motion.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        let settings = Settings::new(&config);
        Self {
            parser: FrameParser::new(),
            received_at: Instant::from_millis(0),
            session: Session::new(config.session),
            controller: Controller::new(),
            wires: Wires::new(config.wires),
            arbiter: Arbiter::new(),
            facts: Facts {
                was_connected: false,
                moved: false,
                link_is_lost: false,
                bus_timeouts: 0,
                bus_is_silent: false,
                can: CanReports::NONE,
                sides: SideReports::new(&config),
                reset_cause: ResetCause::Unknown,
                motion_end: MotionEnd::new(),
                error_cause: 0,
                events: Events::new(),
                store: StoreReports { from: SettingsFrom::Delivered, save: SaveState::Nothing },
                update: Update::new(),
            },
            is_measured: false,
            liveness: Liveness::new(),
            sending: None,
            gave_up: false,
            settings,
        }
    }

    /// Applies another configuration, except for the time-outs of the session, and its origin. Called only before the first
    /// turn. Refused settings block all motions until others are stored.
    // Not inlined: a record of the settings is on its stack.
    #[inline(never)]
    pub(crate) fn configure(&mut self, config: &Config, from: SettingsFrom) {
        self.settings.start(config);
        self.wires.configure(&self.settings);
        self.facts.sides = SideReports::new(config);
        self.facts.store.from = from;
        if from.is_refusal() {
            self.facts.events.happened(EventCode::SettingsRefused, from as u16);
        }
    }

    /// Returns the current settings.
    pub(crate) const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Takes the requested action on the settings. The fingers were at rest at the request, and later input of that turn
    /// starts no motion.
    pub(crate) const fn take_store_command(&mut self) -> Option<StoreCommand> {
        self.settings.take_requested()
    }

    /// Applies these settings without storing them.
    pub(crate) fn take_settings(&mut self, settings: &Record) {
        self.settings.take(settings);
        self.wires.configure(&self.settings);
    }

    /// Records the start of a save.
    pub(crate) const fn save_begins(&mut self) {
        self.facts.store.save = SaveState::Saving;
    }

    /// Records that the current settings have been stored.
    pub(crate) fn save_succeeded(&mut self) {
        self.settings.are_stored();
        self.facts.store = StoreReports { from: SettingsFrom::Stored, save: SaveState::Saved };
    }

    /// Records a failed save. `why` is the value of [`EventCode::SaveFailed`].
    pub(crate) fn save_failed(&mut self, why: u16) {
        self.facts.events.happened(EventCode::SaveFailed, why);
        self.facts.store.save = SaveState::Failed;
    }

    /// Runs one turn: handles the input of line, wires and bus, sends due commands, and returns the output levels for the
    /// PLC. Never waits: reads from `link` only available bytes, and writes only while it has room.
    ///
    /// `bus` is the PLC side beside the wires, or [`NoBus`](crate::plc::NoBus).
    pub fn poll<L: Read + ReadReady + Write + WriteReady, P: PlcSide>(
        &mut self,
        now_ms: u32,
        inputs: Inputs,
        link: &mut L,
        bus: &mut P,
    ) -> Outputs {
        let now = Instant::from_millis(now_ms);
        self.arbiter.set_refuses(self.facts.is_locked());
        bus.report(&mut self.facts.sides);
        let has_heard = self.receive(now, link) || self.expire_half_frame(now);
        // Before a lost connection invalidates this state.
        self.controller.adopt_known(self.session.known());
        self.tick(now);
        self.facts.was_connected |= self.session.is_connected();
        self.take_wires(now, inputs, has_heard);
        if self.facts.motion_end.is_awaited() {
            // Before a bus is served.
            self.follow_motion(now, &self.facts.image(&self.controller, &self.session));
        }
        self.take_bus(now, bus);
        self.forward_commands();
        self.tick(now);
        if !core::mem::take(&mut self.gave_up) {
            self.transmit(now, link);
        }
        // After transmitting, so that the record never delays a FAST STOP.
        self.keep_record(now);
        if self.session.is_connected() {
            self.facts.moved = self.controller.is_moving(self.session.known());
        }
        let motion_is_open = self.session.motion_is_open();
        let image = self.facts.image(&self.controller, &self.session);
        self.follow_motion(now, &image);
        let mut shown = Shown {
            image,
            link: self.facts.link(&self.session),
            error_cause: 0,
            refused_meanwhile: self.controller.has_refused_meanwhile(),
            motion_is_open,
            ignores_motions: motion_is_open
                || self.controller.ignores_motions(self.session.known())
                || self.arbiter.bus_holds_stop()
                || self.facts.is_locked(),
        };
        shown.error_cause = self.cause_of_error(&shown);
        self.facts.error_cause = shown.error_cause;
        bus.show(now, &Shown { image: self.facts.motion_end.shown(shown.image), ..shown });
        self.wires.read(inputs).show(now, &shown);
        self.liveness.serve(Served::OUTPUTS);
        self.wires.shown()
    }

    /// Serves a service port, once per turn before or after [`poll`](Self::poll), with at most one event. Changed settings
    /// take effect immediately. The port cannot command: its output images and its silence are ignored.
    pub fn serve<P: PlcSide>(&mut self, now_ms: u32, service: &mut P) {
        let Self { controller, session, parser, arbiter, facts, settings, .. } = self;
        let mut view = View { controller, session, parser, arbiter, facts, settings };
        let Some(event) = service.receive(Instant::from_millis(now_ms), &mut view) else { return };
        self.measure();
        if event == PlcEvent::Configured {
            self.wires.configure(&self.settings);
        }
    }

    /// Continues an update after the turn's data was transmitted.
    pub(crate) fn update(&mut self, now: Instant, slot: &mut dyn Slot) {
        let Self { controller, session, arbiter, facts, .. } = self;
        let known = session.known();
        let (is_connected, is_pending) = (session.is_connected(), session.fast_stop_pending());
        // A missing gripper confirms nothing, and must not keep a bridge from its update.
        let is_free = !(is_connected && is_pending);
        let has_flag = known.flags.unwrap_or_default().contains(SystemFlags::FAST_STOP);
        let is_stopped = is_connected && !is_pending && has_flag && controller.asks_fast_stop();
        let was_active = facts.update.is_active();
        let may_confirm =
            !facts.moved && !facts.store.from.is_refusal() && facts.store.save != SaveState::Saving;
        let continued = facts.update.turn(now, slot, is_free, is_stopped, may_confirm);
        let stops = facts.note_update(was_active, continued).unwrap_or(false);
        if let Some(image) = arbiter.set_restarts(stops) {
            controller.set_output(&image, known);
        }
    }

    /// Returns whether the gripper answers.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        self.session.is_connected()
    }

    /// Returns the session with the gripper, for inspection.
    #[must_use]
    pub const fn session(&self) -> &Session {
        &self.session
    }

    /// Returns whether a motion of the PLC has no result yet, for inspection: the session awaits it, or the status register
    /// shows a motion that was refused because of it.
    #[must_use]
    pub fn motion_is_open(&self) -> bool {
        self.session.motion_is_open() || self.controller.has_refused_meanwhile()
    }

    /// Sets before a poll whether the link to the gripper is known to be down (bus-off). While it is, the PLC reads ERROR and
    /// E_IO_ERROR, and LINK_OK is low.
    ///
    /// The connection ends immediately instead of after a time-out, so pending commands are never sent after the link
    /// recovers.
    pub fn set_link_lost(&mut self, is_lost: bool) {
        if is_lost && !self.facts.link_is_lost {
            self.session.disconnect();
        }
        self.facts.link_is_lost = is_lost;
    }

    /// Ends a jog, and a motion as `reaction` selects, regardless of its side and of BUS_REACTION. For a caller that knows that
    /// the PLC has left, or that the program ends. Later turns send the commands.
    pub fn silence(&mut self, reaction: SilenceReaction) {
        self.controller.silence(reaction, self.session.known());
    }

    /// Announces the end of a TCP connection, so that the gripper does not enter FAST STOP. Later turns send the announcement,
    /// which is answered when [`session`](Self::session) is no longer busy. Returns `false` without a connection.
    pub fn announce_end(&mut self) -> bool {
        self.session.request(Command::DisconnectAnnouncement).is_ok()
    }

    /// Returns, after a poll, whether a later stop has superseded a motion or acknowledgement that was written to the link. A
    /// link that still holds unsent frames of it withdraws them and reports that by [`withdrawn`](Self::withdrawn).
    #[must_use]
    pub fn has_overtaken(&self) -> bool {
        self.session.has_overtaken()
    }

    /// Returns the current input image, for inspection. A bus shows the end of a motion up to 10 ms later.
    #[must_use]
    pub fn input_image(&self) -> InputImage {
        self.facts.image(&self.controller, &self.session)
    }

    /// Records before a poll that the link has withdrawn this command: the gripper never receives it completely.
    pub fn withdrawn(&mut self, id: CommandId) {
        if self.session.take_back(id) {
            let withdrawn = Some(Event::Withdrawn(id));
            notify(&mut self.controller, &mut self.facts.motion_end, &self.session, withdrawn);
        }
    }

    /// Returns whether the watchdog may be fed: since the last `true`, time has passed, and wires, line, bus and outputs were
    /// served. Call this once per turn, and feed the watchdog for no other reason.
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

    /// Sets the reset cause, for the register that reports it.
    pub fn set_reset_cause(&mut self, cause: ResetCause) {
        self.facts.events.happened(EventCode::Start, cause as u16);
        self.facts.reset_cause = cause;
    }

    /// Sets the state of the CAN bus, for the registers that report it.
    pub fn set_can_reports(&mut self, reports: CanReports) {
        if reports.bus_offs() != self.facts.can.bus_offs() {
            self.facts.events.happened(EventCode::BusOff, 0);
        }
        self.facts.can = reports;
    }

    /// Returns the indication for the board's LED, as of the last turn.
    #[must_use]
    pub const fn indication(&self) -> Indication {
        let is_missed = !matches!(self.arbiter.control_source(), ControlSource::Wires);
        let is_bus_lost = (self.facts.bus_is_silent && is_missed) || self.facts.can.is_off();
        let has_error = self.wires.shown().contains(Outputs::ERROR);
        Indication::of(self.facts.link(&self.session), is_bus_lost, has_error)
    }

    /// Returns the counters of line and session.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        Counters { line: self.parser.counters(), session: self.session.counters() }
    }

    /// Returns the source of the last motion command.
    #[must_use]
    pub const fn control_source(&self) -> ControlSource {
        self.arbiter.control_source()
    }

    /// Returns whether any bytes were received.
    fn receive<L: Read + ReadReady>(&mut self, now: Instant, link: &mut L) -> bool {
        let mut received = 0;
        while received < MAX_RECEIVED_PER_POLL {
            let Ok(is_ready) = link.read_ready() else { break };
            self.liveness.serve(Served::LINE);
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
                notify(&mut self.controller, &mut self.facts.motion_end, &self.session, noticed);
            }
        }
        received > 0
    }

    /// Discards an incomplete frame after its time-out, and handles complete frames inside it. Returns whether it did.
    fn expire_half_frame(&mut self, now: Instant) -> bool {
        if !self.parser.is_mid_frame() || now.since(self.received_at) < self.settings.half_frame_ms() {
            return false;
        }
        while let Some(event) = self.parser.expire() {
            let noticed = self.session.handle(now, &event);
            notify(&mut self.controller, &mut self.facts.motion_end, &self.session, noticed);
        }
        true
    }

    fn tick(&mut self, now: Instant) {
        while let Some(noticed) = self.session.tick(now) {
            if noticed == Event::Disconnected {
                self.facts.events.happened(EventCode::GripperSilent, 0);
                // Unsent commands must not be sent when the line recovers.
                self.sending.take_if(|frame| !CommandId::from_code(frame.id()).outlives_connection());
                self.gave_up = true;
            }
            notify(&mut self.controller, &mut self.facts.motion_end, &self.session, Some(noticed));
        }
    }

    fn take_wires(&mut self, now: Instant, inputs: Inputs, has_heard: bool) {
        self.liveness.serve(Served::WIRES);
        // An update may have begun since READY was shown.
        let is_ready = self.wires.is_ready() && !self.facts.is_locked();
        let Self { wires, controller, session, parser, arbiter, facts, settings, .. } = self;
        let mut view = View { controller, session, parser, arbiter, facts, settings };
        let Some(PlcEvent::Output(image)) = wires.read(inputs).receive(now, &mut view) else { return };
        let known = self.session.known();
        // The parameters of a refused command have no effect. READY was low for moving fingers. If it was high, only data
        // received in this turn can show a motion.
        let keeps_parameters = !is_ready || (has_heard && self.controller.is_moving(known));
        self.arbiter.take_wires(&image, keeps_parameters, |image| {
            if is_ready {
                self.controller.set_output(image, known);
            } else {
                self.controller.set_output_refusing_motions(image, known);
            }
        });
    }

    /// Serves the events of the bus. Each image reaches the controller separately, so that no edge is lost.
    fn take_bus<P: PlcSide>(&mut self, now: Instant, bus: &mut P) {
        for _ in 0..bus.max_events_per_turn() {
            let Self { controller, session, parser, arbiter, facts, settings, .. } = self;
            let mut view = View { controller, session, parser, arbiter, facts, settings };
            let Some(event) = bus.receive(now, &mut view) else { break };
            self.arbiter.set_refuses(self.facts.is_locked());
            self.measure();
            self.facts.bus_is_silent = event == PlcEvent::Left { silent: true };
            match event {
                PlcEvent::Output(image) => {
                    let known = self.session.known();
                    let recipe = self.settings.bus_recipe().map(|recipe| (recipe, force_unit(known)));
                    let moving = self.controller.is_moving(known);
                    let refused = self.arbiter.refused(&image);
                    if let Some(image) = self.arbiter.take_bus(image, recipe, moving) {
                        self.controller.set_output(&image, known);
                    }
                    if !refused.is_empty() {
                        self.controller.refuse(refused);
                    }
                    self.note_incidents();
                }
                PlcEvent::Configured => {
                    self.wires.configure(&self.settings);
                    if self.settings.is_requested() {
                        // The store command is executed before any further event.
                        break;
                    }
                }
                PlcEvent::Left { silent } => self.lose_bus(silent),
                PlcEvent::Served => {}
            }
        }
        self.liveness.serve(Served::BUS);
    }

    /// Subscribes to the values that only registers show.
    fn measure(&mut self) {
        if !core::mem::replace(&mut self.is_measured, true) {
            self.ask_for_measured();
        }
    }

    /// Subscribes to width and force, again if required. The gripper is queried for both as soon as nothing more urgent is
    /// pending.
    fn ask_for_measured(&mut self) {
        let update = AutoUpdate::on_change(MEASURED_PERIOD_MS);
        self.session.subscribe(Topic::Width, update);
        self.session.subscribe(Topic::Force, update);
    }

    /// Requests width and force at the end of a motion, for a bus. It subscribes instead of sending a request, so that a
    /// subsequent motion command does not wait for the replies.
    fn follow_motion(&mut self, now: Instant, image: &InputImage) {
        if self.is_measured && self.facts.motion_end.look(now, image) {
            self.ask_for_measured();
        }
    }

    /// Handles a bus that no longer commands. `silent`: unexpectedly, which is counted.
    fn lose_bus(&mut self, silent: bool) {
        let known = self.session.known();
        if self.arbiter.control_source() == ControlSource::Bus {
            self.facts.bus_timeouts = self.facts.bus_timeouts.saturating_add(silent.into());
            if silent {
                self.facts.events.happened(EventCode::BusSilent, self.settings.bus().reaction as u16);
            }
            self.controller.silence(self.settings.bus().reaction, known);
        }
        if let Some(image) = self.arbiter.lose_bus() {
            self.controller.set_output(&image, known);
        }
    }

    /// Logs the incidents of the controller.
    fn note_incidents(&mut self) {
        while let Some(incident) = self.controller.poll_incident() {
            self.facts.events.note(incident, self.arbiter.fast_stop_event());
        }
    }

    /// Logs incidents, and the faults that the gripper reports.
    #[inline(never)]
    fn keep_record(&mut self, now: Instant) {
        self.facts.events.grow_old(now);
        self.note_incidents();
        if let Some(flags) = self.session.known().flags {
            self.facts.events.see_flags(flags, self.controller.asks_fast_stop());
        }
    }

    /// Returns the event code of the cause of ERROR; 0 if ERROR is low.
    fn cause_of_error(&self, shown: &Shown) -> u8 {
        if !wires::has_error(shown) {
            0
        } else if shown.image.system.contains(SystemFlags::FAST_STOP) {
            self.facts.events.cause_of_error(true)
        } else if self.facts.store.from.is_refusal() {
            EventCode::SettingsRefused as u8
        } else if self.facts.update.is_active() {
            EventCode::UpdateRuns as u8
        } else if shown.link != Link::Up {
            EventCode::GripperSilent as u8
        } else {
            self.facts.events.cause_of_error(false)
        }
    }

    fn forward_commands(&mut self) {
        while let Some(command) = self.controller.poll_command() {
            if let Err(error) = self.session.request(command) {
                self.controller.refused(command.id(), error, self.session.known());
            }
        }
    }

    /// Transmits byte by byte, and takes a byte or a command only while the line has room. A FAST STOP can overtake a command
    /// that still waits in the session, whose time-out has not started.
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
                // The frame is complete, or a byte was rejected. The gripper discards a truncated frame, and the session
                // times out.
                self.sending = None;
            }
        }
    }
}

fn notify(
    controller: &mut Controller,
    motion_end: &mut MotionEnd,
    session: &Session,
    event: Option<Event<'_>>,
) {
    if let Some(event) = event {
        log::noticed(&event);
        motion_end.see(&event);
        controller.handle(&event, session.known());
    }
}
