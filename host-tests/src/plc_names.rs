//! Names and numbers of flags, states and status codes for the PLC documents.
//!
//! They come from `wsg-protocol`. Meanings exist only as comments, so they are read from its source.

use wsg_fieldbus::{CommandFlags, GripperFlags};
use wsg_protocol::{Status, SystemFlags};

use document::read;

/// A flag with its bit, name and meaning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Flag {
    /// Bit number from 0.
    pub bit: u32,
    /// Name in the manual.
    pub name: String,
    /// Meaning for the documents.
    pub meaning: String,
}

/// Returns the flags of CMDFLAGS.
#[must_use]
pub fn command_flags() -> Vec<Flag> {
    let names = CommandFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into()));
    flags("fieldbus/src/image.rs", names)
}

/// Returns the flags of GSTATE.
#[must_use]
pub fn gripper_flags() -> Vec<Flag> {
    let names = GripperFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into()));
    flags("fieldbus/src/image.rs", names)
}

/// Returns the flags of SYSSTATE.
#[must_use]
pub fn system_flags() -> Vec<Flag> {
    let names = SystemFlags::all().iter_names().map(|(name, flag)| (name, flag.bits()));
    flags("protocol/src/types/flags.rs", names)
}

/// Returns each status code with its meaning, in numerical order.
///
/// # Panics
/// Panics when the table's format in the source has changed.
#[must_use]
pub fn statuses() -> Vec<(Status, String)> {
    let source = read("protocol/src/types/status.rs");
    let meaning = |status: &Status| {
        let symbol = format!(" \"{}\" \"", status.symbol());
        let rest = source.split(&symbol).nth(1).unwrap_or_else(|| panic!("{status} has no meaning"));
        rest.split("\";").next().unwrap_or_default().to_owned()
    };
    Status::ALL.iter().map(|status| (*status, meaning(status))).collect()
}

/// Returns the Modbus register that holds a bit of an image, and the mask in it. A register's first byte is its high
/// byte.
#[must_use]
pub const fn register_bit(bit: u32) -> (u32, u16) {
    let in_byte = 1 << (bit % 8);
    (bit / 16, if (bit / 8).is_multiple_of(2) { in_byte << 8 } else { in_byte })
}

/// Formats a status code for a sentence: name, number, meaning.
#[must_use]
pub fn in_words(status: Status) -> String {
    let all = statuses();
    let meaning = all.iter().find(|(other, _)| *other == status).map_or("", |(_, meaning)| meaning);
    format!("{} ({}, {meaning})", status.symbol(), status.code())
}

/// Returns the flags with these names and masks. Their meanings are the comments before them in the source.
fn flags(source: &str, names: impl Iterator<Item = (&'static str, u32)>) -> Vec<Flag> {
    let source = read(source);
    names
        .map(|(name, mask)| {
            let definition = format!("const {name} = ");
            let before = source.split(&definition).next().unwrap_or_default().trim_end();
            let comment = before.lines().next_back().unwrap_or_default().trim();
            let meaning = comment.split_once(": ").map(|(_, meaning)| meaning.trim_end_matches('.'));
            Flag {
                bit: mask.trailing_zeros(),
                name: match name {
                    "STOP_ACK" => "STOP/ACK",
                    "JOG_PLUS" => "JOG+",
                    "JOG_MINUS" => "JOG-",
                    name => name,
                }
                .to_owned(),
                meaning: meaning.unwrap_or_else(|| panic!("{name} has no meaning")).to_owned(),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_fieldbus::{InputImage, OutputImage};

    #[test]
    fn meanings_are_found_in_the_sources() {
        let flag = |flags: Vec<Flag>, name: &str| flags.into_iter().find(|flag| flag.name == name).unwrap();
        assert_eq!(flag(system_flags(), "MOVING").meaning, "the fingers are moving");
        assert_eq!(flag(gripper_flags(), "HOLDING").meaning, "a part is held");
        assert_eq!(flag(command_flags(), "STOP/ACK").bit, 4);
        assert_eq!(in_words(Status::IoError), "E_IO_ERROR (23, input or output error)");
    }

    #[test]
    fn bits_are_in_the_registers_of_the_images() {
        let registers = |bytes: &[u8]| -> Vec<u16> {
            bytes.chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect()
        };
        for bit in 0..8 {
            let flags = CommandFlags::from_bits_retain(1 << bit);
            let image = registers(&OutputImage { flags, ..OutputImage::ZERO }.to_bytes());
            assert_eq!((0, image[0]), register_bit(bit));
        }
        for bit in 0..32 {
            let mut bytes = [0; InputImage::LEN];
            bytes[2 + bit / 8] = 1 << (bit % 8);
            assert_eq!(InputImage::from_bytes(bytes).system.bits(), 1 << bit);
            let (register, mask) = register_bit(16 + bit as u32);
            assert_eq!(registers(&bytes)[register as usize], mask);
        }
    }
}
