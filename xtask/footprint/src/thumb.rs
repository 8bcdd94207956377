//! Decoder for the Thumb-2 instructions that affect control flow and stack depth (ARMv7-M Architecture Reference
//! Manual, A5 and A7).

/// Effect of an instruction on control flow or stack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Effect {
    /// Calls the function at this address.
    Call(u32),
    /// May continue at this address.
    Jump(u32),
    /// Calls an address in a register.
    IndirectCall,
    /// Uses this many bytes of stack.
    Push(u32),
    /// Sets the stack pointer in another way. Instructions that only free stack are [`Effect::Other`].
    SetStack,
    /// Sets half of a register.
    Half {
        register: u8,
        high: bool,
        value: u16,
    },
    Other,
}

/// Decodes the instruction at `address`. Returns its length in bytes and its effect.
pub(super) fn decode(address: u32, halfwords: [u16; 2]) -> (u32, Effect) {
    let [first, second] = halfwords;
    if first >> 11 >= 0b11101 { (4, wide(address, first, second)) } else { (2, narrow(address, first)) }
}

fn narrow(address: u32, code: u16) -> Effect {
    let pc = address.wrapping_add(4);
    match code {
        // B (T1): conditions 1110 and 1111 are UDF and SVC.
        _ if code >> 12 == 0b1101 && (code >> 8) & 0xF < 0b1110 => {
            Effect::Jump(pc.wrapping_add_signed(i32::from(code as u8 as i8) * 2))
        }
        // B (T2)
        _ if code >> 11 == 0b11100 => {
            Effect::Jump(pc.wrapping_add_signed(signed(u32::from(code & 0x7FF), 11) * 2))
        }
        // BLX (register)
        _ if code & 0xFF87 == 0x4780 => Effect::IndirectCall,
        // BX other than LR: an indirect tail call
        _ if code & 0xFF87 == 0x4700 && (code >> 3) & 0xF != 14 => Effect::IndirectCall,
        // PUSH
        _ if code & 0xFE00 == 0xB400 => Effect::Push((code & 0x1FF).count_ones() * 4),
        // SUB SP, immediate
        _ if code & 0xFF80 == 0xB080 => Effect::Push(u32::from(code & 0x7F) * 4),
        // ADD SP, register and MOV SP, register
        _ if code & 0xFF87 == 0x4485 || code & 0xFF87 == 0x4685 => Effect::SetStack,
        _ => Effect::Other,
    }
}

fn wide(address: u32, first: u16, second: u16) -> Effect {
    let pc = address.wrapping_add(4);
    let (one, two) = (u32::from(first), u32::from(second));
    let branch_offset = || {
        let sign = (one >> 10) & 1;
        let i1 = !((two >> 13) ^ sign) & 1;
        let i2 = !((two >> 11) ^ sign) & 1;
        signed(sign << 23 | i1 << 22 | i2 << 21 | (one & 0x3FF) << 11 | two & 0x7FF, 24) * 2
    };
    let modified_immediate = || (one >> 10 & 1) << 11 | (two >> 12 & 7) << 8 | two & 0xFF;
    match (first, second) {
        // BL
        _ if first >> 11 == 0b11110 && second & 0xD000 == 0xD000 => {
            Effect::Call(pc.wrapping_add_signed(branch_offset()))
        }
        // B (T4)
        _ if first >> 11 == 0b11110 && second & 0xD000 == 0x9000 => {
            Effect::Jump(pc.wrapping_add_signed(branch_offset()))
        }
        // B (T3): conditions 111x encode other instructions
        _ if first >> 11 == 0b11110 && second & 0xD000 == 0x8000 && (first >> 7) & 7 != 7 => {
            let offset = (one >> 10 & 1) << 19 | (two >> 11 & 1) << 18 | (two >> 13 & 1) << 17;
            Effect::Jump(pc.wrapping_add_signed(signed(offset | (one & 0x3F) << 11 | two & 0x7FF, 20) * 2))
        }
        // PUSH.W, an alias of STMDB SP!
        (0xE92D, _) => Effect::Push(second.count_ones() * 4),
        // STR.W Rt, [SP, #-imm]!
        (0xF84D, _) if second & 0x0F00 == 0x0D00 => Effect::Push(two & 0xFF),
        // STRD Rt, Rt2, [SP, #-imm]!
        (0xE96D, _) => Effect::Push((two & 0xFF) * 4),
        // SUB.W SP, SP, #imm (T2: modified immediate)
        _ if first & 0xFBEF == 0xF1AD & 0xFBEF && second & 0x8F00 == 0x0D00 => {
            Effect::Push(expand(modified_immediate()))
        }
        // SUBW SP, SP, #imm12 (T3)
        _ if first & 0xFBFF == 0xF2AD && second & 0x8F00 == 0x0D00 => Effect::Push(modified_immediate()),
        // ADD.W and ADDW SP, SP, #imm: they free stack.
        _ if first & 0xFBEF == 0xF10D || first & 0xFBFF == 0xF20D => Effect::Other,
        // Other data processing with SP as the result.
        _ if (first >> 9 == 0b111_0101 || first >> 11 == 0b11110 && second >> 15 == 0)
            && second & 0x0F00 == 0x0D00 =>
        {
            Effect::SetStack
        }
        // LDR.W SP
        _ if first & 0xFF70 == 0xF850 && second >> 12 == 13 => Effect::SetStack,
        // VPUSH of double and of single registers
        _ if first & 0xFFBF == 0xED2D && second & 0x0E00 == 0x0A00 => Effect::Push((two & 0xFF) * 4),
        // MOVW and MOVT
        _ if first & 0xFB70 == 0xF240 && second & 0x8000 == 0 => {
            let value = (one & 0xF) << 12 | modified_immediate();
            Effect::Half {
                register: (second >> 8 & 0xF) as u8,
                high: first & 0x0080 != 0,
                value: value as u16,
            }
        }
        _ => Effect::Other,
    }
}

/// Sign-extends the low bits.
fn signed(value: u32, bits: u32) -> i32 {
    (value << (32 - bits)) as i32 >> (32 - bits)
}

/// A modified immediate constant (A5.3.2).
fn expand(immediate: u32) -> u32 {
    let byte = immediate & 0xFF;
    match immediate >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte * 0x0101_0101,
        _ => (0x80 | byte & 0x7F).rotate_right(immediate >> 7),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected results come from `llvm-objdump` on the firmware and on assembled snippets.
    #[test]
    fn instructions_are_decoded_as_the_disassembler_does() {
        for (address, halfwords, expected) in [
            (0x0800_0978, [0xF7FF, 0xFE88], (4, Effect::Call(0x0800_068C))),
            (0x0800_0662, [0xF7FF, 0xBEF9], (4, Effect::Jump(0x0800_0458))),
            (0x0800_02EA, [0xF100, 0x8170], (4, Effect::Jump(0x0800_05CE))),
            (0x0800_06D4, [0xE00D, 0x0000], (2, Effect::Jump(0x0800_06F2))),
            (0x0800_06C8, [0xD405, 0x0000], (2, Effect::Jump(0x0800_06D6))),
            (0x0800_08B2, [0xD1FE, 0x0000], (2, Effect::Jump(0x0800_08B2))),
            (0, [0x4798, 0x0000], (2, Effect::IndirectCall)),
            (0, [0x4718, 0x0000], (2, Effect::IndirectCall)),
            (0, [0x4770, 0x0000], (2, Effect::Other)),
            (0, [0xB5F0, 0x0000], (2, Effect::Push(20))),
            (0, [0xB08E, 0x0000], (2, Effect::Push(56))),
            (0, [0xE92D, 0x0F00], (4, Effect::Push(16))),
            (0, [0xF84D, 0xBD04], (4, Effect::Push(4))),
            (0, [0xF5AD, 0x7D66], (4, Effect::Push(920))),
            (0, [0xF6AD, 0x0D04], (4, Effect::Push(2052))),
            (0, [0xED2D, 0x8B02], (4, Effect::Push(8))),
            (0, [0x44B5, 0x0000], (2, Effect::SetStack)),
            (0, [0x46A5, 0x0000], (2, Effect::SetStack)),
            (0, [0x466F, 0x0000], (2, Effect::Other)),
            (0, [0xEBAD, 0x0D03], (4, Effect::SetStack)),
            (0, [0xEA4F, 0x0D07], (4, Effect::SetStack)),
            (0, [0xF8D0, 0xD000], (4, Effect::SetStack)),
            (0, [0xF850, 0xDF04], (4, Effect::SetStack)),
            (0, [0xF8DD, 0x1400], (4, Effect::Other)),
            (0, [0xF50D, 0x7D66], (4, Effect::Other)),
            (0, [0xF60D, 0x0D04], (4, Effect::Other)),
            (0, [0xEBBD, 0x0F01], (4, Effect::Other)),
            (0, [0xF1AD, 0x010C], (4, Effect::Other)),
            (0, [0xF240, 0x0A98], (4, Effect::Half { register: 10, high: false, value: 0x0098 })),
            (0, [0xF6C0, 0x0000], (4, Effect::Half { register: 0, high: true, value: 0x0800 })),
        ] {
            assert_eq!(decode(address, halfwords), expected, "{halfwords:04X?}");
        }
    }
}
