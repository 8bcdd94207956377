//! PLC actions on wires, in virtual time.

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::CommandId;
use wsg_sim::Part;

use crate::serial_gripper::motions;

/// Outputs at rest, with referenced fingers.
pub const IDLE: Outputs = Outputs::READY.union(Outputs::REFERENCED).union(Outputs::LINK_OK);

/// Returns the configuration of a gripper that moves ten times as fast. Every phase of a motion still exceeds the 10 ms
/// period of its reports by far.
#[must_use]
pub fn quick() -> wsg_sim::Config {
    wsg_sim::Config { time_scale: 10.0, ..wsg_sim::Config::default() }
}

/// Returns the configuration of a quick gripper with a part of this width in mm.
#[must_use]
pub fn with_part(width: f32) -> wsg_sim::Config {
    wsg_sim::Config { part: Part::of_width(width), ..quick() }
}

/// A test fixture with wires, and the PLC's actions on them.
pub trait Wires {
    /// Returns the wires from the PLC.
    fn inputs(&mut self) -> &mut Inputs;

    /// Returns the wires to the PLC.
    fn outputs(&self) -> Outputs;

    /// Returns the commands that the bridge has sent since the last call.
    fn take_sent(&mut self) -> Vec<CommandId>;

    /// Advances by one millisecond.
    fn step(&mut self);

    /// Returns the motion commands that the bridge has sent since the last call.
    fn take_motions(&mut self) -> Vec<CommandId> {
        motions(self.take_sent())
    }

    /// Sets wires from the PLC.
    fn set(&mut self, wires: Inputs, high: bool) {
        self.inputs().set(wires, high);
    }

    /// Lets time pass.
    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            self.step();
        }
    }

    /// Raises wires for 5 ms and lowers them for 5 ms.
    fn pulse(&mut self, wires: Inputs) {
        self.set(wires, true);
        self.pass(5);
        self.set(wires, false);
        self.pass(5);
    }

    /// Waits at most `bound_ms` until the outputs satisfy `wanted`. Returns whether they do.
    fn until(&mut self, bound_ms: u32, wanted: impl Fn(Outputs) -> bool) -> bool {
        (0..bound_ms).any(|_| {
            self.step();
            wanted(self.outputs())
        })
    }

    /// Proceeds from power-up to READY: connects and acknowledges FAST STOP.
    ///
    /// # Panics
    /// Panics when READY does not become high.
    fn get_ready(&mut self) {
        self.set(Inputs::FAST_STOP_OK, true);
        self.pass(200);
        self.pulse(Inputs::STOP_ACK);
        assert!(self.until(1_000, |outputs| outputs.contains(Outputs::READY)), "{:?}", self.outputs());
    }

    /// Proceeds from power-up to READY and references the fingers.
    ///
    /// # Panics
    /// Panics when homing fails.
    fn get_homed(&mut self) {
        self.get_ready();
        let outputs = self.command(Inputs::HOME);
        assert!(outputs.contains(Outputs::REFERENCED | Outputs::READY), "{outputs:?}");
    }

    /// Issues a motion command and waits until it completes. Returns the outputs at that time.
    ///
    /// # Panics
    /// Panics when it is not accepted, or not completed within a minute.
    fn command(&mut self, wire: Inputs) -> Outputs {
        self.set(wire, true);
        let taken = self.until(1_000, |outputs| outputs.contains(Outputs::BUSY));
        assert!(taken, "{wire:?} is not accepted: {:?}, sent {:?}", self.outputs(), self.take_sent());
        self.set(wire, false);
        assert!(self.until(60_000, |outputs| !outputs.contains(Outputs::BUSY)), "{wire:?} does not complete");
        self.outputs()
    }
}
