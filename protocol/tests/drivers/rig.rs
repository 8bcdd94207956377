//! A line to a virtual gripper, with transport, clock and executor for a driver.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::future::poll_fn;
use std::pin::pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

use wsg_protocol::driver::{Clock, Timer, blocking::Transport};
use wsg_protocol::{Instant, SystemLimits};
use wsg_sim::{Config, MAX_FRAME_LEN, PortId, PortKind, Time, VirtualGripper};

/// 90 s; every motion takes less.
const LONGEST_MS: u32 = 90_000;

/// A line to a virtual gripper, shared by both ends and the test.
#[derive(Clone)]
pub(crate) struct TestRig(Rc<RefCell<World>>);

pub(crate) struct World {
    pub(crate) gripper: VirtualGripper,
    limits: SystemLimits,
    kind: PortKind,
    port: PortId,
    now: Time,
    to_driver: VecDeque<u8>,
    /// Written bytes, one entry per write.
    pub(crate) writes: Vec<Vec<u8>>,
    /// Discards all data from the gripper.
    pub(crate) mute: bool,
    /// Discards all data to the gripper.
    pub(crate) deaf: bool,
    /// The other end has closed the connection.
    pub(crate) closed: bool,
    /// Number of bytes that the transport still accepts.
    pub(crate) room: usize,
    /// Number of messages from the gripper still to be lost.
    pub(crate) lose: usize,
}

impl TestRig {
    pub(crate) fn new(kind: PortKind, config: Config) -> Self {
        let limits = config.model.parameters().limits;
        let mut gripper = VirtualGripper::new(config);
        let port = gripper.connect(kind).expect("a new gripper accepts a client");
        Self(Rc::new(RefCell::new(World {
            gripper,
            limits,
            kind,
            port,
            now: Time::ZERO,
            to_driver: VecDeque::new(),
            writes: vec![],
            mute: false,
            deaf: false,
            closed: false,
            room: usize::MAX,
            lose: 0,
        })))
    }

    pub(crate) fn world<T>(&self, look: impl FnOnce(&mut World) -> T) -> T {
        look(&mut self.0.borrow_mut())
    }

    pub(crate) fn millis(&self) -> u32 {
        self.world(|world| world.millis())
    }

    /// Returns the limits of the gripper.
    pub(crate) fn limits(&self) -> SystemLimits {
        self.world(|world| world.limits)
    }

    pub(crate) fn pass(&self, millis: u32) {
        (0..millis).for_each(|_| self.world(World::pass));
    }

    /// Adds bytes to the driver's input that the gripper never sent.
    pub(crate) fn inject(&self, bytes: &[u8]) {
        self.world(|world| world.to_driver.extend(bytes));
    }

    /// Breaks the connection and makes a new one.
    pub(crate) fn reconnect(&self) {
        self.world(|world| {
            world.gripper.disconnect(world.port, world.now);
            world.port = world.gripper.connect(world.kind).expect("a port is free");
            world.to_driver.clear();
            world.closed = false;
        });
    }

    /// Runs a future to completion in virtual time.
    pub(crate) fn run<T>(&self, future: impl Future<Output = T>) -> T {
        self.run_for(LONGEST_MS, future).expect("the future completes")
    }

    /// Polls a future once per millisecond, at most `polls` times, and drops it.
    pub(crate) fn run_for<T>(&self, polls: u32, future: impl Future<Output = T>) -> Option<T> {
        let mut future = pin!(future);
        let mut context = Context::from_waker(Waker::noop());
        for _ in 0..polls {
            if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
                return Some(value);
            }
            self.pass(1);
        }
        None
    }
}

impl World {
    fn millis(&self) -> u32 {
        (self.now.as_micros() / 1_000) as u32
    }

    fn pass(&mut self) {
        self.now = self.now.plus_millis(1);
        self.gripper.advance(self.now);
        self.collect();
    }

    fn collect(&mut self) {
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(message) = self.gripper.transmit(self.port, &mut buffer) {
            if self.lose > 0 {
                self.lose -= 1;
            } else if !self.mute && !self.closed {
                self.to_driver.extend(message);
            }
        }
    }

    fn take(&mut self, bytes: &[u8]) -> usize {
        let taken = if self.closed { 0 } else { bytes.len().min(self.room) };
        let bytes = &bytes[..taken];
        self.room -= taken;
        if taken > 0 {
            self.writes.push(bytes.to_vec());
        }
        if !self.deaf {
            self.gripper.receive(self.port, self.now, bytes);
        }
        self.collect();
        taken
    }

    fn give(&mut self, buffer: &mut [u8]) -> usize {
        let count = buffer.len().min(self.to_driver.len());
        buffer.iter_mut().zip(self.to_driver.drain(..count)).for_each(|(slot, byte)| *slot = byte);
        count
    }
}

impl Clock for TestRig {
    fn now(&mut self) -> Instant {
        // Close to the end of the clock's range, so that every script also covers the wraparound.
        Instant::from_millis(self.millis().wrapping_sub(300))
    }
}

impl Timer for TestRig {
    async fn wait_until(&mut self, moment: Instant) {
        poll_fn(|_| if self.now().has_reached(moment) { Poll::Ready(()) } else { Poll::Pending }).await;
    }
}

impl embedded_io::ErrorType for TestRig {
    type Error = Infallible;
}

impl embedded_io::ReadReady for TestRig {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.world(|world| !world.to_driver.is_empty() || world.closed))
    }
}

impl Transport for TestRig {
    /// Advances the time until data is available.
    fn wait(&mut self, at_most_ms: u32) -> Result<(), Infallible> {
        self.world(|world| {
            for _ in 0..at_most_ms {
                if !world.to_driver.is_empty() || world.closed {
                    break;
                }
                world.pass();
            }
        });
        Ok(())
    }
}

impl embedded_io::Read for TestRig {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Ok(self.world(|world| world.give(buffer)))
    }
}

impl embedded_io::Write for TestRig {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(self.world(|world| world.take(bytes)))
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl embedded_io_async::Read for TestRig {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            self.world(|world| match world.give(buffer) {
                0 if !world.closed => Poll::Pending,
                count => Poll::Ready(Ok(count)),
            })
        })
        .await
    }
}

impl embedded_io_async::Write for TestRig {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            self.world(|world| match world.take(bytes) {
                0 if !world.closed => Poll::Pending,
                count => Poll::Ready(Ok(count)),
            })
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
