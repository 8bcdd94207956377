//! The boards that there are, as data.

use anyhow::{Context, Result};

/// A board that the firmware runs on.
#[derive(Debug, PartialEq)]
pub(crate) struct Board {
    /// The binary's name, and the image's.
    pub(crate) name: &'static str,
    /// The board's crate.
    pub(crate) package: &'static str,
    /// The target of its core.
    pub(crate) triple: &'static str,
    /// The microcontroller's name for probe-rs.
    pub(crate) chip: &'static str,
    /// What the names of its tests' environment variables end in. A board that no emulator has was never run.
    pub(crate) emulated: Option<&'static str>,
    /// Whether its boot ROM takes an image as UF2, which is then made beside the ELF file.
    pub(crate) takes_uf2: bool,
    /// What the image may take of flash.
    pub(crate) flash_limit: u64,
}

/// All of them, the default board first.
pub(crate) static BOARDS: [Board; 3] = [
    Board {
        name: "b-l475e-iot01a",
        package: "wsg-b-l475e-iot01a",
        triple: "thumbv7em-none-eabihf",
        chip: "STM32L475VG",
        emulated: Some(""),
        takes_uf2: false,
        // 64 KiB before settings stayed and the service port came; 4 KB of it are the start values of the static RAM.
        flash_limit: 80 * 1024,
    },
    Board {
        name: "pico",
        package: "wsg-pico",
        triple: "thumbv6m-none-eabi",
        chip: "RP2040",
        emulated: Some("_PICO"),
        takes_uf2: true,
        // Of 2 MiB. A Cortex-M0+ takes more instructions for the same, and there is a USB device in it.
        flash_limit: 96 * 1024,
    },
    Board {
        name: "nucleo-g474re",
        package: "wsg-nucleo-g474re",
        triple: "thumbv7em-none-eabihf",
        chip: "STM32G474RE",
        emulated: None,
        takes_uf2: false,
        flash_limit: 80 * 1024,
    },
];

/// QEMU's name for the default board. QEMU is asked for it, never for its version: distributions backport.
pub(crate) const MACHINE: &str = "b-l475e-iot01a";

impl Board {
    /// The name of a figure of this board: of the default board by itself.
    pub(crate) fn figure(&self, what: &str) -> String {
        if self == <&Self>::default() { what.to_owned() } else { format!("{what}, {}", self.name) }
    }

    /// The board of this name.
    pub(crate) fn named(name: &str) -> Result<&'static Self> {
        BOARDS.iter().find(|board| board.name == name).with_context(|| {
            let names = BOARDS.each_ref().map(|board| board.name);
            format!("there is no board {name}; there are {}", names.join(", "))
        })
    }
}

impl Default for &Board {
    fn default() -> Self {
        &BOARDS[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_found_by_its_name_and_the_default_is_the_one_that_qemu_has() {
        assert_eq!(<&Board>::default().name, MACHINE);
        assert_eq!(Board::named("pico").unwrap().triple, "thumbv6m-none-eabi");
        let unknown = Board::named("arduino").unwrap_err().to_string();
        assert_eq!(unknown, "there is no board arduino; there are b-l475e-iot01a, pico, nucleo-g474re");
    }
}
