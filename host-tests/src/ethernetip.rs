//! An EtherNet/IP scanner: the owner of an adapter, which exchanges images in cycles, and the promises that it judges.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::mem;
use std::net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket};
use std::process::id;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use wsg_fieldbus::{CommandFlags as Flag, GripperFlags, InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};
use wsg_sim::State;

/// Time limit of every wait of [`judge`].
const BOUND: Duration = Duration::from_secs(60);
/// The connection ends after 128 intervals without a packet.
const TIMES: Times = Times { interval: Duration::from_millis(20), multiplier: 5 };
/// Class, configuration, outputs and inputs of the gripper.
const PATH: [u8; 8] = [0x20, 4, 0x24, 151, 0x2C, 150, 0x2C, 100];
/// Connection manager.
const MANAGER: [u8; 4] = [0x20, 6, 0x24, 1];

const REGISTER_SESSION: u8 = 0x65;
const SEND_RR_DATA: u8 = 0x6F;

/// Returns an address of this computer that no other test uses, because cyclic data has a fixed port. Linux only.
#[must_use]
pub fn own_address() -> Ipv4Addr {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let number = u32::from(NEXT.fetch_add(1, Ordering::Relaxed) & 0x3F);
    Ipv4Addr::from_bits(0x7F40_0000 | (id() & 0xFFFF) << 6 | number)
}

/// What a scanner sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Outputs that count.
    Run,
    /// Outputs that do not count.
    Idle,
    /// Nothing.
    Silent,
}

/// Times of a connection.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// The interval of packets in both directions.
    pub interval: Duration,
    /// The connection ends after 4 intervals without a packet with 0, 8 with 1, and so on.
    pub multiplier: u8,
}

/// Counts of received packets.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reception {
    /// The packets of the adapter.
    pub packets: u32,
    /// The connections that ended without the scanner, by a time-out of either end.
    pub time_outs: u32,
    /// The longest time between two packets of a connection, without time-outs.
    pub longest_gap: Duration,
}

/// A scanner. It opens its connection again whenever the connection has ended. Dropping it closes the connection.
#[derive(Debug)]
pub struct Scanner(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    address: Ipv4Addr,
    times: Times,
    state: Mutex<Cycle>,
    changed: Condvar,
}

#[derive(Debug)]
struct Cycle {
    outputs: OutputImage,
    mode: Mode,
    /// The packets since the last change of outputs or mode.
    sent: u32,
    received: u32,
    reception: Reception,
    inputs: Option<InputImage>,
    /// The extended status of the last refusal.
    refusal: Option<u16>,
    is_over: bool,
}

impl Scanner {
    /// Name of the threads.
    pub const THREAD: &str = "scanner";

    /// Starts a scanner with these first outputs.
    #[must_use]
    pub fn start(address: Ipv4Addr, outputs: OutputImage) -> Self {
        Self::with(address, outputs, TIMES)
    }

    /// Starts a scanner like [`start`](Self::start), with other times.
    ///
    /// # Panics
    /// Panics when the system starts no thread.
    #[must_use]
    pub fn with(address: Ipv4Addr, outputs: OutputImage, times: Times) -> Self {
        let state = Cycle {
            outputs,
            mode: Mode::Run,
            sent: 0,
            received: 0,
            reception: Reception::default(),
            inputs: None,
            refusal: None,
            is_over: false,
        };
        let shared = Arc::new(Shared { address, times, state: Mutex::new(state), changed: Condvar::new() });
        let cycle = Arc::clone(&shared);
        let run = move || {
            while !cycle.lock().is_over {
                // An error means that the adapter does not listen, or has ended the connection.
                if cycle.lock().mode == Mode::Silent || cycle.connect().is_err() {
                    thread::sleep(times.interval);
                }
            }
        };
        thread::Builder::new().name(Self::THREAD.to_owned()).spawn(run).expect("a thread");
        Self(shared)
    }

    /// Writes outputs. Returns whether the adapter has received them and sent later inputs, within this time.
    pub fn write(&self, outputs: OutputImage, at_most: Duration) -> bool {
        self.change(|state| state.outputs = outputs);
        self.wait(at_most, |state| state.sent > 0 && state.received > 1)
    }

    /// Changes the mode.
    pub fn set_mode(&self, mode: Mode) {
        self.change(|state| state.mode = mode);
    }

    /// Returns inputs that arrive after the call, within this time.
    #[must_use]
    pub fn read(&self, at_most: Duration) -> Option<InputImage> {
        self.0.lock().inputs = None;
        self.wait(at_most, |state| state.inputs.is_some());
        self.0.lock().inputs
    }

    /// Returns the counts since the last call.
    #[must_use]
    pub fn take_reception(&self) -> Reception {
        mem::take(&mut self.0.lock().reception)
    }

    /// Returns the extended status of a refusal, within this time.
    #[must_use]
    pub fn refusal(&self, at_most: Duration) -> Option<u16> {
        self.wait(at_most, |state| state.refusal.is_some());
        self.0.lock().refusal
    }

    fn change(&self, change: impl FnOnce(&mut Cycle)) {
        let mut state = self.0.lock();
        change(&mut state);
        (state.sent, state.received) = (0, 0);
    }

    fn wait(&self, at_most: Duration, holds: impl Fn(&Cycle) -> bool) -> bool {
        let state = self.0.lock();
        let waited = self.0.changed.wait_timeout_while(state, at_most, |state| !holds(state));
        !waited.unwrap_or_else(PoisonError::into_inner).1.timed_out()
    }
}

impl Drop for Scanner {
    fn drop(&mut self) {
        self.0.lock().is_over = true;
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Cycle> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens a connection, and exchanges packets until it ends.
    fn connect(&self) -> io::Result<()> {
        static SERIAL: AtomicU16 = AtomicU16::new(0);
        if discards(self.address).contains(&true) {
            return Err(ErrorKind::NotConnected.into());
        }
        let mut session = Session::open(self.address)?;
        let udp = UdpSocket::bind((session.stream.local_addr()?.ip(), 0))?;
        let serial = SERIAL.fetch_add(1, Ordering::Relaxed).to_le_bytes();
        // Serial number of the connection, vendor and serial number of the scanner.
        let triad = [&serial[..], &[0x34, 0x12], &id().to_le_bytes()].concat();
        let own_id = [serial[0], serial[1], 7, 7];
        let open = forward_open(own_id, &triad, [[14, 0x48]; 2], self.times, 150);
        let port = udp.local_addr()?.port().to_be_bytes();
        let target = [&[1, 0x80, 16, 0, 0, 2][..], &port, &[0; 12]].concat();
        let answer = session.ask(&open, &target)?;
        let [0xD4, 0, status, _, id @ ..] = &answer[..] else { return Err(ErrorKind::InvalidData.into()) };
        if *status != 0 {
            self.lock().refusal = id.first_chunk().copied().map(u16::from_le_bytes);
            self.changed.notify_all();
            return Err(ErrorKind::ConnectionRefused.into());
        }
        self.exchange(&udp, &id[..4], own_id).inspect_err(|_| self.lock().reception.time_outs += 1)?;
        session.ask(&[&[0x4E, 2][..], &MANAGER, &[0x0A, 0xF0], &triad, &[4, 0], &PATH].concat(), &[])?;
        Ok(())
    }

    /// Exchanges packets until the scanner ends.
    fn exchange(&self, udp: &UdpSocket, id: &[u8], own_id: [u8; 4]) -> io::Result<()> {
        let (mut received_at, mut next, mut sequence) = (Instant::now(), Instant::now(), 0_u32);
        let adapter = SocketAddr::from((self.address, 2_222));
        loop {
            let now = Instant::now();
            // After a pause, the scanner receives before it sends again.
            next = if next + self.times.interval > now { next } else { now } + self.times.interval;
            let [discards_outputs, discards_inputs] = discards(self.address);
            let mut state = self.lock();
            if state.is_over {
                return Ok(());
            }
            if state.mode != Mode::Silent && !discards_outputs {
                sequence += 1;
                let [a, b, c, d] = sequence.to_le_bytes();
                let head = [&[2, 0, 2, 0x80, 8, 0][..], id, &[a, b, c, d, 0xB1, 0, 14, 0, a, b]].concat();
                let mode = [u8::from(state.mode == Mode::Run), 0, 0, 0];
                let packet = [&head[..], &mode, &state.outputs.to_bytes()].concat();
                uninterrupted::send_to(udp, &packet, adapter)?;
                state.sent += 1;
            }
            drop(state);
            while let Some(time) = next.checked_duration_since(Instant::now()).filter(|it| !it.is_zero()) {
                udp.set_read_timeout(Some(time))?;
                let mut packet = [0; 64];
                let Ok((32, from)) = uninterrupted::recv_from(udp, &mut packet) else { continue };
                if from == adapter && packet[6..10] == own_id && !discards_inputs {
                    let mut state = self.lock();
                    state.reception.packets += 1;
                    state.reception.longest_gap = state.reception.longest_gap.max(received_at.elapsed());
                    received_at = Instant::now();
                    state.inputs = packet[20..].first_chunk().map(|bytes| InputImage::from_bytes(*bytes));
                    state.received += u32::from(state.sent > 0);
                    self.changed.notify_all();
                }
            }
            if received_at.elapsed() > self.times.interval * (4 << self.times.multiplier) {
                return Err(ErrorKind::TimedOut.into());
            }
        }
    }
}

/// The directions in which packets are lost: to the adapter, and from it.
static DISCARDED: Mutex<BTreeMap<Ipv4Addr, [bool; 2]>> = Mutex::new(BTreeMap::new());

fn discards(address: Ipv4Addr) -> [bool; 2] {
    let discarded = DISCARDED.lock().unwrap_or_else(PoisonError::into_inner);
    discarded.get(&address).copied().unwrap_or_default()
}

/// Loses all packets to an adapter (0) or from it (1), or carries them again.
///
/// # Panics
/// Panics with another direction.
pub fn discard(address: Ipv4Addr, direction: usize, discards: bool) {
    let mut discarded = DISCARDED.lock().unwrap_or_else(PoisonError::into_inner);
    discarded.entry(address).or_default()[direction] = discards;
}

/// Returns a Forward_Open: identifier of the inputs, the connection, size and kind of both directions, its times, and the
/// connection point of the outputs.
fn forward_open(
    own_id: [u8; 4],
    triad: &[u8],
    [outputs, inputs]: [[u8; 2]; 2],
    Times { interval, multiplier }: Times,
    point: u8,
) -> Vec<u8> {
    let interval = (interval.as_micros() as u32).to_le_bytes();
    let open = [&[0x54, 2][..], &MANAGER, &[0x0A, 0xF0, 0, 0, 0, 0], &own_id, triad].concat();
    let open =
        [&open[..], &[multiplier, 0, 0, 0], &interval, &outputs, &interval, &inputs, &[1, 4], &PATH[..5]]
            .concat();
    [&open[..], &[point], &PATH[6..]].concat()
}

/// A session for explicit messages.
#[derive(Debug)]
struct Session {
    stream: TcpStream,
    handle: [u8; 4],
}

impl Session {
    fn open(address: Ipv4Addr) -> io::Result<Self> {
        let stream = TcpStream::connect((address, 44_818))?;
        stream.set_read_timeout(Some(BOUND))?;
        let mut session = Self { stream, handle: [0; 4] };
        session.command(REGISTER_SESSION, &[1, 0, 0, 0])?;
        Ok(session)
    }

    /// Returns the answer to a message, sent with further items.
    fn ask(&mut self, message: &[u8], items: &[u8]) -> io::Result<Vec<u8>> {
        let (len, count) = (message.len() as u8, 2 + u8::from(!items.is_empty()));
        let head = [0, 0, 0, 0, 0, 0, count, 0, 0, 0, 0, 0, 0xB2, 0, len, 0];
        let answer = self.command(SEND_RR_DATA, &[&head[..], message, items].concat())?;
        let len = answer.get(14).copied().map_or(0, usize::from);
        answer.get(16..16 + len).map(<[u8]>::to_vec).ok_or_else(|| ErrorKind::InvalidData.into())
    }

    fn command(&mut self, command: u8, data: &[u8]) -> io::Result<Vec<u8>> {
        let head = [&[command, 0, data.len() as u8, 0][..], &self.handle, &[0; 16]].concat();
        self.stream.write_all(&[&head[..], data].concat())?;
        let mut head = [0; 24];
        self.stream.read_exact(&mut head)?;
        let mut data = vec![0; usize::from(u16::from_le_bytes([head[2], head[3]]))];
        self.stream.read_exact(&mut data)?;
        self.handle.copy_from_slice(&head[4..8]);
        Ok(data)
    }
}

/// Sends a request to an attribute, without a connection. Returns the data of the answer.
///
/// # Errors
/// Returns the general status of a refusal.
///
/// # Panics
/// Panics without an answer.
pub fn explicit(address: Ipv4Addr, service: u8, path: [u8; 3], data: &[u8]) -> Result<Vec<u8>, u8> {
    let [class, instance, attribute] = path;
    let path = [0x20, class, 0x24, instance, 0x30, attribute];
    let mut session = Session::open(address).expect("the adapter listens");
    let answer = session.ask(&[&[service, 3][..], &path, data].concat(), &[]).expect("the adapter answers");
    let [_, _, status, _, data @ ..] = &answer[..] else { panic!("{answer:?}") };
    if *status == 0 { Ok(data.to_vec()) } else { Err(*status) }
}

/// Target of the motions that an event must stop, in 0.01 mm.
const TARGET: i16 = 100_00;

const GET: u8 = 0x0E;
const SET: u8 = 0x10;

/// Returns outputs with a target of 100 mm, the lowest speed, and 40 N.
fn outputs(flags: Flag) -> OutputImage {
    OutputImage { flags, user: 0, width: TARGET, speed: 5_00, force_limit: 40_00 }
}

/// Waits until a condition holds.
///
/// # Panics
/// Panics after 60 s.
#[track_caller]
pub fn until(what: &str, holds: impl Fn() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < BOUND, "time-out: {what}");
        thread::sleep(Duration::from_millis(5));
    }
}

/// Judges the inputs that an adapter with an owner sends to a group: once for all that only watch.
fn judge_multicast(address: Ipv4Addr, inputs: &InputImage) {
    let open = |serial: u8, times: Times, point: u8| {
        let triad = [&[serial, 0, 0x35, 0x12][..], &id().to_le_bytes()].concat();
        let open = forward_open([7; 4], &triad, [[2, 0x48], [14, 0x28]], times, point);
        Session::open(address).and_then(|mut it| it.ask(&open, &[])).expect("the adapter answers")
    };
    let config = explicit(address, GET, [0xF5, 1, 9], &[]).expect("the group is readable");
    let [0, 0, 1, 0, d, c, b, a] = config[..] else { panic!("{config:?}") };
    let group = Ipv4Addr::new(a, b, c, d);
    // A test of another process may have the same group.
    let udp = OnceCell::new();
    until("the group's port is free", || {
        UdpSocket::bind((group, 2_222)).is_ok_and(|socket| udp.set(socket).is_ok())
    });
    let udp = udp.into_inner().expect("a socket");
    udp.join_multicast_v4(&group, &address).expect("the group is on the adapter's interface");
    udp.set_read_timeout(Some(BOUND)).expect("a time-out");
    let [input_only, listen_only] = [152, 153].map(|point| open(point, TIMES, point));
    assert_eq!(input_only[..4], [0xD4, 0, 0, 0], "{input_only:?}");
    assert_eq!(input_only[8..12], listen_only[8..12], "a second production");
    assert_eq!(
        open(1, Times { interval: 2 * TIMES.interval, ..TIMES }, 152)[..6],
        [0xD4, 0, 1, 1, 0x12, 0x01],
        "another interval"
    );
    let mut packets = (0..).map_while(|_| {
        let mut packet = [0; 64];
        let (len, from) = uninterrupted::recv_from(&udp, &mut packet).ok()?;
        Some((from, packet[..len].to_vec()))
    });
    let mut last = None;
    for _ in 0..10 {
        let is_of_adapter = |(from, packet): &(SocketAddr, Vec<u8>)| {
            *from == SocketAddr::from((address, 2_222)) && packet[6..10] == input_only[8..12]
        };
        let (_, packet) = packets.find(is_of_adapter).expect("inputs arrive");
        assert_eq!(packet[20..], inputs.to_bytes());
        let sequence = packet[10..14].first_chunk().copied().map(u32::from_le_bytes).expect("four bytes");
        assert!(last.replace(sequence).is_none_or(|last| sequence == last + 1), "{last:?} {sequence}");
    }
}

/// Judges the adapter of a virtual gripper in the given state, which has a part of 20 mm, stops after a lost bus, and is not homed.
///
/// # Panics
/// Panics when the adapter breaks a promise.
pub fn judge(address: Ipv4Addr, state: &dyn Fn() -> State) {
    let has = |flags| state().flags.intersects(flags);
    let is_moving = || has(SystemFlags::MOVING);
    let scanner = Scanner::start(address, outputs(Flag::HOMING));
    let write = |flags| assert!(scanner.write(outputs(flags), BOUND), "{flags:?} arrives");
    let read = || scanner.read(BOUND).expect("inputs arrive");
    let starts_nothing = |what: &str| {
        for _ in 0..10 {
            let inputs = read();
            assert!(inputs.status != Status::CmdPending && !is_moving(), "{what}: {inputs:?}");
        }
    };
    let command = |image: OutputImage| {
        write(Flag::empty());
        assert!(scanner.write(image, BOUND), "{image:?} arrives");
        until("the command ends", || read().status != Status::CmdPending);
        let inputs = read();
        (inputs.state, inputs.status)
    };
    let start_moving = || {
        write(Flag::empty());
        write(Flag::MOVE);
        until("the fingers move", is_moving);
    };

    let stops = |what: &str| {
        until(what, || !is_moving());
        assert!(state().width < f32::from(TARGET) / 100.0 - 1.0, "{what}: the motion has reached its target");
    };

    until("the gripper is connected", || read().status != Status::IoError);
    starts_nothing("the first image");
    assert!(!has(SystemFlags::REFERENCED));
    judge_multicast(address, &read());
    assert_eq!(command(outputs(Flag::HOMING)), (GripperFlags::IDLE, Status::Success));
    let grip = OutputImage { width: 20_00, speed: 400_00, ..outputs(Flag::GRIP) };
    assert_eq!(command(grip), (GripperFlags::HOLDING, Status::Success));
    assert_eq!(command(OutputImage { speed: 400_00, ..outputs(Flag::RELEASE) }).1, Status::Success);
    let close = OutputImage { width: 30_00, speed: 400_00, ..outputs(Flag::MOVE) };
    assert_eq!(command(close), (GripperFlags::IDLE, Status::Success));

    // Registers and assemblies are read; nothing is written. A scanner without a connection has the inputs, too.
    let width = explicit(address, GET, [0x64, 4, 3], &[]).expect("the width is readable");
    assert_eq!(width, read().width.to_le_bytes());
    assert_eq!(explicit(address, GET, [0x64, 3, 3], &[]), Ok(vec![0xA0, 0x0F]), "the force limit");
    assert_eq!(explicit(address, GET, [4, 100, 3], &[]), Ok(read().to_bytes().to_vec()));
    assert_eq!(explicit(address, GET, [4, 150, 3], &[]), Ok(close.to_bytes().to_vec()));
    for (service, path, status) in [
        (GET, [0x64, 5, 0], 0x16),
        (GET, [0x64, 4, 99], 0x14),
        (SET, [0x64, 3, 0], 0x0E),
        (SET, [4, 150, 3], 0x0E),
    ] {
        assert_eq!(explicit(address, service, path, &[0; 2]), Err(status), "{service:X} {path:?}");
    }

    start_moving();
    let other = Scanner::start(address, outputs(Flag::FASTSTOP));
    assert_eq!(other.refusal(BOUND), Some(0x0106), "a second owner");
    drop(other);
    assert!(is_moving(), "a second owner stops nothing");
    scanner.set_mode(Mode::Idle);
    stops("idle stops the fingers");
    assert!(!has(SystemFlags::FAST_STOP));
    assert_eq!(explicit(address, GET, [4, 150, 3], &[]), Ok(vec![0; 8]));
    scanner.set_mode(Mode::Run);
    starts_nothing("run after idle");

    start_moving();
    write(Flag::MOVE | Flag::FASTSTOP);
    until("FASTSTOP acts", || has(SystemFlags::FAST_STOP));
    stops("FASTSTOP stops the fingers");
    write(Flag::empty());
    until("the stop is acknowledged", || {
        write(Flag::STOP_ACK);
        write(Flag::empty());
        !has(SystemFlags::FAST_STOP)
    });

    start_moving();
    scanner.set_mode(Mode::Silent);
    stops("the time-out stops the fingers");
    assert!(!has(SystemFlags::FAST_STOP));
    scanner.set_mode(Mode::Run);
    starts_nothing("the owner's return");
    start_moving();
    drop(scanner);
    stops("the end of the connection stops the fingers");
    assert!(!has(SystemFlags::FAST_STOP));
}
