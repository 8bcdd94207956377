//! Decoder for Thumb-2 loads and stores: register, address and width (ARMv7-M Architecture Reference Manual, A5.2.4,
//! A5.3.7, A5.3.8, A5.3.9, A5.3.10).
//!
//! Supports single core registers, as in accesses to peripherals. Other loads and stores and all other instructions
//! are rejected by name.

use anyhow::{Result, bail, ensure};

/// Width of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// 8 bits.
    Byte,
    /// 16 bits.
    Halfword,
    /// 32 bits.
    Word,
}

impl Width {
    /// Returns the width in bytes.
    #[must_use]
    pub const fn bytes(self) -> u32 {
        match self {
            Self::Byte => 1,
            Self::Halfword => 2,
            Self::Word => 4,
        }
    }

    /// Truncates a value to this width.
    #[must_use]
    pub const fn of(self, value: u32) -> u32 {
        match self {
            Self::Byte => value & 0xFF,
            Self::Halfword => value & 0xFFFF,
            Self::Word => value,
        }
    }

    const fn sign_extended(self, value: u32) -> u32 {
        match self {
            Self::Byte => value as u8 as i8 as u32,
            Self::Halfword => value as u16 as i16 as u32,
            Self::Word => value,
        }
    }
}

/// Direction of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Move {
    /// From memory into a register.
    Load {
        /// Whether the value is sign-extended.
        is_signed: bool,
    },
    /// From a register into memory.
    Store,
}

/// A load or store of one register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadStore {
    /// Load or store.
    pub direction: Move,
    /// Width of the access.
    pub width: Width,
    /// Memory address.
    pub address: u32,
    /// Register number, 0 to 14.
    pub register: usize,
    /// The base register and its new value, if it changes.
    pub write_back: Option<(usize, u32)>,
    /// Length of the instruction in bytes.
    pub len: u32,
}

impl LoadStore {
    /// Decodes a one- or two-halfword instruction with these register values.
    ///
    /// # Errors
    /// Fails with the name of any other instruction.
    pub fn decode(code: [u16; 2], r: &[u32; 16]) -> Result<Self> {
        if code[0] >> 11 >= 0b11101 { wide(code, r) } else { narrow(code[0], r) }
    }

    /// Returns the register's value after a load of `value`.
    #[must_use]
    pub const fn loaded(&self, value: u32) -> u32 {
        match self.direction {
            Move::Load { is_signed: true } => self.width.sign_extended(value),
            Move::Load { is_signed: false } | Move::Store => self.width.of(value),
        }
    }
}

const LOAD: Move = Move::Load { is_signed: false };
const LOAD_SIGNED: Move = Move::Load { is_signed: true };

/// Decodes 16-bit instructions (A5.2.4).
fn narrow(code: u16, r: &[u32; 16]) -> Result<LoadStore> {
    let field = |at: u16, bits: u16| usize::from(code >> at & ((1 << bits) - 1));
    let base = r[field(3, 3)];
    let offset = field(6, 5) as u32;
    let by_register = |direction, width| (direction, width, base.wrapping_add(r[field(6, 3)]));
    let by_offset = |direction, width: Width| (direction, width, base.wrapping_add(offset * width.bytes()));
    let (direction, width, address) = match code >> 9 {
        0b010_1000 => by_register(Move::Store, Width::Word),
        0b010_1001 => by_register(Move::Store, Width::Halfword),
        0b010_1010 => by_register(Move::Store, Width::Byte),
        0b010_1011 => by_register(LOAD_SIGNED, Width::Byte),
        0b010_1100 => by_register(LOAD, Width::Word),
        0b010_1101 => by_register(LOAD, Width::Halfword),
        0b010_1110 => by_register(LOAD, Width::Byte),
        0b010_1111 => by_register(LOAD_SIGNED, Width::Halfword),
        _ => match code >> 11 {
            0b01100 => by_offset(Move::Store, Width::Word),
            0b01101 => by_offset(LOAD, Width::Word),
            0b01110 => by_offset(Move::Store, Width::Byte),
            0b01111 => by_offset(LOAD, Width::Byte),
            0b10000 => by_offset(Move::Store, Width::Halfword),
            0b10001 => by_offset(LOAD, Width::Halfword),
            0b11000 => bail!("STM ({code:04X}) moves several registers"),
            0b11001 => bail!("LDM ({code:04X}) moves several registers"),
            0b10010 | 0b10011 => bail!("LDR or STR by SP ({code:04X}) is not a peripheral access"),
            0b01001 => bail!("LDR by PC ({code:04X}) is not a peripheral access"),
            _ => bail!("the instruction {code:04X} is not a load or store of one register"),
        },
    };
    Ok(LoadStore { direction, width, address, register: field(0, 3), write_back: None, len: 2 })
}

/// Decodes 32-bit instructions (A5.3.7 to A5.3.10).
fn wide([first, second]: [u16; 2], r: &[u32; 16]) -> Result<LoadStore> {
    let name = match first {
        _ if first & 0xFE00 == 0xF800 => None,
        _ if first & 0xFE40 == 0xE800 => Some("LDM or STM"),
        _ if first & 0xFFE0 == 0xE840 || first & 0xFFE0 == 0xE8C0 => Some("LDREX, STREX or TBB"),
        _ if first & 0xFE40 == 0xE840 => Some("LDRD or STRD"),
        _ if first & 0xEC00 == 0xEC00 => Some("a coprocessor's instruction"),
        _ => Some("no load or store"),
    };
    if let Some(name) = name {
        bail!("the instruction {first:04X} {second:04X} ({name}) does not move one register");
    }
    let refused = |why: &str| format!("the instruction {first:04X} {second:04X} is {why}");
    let is_load = first & 1 << 4 != 0;
    let is_signed = first & 1 << 8 != 0;
    let width = match first >> 5 & 0b11 {
        0b00 => Width::Byte,
        0b01 => Width::Halfword,
        0b10 => Width::Word,
        _ => bail!(refused("undefined")),
    };
    ensure!(!is_signed || (is_load && width != Width::Word), refused("undefined"));
    let (base_register, register) = (usize::from(first & 0xF), usize::from(second >> 12));
    ensure!(base_register != 15, refused("a load by PC, not a peripheral access"));
    ensure!(register != 15, refused("a cache hint or a jump"));
    let base = r[base_register];
    let (address, write_back) = if first & 1 << 7 != 0 {
        (base.wrapping_add(u32::from(second & 0xFFF)), None)
    } else if second & 1 << 11 != 0 {
        let offset = u32::from(second & 0xFF);
        let after = if second & 1 << 9 != 0 { base.wrapping_add(offset) } else { base.wrapping_sub(offset) };
        match (second & 1 << 10 != 0, second & 1 << 8 != 0) {
            (true, false) => (after, None),
            (true, true) => (after, Some((base_register, after))),
            (false, true) => (base, Some((base_register, after))),
            (false, false) => bail!(refused("undefined")),
        }
    } else {
        ensure!(second >> 6 & 0x1F == 0, refused("undefined"));
        let shift = second >> 4 & 0b11;
        (base.wrapping_add(r[usize::from(second & 0xF)] << shift), None)
    };
    // LDRT and similar encode as (1, 0) with an added offset, and transfer like LDR.
    let direction = if is_load { Move::Load { is_signed } } else { Move::Store };
    Ok(LoadStore { direction, width, address, register, write_back, len: 4 })
}

#[cfg(test)]
mod tests;
