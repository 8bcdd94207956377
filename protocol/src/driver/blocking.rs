//! The blocking driver, over `embedded-io`.

use super::engine::{Awaited, CHUNK_LEN, DriverState, Goal, MAX_CHUNKS};
use super::{Binary, Clock, Error, MAX_FRAME_LEN, MAX_REPLY_LEN, Protocol};
#[cfg(feature = "gcl")]
use super::{GCL_LINE_LEN, Gcl};
use crate::time::Instant;
use core::task::Poll;
use embedded_io::{ErrorType, Read, ReadReady, Write};

/// The transport of the blocking driver: a byte stream that can wait for bytes.
///
/// The driver sends due messages, reads the available bytes, and only then waits with [`wait`](Self::wait). The three
/// supertraits must therefore never wait for input: `read_ready` only checks, and `read` is called only after it
/// returned `true`.
///
/// The transports of feature `std` (`host::Tcp`, `host::Udp`) wait until the source is ready. [`Spinning`] turns any
/// type with the three traits, such as the UART of a HAL, into a transport. A custom type can sleep until the next
/// interrupt:
///
/// ```
/// use wsg_protocol::driver::blocking::Transport;
/// # use embedded_io::{ErrorType, Read, ReadReady, Write};
/// # fn wait_for_interrupt() {}
/// # struct Uart;
/// # impl ErrorType for Uart {
/// #     type Error = core::convert::Infallible;
/// # }
/// # impl Read for Uart {
/// #     fn read(&mut self, _: &mut [u8]) -> Result<usize, Self::Error> {
/// #         Ok(0)
/// #     }
/// # }
/// # impl ReadReady for Uart {
/// #     fn read_ready(&mut self) -> Result<bool, Self::Error> {
/// #         Ok(false)
/// #     }
/// # }
/// # impl Write for Uart {
/// #     fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
/// #         Ok(bytes.len())
/// #     }
/// #     fn flush(&mut self) -> Result<(), Self::Error> {
/// #         Ok(())
/// #     }
/// # }
///
/// // `Uart` implements `Read`, `ReadReady` and `Write`. Its receiver and a 1 ms tick raise interrupts.
/// impl Transport for Uart {
///     fn wait(&mut self, _at_most_ms: u32) -> Result<(), Self::Error> {
///         wait_for_interrupt();
///         Ok(())
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a transport for the blocking driver",
    label = "this needs `wsg_protocol::driver::blocking::Transport`",
    note = "`Spinning` makes one of every type with `embedded_io::Read`, `ReadReady` and `Write`; for a socket take \
            `wsg_protocol::driver::host::Tcp`, by feature `std`"
)]
pub trait Transport: Read + ReadReady + Write {
    /// Waits for bytes for at most `at_most_ms` milliseconds.
    ///
    /// Returns when bytes may be available, when the peer may have closed the connection, or when the time has elapsed.
    /// It may return earlier for any other reason, such as an interrupt or a signal, because the driver checks and
    /// calls it again. It must not return later, because the driver neither sends nor reports time-outs meanwhile. With
    /// 0 it returns immediately.
    ///
    /// The default implementation returns immediately, so the driver spins while it waits.
    ///
    /// # Errors
    /// Returns the error if the transport failed.
    fn wait(&mut self, at_most_ms: u32) -> Result<(), Self::Error> {
        let _ = at_most_ms;
        Ok(())
    }
}

impl<IO: Transport + ?Sized> Transport for &mut IO {
    fn wait(&mut self, at_most_ms: u32) -> Result<(), Self::Error> {
        (**self).wait(at_most_ms)
    }
}

/// A transport that spins while it waits, for any type with the traits of `embedded_io`.
#[derive(Clone, Copy, Debug)]
pub struct Spinning<T>(pub T);

impl<T: ErrorType> ErrorType for Spinning<T> {
    type Error = T::Error;
}

impl<T: Read> Read for Spinning<T> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, T::Error> {
        self.0.read(buffer)
    }
}

impl<T: ReadReady> ReadReady for Spinning<T> {
    fn read_ready(&mut self) -> Result<bool, T::Error> {
        self.0.read_ready()
    }
}

impl<T: Write> Write for Spinning<T> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, T::Error> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> Result<(), T::Error> {
        self.0.flush()
    }
}

impl<T: Read + ReadReady + Write> Transport for Spinning<T> {}

/// A gripper, connected by a transport.
///
/// `RX` is the maximum payload of a received reply in bytes, at least 34, and `TX` the maximum length of a sent frame,
/// at least 17. Both can be lower than the defaults of [`new`](Self::new) where RAM is short and Loop is not used.
///
/// ```
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::blocking::{Gripper, Transport};
/// use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, N};
///
/// /// Grips a part of 20 mm and returns whether it was found.
/// fn pick<IO: Transport>(io: IO, clock: impl Clock) -> Result<bool, Error<IO::Error>> {
///     Gripper::new(io, clock).with_connection(|gripper| {
///         gripper.home(HomingDirection::Default)?;
///         gripper.set_force_limit(N(40.0))?;
///         Ok(gripper.grip(Mm(20.0), MmPerS(100.0))? == Grip::Held)
///     })
/// }
/// ```
pub type Gripper<IO, C, const RX: usize = MAX_REPLY_LEN, const TX: usize = MAX_FRAME_LEN> =
    GripperOver<IO, C, Binary<RX, TX>>;

/// A gripper over the text protocol; see [`Gcl`] for the differences. `RX` is the maximum length of a received line in
/// bytes, at least 76.
///
/// ```
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::blocking::{GclGripper as Gripper, Transport};
/// use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, N};
///
/// /// Grips a part of 20 mm and returns whether it was found.
/// fn pick<IO: Transport>(io: IO, clock: impl Clock) -> Result<bool, Error<IO::Error>> {
///     Gripper::new(io, clock).with_connection(|gripper| {
///         gripper.home(HomingDirection::Default)?;
///         gripper.set_force_limit(N(40.0))?;
///         Ok(gripper.grip(Mm(20.0), MmPerS(100.0))? == Grip::Held)
///     })
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

impl<IO: Transport, C: Clock, P: Protocol> GripperOver<IO, C, P> {
    /// Returns the clock, for a worker that owns this driver.
    #[cfg(feature = "std")]
    pub(super) const fn clock(&self) -> &C {
        &self.clock
    }

    /// Moves bytes and time until the goal or `moment` is reached. Returns whether the goal was reached.
    pub(super) fn drive(
        &mut self,
        awaited: &mut Awaited<'_>,
        mut goal: Goal,
        mut until: Option<Instant>,
    ) -> Result<bool, Error<IO::Error>> {
        let mut now = self.clock.now();
        let mut stopped = None;
        if self.engine.link().is_urgent() {
            // Sends before reading, so that a Stop is never delayed.
            self.transmit(now, awaited)?;
        }
        loop {
            // Reads available bytes before checking time-outs, because they may have arrived in time.
            self.receive(now, awaited)?;
            if let Some(kind) = self.engine.take_stop(now) {
                stopped = stopped.max(Some(kind));
                (goal, until) = (Goal::Stopped, Some(now.plus(self.engine.config().confirmation_ms())));
            }
            self.engine.elapse(now, awaited);
            self.transmit(now, awaited)?;
            let has_reached = self.engine.has_reached(goal, awaited);
            if has_reached || until.is_some_and(|until| now.has_reached(until)) {
                return stopped.map_or(Ok(has_reached), |kind| Err(Error::Stopped(kind)));
            }
            self.io.wait(self.engine.idle_ms(now, until)).map_err(Error::Transport)?;
            now = self.clock.now();
        }
    }

    /// Processes the bytes already received.
    fn receive(&mut self, now: Instant, awaited: &mut Awaited<'_>) -> Result<(), Error<IO::Error>> {
        let mut chunk = [0; CHUNK_LEN];
        for _ in 0..MAX_CHUNKS {
            if !self.io.read_ready().map_err(Error::Transport)? {
                break;
            }
            let read = self.io.read(&mut chunk);
            self.engine.receive(now, read, &chunk, awaited)?;
        }
        Ok(())
    }

    /// Sends all due frames, each in one write unless the transport accepts less.
    fn transmit(&mut self, now: Instant, awaited: &mut Awaited<'_>) -> Result<(), Error<IO::Error>> {
        let Self { io, engine, .. } = self;
        while engine.fetch(now, awaited) {
            if engine.needs_flush() {
                engine.flushed(io.flush())?;
                continue;
            }
            let rest = engine.rest();
            let write = || Poll::Ready(io.write(rest));
            match engine.gate().poll_write(rest.len(), write) {
                Poll::Ready(Some(written)) => engine.written(written, || now, awaited)?,
                // A stop must be taken over first.
                Poll::Ready(None) | Poll::Pending => return Ok(()),
            }
        }
        Ok(())
    }
}
