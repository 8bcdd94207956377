//! A bus that brings whole images, such as PROFINET, in virtual time: who writes, and what happens when they leave.

use wsg_protocol::fieldbus::{CommandFlags as Flag, GripperFlags as Shown, OutputImage};
use wsg_protocol::{Status, SystemFlags};
use wsg_sim::{Config, PortId, PortKind, SilenceReaction, Time, VirtualGripper};

const PARAMETERS: OutputImage =
    OutputImage { flags: Flag::empty(), user: 0, width: 20_00, speed: 50_00, force_limit: 40_00 };

struct Bus {
    gripper: VirtualGripper,
    port: PortId,
    now: Time,
}

impl Bus {
    fn homed(config: Config) -> Self {
        let mut gripper = VirtualGripper::new(config);
        let port = gripper.connect(PortKind::Profinet).expect("a port is free");
        let mut bus = Self { gripper, port, now: Time::ZERO };
        bus.write(Flag::empty(), true);
        bus.write(Flag::HOMING, false);
        bus.wait(4_000);
        bus.write(Flag::empty(), false);
        assert_eq!(bus.shows(), (Shown::IDLE, Status::Success));
        bus
    }

    fn write(&mut self, flags: Flag, is_first: bool) {
        self.gripper.write_image(self.port, self.now, &OutputImage { flags, ..PARAMETERS }, is_first);
    }

    fn wait(&mut self, millis: u64) {
        self.now = self.now.plus_millis(millis);
        self.gripper.advance(self.now);
    }

    fn shows(&self) -> (Shown, Status) {
        let (_, input) = self.gripper.fieldbus_images();
        (input.state, input.status)
    }

    fn is_moving(&self) -> bool {
        self.gripper.state().speed != 0.0
    }
}

#[test]
fn edges_move_the_fingers() {
    let mut bus = Bus::homed(Config::default());
    bus.write(Flag::MOVE, false);
    bus.wait(100);
    assert!(bus.is_moving());
    bus.wait(5_000);
    assert_eq!((bus.gripper.state().width, bus.shows()), (20.0, (Shown::IDLE, Status::Success)));
}

#[test]
fn flag_in_the_first_image_counts_after_it_was_0_but_fast_stop_at_once() {
    let mut bus = Bus::homed(Config::default());
    bus.write(Flag::MOVE, true);
    bus.wait(100);
    assert!(!bus.is_moving());
    bus.write(Flag::MOVE, false);
    bus.wait(100);
    assert!(!bus.is_moving());
    bus.write(Flag::empty(), false);
    bus.write(Flag::MOVE, false);
    bus.wait(100);
    assert!(bus.is_moving());
    bus.write(Flag::MOVE | Flag::FASTSTOP, true);
    assert!(bus.gripper.state().flags.contains(SystemFlags::FAST_STOP));
}

#[test]
fn master_that_falls_silent_ends_its_motion_as_it_is_configured() {
    for (bus_reaction, goes_on, stops_fast) in [
        (SilenceReaction::Hold, true, false),
        (SilenceReaction::Stop, false, false),
        (SilenceReaction::FastStop, false, true),
    ] {
        let mut bus = Bus::homed(Config { bus_reaction, ..Config::default() });
        bus.write(Flag::MOVE, false);
        bus.wait(100);
        bus.gripper.end_images(bus.port, bus.now);
        bus.wait(10);
        let flags = bus.gripper.state().flags;
        assert_eq!((bus.is_moving(), flags.contains(SystemFlags::FAST_STOP)), (goes_on, stops_fast));
        // Told again, it is the same.
        bus.gripper.end_images(bus.port, bus.now);
        assert_eq!(bus.is_moving(), goes_on);
    }
}

#[test]
fn jog_ends_with_its_master_in_any_case() {
    let config = Config { bus_reaction: SilenceReaction::Hold, ..Config::default() };
    let mut bus = Bus::homed(config);
    bus.write(Flag::JOG_MINUS, false);
    bus.wait(100);
    assert!(bus.is_moving());
    bus.gripper.end_images(bus.port, bus.now);
    assert!(!bus.is_moving());
}

#[test]
fn silence_of_a_master_that_does_not_command_changes_nothing() {
    let mut bus = Bus::homed(Config::default());
    let other = bus.gripper.connect(PortKind::Profinet).expect("a port is free");
    bus.write(Flag::MOVE, false);
    bus.wait(100);
    bus.gripper.end_images(other, bus.now);
    assert!(bus.is_moving());
    // Gone, it writes nothing.
    bus.gripper.disconnect(other, bus.now);
    bus.gripper.write_image(other, bus.now, &OutputImage { flags: Flag::FASTSTOP, ..PARAMETERS }, false);
    bus.wait(10);
    assert!(bus.is_moving());
}
