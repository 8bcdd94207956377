//! The status register (fieldbus, 5.1.2): E_CMD_PENDING while the PLC's last command runs, then its result.

use crate::CommandFlags;
use wsg_protocol::command::CommandId;
use wsg_protocol::types::Status;

/// The status register.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum StatusRegister {
    /// This command runs.
    Pending {
        /// The command whose result will follow.
        command: CommandId,
        /// A motion was refused meanwhile: the refused flags that are still 1.
        refused: Option<CommandFlags>,
    },
    /// The result of the last command, or why the controller refused it.
    Ended(Status),
}

impl StatusRegister {
    pub(super) const fn pending(command: CommandId) -> Self {
        Self::Pending { command, refused: None }
    }

    /// Returns whether the result of this command is to be shown.
    pub(super) fn is_of(&self, id: CommandId) -> bool {
        matches!(self, Self::Pending { command, .. } if *command == id)
    }

    /// Takes the flags that the PLC wrote.
    pub(super) fn see(&mut self, flags: CommandFlags) {
        if let Self::Pending { refused: Some(refused), .. } = self {
            *refused = refused.intersection(flags);
        }
    }

    /// Returns the value of the register: E_ALREADY_RUNNING while a flag refused during a pending command is 1.
    pub(super) fn shown(&self) -> Status {
        match self {
            Self::Ended(status) => *status,
            Self::Pending { refused, .. } if refused.is_some_and(|refused| !refused.is_empty()) => {
                Status::AlreadyRunning
            }
            Self::Pending { .. } => Status::CmdPending,
        }
    }
}
