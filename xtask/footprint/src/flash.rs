//! The image as flash contents, to be copied to a debug probe's drive.

use anyhow::{Context, Result, ensure};
use object::{
    Endianness,
    elf::PT_LOAD,
    read::elf::{ElfFile32, ProgramHeader},
};

/// Value of erased flash.
const ERASED: u8 = 0xFF;

/// Limit of the image's length. A longer one has a segment at a wrong address.
const MOST_BYTES: usize = 1 << 20;

/// Returns the flash contents loaded by an ELF file, from its lowest address on.
///
/// # Errors
/// Fails when the file is not a 32-bit ELF file, or its segments are missing, overlap or are too far apart.
pub fn bytes_of_flash(elf: &[u8]) -> Result<Vec<u8>> {
    Ok(range_of_flash(elf)?.1)
}

/// Returns the lowest address loaded by an ELF file, and the flash contents from there on.
///
/// # Errors
/// Like [`bytes_of_flash`].
pub fn range_of_flash(elf: &[u8]) -> Result<(u32, Vec<u8>)> {
    let mut segments = segments(elf)?;
    segments.sort_by_key(|(address, _)| *address);
    let (first, _) = *segments.first().context("the image has nothing to load")?;
    let mut bytes = Vec::new();
    for (address, data) in segments {
        let offset = (address - first) as usize;
        ensure!(offset >= bytes.len(), "two segments of the image overlap at {address:08X}h");
        ensure!(
            offset + data.len() <= MOST_BYTES,
            "the image has a segment at {address:08X}h, beyond the flash"
        );
        bytes.resize(offset, ERASED);
        bytes.extend_from_slice(data);
    }
    Ok((first, bytes))
}

/// Returns address and data of the segments that an ELF file loads. Initialized variables are at their addresses in flash, from where
/// the start-up code copies them to RAM.
pub(crate) fn segments(elf: &[u8]) -> Result<Vec<(u32, &[u8])>> {
    let file = ElfFile32::<Endianness>::parse(elf)?;
    let endian = file.endian();
    let mut segments = Vec::new();
    for header in file.elf_program_headers() {
        let data = header.data(endian, elf).ok().context("a segment exceeds the image file")?;
        if header.p_type(endian) == PT_LOAD && !data.is_empty() {
            segments.push((header.p_paddr(endian), data));
        }
    }
    Ok(segments)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns a 32-bit ELF file with these segments: physical address, size in memory, data.
    pub(crate) fn elf(segments: &[(u32, u32, &[u8])]) -> Vec<u8> {
        let heads = 52 + 32 * segments.len() as u32;
        let mut file = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
        let halves = |file: &mut Vec<u8>, values: &[u16]| {
            values.iter().for_each(|value| file.extend(value.to_le_bytes()));
        };
        let words = |file: &mut Vec<u8>, values: &[u32]| {
            values.iter().for_each(|value| file.extend(value.to_le_bytes()));
        };
        // ET_EXEC for EM_ARM.
        halves(&mut file, &[2, 40]);
        words(&mut file, &[1, 0, 52, 0, 0]);
        halves(&mut file, &[52, 32, segments.len() as u16, 40, 0, 0]);
        let mut at = heads;
        for (address, size, data) in segments {
            words(&mut file, &[PT_LOAD.0, at, 0x2000_0000, *address, data.len() as u32, *size, 4, 4]);
            at += data.len() as u32;
        }
        segments.iter().for_each(|(_, _, data)| file.extend_from_slice(data));
        file
    }

    #[test]
    fn segments_are_at_their_flash_addresses_and_gaps_are_erased() {
        let image = elf(&[(0x0800_0006, 2, b"de"), (0x0800_0000, 3, b"abc"), (0x2000_0000, 9, b"")]);
        assert_eq!(range_of_flash(&image).unwrap(), (0x0800_0000, b"abc\xff\xff\xffde".to_vec()));
    }

    #[test]
    fn overlapping_or_distant_segments_are_rejected() {
        assert!(bytes_of_flash(&elf(&[(0x0800_0000, 3, b"abc"), (0x0800_0002, 1, b"d")])).is_err());
        assert!(bytes_of_flash(&elf(&[(0x0800_0000, 3, b"abc"), (0x2000_0000, 1, b"d")])).is_err());
        assert!(bytes_of_flash(&elf(&[(0x0800_0000, 9, b"")])).is_err());
        assert!(bytes_of_flash(b"no image").is_err());
    }
}
