//! What a driver asks of a protocol: a session, what finds its messages in a stream of bytes, and what writes them.

use super::Error;
use crate::command::{Command, CommandId};
use crate::session::{Event, Known, Topic};
use crate::time::Instant;
use crate::types::AutoUpdate;
use crate::{frame, session};

/// A protocol that a driver speaks: [`Binary`](super::Binary) or `Gcl`. No other type can be one.
///
/// A program that is written for any of them takes it as a parameter:
///
/// ```
/// # #[cfg(feature = "embedded-io")] {
/// use wsg_protocol::driver::blocking::{GripperOver, Transport};
/// use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, N, Protocol};
///
/// /// Takes a part of 20 mm; whether there was one.
/// fn pick<IO: Transport, C: Clock, P: Protocol>(
///     gripper: &mut GripperOver<IO, C, P>,
/// ) -> Result<bool, Error<IO::Error>> {
///     gripper.set_force_limit(N(40.0))?;
///     Ok(gripper.grip(Mm(20.0), MmPerS(100.0))? == Grip::Held)
/// }
/// # }
/// ```
pub trait Protocol: Link {}

/// The terms are those of the binary protocol: commands, replies, events.
pub trait Link: core::fmt::Debug {
    /// Whether the gripper answers.
    fn is_connected(&self) -> bool;

    /// Whether a request waits to be sent, or for its first answer. Stop and FAST STOP aside.
    fn is_busy(&self) -> bool;

    /// Whether a FAST STOP is not confirmed yet.
    fn fast_stop_pending(&self) -> bool;

    /// Whether a Stop or FAST STOP is on its way.
    fn is_urgent(&self) -> bool;

    /// The motion that is running.
    fn motion(&self) -> Option<CommandId>;

    /// What is known of the gripper.
    fn known(&self) -> &Known;

    /// What could not be used on the line.
    fn line_counters(&self) -> frame::FrameCounters;

    /// What could not be used of messages.
    fn session_counters(&self) -> session::SessionCounters;

    /// As [`session::Session::subscribe`].
    fn subscribe(&mut self, topic: Topic, update: AutoUpdate);

    /// Whether the current opening width must be known before this command can be asked for.
    fn wants_width(&self, command: &Command<'_>) -> bool;

    /// Asks for a command to be sent; `width` is the current one if it was wanted.
    fn request<E>(&mut self, command: Command<'static>, width: Option<f32>) -> Result<(), Error<E>>;

    /// Asks for a command that the caller keeps, because it borrows its payload.
    fn request_borrowed<E>(&mut self, command: &Command<'_>) -> Result<(), Error<E>>;

    /// Cancels every request that was not sent yet.
    fn withdraw(&mut self);

    /// Cancels the last encoded message if no byte of it was sent; returns whether it could.
    fn take_back(&mut self) -> bool;

    /// The line is gone.
    fn hang_up(&mut self);

    /// Takes bytes from the line.
    fn receive(&mut self, now: Instant, bytes: &[u8], note: &mut impl FnMut(&Event<'_>));

    /// Whether half a message is there whose rest should have come at once.
    fn is_mid_message(&self) -> bool;

    /// Gives up that half.
    fn give_up_half(&mut self, now: Instant, note: &mut impl FnMut(&Event<'_>));

    /// Processes what is due at `now`. Call it again until it returns `None`.
    fn tick(&mut self, now: Instant) -> Option<Event<'static>>;

    /// When [`tick`](Self::tick) must be called at the latest.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Encodes the next message to send, and says how long it is. It counts as sent.
    fn encode_next(&mut self, now: Instant, borrowed: Option<Command<'_>>) -> Option<usize>;

    /// The buffer whose start is the message that was encoded last.
    fn encoded(&self) -> &[u8];

    /// Writes the message that stops the fingers this way to the buffer, and says how long it is.
    #[cfg(feature = "std")]
    fn stop_message(kind: super::StopKind, buffer: &mut [u8; super::MAX_STOP_LEN]) -> usize;
}
