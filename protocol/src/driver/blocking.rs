//! The blocking driver, over `embedded-io`.

#[cfg(feature = "gcl")]
mod gcl;

#[cfg(feature = "gcl")]
pub use gcl::GclGripper;

use super::engine::{Awaited, Copied, Engine, Goal};
use super::methods::methods;
use super::{
    Binary, Clock, Config, DriverCounters, Error, Finger, Grip, MAX_FRAME_LEN, MAX_REPLY_LEN, Mm, MmPerS,
    MotionResult, OnBlock, Pending, Protocol, Update,
};
use crate::command::{Command, CommandId};
use crate::frame::Frame;
use crate::reply::{Reply, Value};
use crate::session::{Known, Topic};
use crate::time::Instant;
use crate::types::{
    AutoUpdate, DeviceTag, FingerFlags, FingerInfo, GripperState, GrippingStatistics, HomingDirection,
    LoopData, PrePositionFlags, SoftLimits, Status, SystemFlags, SystemInfo, SystemLimits, Temperature,
};
use embedded_io::{Read, ReadReady, Write};

/// Bytes read at a time.
const CHUNK_LEN: usize = 64;
/// Chunks read before time is looked at again: a line that never falls silent must not stop the clock.
const MAX_CHUNKS: usize = 64;

/// The transport of the blocking driver: every type with these traits of `embedded_io` is one.
///
/// `embedded_io_adapters::std::FromStd` of a `TcpStream` is none, because it does not tell whether there are bytes to
/// read:
///
/// ```compile_fail,E0277
/// use wsg_protocol::Instant;
/// use wsg_protocol::driver::blocking::Gripper;
/// # struct FromStd<T>(T);
/// # impl<T> embedded_io::ErrorType for FromStd<T> {
/// #     type Error = core::convert::Infallible;
/// # }
/// # impl<T> embedded_io::Read for FromStd<T> {
/// #     fn read(&mut self, _: &mut [u8]) -> Result<usize, Self::Error> {
/// #         Ok(0)
/// #     }
/// # }
/// # impl<T> embedded_io::Write for FromStd<T> {
/// #     fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
/// #         Ok(bytes.len())
/// #     }
/// #     fn flush(&mut self) -> Result<(), Self::Error> {
/// #         Ok(())
/// #     }
/// # }
///
/// # fn new(stream: std::net::TcpStream) {
/// let gripper = Gripper::new(FromStd(stream), || Instant::from_millis(0));
/// # }
/// ```
///
/// `host::Tcp` is one, by feature `std`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no transport of the blocking driver",
    label = "this needs `embedded_io::Read`, `ReadReady` and `Write`",
    note = "`FromStd` of a socket has no `ReadReady`: `wsg_protocol::driver::host::Tcp` has it, by feature `std`"
)]
pub trait Transport: Read + ReadReady + Write {}

#[diagnostic::do_not_recommend]
impl<IO: Read + ReadReady + Write> Transport for IO {}

/// A gripper at the other end of a transport.
///
/// While it waits it asks the transport again and again whether there are bytes, and the clock for the time. A transport
/// that waits a millisecond for bytes in `read_ready`, or a clock that sleeps in `now` (`wfi`), saves the processor's
/// time.
///
/// `RX` is the longest payload of a reply that is taken, at least 34, and `TX` the longest frame that is sent, at least
/// 17; both can be lower than what [`new`](Self::new) takes where RAM is short and Loop is not used.
///
/// ```
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::blocking::{Gripper, Transport};
/// use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS};
///
/// /// Takes a part of 20 mm; whether there was one.
/// fn pick<IO: Transport>(io: IO, clock: impl Clock) -> Result<bool, Error<IO::Error>> {
///     Gripper::new(io, clock).with_connection(|gripper| {
///         gripper.home(HomingDirection::Default)?;
///         gripper.set_force_limit(40.0)?;
///         Ok(gripper.grip(Mm(20.0), MmPerS(100.0))? == Grip::Held)
///     })
/// }
/// ```
pub type Gripper<IO, C, const RX: usize = MAX_REPLY_LEN, const TX: usize = MAX_FRAME_LEN> =
    GripperOver<IO, C, Binary<RX, TX>>;

/// A gripper that is spoken to by this protocol, [`Binary`] or `Gcl`; see [`Gripper`].
#[derive(Debug)]
pub struct GripperOver<IO, C, P: Protocol> {
    io: IO,
    clock: C,
    engine: Engine<P>,
}

impl<IO: Transport, C: Clock> GripperOver<IO, C, Binary> {
    /// A gripper that is not connected yet, with [`Config::DEFAULT`] and room for every command.
    #[must_use]
    pub const fn new(io: IO, clock: C) -> Self {
        Self::with_config(io, clock, Config::DEFAULT)
    }
}

impl<IO: Transport, C: Clock, const RX: usize, const TX: usize> GripperOver<IO, C, Binary<RX, TX>> {
    /// As [`new`](Gripper::new), with other settings and buffers.
    ///
    /// ```
    /// use wsg_protocol::driver::{Config, blocking::Gripper};
    /// # use wsg_protocol::driver::{Clock, blocking::Transport};
    /// # fn with<IO: Transport, C: Clock>(io: IO, clock: C) {
    /// let gripper = Gripper::<_, _, 66, 32>::with_config(io, clock, Config::DEFAULT);
    /// # }
    /// ```
    #[must_use]
    pub const fn with_config(io: IO, clock: C, config: Config) -> Self {
        Self { io, clock, engine: Engine::new(Binary::new(config.session), config) }
    }
}

impl<IO: Transport, C: Clock, P: Protocol> GripperOver<IO, C, P> {
    methods!([] [] FnOnce);

    /// Moves bytes and time until the goal is reached, or the moment is; whether it was the goal.
    fn drive(
        &mut self,
        awaited: &mut Awaited<'_>,
        goal: Goal,
        until: Option<Instant>,
    ) -> Result<bool, Error<IO::Error>> {
        loop {
            let now = self.clock.now();
            self.receive(now, awaited)?;
            self.engine.elapse(now, awaited);
            self.transmit(now, awaited)?;
            if self.engine.has_reached(goal, awaited) {
                return Ok(true);
            }
            if until.is_some_and(|until| now.has_reached(until)) {
                return Ok(false);
            }
        }
    }

    /// Takes the bytes that are there.
    fn receive(&mut self, now: Instant, awaited: &mut Awaited<'_>) -> Result<(), Error<IO::Error>> {
        let mut chunk = [0; CHUNK_LEN];
        for _ in 0..MAX_CHUNKS {
            if !self.io.read_ready().map_err(Error::Transport)? {
                break;
            }
            let count = self.io.read(&mut chunk).map_err(Error::Transport)?;
            if count == 0 {
                return Err(self.closed(now, awaited));
            }
            self.engine.receive(now, chunk.get(..count).unwrap_or(&[]), awaited);
        }
        Ok(())
    }

    /// Sends the frames that are due, each by one write unless the transport takes less.
    fn transmit(&mut self, now: Instant, awaited: &mut Awaited<'_>) -> Result<(), Error<IO::Error>> {
        while self.engine.fetch(now, awaited) {
            let written = if self.engine.outbox().needs_flush() {
                self.engine.outbox().flushed();
                self.io.flush().map(|()| None)
            } else {
                self.io.write(self.engine.rest()).map(Some)
            };
            match written {
                Ok(None) => {}
                Ok(Some(0)) => return Err(self.closed(now, awaited)),
                Ok(Some(count)) => self.engine.outbox().sent(count),
                Err(error) => {
                    self.engine.outbox().clear();
                    return Err(Error::Transport(error));
                }
            }
        }
        Ok(())
    }

    fn closed(&mut self, now: Instant, awaited: &mut Awaited<'_>) -> Error<IO::Error> {
        self.engine.hang_up(now, awaited);
        Error::Closed
    }
}
