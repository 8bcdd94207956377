//! The sections of an image and their memory use.

use std::ops::Range;

use anyhow::{Context, Result};
use object::{
    Object, ObjectSection, ObjectSymbol, SectionFlags,
    elf::{SHF_ALLOC, SHF_WRITE, SHT_NOBITS},
    read::elf::ElfFile32,
};

/// A section that occupies memory on the target.
pub struct Section {
    /// Name, such as `.text` or `.bss`.
    pub name: String,
    /// Size in bytes.
    pub size: u64,
    /// Whether its contents are loaded from flash: all except `.bss` and `.uninit`.
    pub is_loaded: bool,
    /// Whether it is in RAM at run time: `.data`, `.bss`, `.uninit`.
    pub is_written: bool,
}

/// Memory use of a program on the target, in bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Code, constants, and the initial values of `.data`.
    pub flash: u64,
    /// Static variables, without the stack.
    pub static_ram: u64,
}

impl Section {
    /// Returns the section's location as text.
    #[must_use]
    pub fn place(&self) -> &'static str {
        match (self.is_loaded, self.is_written) {
            (true, true) => "flash and RAM",
            (true, false) => "flash",
            (false, _) => "RAM",
        }
    }
}

impl Footprint {
    /// Sums these sections.
    #[must_use]
    pub fn of(sections: &[Section]) -> Self {
        let sum =
            |counts: fn(&Section) -> bool| sections.iter().filter(|it| counts(it)).map(|it| it.size).sum();
        Self {
            flash: sum(|section| section.is_loaded),
            static_ram: sum(|section| section.is_written || !section.is_loaded),
        }
    }

    /// Returns the excess over `other`.
    #[must_use]
    pub fn over(self, other: Self) -> Self {
        Self {
            flash: self.flash.saturating_sub(other.flash),
            static_ram: self.static_ram.saturating_sub(other.static_ram),
        }
    }
}

/// Returns the sections that occupy memory on the target.
///
/// # Errors
/// Fails when the file is not a 32-bit ELF file.
pub fn sections_of(elf: &[u8]) -> Result<Vec<Section>> {
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

/// Returns the place of a symbol's bytes in the file.
///
/// # Errors
/// Fails when the file is not a 32-bit ELF file, or does not contain the symbol.
pub fn place_of(symbol: &str, elf: &[u8]) -> Result<Range<usize>> {
    let elf = ElfFile32::<object::Endianness>::parse(elf)?;
    let found = elf.symbol_by_name(symbol).with_context(|| format!("missing symbol {symbol}"))?;
    let section = found.section_index().with_context(|| format!("{symbol} belongs to no section"))?;
    let section = elf.section_by_index(section)?;
    let (start, _) = section.file_range().with_context(|| format!("{symbol} is not in the file"))?;
    let start = usize::try_from(start + (found.address() - section.address()))?;
    Ok(start..start + usize::try_from(found.size())?)
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

        let footprint = Footprint::of(&sections);

        assert_eq!(footprint, Footprint { flash: 0x400 + 3520, static_ram: 127 });
        let empty = Footprint { flash: 0x400, static_ram: 7 };
        assert_eq!(footprint.over(empty), Footprint { flash: 3520, static_ram: 120 });
    }

    #[test]
    fn a_file_other_than_elf_is_rejected() {
        assert!(sections_of(b"MZ").is_err());
    }
}
