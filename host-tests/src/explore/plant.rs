//! Bridge, gripper, line and PLC: one state of the exploration, and the effect of each action.

use std::collections::VecDeque;
use std::fmt::Write as _;

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::Modbus;
use wsg_bridge_fw::{Bridge, BusConfig, Config, ControlSource, WiresConfig};
use wsg_fieldbus::OutputImage;
use wsg_protocol::{CommandId, FrameParser, GripperState, Instant, session};

use super::key::key;
use super::search::Model;
use crate::gripper_states::{Answer, GripperEvent, States, messages};
use crate::operation::{Operation, script};
use crate::promises::{Kept, Promise, Promises, Reach, keep};
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::SerialLine;
use crate::world::modbus::{UNIT, registers_of, write_request};

const CONFIG: Config = Config {
    // An edge takes no time, so more orders of events lead to the same state.
    wires: WiresConfig { debounce_ms: 0, ..WiresConfig::DEFAULT },
    // Shorter than the interval between queries, so a missing result is given up before the next query.
    session: session::Config { result_grace_ms: 60, ..Config::DEFAULT.session },
    bus: BusConfig { unit: UNIT, timeout_ms: BUS_TIMEOUT_MS as u16, ..Config::DEFAULT.bus },
    ..Config::DEFAULT
};

/// Bus silence after which the bridge considers the PLC lost, in milliseconds.
const BUS_TIMEOUT_MS: u32 = 100;
/// Time until a high FAST_STOP_OK takes effect, in milliseconds.
const FAST_STOP_RELEASE_MS: u32 = 5;
/// Turns before a deadline, in milliseconds: after a truncated frame's time-out and after the minimum of BUSY.
const TURNS_MS: [u32; 2] = [21, 51];
/// Longest wait in milliseconds, also used without a deadline.
const LONGEST_WAIT_MS: u32 = 1_000;
/// Maximum wait of a frame for the previous one, in milliseconds.
const MAX_DELAY_MS: u32 = 1;
const COMMAND_WIRES: Inputs = Inputs::GRIP.union(Inputs::MOVE).union(Inputs::RELEASE).union(Inputs::HOME);
/// Rounds of request and reply that take no time; connecting takes seven.
const QUICK_ROUNDS: u32 = 20;
/// Duration of a round on a line at 115 200 bit/s, in milliseconds.
const ROUND_MS: u32 = 2;
/// Maximum number of messages in transit to the bridge.
const MAX_ANSWERS: usize = 16;
/// Maximum number of rounds.
const MOST_ROUNDS: u32 = QUICK_ROUNDS + 500;

/// One state of the exploration.
#[derive(Clone, Debug)]
pub(super) struct Plant {
    actions: &'static [Operation],
    bridge: Bridge,
    modbus: Modbus,
    gripper: States,
    now_ms: u32,
    wires: Inputs,
    outputs: Outputs,
    is_line_up: bool,
    /// Messages in transit to the bridge, each with a flag that it has already been delivered once.
    answers: VecDeque<(Answer, bool)>,
    /// A message that arrives in the last turn of the next action.
    with_next: Option<Answer>,
    /// The last image that the PLC wrote over the bus; `None` while it is silent.
    image: Option<OutputImage>,
    /// Time of the PLC's last request over the bus; `None` while it is silent.
    requested: Option<Instant>,
    promises: Promises,
    reach: Reach,
    /// Readable log, if enabled.
    story: Option<String>,
}

/// What the PLC sends over the bus in a turn.
#[derive(Clone, Copy, Debug)]
enum Request {
    None,
    /// A read of a register.
    Read,
    /// A write of registers 0 to 3.
    Write(OutputImage),
}

/// Name and predicate of a situation.
type Sight = (&'static str, fn(&Plant) -> bool);

/// Situations that an exploration should reach.
pub(super) const SIGHTS: [Sight; 18] = [
    ("READY", |plant| plant.outputs.contains(Outputs::READY)),
    ("BUSY", |plant| plant.outputs.contains(Outputs::BUSY)),
    ("HOLDING", |plant| plant.outputs.contains(Outputs::HOLDING)),
    ("PART_FAULT", |plant| plant.outputs.contains(Outputs::PART_FAULT)),
    ("ERROR", |plant| plant.outputs.contains(Outputs::ERROR)),
    ("REFERENCED", |plant| plant.outputs.contains(Outputs::REFERENCED)),
    ("LINK_OK", |plant| plant.outputs.contains(Outputs::LINK_OK)),
    ("no LINK_OK", |plant| !plant.outputs.contains(Outputs::LINK_OK)),
    ("a homing", |plant| plant.own_motion() == Some(CommandId::Homing)),
    ("a move", |plant| plant.own_motion() == Some(CommandId::PrePosition) && !plant.promises.requests.jogs),
    ("a grip", |plant| plant.own_motion() == Some(CommandId::GripPart)),
    ("a release", |plant| plant.own_motion() == Some(CommandId::ReleasePart)),
    ("a jog", |plant| plant.own_motion() == Some(CommandId::PrePosition) && plant.promises.requests.jogs),
    ("a motion of a third party", |plant| plant.motion().is_some() && plant.gripper.is_foreign),
    ("a lost part", |plant| plant.gripper.state == GripperState::PartLost),
    ("a latched FAST STOP", |plant| plant.gripper.fast_stop()),
    ("an unacknowledged FAST STOP", |plant| plant.promises.requests.stopped.is_some()),
    ("a motion unknown to the bridge", |plant| {
        plant.motion().is_some() && plant.outputs.contains(Outputs::READY)
    }),
];

impl Plant {
    /// Creates the state after power-up with all wires low.
    pub(super) fn switched_on(actions: &'static [Operation]) -> Self {
        let mut plant = Self {
            actions,
            bridge: Bridge::new(CONFIG),
            modbus: Modbus::new(&CONFIG),
            gripper: States::SWITCHED_ON,
            now_ms: 0,
            wires: Inputs::empty(),
            outputs: Outputs::empty(),
            is_line_up: true,
            answers: VecDeque::new(),
            with_next: None,
            image: None,
            requested: None,
            promises: Promises::new(Instant::from_millis(0), &CONFIG),
            reach: Reach::new(true),
            story: None,
        };
        // A promise broken here also breaks in the exploration, through `RestartBridge`.
        let _ = plant.power_up();
        plant
    }

    /// Returns the state after these actions, ignoring broken promises.
    pub(super) fn after(&self, actions: &[Operation]) -> Self {
        let mut plant = self.clone();
        for action in actions {
            let _ = plant.take(action);
        }
        plant
    }

    /// Returns a log of these actions, and the script that repeats them.
    pub(super) fn report(&self, actions: &[u32]) -> String {
        let mut plant = Self { story: Some(String::new()), ..self.clone() };
        for action in actions.iter().copied() {
            if let Err(promise) = plant.act(action) {
                plant.log(|story| write!(story, "\n        broken: {promise:?}"));
            }
        }
        let script = script(actions.iter().map(|action| &self.actions[*action as usize]));
        format!("{}\n&[\n{script}]", plant.story.unwrap_or_default())
    }

    /// Returns the wires to the PLC.
    pub(super) const fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// Returns the motion in progress.
    pub(super) const fn motion(&self) -> Option<CommandId> {
        self.gripper.motion
    }

    /// Returns the motion in progress if the bridge commanded it.
    fn own_motion(&self) -> Option<CommandId> {
        self.motion().filter(|_| !self.gripper.is_foreign)
    }

    const fn now(&self) -> Instant {
        Instant::from_millis(self.now_ms)
    }

    fn log(&mut self, what: impl FnOnce(&mut String) -> std::fmt::Result) {
        if let Some(story) = &mut self.story {
            what(story).expect("writing to a string cannot fail");
        }
    }

    /// Executes an operation.
    pub(super) fn take(&mut self, action: &Operation) -> Kept {
        let ms = self.now_ms;
        self.log(|story| write!(story, "\n{ms:6} ms {action:?}"));
        match *action {
            Operation::Toggle(wire) => self.change_wires(wire),
            Operation::Change { rising, falling } => self.change_wires(rising | falling),
            Operation::Write(image) => self.write(image),
            Operation::FallSilent => self.fall_silent(),
            Operation::AnswersAll => self.deliver_all(),
            Operation::Answer => {
                let answer = self.take_answer();
                self.deliver(answer, false)
            }
            Operation::AnswerTwice => {
                let answer = self.answers.front_mut().map(|(answer, is_repeated)| {
                    *is_repeated = true;
                    *answer
                });
                self.deliver(answer, false)
            }
            Operation::AnswerLost => {
                self.take_answer();
                self.reach.fault(self.now());
                Ok(())
            }
            Operation::AnswerCut => {
                let answer = self.take_answer();
                self.reach.fault(self.now());
                self.deliver(answer, true)
            }
            Operation::AnswerWithNext => {
                self.with_next = self.take_answer();
                Ok(())
            }
            Operation::ToggleLine => {
                self.is_line_up = !self.is_line_up;
                self.reach.is_alive = self.is_line_up;
                self.reach.recover(self.now());
                self.answers.clear();
                self.with_next = None;
                Ok(())
            }
            Operation::Gripper(event) => {
                let was_fast_stopped = self.gripper.fast_stop();
                self.gripper.happen(event, &mut |answer| queue(&mut self.answers, answer));
                if was_fast_stopped && !self.gripper.fast_stop() {
                    self.reach.leave_fast_stop(self.now());
                }
                if event == GripperEvent::Restarts || !self.is_line_up {
                    self.answers.clear();
                }
                Ok(())
            }
            Operation::RestartBridge => {
                self.bridge = Bridge::new(CONFIG);
                self.modbus = Modbus::new(&CONFIG);
                self.with_next = None;
                (self.image, self.requested) = (None, None);
                self.promises = Promises::new(self.now(), &CONFIG);
                self.power_up()
            }
            Operation::Wait => self.wait(),
            _ => panic!("an exploration does not execute {action:?}"),
        }
    }

    /// Runs the first turns after power-up, until all wires have taken effect.
    fn power_up(&mut self) -> Kept {
        self.turn(&[], Request::None)?;
        self.settle(true)
    }

    /// Changes wires and lets them settle.
    fn change_wires(&mut self, changed: Inputs) -> Kept {
        self.wires.toggle(changed);
        let rising = self.wires & changed;
        let before = self.outputs;
        self.turn(&[], Request::None)?;
        let was_ready = (before & self.outputs).contains(Outputs::READY);
        // A message in the same turn may change the expected result.
        let is_judged = was_ready && self.with_next.is_none() && !rising.contains(Inputs::STOP_ACK);
        self.settle(rising.contains(Inputs::FAST_STOP_OK))?;
        if !is_judged || !rising.intersects(COMMAND_WIRES) {
            return Ok(());
        }
        let is_error = self.outputs.contains(Outputs::ERROR);
        // MOVE is rejected unless GSTATE is IDLE. ERROR in IDLE also follows an earlier rejected command.
        if rising.contains(Inputs::MOVE) && before.intersects(Outputs::HOLDING | Outputs::PART_FAULT) {
            return keep(Promise::RefusedCommandShowsError, is_error);
        }
        let may_be_refused = rising.contains(Inputs::MOVE) && before.contains(Outputs::ERROR);
        keep(Promise::ReadyCommandIsTaken, may_be_refused || !is_error)
    }

    /// Lets changed wires settle.
    fn settle(&mut self, fast_stop_ok_rises: bool) -> Kept {
        self.now_ms += if fast_stop_ok_rises { FAST_STOP_RELEASE_MS } else { CONFIG.wires.debounce_ms };
        self.last_turn()
    }

    fn write(&mut self, image: OutputImage) -> Kept {
        self.image = Some(image);
        let answers = self.with_next.take();
        self.turn(answers.as_slice(), Request::Write(image))
    }

    fn fall_silent(&mut self) -> Kept {
        while let Some(requested) = self.requested {
            let left_ms = requested.plus(BUS_TIMEOUT_MS).since(self.now());
            self.now_ms += self.ms_to_deadline().min(left_ms);
            self.turn(&[], Request::None)?;
        }
        Ok(())
    }

    fn wait(&mut self) -> Kept {
        let begun = self.now_ms;
        let ms = self.ms_to_deadline();
        for early in TURNS_MS.into_iter().filter(|early| *early < ms) {
            self.now_ms = begun + early;
            self.turn(&[], self.poll())?;
        }
        self.now_ms = begun + ms;
        self.last_turn()
    }

    fn ms_to_deadline(&self) -> u32 {
        let deadline = self.bridge.session().poll_timeout();
        deadline.map_or(LONGEST_WAIT_MS, |deadline| deadline.since(self.now())).clamp(1, LONGEST_WAIT_MS)
    }

    fn deliver_all(&mut self) -> Kept {
        for round in 0..MOST_ROUNDS {
            if round >= QUICK_ROUNDS {
                self.now_ms += ROUND_MS;
            }
            let mut answers = Vec::from_iter(self.with_next.take());
            answers.extend(self.answers.drain(..).map(|(answer, _)| answer));
            self.turn(&answers, Request::None)?;
            if self.answers.is_empty() {
                return Ok(());
            }
        }
        Err(Promise::ConversationEnds)
    }

    fn take_answer(&mut self) -> Option<Answer> {
        self.answers.pop_front().map(|(answer, _)| answer)
    }

    /// Delivers a message after one that waits for the next action. If it `is_cut`, its last byte is lost.
    fn deliver(&mut self, answer: Option<Answer>, is_cut: bool) -> Kept {
        let answers: Vec<_> = self.with_next.take().into_iter().chain(answer).collect();
        self.turn_with(&answers, is_cut, Request::None)
    }

    /// Runs the last turn of an action.
    fn last_turn(&mut self) -> Kept {
        let answers = self.with_next.take();
        self.turn(answers.as_slice(), self.poll())
    }

    /// Returns a read if the PLC is not silent.
    const fn poll(&self) -> Request {
        if self.image.is_some() { Request::Read } else { Request::None }
    }

    fn turn(&mut self, answers: &[Answer], request: Request) -> Kept {
        self.turn_with(answers, false, request)
    }

    /// Runs one turn of the bridge's main loop, and another a millisecond later if a FAST STOP was requested and not sent.
    fn turn_with(&mut self, answers: &[Answer], is_cut: bool, request: Request) -> Kept {
        self.turn_once(answers, is_cut, request)?;
        if self.promises.owes_fast_stop() {
            self.now_ms += 1;
            self.turn_once(&[], false, Request::None)?;
        }
        keep(Promise::FastStopLeavesAtOnce, !self.promises.owes_fast_stop())
    }

    fn turn_once(&mut self, answers: &[Answer], is_cut: bool, request: Request) -> Kept {
        let now = self.now();
        let mut bytes: Vec<u8> = answers.iter().flat_map(|answer| answer.bytes()).collect();
        if is_cut {
            bytes.pop();
        }
        let mut line = SerialLine::with_room(usize::MAX);
        line.deliver(&bytes);
        let mut bus = RtuDouble::default();
        match request {
            Request::None => {}
            Request::Read => bus.ask(&[UNIT, 3, 0, 0, 0, 1]),
            Request::Write(image) => bus.ask(&write_request(0, &registers_of(&image))),
        }
        self.outputs = self.bridge.poll(self.now_ms, self.wires, &mut line, &mut self.modbus.over(&mut bus));

        let intact = &answers[..answers.len() - usize::from(is_cut)];
        for answer in intact {
            self.log(|story| write!(story, "\n        <- {} {}", answer.id, answer.status));
        }
        self.promises.begin_turn(now, self.wires, |reports| {
            intact.iter().for_each(|answer| reports.receive(answer));
        });
        self.take_request(request);
        self.promises.end_inputs(Some(MAX_DELAY_MS));
        for message in messages(&mut FrameParser::<64>::new(), &line.take_sent()) {
            let command = message.command();
            self.log(|story| write!(story, "\n        -> {command}"));
            // A restarted gripper has lost its limit, and rejects GRIP.
            let force_limit = self.gripper.referenced().then_some(self.gripper.force_limit.cast_signed());
            self.promises.send(message.id, Some(&command), force_limit)?;
            if self.is_line_up {
                if message.id == CommandId::FastStop {
                    self.reach.receive_fast_stop(now);
                }
                self.gripper.take(&command, &mut |answer| queue(&mut self.answers, answer));
            }
        }
        let outputs = self.outputs;
        self.log(|story| write!(story, "\n           {outputs:?}"));
        if !outputs.contains(Outputs::LINK_OK) {
            // The bridge learns the gripper's state only when it is connected.
            self.reach.recover(now);
        }
        self.promises.end_turn(&self.bridge, outputs, &self.reach)
    }

    /// Passes the PLC's request of this turn on, or its silence.
    fn take_request(&mut self, request: Request) {
        let now = self.now();
        if let Request::Write(image) = request {
            self.promises.requests.take_image(image, None);
        }
        if !matches!(request, Request::None) {
            self.requested = Some(now);
        } else if self.requested.is_some_and(|requested| now.since(requested) >= BUS_TIMEOUT_MS) {
            (self.image, self.requested) = (None, None);
            let commands = self.bridge.control_source() == ControlSource::Bus;
            self.promises.requests.lose_bus(commands);
        }
    }
}

/// Queues a message to the bridge. Replies to a burst of FAST STOPs count as one. A message that does not fit is lost.
fn queue(answers: &mut VecDeque<(Answer, bool)>, answer: Answer) {
    let is_of_burst = answer.id == CommandId::FastStop && answers.back() == Some(&(answer, false));
    if !is_of_burst && answers.len() < MAX_ANSWERS {
        answers.push_back((answer, false));
    }
}

impl Model for Plant {
    type Promise = Promise;

    fn actions(&self) -> u32 {
        let waiting = self.answers.front();
        let mut possible = 0;
        for (number, action) in self.actions.iter().enumerate() {
            let is_possible = match action {
                Operation::Toggle(_) | Operation::ToggleLine | Operation::RestartBridge | Operation::Wait => {
                    true
                }
                Operation::Change { rising, falling } => self.wires & (*rising | *falling) == *falling,
                Operation::Write(image) => self.image != Some(*image),
                Operation::FallSilent => self.image.is_some(),
                Operation::AnswersAll | Operation::Answer | Operation::AnswerLost | Operation::AnswerCut => {
                    waiting.is_some()
                }
                Operation::AnswerTwice => waiting.is_some_and(|(_, is_repeated)| !is_repeated),
                Operation::AnswerWithNext => self.with_next.is_none() && waiting.is_some(),
                Operation::Gripper(event) => self.gripper.allows(*event),
                _ => false,
            };
            possible |= u32::from(is_possible) << number;
        }
        possible
    }

    fn act(&mut self, action: u32) -> Kept {
        self.take(&self.actions[action as usize])
    }

    fn key(&self) -> u64 {
        let Self { actions: _, bridge, modbus, gripper, now_ms, wires, outputs, is_line_up, .. } = self;
        let Self { answers, with_next, image, promises, reach, .. } = self;
        // Without a FAST STOP, it need not reach the gripper.
        let reach = promises.requests.stopped.map(|_| reach);
        let line = (is_line_up, answers, with_next, reach);
        key(*now_ms, &(bridge, modbus, gripper, wires, outputs, image, line, promises))
    }

    fn sights(&self) -> u64 {
        SIGHTS.iter().enumerate().fold(0, |seen, (bit, (_, is_met))| seen | u64::from(is_met(self)) << bit)
    }
}
