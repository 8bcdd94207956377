//! The async driver, over `embedded-io-async`.

use super::engine::{Awaited, CHUNK_LEN, DriverState, Goal, MAX_CHUNKS};
use super::gate::Gate;
use super::{Binary, Error, MAX_FRAME_LEN, MAX_REPLY_LEN, Protocol, Timer};
#[cfg(feature = "gcl")]
use super::{GCL_LINE_LEN, Gcl};
use crate::time::Instant;
use core::future::{pending, poll_fn, ready};
use core::pin::pin;
use core::task::Poll;
use embedded_io_async::{Read, Write};

/// The transport of the async driver. Implemented for every type with these traits of `embedded_io_async`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a transport for the async driver",
    label = "this needs `embedded_io_async::Read` and `Write`"
)]
pub trait Transport: Read + Write {}

#[diagnostic::do_not_recommend]
impl<IO: Read + Write> Transport for IO {}

/// A gripper, connected by a transport.
///
/// Every method can be cancelled by dropping its future. No received data is lost, and a partially sent frame is
/// completed before the next one. Unsent requests are never sent. A motion in progress continues:
/// [`motion`](Self::motion) returns it, and [`stop`](Self::stop) ends it. This requires a transport whose dropped
/// `read`, `write` and `flush` futures have no effect, such as the buffered serial ports and TCP sockets of embassy.
///
/// `RX` is the maximum payload of a received reply in bytes, at least 34, and `TX` the maximum length of a sent frame,
/// at least 17. Both can be lower than the defaults of [`new`](Self::new) where RAM is short and Loop is not used.
///
/// ```
/// use wsg_protocol::driver::asynch::{Gripper, Transport};
/// use wsg_protocol::driver::{Error, Grip, Mm, MmPerS, Timer};
///
/// /// Grips a part of 20 mm and prints the opening width meanwhile.
/// async fn pick<IO: Transport>(io: IO, timer: impl Timer) -> Result<Grip, Error<IO::Error>> {
///     let mut gripper = Gripper::new(io, timer);
///     let program = async |gripper: &mut Gripper<_, _>| {
///         let grip = gripper.begin_grip(Mm(20.0), MmPerS(100.0)).await?;
///         loop {
///             println!("{:.1}", gripper.width().await?);
///             if let Some(result) = gripper.poll(&grip).await? {
///                 return Ok(result);
///             }
///         }
///     };
///     gripper.with_connection(program).await
/// }
/// ```
pub type Gripper<IO, C, const RX: usize = MAX_REPLY_LEN, const TX: usize = MAX_FRAME_LEN> =
    GripperOver<IO, C, Binary<RX, TX>>;

/// A gripper over the text protocol; see [`Gcl`] for the differences. `RX` is the maximum length of a received line in
/// bytes, at least 76.
///
/// ```
/// use wsg_protocol::driver::asynch::{GclGripper as Gripper, Transport};
/// use wsg_protocol::driver::{Error, Grip, Mm, MmPerS, N, Timer};
///
/// /// Grips a part of 20 mm and returns whether it was found.
/// async fn pick<IO: Transport>(io: IO, timer: impl Timer) -> Result<bool, Error<IO::Error>> {
///     let mut gripper = Gripper::new(io, timer);
///     let program = async |gripper: &mut Gripper<_, _>| {
///         gripper.set_force_limit(N(40.0)).await?;
///         Ok(gripper.grip(Mm(20.0), MmPerS(100.0)).await? == Grip::Held)
///     };
///     gripper.with_connection(program).await
/// }
/// ```
#[cfg(feature = "gcl")]
pub type GclGripper<IO, C, const RX: usize = GCL_LINE_LEN> = GripperOver<IO, C, Gcl<RX>>;

/// A gripper over the protocol `P`, which is [`Binary`] or `Gcl`; see [`Gripper`].
#[derive(Debug)]
pub struct GripperOver<IO, C, P: Protocol> {
    pub(super) io: IO,
    pub(super) clock: C,
    pub(super) engine: DriverState<P>,
}

/// The first of two futures to complete.
enum First<A, B> {
    One(A),
    Other(B),
}

/// Returns the result of the first future to complete, or of `one` if both do.
async fn first<A, B>(one: impl Future<Output = A>, other: impl Future<Output = B>) -> First<A, B> {
    let mut one = pin!(one);
    let mut other = pin!(other);
    poll_fn(|context| {
        if let Poll::Ready(value) = one.as_mut().poll(context) {
            return Poll::Ready(First::One(value));
        }
        other.as_mut().poll(context).map(First::Other)
    })
    .await
}

/// Waits until `moment`, or until a stop handle makes a request.
async fn wait_until(timer: &mut impl Timer, moment: Option<Instant>, gate: &Gate) {
    let moment = async {
        match moment {
            Some(moment) => timer.wait_until(moment).await,
            None => pending().await,
        }
    };
    first(poll_fn(|context| gate.poll_request(context)), moment).await;
}

impl<IO: Transport, C: Timer, P: Protocol> GripperOver<IO, C, P> {
    /// Moves bytes and time until the goal or `moment` is reached. Returns whether the goal was reached.
    pub(super) async fn drive(
        &mut self,
        awaited: &mut Awaited<'_>,
        mut goal: Goal,
        mut until: Option<Instant>,
    ) -> Result<bool, Error<IO::Error>> {
        let mut stopped = None;
        loop {
            self.receive(awaited).await?;
            let now = self.clock.now();
            if let Some(kind) = self.engine.take_stop(now) {
                stopped = stopped.max(Some(kind));
                (goal, until) = (Goal::Stopped, Some(now.plus(self.engine.config().confirmation_ms())));
            }
            self.engine.elapse(now, awaited);
            if self.engine.has_reached(goal, awaited) {
                // Due messages are sent even during continuous updates, if the line accepts them immediately.
                if goal == Goal::Update && self.engine.fetch(now, awaited) {
                    self.transmit(awaited, Some(now)).await?;
                }
                return stopped.map_or(Ok(true), |kind| Err(Error::Stopped(kind)));
            }
            let is_over = until.is_some_and(|until| now.has_reached(until));
            if self.engine.fetch(now, awaited) && (self.transmit(awaited, until).await? || !is_over) {
                continue;
            }
            if is_over {
                return stopped.map_or(Ok(false), |kind| Err(Error::Stopped(kind)));
            }
            let moment = self.engine.next_due(until);
            let mut chunk = [0; CHUNK_LEN];
            let read = self.io.read(&mut chunk);
            if let First::One(read) =
                first(read, wait_until(&mut self.clock, moment, self.engine.gate())).await
            {
                self.engine.receive(self.clock.now(), read, &chunk, awaited)?;
            }
        }
    }

    /// Processes the bytes already received.
    async fn receive(&mut self, awaited: &mut Awaited<'_>) -> Result<(), Error<IO::Error>> {
        for _ in 0..MAX_CHUNKS {
            let mut chunk = [0; CHUNK_LEN];
            let First::One(read) = first(self.io.read(&mut chunk), ready(())).await else { break };
            self.engine.receive(self.clock.now(), read, &chunk, awaited)?;
        }
        Ok(())
    }

    /// Sends the rest of the message, in one write unless the transport accepts less. Returns whether the transport
    /// accepted anything before another event.
    async fn transmit(
        &mut self,
        awaited: &mut Awaited<'_>,
        until: Option<Instant>,
    ) -> Result<bool, Error<IO::Error>> {
        let Self { io, clock, engine } = self;
        let moment = engine.next_due(until);
        let gate = engine.gate();
        if engine.needs_flush() {
            let flushed = first(io.flush(), wait_until(clock, moment, gate)).await;
            let First::One(flushed) = flushed else { return Ok(false) };
            engine.flushed(flushed)?;
            return Ok(true);
        }
        let written = {
            let rest = engine.rest();
            let mut write = pin!(io.write(rest));
            let write = poll_fn(|context| gate.poll_write(rest.len(), || write.as_mut().poll(context)));
            first(write, wait_until(clock, moment, gate)).await
        };
        match written {
            First::One(Some(written)) => engine.written(written, || clock.now(), awaited)?,
            // A stop must be taken over first.
            First::One(None) => {}
            First::Other(()) => return Ok(false),
        }
        Ok(true)
    }
}
