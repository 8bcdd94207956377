//! What the bodies of the whole bridge share: wires, the gripper's end, the oracle, and the loop that plays a case.
//!
//! A body adds the bridge, its PLC's bus, and what the oracle needs to know of the bus.

use wsg_bridge_fw::Config;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_fieldbus::CommandFlags;
use wsg_protocol::{CommandId, Status};

use super::gripper::{self, Gripper};
use super::input::Input;
use super::oracle::Oracle;
use super::tap::Tap;
use crate::serial_gripper::SerialLine;

const MOTION_WIRES: [Inputs; 4] = [Inputs::GRIP, Inputs::RELEASE, Inputs::MOVE, Inputs::HOME];

/// Flags that a PLC writes: one motion, a jog, a stop, several at once.
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

/// WIDTH, SPEED and FORCELIMIT: two that a gripper takes, and one that it does not.
pub(super) const PARAMETERS: [[u16; 3]; 3] =
    [[20_00, 50_00, 40_00], [50_00, 100_00, 40_00], [20_00, 1, 40_00]];

/// What a bridge shows whose gripper takes commands.
const READY: Outputs = Outputs::READY.union(Outputs::REFERENCED).union(Outputs::LINK_OK);

/// And one that refuses the stored settings.
const REFUSED: Outputs = READY.difference(Outputs::READY).union(Outputs::ERROR);

/// Everything around the bridge but its PLC's bus.
pub(super) struct Ends {
    pub(super) now_ms: u32,
    pub(super) wires: Inputs,
    pub(super) gripper: Gripper,
    /// The line of a gripper on RS-232.
    pub(super) line: Tap<SerialLine>,
    pub(super) oracle: Oracle,
    /// What comes next cannot be followed.
    pub(super) is_over: bool,
}

impl Ends {
    /// Power-up of a bridge with these settings, on a line that takes `per_ms` bytes in a millisecond, or any number.
    pub(super) fn new(config: &Config, per_ms: Option<usize>) -> Self {
        Self {
            now_ms: 0,
            wires: Inputs::empty(),
            gripper: Gripper::new(),
            line: Tap::new(SerialLine::with_room(usize::MAX), per_ms),
            oracle: Oracle::new(config),
            is_over: false,
        }
    }

    /// Passes to the oracle what the bridge read from the line in this turn, and the wires.
    pub(super) fn begin_turn(&mut self) {
        let heard = self.line.take_heard();
        self.oracle.begin_turn(self.now_ms, &heard, self.wires);
    }

    /// Ends a turn with these outputs: the gripper hears what the bridge sent, and answers.
    pub(super) fn end_turn(&mut self, outputs: Outputs, patience_ms: u32) {
        let Self { now_ms, gripper, line, oracle, .. } = self;
        oracle.begin_leaving(Some(patience_ms));
        for id in line.take_begun() {
            oracle.leaves(id, None, gripper);
        }
        for message in line.take_messages() {
            if !line.is_slow() {
                oracle.leaves(message.id, Some(&message.command()), gripper);
            }
            gripper.hear(*now_ms, &message);
        }
        oracle.end_turn(outputs, gripper);
        for answer in gripper.speak(*now_ms) {
            line.link.bring(&answer);
        }
    }
}

/// A bridge with its lines and a PLC.
pub(super) trait WholeBridge {
    /// How long the bridge takes to connect, in milliseconds.
    const CONNECTS_MS: u32 = 12;

    fn ends(&mut self) -> &mut Ends;

    /// Lets the PLC on the bus write zeros, after whatever must precede that. STOP_ACK is high meanwhile.
    fn write_zeros(&mut self);

    /// Executes an op that belongs to this body alone.
    fn take(&mut self, op: u8, input: &mut Input<'_>);

    /// One turn of the main loop, a millisecond after the one before.
    fn turn(&mut self);

    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            if self.ends().is_over {
                return;
            }
            self.turn();
        }
    }

    /// Returns whether a millisecond passes after this op.
    fn passes_after(&self, op: u8) -> bool {
        op & 0x80 == 0
    }

    /// Brings bytes of the gripper to the bridge.
    fn bring(&mut self, bytes: &[u8]) {
        self.ends().line.link.bring(bytes);
    }

    /// Brings bytes to the bridge that the gripper never sent.
    fn forge(&mut self, bytes: &[u8]) {
        let Ends { now_ms, gripper, .. } = self.ends();
        gripper.forge(*now_ms, bytes);
        self.bring(bytes);
    }

    /// Brings an answer to the bridge that the gripper never sent.
    fn forge_status(&mut self, input: &mut Input<'_>) {
        let statuses = [Status::Success, Status::CmdPending, Status::CmdFailed, Status::AccessDenied];
        let status = input.pick(&statuses);
        self.forge(&gripper::status(input.pick(CommandId::ALL), status));
    }

    /// Reaches the state before most interesting ones: connected, FAST STOP acknowledged, zeros written over the bus.
    fn get_ready(&mut self) {
        self.ends().gripper.answer();
        self.ends().wires = Inputs::FAST_STOP_OK;
        self.pass(Self::CONNECTS_MS);
        self.ends().wires = Inputs::FAST_STOP_OK | Inputs::STOP_ACK;
        self.write_zeros();
        self.ends().wires = Inputs::FAST_STOP_OK;
        self.pass(4);
        let Oracle { asked, shown, .. } = &self.ends().oracle;
        assert_eq!(shown.outputs, if asked.refuses { REFUSED } else { READY });
    }

    /// Plays a case. The first byte says whether the bridge is ready (bit 0) and whether the fingers move at power-up (bit 4).
    fn play(&mut self, choice: u8, input: &mut Input<'_>) {
        if choice & 16 != 0 {
            self.ends().gripper.run();
        }
        if choice & 1 != 0 {
            self.get_ready();
        }
        while !input.is_empty() && !self.ends().is_over {
            let op = input.byte();
            match op % 16 {
                0 | 1 => self.ends().wires = Inputs::from_bits_retain(input.byte()),
                2 => self.ends().wires = input.pick(&MOTION_WIRES) | Inputs::FAST_STOP_OK,
                6 => {
                    let Ends { now_ms, gripper, .. } = self.ends();
                    gripper.change(*now_ms, input);
                }
                7 => self.pass(u32::from(input.byte() % 32)),
                15 => self.pass(u32::from(input.byte())),
                _ => self.take(op, input),
            }
            if self.passes_after(op) {
                self.pass(1);
            }
        }
        self.pass(10);
    }
}
