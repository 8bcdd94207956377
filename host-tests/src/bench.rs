//! Bridge and virtual gripper in virtual time: no emulator, no clock, a million milliseconds in seconds.
//!
//! The bridge here is the library that the image is made of; what only the board has (interrupts, registers, the size of
//! its queues) is tested in the emulator.

use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Bridge, Config, NoBus};
use wsg_protocol::CommandId;
use wsg_sim::{Time, VirtualGripper};

pub use crate::serial_gripper::Disturbance;
use crate::serial_gripper::SerialGripper;
use crate::wires::Wires;

/// Bridge and gripper, and a PLC that a test plays.
#[derive(Debug)]
pub struct Bench {
    bridge: Bridge,
    /// The gripper and its line.
    pub far: SerialGripper,
    now_ms: u32,
    /// The bridge's clock stands still.
    is_frozen: bool,
    inputs: Inputs,
    outputs: Outputs,
}

impl Bench {
    /// A bench with all wires of the PLC low.
    #[must_use]
    pub fn new(config: wsg_sim::Config) -> Self {
        Self::with_bridge(Config::DEFAULT, config)
    }

    /// A bench with all wires of the PLC low, and these settings of bridge and gripper.
    #[must_use]
    pub fn with_bridge(bridge: Config, gripper: wsg_sim::Config) -> Self {
        Self {
            bridge: Bridge::new(bridge),
            far: SerialGripper::new(gripper),
            now_ms: 0,
            is_frozen: false,
            inputs: Inputs::empty(),
            outputs: Outputs::empty(),
        }
    }

    /// A bench that is READY: connected, FAST STOP acknowledged.
    #[must_use]
    pub fn ready(config: wsg_sim::Config) -> Self {
        let mut bench = Self::new(config);
        bench.get_ready();
        bench
    }

    /// A bench that is READY and REFERENCED.
    #[must_use]
    pub fn homed(config: wsg_sim::Config) -> Self {
        let mut bench = Self::new(config);
        bench.get_homed();
        bench
    }

    /// The gripper.
    pub fn gripper(&mut self) -> &mut VirtualGripper<1> {
        &mut self.far.gripper
    }

    /// The moment, on the gripper's clock.
    #[must_use]
    pub fn now(&self) -> Time {
        Time::from_millis(self.now_ms.into())
    }

    /// What the bridge has met that it could not use.
    #[must_use]
    pub fn counters(&self) -> wsg_bridge_fw::Counters {
        self.bridge.counters()
    }

    /// What the LED tells.
    #[must_use]
    pub fn indication(&self) -> Indication {
        self.bridge.indication()
    }

    /// Resets the bridge: it has forgotten everything.
    pub fn restart_bridge(&mut self) {
        self.bridge = Bridge::new(Config::DEFAULT);
    }

    /// Lets the bridge's clock stand still from now on.
    pub const fn freeze(&mut self) {
        self.is_frozen = true;
    }

    /// Switches the gripper off and on again: it has forgotten everything, and its clock starts anew.
    pub fn restart_gripper(&mut self, config: wsg_sim::Config) {
        self.far.restart(config, self.now());
    }
}

impl Wires for Bench {
    fn inputs(&mut self) -> &mut Inputs {
        &mut self.inputs
    }

    fn outputs(&self) -> Outputs {
        self.outputs
    }

    fn take_sent(&mut self) -> Vec<CommandId> {
        self.far.take_sent()
    }

    fn step(&mut self) {
        self.now_ms += u32::from(!self.is_frozen);
        self.outputs = self.bridge.poll(self.now_ms, self.inputs, &mut self.far.line, &mut NoBus);
        self.far.advance(self.now());
    }
}
