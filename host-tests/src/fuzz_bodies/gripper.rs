//! The gripper's end in the whole-bridge bodies: received commands, and a gripper that executes them and answers
//! late, twice or not at all.

use wsg_protocol::frame::{OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};
use wsg_protocol::{CommandId, GripperState, Instant, Status, SystemFlags};

use super::input::Input;
use crate::gripper_states::{Answer, GripperEvent, Message, States};
use crate::operation::{Behaviour, Delivery};
use crate::promises::Reach;

/// Start of every message.
pub(super) const PREAMBLE: [u8; PREAMBLE_LEN] = [PREAMBLE_BYTE; PREAMBLE_LEN];

/// Encodes a status-only answer.
pub(super) fn status(id: CommandId, status: Status) -> Vec<u8> {
    Answer::status(id, status).bytes().collect()
}

fn delivery(byte: &u8) -> Delivery {
    match byte {
        0..=200 => Delivery::Late((*byte).into()),
        201..=223 => Delivery::Twice(u32::from(byte - 200) * 9),
        224..=235 => Delivery::Unanswered,
        236..=239 => Delivery::Refused,
        _ => Delivery::Unheard(u32::from(byte - 240) * 68),
    }
}

/// Decodes a behaviour: whether the gripper answers (bit 0), the number of delivery bytes that follow (bits 1 to 3), its condition
/// (bits 4 to 6; 2 is a restart), and a disturbance (bit 7).
pub(super) fn behaviour(input: &mut Input<'_>) -> Behaviour {
    let how = input.byte();
    let deliveries = input.bytes(usize::from(how >> 1 & 7)).iter().map(delivery).collect();
    let (flags, has_part) = CONDITIONS[usize::from(how >> 4 & 7)];
    Behaviour { answers: how & 1 != 0, deliveries, flags, has_part, is_disturbed: how & 0x80 != 0 }
}

/// Time-out of the gripper for an incomplete frame, in milliseconds.
const FRAME_TIMEOUT_MS: u32 = 500;

/// Duration of a motion as a multiple of the answer's delay.
const MOTION_FACTOR: u32 = 4;

/// Further conditions: reported flags, and whether a part can be gripped.
const CONDITIONS: [(SystemFlags, bool); 8] = [
    (SystemFlags::REFERENCED, true),
    (SystemFlags::REFERENCED, false),
    (SystemFlags::empty(), true),
    (SystemFlags::REFERENCED.union(SystemFlags::TEMP_FAULT), true),
    (SystemFlags::REFERENCED.union(SystemFlags::POWER_FAULT), true),
    (SystemFlags::REFERENCED.union(SystemFlags::CURR_FAULT), true),
    (SystemFlags::REFERENCED.union(SystemFlags::FINGER_FAULT), true),
    (SystemFlags::REFERENCED.union(SystemFlags::FAST_STOP), true),
];

/// A gripper that executes its commands.
pub(super) struct Gripper {
    pub(super) reach: Reach,
    /// See [`Behaviour`].
    deliveries: Vec<Delivery>,
    delivered: usize,
    /// Answers and reports in transit, with their times of arrival.
    on_the_way: Vec<(u32, Answer)>,
    last_arrives_ms: u32,
    states: States,
    has_part: bool,
    /// End of the current motion.
    ends_ms: u32,
    /// Bytes still swallowed by a nonexistent frame, and the time of the last byte.
    deaf: (u32, u32),
    /// Whether it has lost its force limit and has neither been homed nor received a new one.
    is_restarted: bool,
}

impl Gripper {
    /// Creates a silent gripper that is referenced and at rest.
    pub(super) fn new() -> Self {
        let (flags, has_part) = CONDITIONS[0];
        Self {
            reach: Reach::new(false),
            deliveries: Vec::new(),
            delivered: 0,
            on_the_way: Vec::new(),
            last_arrives_ms: 0,
            states: States { flags, ..States::SWITCHED_ON },
            has_part,
            ends_ms: 0,
            deaf: (0, 0),
            is_restarted: false,
        }
    }

    /// Starts a motion that continues until it is stopped.
    pub(super) fn run(&mut self) {
        self.states.begin(CommandId::PrePosition);
        self.ends_ms = u32::MAX;
    }

    /// Answers all commands at once from now on.
    pub(super) fn answer(&mut self) {
        self.reach.is_alive = true;
        self.deliveries.clear();
    }

    /// Behaves differently from now on.
    pub(super) fn change(&mut self, now_ms: u32, behaviour: &Behaviour) {
        let Behaviour { answers, ref deliveries, flags, has_part, is_disturbed } = *behaviour;
        let was_alive = std::mem::replace(&mut self.reach.is_alive, answers);
        if self.reach.is_alive && !was_alive {
            self.reach.recover(Instant::from_millis(now_ms));
        }
        self.deliveries.clone_from(deliveries);
        self.delivered = 0;
        self.has_part = has_part;
        let states = &mut self.states;
        let was_fast_stopped = states.fast_stop();
        let (is_fast_stopped, is_restarted) = (flags.contains(SystemFlags::FAST_STOP), flags.is_empty());
        let is_acknowledged = is_fast_stopped && is_disturbed;
        let mut answers = vec![];
        let mut send = |answer: Answer| answers.push(answer);
        states.flags = flags | states.flags & SystemFlags::FAST_STOP;
        if is_restarted {
            states.happen(GripperEvent::Restarts, &mut send);
            self.on_the_way.clear();
            self.is_restarted = true;
        } else if is_acknowledged {
            states.happen(GripperEvent::ThirdPartyAcknowledges, &mut send);
        } else if states.fast_stop() {
            states.happen(GripperEvent::StopsFast, &mut send);
            self.reach.enter_fast_stop();
        }
        if (is_restarted || is_acknowledged) && was_fast_stopped {
            self.reach.leave_fast_stop(Instant::from_millis(now_ms));
        }
        if is_disturbed {
            if states.state == GripperState::Holding {
                states.happen(GripperEvent::LosesPart, &mut send);
            } else if states.motion.is_some() {
                states.happen(GripperEvent::ThirdPartyStops, &mut send);
            } else if !states.fast_stop() {
                let motions = [CommandId::PrePosition, CommandId::GripPart, CommandId::ReleasePart];
                let motion = motions[self.deliveries.len() % motions.len()];
                states.happen(GripperEvent::ThirdPartyBegins(motion), &mut send);
                self.ends_ms = now_ms + MOTION_FACTOR * 200;
            }
        }
        states.report(&mut send);
        self.send(now_ms, Delivery::Late(0), &answers);
    }

    pub(super) fn receive(&mut self, now_ms: u32, message: &Message) {
        let delivery = self.delivery();
        if !matches!(delivery, Delivery::Late(_)) || !self.reach.is_alive {
            self.fault(now_ms);
        }
        if !self.receives(now_ms, message, delivery) {
            return;
        }
        let id = message.id;
        if matches!(delivery, Delivery::Refused) {
            return self.send(now_ms, delivery, &[Answer::status(id, Status::AccessDenied)]);
        }
        match id {
            CommandId::SetForceLimit => self.is_restarted = false,
            CommandId::FastStop => self.reach.receive_fast_stop(Instant::from_millis(now_ms)),
            _ => {}
        }
        let (moved, mut answers) = (self.states.motion.is_some(), vec![]);
        self.states.take(&message.command(), &mut |answer| answers.push(answer));
        if !moved && self.states.motion.is_some() {
            self.ends_ms = now_ms
                + match self.delivery() {
                    Delivery::Late(ms) | Delivery::Twice(ms) => ms * MOTION_FACTOR,
                    // Until it is stopped.
                    Delivery::Unanswered | Delivery::Refused | Delivery::Unheard(_) => u32::MAX / 2,
                };
        }
        self.send(now_ms, delivery, &answers);
    }

    /// Records a fault of the line.
    pub(super) fn fault(&mut self, now_ms: u32) {
        self.reach.fault(Instant::from_millis(now_ms));
    }

    /// Records bytes that reach the bridge but are not from the gripper: noise, or a forged message.
    pub(super) fn forge(&mut self, now_ms: u32, bytes: &[u8]) {
        self.fault(now_ms);
        self.reach.is_forged |= bytes.windows(PREAMBLE.len()).any(|window| window == PREAMBLE);
    }

    /// Returns the force limit in hundredths if the bridge can know it. After a restart GRIP requires homing.
    pub(super) fn force_limit(&self) -> Option<i32> {
        (!self.reach.is_forged && !self.is_restarted).then_some(self.states.force_limit as i32)
    }

    fn receives(&mut self, now_ms: u32, message: &Message, delivery: Delivery) -> bool {
        let (left, last_ms) = std::mem::replace(&mut self.deaf, (0, now_ms));
        if !self.reach.is_alive {
            return false;
        }
        let length = (OVERHEAD + message.payload.len()) as u32;
        let left = if now_ms - last_ms >= FRAME_TIMEOUT_MS { 0 } else { left };
        self.deaf.0 = match delivery {
            _ if left > 0 => left.saturating_sub(length),
            Delivery::Unheard(bytes) => bytes,
            _ => 0,
        };
        left == 0 && !matches!(delivery, Delivery::Unheard(_))
    }

    /// Returns the messages that reach the bridge now.
    pub(super) fn transmit(&mut self, now_ms: u32) -> Vec<Vec<u8>> {
        if let Some(id) = self.states.motion.filter(|_| now_ms >= self.ends_ms) {
            let (finds_none, mut answers) = (id == CommandId::GripPart && !self.has_part, vec![]);
            let event = if finds_none { GripperEvent::Fails } else { GripperEvent::Finishes };
            self.is_restarted &= id != CommandId::Homing;
            self.states.happen(event, &mut |answer| answers.push(answer));
            let delivery = self.delivery();
            self.send(now_ms, delivery, &answers);
        }
        let mut arrived = Vec::new();
        self.on_the_way.retain(|(arrives_ms, answer)| {
            let is_there = now_ms >= *arrives_ms;
            if is_there {
                arrived.push(answer.bytes().collect());
            }
            !is_there
        });
        if self.reach.is_alive { arrived } else { vec![] }
    }

    fn delivery(&mut self) -> Delivery {
        let delivery = self.deliveries.get(self.delivered).or(self.deliveries.last());
        self.delivered += 1;
        delivery.copied().unwrap_or(Delivery::Late(0))
    }

    /// Queues answers; they never overtake each other.
    fn send(&mut self, now_ms: u32, delivery: Delivery, answers: &[Answer]) {
        let (first_ms, second_ms) = match delivery {
            Delivery::Late(ms) => (ms, None),
            Delivery::Refused => (0, None),
            Delivery::Twice(ms) => (0, Some(ms)),
            Delivery::Unanswered | Delivery::Unheard(_) => return,
        };
        for answer in answers {
            self.last_arrives_ms = self.last_arrives_ms.max(now_ms + first_ms);
            self.on_the_way.push((self.last_arrives_ms, *answer));
            self.on_the_way.extend(second_ms.map(|ms| (self.last_arrives_ms + ms, *answer)));
        }
    }
}
