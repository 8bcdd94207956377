//! Measures cyclic exchange over a long time, on a quiet computer and beside busy loops: EtherNet/IP at an RPI of 10 ms with `wsg-sim`
//! and through `wsg gateway`, with time-outs after 80 ms, and PROFINET at 8 ms through `wsg gateway`, with time-outs after 200 ms.
//! Prints a row for each, and fails if a connection timed out. Linux only, as root.
//!
//! ```sh
//! cargo build --release -p wsg-sim -p wsg-tool --bins && cargo run --release -p host-tests --example cyclic -- --seconds 600
//! ```
//!
//! `--loops 0,2` are the numbers of busy loops, `--only NAME` selects an exchange. `wsg-sim` and the gateway have the real-time
//! priority of the gateway's systemd unit, or with `--ordinary` none. The PLCs, and the gripper of a gateway, always have one: they
//! replace devices with processors of their own. PROFINET requires `profinet-py` in the Python that `WSG_MODBUS_PYTHON` names.

#[cfg(target_os = "linux")]
mod exchanges;

#[cfg(target_os = "linux")]
fn main() -> anyhow::Result<std::process::ExitCode> {
    exchanges::measure(&clap::Parser::parse())
}

#[cfg(not(target_os = "linux"))]
fn main() {
    eprintln!("this example requires Linux");
}
