//! The gripper's end of the line: a virtual gripper in the board's time, and a line that can be cut and disturbed.

use std::io::Write;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::{Context, Result};
use wsg_protocol::{Command, Event, FrameParser, Status, frame::MAX_MESSAGE_LEN};
use wsg_sim::{Config, Fault, MAX_FRAME_LEN, Part, PortId, PortKind, State, Time, VirtualGripper};

use crate::clock::Clock;
use crate::faulty_link::FaultyWay;
use crate::trace::{Entry, Trace};

/// The longest time between two looks at the clock: what a part or a fault sets off shows at most this late.
const LOOK_AROUND: Duration = Duration::from_millis(5);

/// How far the fingers move from one entry in the trace to the next, in mm.
const TRACED_TRAVEL: f32 = 10.0;

/// What becomes of the frames that the gripper sends: each in, any number out, in order.
pub type Tampering = Box<dyn FnMut(Vec<u8>) -> Vec<Vec<u8>> + Send>;

/// A virtual gripper that serves one line. Dropping it hangs up.
pub struct GripperEnd {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    world: Mutex<World>,
    over: AtomicBool,
}

struct World {
    gripper: VirtualGripper<1>,
    port: PortId,
    line: UnixStream,
    is_cut: bool,
    tampering: Option<Tampering>,
    /// The way to the gripper and the way to the bridge.
    ways: Option<(FaultyWay, FaultyWay)>,
    /// Finds frames in what the bridge sends, for the trace only.
    seen: FrameParser<MAX_MESSAGE_LEN>,
    traced_width: f32,
    config: Config,
    clock: Clock,
    /// When it was switched on.
    start: Duration,
    trace: Trace,
}

impl GripperEnd {
    /// Switches a gripper on at this end of a line, which goes by this clock: that of the board at the other end.
    ///
    /// # Errors
    /// When the line or a thread cannot be set up.
    pub fn start(line: UnixStream, clock: Clock, config: Config, trace: &Trace) -> Result<Self> {
        let reader = line.try_clone().context("cannot listen on the gripper's line")?;
        let (gripper, port) = switch_on(config)?;
        let world = World {
            gripper,
            port,
            line,
            is_cut: false,
            tampering: None,
            ways: None,
            seen: FrameParser::new(),
            traced_width: f32::NAN,
            config,
            start: clock.now(),
            clock: clock.clone(),
            trace: trace.clone(),
        };
        let shared = Arc::new(Shared { world: Mutex::new(world), over: AtomicBool::new(false) });
        if clock.is_wall() {
            let serving = Arc::clone(&shared);
            let thread = thread::Builder::new().name("gripper".into());
            let thread = thread.spawn(move || serve(&serving, &reader))?;
            return Ok(Self { shared, thread: Some(thread) });
        }
        let followed = Arc::downgrade(&shared);
        clock.follow(move || followed.upgrade().is_some_and(|shared| come_up(&shared, &reader)));
        Ok(Self { shared, thread: None })
    }

    /// How the gripper is at this moment.
    #[must_use]
    pub fn state(&self) -> State {
        let mut world = self.world();
        world.turn(&[]);
        world.gripper.state()
    }

    /// Puts a part between the fingers, or takes it away.
    pub fn set_part(&self, part: Option<Part>) {
        let mut world = self.world();
        let now = world.now();
        world.gripper.set_part(part, now);
        world.turn(&[]);
    }

    /// Lets a fault begin or end.
    pub fn set_fault(&self, fault: Fault, on: bool) {
        let mut world = self.world();
        let now = world.now();
        world.gripper.set_fault(fault, on, now);
        world.turn(&[]);
    }

    /// Cuts the line, both ways, or mends it.
    pub fn cut(&self, cut: bool) {
        self.world().is_cut = cut;
    }

    /// Switches the gripper off and on again: it has forgotten everything.
    ///
    /// # Errors
    /// Never, as long as a new gripper takes a client.
    pub fn restart(&self) -> Result<()> {
        let mut world = self.world();
        let (gripper, port) = switch_on(world.config)?;
        (world.gripper, world.port) = (gripper, port);
        world.start = world.clock.now();
        Ok(())
    }

    /// Gives the gripper a command of a third party, as its web page does. Returns its first status.
    pub fn command(&self, command: &Command<'_>) -> Status {
        let mut world = self.world();
        let now = world.now();
        let status = world.gripper.command(command, now);
        world.turn(&[]);
        status
    }

    /// Lets `tampering` have every frame that the gripper sends from now on; `None`: they arrive as they are.
    pub fn tamper(&self, tampering: Option<Tampering>) {
        self.world().tampering = tampering;
    }

    /// Puts faulty ways between bridge and gripper, to it and from it, and gives those back that were there; `None`: what is
    /// sent arrives. What is still on the old ways is lost.
    pub fn disturb(&self, ways: Option<(FaultyWay, FaultyWay)>) -> Option<(FaultyWay, FaultyWay)> {
        std::mem::replace(&mut self.world().ways, ways)
    }

    /// Sends bytes to the bridge that the gripper never sent.
    pub fn inject(&self, bytes: &[u8]) {
        let mut world = self.world();
        world.trace.add(Entry::FromGripper(bytes.to_vec()));
        world.send(bytes);
    }

    /// Lets the gripper receive bytes that the bridge never sent.
    pub fn mislead(&self, bytes: &[u8]) {
        let mut world = self.world();
        let now = world.now();
        let World { gripper, port, .. } = &mut *world;
        gripper.receive(*port, now, bytes);
    }

    fn world(&self) -> MutexGuard<'_, World> {
        lock(&self.shared.world)
    }
}

impl Drop for GripperEnd {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // Had it panicked, its message is out already.
            let _ = thread.join();
        }
    }
}

fn switch_on(config: Config) -> Result<(VirtualGripper<1>, PortId)> {
    let mut gripper = VirtualGripper::with_ports(config);
    let port = gripper.connect(PortKind::Serial).context("a new gripper takes a client")?;
    Ok((gripper, port))
}

/// Passes bytes and time to the gripper until this end is dropped or the other one hangs up.
fn serve(shared: &Shared, line: &UnixStream) {
    while !shared.over.load(Ordering::Relaxed) {
        let wait = lock(&shared.world).until_next_wake().clamp(Duration::from_micros(100), LOOK_AROUND);
        if !take(shared, line, wait) {
            return;
        }
    }
}

/// The same once, for what has come; whether it is to go on.
fn come_up(shared: &Shared, line: &UnixStream) -> bool {
    match uninterrupted::is_readable_within(line, Duration::ZERO) {
        Ok(true) => take(shared, line, Duration::ZERO),
        Ok(false) => {
            lock(&shared.world).turn(&[]);
            true
        }
        Err(_) => false,
    }
}

/// Passes what comes within this time; whether the other end is still there.
fn take(shared: &Shared, line: &UnixStream, within: Duration) -> bool {
    let mut chunk = [0; 256];
    let bytes = match uninterrupted::read_within(line, &mut chunk, within) {
        Ok(Some(0)) | Err(_) => return false,
        Ok(count) => chunk.get(..count.unwrap_or(0)).unwrap_or(&[]),
    };
    lock(&shared.world).turn(bytes);
    true
}

impl World {
    fn now(&self) -> Time {
        let since = self.clock.now().saturating_sub(self.start);
        Time::from_micros(since.as_micros().try_into().unwrap_or(u64::MAX))
    }

    fn until_next_wake(&self) -> Duration {
        let now = self.now().as_micros();
        let wake = self.gripper.next_wake().map_or(u64::MAX, Time::as_micros);
        Duration::from_micros(wake.saturating_sub(now))
    }

    /// Takes bytes from the bridge, lets the gripper come up to now, and sends what it has to say.
    fn turn(&mut self, bytes: &[u8]) {
        let now = self.now();
        let bytes = if self.is_cut { &[] } else { bytes };
        self.note_frames(bytes);
        let bytes = match &mut self.ways {
            Some((way, _)) => {
                let now_ms = millis(now);
                way.pass(now_ms, bytes);
                way.arrive(now_ms)
            }
            None => bytes.to_vec(),
        };
        self.gripper.receive(self.port, now, &bytes);
        self.gripper.advance(now);
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
            let frame = frame.to_vec();
            let frames = match &mut self.tampering {
                Some(tampering) => tampering(frame),
                None => vec![frame],
            };
            for frame in frames {
                if !self.is_cut {
                    self.trace.add(Entry::FromGripper(frame.clone()));
                }
                self.send(&frame);
            }
        }
        self.send(&[]);
        self.note_travel();
    }

    /// Sends bytes to the bridge, and what is late and arrives now.
    fn send(&mut self, bytes: &[u8]) {
        let now_ms = millis(self.now());
        let arrived = match &mut self.ways {
            Some((_, way)) => {
                way.pass(now_ms, bytes);
                &way.arrive(now_ms)
            }
            None => bytes,
        };
        if !self.is_cut && !arrived.is_empty() {
            // A board that was switched off reads nothing: the reading side notices and ends.
            let _ = self.line.write_all(arrived);
        }
    }

    fn note_frames(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        loop {
            let (taken, event) = self.seen.push_slice(rest);
            let entry = event.map(|event| match event {
                Event::Frame(frame) => {
                    Entry::ToGripper(wsg_protocol::FrameEncoder::new(frame.id, frame.payload).collect())
                }
                broken => Entry::Note(format!("the bridge sent a broken frame: {broken:?}")),
            });
            rest = rest.get(taken..).unwrap_or(&[]);
            match entry {
                Some(entry) => self.trace.add(entry),
                None => return,
            }
        }
    }

    fn note_travel(&mut self) {
        let state = self.gripper.state();
        let travelled = (state.width - self.traced_width).abs();
        let stands = state.speed == 0.0;
        // At the first look the last width is not a number, and neither is the travel.
        if travelled.is_nan() || travelled >= TRACED_TRAVEL || (stands && travelled > 0.005) {
            self.traced_width = state.width;
            self.trace.add(Entry::Fingers(state.width));
        }
    }
}

/// Of a clock of 32 bits that starts again from 0.
fn millis(time: Time) -> u32 {
    (time.as_micros() / 1_000) as u32
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
