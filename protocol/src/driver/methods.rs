//! The methods of a gripper for both drivers. They are written for the async driver, and [`also_blocking`] generates
//! the methods of the blocking driver.
//!
//! Each driver has its own `drive`, which moves bytes and time until a goal or a moment is reached.

use super::engine::{Awaited, Copied, DriverState, Goal};
use super::{
    Binary, Config, DriverCounters, Error, Finger, Grip, Mm, MmPerS, MotionResult, N, OnBlock, Pending,
    Protocol, StopKind, Update,
};
use crate::command::{Command, CommandId};
use crate::frame::Frame;
use crate::reply::{Reply, Value};
use crate::session::{Known, MISMATCH, Topic};
use crate::types::{
    AutoUpdate, DeviceTag, FingerFlags, FingerInfo, GripperState, GrippingStatistics, HomingDirection,
    LoopData, PrePositionFlags, SoftLimits, Status, SystemFlags, SystemInfo, SystemLimits, Temperature,
};
use wsg_protocol_macros::also_blocking;

/// Documents the errors of a request with one answer.
macro_rules! request_errors {
    () => {
        "- [`NotConnected`](Error::NotConnected): there is no connection, and nothing was sent. Call `connect`.\n\
         - [`FastStopRunning`](Error::FastStopRunning) or [`Stopped`](Error::Stopped): a FAST STOP is unconfirmed, or a stop \
         handle stopped the gripper.\n\
         - [`Refused`](Error::Refused): the gripper answered with an error code, such as E_ACCESS_DENIED in FAST STOP.\n\
         - [`Unanswered`](Error::Unanswered): the request was sent and not answered in time.\n\
         - [`Transport`](Error::Transport) or [`Closed`](Error::Closed): the line failed, or the gripper closed it.\n\
         - [`NotInGcl`](Error::NotInGcl): the text protocol has no such request."
    };
}

/// Documents the errors of a setting.
macro_rules! setting_errors {
    () => {
        "- [`OutOfLimits`](Error::OutOfLimits) or [`Invalid`](Error::Invalid): the value is outside the gripper's limits, \
         or not finite. Nothing was changed.\n\
         - [`Mismatch`](Error::Mismatch): settings are read back \
         ([`verify_settings`](crate::session::Config::verify_settings)), and the gripper has another value.\n\
         - [`NotConnected`](Error::NotConnected), [`FastStopRunning`](Error::FastStopRunning), \
         [`Stopped`](Error::Stopped), [`Refused`](Error::Refused), [`Unanswered`](Error::Unanswered), \
         [`Transport`](Error::Transport), [`Closed`](Error::Closed), [`NotInGcl`](Error::NotInGcl): as for any request."
    };
}

/// Documents the errors of beginning a motion.
macro_rules! begin_errors {
    () => {
        "- [`OutOfLimits`](Error::OutOfLimits) or [`Invalid`](Error::Invalid): a parameter is outside the gripper's \
         limits, or not finite. Nothing moved or changed.\n\
         - [`MotionRunning`](Error::MotionRunning): another motion is running, and nothing was sent.\n\
         - [`Refused`](Error::Refused): E_NOT_INITIALIZED before `home`, E_ACCESS_DENIED in FAST STOP until `acknowledge`, or \
         E_RANGE_ERROR outside the soft limits.\n\
         - [`NotConnected`](Error::NotConnected), [`FastStopRunning`](Error::FastStopRunning), \
         [`Stopped`](Error::Stopped), [`Unanswered`](Error::Unanswered), [`Transport`](Error::Transport), \
         [`Closed`](Error::Closed), [`NotInGcl`](Error::NotInGcl): as for any request."
    };
}

/// Documents the errors of a motion with a force limit.
macro_rules! force_errors {
    () => {
        "- [`NotSetBack`](Error::NotSetBack): the gripper refused the motion, and the previous force limit could not be \
         set back.\n\
         - [`Mismatch`](Error::Mismatch): the gripper did not apply the force limit. Nothing moved.\n\
         - After [`Stopped`](Error::Stopped), [`Unanswered`](Error::Unanswered), errors of the line and a dropped future, \
         the force limit may have changed."
    };
}

/// Documents the errors of a whole motion.
macro_rules! motion_errors {
    () => {
        "- [`Blocked`](Error::Blocked): an obstacle blocked the fingers.\n\
         - [`Aborted`](Error::Aborted): Stop, FAST STOP or another client ended the motion.\n\
         - [`Stopped`](Error::Stopped): a stop handle of this driver ended the motion.\n\
         - [`Failed`](Error::Failed): the motion ended with another status code.\n\
         - The errors of the corresponding `begin_` method."
    };
}

/// Returns a function for `ask` that picks the value of this kind, in this unit if one is named.
macro_rules! value {
    ($($kind:ident)|+ $(=> $unit:ident)?) => {
        |value| match *value {
            $(Value::$kind(value))|+ => Some($($unit)?(value)),
            _ => None,
        }
    };
}

#[also_blocking(asynch = blocking, Timer = Clock)]
impl<IO: super::asynch::Transport, C: super::Timer> super::asynch::GripperOver<IO, C, Binary> {
    /// Creates a driver with [`Config::DEFAULT`] and room for every command. It is not connected yet.
    #[must_use]
    pub const fn new(io: IO, clock: C) -> Self {
        Self::with_config(io, clock, Config::DEFAULT)
    }
}

#[also_blocking(asynch = blocking, Timer = Clock)]
impl<IO: super::asynch::Transport, C: super::Timer, const RX: usize, const TX: usize>
    super::asynch::GripperOver<IO, C, Binary<RX, TX>>
{
    /// Creates a driver with other settings and buffers than [`new`](super::asynch::Gripper::new).
    ///
    /// ```
    /// use wsg_protocol::driver::{Config, asynch::Gripper};
    /// # use wsg_protocol::driver::{Timer, asynch::Transport};
    /// # fn with<IO: Transport, C: Timer>(io: IO, clock: C) {
    /// let gripper = Gripper::<_, _, 66, 32>::with_config(io, clock, Config::DEFAULT);
    /// # }
    /// ```
    #[must_use]
    pub const fn with_config(io: IO, clock: C, config: Config) -> Self {
        Self { io, clock, engine: DriverState::new(Binary::new(config.session), config) }
    }
}

#[also_blocking(asynch = blocking, Timer = Clock, AsyncFnOnce = FnOnce)]
impl<IO: super::asynch::Transport, C: super::Timer, P: Protocol> super::asynch::GripperOver<IO, C, P> {
    /// Returns whether the driver had a connection to the gripper in the latest call.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.engine.link().is_connected()
    }

    /// Returns what the gripper has reported up to the latest call: its limits and states, and the latest width, speed
    /// and force. All of it is `None` without a connection.
    ///
    /// Without calls that receive from the gripper, and for width, speed and force also without a subscription, the values
    /// become old. [`age_ms`](Self::age_ms) returns their age.
    #[must_use]
    pub fn known(&self) -> &Known {
        self.engine.link().known()
    }

    /// Returns how long ago the gripper reported the value of [`known`](Self::known), in milliseconds, or `None` if the value
    /// is unknown. Just after `connect` the age may be too high, but it is never too low.
    ///
    /// ```
    /// use wsg_protocol::driver::blocking::{Gripper, Transport};
    /// use wsg_protocol::driver::{Clock, Error};
    /// use wsg_protocol::session::Topic;
    ///
    /// /// Returns the width if it is not older than a quarter of a second.
    /// fn current_width<IO: Transport, C: Clock>(gripper: &mut Gripper<IO, C>) -> Result<Option<f32>, Error<IO::Error>> {
    ///     while gripper.next_update(0)?.is_some() {}
    ///     let is_current = gripper.age_ms(Topic::Width).is_some_and(|age_ms| age_ms <= 250);
    ///     Ok(gripper.known().width.filter(|_| is_current))
    /// }
    /// ```
    pub fn age_ms(&mut self, topic: Topic) -> Option<u32> {
        self.engine.age_ms(self.clock.now(), topic)
    }

    /// Returns the running motion, as far as it is known. It may belong to a cancelled call.
    #[must_use]
    pub fn motion(&self) -> Option<CommandId> {
        self.engine.link().motion()
    }

    /// Returns whether a requested FAST STOP is still unconfirmed. Every call repeats it until the gripper confirms it.
    #[must_use]
    pub fn fast_stop_pending(&self) -> bool {
        self.engine.link().fast_stop_pending()
    }

    /// Returns counts of received data that the driver could not use, and of updates that it dropped.
    #[must_use]
    pub fn counters(&self) -> DriverCounters {
        self.engine.counters()
    }

    /// Returns the transport and drops the driver's state. Over TCP, call
    /// [`announce_disconnect`](Self::announce_disconnect) before you close the connection. Otherwise the gripper enters
    /// FAST STOP.
    #[must_use]
    pub fn into_io(self) -> IO {
        self.io
    }

    /// Continues with another transport after the old one failed, and returns the old one. An unconfirmed FAST STOP is
    /// the first message on the new transport. All other open requests are cancelled.
    pub fn replace_io(&mut self, io: IO) -> IO {
        let now = self.clock.now();
        self.engine.hang_up(now, &mut Awaited::nothing());
        self.engine.change_line();
        core::mem::replace(&mut self.io, io)
    }

    /// Returns a handle that stops this gripper from any thread, even while a call of this driver waits.
    ///
    /// # Errors
    /// The operating system has no free descriptor.
    #[cfg(feature = "std")]
    pub fn stop_handle(&mut self) -> std::io::Result<super::StopHandle>
    where
        IO: super::Stoppable,
    {
        let Self { io, engine, .. } = self;
        engine.stop_handle(|| io.stop_line())
    }

    /// Names this gripper in its records of the crate `log`, for example by its address. The name before is "gripper". Stop
    /// handles use the name from the creation of the first one.
    #[cfg(feature = "log")]
    pub fn set_log_name(&mut self, name: &str) {
        self.engine.journal_mut().set_name(name);
    }

    /// Makes the gripper send a value on its own from now on, also after each reconnect (command set, 3.4).
    /// [`AutoUpdate::once`] ends the subscription. [`next_update`](Self::next_update) returns the values, and
    /// [`known`](Self::known) holds the latest of each.
    pub fn subscribe(&mut self, topic: Topic, update: AutoUpdate) {
        self.engine.link_mut().subscribe(topic, update);
    }

    /// Returns the next automatic or polled update, or `None` if none arrives within `within_ms` milliseconds. With 0
    /// it processes the bytes already received and does not wait. That is enough to keep the connection alive.
    ///
    /// Every method that receives from the gripper keeps the newest [`UPDATES_LEN`](super::UPDATES_LEN) updates. This
    /// method returns those first, without reading from the transport, and reads only when none is left. To get every
    /// update, call it until it returns `None` each time another method has returned.
    /// [`updates_lost`](super::DriverCounters::updates_lost) counts the updates that newer ones have replaced, and those
    /// from before a lost connection, which are discarded.
    ///
    /// # Errors
    /// Errors of the transport.
    pub async fn next_update(&mut self, within_ms: u32) -> Result<Option<Update>, Error<IO::Error>> {
        self.engine.clear_up();
        let now = self.clock.now();
        if !self.engine.has_update() {
            let until = now.plus_at_most(within_ms);
            self.drive(&mut Awaited::nothing(), Goal::Update, Some(until)).await?;
        } else if self.engine.link().is_urgent() {
            self.drive(&mut Awaited::nothing(), Goal::NothingUrgent, Some(now)).await?;
        }
        Ok(self.engine.take_update())
    }

    /// Waits until the gripper answers, its type and limits are known, and all subscriptions are active.
    ///
    /// # Errors
    /// [`Error::NotConnected`] after [`connect_timeout_ms`](super::Config::connect_timeout_ms); errors of the
    /// transport.
    pub async fn connect(&mut self) -> Result<(), Error<IO::Error>> {
        self.engine.clear_up();
        let until = self.clock.now().plus_at_most(self.engine.config().connect_timeout_ms);
        if self.drive(&mut Awaited::nothing(), Goal::Connected, Some(until)).await? {
            Ok(())
        } else {
            Err(Error::NotConnected)
        }
    }

    /// Connects, runs a program, and announces the end of the connection however the program ends, so that it may return
    /// early by `?`. An error of the program takes precedence over an error of the announcement.
    ///
    /// Over TCP, the announcement ends a motion that is still running. Without it, the gripper enters FAST STOP when
    /// the connection closes, which is intended if the program crashes. Dropping the driver or a future announces
    /// nothing. The TCP transports of features `std` and `tokio` announce the end when they are dropped, unless the
    /// program panics. Lines without an announcement (E_NOT_AVAILABLE) are left as they are, and a motion that has
    /// begun continues.
    ///
    /// The result is that of the program, whose error type only needs `From<Error<_>>`. Where the compiler cannot infer
    /// that type, name it: `|gripper| -> Result<_, MyError> { ... }`.
    ///
    /// # Errors
    /// Errors of [`connect`](Self::connect), of the program, and of [`announce_disconnect`](Self::announce_disconnect).
    pub async fn with_connection<T, F: From<Error<IO::Error>>>(
        &mut self,
        program: impl AsyncFnOnce(&mut Self) -> Result<T, F>,
    ) -> Result<T, F> {
        self.connect().await?;
        let result = program(self).await;
        let announced = self.announce_disconnect().await;
        let value = result?;
        match announced {
            // Nothing to announce: not TCP, no connection, or the program has announced the end itself.
            Ok(())
            | Err(Error::Refused(Status::NotAvailable | Status::AccessDenied) | Error::NotConnected) => {
                Ok(value)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Announces the end of a TCP connection, so that closing it causes no FAST STOP (command set, 3.1.2). It ends a
    /// running motion, and the gripper then rejects every request until a new connection: see
    /// [`into_io`](Self::into_io). [`with_connection`](Self::with_connection) always calls it.
    ///
    /// # Errors
    /// [`Error::Refused`] with E_NOT_AVAILABLE on lines other than TCP.
    ///
    #[doc = request_errors!()]
    pub async fn announce_disconnect(&mut self) -> Result<(), Error<IO::Error>> {
        self.perform(Command::DisconnectAnnouncement).await
    }

    /// References the fingers at an end stop (command set, 3.2.1). It takes up to about 4 s.
    ///
    /// # Errors
    /// [`Error::Blocked`] if the fingers reach no end stop.
    ///
    #[doc = motion_errors!()]
    pub async fn home(&mut self, direction: HomingDirection) -> Result<(), Error<IO::Error>> {
        let pending = self.begin_home(direction).await?;
        self.wait(&pending).await
    }

    /// Begins [`home`](Self::home) and returns when the gripper reports E_CMD_PENDING.
    ///
    /// # Errors
    #[doc = begin_errors!()]
    pub async fn begin_home(&mut self, direction: HomingDirection) -> Result<Pending<()>, Error<IO::Error>> {
        self.begin(Command::Homing { direction }).await
    }

    /// Moves the fingers to an opening width (command set, 3.2.2).
    ///
    /// # Errors
    #[doc = motion_errors!()]
    pub async fn move_to(
        &mut self,
        width: Mm,
        speed: MmPerS,
        block: OnBlock,
    ) -> Result<(), Error<IO::Error>> {
        let pending = self.begin_move_to(width, speed, block).await?;
        self.wait(&pending).await
    }

    /// Begins [`move_to`](Self::move_to) and returns when the gripper reports E_CMD_PENDING.
    ///
    /// # Errors
    #[doc = begin_errors!()]
    pub async fn begin_move_to(
        &mut self,
        width: Mm,
        speed: MmPerS,
        block: OnBlock,
    ) -> Result<Pending<()>, Error<IO::Error>> {
        self.begin(Command::PrePosition { flags: block.flags(), width: width.0, speed: speed.0 }).await
    }

    /// Sets the force limit and begins [`move_to`](Self::move_to). The limit remains set after the motion.
    ///
    /// The call checks force, width and speed before it changes anything. If the gripper refuses the motion, the previous
    /// force limit is set back.
    ///
    /// # Errors
    #[doc = force_errors!()]
    ///
    #[doc = begin_errors!()]
    pub async fn begin_move_to_with_force(
        &mut self,
        width: Mm,
        speed: MmPerS,
        block: OnBlock,
        force: N,
    ) -> Result<Pending<()>, Error<IO::Error>> {
        let command = Command::PrePosition { flags: block.flags(), width: width.0, speed: speed.0 };
        self.begin_with_force(command, force).await
    }

    /// Opens the fingers by an offset, or closes them by a negative offset (command set, 3.2.2). Queries the width first:
    /// the target must be inside the stroke, up to the accuracy of a measured width.
    ///
    /// # Errors
    #[doc = motion_errors!()]
    pub async fn move_by(
        &mut self,
        offset: Mm,
        speed: MmPerS,
        block: OnBlock,
    ) -> Result<(), Error<IO::Error>> {
        let pending = self.begin_move_by(offset, speed, block).await?;
        self.wait(&pending).await
    }

    /// Begins [`move_by`](Self::move_by) and returns when the gripper reports E_CMD_PENDING.
    ///
    /// # Errors
    #[doc = begin_errors!()]
    pub async fn begin_move_by(
        &mut self,
        offset: Mm,
        speed: MmPerS,
        block: OnBlock,
    ) -> Result<Pending<()>, Error<IO::Error>> {
        let flags = block.flags().union(PrePositionFlags::RELATIVE);
        self.begin(Command::PrePosition { flags, width: offset.0, speed: speed.0 }).await
    }

    /// Grips a part of nominal width `width` (command set, 3.2.6). [`set_force_limit`](Self::set_force_limit) sets the
    /// maximum gripping force.
    ///
    /// # Errors
    /// A missing part is a result, not an error: [`Grip::NoPart`].
    ///
    #[doc = motion_errors!()]
    pub async fn grip(&mut self, width: Mm, speed: MmPerS) -> Result<Grip, Error<IO::Error>> {
        let pending = self.begin_grip(width, speed).await?;
        self.wait(&pending).await
    }

    /// Begins [`grip`](Self::grip) and returns when the gripper reports E_CMD_PENDING.
    ///
    /// # Errors
    #[doc = begin_errors!()]
    pub async fn begin_grip(&mut self, width: Mm, speed: MmPerS) -> Result<Pending<Grip>, Error<IO::Error>> {
        self.begin(Command::GripPart { width: width.0, speed: speed.0 }).await
    }

    /// Sets the force limit and grips a part like [`grip`](Self::grip). The limit remains set after the grip.
    ///
    /// The call checks force, width and speed before it changes anything. If the gripper refuses the grip, the previous
    /// force limit is set back.
    ///
    /// # Errors
    /// A missing part is a result, not an error: [`Grip::NoPart`].
    ///
    #[doc = force_errors!()]
    ///
    #[doc = motion_errors!()]
    pub async fn grip_with_force(
        &mut self,
        width: Mm,
        speed: MmPerS,
        force: N,
    ) -> Result<Grip, Error<IO::Error>> {
        let pending = self.begin_grip_with_force(width, speed, force).await?;
        self.wait(&pending).await
    }

    /// Begins [`grip_with_force`](Self::grip_with_force) and returns when the gripper reports E_CMD_PENDING.
    ///
    /// # Errors
    #[doc = force_errors!()]
    ///
    #[doc = begin_errors!()]
    pub async fn begin_grip_with_force(
        &mut self,
        width: Mm,
        speed: MmPerS,
        force: N,
    ) -> Result<Pending<Grip>, Error<IO::Error>> {
        self.begin_with_force(Command::GripPart { width: width.0, speed: speed.0 }, force).await
    }

    /// Opens the fingers to a width to release a part (command set, 3.2.7).
    ///
    /// # Errors
    #[doc = motion_errors!()]
    pub async fn release(&mut self, width: Mm, speed: MmPerS) -> Result<(), Error<IO::Error>> {
        let pending = self.begin_release(width, speed).await?;
        self.wait(&pending).await
    }

    /// Begins [`release`](Self::release) and returns when the gripper reports E_CMD_PENDING.
    ///
    /// # Errors
    #[doc = begin_errors!()]
    pub async fn begin_release(&mut self, width: Mm, speed: MmPerS) -> Result<Pending<()>, Error<IO::Error>> {
        self.begin(Command::ReleasePart { width: width.0, speed: speed.0 }).await
    }

    /// Waits for the end of a motion. It can be called again after an error of the transport.
    ///
    /// # Errors
    /// [`Error::Blocked`], [`Error::Aborted`], [`Error::Failed`], [`Error::Unanswered`]; [`Error::Superseded`] if
    /// another motion has begun since; errors of the transport.
    pub async fn wait<T: MotionResult>(&mut self, pending: &Pending<T>) -> Result<T, Error<IO::Error>> {
        self.engine.clear_up();
        if !self.engine.motion().is_of(pending) {
            return Err(Error::Superseded);
        }
        self.drive(&mut Awaited::nothing(), Goal::MotionOver, None).await?;
        self.engine.motion().result()
    }

    /// Returns the result of a motion, or `None` while it runs. It processes the bytes already received and does not
    /// wait.
    ///
    /// # Errors
    /// Errors of [`wait`](Self::wait).
    pub async fn poll<T: MotionResult>(
        &mut self,
        pending: &Pending<T>,
    ) -> Result<Option<T>, Error<IO::Error>> {
        self.engine.clear_up();
        if !self.engine.motion().is_of(pending) {
            return Err(Error::Superseded);
        }
        let now = self.clock.now();
        if self.drive(&mut Awaited::nothing(), Goal::MotionOver, Some(now)).await? {
            self.engine.motion().result().map(Some)
        } else {
            Ok(None)
        }
    }

    /// Stops the fingers (command set, 3.2.3). A running motion ends with [`Error::Aborted`], and the gripper no longer
    /// holds a part. The driver sends Stop before all queued messages, with or without a connection, even if the call
    /// is cancelled.
    ///
    /// # Errors
    /// - [`Unanswered`](Error::Unanswered): Stop was sent and not confirmed in time.
    /// - [`FastStopRunning`](Error::FastStopRunning): an unconfirmed FAST STOP is pending, which stops the fingers too.
    /// - [`Transport`](Error::Transport) or [`Closed`](Error::Closed): the line failed, or the gripper closed it.
    pub async fn stop(&mut self) -> Result<(), Error<IO::Error>> {
        self.urge(StopKind::Stop).await
    }

    /// Stops the fingers as fast as possible and locks them until [`acknowledge`](Self::acknowledge) (command set,
    /// 3.2.4). The driver sends FAST STOP before everything else, with or without a connection.
    ///
    /// # Errors
    /// [`Error::Unanswered`]: not confirmed in time. Every later call repeats FAST STOP, also after a reconnect, until
    /// the gripper confirms it.
    pub async fn fast_stop(&mut self) -> Result<(), Error<IO::Error>> {
        self.urge(StopKind::FastStop).await
    }

    /// Acknowledges a FAST STOP or a fault, which unlocks the fingers (command set, 3.2.5). The driver never does so on
    /// its own.
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn acknowledge(&mut self) -> Result<(), Error<IO::Error>> {
        self.perform(Command::ACKNOWLEDGE).await
    }

    /// Sets the acceleration of subsequent motions in mm/s² (command set, 3.3.1).
    ///
    /// # Errors
    #[doc = setting_errors!()]
    pub async fn set_acceleration(&mut self, acceleration: f32) -> Result<(), Error<IO::Error>> {
        self.set(Command::SetAcceleration { acceleration }).await
    }

    /// Returns the acceleration in mm/s² (command set, 3.3.2).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn acceleration(&mut self) -> Result<f32, Error<IO::Error>> {
        self.ask(Command::GetAcceleration, value!(GetAcceleration)).await
    }

    /// Sets the maximum force of subsequent grips and pre-positions (command set, 3.3.3). Forces above the nominal one
    /// require overdrive mode, see [`set_overdrive`](Self::set_overdrive).
    ///
    /// # Errors
    #[doc = setting_errors!()]
    pub async fn set_force_limit(&mut self, force: N) -> Result<(), Error<IO::Error>> {
        self.set(Command::SetForceLimit { force: force.0 }).await
    }

    /// Returns the force limit (command set, 3.3.4).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn force_limit(&mut self) -> Result<N, Error<IO::Error>> {
        self.ask(Command::GetForceLimit, value!(GetForceLimit => N)).await
    }

    /// Sets the range of permitted finger positions, in mm (command set, 3.3.5). It must be inside the stroke. The gripper
    /// then refuses every motion to a target outside the range with E_RANGE_ERROR. The driver leaves that check to the
    /// gripper, because other clients may change the range at any time.
    ///
    /// # Errors
    #[doc = setting_errors!()]
    pub async fn set_soft_limits(&mut self, limits: SoftLimits) -> Result<(), Error<IO::Error>> {
        self.set(Command::SetSoftLimits { limits }).await
    }

    /// Returns the range of permitted finger positions in mm, or `None` if no limits are set (command set, 3.3.6).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn soft_limits(&mut self) -> Result<Option<SoftLimits>, Error<IO::Error>> {
        let limits = self.ask(Command::GetSoftLimits, value!(GetSoftLimits)).await;
        match limits {
            Err(Error::Refused(Status::NotAvailable)) => Ok(None),
            limits => limits.map(Some),
        }
    }

    /// Removes the soft limits (command set, 3.3.7).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn clear_soft_limits(&mut self) -> Result<(), Error<IO::Error>> {
        self.perform(Command::ClearSoftLimits).await
    }

    /// Allows or forbids forces up to the overdrive limit (command set, 3.3.8). If they are forbidden, the gripper reduces
    /// a force limit above the nominal force to the nominal force.
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn set_overdrive(&mut self, enabled: bool) -> Result<(), Error<IO::Error>> {
        self.perform(Command::OverdriveMode { enabled }).await
    }

    /// Zeroes the force sensor (command set, 3.3.9).
    ///
    /// # Errors
    /// [`Error::Refused`] with E_NOT_AVAILABLE if there is no sensor, which is harmless, or with E_ACCESS_DENIED while
    /// the gripper holds a part.
    ///
    #[doc = request_errors!()]
    pub async fn tare(&mut self) -> Result<(), Error<IO::Error>> {
        self.perform(Command::TareForceSensor).await
    }

    /// Returns the system state flags (command set, 3.4.1).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn system_state(&mut self) -> Result<SystemFlags, Error<IO::Error>> {
        self.ask(Command::GetSystemState { update: AutoUpdate::once() }, value!(GetSystemState)).await
    }

    /// Returns the state of the gripping process (command set, 3.4.2).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn gripper_state(&mut self) -> Result<GripperState, Error<IO::Error>> {
        self.ask(Command::GetGripperState { update: AutoUpdate::once() }, value!(GetGripperState)).await
    }

    /// Returns the counts of grips (command set, 3.4.3). `reset` restarts them at 0.
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn statistics(&mut self, reset: bool) -> Result<GrippingStatistics, Error<IO::Error>> {
        self.ask(Command::GetGrippingStatistics { reset }, value!(GetGrippingStatistics)).await
    }

    /// Returns the opening width (command set, 3.4.4).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn width(&mut self) -> Result<Mm, Error<IO::Error>> {
        self.ask(Command::GetOpeningWidth { update: AutoUpdate::once() }, value!(GetOpeningWidth => Mm)).await
    }

    /// Returns the finger speed (command set, 3.4.5).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn speed(&mut self) -> Result<MmPerS, Error<IO::Error>> {
        self.ask(Command::GetSpeed { update: AutoUpdate::once() }, value!(GetSpeed => MmPerS)).await
    }

    /// Returns the gripping force (command set, 3.4.6).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn force(&mut self) -> Result<N, Error<IO::Error>> {
        self.ask(Command::GetForce { update: AutoUpdate::once() }, value!(GetForce => N)).await
    }

    /// Returns the temperature of the device (command set, 3.4.7).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn temperature(&mut self) -> Result<Temperature, Error<IO::Error>> {
        self.ask(Command::GetTemperature, value!(GetTemperature)).await
    }

    /// Returns the device type, versions and serial number (command set, 3.5.1).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn system_info(&mut self) -> Result<SystemInfo, Error<IO::Error>> {
        self.ask(Command::GetSystemInfo, value!(GetSystemInfo)).await
    }

    /// Returns the physical limits (command set, 3.5.4).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn limits(&mut self) -> Result<SystemLimits, Error<IO::Error>> {
        self.ask(Command::GetSystemLimits, value!(GetSystemLimits)).await
    }

    /// Sets the device tag, up to 64 printable ASCII characters (command set, 3.5.2).
    ///
    /// # Errors
    /// [`Error::Invalid`] for any other text.
    ///
    #[doc = request_errors!()]
    pub async fn set_tag(&mut self, tag: &str) -> Result<(), Error<IO::Error>> {
        let tag = DeviceTag::new(tag)?;
        self.lend(Command::SetDeviceTag { tag }, &mut |_| {}).await
    }

    /// Writes the device tag to the caller's buffer and returns it (command set, 3.5.3).
    ///
    /// # Errors
    /// [`Error::Refused`] with E_NOT_AVAILABLE if no tag is set.
    ///
    #[doc = request_errors!()]
    pub async fn tag<'b>(
        &mut self,
        buffer: &'b mut [u8; DeviceTag::MAX_LEN],
    ) -> Result<&'b str, Error<IO::Error>> {
        let mut copied = Copied::new(buffer);
        self.lend(Command::GetDeviceTag, &mut |reply| copied.take(reply)).await?;
        // The decoder accepts ASCII tags only.
        copied.finish().map(|bytes| core::str::from_utf8(bytes).unwrap_or_default())
    }

    /// Returns the kind and size of the electronics at a finger port (command set, 3.6.1 and 3.6.5).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn finger_info(&mut self, finger: Finger) -> Result<FingerInfo, Error<IO::Error>> {
        let command = match finger {
            Finger::One => Command::GetFinger1Info,
            Finger::Two => Command::GetFinger2Info,
        };
        self.ask(command, value!(GetFinger1Info | GetFinger2Info)).await
    }

    /// Returns the state flags of a finger (command set, 3.6.2 and 3.6.6).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn finger_flags(&mut self, finger: Finger) -> Result<FingerFlags, Error<IO::Error>> {
        let command = match finger {
            Finger::One => Command::GetFinger1Flags,
            Finger::Two => Command::GetFinger2Flags,
        };
        self.ask(command, value!(GetFinger1Flags | GetFinger2Flags)).await
    }

    /// Switches the supply of a finger on, which takes about 500 ms, or off (command set, 3.6.3 and 3.6.7).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn set_finger_power(&mut self, finger: Finger, enabled: bool) -> Result<(), Error<IO::Error>> {
        self.perform(match finger {
            Finger::One => Command::Finger1Power { enabled },
            Finger::Two => Command::Finger2Power { enabled },
        })
        .await
    }

    /// Writes one data frame of a finger to the caller's buffer and returns it (command set, 3.6.4 and 3.6.8). The
    /// finger defines its meaning: a WSG-FMF sends one `f32` in newtons.
    ///
    /// Frames longer than `RX` - 2 bytes cannot be received and end in [`Error::Unanswered`].
    ///
    /// # Errors
    /// [`Error::TooLong`] if the buffer is too small.
    ///
    #[doc = request_errors!()]
    pub async fn finger_data<'b>(
        &mut self,
        finger: Finger,
        buffer: &'b mut [u8],
    ) -> Result<&'b [u8], Error<IO::Error>> {
        let command = match finger {
            Finger::One => Command::GetFinger1Data,
            Finger::Two => Command::GetFinger2Data,
        };
        let mut copied = Copied::new(buffer);
        self.lend(command, &mut |reply| copied.take(reply)).await?;
        copied.finish()
    }

    /// Tests the connection: sends up to 256 bytes, which the gripper must return unchanged (command set, 3.1.1).
    ///
    /// # Errors
    /// [`Error::Mismatch`] if the gripper returns other bytes.
    ///
    #[doc = request_errors!()]
    pub async fn loop_back(&mut self, data: &[u8]) -> Result<(), Error<IO::Error>> {
        let command = Command::Loop { data: LoopData::new(data)? };
        let mut is_same = false;
        let look = &mut |reply: &Reply<'_>| {
            is_same = matches!(reply.value(), Some(Value::Loop(echo)) if echo.bytes() == data);
        };
        self.lend(command, look).await?;
        if is_same { Ok(()) } else { Err(Error::Mismatch) }
    }

    /// Sends a command that a script on the gripper serves (usually ids A0h to BFh), and returns the payload of its
    /// final answer after the status code, in the caller's buffer. An id from the manual is validated as that command, but
    /// its parameters are not checked against the gripper's limits: the gripper may correct them without an error.
    ///
    /// The command counts as a motion: it is never sent twice, no other motion may run meanwhile, and silence is
    /// treated as a lost connection. A script that takes longer than
    /// [`reply_timeout_ms`](crate::session::Config::reply_timeout_ms) needs its own
    /// [time-outs](crate::session::Timeout).
    ///
    /// # Errors
    /// [`Error::Refused`] with E_CMD_UNKNOWN if no script serves it; [`Error::TooLong`] if the buffer is too small.
    ///
    #[doc = request_errors!()]
    pub async fn raw<'b>(
        &mut self,
        id: u8,
        payload: &[u8],
        buffer: &'b mut [u8],
    ) -> Result<&'b [u8], Error<IO::Error>> {
        let command = Command::decode(&Frame { id, payload })?;
        let mut copied = Copied::new(buffer);
        self.lend(command, &mut |reply| copied.take(reply)).await?;
        copied.finish()
    }

    /// Sends a command whose answer has no value.
    async fn perform(&mut self, command: Command<'static>) -> Result<(), Error<IO::Error>> {
        self.exchange(command, &mut |_| {}).await
    }

    /// Sends a command and picks the value of its answer.
    async fn ask<T: Send>(
        &mut self,
        command: Command<'static>,
        pick: fn(&Value<'_>) -> Option<T>,
    ) -> Result<T, Error<IO::Error>> {
        let mut picked = None;
        let look = &mut |reply: &Reply<'_>| picked = reply.value().and_then(|value| pick(&value));
        self.exchange(command, look).await?;
        picked.ok_or(Error::Unanswered)
    }

    /// Sends a command and passes its answer to `look`.
    async fn exchange(
        &mut self,
        command: Command<'static>,
        look: &mut (dyn FnMut(&Reply<'_>) + Send),
    ) -> Result<(), Error<IO::Error>> {
        self.become_free().await?;
        self.engine.link_mut().request(command, None)?;
        let mut awaited = Awaited::answer(command.id(), None, look);
        self.drive(&mut awaited, Goal::Answered, None).await?;
        awaited.result()
    }

    /// Sends a command that borrows its payload, and passes its answer to `look`.
    async fn lend(
        &mut self,
        command: Command<'_>,
        look: &mut (dyn FnMut(&Reply<'_>) + Send),
    ) -> Result<(), Error<IO::Error>> {
        self.become_free().await?;
        self.engine.link_mut().request_borrowed(&command)?;
        let mut awaited = Awaited::answer(command.id(), Some(command), look);
        self.drive(&mut awaited, Goal::Answered, None).await?;
        awaited.result()
    }

    /// Checks a setting and sends it.
    async fn set(&mut self, command: Command<'static>) -> Result<(), Error<IO::Error>> {
        self.check_setting(&command).await?;
        self.perform(command).await
    }

    /// Checks a setting against the gripper's limits.
    async fn check_setting(&mut self, command: &Command<'static>) -> Result<(), Error<IO::Error>> {
        if let Command::SetForceLimit { force } = *command
            && self.engine.requires_overdrive(force)
        {
            // This program or another client may have switched the mode since the last report.
            self.system_state().await?;
        }
        self.engine.check(command, None)
    }

    /// Checks a motion against the gripper's limits, sends it and waits for its first answer.
    async fn begin<T>(&mut self, command: Command<'static>) -> Result<Pending<T>, Error<IO::Error>> {
        self.become_free().await?;
        self.engine.check(&command, None)?;
        let mut width = None;
        if self.engine.link().wants_width(&command) {
            self.engine.may_begin()?;
            width = Some(self.width().await?.0);
            self.engine.check(&command, width)?;
        }
        self.engine.request_motion(command, width)?;
        self.drive(&mut Awaited::nothing(), Goal::MotionDecided, None).await?;
        self.engine.motion().begun()
    }

    /// Sets the force limit and begins a motion. Checks both first, and sets the limit back if the gripper refuses either.
    async fn begin_with_force<T>(
        &mut self,
        command: Command<'static>,
        force: N,
    ) -> Result<Pending<T>, Error<IO::Error>> {
        let limit = Command::SetForceLimit { force: force.0 };
        self.become_free().await?;
        self.engine.check(&command, None)?;
        self.check_setting(&limit).await?;
        self.engine.may_begin()?;
        let before = match self.force_limit().await {
            Ok(N(before)) => Some(before),
            Err(Error::NoForceLimit) => None,
            Err(error) => return Err(error),
        };
        let mut begun = Ok(());
        if before != Some(force.0) {
            begun = self.perform(limit).await;
        }
        let begun = match begun {
            Ok(()) => self.begin(command).await,
            Err(error) => Err(error),
        };
        let status = match begun {
            Err(Error::Refused(status)) => status,
            Err(Error::Mismatch) => MISMATCH,
            begun => return begun,
        };
        let is_set_back = match before {
            Some(force) => self.perform(Command::SetForceLimit { force }).await.is_ok(),
            None => {
                self.engine.link_mut().forget_force_limit();
                true
            }
        };
        if is_set_back { begun } else { Err(Error::NotSetBack(status)) }
    }

    /// Sends Stop or FAST STOP and waits for the confirmation.
    async fn urge(&mut self, kind: StopKind) -> Result<(), Error<IO::Error>> {
        let command = kind.command();
        self.engine.clear_up();
        self.engine.link_mut().request(command, None)?;
        let look = &mut |_: &Reply<'_>| {};
        let mut awaited = Awaited::answer(command.id(), None, look);
        // The session repeats a FAST STOP for ever, so the wait of the caller needs its own end.
        let until = self.clock.now().plus(self.engine.config().confirmation_ms());
        let driven = self.drive(&mut awaited, Goal::Answered, Some(until)).await;
        if kind == StopKind::FastStop {
            self.engine.journal().warn(format_args!("FAST STOP requested"));
        }
        match driven {
            // A handle requested the same kind, or a weaker one.
            Err(Error::Stopped(by_handle)) if by_handle <= kind => {
                if self.engine.link().is_urgent() {
                    Err(Error::Unanswered)
                } else {
                    Ok(())
                }
            }
            driven => driven.and_then(|_| awaited.result()),
        }
    }

    /// Cancels or completes the open requests of an earlier call, so that no answer is taken for another request's.
    pub(super) async fn become_free(&mut self) -> Result<(), Error<IO::Error>> {
        self.engine.clear_up();
        self.drive(&mut Awaited::nothing(), Goal::Free, None).await?;
        Ok(())
    }
}
