//! Causes of refused commands and FAST STOPs, which the status register and GSTATE do not show.

use wsg_protocol::command::CommandId;

/// The reason for an incident.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Cause {
    /// FAST STOP: FASTSTOP is 1.
    Flag,
    /// FAST STOP: WIDTH, SPEED or FORCELIMIT changed while the fingers moved. `value` is the new register value.
    ParameterChanged,
    /// FAST STOP: SPEED or FORCELIMIT is outside the gripper's limits, or the limits are unknown. `value` is the
    /// register value.
    OutsideLimits,
    /// FAST STOP: the PLC in control stopped communicating.
    PlcSilent,
    /// FAST STOP: a Stop failed while the fingers may have been moving. `value` is its status.
    StopFailed,
    /// FAST STOP: the connection was lost while a jog ran.
    ConnectionLost,
    /// The gripper was moving on first contact and was stopped.
    MovedAtStart,
    /// A command was refused because the gripper is not connected.
    NotConnected,
    /// A motion was refused during a FAST STOP, or STOP/ACK before the gripper confirmed it.
    FastStopLasts,
    /// A motion was refused because the fingers move.
    MotionRuns,
    /// A motion was refused because READY is low.
    NotReady,
    /// MOVE or a jog was refused while a part is held. Use RELEASE to open.
    PartHeld,
    /// MOVE was refused because GSTATE was neither IDLE nor HOLDING: no part was found, a part was lost, or an error occurred.
    NotIdle,
    /// The gripper refused the command or ended it with an error. `value` is its status.
    Gripper,
    /// The gripper did not answer. A motion may run, with unknown outcome.
    Unanswered,
    /// Another command overtook this one before it was sent.
    Withdrawn,
}

impl Cause {
    /// Returns whether the controller refused a command for this reason, so that the gripper never received it.
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

    /// Returns whether this cause led to a FAST STOP.
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

/// An error visible to the PLC, with its cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Incident {
    /// The reason, which also defines the meaning of `value`.
    pub cause: Cause,
    /// The command concerned, if any.
    pub command: Option<CommandId>,
    /// The value that the cause defines; 0 for other causes.
    pub value: u16,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_command_neither_reached_the_gripper_nor_stopped_it() {
        let refusals = [
            Cause::NotConnected,
            Cause::FastStopLasts,
            Cause::MotionRuns,
            Cause::NotReady,
            Cause::PartHeld,
            Cause::NotIdle,
        ];
        assert!(refusals.iter().all(|cause| cause.is_refusal() && !cause.is_fast_stop()));
        assert!(
            [Cause::Gripper, Cause::Unanswered, Cause::Withdrawn].iter().all(|cause| !cause.is_refusal())
        );
    }
}
