//! Properties of the whole bridge that must hold in every turn, for any PLC and gripper. The whole-bridge bodies
//! share this oracle and pass all inputs and outputs to it.

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Bridge, Config};
use wsg_protocol::{Command, CommandId, Kind, SystemFlags};

use super::gripper::Gripper;
use super::outputs::Shown;
use super::reported::Reported;
use super::requested::Requested;
use super::stops::Stops;

/// The sets of rules with their state.
pub(super) struct Oracle {
    pub(super) requested: Requested,
    pub(super) reported: Reported,
    pub(super) shown: Shown,
    stops: Stops,
    /// Whether the gripper has confirmed a FAST STOP that is not acknowledged.
    is_latched: bool,
    now_ms: u32,
    /// Maximum wait of a frame for the previous one, in milliseconds; `None` while the gripper is unreachable.
    max_delay_ms: Option<u32>,
}

impl Oracle {
    /// Creates the state at power-up of a bridge with these settings.
    pub(super) fn new(config: &Config) -> Self {
        Self {
            requested: Requested::new(config.wires.debounce_ms),
            reported: Reported::new(config.half_frame_ms),
            shown: Shown::new(config.wires.min_busy_ms),
            stops: Stops::new(),
            is_latched: false,
            now_ms: 0,
            max_delay_ms: None,
        }
    }

    /// Starts a turn with bytes read from the gripper and levels of the wires.
    pub(super) fn begin_turn(&mut self, now_ms: u32, received: &[u8], wires: Inputs) {
        self.now_ms = now_ms;
        self.reported.read(now_ms, received);
        // A third party's acknowledgement or a restart (fieldbus, 6.6), also before the connection is established.
        let may_be_latched = self.stops.is_answered() || self.reported.is_answered(CommandId::FastStop);
        if self.reported.has_left_fast_stop && may_be_latched {
            if !self.requested.holds_fast_stop() {
                self.requested.stopped_ms = None;
                self.stops.leave_fast_stop();
            } else if self.is_latched {
                self.stops.owe_fast_stop(now_ms);
            }
        }
        if self.reported.is_answered(CommandId::PrePosition) {
            self.requested.jogs = false;
        }
        self.requested.read_wires(now_ms, wires);
    }

    /// Ends the inputs of this turn; commands follow.
    pub(super) fn begin_leaving(&mut self, max_delay_ms: Option<u32>) {
        self.max_delay_ms = max_delay_ms;
        self.stops.begin_turn(self.now_ms, &self.reported, &self.requested);
    }

    /// Checks a command to the gripper; `command` is `None` while only its id is known.
    pub(super) fn leaves(&mut self, id: CommandId, command: Option<&Command<'_>>, gripper: &Gripper) {
        self.requested.leaves(id, command, gripper.force_limit());
        self.stops.leaves(self.now_ms, id, &self.reported, self.max_delay_ms);
        if id.kind() == Kind::Motion {
            self.reported.grip = None;
        }
    }

    /// Ends the turn of this bridge with these outputs.
    pub(super) fn end_turn(&mut self, bridge: &Bridge, outputs: Outputs, gripper: &Gripper) {
        let (image, motion_is_open) = (bridge.input_image(), bridge.motion_is_open());
        let keeps_rule = self.reported.gstate.is_kept(&image, motion_is_open);
        assert!(keeps_rule || gripper.is_forged(), "{image:?} {:?}", self.reported.gstate);
        let is_connected = outputs.contains(Outputs::LINK_OK);
        if !is_connected {
            self.requested.lose_gripper();
        }
        if self.shown.outputs.contains(Outputs::LINK_OK) && !is_connected {
            self.reported.forget();
        }
        self.shown.show(self.now_ms, outputs, &self.reported, &self.requested);
        self.requested.is_ready = outputs.contains(Outputs::READY);
        self.stops.end_turn(self.now_ms, outputs, &self.reported, self.max_delay_ms);
        if let Some(since_ms) = self.requested.stopped_ms {
            let is_held = self.requested.holds_fast_stop();
            assert!(
                gripper.has_stopped(self.now_ms, since_ms, is_held),
                "FAST STOP has not reached the gripper"
            );
        }
        let is_reported = self.reported.flags.is_some_and(|flags| flags.contains(SystemFlags::FAST_STOP));
        let is_answered = self.stops.is_answered() && self.requested.stopped_ms.is_some();
        self.is_latched = is_connected && is_answered && is_reported;
    }
}
