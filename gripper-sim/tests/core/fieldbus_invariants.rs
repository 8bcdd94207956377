//! Random images from one or two masters, commands of another client, parts, faults, connections and pauses, after which these rules of the
//! fieldbus manual must hold.

use crate::fieldbus::Plc;
use proptest::prelude::*;
use wsg_fieldbus::{CommandFlags, GripperFlags, OutputImage};
use wsg_protocol::{Command, GripperState, PrePositionFlags, Status, SystemFlags};
use wsg_sim::{Config, Fault, Part, PortKind};

#[derive(Clone, Copy, Debug)]
enum Op {
    /// Changes the image and writes it.
    Write {
        flags: CommandFlags,
        parameters: Option<(i16, u16, i16)>,
    },
    /// Writes only the two jog flags.
    Jog(u8),
    SetPart(Option<f32>),
    SetFault(Fault, bool),
    Wait {
        millis: u16,
    },
    /// Disconnects the master and connects another one.
    Reconnect,
    /// Another client commands the gripper.
    Other(Command<'static>),
}

const OTHERS: [Command<'static>; 6] = [
    Command::Stop,
    Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width: 30.0, speed: 100.0 },
    Command::GripPart { width: 20.0, speed: 100.0 },
    Command::ReleasePart { width: 60.0, speed: 100.0 },
    Command::FastStop,
    Command::ACKNOWLEDGE,
];

fn op() -> impl Strategy<Value = Op> {
    let flags = prop_oneof![
        6 => (0u8..6).prop_map(|bit| CommandFlags::from_bits_retain(1 << bit)),
        2 => any::<u8>().prop_map(CommandFlags::from_bits_retain),
        4 => Just(CommandFlags::empty()),
    ];
    let parameters = (
        prop_oneof![Just(20_00i16), Just(60_00), Just(0), any::<i16>()],
        prop_oneof![6 => Just(100_00u16), 1 => Just(0), 1 => any::<u16>()],
        prop_oneof![6 => Just(40_00i16), 1 => any::<i16>()],
    );
    let faults = prop_oneof![Just(Fault::AxisBlocked), Just(Fault::MotorCurrent)];
    prop_oneof![
        10 => (flags, proptest::option::weighted(0.3, parameters))
            .prop_map(|(flags, parameters)| Op::Write { flags, parameters }),
        3 => (0u8..4).prop_map(Op::Jog),
        2 => proptest::option::of(5f32..70.0).prop_map(Op::SetPart),
        1 => (faults, any::<bool>()).prop_map(|(fault, on)| Op::SetFault(fault, on)),
        8 => (0u16..1_500).prop_map(|millis| Op::Wait { millis }),
        1 => Just(Op::Reconnect),
        4 => proptest::sample::select(OTHERS.to_vec()).prop_map(Op::Other),
    ]
}

/// A PLC that homes, writes random images and checks the rules after each.
struct Trial {
    plc: Plc,
    /// The last motion is that of another client.
    others_move: bool,
}

impl Trial {
    fn new() -> Self {
        // With valid parameters, most sequences cause motion.
        let mut plc = Plc::new(Config::default());
        plc.raise(CommandFlags::HOMING);
        plc.wait(4_000);
        Self { plc, others_move: false }
    }

    fn moves(&self) -> bool {
        let state = self.plc.gripper.state();
        state.gripper.is_motion() || state.flags.contains(SystemFlags::MOVING)
    }

    fn step(&mut self, op: Op) {
        let before = (self.moves(), self.plc.image, self.plc.gripper.state().gripper);
        match op {
            Op::Write { flags, parameters } => {
                let jog = CommandFlags::JOG_PLUS | CommandFlags::JOG_MINUS;
                self.plc.image.flags = flags.difference(jog) | self.plc.image.flags.intersection(jog);
                if let Some((width, speed, force_limit)) = parameters {
                    self.plc.image = OutputImage { width, speed, force_limit, ..self.plc.image };
                }
                self.plc.write();
            }
            Op::Jog(both) => {
                self.plc.image.flags =
                    CommandFlags::from_bits_retain(self.plc.image.flags.bits() & 0x3F | both << 6);
                self.plc.write();
            }
            Op::SetPart(width) => self.plc.gripper.set_part(width.and_then(Part::of_width), self.plc.now),
            Op::SetFault(fault, on) => self.plc.gripper.set_fault(fault, on, self.plc.now),
            Op::Wait { millis } => self.plc.wait(millis.into()),
            Op::Reconnect => {
                self.plc.gripper.disconnect(self.plc.port, self.plc.now);
                self.plc.port = self.plc.gripper.connect(PortKind::ModbusTcp).unwrap();
            }
            Op::Other(command) => {
                let begins = self.plc.gripper.command(&command, self.plc.now) == Status::CmdPending;
                self.others_move = begins || (self.others_move && self.moves());
            }
        }
        self.check(op, before);
    }

    fn check(&mut self, op: Op, (moved, image, gripper): (bool, OutputImage, GripperState)) {
        let shown = self.plc.read();
        self.others_move &= self.moves();
        let flags = self.plc.image.flags;
        let rising = flags.difference(image.flags);
        assert_eq!(shown.state.bits().count_ones(), 1, "{shown:?}");
        // No motion without a command: a motion starts with a write, on an edge or with a jog.
        if self.moves() && !moved {
            let asked = CommandFlags::from_bits_retain(0x0F);
            let jogs = flags.bits() >> 6 == 1 || flags.bits() >> 6 == 2;
            assert!(self.others_move || matches!(op, Op::Write { .. } | Op::Jog(_)), "{op:?} {shown:?}");
            assert!(self.others_move || rising.intersects(asked) || jogs, "{op:?} {shown:?}");
        }
        if flags.intersects(CommandFlags::STOP_ACK | CommandFlags::FASTSTOP) {
            assert!(!self.moves() || self.others_move, "{op:?} {shown:?}");
        }
        // Only this controller jogs, so both flags, or neither, mean no jog.
        if shown.state == GripperFlags::RELEASING
            && matches!(op, Op::Jog(0 | 3))
            && !moved
            && !self.others_move
        {
            panic!("{op:?} {shown:?}");
        }
        let fast_stopped = shown.system.contains(SystemFlags::FAST_STOP);
        if flags.contains(CommandFlags::FASTSTOP) || shown.system.contains(SystemFlags::CURR_FAULT) {
            assert!(fast_stopped, "{op:?} {shown:?}");
        }
        if fast_stopped {
            assert_eq!((shown.state, self.moves()), (GripperFlags::IDLE, false), "{op:?}");
        }
        // GSTATE follows every change of 41h while no command of the PLC runs. A jog ends in IDLE, even if it fails.
        let now = self.plc.gripper.state().gripper;
        if now != gripper && !fast_stopped && shown.status != Status::CmdPending {
            let is_failed_jog = (shown.state, now) == (GripperFlags::IDLE, GripperState::Error);
            assert!(shown.state == now.into() || is_failed_jog, "{op:?} {now:?} {shown:?}");
        }
        if moved && image.parameters_differ(&self.plc.image) && image.flags.bits() >> 6 == 0 {
            assert!(fast_stopped, "a parameter changed while the fingers moved: {op:?} {shown:?}");
        }
        if shown.status == Status::CmdPending {
            assert!(self.moves(), "{op:?} {shown:?}");
        }
        if shown.state == GripperFlags::HOLDING {
            assert!(self.plc.gripper.state().force > 0.0);
        }
        let force_limit = self.plc.gripper.state().force_limit;
        assert!((5.0..=80.0).contains(&force_limit), "{force_limit} N");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn rules_hold_for_arbitrary_writes_of_masters(ops in proptest::collection::vec(op(), 1..80)) {
        let mut trial = Trial::new();
        for op in ops {
            trial.step(op);
        }
        // Every motion must end.
        trial.plc.wait(60_000);
        prop_assert!(!trial.moves());
    }
}
