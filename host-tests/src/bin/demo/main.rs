//! The demonstration: the released image in an emulator, a virtual gripper on its line, a PLC on its wires, and a
//! live trace. Run it with `cargo xtask demo`.

mod options;
mod recording;
mod scenario;

use std::process::ExitCode;

fn main() -> ExitCode {
    match recording::play(<options::Options as clap::Parser>::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
