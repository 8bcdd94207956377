//! Commands and replies: decoded frames encode to the same bytes.

use wsg_protocol::{Command, CommandId, Event, Frame, FrameEncoder, FrameParser, Payload, Reply};

use super::input::Input;

/// Maximum length of a payload.
const LONGEST: usize = 1024;

/// Length of the status code before a reply's values.
const STATUS_LEN: usize = 2;

/// The first byte is the id, the rest the payload, for a request and for a reply.
pub fn typed(data: &[u8]) {
    let mut input = Input::new(data);
    let id = input.byte();
    let payload = input.bytes(LONGEST);
    let frame = Frame { id, payload };

    match Command::decode(&frame) {
        Ok(command) => {
            assert_eq!(command.id().code(), id);
            assert_eq!(command.check(), Ok(()), "a decoded command is valid");
            all_finite(&command);
            same(&without_padding(&frame, 0), command);
        }
        Err(refusal) => {
            let status = CommandId::from_code(id).status_of(refusal);
            assert!(status.is_final(), "{status:?} is not final");
        }
    }
    if let Ok(reply) = Reply::decode(&frame) {
        assert_eq!(reply.id().code(), id);
        assert_eq!(reply.value().is_some(), reply.status().code() == 0, "only E_SUCCESS has values");
        all_finite(&reply);
        same(&without_padding(&frame, STATUS_LEN), reply);
    }
}

/// Checks that no number is infinite or NaN. Uses the debug text to be independent of the check under test. Only a
/// device tag may contain such words.
fn all_finite(value: &impl std::fmt::Debug) {
    let shown = format!("{value:?}");
    let has = |word: &str| shown.split(|c: char| !c.is_alphanumeric()).any(|it| it == word);
    assert!(shown.contains("Tag") || !(has("NaN") || has("inf")), "{shown}");
}

/// Removes NUL padding of a device tag, which is not sent again.
fn without_padding<'a>(frame: &Frame<'a>, tag_at: usize) -> Frame<'a> {
    let mut payload = frame.payload;
    if matches!(CommandId::from_code(frame.id), CommandId::SetDeviceTag | CommandId::GetDeviceTag) {
        while let Some((0, text)) = payload.split_last().filter(|(_, text)| text.len() >= tag_at) {
            payload = text;
        }
    }
    Frame { payload, ..*frame }
}

/// Checks that the encoded payload parses to the same frame.
fn same(frame: &Frame<'_>, payload: impl Payload + Copy) {
    assert_eq!(payload.len(), frame.payload.len());
    assert_eq!(payload.byte(payload.len()), 0, "bytes past the end are 0");
    let bytes: Vec<u8> = FrameEncoder::new(frame.id, payload).collect();
    let mut buffer = [0; LONGEST + 8];
    let length =
        FrameEncoder::new(frame.id, payload).write_into(&mut buffer).expect("the buffer is large enough");
    assert_eq!(buffer[..length], bytes);
    let mut parser = FrameParser::<LONGEST>::new();
    match parser.push_slice(&bytes) {
        (taken, Some(Event::Frame(read))) => assert_eq!((taken, &read), (bytes.len(), frame)),
        other => panic!("{other:?} instead of the frame"),
    }
}
