//! The operations that an exploration tries.

use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::CommandId;

use crate::operation::{self, GripperEvent, Operation};

/// Returns an image with these flags, 30 mm, 50 mm/s, and this force limit in hundredths of a newton.
pub(super) const fn image(flags: CommandFlags, force_limit: u16) -> OutputImage {
    operation::image(flags, [30_00, 50_00, force_limit])
}

/// Images with the usual force limit: no flag, and two that start a motion.
pub(super) const ZERO: OutputImage = image(CommandFlags::empty(), 40_00);
pub(super) const MOVE: OutputImage = image(CommandFlags::MOVE, 40_00);
pub(super) const JOG_PLUS: OutputImage = image(CommandFlags::JOG_PLUS, 40_00);

/// Appends the operations of line, gripper and bridge to the operations of a PLC. All except [`Wait`](Operation::Wait) and
/// [`FallSilent`](Operation::FallSilent) take no time, so simultaneous events are tried in every order.
macro_rules! with_common {
    ($($action:expr),+ $(,)?) => {{
        use Operation::*;
        [
            $($action,)+
            AnswersAll,
            Answer,
            AnswerTwice,
            AnswerLost,
            AnswerCut,
            AnswerWithNext,
            Gripper(GripperEvent::RefusesNext),
            ToggleLine,
            Gripper(GripperEvent::Finishes),
            Gripper(GripperEvent::Fails),
            Gripper(GripperEvent::LosesPart),
            Gripper(GripperEvent::StopsFast),
            Gripper(GripperEvent::ThirdPartyAcknowledges),
            Gripper(GripperEvent::ThirdPartyStops),
            Gripper(GripperEvent::ThirdPartyBegins(CommandId::PrePosition)),
            Gripper(GripperEvent::ThirdPartyBegins(CommandId::GripPart)),
            Gripper(GripperEvent::ThirdPartyBegins(CommandId::ReleasePart)),
            Gripper(GripperEvent::Restarts),
            RestartBridge,
            Wait,
        ]
    }};
}

/// Operations with a PLC on wires. RECIPE1 is low for recipe 0 with 40 N, and high for recipe 2 with 10 N.
pub(super) static WIRES: [Operation; 29] = with_common![
    Toggle(Inputs::GRIP),
    Toggle(Inputs::MOVE),
    Toggle(Inputs::RELEASE),
    Toggle(Inputs::HOME),
    Toggle(Inputs::STOP_ACK),
    Toggle(Inputs::FAST_STOP_OK),
    Toggle(Inputs::RECIPE1),
    Change { rising: Inputs::GRIP.union(Inputs::STOP_ACK), falling: Inputs::empty() },
    Change { rising: Inputs::MOVE, falling: Inputs::FAST_STOP_OK },
];

/// Operations with a PLC on a bus and three wires.
pub(super) static BUS: [Operation; 31] = with_common![
    Write(ZERO),
    Write(MOVE),
    Write(image(CommandFlags::GRIP, 40_00)),
    Write(image(CommandFlags::GRIP, 10_00)),
    Write(JOG_PLUS),
    Write(image(CommandFlags::STOP_ACK, 40_00)),
    Write(image(CommandFlags::FASTSTOP, 40_00)),
    FallSilent,
    Toggle(Inputs::GRIP),
    Toggle(Inputs::STOP_ACK),
    Toggle(Inputs::FAST_STOP_OK),
];
