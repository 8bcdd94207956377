//! Ten thousand commands through the blocking driver, over a faulty line to a virtual gripper, in virtual time.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use host_tests::faulty_link::{FaultyWay, Rates};
use wsg_protocol::driver::blocking::{Gripper, Transport};
use wsg_protocol::driver::{Cause, Clock, Error, Grip, Mm, MmPerS, OnBlock};
use wsg_protocol::{CommandId, Event, FrameParser, GripperState, HomingDirection, Instant, Kind};
use wsg_sim::{Config, MAX_FRAME_LEN, Part, PortId, PortKind, State, Time, VirtualGripper};

const COMMANDS: u32 = 10_000;

const PART_MM: f32 = 20.0;

/// A virtual gripper, a faulty line to it, and the virtual time.
struct FaultyGripper {
    gripper: VirtualGripper<1>,
    port: PortId,
    now_ms: u32,
    outgoing: FaultyWay,
    incoming: FaultyWay,
    answers: VecDeque<u8>,
    /// Parses what the driver sends, before the line damages it.
    sent: FrameParser<64>,
    motions: u32,
}

impl FaultyGripper {
    fn new(rates: Rates) -> Self {
        let config = Config { part: Part::of_width(PART_MM), time_scale: 10.0, ..Config::default() };
        let mut gripper = VirtualGripper::with_ports(config);
        let port = gripper.connect(PortKind::Serial).unwrap();
        let [outgoing, incoming] = [1, 2].map(|seed| FaultyWay::new(rates, seed));
        let (answers, sent) = (VecDeque::new(), FrameParser::new());
        Self { gripper, port, now_ms: 0, outgoing, incoming, answers, sent, motions: 0 }
    }

    /// Advances the gripper to the current time, with these bytes from the driver.
    fn turn(&mut self, bytes: &[u8]) {
        let now = Time::from_millis(self.now_ms.into());
        self.outgoing.pass(self.now_ms, bytes);
        let arrived = self.outgoing.arrive(self.now_ms);
        self.gripper.receive(self.port, now, &arrived);
        self.gripper.advance(now);
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
            self.incoming.pass(self.now_ms, frame);
        }
        self.answers.extend(self.incoming.arrive(self.now_ms));
    }

    fn state(&self) -> State {
        self.gripper.state()
    }
}

/// The driver's end of the line. A millisecond passes when no bytes can be read, so `wait` need not block.
#[derive(Clone)]
struct End(Rc<RefCell<FaultyGripper>>);

impl Transport for End {}

impl ErrorType for End {
    type Error = Infallible;
}

impl ReadReady for End {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        let mut far = self.0.borrow_mut();
        let is_ready = !far.answers.is_empty();
        if !is_ready {
            far.now_ms += 1;
            far.turn(&[]);
        }
        // New bytes are reported at the next call. Otherwise time would not pass while bytes are available.
        Ok(is_ready)
    }
}

impl Read for End {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let mut far = self.0.borrow_mut();
        let count = buffer.len().min(far.answers.len());
        for (slot, byte) in buffer.iter_mut().zip(far.answers.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }
}

impl Write for End {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let mut far = self.0.borrow_mut();
        for byte in bytes {
            match far.sent.push(*byte) {
                Some(Event::Frame(frame)) if CommandId::from_code(frame.id).kind() == Kind::Motion => {
                    far.motions += 1;
                }
                Some(Event::Frame(_)) | None => {}
                Some(broken) => panic!("the driver sends {broken:?}"),
            }
        }
        far.turn(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

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
    let far = Rc::new(RefCell::new(FaultyGripper::new(Rates::of_bytes(byte_errors))));
    let clock = Rc::clone(&far);
    let mut gripper = Gripper::new(End(Rc::clone(&far)), move || Instant::from_millis(clock.borrow().now_ms));
    recover(&mut gripper, &far);
    while gripper.home(HomingDirection::Default).is_err() {
        recover(&mut gripper, &far);
    }

    let (mut done, mut refused, mut not_known) = (0, 0, 0);
    let mut rest = far.borrow().state().width;
    for number in 0..COMMANDS {
        let job = (number % 3) as usize;
        let (sent, before) = (far.borrow().motions, far.borrow().state());
        assert!((before.width - rest).abs() < 0.02, "command {number}: the fingers moved before the command");

        let result = match job {
            0 => gripper.move_to(Mm(60.0), MmPerS(400.0), OnBlock::Stop),
            1 => gripper
                .grip(Mm(PART_MM), MmPerS(200.0))
                .map(|grip| assert_eq!(grip, Grip::Held, "command {number}")),
            _ => gripper.release(Mm(40.0), MmPerS(400.0)),
        };

        let left = far.borrow().motions - sent;
        assert!(left <= 1, "command {number} left {left} times");
        match result {
            Ok(()) => {
                let state = far.borrow().state();
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
        recover(&mut gripper, &far);
        rest = far.borrow().state().width;
    }

    let FaultyGripper { outgoing, incoming, .. } = &*far.borrow();
    let faults = outgoing.counts().faults() + incoming.counts().faults();
    println!("{done} done, {refused} refused or failed, {not_known} with unknown outcome; {faults} faults");
    assert_eq!(done + refused + not_known, COMMANDS);
    assert!(faults >= 50 && not_known > 0, "the line must cause faults and unknown outcomes");
    done
}

/// Waits for a connection and standstill, as a careful program does after each command.
fn recover<C: Clock>(gripper: &mut Gripper<End, C>, far: &RefCell<FaultyGripper>) {
    for _ in 0..200 {
        if gripper.is_connected() && gripper.motion().is_none() && far.borrow().state().speed == 0.0 {
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
