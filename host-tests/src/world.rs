//! The complete bridge and a virtual gripper on a serial line in virtual time, without an emulator or a clock. A
//! million milliseconds take seconds.
//!
//! This is the library that the image is built from. Board-specific parts (interrupts, registers, queue sizes) are
//! tested in the emulator.

use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Bridge, Config, NoBus};
use wsg_protocol::CommandId;
use wsg_sim::{Time, VirtualGripper};

use crate::serial_gripper::{Carry, Disturbance, SerialGripper, SerialLine};
use crate::wires::Wires;

/// A PLC bus, used beside the wires.
pub trait Bus {
    /// Runs one turn of the bridge's main loop.
    fn turn(&mut self, bridge: &mut Bridge, now_ms: u32, inputs: Inputs, line: &mut SerialLine) -> Outputs;
}

impl Bus for NoBus {
    fn turn(&mut self, bridge: &mut Bridge, now_ms: u32, inputs: Inputs, line: &mut SerialLine) -> Outputs {
        bridge.poll(now_ms, inputs, line, self)
    }
}

/// A bridge, its gripper, and the PLC signals driven by a test.
#[derive(Clone, Debug)]
pub struct World<B, W = Option<Disturbance>> {
    pub(crate) bridge: Bridge,
    pub(crate) bus: B,
    /// The gripper and its line.
    pub far: SerialGripper<W>,
    pub(crate) now_ms: u32,
    /// Whether the bridge's clock is stopped.
    is_frozen: bool,
    pub(crate) inputs: Inputs,
    pub(crate) outputs: Outputs,
}

impl<B, W: Carry> World<B, W> {
    /// Powers up bridge and gripper.
    pub(crate) fn with(bridge: Config, bus: B, far: SerialGripper<W>, inputs: Inputs) -> Self {
        let (bridge, outputs) = (Bridge::new(bridge), Outputs::empty());
        Self { bridge, bus, far, now_ms: 0, is_frozen: false, inputs, outputs }
    }

    /// Returns the current time on the gripper's clock.
    #[must_use]
    pub fn now(&self) -> Time {
        Time::from_millis(self.now_ms.into())
    }

    /// Returns the current time in milliseconds.
    #[must_use]
    pub fn now_ms(&self) -> u32 {
        self.now_ms
    }

    /// Returns the bridge.
    #[must_use]
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// Returns the bridge for board-level input, such as the reset cause.
    pub fn bridge_mut(&mut self) -> &mut Bridge {
        &mut self.bridge
    }

    /// Returns the gripper.
    pub fn gripper(&mut self) -> &mut VirtualGripper<1> {
        &mut self.far.gripper
    }

    /// Returns the bridge's error counters.
    #[must_use]
    pub fn counters(&self) -> wsg_bridge_fw::Counters {
        self.bridge.counters()
    }

    /// Returns the state shown by the LED.
    #[must_use]
    pub fn indication(&self) -> Indication {
        self.bridge.indication()
    }

    /// Resets the bridge; it loses all state.
    pub fn restart_bridge(&mut self) {
        self.bridge = Bridge::new(Config::DEFAULT);
    }

    /// Stops the bridge's clock.
    pub const fn freeze(&mut self) {
        self.is_frozen = true;
    }

    /// Power-cycles the gripper; it loses all state, and its clock restarts at zero.
    pub fn restart_gripper(&mut self, config: wsg_sim::Config) {
        self.far.restart(config, self.now());
    }
}

impl<B> World<B> {
    /// Cuts or restores the line from gripper to bridge.
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
