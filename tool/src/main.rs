//! The program `wsg`; see the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    wsg_tool::run(std::env::args_os()).into()
}
