//! The emulated board between your Modbus master and a virtual gripper:
//!
//! ```sh
//! cargo xtask build                                   # prints the image's path
//! cargo run -p host-tests --example bus -- IMAGE 2>frames     # prints the terminals for masters
//! ```
//!
//! A part of 20 mm is between the fingers. FAST_STOP_OK was low at power-up and is now high, so the first command is
//! STOP/ACK. The flash is initially empty; SAVE lasts until the program ends.

use anyhow::Result;

#[cfg(unix)]
fn main() -> Result<()> {
    use anyhow::Context;
    use host_tests::emulator::stm_board::B_L475E_IOT01A;
    use host_tests::emulator::{Emulator, Extras};
    use host_tests::flash_controller::FlashController;
    use host_tests::{gripper_end::GripperEnd, terminal::Terminal, trace::Trace};
    use wsg_bridge_fw::io::Inputs;
    use wsg_sim::{Config, Part};

    let image =
        std::env::args_os().nth(1).context("expected the path of an image; `cargo xtask build` prints it")?;
    let models = FlashController::new(&B_L475E_IOT01A.flash).models();
    let mut board = Emulator::start_with(image.as_ref(), Extras { models, ..Extras::default() })?;
    board.set_input(Inputs::FAST_STOP_OK, true)?;
    let terminal = Terminal::to(board.take_modbus_line().context("the bus is already in use")?)?;
    let service = Terminal::to(board.take_service_line().context("the service port is already in use")?)?;
    println!("{}  (bus: Modbus RTU, unit 1, no parity; press Ctrl-C to quit)", terminal.path);
    println!("{}  (service port: Modbus RTU, unit 1, no parity)", service.path);
    // Frames go to standard error, where `2>frames` keeps them apart from the paths.
    let trace = Trace::new(vec![Box::new(std::io::stderr())]);
    let config = Config { part: Part::of_width(20.0), ..Config::default() };
    let line = board.take_gripper_line().context("the gripper's line is already in use")?;
    let _gripper = GripperEnd::start(line, board.clock(), config, &trace)?;
    loop {
        std::thread::park();
    }
}

#[cfg(not(unix))]
fn main() -> Result<()> {
    anyhow::bail!("the emulator needs Unix sockets")
}
