//! Stack frames of functions from the compiler's section `.stack_sizes`: per function an address and a size in
//! LEB128.

use std::collections::BTreeMap;

/// Returns the frame sizes in bytes by function address.
pub(super) fn parse(section: &[u8]) -> Option<BTreeMap<u32, u64>> {
    let mut frames = BTreeMap::new();
    let mut rest = section;
    while let Some((address, behind)) = rest.split_first_chunk::<4>() {
        let (size, behind) = leb128(behind)?;
        // The lowest bit marks Thumb code.
        frames.insert(u32::from_le_bytes(*address) & !1, size);
        rest = behind;
    }
    rest.is_empty().then_some(frames)
}

fn leb128(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let mut value = 0;
    for (at, byte) in bytes.iter().enumerate().take(9) {
        value |= u64::from(byte & 0x7F) << (7 * at);
        if byte & 0x80 == 0 {
            return Some((value, bytes.get(at + 1..)?));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_in_one_byte_or_more() {
        let section = [0x01, 0, 0, 0x08, 16, 0x11, 0, 0, 0x08, 0x98, 0x07];

        let frames = parse(&section).unwrap();

        assert_eq!(frames, BTreeMap::from([(0x0800_0000, 16), (0x0800_0010, 920)]));
        assert_eq!(parse(&section[..10]), None, "cut off");
    }
}
