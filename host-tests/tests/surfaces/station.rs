//! A virtual gripper, lines to it that a test can hold or cut, and an observer beside the gripper.

use std::io::Write;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use socket2::SockRef;
use wsg_protocol::{CommandId, Event, FrameParser, Kind, SystemFlags, frame::MAX_MESSAGE_LEN};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, State};

/// Time limit of everything that a promise does not limit.
pub(crate) const BOUND: Duration = Duration::from_secs(30);

/// Interval of the observer.
const GLANCE: Duration = Duration::from_millis(1);

/// An interval without the processor that spoils a measurement of 250 ms.
pub(crate) const STALL: Duration = Duration::from_millis(25);

/// A direction of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// To the gripper.
    Requests,
    /// From the gripper.
    Answers,
}

/// A line between a surface and the gripper's server: TCP on both sides, or Ethernet.
pub(crate) struct Line {
    pub(crate) address: SocketAddr,
    shared: Arc<Shared>,
    /// Discards the frames of one direction, or carries them again. Ethernet loses frames where TCP delays bytes.
    discard: Box<dyn Fn(Way, bool)>,
}

#[derive(Default)]
struct Shared {
    state: Mutex<LineState>,
    changed: Condvar,
}

#[derive(Default)]
struct LineState {
    holds_requests: bool,
    holds_answers: bool,
    is_cut: bool,
    open: Vec<TcpStream>,
    /// Requests of a page that have reached the line: messages of its WebSocket (RFC 6455, 5.2), and `POST`.
    posts: usize,
    /// Commands of the binary protocol that have reached the line.
    commands: Vec<CommandId>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, LineState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Line {
    /// A line to a server, at the server's IP address.
    pub(crate) fn to(server: SocketAddr) -> Self {
        let listener = TcpListener::bind((server.ip(), 0)).expect("a free port");
        let address = listener.local_addr().expect("the address of a listener");
        let shared = Arc::<Shared>::default();
        let lines = Arc::clone(&shared);
        thread::spawn(move || {
            for client in listener.incoming() {
                let (Ok(client), Ok(gripper)) = (client, TcpStream::connect(server)) else { return };
                let mut state = lines.lock();
                if state.is_cut {
                    continue;
                }
                for stream in [&client, &gripper] {
                    stream.set_nodelay(true).expect("a TCP option");
                    state.open.push(stream.try_clone().expect("a descriptor"));
                }
                drop(state);
                for (way, from, to) in [(Way::Requests, &client, &gripper), (Way::Answers, &gripper, &client)]
                {
                    let (from, to) =
                        (from.try_clone().expect("a descriptor"), to.try_clone().expect("a descriptor"));
                    let lines = Arc::clone(&lines);
                    thread::spawn(move || carry(&lines, way, from, to));
                }
            }
        });
        Self { address, shared, discard: Box::new(|_, _| ()) }
    }

    /// A line that has no TCP.
    #[cfg_attr(not(target_os = "linux"), expect(dead_code, reason = "such surfaces are for Linux"))]
    pub(crate) fn on_ethernet(address: SocketAddr, discard: impl Fn(Way, bool) + 'static) -> Self {
        Self { address, shared: Arc::default(), discard: Box::new(discard) }
    }

    /// Keeps the bytes of one direction until [`release`](Self::release).
    pub(crate) fn hold(&self, way: Way) {
        self.set(way, true);
    }

    pub(crate) fn release(&self, way: Way) {
        self.set(way, false);
    }

    fn set(&self, way: Way, holds: bool) {
        (self.discard)(way, holds);
        let mut state = self.shared.lock();
        match way {
            Way::Requests => state.holds_requests = holds,
            Way::Answers => state.holds_answers = holds,
        }
        self.shared.changed.notify_all();
    }

    /// Ends all connections, and every new one at once.
    pub(crate) fn cut(&self) {
        let mut state = self.shared.lock();
        state.is_cut = true;
        for stream in state.open.drain(..) {
            // An error means that the stream has ended.
            let _ = stream.shutdown(Shutdown::Both);
        }
        self.shared.changed.notify_all();
        drop(state);
        self.discard_all(true);
    }

    /// Resets all connections: both ends lose the bytes that they have not received.
    #[cfg_attr(not(target_os = "linux"), expect(dead_code, reason = "the test that needs it is for Linux"))]
    pub(crate) fn reset(&self) {
        for stream in self.shared.lock().open.drain(..) {
            // An error means that the stream has ended.
            let _ = SockRef::from(&stream).set_linger(Some(Duration::ZERO));
            let _ = stream.shutdown(Shutdown::Read);
        }
    }

    /// Accepts connections again.
    pub(crate) fn mend(&self) {
        self.discard_all(false);
        self.shared.lock().is_cut = false;
    }

    fn discard_all(&self, discards: bool) {
        for way in [Way::Requests, Way::Answers] {
            (self.discard)(way, discards);
        }
    }

    /// Returns the number of requests of a page that have reached the line since the last call.
    pub(crate) fn take_posts(&self) -> usize {
        std::mem::take(&mut self.shared.lock().posts)
    }

    /// Returns the motions and settings that have reached the line since the last call.
    pub(crate) fn take_effective(&self) -> Vec<CommandId> {
        let commands = std::mem::take(&mut self.shared.lock().commands);
        commands.into_iter().filter(|id| matches!(id.kind(), Kind::Motion | Kind::Setting)).collect()
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.cut();
        // Wakes the listener, whose server is gone.
        let _ = TcpStream::connect(self.address);
    }
}

/// Copies bytes in one direction while it is not held.
fn carry(shared: &Shared, way: Way, mut from: TcpStream, mut to: TcpStream) {
    let mut parser = FrameParser::<MAX_MESSAGE_LEN>::new();
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = uninterrupted::read(&mut from, &mut buffer) {
        let mut state = shared.lock();
        if way == Way::Requests {
            state.posts += usize::from(matches!(buffer[..count], [0x81, ..] | [b'P', b'O', b'S', b'T', ..]));
            note(&mut parser, &buffer[..count], &mut state.commands);
        }
        while !state.is_cut && if way == Way::Requests { state.holds_requests } else { state.holds_answers } {
            state = shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        // The network loses what it has held when its sender resets the connection.
        if state.is_cut || !matches!(from.take_error(), Ok(None)) {
            break;
        }
        drop(state);
        if to.write_all(&buffer[..count]).is_err() {
            break;
        }
    }
    // The other end learns that this one has closed, by a reset when the stream is dropped.
    if !matches!(SockRef::from(&to).linger(), Ok(Some(_))) {
        let _ = to.shutdown(Shutdown::Write);
    }
}

fn note(parser: &mut FrameParser<MAX_MESSAGE_LEN>, bytes: &[u8], commands: &mut Vec<CommandId>) {
    for byte in bytes {
        let mut event = parser.push(*byte);
        while let Some(found) = event {
            if let Event::Frame(frame) = found {
                commands.push(CommandId::from_code(frame.id));
            }
            event = parser.poll();
        }
    }
}

/// Returns the lines of every gripper.
pub(crate) fn lines() -> Lines {
    let any = || "127.0.0.1:0".parse().ok();
    Lines { tcp: any(), modbus: any(), control: any(), ..Lines::default() }
}

/// A gripper with slow fingers, and its lines.
pub(crate) struct Station {
    gripper: Arc<ServerThread>,
    /// The binary protocol.
    pub(crate) tcp: Line,
    pub(crate) control: Line,
    pub(crate) modbus: Line,
    /// Only with a network of its own.
    #[cfg_attr(not(target_os = "linux"), expect(dead_code, reason = "such surfaces are for Linux"))]
    pub(crate) ethernet: Option<Line>,
    trace: Arc<Mutex<Trace>>,
}

/// Observations of the gripper.
#[derive(Default)]
struct Trace {
    /// The times at which the fingers began to travel.
    travels: Vec<Instant>,
    /// The longest time between two glances since the last reset.
    stall: Duration,
    /// The number of glances.
    glances: u64,
    is_over: bool,
}

impl Station {
    pub(crate) fn new() -> Self {
        Self::of(ServerThread::start(Config::default(), &lines(), None).expect("the server starts"), None)
    }

    /// A station whose gripper serves [`lines`], and perhaps a bus without a TCP line.
    pub(crate) fn of(gripper: ServerThread, ethernet: Option<Line>) -> Self {
        let to = |address: Option<SocketAddr>| Line::to(address.expect("it is served"));
        let (tcp, control, modbus) =
            (to(gripper.tcp_address()), to(gripper.control_address()), to(gripper.modbus_address()));
        let (gripper, trace) = (Arc::new(gripper), Arc::<Mutex<Trace>>::default());
        let (seen, noted) = (Arc::clone(&gripper), Arc::clone(&trace));
        thread::spawn(move || observe(&seen, &noted));
        Self { gripper, tcp, control, modbus, ethernet, trace }
    }

    pub(crate) fn state(&self) -> State {
        self.gripper.state()
    }

    /// Returns the time at which the observer saw `wanted`.
    #[track_caller]
    pub(crate) fn until(&self, what: &str, wanted: impl Fn(&State) -> bool) -> Instant {
        let start = Instant::now();
        loop {
            let state = self.state();
            if wanted(&state) {
                return Instant::now();
            }
            assert!(start.elapsed() < BOUND, "the gripper never was {what}: {state:?}");
            thread::sleep(GLANCE);
        }
    }

    /// Waits until the observer has noted every travel that has begun.
    pub(crate) fn catch_up(&self) {
        // The present glance may have begun before.
        let (enough, start) = (self.trace().glances + 2, Instant::now());
        while self.trace().glances < enough {
            assert!(start.elapsed() < BOUND, "the observer has ended");
            thread::sleep(GLANCE);
        }
    }

    /// Returns when the fingers began to travel, each time since `since`.
    pub(crate) fn travels_since(&self, since: Instant) -> Vec<Instant> {
        let trace = self.trace();
        trace.travels.iter().copied().filter(|begin| *begin >= since).collect()
    }

    /// Begins a measurement.
    pub(crate) fn measure(&self) {
        self.trace().stall = Duration::ZERO;
    }

    /// Returns the longest time for which the machine kept the observer from running since [`measure`](Self::measure).
    pub(crate) fn stall(&self) -> Duration {
        self.trace().stall
    }

    fn trace(&self) -> MutexGuard<'_, Trace> {
        self.trace.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Station {
    fn drop(&mut self) {
        self.trace().is_over = true;
    }
}

fn observe(gripper: &ServerThread, trace: &Mutex<Trace>) {
    let (mut width, mut last, mut travelling) = (gripper.state().width, Instant::now(), false);
    loop {
        thread::sleep(GLANCE);
        let (state, now) = (gripper.state(), Instant::now());
        let mut trace = trace.lock().unwrap_or_else(PoisonError::into_inner);
        if trace.is_over {
            return;
        }
        trace.stall = trace.stall.max(now - last);
        let moves = state.width != width || state.flags.contains(SystemFlags::MOVING);
        if moves && !travelling {
            trace.travels.push(now);
        }
        trace.glances += 1;
        (width, last, travelling) = (state.width, now, moves);
    }
}
