//! The demonstration: the released image in an emulator, a virtual gripper on its line, a PLC on its wires, and a
//! live trace. Run it with `cargo xtask demo`.

#[cfg(unix)]
mod options;
#[cfg(unix)]
mod recording;
#[cfg(unix)]
mod scenario;

#[cfg(unix)]
fn main() -> std::process::ExitCode {
    use std::process::ExitCode;

    match recording::play(<options::Options as clap::Parser>::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(not(unix))]
fn main() -> std::process::ExitCode {
    eprintln!("error: the demonstration needs Unix sockets to connect to the emulator; run it on Linux");
    std::process::ExitCode::FAILURE
}
