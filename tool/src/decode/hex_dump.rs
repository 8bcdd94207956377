//! Hex dumps: `xxd`, `hexdump -C`, `od -t x1`, Wireshark's *Copy as Hex Dump*, and plain hex digits.

use std::ops::RangeInclusive;

/// Maximum number of bytes that a `*` may stand for.
const MAX_REPEATED: u64 = 1 << 24;

/// A part of a dump. Bytes of two parts may not belong together.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// Consecutive bytes, and the offset of the first.
    Bytes(u64, Vec<u8>),
    /// Numbers of consecutive lines that could not be parsed, counted from 1.
    Unread(RangeInclusive<usize>),
}

/// A line of a dump: the digits of its offset, if it has one, and its bytes.
#[derive(Debug, PartialEq, Eq)]
struct DumpLine<'a> {
    offset: Option<&'a str>,
    bytes: Vec<u8>,
}

/// Returns whether this is a line of a dump with at least one byte.
pub(crate) fn is_line(line: &str) -> bool {
    parse_line(line.trim(), None).is_some_and(|line| !line.bytes.is_empty())
}

/// Returns whether a line has no bytes but may be part of a dump.
pub(crate) fn is_remark(line: &str) -> bool {
    let line = line.trim();
    line.is_empty() || line == "*" || line.starts_with('#')
}

/// A dump whose lines are being read.
struct Dump<'a> {
    parts: Vec<Part>,
    /// The last line with bytes, which a `*` repeats.
    last: DumpLine<'a>,
    /// Whether lines begin with an offset; the first line shows it.
    has_offsets: Option<bool>,
    /// Base of the offsets.
    radix: u32,
    /// Number of bytes so far, which is the offset in a dump without offsets.
    count: u64,
}

/// Divides a dump into parts: an unreadable line and a jump of the offsets end a part.
pub(crate) fn parse(text: &str) -> Vec<Part> {
    let last = DumpLine { offset: None, bytes: Vec::new() };
    let mut dump = Dump { parts: Vec::new(), last, has_offsets: None, radix: 16, count: 0 };
    let mut repeats = false;
    for (number, line) in (1..).zip(text.lines().map(str::trim)) {
        if line == "*" {
            repeats = true;
        } else if !is_remark(line) {
            let is_read = parse_line(line, dump.has_offsets)
                .is_some_and(|line| dump.take(line, std::mem::take(&mut repeats)));
            if !is_read {
                dump.unread(number);
            }
        }
    }
    dump.parts
}

impl<'a> Dump<'a> {
    /// Adds a line. Returns false if it shows that bytes before it are missing.
    fn take(&mut self, line: DumpLine<'a>, repeats: bool) -> bool {
        self.has_offsets.get_or_insert(line.offset.is_some());
        // Number of bytes between the last line and this one.
        let gap = |radix| {
            let of = |line: &DumpLine<'_>| u64::from_str_radix(line.offset?, radix).ok();
            of(&line)?.checked_sub(of(&self.last)?)?.checked_sub(self.last.bytes.len() as u64)
        };
        // `od` writes seven digits, octal by default or decimal. No other program does, so a jump of other offsets stays one.
        let radices =
            if line.offset.is_some_and(|digits| digits.len() == 7) { &[8, 10, 16][..] } else { &[16] };
        let radix = radices.iter().copied().find(|radix| gap(*radix) == Some(0));
        let radix = radix.unwrap_or(self.radix);
        let missing = gap(radix);
        self.radix = radix;
        let offset = match line.offset {
            Some(digits) => u64::from_str_radix(digits, 16).unwrap_or_default(),
            None => self.count,
        };
        let is_next = line.offset.is_none() || missing == Some(0);
        let is_repeated = repeats && missing.is_some_and(|missing| missing <= MAX_REPEATED);
        match self.parts.last_mut() {
            Some(Part::Bytes(_, bytes)) if is_next || is_repeated => {
                let repeated = missing.filter(|_| is_repeated).unwrap_or_default();
                bytes.extend(self.last.bytes.iter().cycle().take(repeated as usize));
                bytes.extend_from_slice(&line.bytes);
                self.count += repeated;
            }
            // The offset after the end.
            _ if line.bytes.is_empty() => {}
            _ => self.parts.push(Part::Bytes(offset, line.bytes.clone())),
        }
        self.count += line.bytes.len() as u64;
        if !line.bytes.is_empty() {
            self.last = line;
        }
        !repeats || is_repeated
    }

    fn unread(&mut self, number: usize) {
        match self.parts.last_mut() {
            Some(Part::Unread(lines)) if *lines.end() + 1 == number => *lines = *lines.start()..=number,
            _ => self.parts.push(Part::Unread(number..=number)),
        }
    }
}

/// Parses a line. `has_offsets`: whether earlier lines begin with an offset, or `None` for the first line.
fn parse_line(line: &str, has_offsets: Option<bool>) -> Option<DumpLine<'_>> {
    // `00000000: aaaa aa22 0000 0e76  ..."...v`
    if let Some((offset, rest)) = line.split_once(':')
        && has_offsets != Some(false)
    {
        let bytes = bytes_of(rest.trim_start().split("  ").next()?)?;
        return Some(DumpLine { offset: Some(digits_of(offset)?), bytes });
    }
    // `00000000  aa aa aa 22 00 00 0e 76  aa ...  |...".v|`, or `0000   aa aa aa 22 00 00 0e 76   ...".v`
    let digits = line.split(['|', '>']).next()?;
    let (first, rest) = digits.split_once(char::is_whitespace).unwrap_or((digits, ""));
    let rest = rest.trim().split("   ").next()?;
    let is_pairs = || !rest.is_empty() && rest.split_whitespace().all(|word| word.len() == 2);
    let has_offset = has_offsets.unwrap_or_else(|| {
        // Digits may be grouped in any way, such as `AAAAAA 22 00 00 0E 76`.
        is_pairs() && digits_of(first).is_some() && !first.to_ascii_uppercase().starts_with("AAAA")
    });
    if has_offset {
        return Some(DumpLine { offset: Some(digits_of(first)?), bytes: bytes_of(rest)? });
    }
    Some(DumpLine { offset: None, bytes: bytes_of(digits)? })
}

/// Returns the digits of an offset.
fn digits_of(text: &str) -> Option<&str> {
    let digits = text.trim();
    let is_offset = (4..=16).contains(&digits.len()) && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    is_offset.then_some(digits)
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
        assert_eq!(parse(text), [Part::Bytes(offset, bytes.to_vec())]);
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
        assert_dump("AAAA AA 22 00\n000E 76", 0, &STOP);
        assert_dump("0xAA, 0xAA, 0xAA, 0x22, 0x00,\n0x00, 0x0E, 0x76,\n", 0, &STOP);
        assert_dump("AAh AAh AAh 22h\n00h 00h 0Eh 76h\n", 0, &STOP);
    }

    #[test]
    fn four_digit_offsets_of_wireshark_are_no_data() {
        let twice = [STOP, STOP].concat();
        // Copy as Hex Dump; as Hex + ASCII Dump, whose text may look like digits; `tshark -x`.
        assert_dump("0000   aa aa aa 22 00 00 0e 76\n", 0, &STOP);
        assert_dump("0000   aa aa aa 22 00 00 0e 76   ab cd ef\n", 0, &STOP);
        assert_dump(
            "0000  aa aa aa 22 00 00 0e 76  aa aa aa 22 00 00 0e 76   ...\"...v ...\"...v\n",
            0,
            &twice,
        );
        assert_dump("0AB0 aa aa aa 22", 0xAB0, &STOP[..4]);
        // The offsets of the next packet begin again.
        let packets = "0000   aa aa aa 22\n0004   00 00 0e 76\n\n0000   aa aa\n";
        assert_eq!(parse(packets), [Part::Bytes(0, STOP.to_vec()), Part::Bytes(0, vec![0xAA, 0xAA])]);
    }

    #[test]
    fn offsets_may_be_octal_or_decimal_and_a_jump_ends_a_part() {
        let line = "aa aa aa 22 00 00 0e 76 aa aa aa 22 00 00 0e 76";
        let whole = STOP.repeat(6);
        for offsets in
            [["0000", "0010", "0020"], ["0000000", "0000020", "0000040"], ["0000000", "0000016", "0000032"]]
        {
            let text: String = offsets.iter().map(|offset| format!("{offset} {line}\n")).collect();
            assert_dump(&text, 0, &whole);
        }
        let lost = parse(&format!("0000 {line}\n0020 {line}\n"));
        assert_eq!(lost, [Part::Bytes(0, STOP.repeat(2)), Part::Bytes(0x20, STOP.repeat(2))]);
    }

    #[test]
    fn asterisk_repeats_the_previous_line() {
        let text = "00000000  01 02 |..|\n*\n00000006  03 |.|\n00000007\n";
        assert_dump(text, 0, &[1, 2, 1, 2, 1, 2, 3]);
        let endless = parse("00000000  01 |.|\n*\nffffffffffffff  03 |.|\n");
        let [Part::Bytes(0, first), Part::Bytes(.., last), Part::Unread(lines)] = &endless[..] else {
            panic!("{endless:?}")
        };
        assert_eq!((first.as_slice(), last.as_slice(), lines), (&[1][..], &[3][..], &(3..=3)));
    }

    #[test]
    fn bytes_around_an_unreadable_line_are_not_joined() {
        let parts = parse("AA AA\n# a comment\n\nBB\nGRIP(20)\nRELEASE()\n22\n");
        let joined = Part::Bytes(0, vec![0xAA, 0xAA, 0xBB]);
        assert_eq!(parts, [joined, Part::Unread(5..=6), Part::Bytes(3, vec![0x22])]);
        assert!(!is_line("GRIP(20)") && !is_line("AAA") && !is_line(""));
    }
}
