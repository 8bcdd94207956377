//! A [`World`] whose PLC uses wires only.

use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::{Config, NoBus};

pub use crate::serial_gripper::Disturbance;
use crate::serial_gripper::SerialGripper;
use crate::wires::Wires;
use crate::world::World;

/// Bridge and gripper, with PLC wires driven by the test.
pub type TestRig = World<NoBus>;

impl TestRig {
    /// Creates a rig with all PLC wires low.
    #[must_use]
    pub fn new(config: wsg_sim::Config) -> Self {
        Self::with_bridge(Config::DEFAULT, config)
    }

    /// Creates a rig with all PLC wires low and these settings of bridge and gripper.
    #[must_use]
    pub fn with_bridge(bridge: Config, gripper: wsg_sim::Config) -> Self {
        Self::with(bridge, NoBus, SerialGripper::new(gripper), Inputs::empty())
    }

    /// Creates a rig that is READY: connected, with FAST STOP acknowledged.
    #[must_use]
    pub fn ready(config: wsg_sim::Config) -> Self {
        let mut rig = Self::new(config);
        rig.get_ready();
        rig
    }

    /// Creates a rig that is READY and REFERENCED.
    #[must_use]
    pub fn homed(config: wsg_sim::Config) -> Self {
        let mut rig = Self::new(config);
        rig.get_homed();
        rig
    }
}
