//! The released image in the emulator: on wires, on its buses, and with third-party masters.
//!
//! Board-independent tests run on every emulated board: two in QEMU, the Pico in rp2040js. The other tests read registers of one
//! board.

/// The list of emulated boards: generates a test on each for functions that take a `Board`, or its CAN `controller` as a type.
/// `board_in_qemu` and `controller_in_qemu` leave out boards of other emulators.
macro_rules! on_every_board {
    ($how:ident => $($test:ident),+ $(,)?) => {
        on_board!(on_the_default_board, DEFAULT, host_tests::bxcan::Bxcan, $how => $($test),+);
        on_board!(on_the_nucleo, NUCLEO, host_tests::fdcan::Fdcan, $how => $($test),+);
        on_board!(on_the_pico_in_rp2040js, PICO, host_tests::mcp2515::Mcp2515, $how => $($test),+);
    };
}

/// Generates the tests of a board.
macro_rules! on_board {
    (on_the_pico_in_rp2040js, $board:ident, $controller:ty, board_in_qemu => $($test:ident),+) => {};
    (on_the_pico_in_rp2040js, $board:ident, $controller:ty, controller_in_qemu => $($test:ident),+) => {};
    ($module:ident, $board:ident, $controller:ty, controller_in_qemu => $($test:ident),+) => {
        on_board!($module, $board, $controller, controller => $($test),+);
    };
    ($module:ident, $board:ident, $controller:ty, controller => $($test:ident),+) => {
        mod $module {
            $(
                #[test]
                #[ignore = "needs an emulator and the firmware images: run `cargo xtask test`"]
                fn $test() {
                    host_tests::rig::unless_disturbed(super::$test::<$controller>);
                }
            )+
        }
    };
    ($module:ident, $board:ident, $controller:ty, $how:ident => $($test:ident),+) => {
        mod $module {
            use super::super::Board;
            $(
                #[test]
                #[ignore = "needs an emulator and the firmware image: run `cargo xtask test`"]
                fn $test() {
                    host_tests::rig::unless_disturbed(|| super::$test(Board::$board));
                }
            )+
        }
    };
}

mod boot_loader;
mod c_program;
mod can;
mod line_errors;
mod line_rates;
mod masters;
mod modbus;
mod pico;
mod profibus;
mod quick_start;
mod service_port;
mod stored_settings;
mod watchdog;
mod wires;

use std::fmt::Debug;
use std::path::PathBuf;
use std::time::Instant;

use host_tests::emulator::stm_board::{B_L475E_IOT01A, NUCLEO_G474RE, StmBoard};
use host_tests::emulator::{Emulator, Extras};
use host_tests::flash_controller::FlashController;
use host_tests::modbus_master::Master;
use host_tests::rig::{MOTION_PATIENCE, Rig};
use host_tests::trace::Trace;
use wsg_sim::Config;

/// Environment variable of the released image, with default settings.
const RELEASED: &str = "WSG_FIRMWARE_ELF";

/// A board: the suffix of its images' environment variables, and its values in QEMU.
#[derive(Clone, Copy)]
struct Board(&'static str, Option<&'static StmBoard>);

impl Board {
    const DEFAULT: Self = Self("", Some(&B_L475E_IOT01A));
    const NUCLEO: Self = Self("_NUCLEO", Some(&NUCLEO_G474RE));
    const PICO: Self = Self("_PICO", None);

    /// Returns the values of a board in QEMU.
    fn in_qemu(self) -> &'static StmBoard {
        self.1.expect("the board must be one in QEMU")
    }

    /// Returns an empty flash of a board in QEMU.
    fn flash(self) -> FlashController {
        FlashController::new(&self.in_qemu().flash)
    }

    /// Returns the path of this board's firmware image from the variable.
    fn image(self, variable: &str) -> PathBuf {
        let variable = format!("{variable}{}", self.0);
        std::env::var_os(&variable)
            .unwrap_or_else(|| {
                panic!("{variable} must hold the path of a firmware image: run `cargo xtask test`")
            })
            .into()
    }

    /// Starts the firmware image from the variable.
    fn start(self, variable: &str, extras: Extras<'_>) -> Emulator {
        Emulator::start_with(&self.image(variable), extras).unwrap()
    }

    /// Starts the firmware image from the variable, with a gripper on the serial line.
    fn rig(self, variable: &str, extras: Extras<'_>, config: Config) -> Rig {
        Rig::of(self.start(variable, extras), None, config, Trace::new(vec![])).unwrap()
    }
}

/// Waits until the bridge has an input image, because its gripper responds.
fn await_gripper(master: &mut Master) {
    let read = || master.ask(&[4, 0, 0, 0, 6]).unwrap();
    wait_until("the gripper to respond", read, |answer| answer[0] == 4);
}

/// Repeats `look` until its result satisfies `wanted`, and returns it. Panics with the last result after [`MOTION_PATIENCE`].
fn wait_until<T: Debug>(what: &str, mut look: impl FnMut() -> T, wanted: impl Fn(&T) -> bool) -> T {
    let bound = Instant::now() + MOTION_PATIENCE;
    loop {
        let seen = look();
        if wanted(&seen) {
            return seen;
        }
        assert!(Instant::now() < bound, "time-out; expected {what}; seen {seen:?}");
    }
}
