//! The connection of a page: a WebSocket that carries events to the page, and commands from it.
//!
//! The tabs of a browser share six HTTP connections to a server. Endless streams and hung requests use them up, and a
//! FAST STOP would wait in the browser. WebSockets have a limit of their own, of 200 or more.

use super::answer::Answer;
use super::events::Events;
use crate::control::HttpError;
use futures_util::{SinkExt, StreamExt};
use http_body_util::{Either, Full};
use hyper::Request;
use hyper::body::{Bytes, Incoming};
use hyper::header::{HeaderMap, UPGRADE};
use hyper::upgrade::OnUpgrade;
use hyper_util::rt::TokioIo;
use tokio::sync::mpsc::channel;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Utf8Bytes;
use tokio_tungstenite::tungstenite::handshake::server::create_response_with_body;
use tokio_tungstenite::tungstenite::protocol::{Message, Role, WebSocketConfig};

/// Maximum number of answers that wait for a page. Excess answers are lost; the commands are executed.
const MAX_ANSWERS: usize = 16;
/// Size of the read buffer in bytes.
const READ_LEN: usize = 4_096;

/// Returns whether the request asks for a WebSocket.
pub(super) fn is_wanted(headers: &HeaderMap) -> bool {
    headers.get(UPGRADE).is_some_and(|protocol| protocol.as_bytes().eq_ignore_ascii_case(b"websocket"))
}

/// Returns the answer that opens the WebSocket.
pub(super) fn accept(request: &Request<Incoming>) -> Result<Answer, HttpError> {
    create_response_with_body(request, || Either::Left(Full::new(Bytes::new())))
        .map_err(|error| HttpError::wrong(format!("the WebSocket cannot open: {error}")))
}

/// Sends events until the page closes, and answers its messages of at most `max_len` bytes. A message is executed when it
/// is read, also while the page reads nothing.
pub(super) async fn serve(
    upgrade: OnUpgrade,
    mut events: Events,
    max_len: usize,
    answer: impl Fn(&str) -> Bytes,
) {
    let Ok(upgraded) = upgrade.await else { return };
    let config = WebSocketConfig::default()
        .read_buffer_size(READ_LEN)
        .write_buffer_size(0)
        .max_message_size(Some(max_len))
        .max_frame_size(Some(max_len));
    let stream = TokioIo::new(upgraded);
    let (mut to_page, mut from_page) =
        WebSocketStream::from_raw_socket(stream, Role::Server, Some(config)).await.split();
    let (answers, mut answered) = channel(MAX_ANSWERS);
    let send = async {
        loop {
            let text = tokio::select! {
                biased;
                Some(answer) = answered.recv() => answer,
                Some(event) = events.next() => event,
                else => break,
            };
            // Events are JSON, so they are valid UTF-8.
            let Ok(text) = Utf8Bytes::try_from(text) else { continue };
            if to_page.send(Message::Text(text)).await.is_err() {
                break;
            }
        }
    };
    let receive = async {
        while let Some(Ok(message)) = from_page.next().await {
            if let Message::Text(text) = message {
                // A page that reads no answers must not delay its FAST STOP.
                let _ = answers.try_send(answer(&text));
            }
        }
    };
    tokio::select! {
        () = send => {}
        () = receive => {}
    }
}
