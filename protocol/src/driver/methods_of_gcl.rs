//! The settings that only the text protocol has.

use crate::driver::engine::{Awaited, DriverState, Goal};
use crate::driver::{Config, Error, Gcl, Mm};
use crate::gcl::{Request, Setting};
use crate::types::SystemLimits;
use wsg_protocol_macros::also_blocking;

#[also_blocking(asynch = blocking, Timer = Clock)]
impl<IO: crate::driver::asynch::Transport, C: crate::driver::Timer>
    crate::driver::asynch::GripperOver<IO, C, Gcl>
{
    /// Creates a driver with [`Config::DEFAULT`]. It is not connected yet.
    #[must_use]
    pub const fn new(io: IO, clock: C) -> Self {
        Self::with_config(io, clock, Config::DEFAULT)
    }
}

#[also_blocking(asynch = blocking, Timer = Clock)]
impl<IO: crate::driver::asynch::Transport, C: crate::driver::Timer, const RX: usize>
    crate::driver::asynch::GripperOver<IO, C, Gcl<RX>>
{
    /// Creates a driver with other settings and another buffer than [`new`](crate::driver::asynch::GclGripper::new).
    ///
    /// ```
    /// use wsg_protocol::driver::{Config, asynch::GclGripper};
    /// # use wsg_protocol::driver::{Timer, asynch::Transport};
    /// # fn with<IO: Transport, C: Timer>(io: IO, clock: C) {
    /// let gripper = GclGripper::<_, _, 128>::with_config(io, clock, Config::DEFAULT);
    /// # }
    /// ```
    #[must_use]
    pub const fn with_config(io: IO, clock: C, config: Config) -> Self {
        Self { io, clock, engine: DriverState::new(Gcl::new(config.session), config) }
    }

    /// States the limits of this gripper, from its data sheet or from Get System Limits (53h) over the binary protocol. All
    /// requests are then checked against them, as over the binary protocol. [`SystemLimits::UNKNOWN`] stands in for those
    /// that are not known. Without this call, the driver knows only the stroke, from the model that the gripper reports.
    pub fn assume_limits(&mut self, limits: SystemLimits) {
        self.engine.link_mut().assume_limits(limits);
    }

    /// Returns how far before the nominal width a grip may meet its part (PWT; GCL, 2.2.5).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn part_width_tolerance(&mut self) -> Result<Mm, Error<IO::Error>> {
        self.setting(Request::Pwt(Setting::Ask)).await
    }

    /// Sets the part width tolerance of subsequent grips until the connection ends, and returns the value that the
    /// gripper accepted (GCL, 2.2.5).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn set_part_width_tolerance(&mut self, tolerance: Mm) -> Result<Mm, Error<IO::Error>> {
        self.setting(Request::Pwt(Setting::Set(tolerance.0))).await
    }

    /// Returns how far the fingers of a grip may travel to build up the force (CLT; GCL, 2.2.6).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn clamping_travel(&mut self) -> Result<Mm, Error<IO::Error>> {
        self.setting(Request::Clt(Setting::Ask)).await
    }

    /// Sets the clamping travel of subsequent grips until the connection ends, and returns the value that the gripper
    /// accepted (GCL, 2.2.6).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn set_clamping_travel(&mut self, travel: Mm) -> Result<Mm, Error<IO::Error>> {
        self.setting(Request::Clt(Setting::Set(travel.0))).await
    }

    async fn setting(&mut self, request: Request) -> Result<Mm, Error<IO::Error>> {
        self.become_free().await?;
        self.engine.link_mut().request_setting(request)?;
        self.drive(&mut Awaited::nothing(), Goal::Free, None).await?;
        self.engine.link().setting().map(Mm)
    }
}
