//! Bridge, gripper, line and PLC: one state of the exploration, and the effect of each action.

use std::fmt::Write as _;

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::Modbus;
use wsg_bridge_fw::{Bridge, BusConfig, Config, ControlSource, WiresConfig};
use wsg_protocol::{CommandId, FrameParser, GripperState, Instant, session};

use super::action::{Action, Image};
use super::answers::Answers;
use super::key::key;
use super::promises::{Kept, Motion, Promise, Promises, keep};
use super::search::Model;
use crate::gripper_states::{Answer, States, messages};
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::SerialLine;
use crate::world::modbus::UNIT;

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
/// Rounds of request and reply that take no time; connecting takes seven.
const QUICK_ROUNDS: u32 = 20;
/// Duration of a round on a line at 115 200 bit/s, in milliseconds.
const ROUND_MS: u32 = 2;
/// Maximum number of rounds.
const MOST_ROUNDS: u32 = QUICK_ROUNDS + 500;

/// One state of the exploration.
#[derive(Clone, Debug)]
pub(super) struct Plant {
    actions: &'static [Action],
    bridge: Bridge,
    modbus: Modbus,
    gripper: States,
    now_ms: u32,
    wires: Inputs,
    outputs: Outputs,
    is_line_up: bool,
    /// Messages in transit to the bridge.
    answers: Answers,
    /// A message that arrives in the last turn of the next action.
    with_next: Option<Answer>,
    /// The last image that the PLC wrote over the bus; `None` while it is silent.
    image: Option<Image>,
    /// Whether FASTSTOP was set in the last image. A silent bus does not release it.
    bus_holds_fast_stop: bool,
    promises: Promises,
    /// Readable log, if enabled.
    story: Option<String>,
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
    ("a move", |plant| plant.own_motion() == Some(CommandId::PrePosition) && !plant.promises.jogs()),
    ("a grip", |plant| plant.own_motion() == Some(CommandId::GripPart)),
    ("a release", |plant| plant.own_motion() == Some(CommandId::ReleasePart)),
    ("a jog", |plant| plant.own_motion() == Some(CommandId::PrePosition) && plant.promises.jogs()),
    ("a motion of a third party", |plant| plant.motion().is_some() && plant.gripper.is_foreign),
    ("a lost part", |plant| plant.gripper.state == GripperState::PartLost),
    ("a latched FAST STOP", |plant| plant.gripper.fast_stop()),
    ("an unacknowledged FAST STOP", |plant| !plant.promises.is_open()),
    ("a motion unknown to the bridge", |plant| {
        plant.motion().is_some() && plant.outputs.contains(Outputs::READY)
    }),
];

impl Plant {
    /// Creates the state after power-up with all wires low.
    pub(super) fn switched_on(actions: &'static [Action]) -> Self {
        let mut plant = Self {
            actions,
            bridge: Bridge::new(CONFIG),
            modbus: Modbus::new(&CONFIG),
            gripper: States::SWITCHED_ON,
            now_ms: 0,
            wires: Inputs::empty(),
            outputs: Outputs::empty(),
            is_line_up: true,
            answers: Answers::NONE,
            with_next: None,
            image: None,
            bus_holds_fast_stop: false,
            promises: Promises::new(Instant::from_millis(0)),
            story: None,
        };
        // A promise broken here also breaks in the exploration, through `RestartBridge`.
        let _ = plant.power_up();
        plant
    }

    /// Returns the state after these actions, ignoring broken promises.
    pub(super) fn after(&self, actions: &[Action]) -> Self {
        let mut plant = self.clone();
        for action in actions {
            let _ = plant.take(*action);
        }
        plant
    }

    /// Returns a log of these actions.
    pub(super) fn report(&self, actions: impl IntoIterator<Item = u32>) -> String {
        let mut plant = Self { story: Some(String::new()), ..self.clone() };
        for action in actions {
            if let Err(promise) = plant.act(action) {
                plant.say(|story| write!(story, "\n        broken: {promise:?}"));
            }
        }
        plant.story.unwrap_or_default()
    }

    #[cfg(test)]
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

    /// Returns whether the PLC asserts FAST STOP by wire or bus.
    fn holds_fast_stop(&self) -> bool {
        !self.wires.contains(Inputs::FAST_STOP_OK) || self.bus_holds_fast_stop
    }

    fn say(&mut self, what: impl FnOnce(&mut String) -> std::fmt::Result) {
        if let Some(story) = &mut self.story {
            what(story).expect("writing to a string cannot fail");
        }
    }

    fn take(&mut self, action: Action) -> Kept {
        let ms = self.now_ms;
        self.say(|story| write!(story, "\n{ms:6} ms {action:?}"));
        match action {
            Action::Toggle(wire) => self.change_wires(wire.input()),
            Action::GripAndStop => self.change_wires(Inputs::GRIP | Inputs::STOP_ACK),
            Action::MoveAndFastStop => self.change_wires(Inputs::MOVE | Inputs::FAST_STOP_OK),
            Action::Write(image) => self.write(image),
            Action::FallSilent => self.fall_silent(),
            Action::AnswersAll => self.deliver_all(),
            Action::Answer => {
                let answer = self.answers.pop();
                self.deliver(answer)
            }
            Action::AnswerTwice => {
                let answer = self.answers.repeat();
                self.deliver(answer)
            }
            Action::AnswerLost => {
                self.answers.pop();
                Ok(())
            }
            Action::AnswerCut => {
                let mut bytes = self.bytes_with_next();
                bytes.extend(self.answers.pop().into_iter().flat_map(Answer::bytes));
                bytes.pop();
                self.turn(&bytes, silence())
            }
            Action::AnswerWithNext => {
                self.with_next = self.answers.pop();
                Ok(())
            }
            Action::Refuse => {
                self.gripper.refuses = true;
                Ok(())
            }
            Action::ToggleLine => {
                self.is_line_up = !self.is_line_up;
                self.answers = Answers::NONE;
                self.with_next = None;
                Ok(())
            }
            Action::Finish => self.change_gripper(|gripper, say| gripper.finish(true, say)),
            Action::Fail => self.change_gripper(|gripper, say| gripper.finish(false, say)),
            Action::LosePart => self.change_gripper(States::lose_part),
            Action::GripperStopsFast => self.change_gripper(States::raise_fast_stop),
            Action::ThirdPartyAcknowledges => {
                self.promises.leave_elsewhere(self.now());
                self.change_gripper(States::acknowledge)
            }
            Action::ThirdPartyStops => self.change_gripper(States::stop_for_third_party),
            Action::ThirdPartyMoves => self.third_party_begins(CommandId::PrePosition),
            Action::ThirdPartyGrips => self.third_party_begins(CommandId::GripPart),
            Action::ThirdPartyReleases => self.third_party_begins(CommandId::ReleasePart),
            Action::RestartGripper => {
                if self.gripper.fast_stop() {
                    self.promises.leave_elsewhere(self.now());
                }
                self.gripper = States::SWITCHED_ON;
                self.answers = Answers::NONE;
                Ok(())
            }
            Action::RestartBridge => {
                self.bridge = Bridge::new(CONFIG);
                self.modbus = Modbus::new(&CONFIG);
                self.with_next = None;
                self.image = None;
                self.bus_holds_fast_stop = false;
                self.promises.reset(self.now());
                self.power_up()
            }
            Action::Wait => self.wait(),
        }
    }

    /// Runs the first turns after power-up, until all wires have taken effect.
    fn power_up(&mut self) -> Kept {
        if self.wires.contains(Inputs::FAST_STOP_OK) {
            self.turn(&[], silence())?;
        } else {
            self.ask_for_fast_stop(silence(), &[])?;
        }
        self.settle(true)
    }

    /// Changes wires and lets them settle.
    fn change_wires(&mut self, changed: Inputs) -> Kept {
        self.wires.toggle(changed);
        let rising = self.wires & changed;
        let before = self.outputs;
        if (changed - rising).contains(Inputs::FAST_STOP_OK) {
            self.ask_for_fast_stop(silence(), &[])?;
        } else {
            self.turn(&[], silence())?;
        }
        let was_ready = (before & self.outputs).contains(Outputs::READY);
        let was_open = self.promises.is_open();
        let stops = rising.contains(Inputs::STOP_ACK);
        if stops {
            self.promises.stop();
        }
        let motion = self.motion_of(rising).filter(|_| !stops);
        match motion {
            Some(motion) if was_ready => {
                self.promises.want(motion);
                self.promises.expect_busy(self.now());
            }
            Some(_) => self.promises.refuse(),
            None => {}
        }
        // A message in the same turn may change the expected result.
        let judged = motion.filter(|_| self.with_next.is_none());
        self.settle(rising.contains(Inputs::FAST_STOP_OK))?;
        if stops && was_open && self.bridge.is_connected() {
            self.promises.expect_standstill(self.now(), &self.gripper);
        }
        judged.map_or(Ok(()), |motion| self.judge_command(motion, was_ready, before))
    }

    /// Checks that the command is accepted, or visibly rejected.
    fn judge_command(&self, motion: Motion, was_ready: bool, before: Outputs) -> Kept {
        let shows = |output| self.outputs.contains(output);
        if was_ready {
            keep(Promise::ReadyEdgeShowsBusy, shows(Outputs::BUSY))?;
            // MOVE is rejected unless GSTATE is IDLE. ERROR in IDLE also follows an earlier rejected command.
            let is_refused =
                motion == Motion::Move && before.intersects(Outputs::HOLDING | Outputs::PART_FAULT);
            let may_be_refused = motion == Motion::Move && before.contains(Outputs::ERROR);
            return if is_refused {
                keep(Promise::RefusedCommandShowsError, shows(Outputs::ERROR))
            } else {
                keep(Promise::ReadyCommandIsTaken, may_be_refused || !shows(Outputs::ERROR))
            };
        }
        // A command concurrent with STOP/ACK or FAST STOP is lost.
        let is_lost = self.wires & (Inputs::STOP_ACK | Inputs::FAST_STOP_OK) != Inputs::FAST_STOP_OK
            || self.image == Some(Image::StopAck);
        keep(Promise::RefusedCommandShowsError, is_lost || shows(Outputs::ERROR))
    }

    /// Lets changed wires settle.
    fn settle(&mut self, fast_stop_ok_rises: bool) -> Kept {
        self.now_ms += if fast_stop_ok_rises { FAST_STOP_RELEASE_MS } else { CONFIG.wires.debounce_ms };
        self.last_turn()?;
        self.promises.settled(self.wires, self.outputs)
    }

    /// Runs the turn in which FAST STOP is requested, and one more if it was not sent in the first.
    fn ask_for_fast_stop(&mut self, bus: RtuDouble, incoming: &[u8]) -> Kept {
        // A pending FAST STOP is repeated only after its reply or time-out.
        let is_pending = self.bridge.session().fast_stop_pending();
        let is_due = self.promises.fast_stop(self.now()) && !is_pending;
        self.turn(incoming, bus)?;
        if is_due && !self.promises.has_fast_stop_left() {
            self.now_ms += 1;
            self.turn(&[], silence())?;
            return keep(Promise::FastStopLeavesAtOnce, self.promises.has_fast_stop_left());
        }
        Ok(())
    }

    /// Returns the motion that takes precedence among the rising wires.
    fn motion_of(&self, rising: Inputs) -> Option<Motion> {
        if rising.contains(Inputs::MOVE) {
            Some(Motion::Move)
        } else if rising.contains(Inputs::GRIP) {
            Some(if self.wires.contains(Inputs::RECIPE1) { Motion::GripGently } else { Motion::Grip })
        } else if rising.contains(Inputs::RELEASE) {
            Some(Motion::Release)
        } else if rising.contains(Inputs::HOME) {
            Some(Motion::Home)
        } else {
            None
        }
    }

    fn write(&mut self, image: Image) -> Kept {
        let bytes = self.bytes_with_next();
        let now = self.now();
        let before = self.image.replace(image);
        self.bus_holds_fast_stop = image == Image::FastStop;
        if before == Some(Image::JogPlus) {
            self.promises.end_jog(now, &self.gripper);
        }
        if image == Image::FastStop {
            return self.ask_for_fast_stop(writing(image), &bytes);
        }
        // The first image raises no edge.
        let rises = before.is_some_and(|before| before.flags() != image.flags());
        let was_open = self.promises.is_open();
        let stops = rises && image == Image::StopAck;
        if stops {
            self.promises.stop();
        }
        let commands = Inputs::GRIP | Inputs::MOVE | Inputs::RELEASE | Inputs::HOME;
        let counts = rises && was_open && !self.wires.intersects(commands | Inputs::STOP_ACK);
        if let Some(motion) = image.motion().filter(|_| counts) {
            if self.outputs.contains(Outputs::READY) {
                self.promises.want(motion);
            } else {
                self.promises.may_want(motion);
            }
        }
        self.turn(&bytes, writing(image))?;
        if stops && was_open && self.bridge.is_connected() {
            self.promises.expect_standstill(now, &self.gripper);
        }
        Ok(())
    }

    fn fall_silent(&mut self) -> Kept {
        let end = self.now_ms + BUS_TIMEOUT_MS;
        while self.now_ms < end {
            self.now_ms += self.ms_to_deadline().min(end - self.now_ms);
            if self.now_ms == end {
                let commanded =
                    self.bridge.control_source() == ControlSource::Bus && self.bridge.is_connected();
                if self.image.take() == Some(Image::JogPlus) {
                    self.promises.end_jog(self.now(), &self.gripper);
                }
                if commanded {
                    self.promises.fall_silent(self.now(), &self.gripper);
                }
            }
            self.turn(&[], silence())?;
        }
        Ok(())
    }

    fn wait(&mut self) -> Kept {
        let begun = self.now_ms;
        let ms = self.ms_to_deadline();
        for early in TURNS_MS.into_iter().filter(|early| *early < ms) {
            self.now_ms = begun + early;
            self.turn(&[], self.polling())?;
        }
        self.now_ms = begun + ms;
        self.last_turn()
    }

    fn ms_to_deadline(&self) -> u32 {
        let deadline = self.bridge.session().poll_timeout();
        deadline.map_or(LONGEST_WAIT_MS, |deadline| deadline.since(self.now())).clamp(1, LONGEST_WAIT_MS)
    }

    fn change_gripper(&mut self, change: impl FnOnce(&mut States, &mut dyn FnMut(Answer))) -> Kept {
        change(&mut self.gripper, &mut |answer| self.answers.push(answer));
        if !self.is_line_up {
            self.answers = Answers::NONE;
        }
        Ok(())
    }

    fn third_party_begins(&mut self, id: CommandId) -> Kept {
        // The PLC's motion has ended.
        self.promises.stand();
        self.change_gripper(|gripper, say| gripper.begin_for_third_party(id, say))
    }

    fn deliver_all(&mut self) -> Kept {
        for round in 0..MOST_ROUNDS {
            if round >= QUICK_ROUNDS {
                self.now_ms += ROUND_MS;
            }
            let mut bytes = self.bytes_with_next();
            while let Some(answer) = self.answers.pop() {
                bytes.extend(self.bytes_of(answer));
            }
            self.turn(&bytes, silence())?;
            if self.answers.waiting().is_empty() {
                let knows = self.is_line_up && self.bridge.is_connected();
                let is_pending = !knows || self.bridge.session().fast_stop_pending();
                return self.promises.delivered(&self.gripper, is_pending);
            }
        }
        Err(Promise::ConversationEnds)
    }

    fn deliver(&mut self, answer: Option<Answer>) -> Kept {
        let mut bytes = self.bytes_with_next();
        bytes.extend(answer.into_iter().flat_map(|answer| self.bytes_of(answer)));
        self.turn(&bytes, silence())
    }

    fn bytes_with_next(&mut self) -> Vec<u8> {
        self.with_next.take().into_iter().flat_map(|answer| self.bytes_of(answer)).collect()
    }

    /// Encodes a message that arrives intact in this turn.
    fn bytes_of(&mut self, answer: Answer) -> impl Iterator<Item = u8> + use<> {
        self.promises.receive(self.now(), &answer);
        self.say(|story| write!(story, "\n        <- {} {}", answer.id, answer.status));
        answer.bytes()
    }

    /// Runs the last turn of an action.
    fn last_turn(&mut self) -> Kept {
        let bytes = self.bytes_with_next();
        self.turn(&bytes, self.polling())
    }

    /// Returns a bus on which the PLC reads if it is not silent.
    fn polling(&self) -> RtuDouble {
        if self.image.is_some() { reading() } else { silence() }
    }

    /// Runs one turn of the bridge's main loop.
    fn turn(&mut self, incoming: &[u8], mut bus: RtuDouble) -> Kept {
        let now = self.now();
        let mut line = SerialLine::with_room(usize::MAX);
        line.deliver(incoming);
        self.promises.begin_turn(self.holds_fast_stop());
        self.outputs = self.bridge.poll(self.now_ms, self.wires, &mut line, &mut self.modbus.over(&mut bus));
        for message in messages(&mut FrameParser::new(), &line.take_sent()) {
            let command = message.command();
            self.say(|story| write!(story, "\n        -> {command}"));
            self.promises.leave(now, &command, &self.gripper, self.is_line_up)?;
            if self.is_line_up {
                self.gripper.take(&command, &mut |answer| self.answers.push(answer));
            }
        }
        let outputs = self.outputs;
        self.say(|story| write!(story, "\n           {outputs:?}"));
        self.promises.end_turn(now, outputs, &self.gripper)?;
        let motion_is_open = self.bridge.motion_is_open();
        self.promises.shows_state(&self.bridge.input_image(), motion_is_open)
    }
}

/// Returns a bus without requests.
fn silence() -> RtuDouble {
    RtuDouble::default()
}

/// Returns a bus on which the PLC writes registers 0 to 3.
fn writing(image: Image) -> RtuDouble {
    asking(&[&[UNIT, 16, 0, 0, 0, 4, 8], &image.output().to_bytes()[..]].concat())
}

/// Returns a bus on which the PLC reads a register.
fn reading() -> RtuDouble {
    asking(&[UNIT, 3, 0, 0, 0, 1])
}

fn asking(request: &[u8]) -> RtuDouble {
    let mut bus = RtuDouble::default();
    bus.ask(request);
    bus
}

impl Model for Plant {
    type Promise = Promise;

    fn actions(&self) -> u32 {
        let waiting = self.answers.waiting();
        let mut possible = 0;
        for (number, action) in self.actions.iter().enumerate() {
            let is_possible = match action {
                Action::Toggle(_)
                | Action::ToggleLine
                | Action::RestartGripper
                | Action::RestartBridge
                | Action::Wait => true,
                Action::GripAndStop => !self.wires.intersects(Inputs::GRIP | Inputs::STOP_ACK),
                Action::MoveAndFastStop => {
                    self.wires & (Inputs::MOVE | Inputs::FAST_STOP_OK) == Inputs::FAST_STOP_OK
                }
                Action::Write(image) => self.image != Some(*image),
                Action::FallSilent => self.image.is_some(),
                Action::AnswersAll | Action::Answer | Action::AnswerLost | Action::AnswerCut => {
                    !waiting.is_empty()
                }
                Action::AnswerTwice => waiting.first().is_some_and(|(_, is_repeated)| !is_repeated),
                Action::AnswerWithNext => self.with_next.is_none() && !waiting.is_empty(),
                Action::Refuse => {
                    let States { refuses, motion, .. } = self.gripper;
                    !refuses && !self.gripper.fast_stop() && motion.is_none()
                }
                Action::Finish | Action::Fail | Action::GripperStopsFast => self.motion().is_some(),
                Action::ThirdPartyAcknowledges => self.gripper.fast_stop(),
                Action::ThirdPartyStops => {
                    !self.gripper.fast_stop()
                        && (self.motion().is_some() || self.gripper.state == GripperState::Holding)
                }
                Action::ThirdPartyMoves | Action::ThirdPartyGrips | Action::ThirdPartyReleases => {
                    self.motion().is_none() && !self.gripper.fast_stop() && self.gripper.referenced()
                }
                Action::LosePart => self.gripper.state == GripperState::Holding,
            };
            possible |= u32::from(is_possible) << number;
        }
        possible
    }

    fn act(&mut self, action: u32) -> Kept {
        self.take(self.actions[action as usize])
    }

    fn key(&self) -> u64 {
        let Self { actions: _, bridge, modbus, gripper, now_ms, wires, outputs, is_line_up, .. } = self;
        let Self { answers, with_next, image, promises, story: _, .. } = self;
        key(
            *now_ms,
            &(bridge, modbus, gripper, wires, outputs, is_line_up, answers, with_next, image, promises),
        )
    }

    fn sights(&self) -> u64 {
        SIGHTS.iter().enumerate().fold(0, |seen, (bit, (_, is_met))| seen | u64::from(is_met(self)) << bit)
    }
}
