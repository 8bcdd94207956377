//! The controller's side of a connection to a gripper (command set, 1.2.2 and 1.3).
//!
//! One [`Engine`] does it for the binary protocol ([`Session`]) and for GCL (`gcl::session::Session`); what differs between
//! them is a dialect.
//!
//! Sans-IO: the caller owns bytes and time. One contract for it:
//!
//! 1. give every event of the [`FrameParser`](crate::FrameParser) to [`Session::handle`];
//! 2. call [`Session::tick`] until it gives `None`, at the latest when [`Session::poll_timeout`] says;
//! 3. then send every command that [`Session::poll_transmit`] gives, in order, until it gives `None`.
//!
//! What it takes care of:
//! - **Connecting**: it asks for device and limits, subscribes to the values of [`Config`], and asks for each again
//!   and again, so that silence and a gripper that was restarted are noticed.
//! - **Asynchronous commands**: a motion is answered twice; other requests go on in between. While no result comes
//!   but the gripper reports that it stands still, the result is given up.
//! - **Lost answers**: what may be repeated is ([`is_repeatable`](crate::CommandId::is_repeatable)); a motion or an
//!   acknowledgement never is. What it does not know it says: [`Event::Unanswered`].
//! - **Stop**: overtakes what waits; without a connection it is sent once, at once, and never later. One that is not
//!   answered in time is reported ([`Event::Late`]) and repeated.
//! - **FAST STOP**: goes out before anything else and is repeated until the gripper confirms it, over a reconnect as well,
//!   in bursts and pauses ([`FastStopPattern`]) that reach a gripper which mistook a damaged frame for the head of a long
//!   one. Nothing else is sent meanwhile. The session never acknowledges it.
//! - **Acknowledge**: overtakes what waits, like Stop: no motion that was requested before it is sent after it.
//! - **Settings** are read back when [`Config::verify_settings`] is set: what is not what was set is [`MISMATCH`].
//!   A force limit that was read back is asked for again and again, until anything may have changed it
//!   ([`Known::force_limit`]).
//! - **Updates**: what is subscribed to by [`Config`] or [`Session::subscribe`] is subscribed to again after a reconnect.
//! - **Silence**: the connection is given up, all knowledge of the gripper with it, and what was waiting to be sent is
//!   withdrawn: nothing that was asked for before a reconnect leaves after it.
//!
//! ```
//! use wsg_protocol::session::{Config, Event, Session};
//! use wsg_protocol::{Command, CommandId, Instant};
//!
//! let mut session = Session::new(Config::DEFAULT);
//! let now = Instant::from_millis(0);
//! assert_eq!(session.tick(now), None);
//! // First of all it asks whether the fingers move.
//! let first = session.poll_transmit(now).map(|command| command.id());
//! assert_eq!(first, Some(CommandId::GetSystemState));
//! // Not connected yet, so a motion is refused, not kept.
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
