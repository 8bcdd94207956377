//! Events on the wires, the bus and the gripper's line, and in gripper and bridge.

use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::CommandId;

use crate::gripper_states::GripperEvent;

/// One event. All except [`Wait`](Self::Wait) and [`FallSilent`](Self::FallSilent) take no time, so simultaneous
/// events are tried in every order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// A wire changes and settles.
    Toggle(Inputs),
    /// Low wires rise and high ones fall in the same reading.
    Change { rising: Inputs, falling: Inputs },
    /// The PLC writes an image over the bus.
    Write(OutputImage),
    /// The PLC stops polling over the bus until the bridge detects it.
    FallSilent,
    /// The line delivers all messages, including replies to further commands, until both sides are silent.
    AnswersAll,
    /// The line delivers the next message.
    Answer,
    /// The line delivers the next message and keeps it for a second delivery.
    AnswerTwice,
    /// The line loses the next message.
    AnswerLost,
    /// The line loses the last byte of the next message.
    AnswerCut,
    /// The line delivers the next message in the same turn as the next event.
    AnswerWithNext,
    /// The line is cut or restored. Messages in transit are lost.
    ToggleLine,
    /// An event in the gripper.
    Gripper(GripperEvent),
    /// The bridge is reset.
    RestartBridge,
    /// Time passes until the session's next deadline.
    Wait,
}

/// Returns an image with these flags, 30 mm, 50 mm/s, and this force limit in hundredths of a newton.
pub(super) const fn image(flags: CommandFlags, force_limit: i16) -> OutputImage {
    OutputImage { flags, user: 0, width: 30_00, speed: 50_00, force_limit }
}

/// Images with the usual force limit: no flag, and two that start a motion.
pub(super) const ZERO: OutputImage = image(CommandFlags::empty(), 40_00);
pub(super) const MOVE: OutputImage = image(CommandFlags::MOVE, 40_00);
pub(super) const JOG_PLUS: OutputImage = image(CommandFlags::JOG_PLUS, 40_00);

/// Appends the actions of line, gripper and bridge to the actions of a PLC.
macro_rules! with_common {
    ($($action:expr),+ $(,)?) => {{
        use Action::*;
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

/// Actions with a PLC on wires. RECIPE1 is low for recipe 0 with 40 N, and high for recipe 2 with 10 N.
pub(super) const WIRES: [Action; 29] = with_common![
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

/// Actions with a PLC on a bus and three wires.
pub(super) const BUS: [Action; 31] = with_common![
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
