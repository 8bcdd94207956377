//! Why a command came to nothing, or a FAST STOP was asked for: what the status register and GSTATE do not tell.

use wsg_protocol::command::CommandId;

/// The reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Cause {
    /// FAST STOP: FASTSTOP is 1.
    Flag,
    /// FAST STOP: WIDTH, SPEED or FORCELIMIT changed while the fingers moved. The value is the new one.
    ParameterChanged,
    /// FAST STOP: SPEED or FORCELIMIT is outside the gripper's limits, or these are not known. The value is that of the register.
    OutsideLimits,
    /// FAST STOP: the PLC that commanded is silent.
    PlcSilent,
    /// FAST STOP: a Stop was not carried out while the fingers were not known to stand. The value is its status.
    StopFailed,
    /// FAST STOP: the connection was lost while a jog ran.
    ConnectionLost,
    /// The gripper moved when it was heard first: it was stopped.
    MovedAtStart,
    /// A command came while the gripper did not answer.
    NotConnected,
    /// A motion came while FAST STOP lasts, or STOP/ACK before the gripper has confirmed it.
    FastStopLasts,
    /// A motion came while the fingers move.
    MotionRuns,
    /// A motion came while READY was low.
    NotReady,
    /// MOVE or a jog came while a part is held: RELEASE is the way to open.
    PartHeld,
    /// MOVE came while GSTATE was neither IDLE nor HOLDING: no part was found, one was lost, or there was an error.
    NotIdle,
    /// The gripper refused the command or ended it with an error. The value is its status.
    Gripper,
    /// The gripper did not answer, be it to a motion that may run: nobody knows its outcome.
    Unanswered,
    /// Something overtook the command before it left.
    Withdrawn,
}

impl Cause {
    /// Whether the controller refused a command for this reason, so that the gripper never received it.
    #[must_use]
    pub const fn is_refusal(self) -> bool {
        matches!(
            self,
            Self::NotConnected
                | Self::FastStopLasts
                | Self::MotionRuns
                | Self::NotReady
                | Self::PartHeld
                | Self::NotIdle
        )
    }

    /// Whether a FAST STOP came of it.
    #[must_use]
    pub const fn is_fast_stop(self) -> bool {
        matches!(
            self,
            Self::Flag
                | Self::ParameterChanged
                | Self::OutsideLimits
                | Self::PlcSilent
                | Self::StopFailed
                | Self::ConnectionLost
        )
    }
}

/// Something that a PLC sees as an error, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Incident {
    /// Why.
    pub cause: Cause,
    /// The command concerned, if one is.
    pub command: Option<CommandId>,
    /// What the cause says that it is; 0 otherwise.
    pub value: u16,
}
