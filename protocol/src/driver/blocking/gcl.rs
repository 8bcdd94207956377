//! The blocking driver over the text protocol.

use super::{GripperOver, Transport};
use crate::driver::engine::{Awaited, Engine, Goal};
use crate::driver::methods::gcl_methods;
use crate::driver::{Clock, Config, Error, GCL_LINE_LEN, Gcl, Mm};
use crate::gcl::{Request, Setting};

/// The same over the text protocol: see [`Gcl`] for what differs. `RX` is the longest line that is taken, at least 76.
///
/// ```
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::blocking::{GclGripper as Gripper, Transport};
/// use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, N};
///
/// /// Takes a part of 20 mm; whether there was one.
/// fn pick<IO: Transport>(io: IO, clock: impl Clock) -> Result<bool, Error<IO::Error>> {
///     Gripper::new(io, clock).with_connection(|gripper| {
///         gripper.home(HomingDirection::Default)?;
///         gripper.set_force_limit(N(40.0))?;
///         Ok(gripper.grip(Mm(20.0), MmPerS(100.0))? == Grip::Held)
///     })
/// }
/// ```
pub type GclGripper<IO, C, const RX: usize = GCL_LINE_LEN> = GripperOver<IO, C, Gcl<RX>>;

impl<IO: Transport, C: Clock> GripperOver<IO, C, Gcl> {
    /// A gripper that is not connected yet, with [`Config::DEFAULT`].
    #[must_use]
    pub const fn new(io: IO, clock: C) -> Self {
        Self::with_config(io, clock, Config::DEFAULT)
    }
}

impl<IO: Transport, C: Clock, const RX: usize> GripperOver<IO, C, Gcl<RX>> {
    /// As [`new`](GclGripper::new), with other settings and another buffer.
    ///
    /// ```
    /// use wsg_protocol::driver::{Config, blocking::GclGripper};
    /// # use wsg_protocol::driver::{Clock, blocking::Transport};
    /// # fn with<IO: Transport, C: Clock>(io: IO, clock: C) {
    /// let gripper = GclGripper::<_, _, 128>::with_config(io, clock, Config::DEFAULT);
    /// # }
    /// ```
    #[must_use]
    pub const fn with_config(io: IO, clock: C, config: Config) -> Self {
        Self { io, clock, engine: Engine::new(Gcl::new(config.session), config) }
    }
}

impl<IO: Transport, C: Clock, const RX: usize> GripperOver<IO, C, Gcl<RX>> {
    gcl_methods!([] []);
}
