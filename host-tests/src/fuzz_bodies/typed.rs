//! Commands and replies: what decodes encodes to the same bytes.

use wsg_protocol::{Command, CommandId, Event, Frame, FrameEncoder, FrameParser, Payload, Reply};

use super::input::Input;

/// The longest payload that an input can have.
const LONGEST: usize = 1024;

/// Bytes of the status code in front of a reply's values.
const STATUS_LEN: usize = 2;

/// The first byte is the id, the rest the payload, once of a request and once of a reply.
pub fn typed(data: &[u8]) {
    let mut input = Input::new(data);
    let id = input.byte();
    let payload = input.bytes(LONGEST);
    let frame = Frame { id, payload };

    match Command::decode(&frame) {
        Ok(command) => {
            assert_eq!(command.id().code(), id);
            assert_eq!(command.check(), Ok(()), "what decodes may be sent");
            all_finite(&command);
            same(&without_padding(&frame, 0), command);
        }
        Err(refusal) => {
            let status = CommandId::from_code(id).status_of(refusal);
            assert!(status.is_final(), "{status:?} refuses");
        }
    }
    if let Ok(reply) = Reply::decode(&frame) {
        assert_eq!(reply.id().code(), id);
        assert_eq!(reply.value().is_some(), reply.status().code() == 0, "values come with E_SUCCESS alone");
        all_finite(&reply);
        same(&without_padding(&frame, STATUS_LEN), reply);
    }
}

/// No number of it is infinite or none. (As it shows, so that this does not rest on the check that it is about. A tag is the
/// one text that a person may have written.)
fn all_finite(value: &impl std::fmt::Debug) {
    let shown = format!("{value:?}");
    let has = |word: &str| shown.split(|c: char| !c.is_alphanumeric()).any(|it| it == word);
    assert!(shown.contains("Tag") || !(has("NaN") || has("inf")), "{shown}");
}

/// NUL characters behind a device tag are no part of it, and are not sent again.
fn without_padding<'a>(frame: &Frame<'a>, tag_at: usize) -> Frame<'a> {
    let mut payload = frame.payload;
    if matches!(CommandId::from_code(frame.id), CommandId::SetDeviceTag | CommandId::GetDeviceTag) {
        while let Some((0, text)) = payload.split_last().filter(|(_, text)| text.len() >= tag_at) {
            payload = text;
        }
    }
    Frame { payload, ..*frame }
}

/// The frame of this payload is read back as the same frame.
fn same(frame: &Frame<'_>, payload: impl Payload + Copy) {
    assert_eq!(payload.len(), frame.payload.len());
    assert_eq!(payload.byte(payload.len()), 0, "past the end is nothing");
    let bytes: Vec<u8> = FrameEncoder::new(frame.id, payload).collect();
    let mut buffer = [0; LONGEST + 8];
    let length = FrameEncoder::new(frame.id, payload).write_into(&mut buffer).expect("there is room");
    assert_eq!(buffer[..length], bytes);
    let mut parser = FrameParser::<LONGEST>::new();
    match parser.push_slice(&bytes) {
        (taken, Some(Event::Frame(read))) => assert_eq!((taken, &read), (bytes.len(), frame)),
        other => panic!("{other:?} instead of the frame"),
    }
}
