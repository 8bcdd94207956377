//! The bridge: a PLC side, the register controller, the session, and the gripper's line.

use crate::arbiter::{Arbiter, ControlSource};
use crate::can::CanReports;
use crate::gripper::MAX_REPLY_LEN;
use crate::indicator::Indication;
use crate::io::{Inputs, Outputs};
use crate::liveness::{Liveness, Looked};
use crate::log;
use crate::plc::wires::{self, Wires};
use crate::plc::{
    Config, Facts, MotionEnd, PlcEvent, PlcSide, Record, Settings, Shown, SideReports, View, force_unit,
};
use crate::register::{
    EventCode, Events, Link, ResetCause, SaveState, SettingsFrom, StoreCommand, StoreReports,
};
use embedded_io::{Read, ReadReady, Write, WriteReady};
use wsg_fieldbus::{Controller, InputImage};
use wsg_protocol::session::{self, Event, Session, Topic};
use wsg_protocol::{AutoUpdate, Command, CommandId, FrameEncoder, FrameParser, Instant, SystemFlags, frame};

/// Bytes taken from the line in one turn of the main loop, at the most: a line that never falls silent must not keep
/// the wires waiting. One millisecond at 115 200 bit/s brings 12.
const MAX_RECEIVED_PER_POLL: usize = 256;

/// The least time between two updates of width or force for the bus's registers: a report has 14 bytes, and the line
/// carries 115 in that time.
const MEASURED_PERIOD_MS: u16 = AutoUpdate::MIN_PERIOD_MS;

/// What the bridge has met that it could not use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// On the gripper's line, below frames.
    pub line: frame::FrameCounters,
    /// In frames and requests.
    pub session: session::SessionCounters,
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
    wires: Wires,
    arbiter: Arbiter,
    facts: Facts,
    /// Width and force are subscribed to, because a bus or the service port shows them. Wires alone have no use for them.
    is_measured: bool,
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
            wires: Wires::new(config.wires),
            arbiter: Arbiter::new(),
            facts: Facts {
                was_connected: false,
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
            },
            is_measured: false,
            liveness: Liveness::new(),
            sending: None,
            gave_up: false,
            settings,
        }
    }

    /// Takes another configuration, but for the time-outs towards the gripper, and where it is from. Before the first turn
    /// alone. Settings that are refused let nothing move until others are stored.
    // Apart: a record of the settings is on its stack.
    #[inline(never)]
    pub(crate) fn configure(&mut self, config: &Config, from: SettingsFrom) {
        self.settings.start(config);
        self.wires.configure(&self.settings);
        self.facts.sides = SideReports::new(config);
        self.facts.store.from = from;
        self.arbiter.set_refuses(from.is_refusal());
        if from.is_refusal() {
            self.facts.events.happened(EventCode::SettingsRefused, from as u16);
        }
    }

    /// The settings as they are now.
    pub(crate) const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Takes what was asked to be done with the settings. The fingers stood when it was asked for, and nothing that comes later
    /// in that turn begins a motion.
    pub(crate) const fn take_store_command(&mut self) -> Option<StoreCommand> {
        self.settings.take_asked()
    }

    /// Takes these settings; they are not stored.
    pub(crate) fn take_settings(&mut self, settings: &Record) {
        self.settings.take(settings);
        self.wires.configure(&self.settings);
    }

    /// A save has begun.
    pub(crate) const fn save_begins(&mut self) {
        self.facts.store.save = SaveState::Saving;
    }

    /// The settings as they are were stored.
    pub(crate) fn save_succeeded(&mut self) {
        self.settings.are_stored();
        self.facts.store = StoreReports { from: SettingsFrom::Stored, save: SaveState::Saved };
        self.arbiter.set_refuses(false);
    }

    /// They were not; why is the value of [`EventCode::SaveFailed`].
    pub(crate) fn save_failed(&mut self, why: u16) {
        self.facts.events.happened(EventCode::SaveFailed, why);
        self.facts.store.save = SaveState::Failed;
    }

    /// One turn: takes what the line, the wires and the bus brought, sends what is due, and returns the levels of the wires to
    /// the PLC. Never waits: `link` is read only when it has bytes and written only when it has room.
    ///
    /// `bus` is the PLC side beside the wires, [`NoBus`](crate::plc::NoBus) if there is none.
    pub fn poll<L: Read + ReadReady + Write + WriteReady, P: PlcSide>(
        &mut self,
        now_ms: u32,
        inputs: Inputs,
        link: &mut L,
        bus: &mut P,
    ) -> Outputs {
        let now = Instant::from_millis(now_ms);
        bus.report(&mut self.facts.sides);
        let has_heard = self.receive(now, link) | self.expire_half_frame(now);
        // Before what is known may be given up with the connection.
        self.controller.get_acquainted(self.session.known());
        self.tick(now);
        self.facts.was_connected |= self.session.is_connected();
        self.take_wires(now, inputs, has_heard);
        if self.facts.motion_end.is_awaited() {
            // Before a bus is answered.
            self.follow_motion(now, &self.facts.image(&self.controller, &self.session));
        }
        self.take_bus(now, bus);
        self.forward_commands();
        self.tick(now);
        if !core::mem::take(&mut self.gave_up) {
            self.transmit(now, link);
        }
        // Behind what leaves: a FAST STOP does not wait for its record.
        self.keep_record(now);
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
                || self.facts.store.from.is_refusal(),
        };
        shown.error_cause = self.cause_of_error(&shown);
        self.facts.error_cause = shown.error_cause;
        bus.show(now, &Shown { image: self.facts.motion_end.shown(shown.image), ..shown });
        self.wires.read(inputs).show(now, &shown);
        self.liveness.look(Looked::OUTPUTS);
        self.wires.shown()
    }

    /// Serves a service port, once a turn, before or behind [`poll`](Self::poll): one event at the most. What it changes of the
    /// settings counts at once. It commands nothing: an output image of it is dropped, and so is its silence.
    pub fn serve<P: PlcSide>(&mut self, now_ms: u32, service: &mut P) {
        let Self { controller, session, parser, arbiter, facts, settings, .. } = self;
        let mut view = View { controller, session, parser, arbiter, facts, settings };
        let Some(event) = service.receive(Instant::from_millis(now_ms), &mut view) else { return };
        self.measure();
        if event == PlcEvent::Configured {
            self.wires.configure(&self.settings);
        }
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
        if is_lost && !self.facts.link_is_lost {
            self.session.disconnect();
        }
        self.facts.link_is_lost = is_lost;
    }

    /// Returns whether the gripper must not carry out a motion or acknowledgement any more that was written to the link, after a
    /// poll: something that stops it was requested since. A link that holds unsent frames of it withdraws them, and the bridge
    /// learns that by [`withdrawn`](Self::withdrawn).
    #[must_use]
    pub fn has_overtaken(&self) -> bool {
        self.session.has_overtaken()
    }

    /// Takes that the link has withdrawn this command, before a poll: the gripper never gets it whole.
    pub fn withdrawn(&mut self, id: CommandId) {
        if self.session.take_back(id) {
            let withdrawn = Some(Event::Withdrawn(id));
            notify(&mut self.controller, &mut self.facts.motion_end, &self.session, withdrawn);
        }
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
    pub fn set_reset_cause(&mut self, cause: ResetCause) {
        self.facts.events.happened(EventCode::Start, cause as u16);
        self.facts.reset_cause = cause;
    }

    /// Takes what is known of the CAN bus, for the registers that report it.
    pub fn set_can_reports(&mut self, reports: CanReports) {
        if reports.bus_offs() != self.facts.can.bus_offs() {
            self.facts.events.happened(EventCode::BusOff, 0);
        }
        self.facts.can = reports;
    }

    /// What the board's LED tells, as of the last turn.
    #[must_use]
    pub const fn indication(&self) -> Indication {
        let is_missed = !matches!(self.arbiter.control_source(), ControlSource::Wires);
        let is_bus_lost = (self.facts.bus_is_silent && is_missed) || self.facts.can.is_off();
        let has_error = self.wires.shown().contains(Outputs::ERROR);
        Indication::of(self.facts.link(&self.session), is_bus_lost, has_error)
    }

    /// What has been met so far that could not be used.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        Counters { line: self.parser.counters(), session: self.session.counters() }
    }

    /// Whose motion command was the last.
    #[must_use]
    pub const fn control_source(&self) -> ControlSource {
        self.arbiter.control_source()
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
                notify(&mut self.controller, &mut self.facts.motion_end, &self.session, noticed);
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
            notify(&mut self.controller, &mut self.facts.motion_end, &self.session, noticed);
        }
        true
    }

    fn tick(&mut self, now: Instant) {
        while let Some(noticed) = self.session.tick(now) {
            if noticed == Event::Disconnected {
                self.facts.events.happened(EventCode::GripperSilent, 0);
                // What has not left by now must not leave when the line comes back; but for a FAST STOP, which is owed.
                self.sending = self.sending.take().filter(|frame| frame.id() == CommandId::FastStop.code());
                self.gave_up = true;
            }
            notify(&mut self.controller, &mut self.facts.motion_end, &self.session, Some(noticed));
        }
    }

    fn take_wires(&mut self, now: Instant, inputs: Inputs, has_heard: bool) {
        self.liveness.look(Looked::WIRES);
        let is_ready = self.wires.is_ready();
        let Self { wires, controller, session, parser, arbiter, facts, settings, .. } = self;
        let mut view = View { controller, session, parser, arbiter, facts, settings };
        let Some(PlcEvent::Output(image)) = wires.read(inputs).receive(now, &mut view) else { return };
        let known = self.session.known();
        // Of a command that is refused, the parameters do not count. (READY was not shown to a PLC whose fingers move:
        // only what came since can tell otherwise.)
        let keeps_parameters = !is_ready || (has_heard && self.controller.is_moving(known));
        self.arbiter.take_wires(&image, keeps_parameters, |image| {
            if is_ready {
                self.controller.set_output(image, known);
            } else {
                self.controller.set_output_refusing_motions(image, known);
            }
        });
    }

    /// Serves what the bus has brought. Each image reaches the controller by itself, so that no edge is lost.
    fn take_bus<P: PlcSide>(&mut self, now: Instant, bus: &mut P) {
        for _ in 0..bus.max_events_per_turn() {
            let Self { controller, session, parser, arbiter, facts, settings, .. } = self;
            let mut view = View { controller, session, parser, arbiter, facts, settings };
            let Some(event) = bus.receive(now, &mut view) else { break };
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
                    if self.settings.is_asked() {
                        // It is done before anything else comes.
                        break;
                    }
                }
                PlcEvent::Left { silent } => self.lose_bus(silent),
                PlcEvent::Served => {}
            }
        }
        self.liveness.look(Looked::BUS);
    }

    /// Subscribes to what only registers show.
    fn measure(&mut self) {
        if !core::mem::replace(&mut self.is_measured, true) {
            self.ask_for_measured();
        }
    }

    /// Subscribes to width and force, be it again: the gripper is asked for both as soon as the line has nothing more urgent.
    fn ask_for_measured(&mut self) {
        let update = AutoUpdate::on_change(MEASURED_PERIOD_MS);
        self.session.subscribe(Topic::Width, update);
        self.session.subscribe(Topic::Force, update);
    }

    /// Asks for width and force at the end of a motion, for a bus. No request: a motion that the PLC asks for now does not
    /// wait for the answers.
    fn follow_motion(&mut self, now: Instant, image: &InputImage) {
        if self.is_measured && self.facts.motion_end.look(now, image) {
            self.ask_for_measured();
        }
    }

    /// `silent`: unexpectedly, which is counted.
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

    /// Takes what the controller has noted.
    fn note_incidents(&mut self) {
        while let Some(incident) = self.controller.poll_incident() {
            self.facts.events.note(incident, self.arbiter.is_stopped_by_wires());
        }
    }

    /// Keeps a record of what went wrong, and of the faults that the gripper tells.
    #[inline(never)]
    fn keep_record(&mut self, now: Instant) {
        self.facts.events.grow_old(now);
        self.note_incidents();
        if let Some(flags) = self.session.known().flags {
            self.facts.events.see_flags(flags, self.controller.asks_fast_stop());
        }
    }

    /// Why ERROR is high, by the code of an event; 0: it is not.
    fn cause_of_error(&self, shown: &Shown) -> u8 {
        if !wires::has_error(shown) {
            0
        } else if shown.image.system.contains(SystemFlags::FAST_STOP) {
            self.facts.events.cause_of_error(true)
        } else if self.facts.store.from.is_refusal() {
            EventCode::SettingsRefused as u8
        } else if shown.link != Link::Up {
            EventCode::GripperSilent as u8
        } else {
            self.facts.events.cause_of_error(false)
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
