//! The commands that a script on the gripper has claimed, and the requests queued for it.
//!
//! The script itself is outside the core; the caller that runs it takes the requests and answers them.

use crate::port::PortId;
use heapless::{Deque, Vec};
use wsg_protocol::Status;

/// Ids that scripts may claim.
pub const SCRIPT_IDS: core::ops::RangeInclusive<u8> = 0xA0..=0xBF;

/// Longest payload of a request to a script, in bytes. Assumed.
pub const MAX_REQUEST_LEN: usize = 256;

/// Capacity of the request queue of the script. Assumed.
const MAX_WAITING: usize = 16;

/// A command queued for the script.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScriptRequest {
    /// The sender, to which the answer goes.
    pub port: PortId,
    /// The command id, one of [`SCRIPT_IDS`].
    pub id: u8,
    /// The payload of the command.
    pub payload: Vec<u8, MAX_REQUEST_LEN>,
}

/// Whether a script runs, as the system state flags report it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ScriptState {
    /// No script runs, or it ended normally.
    #[default]
    None,
    /// SF_SCRIPT_RUNNING is set.
    Running,
    /// SF_SCRIPT_FAILURE is set: the script ended with an error.
    Failed,
}

/// The device's record of a script.
#[derive(Clone, Debug, Default)]
pub(crate) struct ScriptCommands {
    state: ScriptState,
    /// One bit for each of [`SCRIPT_IDS`].
    claimed: u32,
    waiting: Deque<ScriptRequest, MAX_WAITING>,
}

impl ScriptCommands {
    pub(crate) const fn state(&self) -> ScriptState {
        self.state
    }

    /// Sets the state. A script that no longer runs loses its claims and queued requests.
    pub(crate) fn set_state(&mut self, state: ScriptState) {
        self.state = state;
        if state != ScriptState::Running {
            self.claimed = 0;
            self.waiting.clear();
        }
    }

    /// Claims an id. Returns whether scripts may claim it.
    pub(crate) fn claim(&mut self, id: u8) -> bool {
        let bit = bit(id);
        self.claimed |= bit;
        bit != 0
    }

    /// Releases an id: its commands become unknown. Returns whether scripts may claim it.
    pub(crate) fn release(&mut self, id: u8) -> bool {
        let bit = bit(id);
        self.claimed &= !bit;
        bit != 0
    }

    /// Queues a request for the script. Returns `None` if its id is not claimed, otherwise whether there was room.
    pub(crate) fn keep(&mut self, port: PortId, id: u8, payload: &[u8]) -> Option<Result<(), Status>> {
        if self.claimed & bit(id) == 0 {
            return None;
        }
        let Ok(payload) = Vec::from_slice(payload) else { return Some(Err(Status::CmdFormatError)) };
        let kept = self.waiting.push_back(ScriptRequest { port, id, payload });
        Some(kept.map_err(|_| Status::InsufficientResources))
    }

    pub(crate) fn take(&mut self) -> Option<ScriptRequest> {
        self.waiting.pop_front()
    }

    /// Returns the number of queued requests.
    pub(crate) fn waiting(&self) -> usize {
        self.waiting.len()
    }
}

/// Returns the bit of an id; 0 if scripts may not claim it.
fn bit(id: u8) -> u32 {
    if SCRIPT_IDS.contains(&id) { 1 << (id - SCRIPT_IDS.start()) } else { 0 }
}
