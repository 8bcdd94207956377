//! Properties that must hold for any input bytes. There is one body per fuzz target; it panics when a property is
//! violated.
//!
//! | body | property |
//! |---|---|
//! | [`frames`] | the parser finds the same frames as a reader of the whole capture, however the bytes are split |
//! | [`typed`] | decoded messages encode to the same bytes |
//! | [`session`] | a request is sent at most once, and every request completes |
//! | [`controller`] | commands follow only the edges that request them |
//! | [`gcl`] | a parsed line is written identically, and an invalid one is answered |
//! | [`modbus`] | only intact frames for this unit are answered, as the specification requires |
//! | [`profibus`] | each telegram has the effect of the DP model; no output without data exchange |
//! | [`profinet`] | no output without data exchange; only received outputs; due actions happen once |
//! | [`ethernetip`] | connections, outputs and packets equal a model's, for two originators and damaged messages |
//! | [`can`] | the reassembler finds the same messages as a reader of the whole capture |
//! | [`storage`] | loaded settings were saved completely; saving works with any flash content |
//! | [`bridge`] | no motion without an edge, timely FAST STOP, true outputs, and settings as written, for any gripper, line, wires, Modbus bus and service port |
//! | [`bridge_can`] | the same, with the gripper and a CANopen master on a CAN bus |
//! | [`bridge_profibus`] | the same, with PROFIBUS masters; each answer is timely or omitted |
//! | [`bridge_gateway`] | the same in a gateway, with two Modbus/TCP masters, pauses of the computer, and lost connections |
//!
//! cargo-fuzz runs the bodies (`cargo xtask fuzz`, targets in `host-tests/fuzz`). The test `fuzz_smoke` runs them on
//! stable Rust over the committed seeds and [`generated`] inputs; `cargo xtask fuzz --inputs N` runs more inputs.

use std::ops::Range;
use std::thread;

use generate::Pieces::{Hex, Text};

use crate::operation::Operation;

mod bridge;
mod bridge_can;
mod bridge_gateway;
mod bridge_profibus;
mod can;
mod controller;
mod ethernetip;
mod frames;
mod gcl;
mod generate;
mod gripper;
mod input;
mod modbus;
mod profibus;
mod profinet;
mod rtu_line;
mod session;
mod storage;
pub(crate) mod tap;
mod tracked;
mod typed;
mod whole;

pub use bridge::bridge;
pub use bridge_can::bridge_can;
pub use bridge_gateway::bridge_gateway;
pub use bridge_profibus::bridge_profibus;
pub use can::can;
pub use controller::controller;
pub use ethernetip::ethernetip;
pub use frames::frames;
pub use gcl::gcl;
pub use generate::{Pieces, generated};
pub use modbus::modbus;
pub use profibus::profibus;
pub use profinet::profinet;
pub use session::session;
pub use storage::storage;
pub use typed::typed;

/// A body; its name is also that of a fuzz target and of a folder of seeds.
#[derive(Clone, Copy)]
pub struct Body {
    /// The common name.
    pub name: &'static str,
    /// Panics when a property is violated.
    pub run: fn(&[u8]),
    /// Pieces for [`generated`] inputs.
    pub pieces: Pieces,
}

/// Number of [`generated`] inputs in the test `fuzz_smoke`.
pub const SMOKE_INPUTS: u32 = 60_000;

/// Number of threads that share the inputs.
const THREADS: usize = 2;

impl Body {
    /// Returns the body with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        ALL.into_iter().find(|body| body.name == name)
    }

    /// Runs the body over the [`generated`] inputs with these numbers.
    ///
    /// # Panics
    /// Panics when a property is violated, and prints the input after the message.
    pub fn run_generated(&self, numbers: Range<u32>) {
        let pieces = self.pieces.list();
        thread::scope(|threads| {
            for first in 0..THREADS {
                let pieces = &pieces;
                let numbers = numbers.clone().skip(first).step_by(THREADS);
                threads.spawn(move || {
                    for number in numbers {
                        let case = Case { input: generated(number, pieces), number };
                        (self.run)(&case.input);
                    }
                });
            }
        });
    }
}

/// Functions of a whole-bridge body: one decodes an input into the byte that selects the start and a script, one plays them.
type Whole = (fn(&[u8]) -> (u8, Vec<Operation>), fn(u8, &[Operation]));

fn whole_bridge(body: &str) -> Whole {
    use whole::{decode, play};
    match body {
        "bridge" => (decode::<bridge::Model>, play::<bridge::Model>),
        "bridge_can" => (decode::<bridge_can::Model>, play::<bridge_can::Model>),
        "bridge_profibus" => (decode::<bridge_profibus::Model>, play::<bridge_profibus::Model>),
        "bridge_gateway" => (decode::<bridge_gateway::Model>, play::<bridge_gateway::Model>),
        _ => panic!("{body} is not a whole-bridge body"),
    }
}

/// Decodes an input of a whole-bridge body: the byte that selects the start, and the script.
///
/// # Panics
/// Panics without such a body.
#[must_use]
pub fn decode(body: &str, data: &[u8]) -> (u8, Vec<Operation>) {
    whole_bridge(body).0(data)
}

/// Plays a script on a whole-bridge body, as a failure prints it. `choice` selects the start.
///
/// # Panics
/// Panics when a property is violated, and without such a body.
pub fn play(body: &str, choice: u8, script: &[Operation]) {
    whole_bridge(body).1(choice, script);
}

/// Prints its input when a body panics.
struct Case {
    input: Vec<u8>,
    number: u32,
}

impl Drop for Case {
    fn drop(&mut self) {
        if thread::panicking() {
            eprintln!("input {}: {:02X?}", self.number, self.input);
        }
    }
}

/// Combines the pieces of a whole-bridge body: start, wires, PLC and gripper.
const fn of_bridge([begins, plc]: [&'static [&'static str]; 2]) -> [&'static [&'static str]; 4] {
    [begins, generate::WIRES, plc, generate::GRIPPER]
}

/// All bodies.
pub const ALL: [Body; 15] = [
    Body { name: "frames", run: frames, pieces: Hex(&[generate::BINARY]) },
    Body { name: "typed", run: typed, pieces: Hex(&[generate::BINARY]) },
    Body { name: "session", run: session, pieces: Hex(&[generate::BINARY]) },
    Body { name: "controller", run: controller, pieces: Hex(&[generate::BINARY]) },
    Body { name: "bridge", run: bridge, pieces: Hex(&of_bridge(generate::BRIDGE)) },
    Body { name: "bridge_can", run: bridge_can, pieces: Hex(&of_bridge(generate::BRIDGE_CAN)) },
    Body {
        name: "bridge_profibus",
        run: bridge_profibus,
        pieces: Hex(&of_bridge(generate::BRIDGE_PROFIBUS)),
    },
    Body {
        name: "bridge_gateway",
        run: bridge_gateway,
        pieces: Hex(&[generate::BRIDGE_GATEWAY, generate::GRIPPER]),
    },
    Body { name: "gcl", run: gcl, pieces: Text(generate::TEXT) },
    Body { name: "can", run: can, pieces: Hex(&[generate::BINARY]) },
    Body { name: "modbus", run: modbus, pieces: Hex(&[generate::BINARY]) },
    Body { name: "storage", run: storage, pieces: Hex(&[generate::STORAGE]) },
    Body { name: "profibus", run: profibus, pieces: Hex(&[generate::PROFIBUS]) },
    Body { name: "profinet", run: profinet, pieces: Hex(&[generate::PROFINET]) },
    Body { name: "ethernetip", run: ethernetip, pieces: Hex(&[generate::ETHERNETIP]) },
];
