//! Permitted levels of the wires to the PLC: the rules of docs/wiring.md ("Outputs"), applied to the gripper's
//! reports and the PLC's requests.

use std::hash::{Hash, Hasher};

use wsg_bridge_fw::io::Outputs;
use wsg_protocol::{GripperState, Instant, Status, SystemFlags};

use super::reports::Reports;
use super::requests::Requests;
use super::{Kept, Promise, keep};

/// The output wires of the last turn.
#[derive(Clone, Debug)]
pub(crate) struct Levels {
    /// Minimum duration of BUSY, in milliseconds.
    pub(crate) min_busy_ms: u32,
    /// Maximum time of LINK_OK after the gripper's last intact frame, in milliseconds.
    pub(crate) max_silence_ms: u32,
    pub(crate) outputs: Outputs,
    /// End of the last turn without LINK_OK.
    pub(super) unlinked: Instant,
    busy_since: Instant,
    /// Whether the fingers were moving, or a motion of the PLC had neither a result nor ERROR, at the end of a turn since BUSY
    /// rose.
    has_run: bool,
    /// Time of the last motion edge while READY was high.
    edge: Option<Instant>,
}

impl Hash for Levels {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let busy = self.outputs.contains(Outputs::BUSY).then_some((self.busy_since, self.has_run));
        (self.outputs, busy, self.edge).hash(state);
    }
}

impl Levels {
    /// Creates the state with all wires low.
    pub(super) const fn new(min_busy_ms: u32) -> Self {
        Self {
            min_busy_ms,
            max_silence_ms: 1_000,
            outputs: Outputs::empty(),
            unlinked: Instant::from_millis(0),
            busy_since: Instant::from_millis(0),
            has_run: false,
            edge: None,
        }
    }

    /// Checks the outputs at the end of a turn. `motion_is_open` is whether a motion of the PLC has no result yet.
    pub(super) fn show(
        &mut self,
        now: Instant,
        outputs: Outputs,
        reports: &Reports,
        requests: &Requests,
        motion_is_open: bool,
    ) -> Kept {
        let before = std::mem::replace(&mut self.outputs, outputs);
        let has = |wires| outputs.intersects(wires);
        self.unlinked = if has(Outputs::LINK_OK) { self.unlinked } else { now };
        self.edge = if requests.has_edge { Some(now) } else { self.edge };
        let error = has(Outputs::ERROR);
        if !has(Outputs::LINK_OK) {
            self.edge = None;
            keep(Promise::OnlyErrorWithoutLink, Outputs::ERROR.contains(outputs))?;
            return keep(Promise::FaultShowsError, error || requests.stopped.is_none());
        }
        let (Some(flags), Some(state)) = (reports.flags, reports.state) else {
            return Err(Promise::LinkOkKnowsTheStates);
        };
        keep(Promise::LinkOkGoesLow, now.since(reports.received) <= self.max_silence_ms)?;

        let locked = requests.stopped.is_some() || flags.intersects(SystemFlags::LOCKS);
        let is_at_fault = locked || requests.is_refused || flags.contains(SystemFlags::FINGER_FAULT);
        keep(Promise::FaultShowsError, error || !is_at_fault)?;

        let (ready, busy) = (has(Outputs::READY), has(Outputs::BUSY));
        let may_be_ready = requests.is_released() && !locked && !busy;
        keep(Promise::ReadyIsTrue, ready == may_be_ready || error && !ready)?;
        keep(Promise::BusyIsTrue, busy || !flags.contains(SystemFlags::MOVING))?;
        if busy && !before.contains(Outputs::BUSY) {
            self.busy_since = now;
        }
        // A motion that ERROR has ended, and that waits to be withdrawn, does not run.
        let runs = motion_is_open && !error || flags.contains(SystemFlags::MOVING);
        self.has_run = busy && (self.has_run || runs);
        let ends = before.contains(Outputs::BUSY) && !busy && !error;
        keep(Promise::BusyLasts, !ends || now.since(self.busy_since) >= self.min_busy_ms)?;

        // A FAST STOP ends BUSY; ERROR without READY is also a response.
        let is_stopped = error && !ready && !busy;
        self.edge = self.edge.filter(|edge| !is_stopped && now.since(*edge) < self.min_busy_ms);
        keep(Promise::ReadyEdgeShowsBusy, busy || self.edge.is_none())?;

        let (holding, fault) = (has(Outputs::HOLDING), has(Outputs::PART_FAULT));
        // No new result appears until BUSY of its motion is low. An earlier one outlasts a rejected command until a motion
        // starts. While BUSY only answers an edge, a third party's grip may end.
        let is_kept = before.contains(Outputs::HOLDING) && !flags.contains(SystemFlags::MOVING);
        let may_hold = !fault && (!busy || is_kept || !self.has_run);
        let holds = state == GripperState::Holding || reports.grip == Some(Status::Success);
        keep(Promise::HoldingIsTrue, !holding || may_hold && holds)?;
        let is_gone = matches!(state, GripperState::NoPart | GripperState::PartLost);
        keep(Promise::PartFaultIsTrue, !fault || is_gone || reports.grip == Some(Status::CmdFailed))?;
        keep(Promise::ReferencedIsTrue, has(Outputs::REFERENCED) == flags.contains(SystemFlags::REFERENCED))
    }
}
