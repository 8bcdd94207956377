//! The interface between a driver and a protocol: a session, a parser of its messages and their encoder.

use super::Error;
use crate::command::{Command, CommandId};
use crate::session::{Event, Known, Topic};
use crate::time::Instant;
use crate::types::{AutoUpdate, SystemLimits};
use crate::{frame, session};

/// A protocol of a driver: [`Binary`](super::Binary) or `Gcl`. Sealed.
///
/// Generic programs take it as a type parameter:
///
/// ```
/// # #[cfg(feature = "embedded-io")] {
/// use wsg_protocol::driver::blocking::{GripperOver, Transport};
/// use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, N, Protocol};
///
/// /// Grips a part of 20 mm and returns whether it was found.
/// fn pick<IO: Transport, C: Clock, P: Protocol>(
///     gripper: &mut GripperOver<IO, C, P>,
/// ) -> Result<bool, Error<IO::Error>> {
///     gripper.set_force_limit(N(40.0))?;
///     Ok(gripper.grip(Mm(20.0), MmPerS(100.0))? == Grip::Held)
/// }
/// # }
/// ```
pub trait Protocol: Link {}

/// A protocol in the terms of the binary one: commands, replies and events.
pub trait Link: core::fmt::Debug {
    /// Returns whether the gripper is connected.
    fn is_connected(&self) -> bool;

    /// Returns whether a request is queued or its first reply is outstanding. Ignores Stop and FAST STOP.
    fn is_busy(&self) -> bool;

    /// Returns whether a FAST STOP is unconfirmed.
    fn fast_stop_pending(&self) -> bool;

    /// Returns whether a Stop or FAST STOP is pending.
    fn is_urgent(&self) -> bool;

    /// Returns the motion in progress.
    fn motion(&self) -> Option<CommandId>;

    /// Returns the known state of the gripper.
    fn known(&self) -> &Known;

    /// Returns the limits for requests, as far as they are known.
    fn limits(&self) -> SystemLimits {
        self.known().limits.unwrap_or(SystemLimits::UNKNOWN)
    }

    /// Returns the counters of unusable bytes on the line.
    fn line_counters(&self) -> frame::FrameCounters;

    /// Returns the counters of unusable messages.
    fn session_counters(&self) -> session::SessionCounters;

    /// Subscribes to a value, as in [`session::Session::subscribe`].
    fn subscribe(&mut self, topic: Topic, update: AutoUpdate);

    /// Returns whether this motion requires the current opening width, to check its target or to translate it.
    fn wants_width(&self, command: &Command<'_>) -> bool;

    /// Forgets a force limit that the protocol stores instead of the gripper.
    fn forget_force_limit(&mut self) {}

    /// Requests a command. `width` is the current opening width if it is needed.
    fn request<E>(&mut self, command: Command<'static>, width: Option<f32>) -> Result<(), Error<E>>;

    /// Requests a command that the caller keeps because it borrows its payload.
    fn request_borrowed<E>(&mut self, command: &Command<'_>) -> Result<(), Error<E>>;

    /// Cancels all unsent requests.
    fn withdraw(&mut self);

    /// Cancels the last encoded message if none of its bytes was sent. Returns whether it was cancelled.
    fn take_back(&mut self) -> bool;

    /// Returns whether the rest of the last encoded message is still sent after the loss of the connection
    /// ([`CommandId::outlives_connection`](crate::CommandId::outlives_connection)).
    fn outlives_connection(&self) -> bool;

    /// Handles the loss of the line.
    fn hang_up(&mut self);

    /// Processes bytes received from the line.
    fn receive(&mut self, now: Instant, bytes: &[u8], note: &mut impl FnMut(&Event<'_>));

    /// Returns whether an incomplete message is held whose rest must follow at once.
    fn is_mid_message(&self) -> bool;

    /// Discards the incomplete message.
    fn give_up_half(&mut self, now: Instant, note: &mut impl FnMut(&Event<'_>));

    /// Processes one event that is due at `now`. Call until it returns `None`.
    fn tick(&mut self, now: Instant) -> Option<Event<'static>>;

    /// Returns the latest time of the next call to [`tick`](Self::tick).
    fn poll_timeout(&self) -> Option<Instant>;

    /// Encodes the next message to send and returns its length. It counts as sent.
    fn encode_next(&mut self, now: Instant, borrowed: Option<Command<'_>>) -> Option<usize>;

    /// Returns the buffer that starts with the last encoded message.
    fn encoded(&self) -> &[u8];

    /// Writes the stop message of this kind to the buffer and returns its length.
    #[cfg(feature = "std")]
    fn stop_message(kind: super::StopKind, buffer: &mut [u8; super::MAX_STOP_LEN]) -> usize;
}
