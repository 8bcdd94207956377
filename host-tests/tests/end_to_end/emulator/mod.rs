//! The flashed image in the emulator: on wires, on its buses, and with masters that others wrote.
//!
//! What holds of any board runs on each of them: the default board in QEMU, the Pico in rp2040js. What is left to one of them
//! asks for its registers.

/// Makes a test for each board of functions that take a board.
macro_rules! on_both_boards {
    ($($test:ident),+ $(,)?) => {
        mod on_the_default_board {
            use super::super::Board;
            $(
                #[test]
                #[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
                fn $test() {
                    super::$test(Board::DEFAULT);
                }
            )+
        }

        mod on_the_pico_in_rp2040js {
            use super::super::Board;
            $(
                #[test]
                #[ignore = "needs rp2040js and the firmware image: run `cargo xtask test`"]
                fn $test() {
                    super::$test(Board::PICO);
                }
            )+
        }
    };
}

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

use std::path::PathBuf;

/// A board, by what the names of its images' variables end in.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Board(&'static str);

impl Board {
    const DEFAULT: Self = Self("");
    const PICO: Self = Self("_PICO");

    /// Its firmware image that this variable names.
    fn image(self, variable: &str) -> PathBuf {
        let variable = format!("{variable}{}", self.0);
        std::env::var_os(&variable)
            .unwrap_or_else(|| panic!("{variable} names no firmware image: run `cargo xtask test`"))
            .into()
    }
}

/// The default board's firmware image that this variable names.
fn image(variable: &str) -> PathBuf {
    Board::DEFAULT.image(variable)
}
