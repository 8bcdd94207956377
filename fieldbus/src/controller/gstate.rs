//! GSTATE while no motion of the PLC runs (fieldbus, 5.1.2 and appendix C).

use crate::GripperFlags;
use wsg_protocol::types::GripperState;

/// The source of GSTATE between the PLC's motions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Gstate {
    /// The gripper's last report.
    Reported,
    /// The same, from before the PLC's last motion: none has followed.
    Awaited,
    /// The state that the last result implies, until the gripper reports one.
    Result(GripperState),
    /// ERROR, because the PLC's last motion failed, until the gripper reports a state that this motion does not explain.
    Failed {
        /// The last reported state, which the gripper repeats; `None` if no state is known.
        last: Option<GripperState>,
        /// The outcome of the motion is unknown, and the gripper has not reported fingers at rest since.
        may_run: bool,
    },
    /// IDLE after a jog that failed (fieldbus, 6.7), although the gripper reports ERROR, until it reports another state.
    FailedJog,
}

impl Gstate {
    /// Returns ERROR after a motion that the gripper refused or ended, or that was never sent.
    pub(super) const fn failed(last: Option<GripperState>) -> Self {
        Self::Failed { last, may_run: false }
    }

    /// Returns ERROR after a motion whose outcome is unknown.
    pub(super) const fn unknown(last: Option<GripperState>) -> Self {
        Self::Failed { last, may_run: true }
    }

    /// Takes a state that the gripper reports.
    pub(super) fn report(&mut self, state: GripperState) {
        *self = match *self {
            Self::FailedJog if state == GripperState::Error => return,
            // The motion itself.
            Self::Failed { may_run: true, .. } if state.is_motion() => return,
            // The state from before the motion, or its end, which does not reveal the outcome.
            Self::Failed { last, may_run }
                if !state.is_motion()
                    && (last.is_none_or(|last| last == state)
                        || (may_run && state == GripperState::Idle)) =>
            {
                Self::failed(Some(state))
            }
            _ => Self::Reported,
        };
    }

    /// Takes the confirmation of a Stop or an acknowledgement, which does not undo a later failure. It ends a motion of unknown
    /// outcome, so that a motion reported later is another one.
    pub(super) const fn stand(&mut self) {
        match self {
            Self::Reported | Self::Awaited | Self::Result(_) => *self = Self::Result(GripperState::Idle),
            Self::Failed { may_run: true, .. } => *self = Self::failed(Some(GripperState::Idle)),
            Self::Failed { may_run: false, .. } | Self::FailedJog => {}
        }
    }

    /// Ends ERROR, for the PLC's next command.
    pub(super) const fn end_failure(&mut self) {
        if self.is_failed() {
            *self = Self::Reported;
        }
    }

    /// Ends the state implied by a result, which a lost connection makes obsolete.
    pub(super) const fn end_result(&mut self) {
        if matches!(self, Self::Result(_)) {
            *self = Self::Reported;
        }
    }

    pub(super) const fn is_failed(&self) -> bool {
        matches!(self, Self::Failed { .. })
    }

    /// Returns the state that replaces the reported one.
    pub(super) const fn implied(&self) -> Option<GripperState> {
        match self {
            Self::Result(state) => Some(*state),
            Self::FailedJog => Some(GripperState::Idle),
            Self::Reported | Self::Awaited | Self::Failed { .. } => None,
        }
    }

    /// Returns GSTATE for the state that the gripper reported last. No bit is set before its first report.
    pub(super) fn shown(&self, reported: Option<GripperState>) -> GripperFlags {
        // A held part matters more than a failed command, which the status register shows.
        if self.is_failed() && reported != Some(GripperState::Holding) {
            return GripperFlags::ERROR;
        }
        self.implied().or(reported).map_or(GripperFlags::empty(), GripperFlags::from)
    }
}
