//! Both ends of a line in one process and in virtual time: transport and clock of the driver, and a scripted gripper.

use crate::driver::blocking::Transport;
use crate::driver::{Clock, Timer};
pub(in crate::driver) use crate::session::tests::{INFO, LIMITS};
use crate::{
    Command, CommandId, Event, Frame, FrameEncoder, FrameParser, GripperState, Instant, Payload, Reply,
    Status, SystemFlags, Value,
};
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::vec;
use std::vec::Vec;

/// Close to the end of the clock's range, so that every script also covers the wraparound.
const BEGIN: Instant = Instant::from_millis(u32::MAX - 300);

/// Bytes received together, with their delay after the request in ms.
pub(in crate::driver) type Segment = (u32, Vec<u8>);

/// The error of the transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::driver) struct Noise;

impl core::fmt::Display for Noise {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("noise")
    }
}

impl core::error::Error for Noise {}

impl embedded_io::Error for Noise {
    fn kind(&self) -> embedded_io::ErrorKind {
        embedded_io::ErrorKind::Other
    }
}

pub(in crate::driver) struct World {
    pub(in crate::driver) now: Instant,
    parser: FrameParser<300>,
    /// Bytes for the driver, in order of time.
    coming: VecDeque<(Instant, Vec<u8>)>,
    /// The answers to the next requests with an ID, in place of the healthy gripper's.
    scripted: Vec<(u8, Vec<Segment>)>,
    /// Requests received by the gripper, without the session's own.
    pub(in crate::driver) received: Vec<(u8, Vec<u8>)>,
    /// Length of each write in bytes.
    pub(in crate::driver) writes: Vec<usize>,
    /// Number of waits of the blocking driver.
    pub(in crate::driver) waits: u32,
    /// Keeps written bytes until the flush.
    pub(in crate::driver) holds_back: bool,
    held_back: Vec<u8>,
    /// The time at which the last polled future requested a wake-up.
    wakes_at: Option<Instant>,
    /// Number of bytes that the transport still accepts.
    pub(in crate::driver) room: usize,
    /// The gripper does not answer.
    pub(in crate::driver) silent: bool,
    pub(in crate::driver) closed: bool,
    pub(in crate::driver) noise: bool,
    /// The next write fails, and the gripper discards its incomplete frame.
    pub(in crate::driver) refuses: bool,
    /// The system state that the gripper reports.
    pub(in crate::driver) flags: SystemFlags,
    pub(in crate::driver) force_limit: f32,
    /// The line of the stop handles.
    pub(in crate::driver) direct: std::sync::Arc<std::sync::Mutex<Direct>>,
    /// An action to run at a given time while the blocking driver waits.
    other: Option<(Instant, std::boxed::Box<dyn FnOnce()>)>,
    /// Payload of the last subscription to the width.
    pub(in crate::driver) width_update: Option<Vec<u8>>,
}

/// The line as used by stop handles.
#[derive(Debug, Default)]
pub(in crate::driver) struct Direct {
    bytes: Vec<u8>,
    pub(in crate::driver) is_full: bool,
}

/// Shared access to the world, for both ends and the test.
#[derive(Clone)]
pub(in crate::driver) struct Rig(Rc<RefCell<World>>);

pub(in crate::driver) fn frame(reply: Reply<'_>) -> Vec<u8> {
    FrameEncoder::new(reply.id().code(), reply).collect()
}

pub(in crate::driver) fn status(id: CommandId, status: Status) -> Vec<u8> {
    frame(Reply::status_only(id, status))
}

impl Rig {
    pub(in crate::driver) fn new() -> Self {
        Self(Rc::new(RefCell::new(World {
            now: BEGIN,
            parser: FrameParser::new(),
            coming: VecDeque::new(),
            scripted: vec![],
            received: vec![],
            writes: vec![],
            waits: 0,
            holds_back: false,
            held_back: vec![],
            wakes_at: None,
            room: usize::MAX,
            silent: false,
            closed: false,
            noise: false,
            refuses: false,
            flags: SystemFlags::REFERENCED,
            force_limit: 80.0,
            direct: std::sync::Arc::default(),
            other: None,
            width_update: None,
        })))
    }

    pub(in crate::driver) fn world<T>(&self, look: impl FnOnce(&mut World) -> T) -> T {
        look(&mut self.0.borrow_mut())
    }

    /// Sets the answer to the next request with this ID. An empty answer is silence.
    pub(in crate::driver) fn script(&self, id: CommandId, answer: Vec<Segment>) {
        self.world(|world| world.scripted.push((id.code(), answer)));
    }

    /// Sets the answer to the next request with this ID to a status.
    pub(in crate::driver) fn script_status(&self, id: CommandId, answer: Status) {
        self.script(id, vec![(1, status(id, answer))]);
    }

    /// Sets a motion's answers: E_CMD_PENDING at once, and `result` after 100 ms.
    pub(in crate::driver) fn script_motion(&self, id: CommandId, result: Status) {
        self.script(id, vec![(1, status(id, Status::CmdPending)), (100, status(id, result))]);
    }

    /// Runs an action after `ms`, while the blocking driver waits.
    pub(in crate::driver) fn later(&self, ms: u32, act: impl FnOnce() + 'static) {
        self.world(|world| world.other = Some((world.now.plus(ms), std::boxed::Box::new(act))));
    }

    /// Adds bytes to the input of the driver.
    pub(in crate::driver) fn inject(&self, bytes: &[u8]) {
        self.world(|world| world.coming.push_back((world.now, bytes.to_vec())));
    }

    pub(in crate::driver) fn received(&self, id: CommandId) -> usize {
        self.world(World::receive_from_handles);
        self.world(|world| world.received.iter().filter(|(received, _)| *received == id.code()).count())
    }

    pub(in crate::driver) fn pass(&self, ms: u32) {
        self.world(|world| world.now = world.now.plus(ms));
    }

    /// Runs a future to completion in virtual time.
    pub(in crate::driver) fn run<T>(&self, future: impl Future<Output = T>) -> T {
        self.run_for(600_000, future).expect("the future completes within ten minutes")
    }

    /// Runs a future to completion like an executor: polls it again when bytes are due or at its requested wake-up time.
    pub(in crate::driver) fn run_woken<T>(&self, future: impl Future<Output = T>) -> T {
        let mut future = pin!(future);
        let mut context = Context::from_waker(Waker::noop());
        for _ in 0..1_000 {
            self.world(|world| world.wakes_at = None);
            if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
                return value;
            }
            self.world(|world| {
                let coming = world.coming.iter().map(|(at, _)| *at).chain(world.wakes_at);
                world.now = coming.reduce(Instant::earlier_of).expect("the future has requested a wake-up");
            });
        }
        panic!("endless wake-ups");
    }

    /// Polls a future once per millisecond, at most `polls` times, and drops it.
    pub(in crate::driver) fn run_for<T>(&self, polls: u32, future: impl Future<Output = T>) -> Option<T> {
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
    fn take(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        loop {
            let (taken, event) = self.parser.push_slice(rest);
            rest = &rest[taken..];
            let Some(event) = event else { return };
            let Event::Frame(frame) = event else { panic!("a driver sends only complete frames: {event:?}") };
            let (id, payload) = (frame.id, frame.payload.to_vec());
            if !self.silent {
                self.answer(id, payload);
            }
        }
    }

    fn answer(&mut self, id: u8, payload: Vec<u8>) {
        let command =
            Command::decode(&Frame { id, payload: &payload }).expect("a driver sends only valid commands");
        let scripted = self.scripted.iter().position(|(scripted, _)| *scripted == id);
        let segments = match scripted {
            Some(at) => self.scripted.remove(at).1,
            None => self.healthy(&command),
        };
        if let Command::SetForceLimit { force } = command {
            self.force_limit = force.clamp(5.0, 80.0);
        }
        if let Command::GetOpeningWidth { .. } = command {
            self.width_update = Some(payload.clone());
        }
        for (delay, bytes) in segments {
            self.coming.push_back((self.now.plus(delay), bytes));
        }
        let is_sessions = matches!(
            command,
            Command::GetSystemInfo
                | Command::GetSystemLimits
                | Command::GetSystemState { .. }
                | Command::GetGripperState { .. }
        );
        if !is_sessions {
            self.received.push((id, payload));
        }
    }

    fn healthy(&self, command: &Command<'_>) -> Vec<Segment> {
        let id = command.id();
        let value = match *command {
            Command::GetSystemInfo => Value::GetSystemInfo(INFO),
            Command::GetSystemLimits => Value::GetSystemLimits(LIMITS),
            Command::GetSystemState { .. } => Value::GetSystemState(self.flags),
            Command::GetGripperState { .. } => Value::GetGripperState(GripperState::Positioning),
            Command::GetOpeningWidth { .. } => Value::GetOpeningWidth(42.5),
            Command::GetSpeed { .. } => Value::GetSpeed(0.0),
            Command::GetForce { .. } => Value::GetForce(0.0),
            Command::GetForceLimit => Value::GetForceLimit(self.force_limit),
            Command::Loop { data } => Value::Loop(data),
            _ if id.kind() == crate::Kind::Motion && !id.completion_statuses().is_empty() => {
                return vec![(1, status(id, Status::CmdPending)), (100, status(id, Status::Success))];
            }
            _ => return vec![(1, status(id, Status::Success))],
        };
        vec![(1, frame(Reply::success(value)))]
    }

    /// Returns the number of bytes that the gripper received outside a frame.
    pub(in crate::driver) fn stray(&self) -> u16 {
        self.parser.counters().dropped
    }

    /// Restarts the gripper, which loses an incomplete frame.
    pub(in crate::driver) fn restart(&mut self) {
        self.parser = FrameParser::new();
    }

    pub(in crate::driver) fn drop_received(&mut self) {
        self.coming.clear();
    }

    /// Passes the bytes written by stop handles to the gripper.
    fn receive_from_handles(&mut self) {
        let bytes = core::mem::take(&mut self.direct.lock().unwrap().bytes);
        self.take(&bytes);
    }

    pub(in crate::driver) fn is_due(&mut self) -> bool {
        self.receive_from_handles();
        self.closed || self.noise || self.coming.iter().any(|(at, _)| self.now.has_reached(*at))
    }

    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Noise> {
        if core::mem::take(&mut self.noise) {
            return Err(Noise);
        }
        if self.closed {
            return Ok(0);
        }
        let at = self.coming.iter().position(|(at, _)| self.now.has_reached(*at)).expect("bytes are due");
        let bytes = &mut self.coming[at].1;
        let count = bytes.len().min(buffer.len());
        buffer[..count].copy_from_slice(&bytes[..count]);
        bytes.drain(..count);
        if bytes.is_empty() {
            self.coming.remove(at);
        }
        Ok(count)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<usize, Noise> {
        self.receive_from_handles();
        if core::mem::take(&mut self.refuses) {
            self.restart();
            return Err(Noise);
        }
        let count = bytes.len().min(self.room);
        self.room -= count;
        self.writes.push(count);
        assert!(self.writes.len() < 10_000, "endless messages");
        if self.holds_back {
            self.held_back.extend(&bytes[..count]);
        } else {
            self.take(&bytes[..count]);
        }
        Ok(count)
    }

    fn flush(&mut self) {
        let held_back = core::mem::take(&mut self.held_back);
        self.take(&held_back);
    }
}

impl embedded_io::ErrorType for Rig {
    type Error = Noise;
}

impl embedded_io::ReadReady for Rig {
    fn read_ready(&mut self) -> Result<bool, Noise> {
        Ok(self.world(|world| world.is_due()))
    }
}

/// Advances the time to the next byte, but not beyond the limit of the driver.
impl Transport for Rig {
    fn wait(&mut self, at_most_ms: u32) -> Result<(), Noise> {
        let other = self.world(|world| {
            world.waits += 1;
            if world.is_due() {
                return None;
            }
            let end = world.now.plus(at_most_ms);
            let other = world.other.iter().map(|(at, _)| *at);
            world.now = world.coming.iter().map(|(at, _)| *at).chain(other).fold(end, Instant::earlier_of);
            assert!(world.now.since(BEGIN) < 600_000, "a call returns within ten minutes");
            world.other.take_if(|(at, _)| world.now.has_reached(*at))
        });
        if let Some((_, act)) = other {
            act();
        }
        Ok(())
    }
}

/// The second path to the line, for stop handles.
#[cfg(feature = "std")]
impl crate::driver::Stoppable for Rig {
    fn stop_line(&mut self) -> std::io::Result<crate::driver::StopLine> {
        let direct = self.world(|world| std::sync::Arc::clone(&world.direct));
        let write = move |bytes: &[u8]| {
            let mut direct = direct.lock().unwrap();
            if direct.is_full {
                return Err(std::io::ErrorKind::WouldBlock.into());
            }
            direct.bytes.extend(bytes);
            Ok(bytes.len())
        };
        Ok(crate::driver::StopLine::new(write, || {}))
    }
}

impl embedded_io::Read for Rig {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Noise> {
        self.world(|world| world.read(buffer))
    }
}

impl embedded_io::Write for Rig {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Noise> {
        self.world(|world| world.write(bytes))
    }

    fn flush(&mut self) -> Result<(), Noise> {
        self.world(World::flush);
        Ok(())
    }
}

impl embedded_io_async::Read for Rig {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Noise> {
        core::future::poll_fn(|_| {
            self.world(|world| if world.is_due() { Poll::Ready(world.read(buffer)) } else { Poll::Pending })
        })
        .await
    }
}

impl embedded_io_async::Write for Rig {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Noise> {
        core::future::poll_fn(|_| {
            self.world(|world| if world.room == 0 { Poll::Pending } else { Poll::Ready(world.write(bytes)) })
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Noise> {
        self.world(World::flush);
        Ok(())
    }
}

/// The clock of the rig.
#[derive(Clone)]
pub(in crate::driver) struct Watch(pub(in crate::driver) Rig);

impl Clock for Watch {
    fn now(&mut self) -> Instant {
        self.0.world(|world| world.now)
    }
}

impl Timer for Watch {
    async fn wait_until(&mut self, moment: Instant) {
        core::future::poll_fn(|_| {
            self.0.world(|world| {
                if world.now.has_reached(moment) {
                    return Poll::Ready(());
                }
                world.wakes_at = Some(world.wakes_at.map_or(moment, |at| at.earlier_of(moment)));
                Poll::Pending
            })
        })
        .await;
    }
}

/// Returns the payload of a request.
pub(in crate::driver) fn payload(command: &Command<'_>) -> Vec<u8> {
    (0..command.len()).map(|at| command.byte(at)).collect()
}
