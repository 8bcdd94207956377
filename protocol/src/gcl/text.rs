//! Texts in answers (GCL, 1.3 and appendix E), and conversions of device texts.

use super::ParseError;
use super::form::{Word, assigned, notation};
use super::number::read_integer;
use super::scanner::{Scanner, is_blank};
use crate::types::{DeviceTag, DeviceType, FingerType, FirmwareVersion, Status};
use core::fmt::{Formatter, Result as Written, Write};

/// The text between quotation marks: printable ASCII characters except the quotation mark, which the manual has no escape for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct Text<'a>(&'a str);

impl<'a> Text<'a> {
    /// Checks a text.
    ///
    /// # Errors
    /// [`ParseError::Text`] for a character that is not permitted.
    pub fn new(text: &'a str) -> Result<Self, ParseError> {
        let is_allowed = |byte: u8| (0x20..0x7F).contains(&byte) && byte != b'"';
        if text.bytes().all(is_allowed) { Ok(Self(text)) } else { Err(ParseError::Text) }
    }

    /// Returns the text without quotation marks.
    #[must_use]
    pub const fn as_str(self) -> &'a str {
        self.0
    }

    /// Returns the product in an answer to DEVTYPE: `WSG 50-110` is a WSG 50.
    ///
    /// ```
    /// use wsg_protocol::DeviceType;
    /// use wsg_protocol::gcl::Text;
    ///
    /// assert_eq!(Text::new("WSG 32-068").unwrap().device_type(), DeviceType::Wsg32);
    /// assert_eq!(Text::new("toaster").unwrap().device_type(), DeviceType::Unspecified);
    /// ```
    #[must_use]
    pub fn device_type(self) -> DeviceType {
        const NAMES: [(&str, DeviceType); 6] = [
            ("WSG 50", DeviceType::Wsg50),
            ("WSG 32", DeviceType::Wsg32),
            ("KMS 40", DeviceType::Kms40),
            ("WTS", DeviceType::Wts),
            ("WSG 25", DeviceType::Wsg25),
            ("WSG 70", DeviceType::Wsg70),
        ];
        let named = NAMES.into_iter().find(|(name, _)| self.0.starts_with(name));
        named.map_or(DeviceType::Unspecified, |(_, device)| device)
    }

    /// Returns the stroke in mm in an answer to DEVTYPE: `WSG 50-110` has 110 mm. `None` for a text that is not the
    /// designation of a WSG with its stroke.
    ///
    /// ```
    /// use wsg_protocol::gcl::Text;
    ///
    /// assert_eq!(Text::new("WSG 32-068").unwrap().stroke(), Some(68.0));
    /// assert_eq!(Text::new("WSG 50").unwrap().stroke(), None);
    /// ```
    #[must_use]
    pub fn stroke(self) -> Option<f32> {
        let mut digits = self.0.bytes().skip_while(|byte| *byte != b'-').skip(1).peekable();
        let is_designation = self.0.starts_with("WSG ") && digits.peek().is_some_and(u8::is_ascii_digit);
        let stroke = digits.take_while(u8::is_ascii_digit).try_fold(0_u16, |stroke, digit| {
            stroke.checked_mul(10)?.checked_add(digit.wrapping_sub(b'0').into())
        })?;
        (is_designation && stroke > 0).then(|| stroke.into())
    }

    /// Returns the version in an answer to VERSION. `None` unless it has three numbers up to 15, or a release candidate in
    /// addition (`4.0.0-rc1`), the range of the binary protocol.
    ///
    /// ```
    /// use wsg_protocol::FirmwareVersion;
    /// use wsg_protocol::gcl::Text;
    ///
    /// let version = Text::new("4.0.0").unwrap().firmware_version();
    /// assert_eq!(version, Some(FirmwareVersion::new(4, 0, 0, 0)));
    /// ```
    #[must_use]
    pub fn firmware_version(self) -> Option<FirmwareVersion> {
        if self.0.bytes().any(is_blank) {
            return None;
        }
        let mut input = Scanner::new(self.0.as_bytes());
        let number = |input: &mut Scanner<'_>| {
            u8::try_from(read_integer(input).ok()?).ok().filter(|number| *number <= 15)
        };
        let major = number(&mut input)?;
        input.expect(b'.').ok()?;
        let minor = number(&mut input)?;
        input.expect(b'.').ok()?;
        let patch = number(&mut input)?;
        let candidate = if input.take(b'-') {
            [b'r', b'c'].into_iter().try_for_each(|letter| input.expect(letter)).ok()?;
            number(&mut input)?
        } else {
            0
        };
        input.end().ok()?;
        Some(FirmwareVersion::new(major, minor, patch, candidate))
    }

    /// Returns the type of finger in an answer to FTYPE.
    ///
    /// ```
    /// use wsg_protocol::FingerType;
    /// use wsg_protocol::gcl::Text;
    ///
    /// assert_eq!(Text::new("WSG-FMF").unwrap().finger_type(), FingerType::Fmf);
    /// assert_eq!(Text::new("").unwrap().finger_type(), FingerType::Generic);
    /// ```
    #[must_use]
    pub fn finger_type(self) -> FingerType {
        // `str::contains` would keep a panic path.
        let names = |kind: &[u8; 3]| self.0.as_bytes().windows(3).any(|letters| letters == kind);
        if names(b"FMF") {
            FingerType::Fmf
        } else if names(b"DSA") {
            FingerType::Dsa
        } else {
            FingerType::Generic
        }
    }
}

impl core::fmt::Display for Text<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Written {
        f.write_str(self.0)
    }
}

assigned!(Text<'a>, DeviceTag<'a>);

impl<'a> Word<'a> for Text<'a> {
    notation!("<string>");

    fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError> {
        let text = input.quoted()?;
        Self::new(core::str::from_utf8(text).map_err(|_| ParseError::Text)?)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_char('"')?;
        to.write_str(self.0)?;
        to.write_char('"')
    }
}

/// A tag may contain quotation marks. It is the last word of its line, so the last quotation mark ends it.
impl<'a> Word<'a> for DeviceTag<'a> {
    notation!("<string>");

    fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError> {
        let text = input.remainder().strip_prefix(b"\"").and_then(|text| text.strip_suffix(b"\""));
        let text = core::str::from_utf8(text.ok_or(ParseError::Form)?).map_err(|_| ParseError::Text)?;
        Self::new(text).map_err(|_| ParseError::Text)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_char('"')?;
        to.write_str(self.as_str())?;
        to.write_char('"')
    }
}

/// The text of an error in verbose mode (GCL, 1.3), in any language and character set.
#[derive(Clone, Copy, PartialEq, Eq, crate::Format)]
pub struct Description<'a>(&'a [u8]);

impl<'a> Description<'a> {
    /// Returns the text without surrounding blanks; `None` if it is empty or has more than one line.
    #[must_use]
    pub fn new(text: &'a [u8]) -> Option<Self> {
        let text = text.trim_ascii();
        let is_one_line = !text.is_empty() && !text.iter().any(|byte| matches!(byte, b'\n' | b'\r'));
        is_one_line.then_some(Self(text))
    }

    /// Returns the text of a status: its [meaning](Status::meaning) (GCL, 1.3 and appendix A).
    #[must_use]
    pub const fn of(status: Status) -> Description<'static> {
        Description(status.meaning().as_bytes())
    }

    /// Returns the bytes in the gripper's character set.
    #[must_use]
    pub const fn bytes(self) -> &'a [u8] {
        self.0
    }

    pub(super) fn write(self, to: &mut impl Write) -> Written {
        self.0.utf8_chunks().try_for_each(|chunk| {
            to.write_str(chunk.valid())?;
            if chunk.invalid().is_empty() { Ok(()) } else { to.write_char('?') }
        })
    }
}

impl core::fmt::Display for Description<'_> {
    /// Writes invalid UTF-8 as `?`.
    fn fmt(&self, f: &mut Formatter<'_>) -> Written {
        self.write(f)
    }
}

impl core::fmt::Debug for Description<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Written {
        write!(f, "\"{self}\"")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stroke_is_the_number_after_the_first_hyphen_of_a_wsg() {
        for (text, stroke) in [
            ("WSG 50-110", Some(110.0)),
            ("WSG 50-210", Some(210.0)),
            ("WSG 25-064", Some(64.0)),
            ("WSG 50-110-B", Some(110.0)),
            ("WSG 50-110 (special)", Some(110.0)),
            ("WSG 50", None),
            ("WSG 50-", None),
            ("WSG 50-B110", None),
            ("WSG 50-0", None),
            ("WSG 50-70000", None),
            ("KMS 40-7", None),
            ("", None),
        ] {
            assert_eq!(Text::new(text).unwrap().stroke(), stroke, "{text}");
        }
    }
}
