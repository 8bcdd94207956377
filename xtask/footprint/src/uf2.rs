//! The image in UF2 format for the RP2040's USB boot loader: blocks of 256 bytes with addresses (Microsoft's UF2
//! specification; RP2040 data sheet, 2.8.4.2).

use std::collections::BTreeMap;

use anyhow::{Result, ensure};

use crate::flash::segments;

const MAGIC: [u32; 2] = [0x0A32_4655, 0x9E5D_5157];
const MAGIC_END: u32 = 0x0AB1_6F30;
/// Flag for a family number, which identifies the MCU.
const FAMILY_ID_PRESENT: u32 = 0x2000;
const RP2040: u32 = 0xE48B_FF56;

const BLOCK_LEN: usize = 512;
const DATA_AT: usize = 32;
/// Length of a flash page, the programming unit of the boot ROM.
const PAYLOAD: u64 = 256;

/// Address range of the flash.
const FLASH: std::ops::Range<u64> = 0x1000_0000..0x1100_0000;

/// Converts an ELF file's flash contents to UF2. Unused bytes of a page are 00h.
pub fn uf2(elf: &[u8]) -> Result<Vec<u8>> {
    uf2_of(&segments(elf)?)
}

/// Does the same with flash contents and their addresses. Contents of several sectors must be without gaps: the boot ROM erases a
/// sector for every 16th block, not for each address (RP2040-E14).
pub fn uf2_of(contents: &[(u32, &[u8])]) -> Result<Vec<u8>> {
    let mut pages = BTreeMap::<u64, [u8; PAYLOAD as usize]>::new();
    for &(start, data) in contents {
        for (address, byte) in (u64::from(start)..).zip(data) {
            ensure!(FLASH.contains(&address), "the image has {address:#x}, which is not in flash");
            let page = pages.entry(address / PAYLOAD * PAYLOAD).or_insert([0; PAYLOAD as usize]);
            page[(address % PAYLOAD) as usize] = *byte;
        }
    }
    let count = pages.len() as u32;
    let blocks = pages.iter().zip(0u32..).map(|((address, data), number)| {
        let mut block = [0; BLOCK_LEN];
        let words =
            [MAGIC[0], MAGIC[1], FAMILY_ID_PRESENT, *address as u32, PAYLOAD as u32, number, count, RP2040];
        for (place, word) in block.chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        block[DATA_AT..DATA_AT + data.len()].copy_from_slice(data);
        block[BLOCK_LEN - 4..].copy_from_slice(&MAGIC_END.to_le_bytes());
        block
    });
    Ok(blocks.flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flash::tests::elf;

    #[test]
    fn segments_become_numbered_pages_of_flash() {
        let made = uf2(&elf(&[(0x1000_00FE, 3, &[1, 2, 3]), (0x1000_0400, 1, &[4])])).unwrap();

        let blocks: Vec<&[u8]> = made.chunks_exact(BLOCK_LEN).collect();
        let word =
            |block: usize, at: usize| u32::from_le_bytes(blocks[block][at..at + 4].try_into().unwrap());
        assert_eq!(blocks.len(), 3);
        for (number, address) in [0x1000_0000, 0x1000_0100, 0x1000_0400].into_iter().enumerate() {
            let head: Vec<u32> = (0..8).map(|place| word(number, 4 * place)).collect();
            let count = 3;
            assert_eq!(
                head,
                [0x0A32_4655, 0x9E5D_5157, 0x2000, address, 256, number as u32, count, 0xE48B_FF56]
            );
            assert_eq!(word(number, 508), 0x0AB1_6F30);
        }
        assert_eq!(blocks[0][DATA_AT + 0xFD..DATA_AT + 0x100], [0, 1, 2]);
        assert_eq!(blocks[1][DATA_AT..DATA_AT + 2], [3, 0]);
        assert_eq!(blocks[2][DATA_AT], 4);
    }

    #[test]
    fn a_segment_outside_flash_is_rejected() {
        let refused = uf2(&elf(&[(0x2000_0000, 1, &[1])])).unwrap_err().to_string();
        assert_eq!(refused, "the image has 0x20000000, which is not in flash");
    }
}
