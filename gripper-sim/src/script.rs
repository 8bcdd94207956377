//! What a script on the gripper shares with its clients: the commands that it has claimed, and those that wait for it.
//!
//! The script itself is outside of the core: whoever runs one takes the requests and answers them.

use crate::port::PortId;
use heapless::{Deque, Vec};
use wsg_protocol::Status;

/// The ids that scripts may claim.
pub const SCRIPT_IDS: core::ops::RangeInclusive<u8> = 0xA0..=0xBF;

/// The longest payload of a request to a script, in bytes. Assumed.
pub const MAX_REQUEST_LEN: usize = 256;

/// Requests that wait for the script. Assumed.
const MAX_WAITING: usize = 16;

/// A command that waits for the script.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScriptRequest {
    /// Who sent it: where the answer goes.
    pub port: PortId,
    /// One of [`SCRIPT_IDS`].
    pub id: u8,
    /// Its payload.
    pub payload: Vec<u8, MAX_REQUEST_LEN>,
}

/// Whether a script runs, as the system state flags tell it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ScriptState {
    /// There is none, or it came to its end.
    #[default]
    None,
    /// SF_SCRIPT_RUNNING.
    Running,
    /// SF_SCRIPT_FAILURE: it ended with an error.
    Failed,
}

/// What the device holds of a script.
#[derive(Clone, Debug, Default)]
pub(crate) struct Script {
    state: ScriptState,
    /// A bit for each of [`SCRIPT_IDS`].
    claimed: u32,
    waiting: Deque<ScriptRequest, MAX_WAITING>,
}

impl Script {
    pub(crate) const fn state(&self) -> ScriptState {
        self.state
    }

    /// A script that does not run answers nothing any more.
    pub(crate) fn set_state(&mut self, state: ScriptState) {
        self.state = state;
        if state != ScriptState::Running {
            self.claimed = 0;
            self.waiting.clear();
        }
    }

    /// Whether there is a command of this id to be claimed.
    pub(crate) fn claim(&mut self, id: u8) -> bool {
        let bit = bit(id);
        self.claimed |= bit;
        bit != 0
    }

    /// Gives an id back: its commands are unknown from now on. Returns whether a script may claim it.
    pub(crate) fn release(&mut self, id: u8) -> bool {
        let bit = bit(id);
        self.claimed &= !bit;
        bit != 0
    }

    /// Keeps a request for the script. `None` if none has claimed its id; else whether it could be kept.
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

    /// The number of requests that wait for the script.
    pub(crate) fn waiting(&self) -> usize {
        self.waiting.len()
    }
}

/// The bit of an id; 0 for one that no script may claim.
fn bit(id: u8) -> u32 {
    if SCRIPT_IDS.contains(&id) { 1 << (id - SCRIPT_IDS.start()) } else { 0 }
}
