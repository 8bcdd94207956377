//! Hex dumps: `xxd`, `hexdump -C`, `od -A x -t x1`, and plain hex digits.

/// Maximum number of bytes that a `*` may stand for.
const MAX_REPEATED: u64 = 1 << 24;

#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Dump {
    /// Offset of the first byte, as stated in the dump.
    pub(crate) offset: u64,
    pub(crate) bytes: Vec<u8>,
    /// Numbers of lines that could not be parsed, counted from 1.
    pub(crate) strange: Vec<usize>,
}

/// A line of a dump.
#[derive(Debug, PartialEq, Eq)]
struct Line {
    offset: Option<u64>,
    bytes: Vec<u8>,
}

/// Returns whether this is a line of a dump with at least one byte.
pub(crate) fn is_line(line: &str) -> bool {
    parse_line(line.trim(), false).is_some_and(|line| !line.bytes.is_empty())
}

pub(crate) fn parse(text: &str) -> Dump {
    let mut dump = Dump::default();
    let mut last: Vec<u8> = Vec::new();
    let mut repeats = false;
    let mut has_offsets = false;
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        if line == "*" {
            repeats = true;
            continue;
        }
        let Some(Line { offset, bytes }) = parse_line(line, has_offsets) else {
            dump.strange.push(number + 1);
            continue;
        };
        has_offsets |= offset.is_some();
        if dump.bytes.is_empty() {
            dump.offset = offset.unwrap_or(0);
        }
        if let Some(offset) = offset.filter(|_| std::mem::take(&mut repeats)) {
            let missing = offset.saturating_sub(dump.offset).saturating_sub(dump.bytes.len() as u64);
            if missing <= MAX_REPEATED {
                dump.bytes.extend(last.iter().cycle().take(missing as usize));
            } else {
                dump.strange.push(number + 1);
            }
        }
        dump.bytes.extend_from_slice(&bytes);
        if !bytes.is_empty() {
            last = bytes;
        }
    }
    dump
}

/// Parses a line. `has_offsets`: earlier lines have offsets, so a lone number is the end offset.
fn parse_line(line: &str, has_offsets: bool) -> Option<Line> {
    // `00000000: aaaa aa22 0000 0e76  ..."...v`
    if let Some((offset, rest)) = line.split_once(':')
        && let Some(offset) = offset_of(offset)
    {
        let digits = rest.trim_start().split("  ").next().unwrap_or("");
        return Some(Line { offset: Some(offset), bytes: bytes_of(digits)? });
    }
    // `00000000  aa aa aa 22 00 00 0e 76  aa ...  |...".v|`
    let (digits, text) = line.split_once('|').map_or((line, None), |(digits, text)| (digits, Some(text)));
    let (first, rest) = digits.split_once(char::is_whitespace).unwrap_or((digits, ""));
    let mut words = rest.split_whitespace().peekable();
    let has_offset = match words.peek() {
        None => has_offsets,
        Some(_) => text.is_some() || (first.len() >= 6 && words.all(|word| word.len() == 2)),
    };
    if has_offset
        && !first.to_ascii_uppercase().starts_with("AAAAAA")
        && let Some(offset) = offset_of(first)
    {
        return Some(Line { offset: Some(offset), bytes: bytes_of(rest)? });
    }
    Some(Line { offset: None, bytes: bytes_of(digits)? })
}

fn offset_of(digits: &str) -> Option<u64> {
    let digits = digits.trim();
    let is_offset = (4..=16).contains(&digits.len()) && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    is_offset.then(|| u64::from_str_radix(digits, 16).ok()).flatten()
}

/// Parses bytes in any of the forms `AA AA`, `aaaa`, `0xAA, 0xAA` and `AAh`.
fn bytes_of(digits: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    for word in
        digits.split(|c: char| c.is_whitespace() || matches!(c, ',' | ';')).filter(|word| !word.is_empty())
    {
        let word = word.strip_prefix("0x").or_else(|| word.strip_prefix("0X")).unwrap_or(word);
        let word = word.strip_suffix(['h', 'H']).unwrap_or(word);
        if word.is_empty()
            || !word.len().is_multiple_of(2)
            || !word.bytes().all(|digit| digit.is_ascii_hexdigit())
        {
            return None;
        }
        for pair in word.as_bytes().chunks(2) {
            let pair = std::str::from_utf8(pair).ok()?;
            bytes.push(u8::from_str_radix(pair, 16).ok()?);
        }
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STOP: [u8; 8] = [0xAA, 0xAA, 0xAA, 0x22, 0x00, 0x00, 0x0E, 0x76];

    #[track_caller]
    fn assert_dump(text: &str, offset: u64, bytes: &[u8]) {
        assert_eq!(parse(text), Dump { offset, bytes: bytes.to_vec(), strange: vec![] });
        assert!(is_line(text.lines().next().unwrap()));
    }

    #[test]
    fn every_dump_format_is_parsed() {
        assert_dump("00000000: aaaa aa22 0000 0e76                      ...\"...v\n", 0, &STOP);
        assert_dump(
            "00000010  aa aa aa 22 00 00 0e 76                           |...\"...v|\n00000018\n",
            16,
            &STOP,
        );
        assert_dump("000020 aa aa aa 22 00 00 0e 76\n000028\n", 32, &STOP);
        assert_dump("AA AA AA 22 00 00 0E 76", 0, &STOP);
        assert_dump("aaaaaa2200000e76", 0, &STOP);
        assert_dump("AAAAAA 22 0000 0E76", 0, &STOP);
        assert_dump("AAAAAA 22 00 00 0E 76", 0, &STOP);
        assert_dump("0xAA, 0xAA, 0xAA, 0x22, 0x00,\n0x00, 0x0E, 0x76,\n", 0, &STOP);
        assert_dump("AAh AAh AAh 22h\n00h 00h 0Eh 76h\n", 0, &STOP);
    }

    #[test]
    fn asterisk_repeats_the_previous_line() {
        let text = "00000000  01 02 |..|\n*\n00000006  03 |.|\n00000007\n";
        assert_dump(text, 0, &[1, 2, 1, 2, 1, 2, 3]);
        let endless = parse("00000000  01 |.|\n*\nffffffffffffff  03 |.|\n");
        assert_eq!((endless.bytes, endless.strange), (vec![1, 3], vec![3]));
    }

    #[test]
    fn lines_outside_a_dump_are_listed() {
        let dump = parse("AA AA\n# a comment\nGRIP(20)\n22\n");
        assert_eq!(dump, Dump { offset: 0, bytes: vec![0xAA, 0xAA, 0x22], strange: vec![3] });
        assert!(!is_line("GRIP(20)") && !is_line("AAA") && !is_line(""));
    }
}
