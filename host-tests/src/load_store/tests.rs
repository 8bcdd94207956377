//! Covers encodings that compilers may emit in future, and the rejection of all others.

use super::*;

/// R0 to R15; R2 and R10 are indices.
const R: [u32; 16] = {
    let mut r = [0xDEAD_BEEF; 16];
    r[0] = 0x4000_6400;
    r[2] = 0x21;
    r[8] = 0x4000_6800;
    r[10] = 0x41;
    r
};

#[track_caller]
fn assert_decodes(code: [u16; 2], direction: Move, width: Width, address: u32) {
    let decoded = LoadStore::decode(code, &R).unwrap();
    assert_eq!((decoded.direction, decoded.width), (direction, width), "{code:04X?}");
    assert_eq!(decoded.address, address, "{code:04X?}: {:#X}", decoded.address);
    let (register, len) = if code[0] >> 12 == 0xF { (9, 4) } else { (1, 2) };
    assert_eq!((decoded.register, decoded.len), (register, len), "{code:04X?}");
}

// The encodings come from an assembler (llvm-mc).

#[test]
fn narrow_and_wide_instructions_have_an_offset_or_a_register() {
    for (code, direction, width, address) in [
        ([0x6001, 0], Move::Store, Width::Word, 0x4000_6400),
        ([0x6FC1, 0], LOAD, Width::Word, 0x4000_6400 + 124),
        ([0x77C1, 0], Move::Store, Width::Byte, 0x4000_6400 + 31),
        ([0x7FC1, 0], LOAD, Width::Byte, 0x4000_6400 + 31),
        ([0x87C1, 0], Move::Store, Width::Halfword, 0x4000_6400 + 62),
        ([0x8FC1, 0], LOAD, Width::Halfword, 0x4000_6400 + 62),
        ([0x5081, 0], Move::Store, Width::Word, 0x4000_6421),
        ([0x5281, 0], Move::Store, Width::Halfword, 0x4000_6421),
        ([0x5481, 0], Move::Store, Width::Byte, 0x4000_6421),
        ([0x5681, 0], LOAD_SIGNED, Width::Byte, 0x4000_6421),
        ([0x5881, 0], LOAD, Width::Word, 0x4000_6421),
        ([0x5A81, 0], LOAD, Width::Halfword, 0x4000_6421),
        ([0x5C81, 0], LOAD, Width::Byte, 0x4000_6421),
        ([0x5E81, 0], LOAD_SIGNED, Width::Halfword, 0x4000_6421),
        ([0xF8D8, 0x9ABC], LOAD, Width::Word, 0x4000_6800 + 0xABC),
        ([0xF8C8, 0x9ABC], Move::Store, Width::Word, 0x4000_6800 + 0xABC),
        ([0xF898, 0x9ABC], LOAD, Width::Byte, 0x4000_6800 + 0xABC),
        ([0xF8B8, 0x9ABC], LOAD, Width::Halfword, 0x4000_6800 + 0xABC),
        ([0xF888, 0x9ABC], Move::Store, Width::Byte, 0x4000_6800 + 0xABC),
        ([0xF8A8, 0x9ABC], Move::Store, Width::Halfword, 0x4000_6800 + 0xABC),
        ([0xF998, 0x9ABC], LOAD_SIGNED, Width::Byte, 0x4000_6800 + 0xABC),
        ([0xF9B8, 0x9ABC], LOAD_SIGNED, Width::Halfword, 0x4000_6800 + 0xABC),
        ([0xF858, 0x9CAB], LOAD, Width::Word, 0x4000_6800 - 0xAB),
        ([0xF858, 0x9EAB], LOAD, Width::Word, 0x4000_6800 + 0xAB),
        ([0xF858, 0x903A], LOAD, Width::Word, 0x4000_6800 + (0x41 << 3)),
        ([0xF808, 0x900A], Move::Store, Width::Byte, 0x4000_6841),
    ] {
        assert_decodes(code, direction, width, address);
    }
}

#[test]
fn the_base_is_written_back_before_or_after() {
    let write_back = |code| {
        let decoded = LoadStore::decode(code, &R).unwrap();
        (decoded.address, decoded.write_back)
    };
    assert_eq!(write_back([0xF858, 0x9FAB]), (0x4000_68AB, Some((8, 0x4000_68AB))));
    assert_eq!(write_back([0xF858, 0x9DAB]), (0x4000_6755, Some((8, 0x4000_6755))));
    assert_eq!(write_back([0xF848, 0x9BAB]), (0x4000_6800, Some((8, 0x4000_68AB))));
    assert_eq!(write_back([0xF848, 0x99AB]), (0x4000_6800, Some((8, 0x4000_6755))));
    assert_eq!(write_back([0xF858, 0x9CAB]).1, None);
}

#[test]
fn all_other_instructions_are_rejected_by_name() {
    for (code, name) in [
        ([0xE9D2, 0x0100], "LDRD"),
        ([0xE9C2, 0x0102], "STRD"),
        ([0xC806, 0], "LDM"),
        ([0xC006, 0], "STM"),
        ([0xE898, 0x0006], "LDM"),
        ([0xE851, 0x0F00], "LDREX"),
        ([0xE8C1, 0x2F40], "STREX"),
        ([0xE8D0, 0xF001], "TBB"),
        ([0xED90, 0x0A00], "coprocessor"),
        ([0xEC80, 0x0A04], "coprocessor"),
        ([0x9801, 0], "SP"),
        ([0x4801, 0], "PC"),
        ([0xF8DF, 0x9004], "PC"),
        ([0xF890, 0xF000], "hint"),
        ([0x1888, 0], "1888"),
        ([0xF000, 0xF800], "no load or store"),
        ([0xF858, 0x98AB], "undefined"),
        ([0xF8F8, 0x9000], "undefined"),
        ([0xF948, 0x9C00], "undefined"),
    ] {
        let refusal = LoadStore::decode(code, &R).unwrap_err().to_string();
        assert!(refusal.contains(name), "{code:04X?}: {refusal}");
        assert!(refusal.contains(&format!("{:04X}", code[0])), "{code:04X?}: {refusal}");
    }
}

#[test]
fn a_load_narrower_than_the_register_fills_its_upper_bits() {
    let loaded = |code, value| LoadStore::decode(code, &R).unwrap().loaded(value);
    assert_eq!(loaded([0x5C81, 0], 0x1234_56F8), 0xF8);
    assert_eq!(loaded([0x5681, 0], 0x1234_56F8), 0xFFFF_FFF8);
    assert_eq!(loaded([0x5A81, 0], 0x1234_8678), 0x8678);
    assert_eq!(loaded([0x5E81, 0], 0x1234_8678), 0xFFFF_8678);
    assert_eq!(loaded([0x6FC1, 0], 0x1234_8678), 0x1234_8678);
}
