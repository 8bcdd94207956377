//! Events on the wires, the bus and the gripper's line, and in gripper and bridge.

use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{CommandFlags, OutputImage};

/// One event. All except [`Wait`](Self::Wait) and [`FallSilent`](Self::FallSilent) take no time, so simultaneous
/// events are tried in every order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// A wire changes and settles.
    Toggle(Wire),
    /// GRIP and STOP_ACK rise in the same reading.
    GripAndStop,
    /// MOVE rises and FAST_STOP_OK falls in the same reading.
    MoveAndFastStop,
    /// The PLC writes an image over the bus.
    Write(Image),
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
    /// The gripper rejects the next motion or setting.
    Refuse,
    /// The line is cut or restored. Messages in transit are lost.
    ToggleLine,
    Finish,
    /// The motion fails or finds no part.
    Fail,
    /// The gripped part is lost.
    LosePart,
    /// The gripper enters FAST STOP without a command, as at a soft limit.
    GripperStopsFast,
    /// A third party, such as the gripper's web page, acknowledges FAST STOP.
    ThirdPartyAcknowledges,
    /// A third party stops a motion, or the monitoring of a held part.
    ThirdPartyStops,
    /// A third party starts a motion.
    ThirdPartyMoves,
    ThirdPartyGrips,
    ThirdPartyReleases,
    /// The gripper is power-cycled.
    RestartGripper,
    /// The bridge is reset.
    RestartBridge,
    /// Time passes until the session's next deadline.
    Wait,
}

/// A wire from the PLC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wire {
    Grip,
    Move,
    Release,
    Home,
    StopAck,
    FastStopOk,
    /// RECIPE1: low for recipe 0 with 40 N, high for recipe 2 with 10 N.
    Recipe,
}

/// An output image with one flag, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Image {
    Zero,
    Move,
    /// With 40 N.
    Grip,
    /// With 10 N.
    GripGently,
    JogPlus,
    StopAck,
    FastStop,
}

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
            Refuse,
            ToggleLine,
            Finish,
            Fail,
            LosePart,
            GripperStopsFast,
            ThirdPartyAcknowledges,
            ThirdPartyStops,
            ThirdPartyMoves,
            ThirdPartyGrips,
            ThirdPartyReleases,
            RestartGripper,
            RestartBridge,
            Wait,
        ]
    }};
}

/// Actions with a PLC on wires.
pub(super) const WIRES: [Action; 29] = with_common![
    Toggle(Wire::Grip),
    Toggle(Wire::Move),
    Toggle(Wire::Release),
    Toggle(Wire::Home),
    Toggle(Wire::StopAck),
    Toggle(Wire::FastStopOk),
    Toggle(Wire::Recipe),
    GripAndStop,
    MoveAndFastStop,
];

/// Actions with a PLC on a bus and three wires.
pub(super) const BUS: [Action; 31] = with_common![
    Write(Image::Zero),
    Write(Image::Move),
    Write(Image::Grip),
    Write(Image::GripGently),
    Write(Image::JogPlus),
    Write(Image::StopAck),
    Write(Image::FastStop),
    FallSilent,
    Toggle(Wire::Grip),
    Toggle(Wire::StopAck),
    Toggle(Wire::FastStopOk),
];

impl Wire {
    pub(super) const fn input(self) -> Inputs {
        match self {
            Self::Grip => Inputs::GRIP,
            Self::Move => Inputs::MOVE,
            Self::Release => Inputs::RELEASE,
            Self::Home => Inputs::HOME,
            Self::StopAck => Inputs::STOP_ACK,
            Self::FastStopOk => Inputs::FAST_STOP_OK,
            Self::Recipe => Inputs::RECIPE1,
        }
    }
}

impl Image {
    pub(super) const fn flags(self) -> CommandFlags {
        match self {
            Self::Zero => CommandFlags::empty(),
            Self::Move => CommandFlags::MOVE,
            Self::Grip | Self::GripGently => CommandFlags::GRIP,
            Self::JogPlus => CommandFlags::JOG_PLUS,
            Self::StopAck => CommandFlags::STOP_ACK,
            Self::FastStop => CommandFlags::FASTSTOP,
        }
    }

    pub(super) const fn output(self) -> OutputImage {
        let force_limit = if matches!(self, Self::GripGently) { 10_00 } else { 40_00 };
        OutputImage { flags: self.flags(), user: 0, width: 30_00, speed: 50_00, force_limit }
    }
}
