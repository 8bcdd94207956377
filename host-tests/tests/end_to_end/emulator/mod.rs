//! The released image in the emulator: on wires, on its buses, and with third-party masters.
//!
//! Board-independent tests run on the default board in QEMU and on the Pico in rp2040js. The other tests read registers of
//! one board.

/// Generates a test for each board from functions that take a board.
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

use std::path::PathBuf;

/// A board, identified by the suffix of its images' environment variables.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Board(&'static str);

impl Board {
    const DEFAULT: Self = Self("");
    const PICO: Self = Self("_PICO");

    /// Returns the path of this board's firmware image from the variable.
    fn image(self, variable: &str) -> PathBuf {
        let variable = format!("{variable}{}", self.0);
        std::env::var_os(&variable)
            .unwrap_or_else(|| {
                panic!("{variable} must hold the path of a firmware image: run `cargo xtask test`")
            })
            .into()
    }
}

/// Returns the path of the default board's firmware image from the variable.
fn image(variable: &str) -> PathBuf {
    Board::DEFAULT.image(variable)
}
