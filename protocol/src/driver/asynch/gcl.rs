//! The async driver over the text protocol.

use super::{GripperOver, Transport};
use crate::driver::engine::{Awaited, Engine, Goal};
use crate::driver::methods::gcl_methods;
use crate::driver::{Config, Error, GCL_LINE_LEN, Gcl, Mm, Timer};
use crate::gcl::{Request, Setting};

/// The same over the text protocol: see [`Gcl`] for what differs. `RX` is the longest line that is taken, at least 76.
///
/// ```
/// use wsg_protocol::driver::asynch::{GclGripper as Gripper, Transport};
/// use wsg_protocol::driver::{Error, Grip, Mm, MmPerS, N, Timer};
///
/// /// Takes a part of 20 mm; whether there was one.
/// async fn pick<IO: Transport>(io: IO, timer: impl Timer) -> Result<bool, Error<IO::Error>> {
///     let mut gripper = Gripper::new(io, timer);
///     let program = async |gripper: &mut Gripper<_, _>| {
///         gripper.set_force_limit(N(40.0)).await?;
///         Ok(gripper.grip(Mm(20.0), MmPerS(100.0)).await? == Grip::Held)
///     };
///     gripper.with_connection(program).await
/// }
/// ```
pub type GclGripper<IO, C, const RX: usize = GCL_LINE_LEN> = GripperOver<IO, C, Gcl<RX>>;

impl<IO: Transport, C: Timer> GripperOver<IO, C, Gcl> {
    /// A gripper that is not connected yet, with [`Config::DEFAULT`].
    #[must_use]
    pub const fn new(io: IO, timer: C) -> Self {
        Self::with_config(io, timer, Config::DEFAULT)
    }
}

impl<IO: Transport, C: Timer, const RX: usize> GripperOver<IO, C, Gcl<RX>> {
    /// As [`new`](GclGripper::new), with other settings and another buffer.
    ///
    /// ```
    /// use wsg_protocol::driver::{Config, asynch::GclGripper};
    /// # use wsg_protocol::driver::{Timer, asynch::Transport};
    /// # fn with<IO: Transport, C: Timer>(io: IO, timer: C) {
    /// let gripper = GclGripper::<_, _, 128>::with_config(io, timer, Config::DEFAULT);
    /// # }
    /// ```
    #[must_use]
    pub const fn with_config(io: IO, timer: C, config: Config) -> Self {
        Self { io, clock: timer, engine: Engine::new(Gcl::new(config.session), config) }
    }
}

impl<IO: Transport, C: Timer, const RX: usize> GripperOver<IO, C, Gcl<RX>> {
    gcl_methods!([async] [.await]);
}
