//! CAN over a serial line: the text protocol of LAWICEL's CANUSB adapter, used by SLCAN tools.
//!
//! Each frame is a line, such as `t1202ABCD` for identifier 120h with the two bytes ABh and CDh. It consists of a
//! letter (`t` and `T` for data frames with 11 and 29 bits, `r` and `R` for remote frames), the identifier, the DLC and
//! the data, all in hexadecimal, and CR. Both sides send frames in this form. The host also sends commands. The adapter
//! responds with CR, or with BEL if it rejects the command.
//!
//! [`encode`] and [`Decoder`] serve both sides, with any frame type of `embedded-can`. [`Adapter`] implements the
//! responses of an adapter. [`ClassicFrame`] is a frame type for programs without a CAN controller driver.
//!
//! Bit rates are accepted without effect, because there is no bus. Time stamps are accepted and ignored.
//!
//! `mini-slcan` is another codec for the adapter's side. It can panic, does not support the host's side, and depends on
//! a `defmt` version before 1.0, which Cargo does not link together with a newer one.
//!
//! ```
//! use bus_slcan::{ClassicFrame, Decoder, Line, encode};
//! use embedded_can::{Frame, StandardId};
//!
//! let frame = ClassicFrame::new(StandardId::new(0x120).unwrap(), &[0xAB, 0xCD]).unwrap();
//! let line = encode(&frame);
//! assert_eq!(line.as_bytes(), b"t1202ABCD\r");
//!
//! let mut decoder = Decoder::new();
//! let read = line.as_bytes().iter().find_map(|&byte| decoder.push(byte));
//! assert_eq!(read, Some(Line::Frame(frame)));
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::arithmetic_side_effects
    )
)]

#[cfg(test)]
extern crate std;

mod classic;

pub use classic::ClassicFrame;

use embedded_can::{ExtendedId, Frame, Id, StandardId};

/// Maximum number of data bytes in a frame.
const FULL: usize = 8;

/// Maximum length of a line without CR: a frame with 29 bits, eight bytes and a time stamp.
pub const MAX_LINE_LEN: usize = 1 + 8 + 1 + 2 * FULL + 4;

/// Ends a line. On its own, it is the positive response to a command.
pub const CR: u8 = b'\r';
/// Negative response to a command or frame.
pub const BEL: u8 = 7;

/// A decoded line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line<F> {
    /// A frame: to send if from the host, received if from the adapter.
    Frame(F),
    /// A command: its letter and the first character of its parameter. `O` opens the channel, `C` closes it, `S6` and
    /// `s` set the bit rate, `Z1` enables time stamps.
    Command(u8, Option<u8>),
    /// The positive response to a frame: `z`, or `Z` for 29 bits.
    Taken(u8),
    /// An empty line: the positive response to a command.
    Done,
    /// The negative response to a command or frame.
    Refused,
    /// An invalid line: too long, or an invalid frame.
    Malformed,
}

/// Value of `count` for a line that is too long.
const TOO_LONG: u8 = MAX_LINE_LEN as u8 + 1;

/// Splits a stream of bytes into lines. After noise it resynchronizes at the next CR.
#[derive(Clone, Debug)]
pub struct Decoder {
    held: [u8; MAX_LINE_LEN],
    /// Number of held characters, or [`TOO_LONG`].
    count: u8,
}

impl Decoder {
    /// Creates a decoder for the start of a line.
    #[must_use]
    pub const fn new() -> Self {
        Self { held: [0; MAX_LINE_LEN], count: 0 }
    }

    /// Processes a byte. Returns the line that it ends, if any. Line feeds, which some hosts send, are ignored, and so are
    /// NULs before a line, which a serial line may add when a port is opened, or a C program after a string.
    pub fn push<F: Frame>(&mut self, byte: u8) -> Option<Line<F>> {
        match byte {
            CR => {
                let count = usize::from(core::mem::take(&mut self.count));
                Some(self.held.get(..count).map_or(Line::Malformed, line))
            }
            BEL => {
                self.count = 0;
                Some(Line::Refused)
            }
            b'\n' => None,
            0 if self.count == 0 => None,
            _ => {
                match self.held.get_mut(usize::from(self.count)) {
                    Some(place) => {
                        *place = byte;
                        self.count = self.count.saturating_add(1);
                    }
                    None => self.count = TOO_LONG,
                }
                None
            }
        }
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

fn line<F: Frame>(text: &[u8]) -> Line<F> {
    match text {
        [] => Line::Done,
        [b't' | b'T' | b'r' | b'R', ..] => frame(text).map_or(Line::Malformed, Line::Frame),
        [letter @ (b'z' | b'Z')] => Line::Taken(*letter),
        [letter, rest @ ..] => Line::Command(*letter, rest.first().copied()),
    }
}

fn frame<F: Frame>(text: &[u8]) -> Option<F> {
    let (letter, rest) = text.split_first()?;
    let (id, rest) = if letter.is_ascii_lowercase() {
        let (digits, rest) = rest.split_at_checked(3)?;
        (Id::Standard(StandardId::new(number(digits)? as u16)?), rest)
    } else {
        let (digits, rest) = rest.split_at_checked(8)?;
        (Id::Extended(ExtendedId::new(number(digits)?)?), rest)
    };
    let (dlc, rest) = rest.split_at_checked(1)?;
    let dlc = number(dlc)? as usize;
    let digits = if letter.eq_ignore_ascii_case(&b't') { dlc.checked_mul(2)? } else { 0 };
    let (data, stamp) = rest.split_at_checked(digits)?;
    if !matches!(stamp.len(), 0 | 4) {
        return None;
    }
    number(stamp)?;
    if digits == 0 && letter.eq_ignore_ascii_case(&b'r') {
        return F::new_remote(id, dlc);
    }
    let mut bytes = [0; FULL];
    let bytes = bytes.get_mut(..dlc)?;
    for (byte, digits) in bytes.iter_mut().zip(data.chunks(2)) {
        *byte = number(digits)? as u8;
    }
    F::new(id, bytes)
}

/// Returns the value of up to eight hexadecimal digits in upper or lower case.
fn number(digits: &[u8]) -> Option<u32> {
    digits.iter().try_fold(0u32, |number, &digit| {
        let value = match digit {
            b'0'..=b'9' => digit.wrapping_sub(b'0'),
            b'A'..=b'F' => digit.wrapping_sub(b'A' - 10),
            b'a'..=b'f' => digit.wrapping_sub(b'a' - 10),
            _ => return None,
        };
        Some(number.wrapping_shl(4) | u32::from(value))
    })
}

/// Encodes a frame as a line, including CR.
///
/// See the [crate's documentation](crate) for an example.
#[must_use]
pub fn encode<F: Frame>(frame: &F) -> Encoded {
    let mut line = Encoded { bytes: [0; MAX_LINE_LEN + 1], len: 0 };
    let (standard, extended) = if frame.is_remote_frame() { (b'r', b'R') } else { (b't', b'T') };
    match frame.id() {
        Id::Standard(id) => {
            line.append(standard);
            line.append_hex(id.as_raw().into(), 3);
        }
        Id::Extended(id) => {
            line.append(extended);
            line.append_hex(id.as_raw(), 8);
        }
    }
    line.append_hex(frame.dlc() as u32, 1);
    for &byte in frame.data().iter().take(FULL) {
        line.append_hex(byte.into(), 2);
    }
    line.append(CR);
    line
}

/// An encoded line, including CR.
#[derive(Clone, Copy, Debug)]
pub struct Encoded {
    bytes: [u8; MAX_LINE_LEN + 1],
    len: u8,
}

impl Encoded {
    /// Returns the characters of the line.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.len.into()).unwrap_or(&[])
    }

    fn append(&mut self, byte: u8) {
        if let Some(place) = self.bytes.get_mut(usize::from(self.len)) {
            *place = byte;
            self.len = self.len.saturating_add(1);
        }
    }

    /// Appends the lowest `digits` hexadecimal digits of a number.
    fn append_hex(&mut self, number: u32, digits: u32) {
        for place in (0..digits).rev() {
            let digit = (number.wrapping_shr(place.wrapping_mul(4)) & 0xF) as u8;
            self.append(if digit < 10 { digit.wrapping_add(b'0') } else { digit.wrapping_add(b'A' - 10) });
        }
    }
}

/// The adapter's side of the protocol: responses to the host, and no frames while the channel is closed.
///
/// ```
/// use bus_slcan::{Adapter, ClassicFrame, Line};
///
/// let mut adapter = Adapter::new();
/// assert_eq!(adapter.answer(&Line::<ClassicFrame>::Command(b'S', Some(b'6'))), b"\r");
/// assert!(!adapter.is_open());
/// assert_eq!(adapter.answer(&Line::<ClassicFrame>::Command(b'O', None)), b"\r");
/// assert!(adapter.is_open());
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Adapter {
    is_open: bool,
}

impl Adapter {
    /// Creates an adapter with a closed channel.
    #[must_use]
    pub const fn new() -> Self {
        Self { is_open: false }
    }

    /// Returns whether the channel is open, so that frames pass in both directions.
    #[must_use]
    pub const fn is_open(&self) -> bool {
        self.is_open
    }

    /// Returns the response to a line from the host; empty if the line is itself a response.
    pub fn answer<F: Frame>(&mut self, line: &Line<F>) -> &'static [u8] {
        const BEL_ALONE: &[u8] = &[BEL];
        match line {
            Line::Frame(_) if !self.is_open => BEL_ALONE,
            Line::Frame(frame) => {
                if frame.is_extended() {
                    b"Z\r"
                } else {
                    b"z\r"
                }
            }
            // Listen-only mode is rejected, because frames from the host would be lost.
            Line::Command(b'O', _) => {
                self.is_open = true;
                b"\r"
            }
            Line::Command(b'C', _) => {
                self.is_open = false;
                b"\r"
            }
            // Any of the nine standard rates is accepted; there is no bus.
            Line::Command(b'S', Some(b'0'..=b'8')) | Line::Command(b's', Some(_)) => b"\r",
            // Time stamps are not supported, so disabling them succeeds and enabling them is rejected.
            Line::Command(b'Z', Some(b'0')) => b"\r",
            Line::Command(b'F', _) => b"F00\r",
            Line::Command(b'V', _) => b"V0101\r",
            Line::Command(b'N', _) => b"N0001\r",
            Line::Done | Line::Refused | Line::Taken(_) => b"",
            Line::Command(..) | Line::Malformed => BEL_ALONE,
        }
    }
}

#[cfg(test)]
mod tests;

/// Compiles the README's example as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
