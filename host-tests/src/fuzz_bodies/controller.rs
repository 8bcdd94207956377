//! The register controller against a small model of edges and commands.

use wsg_fieldbus::{CommandFlags, Controller, OutputImage};
use wsg_protocol::session::{Event, Known, RequestError};
use wsg_protocol::{Command, CommandId, GripperState, Kind, Reply, Status, SystemFlags, Value};

use super::input::Input;
use crate::gripper_states::LIMITS;
use crate::promises::MOTIONS;

/// Lock on motions: after FAST STOP until an acknowledgement has succeeded. The gripper's flag also disappears when a
/// third party acknowledges the FAST STOP, or when the gripper restarts.
#[derive(Clone, Copy, PartialEq)]
enum Lock {
    Open,
    FastStopped,
    Answered,
    /// The gripper's flag has been seen since the answer.
    Latched,
    Acknowledged,
}

const JOG: CommandFlags = CommandFlags::JOG_PLUS.union(CommandFlags::JOG_MINUS);

struct Model {
    controller: Controller,
    known: Known,
    image: Option<OutputImage>,
    /// The motion requested by the last edge, until its command is sent.
    wanted: Option<CommandId>,
    /// The motion whose force limit is being set; an edge in the meantime is rejected without effect.
    prepared: Option<CommandId>,
    /// Whether STOP/ACK has risen since its last command.
    stop_risen: bool,
    lock: Lock,
    /// Whether both JOG flags have been 0, with neither STOP/ACK nor FASTSTOP set since.
    jog_counts: bool,
}

/// Each op is a byte with parameter bytes: an image, a gripper report, an outcome.
pub fn controller(data: &[u8]) {
    let mut input = Input::new(data);
    let mut model = Model {
        controller: Controller::new(),
        known: Known::NOTHING,
        image: None,
        wanted: None,
        prepared: None,
        stop_risen: false,
        lock: Lock::Open,
        jog_counts: false,
    };
    while !input.is_empty() {
        match input.byte() % 8 {
            0..=2 => model.write(&mut input),
            3 => model.event(&Event::Connected),
            4 => {
                model.known.limits = Some(LIMITS);
                model.known.flags = Some(SystemFlags::from_bits_retain(u32::from_le_bytes(input.array())));
                model.known.state = GripperState::from_code(input.byte());
            }
            5 => {
                let status = input.pick(&[
                    Status::Success,
                    Status::CmdFailed,
                    Status::AxisBlocked,
                    Status::CmdAborted,
                ]);
                let id = input.pick(CommandId::ALL);
                model.event(&Event::Answered(Reply::status_only(id, status)));
            }
            6 => {
                let id = input.pick(CommandId::ALL);
                let events = [
                    Event::Unanswered(id),
                    Event::Withdrawn(id),
                    Event::Pending(id),
                    Event::Disconnected,
                    Event::Reported(Value::GetSystemState(SystemFlags::REFERENCED)),
                ];
                model.event(&input.pick(&events));
            }
            _ => {
                let errors =
                    [RequestError::NotConnected, RequestError::MotionRunning, RequestError::QueueFull];
                let (id, error) = (input.pick(CommandId::ALL), input.pick(&errors));
                model.controller.refused(id, error, &model.known);
                model.fetch();
            }
        }
    }
}

impl Model {
    /// Writes an image in which only flags and a few parameters vary, so that edges are frequent.
    fn write(&mut self, input: &mut Input<'_>) {
        let (flags, parameters) = (CommandFlags::from_bits_retain(input.byte()), input.byte());
        let image = OutputImage {
            flags,
            user: parameters,
            width: i16::from(parameters & 1) * 10_00,
            speed: if parameters & 2 == 0 { 50_00 } else { 1 },
            force_limit: 40_00,
        };
        let before = self.image.replace(image);
        let rising = before.map_or(CommandFlags::empty(), |before| flags.difference(before.flags));
        let fast_stop = flags.contains(CommandFlags::FASTSTOP);
        let fast_stop_due = fast_stop && (before.is_none() || rising.contains(CommandFlags::FASTSTOP));
        self.stop_risen |= !fast_stop && rising.contains(CommandFlags::STOP_ACK);
        let locked = fast_stop || flags.contains(CommandFlags::STOP_ACK);
        let lowest = MOTIONS.iter().find(|(flag, _)| rising.contains(*flag) && !locked);
        if let Some((_, id)) = lowest {
            self.wanted = Some(*id);
        }

        if !flags.intersects(JOG) {
            self.jog_counts = true;
        } else if locked {
            self.jog_counts = false;
        }

        self.controller.set_output(&image, &self.known);

        if fast_stop_due {
            self.lock = Lock::FastStopped;
            assert_eq!(self.controller.poll_command(), Some(Command::FastStop), "FAST STOP is first");
            self.prepared = None;
        }
        self.fetch();
        self.shown();
    }

    fn event(&mut self, event: &Event<'_>) {
        let is_stopped = |flags: SystemFlags| flags.contains(SystemFlags::FAST_STOP);
        let seen = match event {
            Event::Connected => self.known.flags.map(is_stopped),
            Event::Reported(Value::GetSystemState(flags)) => Some(is_stopped(*flags)),
            _ => None,
        };
        let succeeded = match event {
            Event::Answered(reply) if reply.status() == Status::Success => Some(reply.id()),
            _ => None,
        };
        self.lock = match (self.lock, succeeded, seen) {
            (Lock::Acknowledged, Some(CommandId::Acknowledge), _) => Lock::Open,
            (Lock::FastStopped, Some(CommandId::FastStop), _) => Lock::Answered,
            (Lock::Answered, _, Some(true)) => Lock::Latched,
            (Lock::Latched | Lock::Acknowledged, _, Some(false)) => Lock::Open,
            (lock, ..) => lock,
        };
        self.controller.handle(event, &self.known);
        self.fetch();
        self.shown();
    }

    /// Fetches the controller's commands and checks them against the edges.
    fn fetch(&mut self) {
        let mut commands = 0;
        while let Some(command) = self.controller.poll_command() {
            commands += 1;
            assert!(commands < 8, "the number of commands is bounded");
            assert_eq!(command.check(), Ok(()), "{command:?}");
            let id = command.id();
            match id.kind() {
                Kind::Setting => {
                    assert_eq!(id, CommandId::SetForceLimit);
                    let grips = self.wanted == Some(CommandId::GripPart);
                    assert!(grips || self.jogs(), "only GRIP and JOG set the force limit");
                    self.prepared = if grips { self.wanted.take() } else { None };
                }
                Kind::Motion => {
                    // The motion in preparation may be void and a new edge effective. JOG is a level.
                    let (prepared, wanted) = (self.prepared.take(), self.wanted);
                    let jogs = id == CommandId::PrePosition && self.jogs();
                    assert!([prepared, wanted].contains(&Some(id)) || jogs, "{id} without its edge");
                    self.wanted = wanted.filter(|wanted| *wanted != id);
                    let flags = self.image.map_or(CommandFlags::empty(), |image| image.flags);
                    assert!(!flags.contains(CommandFlags::FASTSTOP), "a motion during FASTSTOP");
                    assert!(self.lock == Lock::Open, "a motion after FAST STOP");
                }
                Kind::Acknowledge => {
                    assert!(std::mem::take(&mut self.stop_risen), "an acknowledgement without STOP/ACK");
                    self.prepared = None;
                    if self.lock != Lock::Open {
                        self.lock = Lock::Acknowledged;
                    }
                }
                // Stops end any preparation.
                Kind::Stop => {
                    self.prepared = None;
                    if id == CommandId::FastStop {
                        self.lock = Lock::FastStopped;
                    }
                }
                // Checks whether the gripper reports the FAST STOP that it has confirmed.
                Kind::Query => {
                    assert_eq!(id, CommandId::GetSystemState);
                    assert!(self.lock == Lock::Answered, "an unexpected query");
                }
                kind => panic!("{id} ({kind:?}) is not a PLC command"),
            }
        }
    }

    /// Returns whether a JOG flag is set and effective.
    fn jogs(&self) -> bool {
        self.jog_counts && self.image.is_some_and(|image| image.flags.intersects(JOG))
    }

    /// Checks that the input image has at most one state and survives encoding.
    fn shown(&self) {
        let image = self.controller.input(&self.known);
        assert!(image.state.bits().count_ones() <= 1, "{image:?}");
        assert_eq!(wsg_fieldbus::InputImage::from_bytes(image.to_bytes()), image);
    }
}
