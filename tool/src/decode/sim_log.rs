//! The log of `wsg-sim` and of `wsg gripper`: `12.345678 s tcp 127.0.0.1:40000 -> AA AA AA 22 00 00 0E 76 22h Stop`.

use wsg_protocol::Direction;

/// A log line: a message, marked by an arrow, or an event.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct LogLine<'a> {
    /// Time and line: `12.345678 s tcp 127.0.0.1:40000`. Of an event, the time.
    pub(crate) place: &'a str,
    /// `None` for an event.
    pub(crate) direction: Option<Direction>,
    pub(crate) content: Content<'a>,
}

/// The text after the arrow, or after the time.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Content<'a> {
    /// Bytes of a frame.
    Frame(Vec<u8>),
    /// A line of GCL.
    Text(Vec<u8>),
    /// A remark on data that the log does not show in full.
    Remark(&'a str),
    /// Bytes of Modbus/TCP or PROFIBUS.
    OfABus,
    /// An event, such as a connection or the output of a script.
    Event(&'a str),
}

/// Beginning and end of the log's remarks on damaged or foreign data.
const TOLD: [(&str, &str); 5] = [
    ("wrong checksum: ", " bytes of payload"),
    ("too long: ", " bytes of payload"),
    ("", " bytes of no frame"),
    ("", " bytes of another protocol"),
    ("a length that no frame has", ""),
];

pub(crate) fn parse_line(line: &str) -> Option<LogLine<'_>> {
    let line = line.trim();
    let (time, event) = line.split_once(" s ")?;
    if time.is_empty() || !time.bytes().all(|c| c.is_ascii_digit() || c == b'.') {
        return None;
    }
    let arrows = [(" -> ", Direction::ToGripper), (" <- ", Direction::FromGripper)];
    let found =
        arrows.into_iter().filter_map(|(arrow, direction)| Some((line.find(arrow)?, arrow, direction)));
    let Some((at, arrow, direction)) = found.min_by_key(|(at, ..)| *at) else {
        let place = line.get(..time.len() + " s".len())?;
        return Some(LogLine { place, direction: None, content: Content::Event(event) });
    };
    let (place, rest) = (line.get(..at)?, line.get(at + arrow.len()..)?);
    let words = || rest.split(' ').map_while(|word| byte_of(word).map(|byte| (word, byte)));
    let content = if rest.starts_with("AA AA AA ") {
        // `?? ??` stands for an unknown checksum, so the frame cannot be checked and is passed on as text.
        let bytes: Vec<u8> = words().map(|(_, byte)| byte).collect();
        if rest.contains(" ?? ?? ") { Content::Remark(rest) } else { Content::Frame(bytes) }
    } else if words().nth(1).is_some() {
        Content::OfABus
    } else if TOLD.iter().any(|(begin, end)| rest.starts_with(begin) && rest.ends_with(end)) {
        Content::Remark(rest)
    } else {
        Content::Text(unescaped(rest))
    };
    Some(LogLine { place, direction: Some(direction), content })
}

/// Reverses `escape_ascii`, with which the log writes GCL lines.
fn unescaped(text: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut rest = text.as_bytes();
    while let [first, behind @ ..] = rest {
        let (byte, behind) = match (first, behind) {
            (b'\\', [b't', behind @ ..]) => (b'\t', behind),
            (b'\\', [b'r', behind @ ..]) => (b'\r', behind),
            (b'\\', [b'n', behind @ ..]) => (b'\n', behind),
            (b'\\', [escaped @ (b'\\' | b'"' | b'\''), behind @ ..]) => (*escaped, behind),
            (b'\\', [b'x', high, low, behind @ ..]) => {
                let digits = [*high, *low];
                let byte = std::str::from_utf8(&digits).ok().and_then(byte_of);
                byte.map_or((b'\\', rest.get(1..).unwrap_or(&[])), |byte| (byte, behind))
            }
            (byte, behind) => (*byte, behind),
        };
        bytes.push(byte);
        rest = behind;
    }
    bytes
}

/// Parses two hex digits.
fn byte_of(word: &str) -> Option<u8> {
    let is_byte = word.len() == 2 && word.bytes().all(|digit| digit.is_ascii_hexdigit());
    is_byte.then(|| u8::from_str_radix(word, 16).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_lines_are_parsed() {
        let stop =
            parse_line("12.345678 s tcp 127.0.0.1:40000 -> AA AA AA 22 00 00 0E 76 22h Stop\n").unwrap();
        assert_eq!(stop.place, "12.345678 s tcp 127.0.0.1:40000");
        assert_eq!(stop.direction, Some(Direction::ToGripper));
        assert_eq!(stop.content, Content::Frame(vec![0xAA, 0xAA, 0xAA, 0x22, 0, 0, 0x0E, 0x76]));
        let ack = parse_line("0.000001 s gcl 127.0.0.1:1 <- ACK HOME").unwrap();
        assert_eq!(
            (ack.direction, ack.content),
            (Some(Direction::FromGripper), Content::Text(b"ACK HOME".to_vec()))
        );
        let bus =
            parse_line("0.000001 s modbus 127.0.0.1:1 <- 00 01 00 00 00 03 01 84 0A FC 4, exception 10")
                .unwrap();
        assert_eq!(bus.content, Content::OfABus);
        let remark = "wrong checksum: 25h Grip Part with 8 bytes of payload";
        let line = format!("0.000001 s tcp 127.0.0.1:1 -> {remark}");
        assert_eq!(parse_line(&line).unwrap().content, Content::Remark(remark));
        let quoted = parse_line(r#"0.000001 s gcl 127.0.0.1:1 <- TAG=\"a\\b\xe4\x\""#).unwrap();
        assert_eq!(quoted.content, Content::Text(b"TAG=\"a\\b\xE4\\x\"".to_vec()));
        let event = parse_line("0.000001 s tcp 127.0.0.1:1 connected").unwrap();
        assert_eq!((event.place, event.content), ("0.000001 s", Content::Event("tcp 127.0.0.1:1 connected")));
        assert_eq!(parse_line("later s tcp -> AA"), None);
    }
}
