//! Exhaustive exploration of the bridge: every order of events up to a depth, from power-up and from each key state.
//!
//! The bridge is the library that the image is made of. Beside it stand a gripper reduced to its states, a line that delays,
//! drops, repeats or truncates what the gripper says, and a PLC. A breadth-first search tries every action in every state,
//! visits equal states once, and checks each [`Promise`] of docs/wiring.md and docs/registers.md after every turn.
//!
//! | module | holds |
//! |---|---|
//! | `action` | what can happen |
//! | `plant` | bridge, gripper, line and PLC, and what an action does to them |
//! | `answers` | what the gripper has said and the line has not delivered |
//! | `promises` | what must hold |
//! | `roots` | the states that an exploration starts from |
//! | `search` | breadth-first search |
//! | `key` | when two states are equal |
//!
//! It does not cover half-sent frames and timing within a message: see [`fuzz_bodies`](crate::fuzz_bodies) and
//! [`fault_sweep`](crate::fault_sweep).

mod action;
mod answers;
mod key;
mod plant;
mod promises;
mod roots;
mod search;

use std::fmt;

pub use promises::Promise;

use action::{Action, BUS, WIRES};
use roots::Root;
use search::{Outcome, explore};

/// How far to go.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Actions in a row, 12 at most.
    pub depth: u32,
    /// The search ends once it has met this many states.
    pub states: u64,
}

/// A PLC, and so a set of actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plc {
    /// It has wires and no bus.
    Wires,
    /// It writes images over Modbus, and has the wires GRIP, STOP_ACK and FAST_STOP_OK.
    Bus,
}

impl Plc {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Wires, Self::Bus];

    const fn actions(self) -> &'static [Action] {
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

/// What an exploration found.
#[derive(Debug)]
pub struct Report {
    plc: Plc,
    roots: Vec<Root>,
    outcome: Outcome<Promise>,
}

impl Report {
    /// How many different states it met.
    #[must_use]
    pub const fn states(&self) -> u64 {
        self.outcome.states
    }

    /// The promises that were broken, the one with the fewest actions first.
    #[must_use]
    pub fn broken(&self) -> Vec<Promise> {
        self.outcome.broken.iter().map(|broken| broken.promise).collect()
    }

    /// The situations that should have occurred and did not: an exploration that misses them proves little.
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
    /// Figures, then for each broken promise the shortest way to break it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Outcome { states, tried, new_at, complete_to, broken, .. } = &self.outcome;
        let Self { plc, roots, .. } = self;
        write!(f, "{plc:?}: {states} states, {tried} actions tried, from {} key states; ", roots.len())?;
        write!(f, "all orders of {complete_to} actions; new states by depth: {new_at:?}")?;
        for broken in broken {
            let root = &roots[broken.path.root()];
            let actions = (0..broken.len).map(|step| broken.path.action(step));
            write!(f, "\n{:?} is broken in {} ways; ", broken.promise, broken.ways)?;
            write!(f, "the shortest, from \"{}\":{}", root.name, root.plant.tell(actions))?;
        }
        Ok(())
    }
}
