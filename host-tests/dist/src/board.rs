//! The boards of a release, as their folders present them.

use anyhow::{Context, Result};

/// A board and its image.
#[derive(Debug, PartialEq)]
pub(crate) struct Board {
    /// Name of the board. The package of its crate has the prefix `wsg-`.
    pub(crate) name: &'static str,
    /// Target of its core.
    pub(crate) target: &'static str,
    /// Whether its boot ROM accepts UF2 files.
    pub(crate) takes_uf2: bool,
    /// Lines of the README about the files of the image.
    pub(crate) files: &'static str,
}

/// All boards, the default board first.
pub(crate) static BOARDS: [Board; 3] = [
    Board {
        name: "b-l475e-iot01a",
        target: "thumbv7em-none-eabihf",
        takes_uf2: false,
        files: "\
wsg-bridge.bin       the image: copy it to the USB drive that the board provides
wsg-bridge.elf       the same image for programming tools, such as STM32CubeProgrammer",
    },
    Board {
        name: "pico",
        target: "thumbv6m-none-eabi",
        takes_uf2: true,
        files: "\
wsg-bridge.uf2       the image: hold BOOTSEL while you connect USB, and copy it to the
                     drive that appears
wsg-bridge.elf       the same image for debug probes
wsg-bridge.bin       the same image as bytes of the flash, from 10000000h",
    },
    Board {
        name: "nucleo-g474re",
        target: "thumbv7em-none-eabihf",
        takes_uf2: false,
        files: "\
This image has never been executed: no emulator has the board NUCLEO-G474RE.

wsg-bridge.bin       the image: copy it to the USB drive that the board provides
wsg-bridge.elf       the same image for programming tools, such as STM32CubeProgrammer",
    },
];

impl Board {
    /// Finds a board by name.
    pub(crate) fn named(name: &str) -> Result<&'static Self> {
        BOARDS.iter().find(|board| board.name == name).with_context(|| {
            let names = BOARDS.each_ref().map(|board| board.name);
            format!("unknown board {name}; expected one of {}", names.join(", "))
        })
    }

    /// Returns cargo's arguments that select the crate, features and target of the image.
    pub(crate) fn selection(&self) -> String {
        format!("--package wsg-{} --features firmware --target {}", self.name, self.target)
    }
}
