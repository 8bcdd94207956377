//! The promises of the bridge, judged on the station of the web page, turn by turn.

use embedded_io::Write;
use wsg_bridge_fw::io::Outputs;
use wsg_bridge_fw::{Config, ControlSource};
use wsg_fieldbus::SilenceReaction;
use wsg_protocol::{CommandId, Instant, SystemFlags};
use wsg_web::station::{Action, Session, Station, Turn};

use crate::fuzz_bodies::tap::Tap;
use crate::promises::{Kept, Promises, Reach};
use crate::serial_gripper::SerialLine;

/// Maximum wait of a frame for the previous one: the bytes of the send queue, and a turn, in milliseconds.
const MAX_DELAY_MS: u32 = 5;

/// Everything that a session has shown.
#[derive(Debug)]
pub struct Seen {
    /// Outputs that were high.
    pub outputs: Outputs,
    /// Commands to the gripper.
    pub sent: Vec<CommandId>,
}

struct Judge {
    promises: Promises,
    reach: Reach,
    /// Parses the bytes of the bridge.
    tap: Tap<SerialLine>,
    was_connected: bool,
    /// Time of the PLC's last activity on the bus; `None` while it is inactive.
    received_ms: Option<u32>,
    next_frame: u32,
    /// Whether the gripper has lost its force limit.
    is_restarted: bool,
    seen: Seen,
}

/// Plays a session and checks the promises of the bridge.
///
/// # Panics
/// Panics when a promise is broken.
#[must_use]
pub fn judge(session: &Session) -> Seen {
    let mut station = Station::default();
    let mut judge = Judge::new(0, Reach::new(true));
    for &(at_us, action) in session.actions.iter().chain([&(session.end_us, Action::Part(0))]) {
        while station.next_turn_us() <= at_us {
            let turn = station.turn();
            let (now_ms, settings) = (turn.now_ms, *turn.settings);
            if let Err(promise) = judge.check(&turn) {
                let link = session.link();
                panic!("{promise:?} is broken at {now_ms} ms in {link:?}: {:#?}", judge.promises);
            }
            judge.configure(&Config::from_record(&settings).expect("the bridge has accepted it"));
        }
        station.run(at_us);
        let is_fast_stopped = station.gripper().flags.contains(SystemFlags::FAST_STOP);
        judge.prepare((at_us / 1_000) as u32, action, is_fast_stopped);
        station.act(action);
        if action == Action::RestartBridge {
            let Seen { outputs, sent } = &judge.seen;
            let seen = Seen { outputs: *outputs, sent: sent.clone() };
            let (next_frame, is_restarted) = (judge.next_frame, judge.is_restarted);
            judge =
                Judge { seen, next_frame, is_restarted, ..Judge::new((at_us / 1_000) as u32, judge.reach) };
            judge.configure(&Config::from_record(station.settings()).expect("the bridge has accepted it"));
        }
    }
    judge.seen
}

impl Judge {
    fn new(now_ms: u32, reach: Reach) -> Self {
        Self {
            promises: Promises::new(Instant::from_millis(now_ms), &Config::DEFAULT),
            reach,
            tap: Tap::new(SerialLine::with_room(usize::MAX), Some(usize::MAX)),
            was_connected: false,
            received_ms: None,
            next_frame: 0,
            is_restarted: false,
            seen: Seen { outputs: Outputs::empty(), sent: Vec::new() },
        }
    }

    fn configure(&mut self, config: &Config) {
        let Promises { requests, levels, .. } = &mut self.promises;
        requests.debounce_ms = config.wires.debounce_ms;
        requests.recipes = config.recipes;
        levels.min_busy_ms = config.wires.min_busy_ms;
    }

    /// Records the effect of an action on the line and on the gripper.
    fn prepare(&mut self, now_ms: u32, action: Action, is_fast_stopped: bool) {
        let now = Instant::from_millis(now_ms);
        match action {
            Action::Cut(is_cut) => {
                if !is_cut && !self.reach.is_alive {
                    self.reach.recover(now);
                }
                self.reach.is_alive = !is_cut;
            }
            Action::Damage(_) | Action::RestartBridge => self.reach.fault(now),
            Action::RestartGripper => {
                self.reach.fault(now);
                self.is_restarted = true;
                if is_fast_stopped {
                    self.reach.leave_fast_stop(now);
                }
            }
            _ => {}
        }
    }

    fn check(&mut self, turn: &Turn<'_>) -> Kept {
        let now = Instant::from_millis(turn.now_ms);
        for frame in turn.frames.iter().filter(|frame| frame.number >= self.next_frame) {
            if frame.is_damaged || frame.is_lost {
                self.reach.fault(now);
            } else if frame.to_gripper && frame.text.starts_with("23h") {
                self.reach.receive_fast_stop(now);
            }
        }
        self.next_frame = turn.frames.back().map_or(0, |frame| frame.number + 1);
        let config = Config::from_record(turn.settings).expect("the bridge has accepted it");
        let Self { promises, tap, .. } = self;
        promises.begin_turn(now, turn.inputs, |reports| reports.read(turn.read));
        if let Some(image) = turn.image {
            promises
                .requests
                .take_image(image, config.bus_recipe.map(|number| config.recipes[usize::from(number)]));
        }
        let timeout_ms = config.bus.timeout_ms.into();
        if turn.has_answered {
            self.received_ms = Some(turn.now_ms);
        } else if timeout_ms > 0 && self.received_ms.is_some_and(|since| turn.now_ms - since >= timeout_ms) {
            self.received_ms = None;
            let commands = turn.bridge.control_source() == ControlSource::Bus;
            promises.requests.lose_bus(commands && config.bus.reaction == SilenceReaction::Stop);
        }
        if std::mem::replace(&mut self.was_connected, turn.bridge.is_connected()) && !self.was_connected {
            tap.cut();
        }
        promises.end_inputs(Some(MAX_DELAY_MS));
        tap.turn().write_all(turn.written).expect("the line has room");
        let (begun, messages) = (tap.take_begun(), tap.take_messages());
        for id in begun {
            let command = messages.iter().find(|message| message.id == id).map(|message| message.command());
            let force_limit =
                (!self.is_restarted).then_some((turn.gripper.force_limit * 100.0).round() as i32);
            promises.send(id, command.as_ref(), force_limit)?;
            self.is_restarted &= !matches!(id, CommandId::SetForceLimit | CommandId::Homing);
            if !self.seen.sent.contains(&id) {
                self.seen.sent.push(id);
            }
        }
        self.seen.outputs |= turn.outputs;
        promises.end_turn(turn.bridge, turn.outputs, &self.reach)
    }
}
