//! Clients of both protocols use one virtual gripper at the same time over real sockets and read the same state. Every wait
//! is bounded.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use wsg_protocol::driver::blocking::{GclGripper, Gripper, GripperOver};
use wsg_protocol::driver::host::{StdClock, Tcp};
use wsg_protocol::driver::{self, Error, Grip, Mm, MmPerS, N, OnBlock, Protocol};
use wsg_protocol::{GripperState, HomingDirection, Status, SystemFlags, session};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

/// Time limit of every wait.
const BOUND: Duration = Duration::from_secs(60);

/// On a loaded machine the server may answer later than any real gripper.
const PATIENT: driver::Config = driver::Config {
    session: session::Config {
        reply_timeout_ms: 20_000,
        result_grace_ms: 20_000,
        ..driver::Config::DEFAULT.session
    },
    connect_timeout_ms: 20_000,
    ..driver::Config::DEFAULT
};

fn connect(address: Option<SocketAddr>) -> Tcp {
    Tcp::connect(address.expect("the server has this port")).unwrap()
}

type Driver<P> = GripperOver<Tcp, StdClock, P>;

/// The state of a gripper, as far as both protocols report it.
#[derive(Debug, PartialEq)]
struct Seen {
    state: GripperState,
    flags: SystemFlags,
    width: f32,
    speed: f32,
    force: f32,
    grips: [u32; 3],
    serial_number: u32,
    tag: String,
}

fn seen<P: Protocol>(gripper: &mut Driver<P>) -> Seen {
    let statistics = gripper.statistics(false).unwrap();
    Seen {
        state: gripper.gripper_state().unwrap(),
        flags: gripper.system_state().unwrap(),
        width: gripper.width().unwrap().0,
        speed: gripper.speed().unwrap().0,
        force: gripper.force().unwrap().0,
        grips: [statistics.total, statistics.no_part.into(), statistics.part_lost.into()],
        serial_number: gripper.system_info().unwrap().serial_number,
        tag: gripper.tag(&mut [0; 64]).unwrap().to_owned(),
    }
}

/// Asserts that both clients read the same state at standstill, and returns it.
#[track_caller]
fn seen_by_both<P: Protocol, Q: Protocol>(one: &mut Driver<P>, other: &mut Driver<Q>) -> Seen {
    let first = seen(one);
    assert_eq!(first, seen(other));
    first
}

/// One client acts. The other monitors and stops its motions.
fn one_acts_and_the_other_watches<P: Protocol, Q: Protocol>(actor: &mut Driver<P>, watcher: &mut Driver<Q>) {
    actor.set_force_limit(N(35.0)).unwrap();
    watcher.set_force_limit(N(35.0)).unwrap();

    // A motion of fourteen seconds: both clients read the same state, and widths that change in one direction.
    actor.move_to(Mm(100.0), MmPerS(400.0), OnBlock::Stop).unwrap();
    let motion = actor.begin_move_to(Mm(30.0), MmPerS(5.0), OnBlock::Stop).unwrap();
    assert_eq!(watcher.gripper_state().unwrap(), GripperState::Positioning);
    let mut widths = vec![];
    let begun = Instant::now();
    while widths.len() < 20 || widths.first() == widths.last() {
        assert!(begun.elapsed() < BOUND, "the fingers do not move: {widths:?}");
        widths.push(actor.width().unwrap());
        widths.push(watcher.width().unwrap());
    }
    assert!(widths.is_sorted_by(|one, other| one >= other), "{widths:?}");
    let refused = watcher.grip(Mm(20.0), MmPerS(100.0)).unwrap_err();
    assert!(matches!(refused, Error::Refused(Status::AlreadyRunning)), "{refused:?}");
    // One client stops the other's motion.
    watcher.stop().unwrap();
    assert!(matches!(actor.wait(&motion), Err(Error::Aborted)));
    assert!(seen_by_both(actor, watcher).flags.contains(SystemFlags::AXIS_STOPPED));
    actor.move_to(Mm(60.0), MmPerS(400.0), OnBlock::Stop).unwrap();
    assert_eq!(seen_by_both(actor, watcher).width, 60.0);

    // The part is held.
    let before = seen(watcher).grips[0];
    assert_eq!(actor.grip(Mm(20.0), MmPerS(100.0)).unwrap(), Grip::Held);
    let holding = seen_by_both(actor, watcher);
    assert_eq!((holding.state, holding.force, holding.grips[0]), (GripperState::Holding, 35.0, before + 1));
    actor.release(Mm(50.0), MmPerS(200.0)).unwrap();
    assert_eq!(seen_by_both(actor, watcher).state, GripperState::Idle);

    // A FAST STOP of one client ends the other's motion, and either client can acknowledge it.
    let motion = watcher.begin_move_to(Mm(100.0), MmPerS(5.0), OnBlock::Stop).unwrap();
    actor.fast_stop().unwrap();
    assert!(matches!(watcher.wait(&motion), Err(Error::Aborted)));
    let locked = seen_by_both(actor, watcher);
    assert!(locked.flags.contains(SystemFlags::FAST_STOP));
    assert_eq!(locked.state, GripperState::Error);
    let denied = watcher.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop).unwrap_err();
    assert!(matches!(denied, Error::Refused(Status::AccessDenied)), "{denied:?}");
    watcher.acknowledge().unwrap();
    assert!(!seen_by_both(actor, watcher).flags.contains(SystemFlags::FAST_STOP));
    actor.move_to(Mm(70.0), MmPerS(200.0), OnBlock::Stop).unwrap();
}

#[test]
fn clients_of_both_protocols_at_the_same_time_see_the_same_gripper() {
    let any = || Some(SocketAddr::from(([127, 0, 0, 1], 0)));
    let config = Config {
        part: Part::of_width(20.0),
        serial_number: 4_711,
        tag: wsg_sim::Tag::new("shared").unwrap(),
        ..Config::default()
    };
    let lines = Lines { tcp: any(), gcl: any(), ..Lines::default() };
    let served = ServerThread::start(config, &lines, None).expect("the server starts");
    let clock = StdClock::new();
    let mut frames: Gripper<_, _> = Gripper::with_config(connect(served.tcp_address()), clock, PATIENT);
    let mut text: GclGripper<_, _> = GclGripper::with_config(connect(served.gcl_address()), clock, PATIENT);
    frames.connect().unwrap();
    text.connect().unwrap();

    text.home(HomingDirection::Default).unwrap();
    assert!(seen_by_both(&mut frames, &mut text).flags.contains(SystemFlags::REFERENCED));
    one_acts_and_the_other_watches(&mut frames, &mut text);
    one_acts_and_the_other_watches(&mut text, &mut frames);
    assert_eq!(seen_by_both(&mut frames, &mut text).serial_number, 4_711);
    assert_eq!((frames.counters().session.refused, text.counters().session.refused), (0, 0));

    // An announced disconnect of one client does not affect the other.
    text.announce_disconnect().unwrap();
    drop(text);
    frames.move_to(Mm(80.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    assert!(!frames.system_state().unwrap().contains(SystemFlags::FAST_STOP));
    frames.announce_disconnect().unwrap();
}
