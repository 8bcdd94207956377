//! The input language of a command editor (command set, chapter 2): a command by name or id, and a payload of bytes,
//! floating point numbers and texts.
//!
//! `wsg gripper ADDRESS raw` and the page of `wsg-sim` both use it.

use core::fmt::{Display, Formatter, Write as _};

use crate::command::CommandId;
use crate::decimal;

/// A text that the language does not accept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EditorError<'a> {
    /// Neither an id nor a command's name.
    Command(&'a str),
    /// Not a byte, a floating point number or a text.
    Value(&'a str),
    /// A number that does not fit in a byte.
    Byte(&'a str),
    /// Not a finite number of 32 bits.
    Float(&'a str),
    /// A text without a closing quotation mark, or with a character that is not printable ASCII.
    Text(&'a str),
    /// The payload is longer than this number of bytes.
    TooLong(usize),
}

impl Display for EditorError<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        let (text, is_wrong) = match *self {
            Self::Command(text) => {
                f.write_str("unknown command ")?;
                (text, "; expected a name such as \"Grip Part\", or an id from 0 to 255 such as 0x25")
            }
            Self::Value(text) => {
                (text, " is no value; expected bytes such as 32 or 0x20, floats such as 150.0f, or \"text\"")
            }
            Self::Byte(text) => (text, " is no byte; expected 0 to 255 or 0x00 to 0xFF"),
            Self::Float(text) => (text, " is no finite float; expected a number such as 150.0f"),
            Self::Text(text) => {
                (text, " is no text; expected printable ASCII in quotation marks, such as \"text\"")
            }
            Self::TooLong(limit) => {
                return write!(f, "the payload is too long; expected at most {limit} bytes");
            }
        };
        write!(f, "{}{is_wrong}", Quoted(text))
    }
}

impl core::error::Error for EditorError<'_> {}

/// A text in quotation marks, in one line. `{:?}` has the tables of all printable characters.
#[derive(Clone, Copy, Debug)]
pub struct Quoted<'a>(pub &'a str);

impl Display for Quoted<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        f.write_str("\"")?;
        for char in self.0.chars() {
            match char {
                '\0'..' ' | '"' | '\\' | '\u{7f}'..'\u{a0}' => write!(f, "{}", char.escape_default())?,
                char => f.write_char(char)?,
            }
        }
        f.write_str("\"")
    }
}

/// Parses a command: its id (`37`, `0x25` or `25h`), or its name in the manual. Names ignore case, and blanks, hyphens
/// and underscores.
///
/// ```
/// use wsg_protocol::{CommandId, editor};
///
/// for text in ["37", "0x25", "25h", "Grip Part", "grip-part", "GRIP_PART"] {
///     assert_eq!(editor::command_id(text), Ok(CommandId::GripPart));
/// }
/// assert!(editor::command_id("Grab").is_err());
/// ```
///
/// # Errors
/// [`EditorError::Command`] with the text.
pub fn command_id(text: &str) -> Result<CommandId, EditorError<'_>> {
    let text = text.trim();
    if let Some(Ok(code)) = byte(text) {
        return Ok(CommandId::from_code(code));
    }
    let named = CommandId::ALL.iter().find(|id| significant(id.name()).eq(significant(text)));
    named.copied().ok_or(EditorError::Command(text))
}

/// Returns the characters of a name that matter, in lower case.
fn significant(name: &str) -> impl Iterator<Item = char> {
    name.chars().filter(|char| !matches!(char, ' ' | '-' | '_')).map(|char| char.to_ascii_lowercase())
}

/// Parses a payload into `buffer` and returns its length. Blanks and commas separate the values:
///
/// - a byte, decimal or hexadecimal: `32`, `0x20` or `20h`
/// - a floating point number: `150.0f`, four bytes, lowest first
/// - a text in quotation marks: `"text"`, with `\"` and `\\` for these two characters
///
/// ```
/// use wsg_protocol::editor;
///
/// let mut buffer = [0; 16];
/// let len = editor::payload(r#"1, 0x20 150.0f "ack""#, &mut buffer).unwrap();
/// assert_eq!(buffer[..len], [1, 0x20, 0x00, 0x00, 0x16, 0x43, b'a', b'c', b'k']);
/// assert_eq!(editor::payload("256", &mut buffer), Err(editor::EditorError::Byte("256")));
/// ```
///
/// # Errors
/// The first value that is invalid or does not fit.
pub fn payload<'a>(text: &'a str, buffer: &mut [u8]) -> Result<usize, EditorError<'a>> {
    let limit = buffer.len();
    let mut places = buffer.iter_mut();
    let mut put = |byte: u8| places.next().map(|place| *place = byte).ok_or(EditorError::TooLong(limit));
    let is_separator = |char: char| char.is_ascii_whitespace() || char == ',';
    let mut rest = text.trim_start_matches(is_separator);
    while !rest.is_empty() {
        let word = if rest.starts_with('"') {
            let word = quoted(rest)?;
            for byte in unescaped(word) {
                put(byte)?;
            }
            word
        } else {
            let word = rest.split(is_separator).next().unwrap_or(rest);
            match byte(word) {
                Some(byte) => put(byte.map_err(|()| EditorError::Byte(word))?)?,
                None => {
                    for byte in float(word)?.to_le_bytes() {
                        put(byte)?;
                    }
                }
            }
            word
        };
        rest = rest.strip_prefix(word).unwrap_or("").trim_start_matches(is_separator);
    }
    Ok(limit.saturating_sub(places.len()))
}

/// Parses a byte; `None` if the text is not an integer.
fn byte(text: &str) -> Option<Result<u8, ()>> {
    let is_of = |digits: &str, is_digit: fn(&u8) -> bool| {
        !digits.is_empty() && digits.bytes().all(|byte| is_digit(&byte))
    };
    let (digits, radix) = if is_of(text, u8::is_ascii_digit) {
        (text, 10)
    } else {
        let digits =
            text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")).or_else(|| text.strip_suffix('h'))?;
        (digits, 16)
    };
    let is_hex = radix == 10 || is_of(digits, u8::is_ascii_hexdigit);
    is_hex.then(|| u8::from_str_radix(digits, radix).map_err(drop))
}

/// Parses a decimal number, perhaps with an exponent, to the nearest `f32`; infinity if it is too large. Unlike [`str::parse`], it
/// needs no tables of 10 KB, and does not accept `inf` and `nan`.
///
/// ```
/// use wsg_protocol::editor;
///
/// assert_eq!(["-1.5e1", "40 N"].map(editor::number), [Some(-15.0), None]);
/// ```
#[must_use]
pub fn number(text: &str) -> Option<f32> {
    decimal::read(text.as_bytes())
}

fn float(word: &str) -> Result<f32, EditorError<'_>> {
    let digits =
        word.strip_suffix(['f', 'F']).filter(|digits| digits.bytes().any(|byte| byte.is_ascii_digit()));
    let digits = digits.ok_or(EditorError::Value(word))?;
    let number = number(digits).ok_or(EditorError::Value(word))?;
    if number.is_finite() { Ok(number) } else { Err(EditorError::Float(word)) }
}

/// Returns the text in quotation marks at the start, including the marks.
fn quoted(text: &str) -> Result<&str, EditorError<'_>> {
    let mut is_escaped = false;
    for (at, byte) in text.bytes().enumerate().skip(1) {
        match byte {
            _ if !matches!(byte, b' '..=b'~') => break,
            b'"' if !is_escaped => return text.get(..=at).ok_or(EditorError::Text(text)),
            _ => is_escaped = byte == b'\\' && !is_escaped,
        }
    }
    Err(EditorError::Text(text))
}

/// Returns the bytes of a text in quotation marks.
fn unescaped(word: &str) -> impl Iterator<Item = u8> {
    let inner = word.strip_prefix('"').and_then(|word| word.strip_suffix('"')).unwrap_or("");
    let mut is_escaped = false;
    inner.bytes().filter(move |byte| {
        is_escaped = *byte == b'\\' && !is_escaped;
        !is_escaped
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::{String, ToString};

    fn parsed(text: &str) -> Result<std::vec::Vec<u8>, String> {
        let mut buffer = [0; 12];
        let len = payload(text, &mut buffer).map_err(|error| error.to_string())?;
        Ok(buffer[..len].to_vec())
    }

    #[test]
    fn every_kind_of_value_becomes_its_bytes() {
        for (text, bytes) in [
            ("", &[][..]),
            ("  , ", &[]),
            ("0 255 007", &[0, 255, 7]),
            ("0x0 0xfF,0X10 20h", &[0, 255, 16, 32]),
            ("150.0f", &[0, 0, 0x16, 0x43]),
            ("-1f", &[0, 0, 0x80, 0xBF]),
            ("1e2F", &[0, 0, 0xC8, 0x42]),
            (r#""ack""#, b"ack"),
            (r#""""#, b""),
            (r#""a, b" 1"#, b"a, b\x01"),
            (r#""\"\\""#, b"\"\\"),
        ] {
            assert_eq!(parsed(text), Ok(bytes.to_vec()), "{text}");
        }
    }

    #[test]
    fn errors_name_the_value_and_what_was_expected() {
        for (text, expected) in [
            (r#"1"x""#, "is no value"),
            ("1 256", "\"256\" is no byte; expected 0 to 255"),
            ("0x100", "\"0x100\" is no byte"),
            ("100h", "\"100h\" is no byte"),
            ("-1", "\"-1\" is no value; expected bytes such as 32"),
            ("150.0", "\"150.0\" is no value"),
            ("0x", "\"0x\" is no value"),
            ("nanf", "\"nanf\" is no value"),
            ("1e99f", "\"1e99f\" is no finite float"),
            ("\"open", "expected printable ASCII in quotation marks"),
            ("\"\u{e9}\"", "expected printable ASCII"),
            ("\"\n\"", "expected printable ASCII"),
            ("1 2 3 4 5 6 7 8 9 10 11 12 13", "the payload is too long; expected at most 12 bytes"),
        ] {
            let error = parsed(text).unwrap_err();
            assert!(error.contains(expected) && !error.contains('\n'), "{text}: {error}");
        }
    }

    #[test]
    fn every_command_is_found_by_its_name_and_its_id() {
        for id in CommandId::ALL {
            assert_eq!(command_id(id.name()), Ok(*id));
            assert_eq!(command_id(&std::format!("{:#04x}", id.code())), Ok(*id));
            assert_eq!(command_id(&id.code().to_string()), Ok(*id));
        }
        assert_eq!(command_id("0xB0"), Ok(CommandId::Unknown(0xB0)));
        for wrong in ["", "Grab", "256", "0x100", "-1"] {
            assert_eq!(command_id(wrong), Err(EditorError::Command(wrong)));
        }
    }

    proptest::proptest! {
        #[test]
        fn any_text_is_parsed_or_refused_within_the_buffer(text in ".{0,40}", limit in 0_usize..12) {
            let mut buffer = [0; 12];
            match payload(&text, &mut buffer[..limit]) {
                Ok(len) => assert!(len <= limit),
                Err(error) => assert!(!error.to_string().contains('\n')),
            }
            let _ = command_id(&text);
        }

        #[test]
        fn bytes_and_floats_come_back(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..6), float in -1e6_f32..1e6) {
            let words: std::vec::Vec<String> = bytes.iter().map(|byte| std::format!("{byte:#04x}")).collect();
            let text = std::format!("{}, {float:?}f", words.join(" "));
            let expected: std::vec::Vec<u8> = bytes.into_iter().chain(float.to_le_bytes()).collect();
            assert_eq!(parsed(&text), Ok(expected));
        }
    }
}
