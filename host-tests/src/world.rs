//! The whole bridge and a virtual gripper on a serial line in virtual time: no emulator, no clock, a million milliseconds in
//! seconds.
//!
//! The bridge here is the library that the image is made of; what only the board has (interrupts, registers, the size of
//! its queues) is tested in the emulator.

use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Bridge, Config, NoBus};
use wsg_protocol::CommandId;
use wsg_sim::{Time, VirtualGripper};

use crate::serial_gripper::{Carry, Disturbance, SerialGripper, SerialLine};
use crate::wires::Wires;

/// The bus of a PLC that has wires as well.
pub trait Bus {
    /// One turn of the bridge's main loop.
    fn turn(&mut self, bridge: &mut Bridge, now_ms: u32, inputs: Inputs, line: &mut SerialLine) -> Outputs;
}

impl Bus for NoBus {
    fn turn(&mut self, bridge: &mut Bridge, now_ms: u32, inputs: Inputs, line: &mut SerialLine) -> Outputs {
        bridge.poll(now_ms, inputs, line, self)
    }
}

/// A bridge with its gripper, and the lines to a PLC that a test plays.
#[derive(Clone, Debug)]
pub struct World<B, W = Option<Disturbance>> {
    pub(crate) bridge: Bridge,
    /// The PLC's bus.
    pub(crate) bus: B,
    /// The gripper and its line.
    pub far: SerialGripper<W>,
    pub(crate) now_ms: u32,
    /// The bridge's clock stands still.
    is_frozen: bool,
    pub(crate) inputs: Inputs,
    pub(crate) outputs: Outputs,
}

impl<B, W: Carry> World<B, W> {
    /// Switches bridge and gripper on.
    pub(crate) fn with(bridge: Config, bus: B, far: SerialGripper<W>, inputs: Inputs) -> Self {
        let (bridge, outputs) = (Bridge::new(bridge), Outputs::empty());
        Self { bridge, bus, far, now_ms: 0, is_frozen: false, inputs, outputs }
    }

    /// The moment, on the gripper's clock.
    #[must_use]
    pub fn now(&self) -> Time {
        Time::from_millis(self.now_ms.into())
    }

    /// The moment, in milliseconds.
    #[must_use]
    pub fn now_ms(&self) -> u32 {
        self.now_ms
    }

    /// The bridge.
    #[must_use]
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// The bridge, to tell it what its board knows.
    pub fn bridge_mut(&mut self) -> &mut Bridge {
        &mut self.bridge
    }

    /// The gripper.
    pub fn gripper(&mut self) -> &mut VirtualGripper<1> {
        &mut self.far.gripper
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

impl<B> World<B> {
    /// Cuts the line from gripper to bridge, or mends it.
    pub fn set_cut(&mut self, cut: bool) {
        self.far.to_bridge = if cut { Some(Box::new(Vec::clear)) } else { None };
    }
}

impl<B: Bus, W: Carry> Wires for World<B, W> {
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
        self.outputs = self.bus.turn(&mut self.bridge, self.now_ms, self.inputs, &mut self.far.line);
        self.far.advance(self.now());
    }
}
