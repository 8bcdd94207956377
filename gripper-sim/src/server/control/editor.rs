//! The command editor (command set, chapter 2): previews and sends any frame, and keeps the exchanged frames.

use super::answer::HttpError;
use crate::port::{MAX_FRAME_LEN, PortKind};
use crate::server::hub::{ClientHandle, Hub};
use fieldbus_host::Client;
use hyper::StatusCode;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;
use tokio::task::spawn_local;
use wsg_protocol::frame::{OVERHEAD, PREAMBLE_LEN};
use wsg_protocol::{CommandId, Direction, Frame, FrameEncoder, Meaning, editor};

pub(super) const FRAME_EXPECTED: &str =
    r#"{"command":"Grip Part","payload":"20.0f 50.0f"}, and "send":true to send the frame"#;

/// Maximum length of a payload in bytes: that of the longest frame that a gripper accepts.
const MAX_PAYLOAD_LEN: usize = 1_016;
/// Maximum number of frames that are kept.
const MAX_FRAMES: usize = 100;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameBody {
    command: String,
    #[serde(default)]
    payload: String,
    #[serde(default)]
    send: bool,
}

impl FrameBody {
    /// Returns whether this is a frame for the gripper, except a Stop and a FAST STOP.
    pub(super) fn commands(&self) -> bool {
        let id = editor::command_id(&self.command);
        self.send && !matches!(id, Ok(CommandId::Stop | CommandId::FastStop))
    }
}

/// A frame with its meaning.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Exchanged {
    pub(super) number: u64,
    time_s: f64,
    /// `->` to the gripper, `<-` from it.
    direction: String,
    id: u8,
    bytes: Vec<u8>,
    meaning: String,
}

impl Exchanged {
    fn new(hub: &Hub, direction: Direction, bytes: &[u8]) -> Self {
        let id = bytes.get(PREAMBLE_LEN).copied().unwrap_or(0);
        let payload = bytes.get(PREAMBLE_LEN + 3..bytes.len().saturating_sub(2)).unwrap_or(&[]);
        let meaning = Meaning { direction, frame: Frame { id, payload } }.to_string();
        let time_s = hub.now().as_micros() as f64 / 1e6;
        Self { number: 0, time_s, direction: direction.to_string(), id, bytes: bytes.to_vec(), meaning }
    }
}

/// The editor's connection to the gripper, which all pages share.
#[derive(Debug)]
pub(super) struct Editor {
    hub: Arc<Hub>,
    /// Connected by the first frame.
    client: RefCell<Option<Rc<ClientHandle>>>,
    frames: RefCell<VecDeque<Exchanged>>,
}

impl Editor {
    pub(super) fn new(hub: Arc<Hub>) -> Rc<Self> {
        Rc::new(Self { hub, client: RefCell::default(), frames: RefCell::default() })
    }

    /// Returns the frame of this input, and sends it if the body says so.
    pub(super) fn take(self: &Rc<Self>, body: &FrameBody) -> Result<Exchanged, HttpError> {
        let wrong = |error: editor::EditorError<'_>| HttpError::wrong(error.to_string());
        let id = editor::command_id(&body.command).map_err(wrong)?;
        let mut payload = [0; MAX_PAYLOAD_LEN];
        let len = editor::payload(&body.payload, &mut payload).map_err(wrong)?;
        let bytes: Vec<u8> = FrameEncoder::new(id.code(), &payload[..len]).collect();
        debug_assert_eq!(bytes.len(), len + OVERHEAD);
        let frame = Exchanged::new(&self.hub, Direction::ToGripper, &bytes);
        if body.send {
            let client = self.client()?;
            self.keep(frame.clone());
            client.receive(&bytes);
        }
        Ok(frame)
    }

    /// Returns the frames from this number on, oldest first.
    pub(super) fn frames_from(&self, number: u64) -> Vec<Exchanged> {
        self.frames.borrow().iter().filter(|frame| frame.number >= number).cloned().collect()
    }

    fn client(self: &Rc<Self>) -> Result<Rc<ClientHandle>, HttpError> {
        let mut place = self.client.borrow_mut();
        if let Some(client) = &*place {
            return Ok(Rc::clone(client));
        }
        let client = self.hub.connect(PortKind::Page, "editor").map(Rc::new).ok_or_else(|| {
            let error = "all client places of the gripper are taken; disconnect a client first";
            HttpError::new(StatusCode::SERVICE_UNAVAILABLE, error.to_owned())
        })?;
        *place = Some(Rc::clone(&client));
        spawn_local(Rc::clone(self).receive(Rc::clone(&client)));
        Ok(client)
    }

    /// Keeps the frames that the gripper sends to the editor.
    async fn receive(self: Rc<Self>, client: Rc<ClientHandle>) {
        let mut buffer = [0; MAX_FRAME_LEN];
        loop {
            while let Some(frame) = client.transmit(&mut buffer) {
                self.keep(Exchanged::new(&self.hub, Direction::FromGripper, frame));
            }
            tokio::select! {
                () = client.frame_waits() => {}
                () = client.request_waits() => client.arrive(),
            }
        }
    }

    fn keep(&self, frame: Exchanged) {
        let mut frames = self.frames.borrow_mut();
        let number = frames.back().map_or(0, |last| last.number + 1);
        if frames.len() >= MAX_FRAMES {
            frames.pop_front();
        }
        frames.push_back(Exchanged { number, ..frame });
    }
}
