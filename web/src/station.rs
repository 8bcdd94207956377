//! The whole station in virtual time: a PLC's wires, a bus master, the bridge, the gripper's line and the virtual gripper.
//!
//! [`Station`] has no clock and no I/O. It runs the firmware's main loop once per virtual millisecond. The same actions at the same
//! times give the same frames, regardless of the steps between them, so a [`Session`] reproduces a state.

mod line;
mod master;
mod session;

use std::cell::RefCell;
use std::collections::VecDeque;

use bitflags::Flags;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::Modbus;
use wsg_bridge_fw::registers::{EVENTS, FIRST_REPORT, FIRST_SETTING, Record, SETTINGS};
use wsg_bridge_fw::{Bridge, Config, ResetCause};
use wsg_fieldbus::{CommandFlags, GripperFlags, InputImage, OutputImage};
use wsg_protocol::Direction;
use wsg_sim::control::json::{self, body, object};
use wsg_sim::{MAX_FRAME_LEN, Part, PortId, PortKind, Time, VirtualGripper};

pub use line::SentFrame;
pub use session::{Action, MAX_ACTIONS, MAX_TIME_US, OFFERED_SETTINGS, Session};

use line::{BridgeEnd, Way};
use master::{Master, read, words, write};

/// Time between two turns of the main loop, in microseconds.
const TURN_US: u64 = 1_000;

/// Times of a character: 11 bits at 19 200 bit/s on the PLC's bus, and 10 bits at 115 200 bit/s on the service port.
const BUS_CHARACTER_US: u64 = 573;
const SERVICE_CHARACTER_US: u64 = 87;

/// Intervals of the requests on both lines, in microseconds. The master writes and reads in turn.
const BUS_CYCLE_US: u64 = 25_000;
const SERVICE_CYCLE_US: u64 = 100_000;

/// Number of reports that are read over the service port, from [`FIRST_REPORT`] on.
const REPORT_COUNT: u8 = 103;

/// Number of frames kept.
const FRAMES_KEPT: usize = 300;

/// Width in 1/10 mm of the part at the start.
const FIRST_PART: u16 = 200;

/// Longest step of a page, in microseconds.
const LONGEST_STEP_US: u64 = 2_000_000;

/// A bridge between a PLC and a gripper, with everything around it.
pub struct Station {
    now_us: u64,
    next_turn_us: u64,
    session: Session,
    bridge: Bridge,
    /// The bridge's ends of bus and service port.
    sides: [Modbus; 2],
    /// The settings, which the bridge keeps at a restart.
    settings: Record,
    inputs: Inputs,
    outputs: Outputs,
    bus: Master,
    bus_cycle_us: u64,
    is_master_on: bool,
    image: [u16; 4],
    input: Result<InputImage, u8>,
    service: Master,
    service_cycle_us: u64,
    unwritten: VecDeque<(u16, u16)>,
    refused: Option<(u16, u8)>,
    reports: Vec<u16>,
    gripper: VirtualGripper<1>,
    port: PortId,
    part: u16,
    to_gripper: Way,
    to_bridge: Way,
    received: VecDeque<u8>,
    /// Bytes that the bridge has read and written in its last turn.
    read: Vec<u8>,
    written: Vec<u8>,
    frames: VecDeque<SentFrame>,
    frame_count: u32,
}

/// A turn of the bridge's main loop, for an observer.
pub struct Turn<'a> {
    /// The bridge's clock.
    pub now_ms: u32,
    /// Levels of the wires from the PLC.
    pub inputs: Inputs,
    /// Bytes that the bridge has read from the gripper's line.
    pub read: &'a [u8],
    /// Bytes that the bridge has written to the gripper's line.
    pub written: &'a [u8],
    /// Output image of a write that the bridge has executed.
    pub image: Option<OutputImage>,
    /// Whether the bridge has answered the bus master.
    pub has_answered: bool,
    /// Levels of the wires to the PLC.
    pub outputs: Outputs,
    /// The bridge.
    pub bridge: &'a Bridge,
    /// The settings after the turn.
    pub settings: &'a Record,
    /// The latest frames whose last byte has ended.
    pub frames: &'a VecDeque<SentFrame>,
    /// State of the gripper.
    pub gripper: wsg_sim::State,
}

impl Default for Station {
    /// Powers up a station: all wires low, a bus master that writes zeros, a WSG 50-110 and a part of 20 mm.
    fn default() -> Self {
        let settings = Config::DEFAULT.record();
        let (gripper, port) = power_up(FIRST_PART);
        let (bridge, sides) = boot(&settings, ResetCause::PowerOn);
        Self {
            now_us: 0,
            next_turn_us: TURN_US,
            session: Session::default(),
            bridge,
            sides,
            settings,
            inputs: Inputs::empty(),
            outputs: Outputs::empty(),
            bus: Master::new(BUS_CHARACTER_US),
            bus_cycle_us: 0,
            is_master_on: true,
            image: [0; 4],
            input: Err(0),
            service: Master::new(SERVICE_CHARACTER_US),
            service_cycle_us: 0,
            unwritten: VecDeque::new(),
            refused: None,
            reports: Vec::new(),
            gripper,
            port,
            part: FIRST_PART,
            to_gripper: Way::new(Direction::ToGripper),
            to_bridge: Way::new(Direction::FromGripper),
            received: VecDeque::new(),
            read: Vec::new(),
            written: Vec::new(),
            frames: VecDeque::new(),
            frame_count: 0,
        }
    }
}

impl Station {
    /// Plays a session.
    #[must_use]
    pub fn replay(session: &Session) -> Self {
        let mut station = Self::default();
        for &(at_us, action) in &session.actions {
            station.run(at_us);
            station.act(action);
        }
        station.run(session.end_us);
        station
    }

    /// Returns the session so far.
    #[must_use]
    pub fn session(&self) -> Session {
        Session { end_us: self.now_us, ..self.session.clone() }
    }

    /// Returns the time of the next turn, in microseconds.
    #[must_use]
    pub const fn next_turn_us(&self) -> u64 {
        self.next_turn_us
    }

    /// Returns the settings of the bridge.
    #[must_use]
    pub const fn settings(&self) -> &Record {
        &self.settings
    }

    /// Returns the state of the gripper.
    #[must_use]
    pub fn gripper(&self) -> wsg_sim::State {
        self.gripper.state()
    }

    /// Runs all turns up to this time in microseconds.
    pub fn run(&mut self, until_us: u64) {
        while self.next_turn_us <= until_us {
            self.turn();
        }
        self.now_us = self.now_us.max(until_us);
    }

    /// Performs an action now.
    pub fn act(&mut self, action: Action) {
        self.carry(self.now_us * 1_000);
        // A session that is too long for a link stays so.
        if self.session.actions.len() <= MAX_ACTIONS {
            self.session.actions.push((self.now_us, action));
        }
        match action {
            Action::Wires(levels) => self.inputs = Inputs::from_bits_retain(levels),
            Action::Image(image) => self.image = image,
            Action::Master(is_on) => self.is_master_on = is_on,
            Action::Cut(is_cut) => (self.to_gripper.is_cut, self.to_bridge.is_cut) = (is_cut, is_cut),
            Action::Damage(true) => self.to_gripper.damages = 1,
            Action::Damage(false) => self.to_bridge.damages = 1,
            Action::Part(width) => {
                self.part = width;
                self.gripper.set_part(part(width), self.time());
            }
            Action::RestartBridge => {
                (self.bridge, self.sides) = boot(&self.settings, ResetCause::Pin);
                self.to_gripper.restart();
                self.received.clear();
                for (master, character_us) in
                    [(&mut self.bus, BUS_CHARACTER_US), (&mut self.service, SERVICE_CHARACTER_US)]
                {
                    *master = Master::new(character_us);
                }
            }
            Action::RestartGripper => {
                (self.gripper, self.port) = power_up(self.part);
                self.gripper.advance(self.time());
                self.to_bridge.restart();
            }
            Action::Setting(register, value) => self.unwritten.push_back((register, value)),
        }
    }

    /// Runs the next turn of the bridge's main loop.
    pub fn turn(&mut self) -> Turn<'_> {
        let (now_us, now_ns) = (self.next_turn_us, self.next_turn_us * 1_000);
        self.carry(now_ns);
        self.now_us = now_us;
        self.next_turn_us += TURN_US;
        self.gripper.advance(self.time());
        self.serve_masters();
        let Self { bridge, sides: [plc, port], to_gripper, received, read, written, .. } = self;
        let mut line = BridgeEnd::new(now_ns, to_gripper, received, [read, written]);
        let now_ms = (now_us / 1_000) as u32;
        self.outputs = bridge.poll(now_ms, self.inputs, &mut line, &mut plc.over(&mut self.bus));
        bridge.serve(now_ms, &mut port.over(&mut self.service));
        let image = self.bus.executed().filter(|request| request.first() == Some(&16)).map(image_of);
        if let Some(request) = self.service.executed().filter(|request| request.first() == Some(&16)) {
            let register = words(request, 1).next().unwrap_or_default();
            for (place, value) in
                self.settings.iter_mut().skip(usize::from(register - FIRST_SETTING)).zip(words(request, 6))
            {
                *place = value;
            }
        }
        Turn {
            now_ms,
            inputs: self.inputs,
            read: &self.read,
            written: &self.written,
            image,
            has_answered: self.bus.has_answered,
            outputs: self.outputs,
            bridge: &self.bridge,
            settings: &self.settings,
            frames: &self.frames,
            gripper: self.gripper.state(),
        }
    }

    fn time(&self) -> Time {
        Time::from_micros(self.now_us)
    }

    /// Carries the bytes that end until this time, each at its own time, and wakes the gripper when it is due.
    fn carry(&mut self, until_ns: u64) {
        loop {
            let now = self.gripper.now();
            // An event of the gripper that became due while time stood still is due now.
            let wake = self
                .gripper
                .next_wake()
                .map_or(u64::MAX, |wake| wake.max(now.plus_micros(1)).as_micros() * 1_000);
            let [to_gripper, to_bridge] = [self.to_gripper.due_ns(), self.to_bridge.due_ns()];
            let at_ns = wake.min(to_gripper).min(to_bridge);
            if at_ns > until_ns {
                return;
            }
            let at = Time::from_micros(at_ns.div_ceil(1_000));
            let mut ended = None;
            if to_gripper == at_ns {
                let (byte, frame) = self.to_gripper.receive();
                self.gripper.receive(self.port, at, byte.as_slice());
                ended = frame;
            } else if to_bridge == at_ns {
                let (byte, frame) = self.to_bridge.receive();
                self.received.extend(byte);
                ended = frame;
            } else {
                self.gripper.advance(at);
            }
            if let Some(frame) = ended {
                self.frames.push_back(SentFrame { number: self.frame_count, ..frame });
                self.frame_count += 1;
                if self.frames.len() > FRAMES_KEPT {
                    self.frames.pop_front();
                }
            }
            let mut buffer = [0; MAX_FRAME_LEN];
            while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
                self.to_bridge.send(at_ns, frame);
            }
        }
    }

    /// Takes the answers to the master and to the service port's client, and sends their next requests.
    fn serve_masters(&mut self) {
        let now_us = self.now_us;
        if let Some((request, answer)) = self.bus.turn(now_us)
            && request.first() == Some(&4)
        {
            self.input = match answer[..] {
                [4, _, ref image @ ..] => image.try_into().map(InputImage::from_bytes).map_err(|_| 0),
                [_, exception] => Err(exception),
                _ => Err(0),
            };
        }
        if now_us >= self.bus_cycle_us && self.is_master_on && !self.bus.is_busy() {
            let is_write = (self.bus_cycle_us / BUS_CYCLE_US).is_multiple_of(2);
            self.bus_cycle_us = (now_us / BUS_CYCLE_US + 1) * BUS_CYCLE_US;
            self.bus.send(if is_write { write(0, &self.image) } else { read(0, 6) });
        } else if !self.is_master_on {
            self.input = Err(0);
        }
        if let Some((request, answer)) = self.service.turn(now_us) {
            match (request.first(), &answer[..]) {
                (Some(4), [4, ..]) => self.reports = words(&answer, 2).collect(),
                (Some(16), [16, ..]) => self.refused = None,
                // A write that a restart has cut off is not repeated.
                (Some(16), _) => {
                    let register = words(&request, 1).next().unwrap_or_default();
                    self.refused = Some((register, answer.get(1).copied().unwrap_or_default()));
                }
                _ => {}
            }
        }
        if !self.service.is_busy() {
            if let Some((register, value)) = self.unwritten.pop_front() {
                self.service.send(write(register, &[value]));
            } else if now_us >= self.service_cycle_us {
                self.service_cycle_us = (now_us / SERVICE_CYCLE_US + 1) * SERVICE_CYCLE_US;
                self.service.send(read(FIRST_REPORT, REPORT_COUNT));
            }
        }
    }

    /// Returns the state for a page, with the frames from this number on, and perhaps with the link.
    fn view(&self, first_frame: u32, has_link: bool) -> String {
        let state = self.gripper.state();
        let input = self
            .input
            .map(|it| (it.state.bits(), names(it.system), it.width, it.force, it.status.to_string()));
        object! {
            "now_us": self.now_us,
            "inputs": self.inputs.bits(),
            "outputs": self.outputs.bits(),
            "is_master_on": self.is_master_on,
            "image": self.image,
            "input": input.as_ref().ok(),
            "exception": input.as_ref().err(),
            "settings": &self.settings[..],
            "refused": self.refused,
            "reports": self.reports,
            "is_cut": self.to_gripper.is_cut,
            "damages": [self.to_gripper.damages, self.to_bridge.damages],
            "state": state.gripper.to_string(),
            "flags": names(state.flags),
            "width": state.width,
            "force": state.force,
            "part": self.part,
            "has_part": state.part_is_between,
            "frames": self.frames.iter().filter(|frame| frame.number >= first_frame).collect::<Vec<_>>(),
            "frame_count": self.frame_count,
            "link": has_link.then(|| self.session().link()).flatten(),
        }
    }
}

/// Returns names and tables of the library for a page.
fn hello() -> String {
    let setting = |register: &u16| {
        let it = SETTINGS.get(usize::from(register - FIRST_SETTING))?;
        Some((*register, it.name, it.unit, it.least, it.most, it.meaning))
    };
    object! {
        "inputs": names(Inputs::all()),
        "outputs": names(Outputs::all()),
        "command_flags": names(CommandFlags::all()),
        "gripper_flags": names(GripperFlags::all()),
        "events": EVENTS.map(|it| (it.code as u8, it.name, it.meaning, it.remedy)),
        "settings": OFFERED_SETTINGS.iter().filter_map(setting).collect::<Vec<_>>(),
    }
}

fn names<F: Flags>(flags: F) -> Vec<&'static str> {
    flags.iter_names().map(|(name, _)| name).collect()
}

struct Request {
    station: Body,
}
body!(Request: station);

/// A request of a page, in the order of its effects.
struct Body {
    /// Returns the names instead of the state.
    hello: bool,
    /// Starts again and replays the session of this link; empty: an empty one.
    link: Option<String>,
    actions: Vec<String>,
    step_us: u64,
    first_frame: u32,
    /// Returns the link, too.
    share: bool,
}
body!(
    Body: #[default] hello, link, #[default] actions, #[default] step_us, #[default] first_frame, #[default] share
);

thread_local! {
    static STATION: RefCell<Station> = RefCell::default();
}

/// Answers a request of a page, both in JSON.
#[must_use]
pub fn call(request: &str) -> String {
    let answer = json::read(request.as_bytes()).and_then(answer);
    answer.unwrap_or_else(|error| object! { "error": error })
}

fn answer(Request { station: body }: Request) -> Result<String, String> {
    if body.hello {
        return Ok(hello());
    }
    STATION.with_borrow_mut(|station| {
        if let Some(link) = &body.link {
            let session = if link.is_empty() { Some(Session::default()) } else { Session::parse(link) };
            *station =
                Station::replay(&session.ok_or("the link is damaged: expected a copied link to a session")?);
        }
        for action in &body.actions {
            station.act(Action::parse(action).ok_or_else(|| format!("unknown action `{action}`"))?);
        }
        station.run(station.now_us + body.step_us.min(LONGEST_STEP_US));
        Ok(station.view(body.first_frame, body.share))
    })
}

/// Starts a bridge with the PLC on wires and Modbus RTU.
fn boot(settings: &Record, cause: ResetCause) -> (Bridge, [Modbus; 2]) {
    // The bridge has accepted each of them.
    let config = Config::from_record(settings).unwrap_or(Config::DEFAULT);
    let mut bridge = Bridge::new(config);
    bridge.set_reset_cause(cause);
    (bridge, [Modbus::new(&config), Modbus::service()])
}

/// Powers up a gripper with this part and connects to it.
fn power_up(width: u16) -> (VirtualGripper<1>, PortId) {
    let mut gripper = VirtualGripper::with_ports(wsg_sim::Config { part: part(width), ..Default::default() });
    let port = gripper.connect(PortKind::Serial);
    (gripper, port.unwrap_or_else(|| unreachable!("a new gripper takes a client")))
}

fn part(width: u16) -> Option<Part> {
    Part::of_width(f32::from(width) / 10.0)
}

/// Returns the output image that a request writes.
fn image_of(request: &[u8]) -> OutputImage {
    let mut bytes = [0; OutputImage::LEN];
    bytes.iter_mut().zip(request.iter().skip(6)).for_each(|(place, byte)| *place = *byte);
    OutputImage::from_bytes(bytes)
}
