//! The program `wsg-sim`; see the module `program` of the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    wsg_sim::program::run(std::env::args_os().skip(1)).into()
}
