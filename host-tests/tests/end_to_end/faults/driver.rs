//! Ten thousand commands through the blocking driver, over a faulty line to a virtual gripper, in virtual time.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write};
use host_tests::faulty_link::{FaultyWay, Rates};
use host_tests::serial_gripper::{SerialGripper, motions};
use wsg_protocol::driver::blocking::{Gripper, Transport};
use wsg_protocol::driver::{Cause, Clock, Error, Grip, Mm, MmPerS, OnBlock};
use wsg_protocol::{GripperState, HomingDirection, Instant};
use wsg_sim::{Config, Part, PortKind, State, Time};

const COMMANDS: u32 = 10_000;

const PART_MM: f32 = 20.0;

/// A virtual gripper at the other end of a faulty line, and the virtual time.
struct FaultyGripper {
    far: SerialGripper<FaultyWay>,
    now_ms: u32,
    motions: usize,
}

impl FaultyGripper {
    fn new(rates: Rates) -> Self {
        let config = Config { part: Part::of_width(PART_MM), time_scale: 10.0, ..Config::default() };
        let ways = [1, 2].map(|seed| FaultyWay::new(rates, seed));
        let far = SerialGripper::over(config, PortKind::Serial, usize::MAX, ways);
        Self { far, now_ms: 0, motions: 0 }
    }

    /// Advances line and gripper to the current time.
    fn turn(&mut self) {
        self.far.advance(Time::from_millis(self.now_ms.into()));
        self.motions += motions(self.far.take_sent()).len();
    }

    fn state(&self) -> State {
        self.far.gripper.state()
    }
}

/// The driver's end of the line. A millisecond passes when no bytes can be read, so `wait` need not block.
#[derive(Clone)]
struct End(Rc<RefCell<FaultyGripper>>);

impl Transport for End {}

impl ErrorType for End {
    type Error = ErrorKind;
}

impl ReadReady for End {
    fn read_ready(&mut self) -> Result<bool, ErrorKind> {
        let mut gripper = self.0.borrow_mut();
        let is_ready = gripper.far.line.read_ready()?;
        if !is_ready {
            gripper.now_ms += 1;
            gripper.turn();
        }
        // New bytes are reported at the next call. Otherwise time would not pass while bytes are available.
        Ok(is_ready)
    }
}

impl Read for End {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        self.0.borrow_mut().far.line.read(buffer)
    }
}

impl Write for End {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        let mut gripper = self.0.borrow_mut();
        let count = gripper.far.line.write(bytes)?;
        gripper.turn();
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), ErrorKind> {
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

    let FaultyGripper { far: SerialGripper { to_gripper, to_bridge, .. }, .. } = &*far.borrow();
    let faults = to_gripper.counts().faults + to_bridge.counts().faults;
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
