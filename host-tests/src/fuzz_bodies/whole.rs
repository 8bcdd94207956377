//! Common parts of the whole-bridge bodies: wires, the gripper's end, the promises, and the loop that plays a script.
//!
//! Each body adds the bridge, its PLC bus, and what the bus requests.

use std::thread;

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Bridge, Config};
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::{CommandId, Instant, Status};

use super::frames::repair_checksums;
use super::gripper::{self, Gripper};
use super::input::Input;
use super::tap::Tap;
use crate::gripper_states::Message;
use crate::operation::{Operation, image, script};
use crate::promises::{Kept, Promises};
use crate::serial_gripper::SerialLine;
use crate::world::IDLE;

const MOTION_WIRES: [Inputs; 4] = [Inputs::GRIP, Inputs::RELEASE, Inputs::MOVE, Inputs::HOME];

/// Flags from a PLC: single motions, jogs, stops, and combinations.
pub(super) const FLAGS: [CommandFlags; 12] = [
    CommandFlags::empty(),
    CommandFlags::MOVE,
    CommandFlags::GRIP,
    CommandFlags::RELEASE,
    CommandFlags::HOMING,
    CommandFlags::STOP_ACK,
    CommandFlags::FASTSTOP,
    CommandFlags::JOG_PLUS,
    CommandFlags::JOG_MINUS,
    CommandFlags::MOVE.union(CommandFlags::GRIP),
    CommandFlags::GRIP.union(CommandFlags::STOP_ACK),
    CommandFlags::all(),
];

/// WIDTH, SPEED and FORCELIMIT: two valid sets and one that the gripper rejects.
pub(super) const PARAMETERS: [[u16; 3]; 3] =
    [[20_00, 50_00, 40_00], [50_00, 100_00, 40_00], [20_00, 1, 40_00]];

/// Decodes an image.
pub(super) fn pick_image(input: &mut Input<'_>) -> OutputImage {
    let flags = input.pick(&FLAGS);
    image(flags, input.pick(&PARAMETERS))
}

/// Decodes an edge as a PLC writes it: an image without flags, and one with flags.
pub(super) fn pick_edge(input: &mut Input<'_>) -> [OutputImage; 2] {
    let parameters = input.pick(&PARAMETERS);
    [CommandFlags::empty(), input.pick(&FLAGS)].map(|flags| image(flags, parameters))
}

/// Decodes noise on the gripper's line, whose checksums may be `repaired`.
pub(super) fn pick_noise(input: &mut Input<'_>, repaired: bool) -> Operation {
    let mut bytes = input.fewer_than(40).to_vec();
    if repaired {
        repair_checksums(&mut bytes);
    }
    Operation::Forge(bytes)
}

/// Decodes characters on a bus, each after one of these silences.
pub(super) fn pick_characters(input: &mut Input<'_>, silences: &[u32]) -> Vec<(Option<u8>, u32)> {
    let count = input.byte() % 24;
    let mut pick = || (if input.byte() == 0xFF { None } else { Some(input.byte()) }, input.pick(silences));
    (0..count).map(|_| pick()).collect()
}

/// Decodes a forged answer.
pub(super) fn pick_answer(input: &mut Input<'_>) -> Operation {
    let statuses = [Status::Success, Status::CmdPending, Status::CmdFailed, Status::AccessDenied];
    let status = input.pick(&statuses);
    Operation::Forge(gripper::status(input.pick(CommandId::ALL), status))
}

/// Outputs of a bridge that rejects the stored settings.
const REFUSED: Outputs = IDLE.difference(Outputs::READY).union(Outputs::ERROR);

/// Everything around the bridge except the PLC bus.
pub(super) struct Ends {
    pub(super) now_ms: u32,
    pub(super) wires: Inputs,
    pub(super) gripper: Gripper,
    /// The line of a gripper on RS-232.
    pub(super) line: Tap<SerialLine>,
    pub(super) promises: Promises,
    /// Whether further effects cannot be tracked.
    pub(super) is_over: bool,
}

impl Ends {
    /// Creates the state at power-up with these settings; `per_ms` limits the line's bytes per millisecond.
    pub(super) fn new(config: &Config, per_ms: Option<usize>) -> Self {
        Self {
            now_ms: 0,
            wires: Inputs::empty(),
            gripper: Gripper::new(),
            line: Tap::new(SerialLine::with_room(usize::MAX), per_ms),
            promises: Promises::new(Instant::from_millis(0), config),
            is_over: false,
        }
    }

    /// Passes on the bytes that the bridge has `received` in this turn, and the wires.
    pub(super) fn begin_turn(&mut self, received: &[u8]) {
        let now = Instant::from_millis(self.now_ms);
        self.promises.begin_turn(now, self.wires, |reports| reports.read(received));
    }

    /// Ends a turn of this bridge with these outputs: delivers its commands to the gripper, and the gripper's answers.
    /// `max_delay_ms` is `None` without a line.
    pub(super) fn end_turn(&mut self, bridge: &Bridge, outputs: Outputs, max_delay_ms: Option<u32>) {
        self.promises.end_inputs(max_delay_ms);
        for id in self.line.take_begun() {
            self.send(id, None);
        }
        for message in self.line.take_messages() {
            if !self.line.is_slow() {
                self.send(message.id, Some(&message));
            }
            self.gripper.receive(self.now_ms, &message);
        }
        self.judge(bridge, outputs);
        for answer in self.gripper.transmit(self.now_ms) {
            self.line.link.deliver(&answer);
        }
    }

    /// Checks a command to the gripper; only its id may be known.
    pub(super) fn send(&mut self, id: CommandId, message: Option<&Message>) {
        let command = message.map(Message::command);
        let kept = self.promises.send(id, command.as_ref(), self.gripper.force_limit());
        self.check(kept);
    }

    /// Checks the outputs at the end of a turn.
    pub(super) fn judge(&mut self, bridge: &Bridge, outputs: Outputs) {
        let kept = self.promises.end_turn(bridge, outputs, &self.gripper.reach);
        self.check(kept);
    }

    fn check(&self, kept: Kept) {
        if let Err(promise) = kept {
            panic!("{promise:?} is broken: {:#?}", self.promises);
        }
    }
}

/// A bridge with its lines and a PLC.
pub(super) trait WholeBridge: Sized {
    /// Name of the body.
    const NAME: &'static str;

    /// Time until the bridge is connected, in milliseconds.
    const CONNECTS_MS: u32 = 12;

    /// Creates the state at power-up that the first byte of an input selects.
    fn start(choice: u8) -> Self;

    fn ends(&mut self) -> &mut Ends;

    /// Writes zeros as the PLC on the bus, with any required preparation. STOP_ACK is high meanwhile.
    fn write_zeros(&mut self);

    /// Appends the operations of an op specific to this body.
    fn decode(op: u8, input: &mut Input<'_>, script: &mut Vec<Operation>);

    /// Executes an operation specific to this body.
    fn execute(&mut self, operation: &Operation);

    /// Runs one turn of the main loop, a millisecond after the previous one.
    fn turn(&mut self);

    /// Ends a case.
    fn end(self) {}

    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            if self.ends().is_over {
                return;
            }
            self.turn();
        }
    }

    /// Returns whether a millisecond passes after this op.
    fn passes_after(op: u8) -> bool {
        op & 0x80 == 0
    }

    /// Delivers bytes from the gripper to the bridge.
    fn deliver(&mut self, bytes: &[u8]) {
        self.ends().line.link.deliver(bytes);
    }

    /// Establishes the usual initial state: connected, FAST STOP acknowledged, zeros written over the bus.
    fn get_ready(&mut self) {
        self.ends().gripper.answer();
        self.ends().wires = Inputs::FAST_STOP_OK;
        self.pass(Self::CONNECTS_MS);
        self.ends().wires = Inputs::FAST_STOP_OK | Inputs::STOP_ACK;
        self.write_zeros();
        self.ends().wires = Inputs::FAST_STOP_OK;
        self.pass(4);
        let Promises { requests, levels, .. } = &self.ends().promises;
        assert_eq!(levels.outputs, if requests.refuses { REFUSED } else { IDLE });
    }
}

/// Decodes an input and plays it.
pub(super) fn run<B: WholeBridge>(data: &[u8]) {
    let (choice, script) = decode::<B>(data);
    play::<B>(choice, &script);
}

/// Decodes an input: the byte that selects the start, and the script.
pub(super) fn decode<B: WholeBridge>(data: &[u8]) -> (u8, Vec<Operation>) {
    let mut input = Input::new(data);
    let choice = input.byte();
    let mut script = Vec::new();
    while !input.is_empty() {
        let op = input.byte();
        match op % 16 {
            0 | 1 => script.push(Operation::Wires(Inputs::from_bits_retain(input.byte()))),
            2 => script.push(Operation::Wires(input.pick(&MOTION_WIRES) | Inputs::FAST_STOP_OK)),
            6 => script.push(Operation::Behave(gripper::behaviour(&mut input))),
            7 => script.push(Operation::Pass(u32::from(input.byte() % 32))),
            15 => script.push(Operation::Pass(input.byte().into())),
            _ => B::decode(op, &mut input, &mut script),
        }
        if B::passes_after(op) {
            script.push(Operation::Pass(1));
        }
    }
    script.dedup_by(|next, last| match (next, last) {
        (Operation::Pass(more), Operation::Pass(ms)) => {
            *ms += *more;
            true
        }
        _ => false,
    });
    (choice, script)
}

/// Plays a script. `choice` selects a ready bridge (bit 0) and moving fingers at power-up (bit 4).
pub(super) fn play<B: WholeBridge>(choice: u8, script: &[Operation]) {
    let played = Played { body: B::NAME, choice, script };
    let mut model = B::start(choice);
    if choice & 16 != 0 {
        model.ends().gripper.run();
    }
    if choice & 1 != 0 {
        model.get_ready();
    }
    for operation in played.script {
        if model.ends().is_over {
            break;
        }
        match operation {
            Operation::Pass(ms) => model.pass(*ms),
            Operation::Wires(levels) => model.ends().wires = *levels,
            Operation::Behave(behaviour) => {
                let Ends { now_ms, gripper, .. } = model.ends();
                gripper.change(*now_ms, behaviour);
            }
            Operation::Forge(bytes) => {
                let Ends { now_ms, gripper, .. } = model.ends();
                gripper.forge(*now_ms, bytes);
                model.deliver(bytes);
            }
            _ => model.execute(operation),
        }
    }
    model.pass(10);
    model.end();
}

/// Panics at an operation of another body.
pub(super) fn cannot(operation: &Operation) -> ! {
    panic!("this body does not execute {operation:?}")
}

/// Prints its script as a test when a body panics.
struct Played<'a> {
    body: &'static str,
    choice: u8,
    script: &'a [Operation],
}

impl Drop for Played<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            let Self { body, choice, script: operations } = self;
            eprintln!("play(\"{body}\", {choice:#04X}, &[\n{}]);", script(*operations));
        }
    }
}
