//! The rule of GSTATE (fieldbus, 5.1.2 and appendix C).
//!
//! While no command of the PLC runs, GSTATE is the state that the gripper reported last, whoever caused it. The only
//! exception is ERROR after a motion of the PLC that failed, until the gripper reports another state.

use wsg_fieldbus::{GripperFlags, InputImage};
use wsg_protocol::{CommandId, GripperState, Kind, Status, SystemFlags};

/// The last reports, and the reason why GSTATE may differ from them.
#[derive(Clone, Debug)]
pub(super) struct GstateRule {
    /// The state reported last; `None` while it is unknown.
    reported: Option<GripperState>,
    /// No state was reported since the PLC's last command ended.
    is_outdated: bool,
    excuse: Excuse,
    /// The status register at the end of the last turn, and GSTATE.
    status: Status,
    state: GripperFlags,
    /// A command of the PLC was running then.
    is_pending: bool,
    /// The gripper has answered the running motion with E_CMD_ABORTED.
    is_aborted: bool,
    /// A jog failed, and the gripper has not reported another state than ERROR since.
    is_failed_jog: bool,
}

/// Why GSTATE may be ERROR.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Excuse {
    None,
    /// The PLC's motion failed while the gripper reported this state; `None` if it reported none.
    Failed(Option<GripperState>),
    /// The same for a motion that may still run. Its own reports do not count.
    Unknown(Option<GripperState>),
}

impl std::hash::Hash for GstateRule {
    /// Ignores what the bridge stores as well.
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (self.is_outdated, self.excuse, self.is_aborted).hash(state);
    }
}

impl GstateRule {
    pub(super) const fn new() -> Self {
        Self {
            reported: None,
            is_outdated: true,
            excuse: Excuse::None,
            status: Status::Success,
            state: GripperFlags::empty(),
            is_pending: false,
            is_aborted: false,
            is_failed_jog: false,
        }
    }

    /// Takes the loss of the connection, after which the state is unknown.
    pub(super) const fn disconnect(&mut self) {
        (self.reported, self.is_outdated, self.is_aborted) = (None, true, false);
    }

    /// Takes a state that the gripper reports.
    pub(super) fn report(&mut self, state: GripperState) {
        if !self.is_pending {
            self.excuse = self.excuse.after(state);
        }
        self.is_failed_jog &= state == GripperState::Error;
        (self.reported, self.is_outdated) = (Some(state), false);
    }

    /// Takes an answer without a value.
    pub(super) fn answer(&mut self, id: CommandId, status: Status) {
        self.is_aborted |= self.is_pending && id.kind() == Kind::Motion && status == Status::CmdAborted;
        // The status register may show a refused motion instead of these ends.
        self.is_outdated |= match (id, status) {
            (CommandId::Stop, Status::Success) => true,
            // It leaves no other state (command set, appendix C).
            (CommandId::Acknowledge, Status::Success) => self.reported == Some(GripperState::Error),
            _ => false,
        };
        // STOP/ACK may rise in the same turn. Only a jog shows a Pre-position as RELEASING.
        self.is_failed_jog |= self.is_pending
            && self.state == GripperFlags::RELEASING
            && id == CommandId::PrePosition
            && !matches!(status, Status::Success | Status::CmdPending);
    }

    /// Returns whether the image at the end of a turn keeps the rule. `motion_is_open` is whether a motion of
    /// the PLC has no result yet.
    pub(super) fn is_kept(&mut self, image: &InputImage, motion_is_open: bool) -> bool {
        let is_pending = match image.status {
            Status::CmdPending => true,
            // While a flag of a motion refused in the meantime is 1.
            Status::AlreadyRunning => self.is_pending || motion_is_open,
            _ => motion_is_open,
        };
        if image.status != self.status || (self.is_pending && !is_pending) {
            self.excuse = match image.status {
                Status::Success | Status::CmdPending | Status::CmdFailed => Excuse::None,
                Status::CmdAborted if self.is_aborted => Excuse::None,
                // Withdrawn, or found moving at power-up, which refused settings or a motion that was refused then hide.
                Status::CmdAborted | Status::Timeout | Status::AlreadyRunning | Status::InconsistentData => {
                    Excuse::Unknown(self.reported)
                }
                // The connection was lost during the motion.
                Status::IoError if self.is_pending => Excuse::Unknown(self.reported),
                // Refused at once, while the outcome of an earlier motion is unknown.
                _ if !self.is_pending && matches!(self.excuse, Excuse::Unknown(_)) => self.excuse,
                // The session refused it, or the gripper did.
                _ => Excuse::Failed(self.reported),
            };
            if !matches!(image.status, Status::Success | Status::CmdPending) {
                // Another motion would be an error (fieldbus, 6.7).
                self.is_failed_jog = image.state == GripperFlags::IDLE;
            }
            self.is_outdated = true;
        }
        self.is_aborted &= is_pending;
        (self.status, self.state, self.is_pending) = (image.status, image.state, is_pending);
        // No connection, or settings that are refused.
        if image.state == GripperFlags::ERROR
            && matches!(image.status, Status::IoError | Status::InconsistentData)
        {
            return true;
        }
        if image.system.contains(SystemFlags::FAST_STOP) {
            (self.excuse, self.is_outdated) = (Excuse::None, true);
            return is_pending || image.state == GripperFlags::IDLE;
        }
        let Some(reported) = self.reported.filter(|_| !is_pending && !self.is_outdated) else { return true };
        let is_excused = match image.state {
            GripperFlags::ERROR => self.excuse != Excuse::None,
            GripperFlags::IDLE => self.is_failed_jog,
            _ => false,
        };
        image.state == GripperFlags::from(reported) || is_excused
    }
}

impl Excuse {
    /// Returns the remaining excuse after this report.
    fn after(self, state: GripperState) -> Self {
        let repeats = |before: Option<GripperState>| before.is_none_or(|before| before == state);
        match self {
            Self::Failed(before) if !state.is_motion() && repeats(before) => Self::Failed(Some(state)),
            Self::Unknown(_) if state.is_motion() => self,
            Self::Unknown(before) if repeats(before) || state == GripperState::Idle => {
                Self::Failed(Some(state))
            }
            _ => Self::None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(state: GripperFlags, status: Status) -> InputImage {
        InputImage { state, status, ..InputImage::from_bytes([0; InputImage::LEN]) }
    }

    #[test]
    fn error_of_lost_connection_outlasts_motion_report_and_refusal() {
        let mut rule = GstateRule::new();
        rule.report(GripperState::Idle);
        assert!(rule.is_kept(&image(GripperFlags::POSITIONING, Status::CmdPending), true));
        assert!(rule.is_kept(&image(GripperFlags::ERROR, Status::IoError), false));
        rule.disconnect();
        rule.report(GripperState::Gripping);
        let refused = image(GripperFlags::ERROR, Status::AccessDenied);
        assert!(rule.is_kept(&refused, false));
        rule.report(GripperState::Gripping);
        assert!(rule.is_kept(&refused, false));
        rule.report(GripperState::NoPart);
        assert!(!rule.is_kept(&refused, false));
    }

    #[test]
    fn error_of_refused_motion_ends_when_another_state_is_reported() {
        let refused = image(GripperFlags::ERROR, Status::InsufficientResources);
        for (reported, is_error_kept) in [(GripperState::Idle, true), (GripperState::NoPart, false)] {
            let mut rule = GstateRule::new();
            rule.report(GripperState::Idle);
            assert!(rule.is_kept(&image(GripperFlags::RELEASING, Status::CmdPending), false));
            assert!(rule.is_kept(&refused, false));
            rule.report(reported);
            assert_eq!(rule.is_kept(&refused, false), is_error_kept, "{reported:?}");
        }
    }
}
