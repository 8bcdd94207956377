//! The registers of the two images: which there are, and what each holds.
//!
//! The one table of them: what [`Images`](super::Images) serves and what the documents say comes from here.

use super::{InputImage, OutputImage};

/// What the two bytes of a register are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Content {
    /// Two bytes of single bits; the high byte of the register is the image's first. Never swapped.
    Bits,
    /// An unsigned number.
    Unsigned,
    /// A number in two's complement.
    Signed,
}

impl Content {
    /// Whether the bytes are a number, which `swap bytes` turns round.
    #[must_use]
    pub const fn is_number(self) -> bool {
        !matches!(self, Self::Bits)
    }
}

/// A register of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Register {
    /// The manual's name.
    pub name: &'static str,
    /// What its bytes are.
    pub content: Content,
    /// Its unit, or which bits it holds.
    pub unit: &'static str,
}

const fn bits(name: &'static str, unit: &'static str) -> Register {
    Register { name, content: Content::Bits, unit }
}

const fn signed(name: &'static str, unit: &'static str) -> Register {
    Register { name, content: Content::Signed, unit }
}

const fn unsigned(name: &'static str, unit: &'static str) -> Register {
    Register { name, content: Content::Unsigned, unit }
}

/// The holding registers from 0 on: the output image (fieldbus, table 1).
///
/// ```
/// use wsg_fieldbus::OUTPUT_REGISTERS;
///
/// assert_eq!(OUTPUT_REGISTERS[2].name, "SPEED");
/// ```
pub const OUTPUT_REGISTERS: [Register; OutputImage::LEN / 2] = [
    bits("CMDFLAGS, IF", "high byte: CMDFLAGS; low byte: IF1 (bit 0) to IF8"),
    signed("WIDTH", "1/100 mm"),
    unsigned("SPEED", "1/100 mm/s"),
    signed("FORCELIMIT", "1/100 N (WSG 70: 1/10 N), only positive"),
];

/// The input registers from 0 on: the input image (fieldbus, table 2).
///
/// ```
/// use wsg_fieldbus::INPUT_REGISTERS;
///
/// assert_eq!(INPUT_REGISTERS[5].name, "Status Code");
/// ```
pub const INPUT_REGISTERS: [Register; InputImage::LEN / 2] = [
    bits("GSTATE, OF", "high byte: GSTATE; low byte: OF1 (bit 0) to OF8"),
    bits("SYSSTATE", "high byte: flags D7 to D0; low byte: D15 to D8"),
    bits("SYSSTATE", "high byte: flags D23 to D16; low byte: D31 to D24"),
    signed("WIDTH", "1/100 mm"),
    signed("Gripping Force", "1/100 N (WSG 70: 1/10 N)"),
    unsigned("Status Code", "code of the last command"),
];
