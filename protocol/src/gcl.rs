//! The Gripper Control Language (GCL), a text protocol over TCP and UDP, in both directions.
//!
//! Each request and each reply is a line. A command is acknowledged (`ACK MOVE`). A motion has a second reply when it
//! is done (`FIN MOVE`) or has failed (`ERR MOVE 29`). A query is answered by a value (`POS=20.0`). Automatic updates
//! (AUTOSEND) begin with `@`.
//!
//! | type | purpose |
//! |---|---|
//! | [`LineReader`] | bytes to lines |
//! | [`Request`], [`Answer`], [`Value`] | lines to typed values, and back |
//! | [`ParseError`], [`Refused`] | the reason why a line is rejected, and the reply to it |
//! | [`CommandName`] | the table of commands: sections, forms, kinds |
//! | [`session`] | the controller's side of a connection |
//!
//! See `docs/gcl.md` for the grammar and for decisions where the manual is silent. Requires the feature `gcl`.
//!
//! ```
//! use wsg_protocol::gcl::{Answer, LineEvent, LineReader, Move, Request, Value};
//!
//! // The controller sends a request.
//! let mut buffer = [0; Request::MAX_LEN + 1];
//! let length = Request::Move(Move { width: 50.0, speed: None }).write_line_into(&mut buffer).unwrap();
//! assert_eq!(&buffer[..length], b"MOVE(50.0)\n");
//!
//! // The gripper replies.
//! let mut reader = LineReader::<64>::new();
//! let mut answers = 0;
//! for byte in *b"ACK MOVE\n@POS=31.25\nFIN MOVE\n" {
//!     if let Some(LineEvent::Line(line)) = reader.push(byte) {
//!         answers += 1;
//!         if let Ok(Answer::Update(Value::Pos(width))) = Answer::parse(line) {
//!             assert_eq!(width, 31.25);
//!         }
//!     }
//! }
//! assert_eq!(answers, 3);
//! ```

mod answer;
mod form;
mod line;
mod name;
mod number;
mod parameters;
mod parse_error;
mod refused;
mod request;
mod scanner;
pub mod session;
mod table;
mod text;
mod topic;
mod value;
mod writer;

pub use answer::Answer;
pub use line::{LineCounters, LineEvent, LineReader, MAX_LINE_LEN};
pub use name::{CommandName, Named, OtherName};
pub use parameters::*;
pub use parse_error::ParseError;
pub use refused::Refused;
pub use request::Request;
pub use text::{Description, Text};
pub use topic::Topic;
pub use value::{FingerReading, Selected, Value, Vector};
pub use writer::LineError;

use writer::write_line;
