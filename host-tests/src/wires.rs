//! The PLC on the wires of a bench in virtual time.

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::CommandId;

use crate::serial_gripper::motions;

/// A bench with wires, and what a PLC does with them.
pub trait Wires {
    /// The wires from the PLC.
    fn inputs(&mut self) -> &mut Inputs;

    /// The wires to the PLC.
    fn outputs(&self) -> Outputs;

    /// The commands that the bridge has sent since this was last asked.
    fn take_sent(&mut self) -> Vec<CommandId>;

    /// One millisecond.
    fn step(&mut self);

    /// The motion commands among those that were sent.
    fn take_motions(&mut self) -> Vec<CommandId> {
        motions(self.take_sent())
    }

    /// Sets wires of the PLC.
    fn set(&mut self, wires: Inputs, high: bool) {
        self.inputs().set(wires, high);
    }

    /// Lets time pass.
    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            self.step();
        }
    }

    /// Raises wires for 5 ms and lowers them for as long.
    fn pulse(&mut self, wires: Inputs) {
        self.set(wires, true);
        self.pass(5);
        self.set(wires, false);
        self.pass(5);
    }

    /// Lets time pass until the outputs are as wanted, `bound_ms` at the most; whether they are.
    fn until(&mut self, bound_ms: u32, wanted: impl Fn(Outputs) -> bool) -> bool {
        (0..bound_ms).any(|_| {
            self.step();
            wanted(self.outputs())
        })
    }

    /// Gets from power-up to READY: a connection, FAST STOP acknowledged.
    ///
    /// # Panics
    /// When it does not become so.
    fn get_ready(&mut self) {
        self.set(Inputs::FAST_STOP_OK, true);
        self.pass(200);
        self.pulse(Inputs::STOP_ACK);
        assert!(self.until(1_000, |outputs| outputs.contains(Outputs::READY)), "{:?}", self.outputs());
    }

    /// The same, and references the fingers.
    ///
    /// # Panics
    /// When it does not become so.
    fn get_homed(&mut self) {
        self.get_ready();
        let outputs = self.command(Inputs::HOME);
        assert!(outputs.contains(Outputs::REFERENCED | Outputs::READY), "{outputs:?}");
    }

    /// Gives a motion command and waits for its end; the outputs then.
    ///
    /// # Panics
    /// When it is not taken, or does not end within a minute.
    fn command(&mut self, wire: Inputs) -> Outputs {
        self.set(wire, true);
        let taken = self.until(1_000, |outputs| outputs.contains(Outputs::BUSY));
        assert!(taken, "{wire:?} is not taken: {:?}, sent {:?}", self.outputs(), self.take_sent());
        self.set(wire, false);
        assert!(self.until(60_000, |outputs| !outputs.contains(Outputs::BUSY)), "{wire:?} does not end");
        self.outputs()
    }
}
