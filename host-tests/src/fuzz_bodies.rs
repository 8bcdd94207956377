//! What must hold for any bytes at all: one body for each fuzz target, which panics where something does not.
//!
//! | body | what it holds |
//! |---|---|
//! | [`frames`] | the parser finds what a reader of the whole capture finds, however the bytes are cut |
//! | [`typed`] | what decodes encodes to the same bytes |
//! | [`session`] | a request leaves once at the most, and every one comes to an end |
//! | [`controller`] | a command only after the edge that asks for it |
//! | [`gcl`] | what is understood of a line is written the same, and what is not gets an answer |
//! | [`modbus`] | an answer only to an intact frame for this unit, and what the specification says it is |
//! | [`profibus`] | what the DP model says of each telegram, and no output without data exchange |
//! | [`profinet`] | no output without data exchange and none but those that came, and what is due is done once |
//! | [`can`] | the reassembler finds what a reader of the whole capture finds |
//! | [`storage`] | what is loaded was saved whole, and a save works on whatever the flash holds |
//! | [`bridge`] | no motion without an edge, FAST STOP in time, true outputs, and settings as they were written, whatever gripper, line, wires, Modbus bus and service port do |
//! | [`bridge_can`] | the same, with the gripper and a CANopen master on a CAN bus |
//! | [`bridge_profibus`] | the same, with masters on PROFIBUS, and each answer in time or not at all |
//!
//! cargo-fuzz runs them (`cargo xtask fuzz`, targets in `host-tests/fuzz`); the test `fuzz_smoke` runs them on stable Rust
//! over the committed seeds and over [`generated`] inputs, `cargo xtask fuzz --inputs N` over more of these.

use std::ops::Range;
use std::thread;

use generate::Pieces::{Hex, Text};

mod asked;
mod bridge;
mod bridge_can;
mod bridge_profibus;
mod can;
mod controller;
mod frames;
mod gcl;
mod generate;
mod gripper;
mod input;
mod modbus;
mod oracle;
mod outputs;
mod overheard;
mod profibus;
mod profinet;
mod rtu_line;
mod session;
mod stops;
mod storage;
mod tap;
mod told;
mod typed;
mod whole;

pub use bridge::bridge;
pub use bridge_can::bridge_can;
pub use bridge_profibus::bridge_profibus;
pub use can::can;
pub use controller::controller;
pub use frames::frames;
pub use gcl::gcl;
pub use generate::{Pieces, generated};
pub use modbus::modbus;
pub use profibus::profibus;
pub use profinet::profinet;
pub use session::session;
pub use storage::storage;
pub use typed::typed;

/// A body, which is also a fuzz target and a folder of seeds.
#[derive(Clone, Copy)]
pub struct Body {
    /// The name of all three.
    pub name: &'static str,
    /// Panics where something does not hold.
    pub run: fn(&[u8]),
    /// What [`generated`] inputs for it are made of.
    pub pieces: Pieces,
}

/// How many [`generated`] inputs the test `fuzz_smoke` takes, from number 0 on.
pub const SMOKE_INPUTS: u32 = 60_000;

/// Inputs are shared out among threads: half of them each, odd and even.
const THREADS: usize = 2;

impl Body {
    /// The body of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        ALL.into_iter().find(|body| body.name == name)
    }

    /// Runs it over the [`generated`] inputs of these numbers.
    ///
    /// # Panics
    /// Where something does not hold; behind what the body says of it stands the input.
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

/// Says which input it was, when a body panics.
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

/// Pieces for a body of the whole bridge: how a case begins, what its PLC does, and what all of them have.
const fn of_bridge([begins, plc]: [&'static [&'static str]; 2]) -> [&'static [&'static str]; 4] {
    [begins, generate::WIRES, plc, generate::GRIPPER]
}

/// Every body.
pub const ALL: [Body; 13] = [
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
    Body { name: "gcl", run: gcl, pieces: Text(generate::TEXT) },
    Body { name: "can", run: can, pieces: Hex(&[generate::BINARY]) },
    Body { name: "modbus", run: modbus, pieces: Hex(&[generate::BINARY]) },
    Body { name: "storage", run: storage, pieces: Hex(&[generate::STORAGE]) },
    Body { name: "profibus", run: profibus, pieces: Hex(&[generate::PROFIBUS]) },
    Body { name: "profinet", run: profinet, pieces: Hex(&[generate::PROFINET]) },
];
