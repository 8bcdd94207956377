//! Client programs on the blocking driver, in virtual time.

use std::convert::Infallible;
use std::thread;
use std::time::Duration;

use wsg_protocol::driver::blocking::{GclGripper, Gripper};
use wsg_protocol::driver::{Error, Grip, Mm, MmPerS, N, OnBlock, StopKind};
use wsg_protocol::{GripperState, HomingDirection, Status, SystemFlags};
use wsg_sim::{Config, Fault, Part, PortKind, Time, VirtualRig};

type Driver = Gripper<VirtualRig, VirtualRig>;

const WITH_PART: fn() -> Config = || Config { part: Part::of_width(20.0), ..Config::default() };

fn homed_on(kind: PortKind, config: Config) -> (VirtualRig, Driver) {
    let rig = VirtualRig::with_port(kind, config);
    let mut gripper = Gripper::new(rig.line(), rig.clock());
    gripper.connect().unwrap();
    gripper.home(HomingDirection::Default).unwrap();
    (rig, gripper)
}

fn homed(config: Config) -> (VirtualRig, Driver) {
    homed_on(PortKind::Serial, config)
}

/// An example of a client program.
fn two_grips() -> Result<(Grip, Grip, Time), Error<Infallible>> {
    let rig = VirtualRig::new(WITH_PART());
    let mut gripper = Gripper::new(rig.line(), rig.clock());
    gripper.connect()?;
    gripper.home(HomingDirection::Default)?;
    let held = gripper.grip(Mm(20.0), MmPerS(100.0))?;
    gripper.release(Mm(60.0), MmPerS(200.0))?;
    rig.set_part(None);
    let no_part = gripper.grip(Mm(20.0), MmPerS(100.0))?;
    Ok((held, no_part, rig.time()))
}

#[test]
fn same_program_takes_the_same_virtual_time_each_time() {
    let first = two_grips().unwrap();
    assert_eq!((first.0, first.1), (Grip::Held, Grip::NoPart));
    assert!(first.2 > Time::from_millis(3_000), "{}", first.2);
    assert_eq!(two_grips(), Ok(first));
}

/// Takes the fastest of many runs and allows ten times the measured duration, so that a busy machine does not fail the test.
#[test]
fn homing_and_two_grips_take_milliseconds_of_real_time_at_most() {
    let fastest = (0..50).map(|_| {
        let start = std::time::Instant::now();
        two_grips().unwrap();
        start.elapsed()
    });
    let fastest = fastest.min().unwrap();
    println!("fastest run: {fastest:?}");
    assert!(fastest < Duration::from_millis(10), "{fastest:?}");
}

#[test]
fn rig_runs_on_another_thread() {
    let (rig, mut gripper) = homed(WITH_PART());
    let grip = thread::spawn(move || gripper.grip(Mm(20.0), MmPerS(100.0)));
    assert_eq!(grip.join().unwrap(), Ok(Grip::Held));
    assert_eq!(rig.state().gripper, GripperState::Holding);
}

#[test]
fn program_that_polls_without_waiting_sees_the_motion_end() {
    let (_rig, mut gripper) = homed(Config::default());
    let motion = gripper.begin_move_to(Mm(50.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    while gripper.poll(&motion).unwrap().is_none() {}
    let motion = gripper.begin_move_to(Mm(60.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    while gripper.motion().is_some() {
        assert!(gripper.width().unwrap().0 >= 50.0);
    }
    assert_eq!(gripper.poll(&motion), Ok(Some(())));
}

#[test]
fn fault_locks_the_fingers_until_it_ends_and_is_acknowledged() {
    let (rig, mut gripper) = homed(Config::default());
    rig.set_fault(Fault::MotorCurrent, true);
    assert!(gripper.system_state().unwrap().contains(SystemFlags::CURR_FAULT));
    let refused = gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop);
    assert_eq!(refused, Err(Error::Refused(Status::AccessDenied)));
    rig.set_fault(Fault::MotorCurrent, false);
    gripper.acknowledge().unwrap();
    gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop).unwrap();
}

#[test]
fn restarted_gripper_is_not_referenced_and_its_time_restarts() {
    let (rig, mut gripper) = homed(Config::default());
    rig.restart();
    assert_eq!(rig.access(|_, now| now), Time::ZERO);
    let refused = gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop);
    assert_eq!(refused, Err(Error::Refused(Status::NotInitialized)));
    gripper.home(HomingDirection::Default).unwrap();
    gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop).unwrap();
}

#[test]
fn cut_line_is_no_connection_until_it_is_restored() {
    let (rig, mut gripper) = homed(Config::default());
    rig.cut_line();
    let before = rig.time();
    assert!(matches!(gripper.width(), Err(Error::Unanswered | Error::NotConnected)));
    assert!(rig.time() > before, "the time-out passes in virtual time");
    assert_eq!(gripper.connect(), Err(Error::NotConnected));
    rig.restore_line();
    gripper.connect().unwrap();
    assert_eq!(gripper.width(), Ok(Mm(110.0)));
}

/// Command set, 1.4.2: an unannounced end is an error.
#[test]
fn tcp_connection_that_closes_unannounced_leaves_a_fast_stop() {
    let (rig, mut gripper) = homed_on(PortKind::Tcp, Config::default());
    rig.close_line();
    assert_eq!(gripper.width(), Err(Error::Closed));
    assert!(rig.state().flags.contains(SystemFlags::FAST_STOP));
    rig.restore_line();
    gripper.connect().unwrap();
    assert!(gripper.system_state().unwrap().contains(SystemFlags::FAST_STOP));
}

#[test]
fn restart_closes_a_tcp_connection() {
    let (rig, mut gripper) = homed_on(PortKind::Tcp, Config::default());
    rig.restart();
    assert_eq!(gripper.width(), Err(Error::Closed));
    rig.restore_line();
    gripper.connect().unwrap();
    assert_eq!(gripper.width(), Ok(Mm(0.0)), "not referenced");
}

#[test]
fn noise_before_an_answer_is_skipped_and_counted() {
    let (rig, mut gripper) = homed(Config::default());
    rig.inject(&[0x55; 20]);
    assert_eq!(gripper.width(), Ok(Mm(110.0)));
    assert_eq!(gripper.counters().line.dropped, 20);
}

#[test]
fn stop_handle_ends_a_motion() {
    let (_rig, mut gripper) = homed(Config::default());
    let handle = gripper.stop_handle().unwrap();
    let motion = gripper.begin_move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop).unwrap();
    thread::spawn(move || handle.stop()).join().unwrap().unwrap();
    assert_eq!(gripper.wait(&motion), Err(Error::Stopped(StopKind::Stop)));
}

#[test]
fn text_protocol_grips_as_well() {
    let rig = VirtualRig::with_port(PortKind::GclTcp, WITH_PART());
    let mut gripper = GclGripper::new(rig.line(), rig.clock());
    gripper.connect().unwrap();
    gripper.home(HomingDirection::Default).unwrap();
    gripper.set_force_limit(N(40.0)).unwrap();
    assert_eq!(gripper.grip(Mm(20.0), MmPerS(100.0)), Ok(Grip::Held));
}
