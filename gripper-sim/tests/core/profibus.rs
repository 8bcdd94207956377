//! A PROFIBUS master with the virtual gripper, telegram by telegram in virtual time.

use crate::fieldbus::{PARAMETERS, REACTIONS};
use wsg_fieldbus::{CommandFlags as Flag, Diagnosis, GripperFlags as Shown, InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};
use wsg_sim::{Config, Fault, MAX_FRAME_LEN, Part, PortId, PortKind, Time, VirtualGripper};

const STATION: u8 = 7;
const MASTER: u8 = 2;
const SC: [u8; 1] = [0xE5];
const NOTHING: [u8; 0] = [];
/// The watchdog time that the master configures.
const WATCHDOG_MS: u64 = 200;

/// How a master leaves.
type Leave = fn(&mut Master);

/// A master connected to a gripper, with virtual time.
struct Master {
    gripper: VirtualGripper,
    port: PortId,
    image: OutputImage,
    fcb: bool,
    now: Time,
}

fn sum(body: &[u8]) -> u8 {
    body.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

fn sd2(body: &[u8]) -> Vec<u8> {
    let len = body.len() as u8;
    [&[0x68, len, len, 0x68], body, &[sum(body), 0x16]].concat()
}

impl Master {
    /// Powers up the gripper.
    fn new(config: Config) -> Self {
        let mut gripper = VirtualGripper::new(config);
        let port = gripper.connect(PortKind::Profibus).expect("a port is free");
        Self { gripper, port, image: PARAMETERS, fcb: false, now: Time::ZERO }
    }

    /// Starts data exchange; the PLC has written its parameters with all flags 0.
    fn exchanging(config: Config) -> Self {
        let mut master = Self::new(config);
        master.start();
        master.exchange();
        master
    }

    fn homed(part: Option<Part>) -> Self {
        Self::homed_with(Config { part, ..Config::default() })
    }

    fn homed_with(config: Config) -> Self {
        let mut master = Self::exchanging(config);
        master.set(Flag::HOMING);
        master.wait(4_000);
        master.set(Flag::empty());
        assert_eq!(master.shows(), (Shown::IDLE, Status::Success));
        master
    }

    fn start(&mut self) {
        assert_eq!(self.service(61, &[0x88, 1, 20, 11, 0x55, 0x55, 0]), SC);
        assert_eq!(self.service(62, &[0xA7, 0x9B]), SC);
    }

    /// Sends bytes and returns the answer; empty without one.
    fn send(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.gripper.receive(self.port, self.now, bytes);
        let mut buffer = [0; MAX_FRAME_LEN];
        let answer = self.gripper.transmit(self.port, &mut buffer).map(<[u8]>::to_vec);
        assert_eq!(self.gripper.transmit(self.port, &mut buffer), None);
        answer.unwrap_or_default()
    }

    /// Returns the function code of a new request.
    fn next(&mut self) -> u8 {
        self.fcb = !self.fcb;
        if self.fcb { 0x7D } else { 0x5D }
    }

    fn service(&mut self, point: u8, data: &[u8]) -> Vec<u8> {
        let head = [STATION | 0x80, MASTER | 0x80, self.next(), point, 62];
        self.send(&sd2(&[&head[..], data].concat()))
    }

    /// Exchanges data with SD3 and returns the function code of the answer and the inputs.
    fn exchange(&mut self) -> (u8, InputImage) {
        let body = [&[STATION, MASTER, self.next()][..], &self.image.to_bytes()].concat();
        let answer = self.send(&[&[0xA2], &body[..], &[sum(&body), 0x16]].concat());
        assert_eq!(answer[..6], [0x68, 15, 15, 0x68, MASTER, STATION], "{answer:02X?}");
        (answer[6], InputImage::from_bytes(answer[7..19].try_into().unwrap()))
    }

    fn set(&mut self, flags: Flag) {
        self.image.flags = flags;
        self.exchange();
    }

    /// Exchanges the same image again and returns the shown state.
    fn shows(&mut self) -> (Shown, Status) {
        let (_, input) = self.exchange();
        (input.state, input.status)
    }

    /// Exchanges data continuously, as a bus does.
    fn wait(&mut self, millis: u64) {
        let end = self.now.plus_millis(millis);
        while self.now < end {
            self.now = self.now.plus_millis(10);
            self.exchange();
        }
    }

    fn stop_sending(&mut self, millis: u64) {
        self.now = self.now.plus_millis(millis);
        self.gripper.advance(self.now);
    }
}

#[test]
fn master_time_out_ends_a_jog_and_its_return_starts_nothing() {
    let mut master = Master::homed(None);
    master.image.speed = 10_00;
    master.set(Flag::JOG_MINUS);
    master.wait(50);
    assert!(master.gripper.state().speed < 0.0);
    // The expiry of the watchdog wakes the gripper.
    assert!(master.gripper.next_wake().is_some_and(|at| at <= master.now.plus_millis(WATCHDOG_MS + 1)));
    master.stop_sending(WATCHDOG_MS - 5);
    assert!(master.gripper.state().speed < 0.0, "not yet");
    master.stop_sending(10);
    assert_eq!(master.gripper.state().speed, 0.0);

    // The next image is the first one again: a flag set in it is not an edge.
    master.image = PARAMETERS;
    let width = master.gripper.state().width;
    master.start();
    master.set(Flag::GRIP);
    master.wait(500);
    assert_eq!(master.gripper.state().width, width);
    master.set(Flag::empty());
    master.set(Flag::GRIP);
    master.wait(100);
    assert!(master.gripper.state().width < width, "an edge starts the motion");
}

#[test]
fn disconnecting_master_ends_its_motion_as_configured() {
    let stops_sending = |master: &mut Master| master.stop_sending(WATCHDOG_MS + 5);
    let clears = |master: &mut Master| {
        // Global_Control to all stations: Clear_Data.
        let _ = master.send(&sd2(&[0xFF, MASTER | 0x80, 0x46, 58, 62, 0x02, 0]));
    };
    let is_cut = |master: &mut Master| master.gripper.disconnect(master.port, master.now);
    let ways: [(&str, Leave); 3] = [("silent", stops_sending), ("cleared", clears), ("cut", is_cut)];
    for (way, leave) in ways {
        for (bus_reaction, flag, continues, stops_fast) in REACTIONS {
            let mut master = Master::homed_with(Config { bus_reaction, ..Config::default() });
            master.image.speed = 10_00;
            master.set(flag);
            master.wait(50);
            assert!(master.gripper.state().speed < 0.0);
            assert_eq!(master.gripper.fieldbus_images().0.flags, flag);
            leave(&mut master);
            master.gripper.advance(master.now.plus_millis(10));
            let state = master.gripper.state();
            let shown = (state.speed < 0.0, state.flags.contains(SystemFlags::FAST_STOP));
            assert_eq!(shown, (continues, stops_fast), "{way} {bus_reaction:?} {flag:?}");
            assert_eq!(master.gripper.fieldbus_images().0, OutputImage::ZERO, "{way}");
        }
    }
}

#[test]
fn fault_is_announced_and_its_diagnosis_read_once() {
    let mut master = Master::exchanging(Config::default());
    assert_eq!(master.exchange().0, 0x08);
    master.gripper.set_fault(Fault::OverTemperature, true, master.now);
    assert_eq!(master.exchange().0, 0x0A);
    let answer = master.service(60, &[]);
    let system = master.exchange().1.system;
    assert!(system.contains(SystemFlags::TEMP_FAULT));
    let expected = Diagnosis { standard: [0x08, 0x0C, 0x00, MASTER], system }.to_bytes();
    assert_eq!(answer[9..25], expected);
    assert_eq!(master.exchange().0, 0x08);
}

#[test]
fn telegram_in_pieces_is_accepted_unless_incomplete() {
    let mut master = Master::exchanging(Config::default());
    let status = [0x10, STATION, MASTER, 0x49, 0x52, 0x16];
    let answer = [0x10, MASTER, STATION, 0x00, 0x09, 0x16];
    assert_eq!(master.send(&status[..3]), NOTHING);
    assert_eq!(master.send(&status[3..]), answer);
    assert_eq!(master.send(&status[..3]), NOTHING);
    master.now = master.now.plus_millis(10);
    assert_eq!(master.send(&status), answer, "after a pause");
}

#[test]
fn address_is_the_one_that_is_set() {
    let mut master = Master::new(Config { profibus_address: 9, ..Config::default() });
    assert_eq!(master.send(&[0x10, STATION, MASTER, 0x49, 0x52, 0x16]), NOTHING);
    assert_eq!(master.send(&[0x10, 9, MASTER, 0x49, 0x54, 0x16]), [0x10, MASTER, 9, 0x00, 0x0B, 0x16]);
}
