//! A virtual gripper on an emulated board's line, on the board's clock. The line can be cut and disturbed.

use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::{Context, Result};
use wsg_protocol::{Event, FrameParser, frame::MAX_MESSAGE_LEN};
use wsg_sim::{Config, MAX_FRAME_LEN, Part, PortId, PortKind, State, Time, VirtualGripper};

use crate::clock::Clock;
use crate::faulty_link::FaultyWay;
use crate::serial_gripper::switch_on;
use crate::socket::Socket;
use crate::trace::{Entry, Trace};

/// Longest interval between two looks at the clock; effects of a part or a fault appear at most this late.
const LOOK_AROUND: Duration = Duration::from_millis(5);

/// Travel of the fingers between two entries of the trace, in mm.
const TRACED_TRAVEL: f32 = 10.0;

/// Modifies frames from the gripper: one frame in, any number out, in order.
pub type Tampering = Box<dyn FnMut(Vec<u8>) -> Vec<Vec<u8>> + Send>;

/// A virtual gripper on one line. Dropping it closes the line.
pub struct GripperEnd {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    connected: Mutex<Connected>,
    over: AtomicBool,
}

struct Connected {
    gripper: VirtualGripper<1>,
    port: PortId,
    line: Socket,
    is_cut: bool,
    tampering: Option<Tampering>,
    /// Fault injection from and to the bridge.
    ways: Option<(FaultyWay, FaultyWay)>,
    /// Parses frames from the bridge, for the trace only.
    seen: FrameParser<MAX_MESSAGE_LEN>,
    traced_width: f32,
    clock: Clock,
    start: Duration,
    trace: Trace,
}

impl GripperEnd {
    /// Powers up a gripper on `line`. `clock` is the clock of the board at the other end.
    ///
    /// # Errors
    /// Fails when the line or a thread cannot be set up.
    pub fn start(line: Socket, clock: Clock, config: Config, trace: &Trace) -> Result<Self> {
        let reader = line.try_clone().context("cannot listen on the gripper's line")?;
        let (gripper, port) = switch_on(config, PortKind::Serial);
        let connected = Connected {
            gripper,
            port,
            line,
            is_cut: false,
            tampering: None,
            ways: None,
            seen: FrameParser::new(),
            traced_width: f32::NAN,
            start: clock.now(),
            clock: clock.clone(),
            trace: trace.clone(),
        };
        let shared = Arc::new(Shared { connected: Mutex::new(connected), over: AtomicBool::new(false) });
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

    /// Returns the gripper's state at this moment.
    #[must_use]
    pub fn state(&self) -> State {
        let mut connected = self.connected();
        connected.turn(&[]);
        connected.gripper.state()
    }

    /// Places a part between the fingers, or removes it.
    pub fn set_part(&self, part: Option<Part>) {
        let mut connected = self.connected();
        let now = connected.now();
        connected.gripper.set_part(part, now);
        connected.turn(&[]);
    }

    /// Cuts or restores both directions of the line.
    pub fn cut(&self, cut: bool) {
        self.connected().is_cut = cut;
    }

    /// Passes every further frame from the gripper to `tampering`; `None` delivers frames unmodified.
    pub fn tamper(&self, tampering: Option<Tampering>) {
        self.connected().tampering = tampering;
    }

    /// Injects faults on the way to and from the gripper, and returns the previous fault injection. `None` delivers
    /// everything. Bytes still in transit are lost.
    pub fn disturb(&self, ways: Option<(FaultyWay, FaultyWay)>) -> Option<(FaultyWay, FaultyWay)> {
        std::mem::replace(&mut self.connected().ways, ways)
    }

    /// Sends bytes to the bridge in the gripper's place.
    pub fn inject(&self, bytes: &[u8]) {
        let mut connected = self.connected();
        connected.trace.add(Entry::FromGripper(bytes.to_vec()));
        connected.send(bytes);
    }

    /// Sends bytes to the gripper in the bridge's place.
    pub fn mislead(&self, bytes: &[u8]) {
        let mut connected = self.connected();
        let now = connected.now();
        let Connected { gripper, port, .. } = &mut *connected;
        gripper.receive(*port, now, bytes);
    }

    fn connected(&self) -> MutexGuard<'_, Connected> {
        lock(&self.shared.connected)
    }
}

impl Drop for GripperEnd {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // After a panic its message has already been printed.
            let _ = thread.join();
        }
    }
}

/// Passes bytes and time to the gripper until either end is closed.
fn serve(shared: &Shared, line: &Socket) {
    while !shared.over.load(Ordering::Relaxed) {
        let wait = lock(&shared.connected).until_next_wake().clamp(Duration::from_micros(100), LOOK_AROUND);
        if !take(shared, line, wait) {
            return;
        }
    }
}

/// Serves the bytes that have arrived. Returns whether to continue.
fn come_up(shared: &Shared, line: &Socket) -> bool {
    match uninterrupted::is_readable_within(line, Duration::ZERO) {
        Ok(true) => take(shared, line, Duration::ZERO),
        Ok(false) => {
            lock(&shared.connected).turn(&[]);
            true
        }
        Err(_) => false,
    }
}

/// Serves bytes that arrive within this time. Returns whether the other end is still open.
fn take(shared: &Shared, line: &Socket, within: Duration) -> bool {
    let mut chunk = [0; 256];
    let bytes = match uninterrupted::read_within(line, &mut chunk, within) {
        Ok(Some(0)) | Err(_) => return false,
        Ok(count) => chunk.get(..count.unwrap_or(0)).unwrap_or(&[]),
    };
    lock(&shared.connected).turn(bytes);
    true
}

impl Connected {
    fn now(&self) -> Time {
        let since = self.clock.now().saturating_sub(self.start);
        Time::from_micros(since.as_micros().try_into().unwrap_or(u64::MAX))
    }

    fn until_next_wake(&self) -> Duration {
        let now = self.now().as_micros();
        let wake = self.gripper.next_wake().map_or(u64::MAX, Time::as_micros);
        Duration::from_micros(wake.saturating_sub(now))
    }

    /// Delivers bytes from the bridge, advances the gripper to now, and sends its output.
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

    /// Sends bytes to the bridge, together with delayed bytes that are now due.
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
            // A board that was switched off reads nothing; the reading side detects this and ends.
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
        // Initially the width is NaN, and so is the travel.
        if travelled.is_nan() || travelled >= TRACED_TRAVEL || (stands && travelled > 0.005) {
            self.traced_width = state.width;
            self.trace.add(Entry::Fingers(state.width));
        }
    }
}

/// Converts to a 32-bit clock that wraps to 0.
fn millis(time: Time) -> u32 {
    (time.as_micros() / 1_000) as u32
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
