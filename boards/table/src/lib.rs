//! The table of boards, from which images are built, tested and delivered.

use anyhow::{Context, Result, ensure};

/// A board supported by the firmware.
#[derive(Debug, PartialEq)]
pub struct Board {
    /// Name of the board, its binary and its image. The package of its crate has the prefix `wsg-`.
    pub name: &'static str,
    /// Target triple of its core.
    pub triple: &'static str,
    /// Microcontroller, as named by probe-rs.
    pub chip: &'static str,
    /// Suffix of the environment variables for its tests, or `None` if the board is not emulated.
    pub emulated: Option<&'static str>,
    /// Whether its boot ROM accepts UF2 files. If so, one is built in addition to the ELF file.
    pub takes_uf2: bool,
    /// Flash limit of the image in bytes.
    pub flash_limit: u64,
    /// Flash limit of the image for slot A in bytes. It also contains the check and the receiver of signed images.
    pub slot_flash_limit: u64,
    /// Lines of START-HERE.txt about the files of the firmware.
    pub files: &'static str,
    /// Words of its documents that name a part, a file or a program of this board. Documents of boards without such a word
    /// must not contain it.
    pub words: &'static [&'static str],
}

/// All boards, the default board first.
pub static BOARDS: [Board; 3] = [
    Board {
        name: "b-l475e-iot01a",
        triple: "thumbv7em-none-eabihf",
        chip: "STM32L475VG",
        emulated: Some(""),
        takes_uf2: false,
        // 64 KiB before persistent settings and the service port were added. 4 KB hold the initial values of the static RAM.
        flash_limit: 80 * 1024,
        slot_flash_limit: 96 * 1024,
        files: "\
wsg-bridge.bin       the firmware: copy it to the USB drive that the board provides
wsg-bridge.elf       the same firmware for programming tools, such as STM32CubeProgrammer",
        words: &[
            "ST",
            "ST-Link",
            "STM32CubeProgrammer",
            "STM32_Programmer_CLI",
            "st-flash",
            "LED1",
            "LED2",
            "HSI16",
            "RM0351",
        ],
    },
    Board {
        name: "pico",
        triple: "thumbv6m-none-eabi",
        chip: "RP2040",
        emulated: Some("_PICO"),
        takes_uf2: true,
        // Of 2 MiB. A Cortex-M0+ needs more instructions, and the image contains a USB device.
        flash_limit: 96 * 1024,
        slot_flash_limit: 112 * 1024,
        files: "\
wsg-bridge.uf2       the firmware: hold BOOTSEL while you connect USB, and copy it to the
                     drive that appears
wsg-bridge.elf       the same firmware for debug probes
wsg-bridge.bin       the same firmware as bytes of the flash, from 10000000h",
        words: &["Pico", "wsg-bridge.uf2", "uf2", "BOOTSEL", "MCP2515", "CDC"],
    },
    Board {
        name: "nucleo-g474re",
        triple: "thumbv7em-none-eabihf",
        chip: "STM32G474RE",
        emulated: Some("_NUCLEO"),
        takes_uf2: false,
        flash_limit: 80 * 1024,
        slot_flash_limit: 96 * 1024,
        files: "\
wsg-bridge.bin       the firmware: copy it to the USB drive that the board provides
wsg-bridge.elf       the same firmware for programming tools, such as STM32CubeProgrammer",
        words: &[
            "ST",
            "ST-Link",
            "STM32CubeProgrammer",
            "STM32_Programmer_CLI",
            "st-flash",
            "LD2",
            "Morpho",
            "CN7",
            "CN10",
            "RM0440",
            "PA13",
            "PA15",
            "PB3",
            "PB4",
            "PB6",
            "PB8",
            "PC13",
        ],
    },
];

/// QEMU's name for the default board. Set-up checks for this machine and not for QEMU's version, because distributions backport.
pub const MACHINE: &str = "b-l475e-iot01a";

impl Board {
    /// Returns the name of a figure of this board. The default board has no suffix.
    #[must_use]
    pub fn figure(&self, what: &str) -> String {
        if self == <&Self>::default() { what.to_owned() } else { format!("{what}, {}", self.name) }
    }

    /// Returns the name of the default board.
    #[must_use]
    pub fn default_name() -> &'static str {
        BOARDS[0].name
    }

    /// Returns cargo's arguments that select the crate, features and target of the image, with and without the boot loader.
    #[must_use]
    pub fn selection(&self) -> String {
        format!("--package wsg-{} --features boot,slot --target {}", self.name, self.triple)
    }

    /// Finds an emulated board by name.
    ///
    /// # Errors
    /// Fails if there is no such board, or no emulator has it.
    pub fn emulated(name: &str) -> Result<&'static Self> {
        let board = Self::named(name)?;
        ensure!(board.emulated.is_some(), "the board {name} is not emulated");
        Ok(board)
    }

    /// Finds a board by name.
    ///
    /// # Errors
    /// Fails if there is no such board; the message lists the boards.
    pub fn named(name: &str) -> Result<&'static Self> {
        BOARDS.iter().find(|board| board.name == name).with_context(|| {
            let names = BOARDS.each_ref().map(|board| board.name);
            format!("unknown board {name}; expected one of {}", names.join(", "))
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
    fn board_is_found_by_name_and_the_default_runs_in_qemu() {
        assert_eq!(<&Board>::default().name, MACHINE);
        assert_eq!(Board::named("pico").unwrap().triple, "thumbv6m-none-eabi");
        let unknown = Board::named("arduino").unwrap_err().to_string();
        assert!(
            unknown.starts_with("unknown board arduino; expected one of b-l475e-iot01a, pico, "),
            "{unknown}"
        );
    }
}
