//! The command editor (command set, chapter 2): previews and sends any frame, and keeps the exchanged frames.

use super::{Bench, Client};
use crate::control::answer::{HttpError, status};
use crate::control::json::{body, members};
use crate::port::{MAX_FRAME_LEN, PortKind};
use crate::time::{Time, earlier};
use std::collections::VecDeque;
use wsg_protocol::frame::{OVERHEAD, PREAMBLE_LEN};
use wsg_protocol::{CommandId, Direction, Frame, FrameEncoder, Meaning, editor};

pub(crate) const FRAME_EXPECTED: &str =
    r#"{"command":"Grip Part","payload":"20.0f 50.0f"}, and "send":true to send the frame"#;

/// Maximum length of a payload in bytes: that of the longest frame that a gripper accepts.
const MAX_PAYLOAD_LEN: usize = 1_016;
/// Maximum number of frames that are kept.
const MAX_FRAMES: usize = 100;

#[derive(Debug)]
pub(crate) struct FrameBody {
    command: String,
    payload: String,
    send: bool,
}
body!(FrameBody: command, #[default] payload, #[default] send);

impl FrameBody {
    /// Returns whether this is a frame for the gripper, except a Stop and a FAST STOP.
    pub(crate) fn commands(&self) -> bool {
        let id = editor::command_id(&self.command);
        self.send && !matches!(id, Ok(CommandId::Stop | CommandId::FastStop))
    }
}

/// A frame with its meaning.
#[derive(Clone, Debug)]
pub(crate) struct Exchanged {
    pub(crate) number: u64,
    time_s: Time,
    /// `->` to the gripper, `<-` from it.
    direction: String,
    id: u8,
    bytes: Vec<u8>,
    meaning: String,
}
members!(Exchanged: number, time_s, direction, id, bytes, meaning);

impl Exchanged {
    fn new(direction: Direction, bytes: &[u8], now: Time) -> Self {
        let id = bytes.get(PREAMBLE_LEN).copied().unwrap_or(0);
        let payload = bytes.get(PREAMBLE_LEN + 3..bytes.len().saturating_sub(2)).unwrap_or(&[]);
        let meaning = Meaning { direction, frame: Frame { id, payload } }.to_string();
        Self { number: 0, time_s: now, direction: direction.to_string(), id, bytes: bytes.to_vec(), meaning }
    }
}

/// The editor's connection to the gripper, which all pages share.
#[derive(Debug, Default)]
pub(super) struct Editor {
    /// Connected by the first frame.
    client: Option<Client>,
    frames: VecDeque<Exchanged>,
}

impl Bench {
    /// Returns the frame of this input, and sends it if the body says so.
    pub(crate) fn take_frame(&mut self, body: &FrameBody, now: Time) -> Result<Exchanged, HttpError> {
        let wrong = |error: editor::EditorError<'_>| HttpError::wrong(error.to_string());
        let id = editor::command_id(&body.command).map_err(wrong)?;
        let mut payload = [0; MAX_PAYLOAD_LEN];
        let len = editor::payload(&body.payload, &mut payload).map_err(wrong)?;
        let bytes: Vec<u8> = FrameEncoder::new(id.code(), &payload[..len]).collect();
        debug_assert_eq!(bytes.len(), len + OVERHEAD);
        let frame = Exchanged::new(Direction::ToGripper, &bytes, now);
        if body.send {
            let mut editor = std::mem::take(&mut self.editor);
            let sent = editor.send(self, frame.clone(), now);
            self.editor = editor;
            sent?;
        }
        Ok(frame)
    }

    /// Returns the editor's frames from this number on, oldest first.
    pub(crate) fn frames_from(&self, number: u64) -> Vec<Exchanged> {
        self.editor.frames.iter().filter(|frame| frame.number >= number).cloned().collect()
    }
}

impl Editor {
    pub(super) const fn is_connected(&self) -> bool {
        self.client.is_some()
    }

    /// Returns when the next frame has passed a line between editor and gripper.
    pub(super) fn next_arrival(&self) -> Option<Time> {
        let client = self.client.as_ref()?;
        earlier(client.next_frame(), client.next_request())
    }

    fn send(&mut self, bench: &mut Bench, frame: Exchanged, now: Time) -> Result<(), HttpError> {
        if self.client.is_none() {
            self.client = Some(bench.connect(PortKind::Page, "editor", now).ok_or_else(|| {
                let error = "all client places of the gripper are taken; disconnect a client first";
                HttpError::new(status::SERVICE_UNAVAILABLE, error.to_owned())
            })?);
        }
        let bytes = frame.bytes.clone();
        self.keep(frame);
        if let Some(client) = &mut self.client {
            client.receive(bench, now, &bytes);
        }
        self.receive(bench, now);
        Ok(())
    }

    /// Passes on what the lines have delayed until now, and keeps the frames that the gripper sends to the editor.
    pub(super) fn receive(&mut self, bench: &mut Bench, now: Time) {
        let Some(mut client) = self.client.take() else { return };
        while client.next_request().is_some_and(|at| at <= now) {
            client.arrive(bench, now);
        }
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(frame) = client.transmit(bench, now, &mut buffer).and_then(|len| buffer.get(..len)) {
            self.keep(Exchanged::new(Direction::FromGripper, frame, now));
        }
        self.client = Some(client);
    }

    fn keep(&mut self, frame: Exchanged) {
        let number = self.frames.back().map_or(0, |last| last.number + 1);
        if self.frames.len() >= MAX_FRAMES {
            self.frames.pop_front();
        }
        self.frames.push_back(Exchanged { number, ..frame });
    }
}
