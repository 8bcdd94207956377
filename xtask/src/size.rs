//! Size gates: what the image takes of flash and RAM, against the limits of DESIGN.md section 7.

use std::fs;

use anyhow::{Context, Result, bail};
use object::{
    Object, ObjectSection, SectionFlags,
    elf::{SHF_ALLOC, SHF_WRITE, SHT_NOBITS},
    read::elf::ElfFile32,
};

use crate::firmware::Image;

const FLASH_LIMIT: u64 = 32 * 1024;
const STATIC_RAM_LIMIT: u64 = 6 * 1024;

/// A measured figure and its limit, both in bytes.
pub(crate) struct Gate {
    what: &'static str,
    measured: u64,
    limit: u64,
}

/// The gates of the firmware image.
pub(crate) fn of_image(image: &Image) -> Result<Vec<Gate>> {
    let what_failed = || format!("cannot read the sections of {}", image.path.display());
    let bytes = fs::read(&image.path).with_context(what_failed)?;
    let sections = sections_of(&bytes).with_context(what_failed)?;
    for section in sections.iter().filter(|section| section.size > 0) {
        println!("  {:<16} {:>7} B  {}", section.name, section.size, section.place());
    }
    let Footprint { flash, static_ram } = Footprint::of(&sections);
    Ok(vec![
        Gate { what: "firmware image, flash", measured: flash, limit: FLASH_LIMIT },
        Gate { what: "firmware image, static RAM", measured: static_ram, limit: STATIC_RAM_LIMIT },
    ])
}

/// Prints each gate; fails where one is past its limit.
pub(crate) fn check(gates: &[Gate]) -> Result<()> {
    for gate in gates {
        println!("{gate}");
    }
    let past: Vec<&str> = gates.iter().filter(|gate| !gate.holds()).map(|gate| gate.what).collect();
    if past.is_empty() {
        return Ok(());
    }
    bail!("size past its limit: {}; the sections above show what grew", past.join(", "))
}

impl Gate {
    fn holds(&self) -> bool {
        self.measured <= self.limit
    }
}

impl std::fmt::Display for Gate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let verdict = if self.holds() { "ok" } else { "TOO LARGE" };
        write!(f, "{:<28} {:>7} B of {:>7} B  {verdict}", self.what, self.measured, self.limit)
    }
}

/// A section that takes memory on the target.
struct Section {
    name: String,
    size: u64,
    /// Its contents are loaded from flash: all but `.bss` and `.uninit`.
    is_loaded: bool,
    /// It lies in RAM at run time: `.data`, `.bss`, `.uninit`.
    is_written: bool,
}

impl Section {
    fn place(&self) -> &'static str {
        match (self.is_loaded, self.is_written) {
            (true, true) => "flash and RAM",
            (true, false) => "flash",
            (false, _) => "RAM",
        }
    }
}

#[derive(Debug, PartialEq)]
struct Footprint {
    flash: u64,
    static_ram: u64,
}

impl Footprint {
    fn of(sections: &[Section]) -> Self {
        let sum =
            |counts: fn(&Section) -> bool| sections.iter().filter(|it| counts(it)).map(|it| it.size).sum();
        Self {
            flash: sum(|section| section.is_loaded),
            static_ram: sum(|section| section.is_written || !section.is_loaded),
        }
    }
}

fn sections_of(elf: &[u8]) -> Result<Vec<Section>> {
    let elf = ElfFile32::<object::Endianness>::parse(elf)?;
    let mut sections = Vec::new();
    for section in elf.sections() {
        let SectionFlags::Elf { sh_type, sh_flags } = section.flags() else { continue };
        if !sh_flags.contains(SHF_ALLOC) {
            continue;
        }
        sections.push(Section {
            name: section.name()?.to_owned(),
            size: section.size(),
            is_loaded: sh_type != SHT_NOBITS,
            is_written: sh_flags.contains(SHF_WRITE),
        });
    }
    Ok(sections)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(name: &str, size: u64, is_loaded: bool, is_written: bool) -> Section {
        Section { name: name.into(), size, is_loaded, is_written }
    }

    #[test]
    fn initialised_data_counts_in_flash_and_in_ram() {
        let sections = [
            section(".vector_table", 0x400, true, false),
            section(".text", 3000, true, false),
            section(".rodata", 500, true, false),
            section(".data", 20, true, true),
            section(".bss", 100, false, true),
            section(".uninit", 7, false, true),
        ];

        assert_eq!(Footprint::of(&sections), Footprint { flash: 0x400 + 3520, static_ram: 127 });
    }

    #[test]
    fn a_gate_holds_up_to_its_limit_and_not_past_it() {
        let gate = |measured| Gate { what: "flash", measured, limit: 100 };

        assert!(check(&[gate(0), gate(100)]).is_ok());
        let error = check(&[gate(100), gate(101)]).unwrap_err();
        assert!(error.to_string().contains("flash"));
    }

    #[test]
    fn a_file_that_is_no_elf_is_refused() {
        assert!(sections_of(b"MZ").is_err());
    }
}
