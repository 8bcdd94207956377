//! The controller's side of a connection to a gripper (command set, 1.2.2 and 1.3).
//!
//! A single [`Engine`] implements the binary protocol ([`Session`]) and GCL (`gcl::session::Session`). A dialect
//! provides the differences.
//!
//! Sans-IO: the caller owns bytes and time, and must:
//!
//! 1. pass every event of the [`FrameParser`](crate::FrameParser) to [`Session::handle`];
//! 2. call [`Session::tick`] until it returns `None`, at the latest when [`Session::poll_timeout`] expires;
//! 3. then send every command that [`Session::poll_transmit`] returns, in order, until it returns `None`.
//!
//! The session handles:
//! - **Connecting**: queries device and limits, subscribes to the values of [`Config`], and polls each of them to
//!   detect a silent or restarted gripper.
//! - **Asynchronous commands**: a motion has two replies, and other requests proceed in between. If the gripper reports
//!   standstill but the result is missing, the session stops waiting for it.
//! - **Lost replies**: repeats requests that are [repeatable](crate::CommandId::is_repeatable), but never a motion or
//!   an acknowledgement. An unknown outcome is reported as [`Event::Unanswered`].
//! - **Stop**: overtakes all queued requests. Without a connection it is sent once, immediately, and never later. If
//!   the reply is late, the Stop is reported ([`Event::Late`]) and repeated.
//! - **FAST STOP**: is sent before anything else and repeated until the gripper confirms it, even across a reconnect.
//!   The bursts and pauses of [`FastStopPattern`] also reach a gripper that mistook a damaged frame for the head of a
//!   long one. Nothing else is sent meanwhile. The session never acknowledges a FAST STOP.
//! - **Acknowledge**: overtakes all queued requests like Stop. A motion requested before it is never sent after it.
//! - **FAST STOP of the gripper itself**: overtakes all queued requests like Stop, if a motion is among them. Otherwise
//!   the motion could follow somebody else's acknowledgement.
//! - **Settings**: are read back if [`Config::verify_settings`] is set. A different value is reported as [`MISMATCH`].
//!   A verified force limit is polled until anything may have changed it ([`Known::force_limit`]).
//! - **Updates**: restores all subscriptions of [`Config`] and [`Session::subscribe`] after a reconnect.
//! - **Silence**: closes the connection, forgets the gripper's state and withdraws all queued requests. Nothing that
//!   was requested before a reconnect is sent after it.
//!
//! ```
//! use wsg_protocol::session::{Config, Event, Session};
//! use wsg_protocol::{Command, CommandId, Instant};
//!
//! let mut session = Session::new(Config::DEFAULT);
//! let now = Instant::from_millis(0);
//! assert_eq!(session.tick(now), None);
//! // The first request queries whether the fingers move.
//! let first = session.poll_transmit(now).map(|command| command.id());
//! assert_eq!(first, Some(CommandId::GetSystemState));
//! // Not connected yet, so a motion is rejected, not queued.
//! assert!(session.request(Command::GripPart { width: 20.0, speed: 50.0 }).is_err());
//! ```

mod binary;
pub(crate) mod config;
pub(crate) mod dialect;
mod engine;
mod event;
mod fast_stop;
mod known;
pub(crate) mod message;
mod read_back;
pub(crate) mod subscriptions;
mod topic;
pub(crate) mod transaction;

pub use binary::{Event, MISMATCH, Session};
pub use config::{Config, FastStopPattern, Timeout};
pub use engine::{Engine, QUEUE_LEN};
pub use event::{EventOf, RequestError, SessionCounters};
pub use known::Known;
pub use topic::Topic;

#[cfg(test)]
pub(crate) mod tests;
