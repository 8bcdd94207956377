//! The methods of a gripper, written once for both drivers: [`also_blocking`] makes the blocking ones from the async ones.
//!
//! The drivers differ in `drive`, which each has for itself: it moves bytes and time until a goal is reached, or a moment.

use super::engine::{Awaited, Copied, Engine, Goal};
use super::{
    Binary, Config, DriverCounters, Error, Finger, Grip, Mm, MmPerS, MotionResult, N, OnBlock, Pending,
    Protocol, StopKind, Update,
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
use wsg_protocol_macros::also_blocking;

/// The causes of an error of a request that is answered once, as documentation.
macro_rules! request_errors {
    () => {
        "- [`NotConnected`](Error::NotConnected): there is no connection; nothing was sent. Call `connect`.\n\
         - [`FastStopRunning`](Error::FastStopRunning) or [`Stopped`](Error::Stopped): a FAST STOP is not confirmed yet, or a \
         stop handle stopped the gripper.\n\
         - [`Refused`](Error::Refused): the gripper's status code, such as E_ACCESS_DENIED in FAST STOP.\n\
         - [`Unanswered`](Error::Unanswered): sent, without an answer in time.\n\
         - [`Transport`](Error::Transport) or [`Closed`](Error::Closed): the line failed, or the gripper closed it.\n\
         - [`NotInGcl`](Error::NotInGcl): the text protocol has no such request."
    };
}

/// The causes of an error of a motion, up to its beginning, as documentation.
macro_rules! begin_errors {
    () => {
        "- [`Invalid`](Error::Invalid): a parameter is not finite; nothing was sent.\n\
         - [`MotionRunning`](Error::MotionRunning): another motion is not over; nothing was sent.\n\
         - [`Refused`](Error::Refused): E_NOT_INITIALIZED before `home`; E_ACCESS_DENIED in FAST STOP, until `acknowledge`; \
         E_RANGE_ERROR outside the gripper's limits.\n\
         - [`NotConnected`](Error::NotConnected), [`FastStopRunning`](Error::FastStopRunning), \
         [`Stopped`](Error::Stopped), [`Unanswered`](Error::Unanswered), [`Transport`](Error::Transport), \
         [`Closed`](Error::Closed), [`NotInGcl`](Error::NotInGcl): as for any request."
    };
}

/// The causes of an error of a whole motion, as documentation.
macro_rules! motion_errors {
    () => {
        "- [`Blocked`](Error::Blocked): something was in the way of the fingers.\n\
         - [`Aborted`](Error::Aborted): Stop, FAST STOP or another client ended it.\n\
         - [`Stopped`](Error::Stopped): a stop handle of this driver ended it.\n\
         - [`Failed`](Error::Failed): it ended with another status code.\n\
         - Before it begins, those of the method `begin_` of the same name."
    };
}

/// Picks the value of one kind, as a function for `ask`; in a unit if one is named.
macro_rules! value {
    ($($kind:ident)|+ $(=> $unit:ident)?) => {
        |value| match *value {
            $(Value::$kind(value))|+ => Some($($unit)?(value)),
            _ => None,
        }
    };
}

#[cfg(feature = "gcl")]
mod gcl;

#[also_blocking(asynch = blocking, Timer = Clock)]
impl<IO: super::asynch::Transport, C: super::Timer> super::asynch::GripperOver<IO, C, Binary> {
    /// A gripper that is not connected yet, with [`Config::DEFAULT`] and room for every command.
    #[must_use]
    pub const fn new(io: IO, clock: C) -> Self {
        Self::with_config(io, clock, Config::DEFAULT)
    }
}

#[also_blocking(asynch = blocking, Timer = Clock)]
impl<IO: super::asynch::Transport, C: super::Timer, const RX: usize, const TX: usize>
    super::asynch::GripperOver<IO, C, Binary<RX, TX>>
{
    /// As [`new`](super::asynch::Gripper::new), with other settings and buffers.
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
        Self { io, clock, engine: Engine::new(Binary::new(config.session), config) }
    }
}

#[also_blocking(asynch = blocking, Timer = Clock, AsyncFnOnce = FnOnce)]
impl<IO: super::asynch::Transport, C: super::Timer, P: Protocol> super::asynch::GripperOver<IO, C, P> {
    /// Whether the gripper answered when it was last heard.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.engine.link().is_connected()
    }

    /// What is known of the gripper, as of the last call: its limits and states, and the latest width, speed and
    /// force that it told, if any. Nothing without a connection.
    #[must_use]
    pub fn known(&self) -> &Known {
        self.engine.link().known()
    }

    /// The motion that is running, as far as is known; also one whose call was given up.
    #[must_use]
    pub fn motion(&self) -> Option<CommandId> {
        self.engine.link().motion()
    }

    /// Whether a FAST STOP was asked for and is not confirmed yet. It is repeated in every call until it is.
    #[must_use]
    pub fn fast_stop_pending(&self) -> bool {
        self.engine.link().fast_stop_pending()
    }

    /// What could not be used so far.
    #[must_use]
    pub fn counters(&self) -> DriverCounters {
        self.engine.counters()
    }

    /// The transport, to be used for something else. What the driver knew is lost; over TCP,
    /// [`announce_disconnect`](Self::announce_disconnect) before the connection closes, or the gripper enters FAST
    /// STOP.
    #[must_use]
    pub fn into_io(self) -> IO {
        self.io
    }

    /// Goes on with another transport, after the old one broke, and gives the old one back. A FAST STOP that is not
    /// confirmed is the first thing that is sent there; everything else that was open is given up.
    pub fn replace_io(&mut self, io: IO) -> IO {
        let now = self.clock.now();
        self.engine.hang_up(now, &mut Awaited::nothing(&mut |_| {}));
        self.engine.change_line();
        core::mem::replace(&mut self.io, io)
    }

    /// A handle that stops this gripper from any thread, also while a call of this driver waits.
    ///
    /// # Errors
    /// The operating system has no descriptor left.
    #[cfg(feature = "std")]
    pub fn stop_handle(&mut self) -> std::io::Result<super::StopHandle>
    where
        IO: super::Stoppable,
    {
        let Self { io, engine, .. } = self;
        engine.stop_handle(|| io.stop_line())
    }

    /// Has the gripper send a value by itself from now on, again after each reconnect;
    /// [`AutoUpdate::once`] ends that. [`next_update`](Self::next_update) has the values, and
    /// [`known`](Self::known) the latest of each (command set, 3.4).
    pub fn subscribe(&mut self, topic: Topic, update: AutoUpdate) {
        self.engine.link_mut().subscribe(topic, update);
    }

    /// The next value that the gripper sent by itself, or that was asked for again in its turn; `None` when there is
    /// none within so many milliseconds. With 0 it takes what is there, which keeps the connection alive.
    ///
    /// Every method that hears the gripper keeps such values: the newest [`UPDATES_LEN`](super::UPDATES_LEN). This
    /// one returns those first, without a look at the transport, and hears the gripper when there is none left. To
    /// see all values, call it until it returns `None` whenever another method has returned;
    /// [`updates_lost`](super::DriverCounters::updates_lost) counts those that newer ones have replaced.
    ///
    /// # Errors
    /// Those of the transport.
    pub async fn next_update(&mut self, within_ms: u32) -> Result<Option<Update>, Error<IO::Error>> {
        self.engine.clear_up();
        let now = self.clock.now();
        if !self.engine.has_update() {
            let until = now.plus(within_ms);
            self.reach(Goal::Update, Some(until)).await?;
        } else if self.engine.link().is_urgent() {
            self.reach(Goal::NothingUrgent, Some(now)).await?;
        }
        Ok(self.engine.take_update())
    }

    /// Waits until the gripper answers, device and limits are known, and all subscriptions stand.
    ///
    /// # Errors
    /// [`Error::NotConnected`] when that takes longer than
    /// [`connect_timeout_ms`](super::Config::connect_timeout_ms); those of the transport.
    pub async fn connect(&mut self) -> Result<(), Error<IO::Error>> {
        self.engine.clear_up();
        let until = self.clock.now().plus(self.engine.config().connect_timeout_ms);
        if self.reach(Goal::Connected, Some(until)).await? { Ok(()) } else { Err(Error::NotConnected) }
    }

    /// Connects, runs a program, and announces the end of the connection however the program ends, so that it may
    /// leave by `?` at any place. An error of the program takes precedence over one of the announcement.
    ///
    /// Over TCP the announcement ends a motion that still runs, and without it the gripper enters FAST STOP when
    /// the connection closes, which it shall if the program crashes. Dropping the driver, or a future, announces
    /// nothing by itself; the TCP transports of features `std` and `tokio` do, unless the program panics. Lines without
    /// an announcement (E_NOT_AVAILABLE) are left as they are: a motion that was begun goes on.
    ///
    /// Its result is that of the program, whose errors only have to be made from [`Error`]. Where the compiler asks
    /// for their type, name it: `|gripper| -> Result<_, MyError> { ... }`.
    ///
    /// # Errors
    /// Those of [`connect`](Self::connect), the program and
    /// [`announce_disconnect`](Self::announce_disconnect).
    pub async fn with_connection<T, F: From<Error<IO::Error>>>(
        &mut self,
        program: impl AsyncFnOnce(&mut Self) -> Result<T, F>,
    ) -> Result<T, F> {
        self.connect().await?;
        let result = program(self).await;
        let announced = self.announce_disconnect().await;
        let value = result?;
        match announced {
            // There is nothing to announce: no TCP, no connection any more, or the program has done it.
            Ok(())
            | Err(Error::Refused(Status::NotAvailable | Status::AccessDenied) | Error::NotConnected) => {
                Ok(value)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Announces the end of a TCP connection, so that it causes no FAST STOP; ends a running motion (command set,
    /// 3.1.2). Afterwards the gripper denies everything until a new connection: see [`into_io`](Self::into_io).
    /// [`with_connection`](Self::with_connection) does it in any case.
    ///
    /// # Errors
    /// [`Error::Refused`] with E_NOT_AVAILABLE on other lines than TCP.
    ///
    #[doc = request_errors!()]
    pub async fn announce_disconnect(&mut self) -> Result<(), Error<IO::Error>> {
        self.tell(Command::DisconnectAnnouncement).await
    }

    /// References the fingers at an end stop (command set, 3.2.1). Takes up to about 4 s.
    ///
    /// # Errors
    /// [`Error::Blocked`] when no end stop was found.
    ///
    #[doc = motion_errors!()]
    pub async fn home(&mut self, direction: HomingDirection) -> Result<(), Error<IO::Error>> {
        let pending = self.begin_home(direction).await?;
        self.wait(&pending).await
    }

    /// As [`home`](Self::home), up to E_CMD_PENDING.
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

    /// As [`move_to`](Self::move_to), up to E_CMD_PENDING.
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

    /// Opens the fingers by an offset, or closes them by a negative one (command set, 3.2.2).
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

    /// As [`move_by`](Self::move_by), up to E_CMD_PENDING.
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

    /// Grips a part of a nominal width, with the force limit that is set (command set, 3.2.6).
    ///
    /// # Errors
    /// "No part" is a result, not an error: [`Grip::NoPart`].
    ///
    #[doc = motion_errors!()]
    pub async fn grip(&mut self, width: Mm, speed: MmPerS) -> Result<Grip, Error<IO::Error>> {
        let pending = self.begin_grip(width, speed).await?;
        self.wait(&pending).await
    }

    /// As [`grip`](Self::grip), up to E_CMD_PENDING.
    ///
    /// # Errors
    #[doc = begin_errors!()]
    pub async fn begin_grip(&mut self, width: Mm, speed: MmPerS) -> Result<Pending<Grip>, Error<IO::Error>> {
        self.begin(Command::GripPart { width: width.0, speed: speed.0 }).await
    }

    /// Opens the fingers to a width, to release a part (command set, 3.2.7).
    ///
    /// # Errors
    #[doc = motion_errors!()]
    pub async fn release(&mut self, width: Mm, speed: MmPerS) -> Result<(), Error<IO::Error>> {
        let pending = self.begin_release(width, speed).await?;
        self.wait(&pending).await
    }

    /// As [`release`](Self::release), up to E_CMD_PENDING.
    ///
    /// # Errors
    #[doc = begin_errors!()]
    pub async fn begin_release(&mut self, width: Mm, speed: MmPerS) -> Result<Pending<()>, Error<IO::Error>> {
        self.begin(Command::ReleasePart { width: width.0, speed: speed.0 }).await
    }

    /// Waits for the end of a motion that was begun. It can be asked again after an error of the transport.
    ///
    /// # Errors
    /// [`Error::Blocked`], [`Error::Aborted`], [`Error::Failed`], [`Error::Unanswered`]; [`Error::Superseded`] when
    /// another one was begun since; those of the transport.
    pub async fn wait<T: MotionResult>(&mut self, pending: &Pending<T>) -> Result<T, Error<IO::Error>> {
        self.engine.clear_up();
        if !self.engine.motion().is_of(pending) {
            return Err(Error::Superseded);
        }
        self.reach(Goal::MotionOver, None).await?;
        self.engine.motion().result()
    }

    /// What a motion came to; `None` while it goes on. Takes what is there and does not wait.
    ///
    /// # Errors
    /// As [`wait`](Self::wait).
    pub async fn poll<T: MotionResult>(
        &mut self,
        pending: &Pending<T>,
    ) -> Result<Option<T>, Error<IO::Error>> {
        self.engine.clear_up();
        if !self.engine.motion().is_of(pending) {
            return Err(Error::Superseded);
        }
        let now = self.clock.now();
        if self.reach(Goal::MotionOver, Some(now)).await? {
            self.engine.motion().result().map(Some)
        } else {
            Ok(None)
        }
    }

    /// Stops the fingers; a motion that was begun ends with [`Error::Aborted`], and a part is held no longer
    /// (command set, 3.2.3). It is sent before all that waits, connected or not, even if the call is given up.
    ///
    /// # Errors
    /// - [`Unanswered`](Error::Unanswered): sent, and not confirmed in time.
    /// - [`FastStopRunning`](Error::FastStopRunning): a FAST STOP is not confirmed yet, which stops the fingers as well.
    /// - [`Transport`](Error::Transport) or [`Closed`](Error::Closed): the line failed, or the gripper closed it.
    pub async fn stop(&mut self) -> Result<(), Error<IO::Error>> {
        self.urge(StopKind::Stop).await
    }

    /// Stops the fingers the fastest way and locks them until [`acknowledge`](Self::acknowledge) (command set,
    /// 3.2.4). It is sent before anything else, connected or not.
    ///
    /// # Errors
    /// [`Error::Unanswered`]: not confirmed in time. It is repeated in every call from then on, over reconnects as
    /// well, until it is.
    pub async fn fast_stop(&mut self) -> Result<(), Error<IO::Error>> {
        self.urge(StopKind::FastStop).await
    }

    /// Acknowledges a FAST STOP or a fault, which unlocks the fingers (command set, 3.2.5). The driver never does
    /// that by itself.
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn acknowledge(&mut self) -> Result<(), Error<IO::Error>> {
        self.tell(Command::ACKNOWLEDGE).await
    }

    /// Sets the acceleration of the motions that follow, in mm/s²; clamped to the gripper's limits (command set,
    /// 3.3.1).
    ///
    /// # Errors
    /// [`Error::Mismatch`] if settings are read back.
    ///
    #[doc = request_errors!()]
    pub async fn set_acceleration(&mut self, acceleration: f32) -> Result<(), Error<IO::Error>> {
        self.tell(Command::SetAcceleration { acceleration }).await
    }

    /// The acceleration in mm/s² (command set, 3.3.2).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn acceleration(&mut self) -> Result<f32, Error<IO::Error>> {
        self.ask(Command::GetAcceleration, value!(GetAcceleration)).await
    }

    /// Sets the greatest force of the grips and pre-positions that follow; clamped to the gripper's limits (command set,
    /// 3.3.3).
    ///
    /// # Errors
    /// [`Error::Mismatch`] if settings are read back.
    ///
    #[doc = request_errors!()]
    pub async fn set_force_limit(&mut self, force: N) -> Result<(), Error<IO::Error>> {
        self.tell(Command::SetForceLimit { force: force.0 }).await
    }

    /// The force limit (command set, 3.3.4).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn force_limit(&mut self) -> Result<N, Error<IO::Error>> {
        self.ask(Command::GetForceLimit, value!(GetForceLimit => N)).await
    }

    /// Sets the range that the fingers may not leave, in mm (command set, 3.3.5).
    ///
    /// # Errors
    /// [`Error::Mismatch`] if settings are read back.
    ///
    #[doc = request_errors!()]
    pub async fn set_soft_limits(&mut self, limits: SoftLimits) -> Result<(), Error<IO::Error>> {
        self.tell(Command::SetSoftLimits { limits }).await
    }

    /// The range that the fingers may not leave, in mm; `None` when there is none (command set, 3.3.6).
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

    /// Lets the fingers go everywhere again (command set, 3.3.7).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn clear_soft_limits(&mut self) -> Result<(), Error<IO::Error>> {
        self.tell(Command::ClearSoftLimits).await
    }

    /// Allows forces up to the overdrive limit, or ends that (command set, 3.3.8).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn set_overdrive(&mut self, enabled: bool) -> Result<(), Error<IO::Error>> {
        self.tell(Command::OverdriveMode { enabled }).await
    }

    /// Zeroes the force sensor (command set, 3.3.9).
    ///
    /// # Errors
    /// [`Error::Refused`] with E_NOT_AVAILABLE when there is no sensor, which is harmless, and with E_ACCESS_DENIED
    /// while a part is held.
    ///
    #[doc = request_errors!()]
    pub async fn tare(&mut self) -> Result<(), Error<IO::Error>> {
        self.tell(Command::TareForceSensor).await
    }

    /// The system state flags (command set, 3.4.1).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn system_state(&mut self) -> Result<SystemFlags, Error<IO::Error>> {
        self.ask(Command::GetSystemState { update: AutoUpdate::once() }, value!(GetSystemState)).await
    }

    /// Where the gripping process stands (command set, 3.4.2).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn gripper_state(&mut self) -> Result<GripperState, Error<IO::Error>> {
        self.ask(Command::GetGripperState { update: AutoUpdate::once() }, value!(GetGripperState)).await
    }

    /// Counts of grips (command set, 3.4.3); they start again at 0 with `reset`.
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn statistics(&mut self, reset: bool) -> Result<GrippingStatistics, Error<IO::Error>> {
        self.ask(Command::GetGrippingStatistics { reset }, value!(GetGrippingStatistics)).await
    }

    /// The opening width (command set, 3.4.4).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn width(&mut self) -> Result<Mm, Error<IO::Error>> {
        self.ask(Command::GetOpeningWidth { update: AutoUpdate::once() }, value!(GetOpeningWidth => Mm)).await
    }

    /// The finger speed (command set, 3.4.5).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn speed(&mut self) -> Result<MmPerS, Error<IO::Error>> {
        self.ask(Command::GetSpeed { update: AutoUpdate::once() }, value!(GetSpeed => MmPerS)).await
    }

    /// The gripping force (command set, 3.4.6).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn force(&mut self) -> Result<N, Error<IO::Error>> {
        self.ask(Command::GetForce { update: AutoUpdate::once() }, value!(GetForce => N)).await
    }

    /// The temperature of the device (command set, 3.4.7).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn temperature(&mut self) -> Result<Temperature, Error<IO::Error>> {
        self.ask(Command::GetTemperature, value!(GetTemperature)).await
    }

    /// Device type, versions and serial number (command set, 3.5.1).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn system_info(&mut self) -> Result<SystemInfo, Error<IO::Error>> {
        self.ask(Command::GetSystemInfo, value!(GetSystemInfo)).await
    }

    /// The physical limits (command set, 3.5.4).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn limits(&mut self) -> Result<SystemLimits, Error<IO::Error>> {
        self.ask(Command::GetSystemLimits, value!(GetSystemLimits)).await
    }

    /// Sets the device tag: up to 64 printable ASCII characters (command set, 3.5.2).
    ///
    /// # Errors
    /// [`Error::Invalid`] for other texts.
    ///
    #[doc = request_errors!()]
    pub async fn set_tag(&mut self, tag: &str) -> Result<(), Error<IO::Error>> {
        let tag = DeviceTag::new(tag)?;
        self.lend(Command::SetDeviceTag { tag }, &mut |_| {}).await
    }

    /// The device tag, written to the caller's buffer (command set, 3.5.3).
    ///
    /// # Errors
    /// [`Error::Refused`] with E_NOT_AVAILABLE when none is set.
    ///
    #[doc = request_errors!()]
    pub async fn tag<'b>(
        &mut self,
        buffer: &'b mut [u8; DeviceTag::MAX_LEN],
    ) -> Result<&'b str, Error<IO::Error>> {
        let mut copied = Copied::new(buffer);
        self.lend(Command::GetDeviceTag, &mut |reply| copied.take(reply)).await?;
        // A tag is ASCII, or its reply would not have been taken.
        copied.finish().map(|bytes| core::str::from_utf8(bytes).unwrap_or_default())
    }

    /// What is connected at a finger's port (command set, 3.6.1 and 3.6.5).
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

    /// The state flags of a finger (command set, 3.6.2 and 3.6.6).
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

    /// Switches the supply of a finger; on takes about 500 ms (command set, 3.6.3 and 3.6.7).
    ///
    /// # Errors
    #[doc = request_errors!()]
    pub async fn set_finger_power(&mut self, finger: Finger, enabled: bool) -> Result<(), Error<IO::Error>> {
        self.tell(match finger {
            Finger::One => Command::Finger1Power { enabled },
            Finger::Two => Command::Finger2Power { enabled },
        })
        .await
    }

    /// One data frame of a finger, written to the caller's buffer; its meaning is the finger's: a WSG-FMF sends one
    /// `f32`, newton (command set, 3.6.4 and 3.6.8).
    ///
    /// A frame of more than `RX` - 2 bytes is not received: then [`Error::Unanswered`].
    ///
    /// # Errors
    /// [`Error::TooLong`] when the buffer is too small.
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

    /// Sends up to 256 bytes that must come back unchanged, to test the connection (command set, 3.1.1).
    ///
    /// # Errors
    /// [`Error::Mismatch`] when other bytes came back.
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

    /// Sends a command that a script on the gripper serves (ids A0h to BFh are in use), and writes what follows the
    /// status code of its final answer to the caller's buffer. An id that the manual lists is checked as that
    /// command.
    ///
    /// It counts as a motion: it is never sent twice, none other may run, and silence is taken for a lost connection.
    /// A script that takes longer than [`reply_timeout_ms`](crate::session::Config::reply_timeout_ms) needs
    /// [time-outs](crate::session::Timeout) of its own.
    ///
    /// # Errors
    /// [`Error::Refused`] with E_CMD_UNKNOWN when nothing serves it; [`Error::TooLong`].
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

    /// A command whose success says it all.
    async fn tell(&mut self, command: Command<'static>) -> Result<(), Error<IO::Error>> {
        self.exchange(command, &mut |_| {}).await
    }

    /// A command that is answered with a value.
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

    /// A command that borrows its payload.
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

    /// A motion, up to its first answer.
    async fn begin<T>(&mut self, command: Command<'static>) -> Result<Pending<T>, Error<IO::Error>> {
        self.become_free().await?;
        let width = if self.engine.link().wants_width(&command) { Some(self.width().await?.0) } else { None };
        self.engine.request_motion(command, width)?;
        self.reach(Goal::MotionDecided, None).await?;
        self.engine.motion().begun()
    }

    /// Stop or FAST STOP.
    async fn urge(&mut self, kind: StopKind) -> Result<(), Error<IO::Error>> {
        let command = kind.command();
        self.engine.clear_up();
        self.engine.link_mut().request(command, None)?;
        let look = &mut |_: &Reply<'_>| {};
        let mut awaited = Awaited::answer(command.id(), None, look);
        // A session never gives up a FAST STOP; a caller wants to know.
        let until = self.clock.now().plus(self.engine.config().confirmation_ms());
        match self.drive(&mut awaited, Goal::Answered, Some(until)).await {
            // A handle has done the same, or less.
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

    /// Cancels or completes what an earlier call left behind, so that no answer is taken for another request's.
    async fn become_free(&mut self) -> Result<(), Error<IO::Error>> {
        self.engine.clear_up();
        self.reach(Goal::Free, None).await?;
        Ok(())
    }

    /// Drives the engine to a goal that is not an answer. Returns `false` at `until`.
    async fn reach(&mut self, goal: Goal, until: Option<Instant>) -> Result<bool, Error<IO::Error>> {
        self.drive(&mut Awaited::nothing(&mut |_| {}), goal, until).await
    }
}
