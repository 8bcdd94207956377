//! A program for a gripper, tested without one: driver and virtual gripper in one process, on one thread, in virtual time.
//! A minute of travel takes milliseconds, and gives the same result each time.
//!
//! ```text
//! cargo run -p wsg-protocol --example virtual_time --features embedded-io
//! ```

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use wsg_protocol::driver::blocking::{Gripper, Transport};
use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, OnBlock};
use wsg_protocol::{HomingDirection, Instant};
use wsg_sim::{Config, MAX_FRAME_LEN, Part, PortId, PortKind, Time, VirtualGripper};

/// A virtual gripper at the other end of a line, and the time.
#[derive(Clone)]
struct Bench(Rc<RefCell<World>>);

struct World {
    gripper: VirtualGripper<1>,
    port: PortId,
    now: Time,
    received: VecDeque<u8>,
}

impl Bench {
    fn new(config: Config) -> Self {
        let mut gripper = VirtualGripper::with_ports(config);
        let port = gripper.connect(PortKind::Serial).expect("a new gripper takes a client");
        let received = VecDeque::new();
        Self(Rc::new(RefCell::new(World { gripper, port, now: Time::ZERO, received })))
    }

    fn gripper(&self) -> Gripper<Self, Self> {
        Gripper::new(self.clone(), self.clone())
    }

    fn time(&self) -> Time {
        self.0.borrow().now
    }

    fn set_part(&self, part: Option<Part>) {
        let now = self.time();
        self.0.borrow_mut().gripper.set_part(part, now);
    }
}

impl World {
    fn collect(&mut self) {
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
            self.received.extend(frame);
        }
    }
}

impl Clock for Bench {
    fn now(&mut self) -> Instant {
        Instant::from_millis((self.0.borrow().now.as_micros() / 1_000) as u32)
    }
}

impl ErrorType for Bench {
    type Error = Infallible;
}

impl ReadReady for Bench {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().received.is_empty())
    }
}

impl Transport for Bench {
    /// Time passes until something is there.
    fn wait(&mut self, at_most_ms: u32) -> Result<(), Infallible> {
        let mut world = self.0.borrow_mut();
        for _ in 0..at_most_ms {
            if !world.received.is_empty() {
                break;
            }
            world.now = world.now.plus_millis(1);
            let now = world.now;
            world.gripper.advance(now);
            world.collect();
        }
        Ok(())
    }
}

impl Read for Bench {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Read::read(&mut self.0.borrow_mut().received, buffer)
    }
}

impl Write for Bench {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let mut world = self.0.borrow_mut();
        let (port, now) = (world.port, world.now);
        world.gripper.receive(port, now, bytes);
        world.collect();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The program: takes a part and puts it down, or says that there is none.
fn cycle(gripper: &mut Gripper<Bench, Bench>) -> Result<Grip, Error<Infallible>> {
    gripper.move_to(Mm(60.0), MmPerS(200.0), OnBlock::Stop)?;
    let grip = gripper.grip(Mm(20.0), MmPerS(100.0))?;
    if grip == Grip::Held {
        gripper.release(Mm(60.0), MmPerS(200.0))?;
    }
    Ok(grip)
}

fn main() -> Result<(), Error<Infallible>> {
    let bench = Bench::new(Config { part: Part::of_width(20.0), ..Config::default() });
    let mut gripper = bench.gripper();
    gripper.connect()?;
    gripper.home(HomingDirection::Default)?;
    let grip = cycle(&mut gripper)?;
    println!("{}: {grip:?}", bench.time());
    bench.set_part(None);
    let grip = cycle(&mut gripper)?;
    println!("{}: {grip:?}", bench.time());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_protocol::driver::{Finger, Update};
    use wsg_protocol::session::Topic;
    use wsg_protocol::{AutoUpdate, GripperState, SoftLimits, Status, SystemFlags};
    use wsg_sim::{Fault, Tag};

    fn homed(config: Config) -> (Bench, Gripper<Bench, Bench>) {
        let bench = Bench::new(config);
        let mut gripper = bench.gripper();
        gripper.connect().unwrap();
        gripper.home(HomingDirection::Default).unwrap();
        (bench, gripper)
    }

    fn with_part() -> Config {
        Config { part: Part::of_width(20.0), ..Config::default() }
    }

    #[test]
    fn part_is_held_and_none_is_told_apart() {
        let (bench, mut gripper) = homed(with_part());
        assert_eq!(cycle(&mut gripper), Ok(Grip::Held));
        bench.set_part(None);
        assert_eq!(cycle(&mut gripper), Ok(Grip::NoPart));
        let statistics = gripper.statistics(true).unwrap();
        assert_eq!((statistics.total, statistics.no_part), (2, 1));
        assert_eq!(gripper.statistics(false).unwrap().total, 0);
    }

    #[test]
    fn motion_before_homing_is_refused() {
        let bench = Bench::new(Config::default());
        let mut gripper = bench.gripper();
        gripper.connect().unwrap();
        assert_eq!(gripper.grip(Mm(20.0), MmPerS(100.0)), Err(Error::Refused(Status::NotInitialized)));
    }

    #[test]
    fn part_in_the_way_blocks() {
        let (_bench, mut gripper) = homed(with_part());
        assert_eq!(gripper.move_to(Mm(5.0), MmPerS(100.0), OnBlock::Stop), Err(Error::Blocked));
    }

    #[test]
    fn stop_aborts_and_fast_stop_locks_until_it_is_acknowledged() {
        let (_bench, mut gripper) = homed(Config::default());
        let motion = gripper.begin_move_to(Mm(5.0), MmPerS(20.0), OnBlock::Stop).unwrap();
        assert_eq!(gripper.state(), Ok(GripperState::Positioning));
        gripper.stop().unwrap();
        assert_eq!(gripper.wait(&motion), Err(Error::Aborted));

        let motion = gripper.begin_move_to(Mm(5.0), MmPerS(20.0), OnBlock::Stop).unwrap();
        gripper.fast_stop().unwrap();
        assert_eq!(gripper.wait(&motion), Err(Error::Aborted));
        assert!(gripper.system_state().unwrap().contains(SystemFlags::FAST_STOP));
        assert_eq!(
            gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop),
            Err(Error::Refused(Status::AccessDenied))
        );
        gripper.acknowledge().unwrap();
        assert_eq!(gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop), Ok(()));
        assert!((gripper.width().unwrap() - 50.0).abs() < 0.1);
    }

    #[test]
    fn relative_moves_add_up() {
        let (_bench, mut gripper) = homed(Config::default());
        gripper.move_by(Mm(-30.0), MmPerS(200.0), OnBlock::Stop).unwrap();
        gripper.move_by(Mm(10.0), MmPerS(200.0), OnBlock::Stop).unwrap();
        assert!((gripper.width().unwrap() - 90.0).abs() < 0.1);
    }

    #[test]
    fn settings_come_back_as_they_were_set_or_clamped() {
        let (_bench, mut gripper) = homed(Config::default());
        let limits = gripper.limits().unwrap();
        gripper.set_force_limit(40.0).unwrap();
        assert_eq!(gripper.force_limit(), Ok(40.0));
        gripper.set_force_limit(1_000.0).unwrap();
        assert_eq!(gripper.force_limit(), Ok(limits.nominal_force));
        gripper.set_overdrive(true).unwrap();
        gripper.set_force_limit(1_000.0).unwrap();
        assert_eq!(gripper.force_limit(), Ok(limits.overdrive_force));
        gripper.set_acceleration(1.0).unwrap();
        assert_eq!(gripper.acceleration(), Ok(limits.min_acceleration));
        assert_eq!(gripper.soft_limits(), Ok(None));
        let range = SoftLimits { minus: 10.0, plus: 90.0 };
        gripper.set_soft_limits(range).unwrap();
        assert_eq!(gripper.soft_limits(), Ok(Some(range)));
        gripper.clear_soft_limits().unwrap();
        assert_eq!(gripper.soft_limits(), Ok(None));
    }

    #[test]
    fn device_tells_about_itself() {
        let config = Config { tag: Tag::new("left hand").unwrap(), serial_number: 77, ..Config::default() };
        let (_bench, mut gripper) = homed(config);
        assert_eq!(gripper.system_info().unwrap().serial_number, 77);
        assert_eq!(gripper.tag(&mut [0; 64]), Ok("left hand"));
        gripper.set_tag("right hand").unwrap();
        assert_eq!(gripper.tag(&mut [0; 64]), Ok("right hand"));
        assert!(gripper.temperature().unwrap().0 > 0);
        assert_eq!(gripper.finger_info(Finger::Two).unwrap().data_len, 0);
        assert!(gripper.finger_data(Finger::One, &mut [0; 8]).is_err());
        assert_eq!(gripper.tare(), Err(Error::Refused(Status::NotAvailable)));
        assert_eq!(gripper.raw(0xB0, &[1], &mut []), Err(Error::Refused(Status::CmdUnknown)));
        assert_eq!(gripper.loop_back(&[0xAA; 256]), Ok(()));
        assert_eq!(gripper.announce_disconnect(), Err(Error::Refused(Status::NotAvailable)));
    }

    #[test]
    fn updates_come_while_the_fingers_travel() {
        let (_bench, mut gripper) = homed(Config::default());
        gripper.subscribe(Topic::Width, AutoUpdate::every(10));
        let motion = gripper.begin_move_to(Mm(10.0), MmPerS(100.0), OnBlock::Stop).unwrap();
        let lost = gripper.counters().updates_lost;
        let mut widths = vec![];
        while gripper.poll(&motion).unwrap().is_none() {
            if let Some(Update::Width(width)) = gripper.next_update(100).unwrap() {
                widths.push(width);
            }
        }
        assert!(widths.len() > 80, "{}", widths.len());
        assert!(widths.is_sorted_by(|one, other| one >= other));
        assert_eq!(gripper.counters().updates_lost, lost);
    }

    #[test]
    fn fault_of_the_device_shows_in_its_flags() {
        let (bench, mut gripper) = homed(Config::default());
        let now = bench.time();
        bench.0.borrow_mut().gripper.set_fault(Fault::SupplyOutOfRange, true, now);
        assert!(gripper.system_state().unwrap().contains(SystemFlags::POWER_FAULT));
    }
}
