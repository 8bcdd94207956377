//! The register table of the two images.
//!
//! [`Images`](super::Images) and the documents derive from it.

use super::{InputImage, OutputImage};

/// The meaning of a register's two bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Content {
    /// Two bytes of bits, never swapped. The high byte of the register is the first byte of the image.
    Bits,
    /// An unsigned 16-bit number.
    Unsigned,
    /// A signed 16-bit number in two's complement.
    Signed,
}

impl Content {
    /// Returns whether the register is a number, which `swap bytes` reverses.
    #[must_use]
    pub const fn is_number(self) -> bool {
        !matches!(self, Self::Bits)
    }
}

/// A register of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Register {
    /// The name in the manual.
    pub name: &'static str,
    /// The meaning of its bytes.
    pub content: Content,
    /// The unit, or the bits that it holds.
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

/// The holding registers, from address 0: the output image (fieldbus, table 1).
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

/// The input registers, from address 0: the input image (fieldbus, table 2).
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
