//! Permitted levels of the wires to the PLC: the rules of docs/wiring.md ("Outputs"), applied to the gripper's
//! reports and the PLC's requests.

use wsg_bridge_fw::io::Outputs;
use wsg_protocol::{GripperState, Status, SystemFlags};

use super::reported::Reported;
use super::requested::Requested;

/// Maximum time of LINK_OK after the gripper's last intact frame, in milliseconds.
const SILENCE_MS: u32 = 1_000;

/// The output wires of the last turn.
pub(super) struct Shown {
    /// Minimum duration of BUSY, in milliseconds.
    pub(super) min_busy_ms: u32,
    pub(super) outputs: Outputs,
    busy_since: u32,
    /// Time of the last motion edge while READY was high.
    edge_ms: Option<u32>,
}

impl Shown {
    /// Creates the state with all wires low.
    pub(super) const fn new(min_busy_ms: u32) -> Self {
        Self { min_busy_ms, outputs: Outputs::empty(), busy_since: 0, edge_ms: None }
    }

    /// Checks the outputs at the end of a turn.
    pub(super) fn show(&mut self, now_ms: u32, outputs: Outputs, reported: &Reported, requested: &Requested) {
        let before = std::mem::replace(&mut self.outputs, outputs);
        let has = |wires| outputs.intersects(wires);
        self.edge_ms = if requested.has_edge { Some(now_ms) } else { self.edge_ms };
        let error = has(Outputs::ERROR);
        if !has(Outputs::LINK_OK) {
            assert!(Outputs::ERROR.contains(outputs), "{outputs:?}");
            assert!(error || requested.stopped_ms.is_none(), "FAST STOP without ERROR");
            self.edge_ms = None;
            return;
        }
        let (Some(flags), Some(state)) = (reported.flags, reported.state) else {
            panic!("LINK_OK without the states")
        };
        let what = || format!("{outputs:?}, {flags:?}, {state:?}, {:?}", reported.grip);
        assert!(now_ms - reported.received_ms <= SILENCE_MS, "silence: {}", what());

        let locked = requested.stopped_ms.is_some() || flags.intersects(SystemFlags::LOCKS);
        let is_at_fault = locked || requested.is_refused || flags.contains(SystemFlags::FINGER_FAULT);
        assert!(
            error || !is_at_fault,
            "{} stopped {:?} refused {}",
            what(),
            requested.stopped_ms,
            requested.is_refused
        );

        let (ready, busy) = (has(Outputs::READY), has(Outputs::BUSY));
        let may_be_ready = requested.is_released() && !locked && !busy;
        assert!(ready == may_be_ready || error && !ready, "{}", what());
        assert!(busy || !flags.contains(SystemFlags::MOVING), "{}", what());
        if busy && !before.contains(Outputs::BUSY) {
            self.busy_since = now_ms;
        }
        let ends = before.contains(Outputs::BUSY) && !busy && !error;
        assert!(!ends || now_ms - self.busy_since >= self.min_busy_ms, "{}", what());

        // A FAST STOP ends BUSY; ERROR without READY is also a response.
        let is_stopped = error && !ready && !busy;
        self.edge_ms = self.edge_ms.filter(|edge_ms| !is_stopped && now_ms - edge_ms < self.min_busy_ms);
        assert!(busy || self.edge_ms.is_none(), "an edge at READY without a response: {}", what());

        let (holding, fault) = (has(Outputs::HOLDING), has(Outputs::PART_FAULT));
        assert!(!(holding && fault), "{}", what());
        // No new result appears while BUSY is high. An earlier one outlasts a rejected command until a motion starts.
        let is_kept = before.contains(Outputs::HOLDING) && !flags.contains(SystemFlags::MOVING);
        assert!(!holding || !busy || is_kept, "{}", what());
        assert!(
            !holding || state == GripperState::Holding || reported.grip == Some(Status::Success),
            "{}",
            what()
        );
        let is_gone = matches!(state, GripperState::NoPart | GripperState::PartLost);
        assert!(!fault || is_gone || reported.grip == Some(Status::CmdFailed), "{}", what());
        assert_eq!(has(Outputs::REFERENCED), flags.contains(SystemFlags::REFERENCED), "{}", what());
    }
}
