//! A test rig for programs that use the blocking driver: gripper, line and clock in virtual time (feature `rig`).
//!
//! It uses no socket, no thread and no wall clock. It does not model a line: bytes take no time, and the only line
//! fault is a line that transfers nothing.

use crate::axis::Part;
use crate::config::Config;
use crate::faults::Fault;
use crate::gripper::{State, VirtualGripper};
use crate::port::{MAX_FRAME_LEN, PortId, PortKind};
use crate::time::Time;
use core::convert::Infallible;
use embedded_io::{ErrorType, Read, ReadReady, Write};
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use wsg_protocol::Instant;
use wsg_protocol::driver::blocking::Transport;
use wsg_protocol::driver::{Clock, StopLine, Stoppable};

/// Virtual time of one check of an empty line, in microseconds. Without it, a program that polls in a loop and never
/// waits would stop the clock.
const LOOK_US: u64 = 100;

/// A virtual gripper with its line and clock, for unit tests of programs that use the blocking driver.
///
/// It implements [`Transport`] and [`Clock`]. Clones share one gripper, so [`line`](Self::line) and
/// [`clock`](Self::clock) go into the driver, and the test keeps the rig to reach the gripper between two commands.
///
/// Virtual time advances while the driver waits, up to the next event of the gripper or the driver's deadline, and by
/// 100 µs at each check of an empty line. A minute of travel therefore takes milliseconds, and the same program
/// produces the same result each time.
///
/// A rig is [`Send`] and `Sync`. It needs an allocator and a mutex, so the feature `rig` links `std`, but none of the
/// servers of the feature `std`.
///
/// ```
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::blocking::{Gripper, Transport};
/// use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS};
/// use wsg_sim::{Config, Part, VirtualRig};
///
/// // The program under test. It also runs on `host::Tcp` and `host::StdClock` as well.
/// fn pick<T: Transport, C: Clock>(gripper: &mut Gripper<T, C>) -> Result<Grip, Error<T::Error>> {
///     let grip = gripper.grip(Mm(20.0), MmPerS(100.0))?;
///     gripper.release(Mm(60.0), MmPerS(200.0))?;
///     Ok(grip)
/// }
///
/// let rig = VirtualRig::new(Config { part: Part::of_width(20.0), ..Config::default() });
/// let mut gripper = Gripper::new(rig.line(), rig.clock());
/// gripper.connect().unwrap();
/// gripper.home(HomingDirection::Default).unwrap();
/// assert_eq!(pick(&mut gripper), Ok(Grip::Held));
///
/// rig.set_part(None);
/// assert_eq!(pick(&mut gripper), Ok(Grip::NoPart));
/// assert_eq!(rig.state().width, 60.0);
/// ```
#[derive(Clone)]
pub struct VirtualRig(Arc<Mutex<World>>);

struct World {
    config: Config,
    kind: PortKind,
    gripper: VirtualGripper,
    port: PortId,
    line: LineState,
    to_driver: VecDeque<u8>,
    now: Time,
    /// Power-up, the zero point of the gripper's own time.
    powered_up: Time,
}

/// Whether the line transfers data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LineState {
    Intact,
    /// Bytes are lost in both directions.
    Cut,
    /// The connection has ended, and the driver notices it.
    Closed,
}

impl VirtualRig {
    /// Returns a rig with a gripper just powered up, which speaks the binary protocol over RS-232.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self::with_port(PortKind::Serial, config)
    }

    /// Returns a rig with another kind of line, such as [`PortKind::GclTcp`] for GCL, or [`PortKind::Tcp`] for a
    /// connection whose end the gripper notices.
    #[must_use]
    pub fn with_port(kind: PortKind, config: Config) -> Self {
        let (gripper, port) = power_up(config, kind);
        Self(Arc::new(Mutex::new(World {
            config,
            kind,
            gripper,
            port,
            line: LineState::Intact,
            to_driver: VecDeque::new(),
            now: Time::ZERO,
            powered_up: Time::ZERO,
        })))
    }

    /// Returns the driver's end of the line: a clone, because the rig is its own transport.
    #[must_use]
    pub fn line(&self) -> Self {
        self.clone()
    }

    /// Returns the driver's clock: also a clone. It counts the milliseconds of [`time`](Self::time).
    #[must_use]
    pub fn clock(&self) -> Self {
        self.clone()
    }

    /// Returns the virtual time since the rig was built.
    #[must_use]
    pub fn time(&self) -> Time {
        self.world().now
    }

    /// Advances time by `ms` milliseconds. Bytes from the gripper wait for the driver.
    pub fn pass(&self, ms: u32) {
        let mut world = self.world();
        let end = world.now.plus_millis(ms.into());
        world.advance(end);
    }

    /// Returns the state of the gripper as an observer beside it sees it.
    #[must_use]
    pub fn state(&self) -> State {
        self.world().gripper.state()
    }

    /// Places a part between the fingers, or removes it; see [`VirtualGripper::set_part`].
    pub fn set_part(&self, part: Option<Part>) {
        self.access(|gripper, now| gripper.set_part(part, now));
    }

    /// Begins or ends a fault of the gripper.
    pub fn set_fault(&self, fault: Fault, on: bool) {
        self.access(|gripper, now| gripper.set_fault(fault, on, now));
    }

    /// Power-cycles the gripper. It is not referenced afterwards and loses its settings and subscriptions. A TCP
    /// connection closes; any other line stays open.
    pub fn restart(&self) {
        let mut world = self.world();
        let World { config, kind, now, .. } = *world;
        (world.gripper, world.port) = power_up(config, kind);
        world.powered_up = now;
        if kind.is_connection() {
            world.line = LineState::Closed;
        }
    }

    /// Cuts the line. Bytes are lost in both directions and neither end notices, as with a pulled serial cable.
    pub fn cut_line(&self) {
        self.world().line = LineState::Cut;
    }

    /// Closes the connection. The driver reports [`Closed`](wsg_protocol::driver::Error::Closed), and a gripper on TCP
    /// enters FAST STOP unless the program has announced the end (command set, 1.4.2).
    pub fn close_line(&self) {
        let mut world = self.world();
        let (port, now) = (world.port, world.device_time());
        world.gripper.disconnect(port, now);
        world.line = LineState::Closed;
    }

    /// Restores a line that was cut, or opens a new connection after the old one closed. Call `connect` of the driver next.
    ///
    /// # Panics
    /// Panics if [`access`](Self::access) has used up the gripper's connections.
    pub fn restore_line(&self) {
        let mut world = self.world();
        if world.line == LineState::Closed {
            let (port, kind, now) = (world.port, world.kind, world.device_time());
            world.gripper.disconnect(port, now);
            world.port = world.gripper.connect(kind).expect("the gripper accepts another connection");
            world.to_driver.clear();
        }
        world.line = LineState::Intact;
    }

    /// Sends bytes to the driver that do not come from the gripper, such as noise or an incomplete frame.
    pub fn inject(&self, bytes: &[u8]) {
        self.world().to_driver.extend(bytes);
    }

    /// Calls `act` with the gripper and its time, for everything that has no method here, such as a second client. That
    /// time starts at power-up, so it differs from [`time`](Self::time) after a [`restart`](Self::restart).
    pub fn access<T>(&self, act: impl FnOnce(&mut VirtualGripper, Time) -> T) -> T {
        let mut world = self.world();
        let now = world.device_time();
        let result = act(&mut world.gripper, now);
        world.collect();
        result
    }

    /// Ignores a poisoned lock: a panic in `access` leaves the gripper in a usable state.
    fn world(&self) -> MutexGuard<'_, World> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn power_up(config: Config, kind: PortKind) -> (VirtualGripper, PortId) {
    let mut gripper = VirtualGripper::new(config);
    let port = gripper.connect(kind).expect("a new gripper accepts a client");
    (gripper, port)
}

impl World {
    fn device_time(&self) -> Time {
        Time::from_micros(self.now.as_micros() - self.powered_up.as_micros())
    }

    fn is_readable(&self) -> bool {
        !self.to_driver.is_empty() || self.line == LineState::Closed
    }

    /// Advances time to `moment`.
    fn advance(&mut self, moment: Time) {
        self.now = moment;
        let now = self.device_time();
        self.gripper.advance(now);
        self.collect();
    }

    /// Advances time until the driver can read, up to `deadline`.
    fn wait(&mut self, deadline: Time) {
        while !self.is_readable() && self.now < deadline {
            let wake = self.gripper.next_wake().map(|at| self.powered_up.plus_micros(at.as_micros()));
            let soonest = self.now.plus_micros(1);
            self.advance(wake.map_or(deadline, |wake| wake.max(soonest).min(deadline)));
        }
    }

    /// Moves the gripper's output to the driver's input.
    fn collect(&mut self) {
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
            if self.line == LineState::Intact {
                self.to_driver.extend(frame);
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> usize {
        match self.line {
            LineState::Closed => return 0,
            LineState::Cut => {}
            LineState::Intact => {
                let (port, now) = (self.port, self.device_time());
                self.gripper.receive(port, now, bytes);
                self.collect();
            }
        }
        bytes.len()
    }
}

impl core::fmt::Debug for VirtualRig {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let world = self.world();
        f.debug_struct("VirtualRig")
            .field("time", &world.now)
            .field("line", &world.line)
            .field("state", &world.gripper.state())
            .finish_non_exhaustive()
    }
}

impl Clock for VirtualRig {
    fn now(&mut self) -> Instant {
        // It wraps, like every driver clock.
        Instant::from_millis((self.time().as_micros() / 1_000) as u32)
    }
}

impl ErrorType for VirtualRig {
    type Error = Infallible;
}

impl Transport for VirtualRig {
    fn wait(&mut self, at_most_ms: u32) -> Result<(), Infallible> {
        let mut world = self.world();
        // Counts from the clock's last tick, so that the driver's clock reaches exactly the deadline.
        let tick = Time::from_millis(world.now.as_micros() / 1_000);
        world.wait(tick.plus_millis(at_most_ms.into()));
        Ok(())
    }
}

impl ReadReady for VirtualRig {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        let mut world = self.world();
        if !world.is_readable() {
            let end = world.now.plus_micros(LOOK_US);
            world.advance(end);
        }
        Ok(world.is_readable())
    }
}

impl Read for VirtualRig {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Read::read(&mut self.world().to_driver, buffer)
    }
}

impl Write for VirtualRig {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(self.world().write(bytes))
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Stop handles write to the same line. A waiting driver needs no wake-up because it waits in virtual time only.
impl Stoppable for VirtualRig {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        let rig = self.clone();
        Ok(StopLine::new(move |bytes| Ok(rig.world().write(bytes)), || {}))
    }
}
