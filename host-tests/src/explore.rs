//! Exhaustive exploration of the bridge: every order of events up to a depth, from power-up and from each key state.
//!
//! The bridge is the library that the image is built from. Around it are a PLC, a gripper reduced to its states, and
//! a line that delays, drops, repeats or truncates its messages. A breadth-first search tries every action in every
//! state once, and checks each [`Promise`] after every turn.
//!
//! | module | content |
//! |---|---|
//! | `action` | the operations that are tried |
//! | `plant` | bridge, gripper, line and PLC, and the effect of each action |
//! | `roots` | initial states |
//! | `search` | breadth-first search |
//! | `key` | equality of states |
//!
//! Not covered: partially sent frames and timing within a message. See [`fuzz_bodies`](crate::fuzz_bodies) and
//! [`fault_sweep`](crate::fault_sweep).

mod action;
mod key;
mod plant;
mod roots;
mod search;

use std::fmt;

use wsg_bridge_fw::io::Outputs;

use crate::operation::Operation;
pub use crate::promises::Promise;
use action::{BUS, WIRES};
use roots::Root;
use search::{Outcome, explore};

/// Limits of an exploration.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Maximum number of consecutive actions, at most 12.
    pub depth: u32,
    /// Number of states after which the search ends.
    pub states: u64,
}

/// A type of PLC, which determines the set of actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlcKind {
    /// A PLC with wires and no bus.
    Wires,
    /// A PLC that writes images over Modbus and has the wires GRIP, STOP_ACK and FAST_STOP_OK.
    Bus,
}

impl PlcKind {
    /// All types of PLC.
    pub const ALL: [Self; 2] = [Self::Wires, Self::Bus];

    const fn actions(self) -> &'static [Operation] {
        match self {
            Self::Wires => &WIRES,
            Self::Bus => &BUS,
        }
    }

    /// Explores every order of this PLC's actions from each key state.
    #[must_use]
    pub fn explore(self, bounds: Bounds) -> Report {
        let roots = roots::roots(self.actions());
        let plants: Vec<_> = roots.iter().map(|root| root.plant.clone()).collect();
        let outcome = explore(&plants, bounds);
        Report { plc: self, roots, outcome }
    }
}

/// Executes operations from the key state of this name. Returns the outputs after them.
///
/// # Errors
/// The first [`Promise`] that is broken.
///
/// # Panics
/// Panics without a key state of this name, and at an operation that an exploration does not know.
pub fn replay(plc: PlcKind, root: &str, operations: &[Operation]) -> Result<Outputs, Promise> {
    let mut roots = roots::roots(plc.actions()).into_iter();
    let mut plant = roots.find(|known| known.name == root).expect("a key state of this name").plant;
    operations.iter().try_for_each(|operation| plant.take(operation))?;
    Ok(plant.outputs())
}

/// Result of an exploration.
#[derive(Debug)]
pub struct Report {
    plc: PlcKind,
    roots: Vec<Root>,
    outcome: Outcome<Promise>,
}

impl Report {
    /// Returns the broken promises in order of the number of actions.
    #[must_use]
    pub fn broken(&self) -> Vec<Promise> {
        self.outcome.broken.iter().map(|broken| broken.promise).collect()
    }

    /// Returns the expected situations that did not occur. An exploration that misses them proves little.
    #[must_use]
    pub fn unseen(&self) -> Vec<&'static str> {
        plant::SIGHTS
            .iter()
            .enumerate()
            .filter(|(bit, _)| self.outcome.sights & 1 << bit == 0)
            .map(|(_, (name, _))| *name)
            .collect()
    }
}

impl fmt::Display for Report {
    /// Writes figures, followed by the shortest way to break each broken promise, also as operations for [`replay`].
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Outcome { states, tried, new_at, complete_to, broken, .. } = &self.outcome;
        let Self { plc, roots, .. } = self;
        write!(f, "{plc:?}: {states} states, {tried} actions tried, from {} key states; ", roots.len())?;
        write!(f, "all orders of {complete_to} actions; new states by depth: {new_at:?}")?;
        for broken in broken {
            let root = &roots[broken.path.root()];
            let actions: Vec<u32> = (0..broken.len).map(|step| broken.path.action(step)).collect();
            write!(f, "\n{:?} is broken in {} ways; ", broken.promise, broken.ways)?;
            write!(f, "the shortest, from \"{}\":{}", root.name, root.plant.report(&actions))?;
        }
        Ok(())
    }
}
