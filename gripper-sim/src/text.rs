//! Text from outside: how all host programs read it, and how they print it (feature `std`).
//!
//! Editors and shells save text in several ways: Notepad and .NET begin it with a byte order mark, and PowerShell's `>`
//! writes UTF-16. A topic, a device tag or a file name may contain control characters, which command a terminal and forge
//! lines of a log.

use std::borrow::Cow;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;

/// The byte order mark in UTF-8.
const MARK: &[u8] = b"\xEF\xBB\xBF";

/// Reads a text file in UTF-8, without its byte order mark.
///
/// # Errors
/// Returns an error if the file cannot be read, or is not UTF-8. The error names the encoding or the line.
pub fn read(path: &Path) -> io::Result<String> {
    decoded(fs::read(path)?)
}

/// Decodes text in UTF-8, without its byte order mark.
///
/// # Errors
/// Returns an error if the text is not UTF-8. The error names the encoding or the line.
///
/// ```
/// use wsg_sim::text::decoded;
///
/// assert_eq!(decoded(b"\xEF\xBB\xBFhome\n".to_vec()).unwrap(), "home\n");
/// assert!(decoded(b"\xFF\xFEh\0o\0".to_vec()).unwrap_err().to_string().contains("UTF-16"));
/// ```
pub fn decoded(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(unmarked(bytes)?).map_err(|error| {
        // Without the invalid byte, because the text may be a password.
        let valid = error.as_bytes().iter().take(error.utf8_error().valid_up_to());
        let line = 1 + valid.filter(|byte| **byte == b'\n').count();
        invalid(&format!("line {line} is not UTF-8; save the text as UTF-8"))
    })
}

/// Removes the byte order mark of UTF-8. For text that may have another encoding for its letters, such as a Lua script.
///
/// # Errors
/// Returns an error if the text is UTF-16 or UTF-32.
pub fn unmarked(mut bytes: Vec<u8>) -> io::Result<Vec<u8>> {
    let encoding = match bytes.as_slice() {
        [0xFF, 0xFE, 0, 0, ..] | [0, 0, 0xFE, 0xFF, ..] => "UTF-32",
        [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] => "UTF-16",
        // Without a mark: two ASCII characters.
        [0, 1..=0x7F, 0, 1..=0x7F, ..] | [1..=0x7F, 0, 1..=0x7F, 0, ..] => "UTF-16",
        _ => {
            if bytes.starts_with(MARK) {
                bytes.drain(..MARK.len());
            }
            return Ok(bytes);
        }
    };
    Err(invalid(&format!("the text is {encoding}; save it as UTF-8")))
}

fn invalid(what: &str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, what)
}

/// Returns a text as one printable line: control characters other than the tab, invisible characters and characters that
/// change the direction of writing become escape sequences.
///
/// ```
/// use wsg_sim::text::one_line;
///
/// assert_eq!(one_line("cell 4"), "cell 4");
/// assert_eq!(one_line("x\n\x1b[2Jwsg: stopped"), "x\\n\\u{1b}[2Jwsg: stopped");
/// ```
#[must_use]
pub fn one_line(text: &str) -> Cow<'_, str> {
    if !text.contains(is_hidden) {
        return Cow::Borrowed(text);
    }
    let mut line = String::new();
    for char in text.chars() {
        if is_hidden(char) {
            line.extend(char.escape_default());
        } else {
            line.push(char);
        }
    }
    line.into()
}

fn is_hidden(char: char) -> bool {
    match char {
        '\t' => false,
        // Marks and overrides of the direction, ends of lines and paragraphs, zero width, and tags.
        '\u{61C}'
        | '\u{200B}'..='\u{200F}'
        | '\u{2028}'..='\u{202E}'
        | '\u{2060}'..='\u{206F}'
        | '\u{FEFF}'
        | '\u{E0000}'..='\u{E007F}' => true,
        _ => char.is_control(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mark_is_removed_once_and_line_ends_stay() {
        for (bytes, text) in [
            (&b"\xEF\xBB\xBFhome\r\n"[..], "home\r\n"),
            (b"home\n", "home\n"),
            (b"\xEF\xBB\xBF", ""),
            (b"", ""),
            (b"0", "0"),
            ("\u{FEFF}\u{FEFF}gr\u{FC}n".as_bytes(), "\u{FEFF}gr\u{FC}n"),
        ] {
            assert_eq!(decoded(bytes.to_vec()).unwrap(), text);
        }
        let latin = b"\xEF\xBB\xBFprint('\xE4')".to_vec();
        assert_eq!(unmarked(latin).unwrap(), b"print('\xE4')");
    }

    #[test]
    fn other_encodings_are_named() {
        let utf_16 = |mark: &[u8], bytes_of: fn(u16) -> [u8; 2]| {
            [mark, &"home\n".encode_utf16().flat_map(bytes_of).collect::<Vec<_>>()].concat()
        };
        for (bytes, expected) in [
            (utf_16(b"\xFF\xFE", u16::to_le_bytes), "the text is UTF-16; save it as UTF-8"),
            (utf_16(b"\xFE\xFF", u16::to_be_bytes), "UTF-16"),
            (utf_16(b"", u16::to_le_bytes), "UTF-16"),
            (utf_16(b"", u16::to_be_bytes), "UTF-16"),
            (b"\xFF\xFE\0\0h\0\0\0".to_vec(), "UTF-32"),
            (b"\0\0\xFE\xFF\0\0\0h".to_vec(), "UTF-32"),
            (b"home\nmove \xE4\n".to_vec(), "line 2 is not UTF-8; save the text as UTF-8"),
        ] {
            let error = decoded(bytes).unwrap_err();
            assert!(
                error.kind() == ErrorKind::InvalidData && error.to_string().contains(expected),
                "{error}"
            );
        }
    }

    #[test]
    fn control_characters_are_escaped_in_a_line() {
        for (text, line) in [
            ("left\tC:\\x \"gr\u{FC}n\" e\u{301}", "left\tC:\\x \"gr\u{FC}n\" e\u{301}"),
            ("a\r\nwsg: b", "a\\r\\nwsg: b"),
            ("\u{1b}]0;x\u{7}\u{7f}\u{9b}2J", "\\u{1b}]0;x\\u{7}\\u{7f}\\u{9b}2J"),
            ("a\u{202E}b\u{2028}\u{200B}", "a\\u{202e}b\\u{2028}\\u{200b}"),
        ] {
            assert_eq!(one_line(text), line);
        }
    }
}
