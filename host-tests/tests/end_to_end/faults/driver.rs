//! Ten thousand commands through the blocking driver, over a faulty line to a virtual gripper, in virtual time.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use host_tests::faulty_link::{FaultyLink, FaultyWay, Rates};
use wsg_protocol::driver::blocking::{Gripper, Transport};
use wsg_protocol::driver::{Cause, Clock, Error, Grip, Mm, MmPerS, OnBlock};
use wsg_protocol::{CommandId, Event, FrameParser, GripperState, HomingDirection, Instant, Kind};
use wsg_sim::{Config, MAX_FRAME_LEN, Part, PortId, PortKind, State, Time, VirtualGripper};

const COMMANDS: u32 = 10_000;

const PART_MM: f32 = 20.0;

/// A virtual gripper and the virtual time.
struct World {
    gripper: VirtualGripper<1>,
    port: PortId,
    now_ms: u32,
    answers: VecDeque<u8>,
}

impl World {
    fn now(&self) -> Time {
        Time::from_millis(self.now_ms.into())
    }

    fn collect(&mut self) {
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
            self.answers.extend(frame);
        }
    }

    fn state(&self) -> State {
        self.gripper.state()
    }
}

/// The gripper's end of the line. A millisecond passes when no bytes can be read.
#[derive(Clone)]
struct End(Rc<RefCell<World>>);

impl ErrorType for End {
    type Error = Infallible;
}

impl ReadReady for End {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        let mut world = self.0.borrow_mut();
        if world.answers.is_empty() {
            world.now_ms += 1;
            let now = world.now();
            world.gripper.advance(now);
            world.collect();
        }
        // These bytes are reported at the next call. Otherwise time would not pass while bytes are available.
        Ok(!world.answers.is_empty())
    }
}

impl Read for End {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let mut world = self.0.borrow_mut();
        let count = buffer.len().min(world.answers.len());
        for (slot, byte) in buffer.iter_mut().zip(world.answers.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }
}

impl Write for End {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let mut world = self.0.borrow_mut();
        let (port, now) = (world.port, world.now());
        world.gripper.receive(port, now, bytes);
        world.collect();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Counts the motions that the driver sends, before the line damages them.
struct Tap<L> {
    link: L,
    sent: FrameParser<64>,
    motions: Rc<Cell<u32>>,
}

impl<L: ErrorType> ErrorType for Tap<L> {
    type Error = L::Error;
}

impl<L: ReadReady> ReadReady for Tap<L> {
    fn read_ready(&mut self) -> Result<bool, L::Error> {
        self.link.read_ready()
    }
}

impl<L: Read> Read for Tap<L> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, L::Error> {
        self.link.read(buffer)
    }
}

impl<L: Write> Write for Tap<L> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, L::Error> {
        let taken = self.link.write(bytes)?;
        for byte in &bytes[..taken] {
            match self.sent.push(*byte) {
                Some(Event::Frame(frame)) if CommandId::from_code(frame.id).kind() == Kind::Motion => {
                    self.motions.set(self.motions.get() + 1);
                }
                Some(Event::Frame(_)) | None => {}
                Some(broken) => panic!("the driver sends {broken:?}"),
            }
        }
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), L::Error> {
        self.link.flush()
    }
}

/// Time passes with each call of `read_ready`, so `wait` need not block.
impl<L: Read + ReadReady + Write> Transport for Tap<L> {}

/// Conditions on the gripper after each of the program's repeating commands.
const JOBS: [fn(&State) -> bool; 3] = [
    |state| (state.width - 60.0).abs() < 0.1,
    |state| state.gripper == GripperState::Holding,
    |state| (state.width - 40.0).abs() < 0.1,
];

#[test]
fn ten_thousand_commands_with_one_byte_wrong_in_ten_thousand() {
    let done = soak(1e-4);
    assert!(done > COMMANDS * 98 / 100, "{done}");
}

#[test]
fn ten_thousand_commands_with_one_byte_wrong_in_two_hundred() {
    let done = soak(5e-3);
    assert!(done > COMMANDS / 4, "{done}");
}

/// Issues the commands over a line with this rate of damaged bytes. Returns the number reported as done.
fn soak(byte_errors: f64) -> u32 {
    let config = Config { part: Part::of_width(PART_MM), time_scale: 10.0, ..Config::default() };
    let mut gripper = VirtualGripper::with_ports(config);
    let port = gripper.connect(PortKind::Serial).unwrap();
    let end = End(Rc::new(RefCell::new(World { gripper, port, now_ms: 0, answers: VecDeque::new() })));
    let world = Rc::clone(&end.0);
    let clock = || {
        let world = Rc::clone(&world);
        move || world.borrow().now_ms
    };
    let rates = Rates::of_bytes(byte_errors);
    let link = FaultyLink::new(end, clock(), FaultyWay::new(rates, 1), FaultyWay::new(rates, 2));
    let motions = Rc::new(Cell::new(0));
    let tap = Tap { link, sent: FrameParser::new(), motions: Rc::clone(&motions) };
    let now_ms = clock();
    let mut gripper = Gripper::new(tap, move || Instant::from_millis(now_ms()));
    recover(&mut gripper, &world);
    while gripper.home(HomingDirection::Default).is_err() {
        recover(&mut gripper, &world);
    }

    let (mut done, mut refused, mut not_known) = (0, 0, 0);
    let mut rest = world.borrow().state().width;
    for number in 0..COMMANDS {
        let job = (number % 3) as usize;
        let (sent, before) = (motions.get(), world.borrow().state());
        assert!((before.width - rest).abs() < 0.02, "command {number}: the fingers moved before the command");

        let result = match job {
            0 => gripper.move_to(Mm(60.0), MmPerS(400.0), OnBlock::Stop),
            1 => gripper
                .grip(Mm(PART_MM), MmPerS(200.0))
                .map(|grip| assert_eq!(grip, Grip::Held, "command {number}")),
            _ => gripper.release(Mm(40.0), MmPerS(400.0)),
        };

        let left = motions.get() - sent;
        assert!(left <= 1, "command {number} left {left} times");
        match result {
            Ok(()) => {
                let state = world.borrow().state();
                assert!(left == 1 && JOBS[job](&state), "command {number} is reported as done: {state:?}");
                done += 1;
            }
            Err(Error::Unanswered) => not_known += 1,
            Err(error) => {
                assert!(
                    left == 0 || error.cause() != Cause::Caller,
                    "command {number}: {error:?}, but the command was sent"
                );
                refused += 1;
            }
        }
        recover(&mut gripper, &world);
        rest = world.borrow().state().width;
    }

    let faults = faults(gripper);
    println!("{done} done, {refused} refused or failed, {not_known} with unknown outcome; {faults} faults");
    assert_eq!(done + refused + not_known, COMMANDS);
    assert!(faults >= 50 && not_known > 0, "the line must cause faults and unknown outcomes");
    done
}

type Soaked<C, D> = Gripper<Tap<FaultyLink<End, C>>, D>;

fn faults<C: FnMut() -> u32, D: Clock>(gripper: Soaked<C, D>) -> u64 {
    let link = gripper.into_io().link;
    link.outgoing.counts().faults() + link.incoming.counts().faults()
}

/// Waits for a connection and standstill, as a careful program does after each command.
fn recover<C: FnMut() -> u32, D: Clock>(gripper: &mut Soaked<C, D>, world: &RefCell<World>) {
    for _ in 0..200 {
        if gripper.is_connected() && gripper.motion().is_none() && world.borrow().state().speed == 0.0 {
            return;
        }
        if !gripper.is_connected() {
            // On this line, a connection attempt may fail too.
            let _ = gripper.connect();
        }
        let _ = gripper.next_update(20);
    }
    panic!("no connection, or the motion does not end");
}
