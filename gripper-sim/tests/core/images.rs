//! A bus with complete images, such as PROFINET, in virtual time: which master is active, and what happens when it leaves.

use crate::fieldbus::{PARAMETERS, REACTIONS};
use wsg_fieldbus::{CommandFlags as Flag, GripperFlags as Shown, OutputImage};
use wsg_protocol::{Command, HomingDirection, Status, SystemFlags};
use wsg_sim::{Config, PortId, PortKind, ScriptState, Time, VirtualGripper};

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
fn first_image_gives_no_edge_except_faststop() {
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
    for (bus_reaction, flag, continues, stops_fast) in REACTIONS {
        let mut bus = Bus::homed(Config { bus_reaction, ..Config::default() });
        bus.write(flag, false);
        bus.wait(100);
        assert!(bus.is_moving());
        bus.gripper.end_images(bus.port, bus.now);
        bus.wait(10);
        let flags = bus.gripper.state().flags;
        assert_eq!((bus.is_moving(), flags.contains(SystemFlags::FAST_STOP)), (continues, stops_fast));
        // A second report changes nothing.
        bus.gripper.end_images(bus.port, bus.now);
        assert_eq!(bus.is_moving(), continues);
    }
}

/// The control server shows the outputs (`/state`).
#[test]
fn outputs_are_zeros_only_after_their_own_master_has_left() {
    for is_cut in [false, true] {
        let mut bus = Bus::homed(Config::default());
        bus.write(Flag::GRIP, false);
        let other = bus.gripper.connect(PortKind::Profinet).expect("a port is free");
        bus.gripper.end_images(other, bus.now);
        bus.gripper.disconnect(other, bus.now);
        assert_eq!(bus.gripper.fieldbus_images().0, OutputImage { flags: Flag::GRIP, ..PARAMETERS });
        if is_cut {
            bus.gripper.disconnect(bus.port, bus.now);
        } else {
            bus.gripper.end_images(bus.port, bus.now);
        }
        assert_eq!(bus.gripper.fieldbus_images().0, OutputImage::ZERO);
    }
}

#[test]
fn silence_of_a_master_that_does_not_command_changes_nothing() {
    let mut bus = Bus::homed(Config::default());
    let other = bus.gripper.connect(PortKind::Profinet).expect("a port is free");
    bus.write(Flag::MOVE, false);
    bus.wait(100);
    bus.gripper.end_images(other, bus.now);
    assert!(bus.is_moving());
    // After its disconnect it is not the active master.
    bus.gripper.disconnect(other, bus.now);
    bus.gripper.write_image(other, bus.now, &OutputImage { flags: Flag::FASTSTOP, ..PARAMETERS }, false);
    bus.wait(10);
    assert!(bus.is_moving());
}

/// Fieldbus manual, 5.1.1. The flags of an ended script are reset.
#[test]
fn user_flags_pass_both_images_and_end_with_the_script() {
    let mut bus = Bus::homed(Config::default());
    bus.gripper.set_script_state(ScriptState::Running, bus.now);
    bus.gripper.write_image(bus.port, bus.now, &OutputImage { user: 0xA5, ..PARAMETERS }, false);
    bus.gripper.set_user_outputs(0x5A);
    let (written, shown) = bus.gripper.fieldbus_images();
    assert_eq!((written.user, shown.user), (0xA5, 0x5A));
    for state in [ScriptState::Failed, ScriptState::None] {
        bus.gripper.set_user_outputs(0x5A);
        bus.gripper.set_script_state(state, bus.now);
        assert_eq!(bus.gripper.fieldbus_images().1.user, 0, "{state:?}");
    }
}

/// Writes the image over Modbus/TCP.
fn modbus_writes(bus: &mut Bus, modbus: PortId, flags: Flag) {
    let image = OutputImage { flags, ..PARAMETERS };
    let pdu = [&[16, 0, 0, 0, 4, 8][..], &image.to_bytes()].concat();
    let header = [0, 1, 0, 0, 0, pdu.len() as u8 + 1, 0xFF];
    bus.gripper.receive(modbus, bus.now, &[&header, &pdu[..]].concat());
}

#[test]
fn unchanged_cyclic_image_is_no_edge_after_another_write() {
    let mut bus = Bus::homed(Config::default());
    let modbus = bus.gripper.connect(PortKind::ModbusTcp).expect("a port is free");
    bus.write(Flag::MOVE, false);
    bus.wait(5_000);
    bus.gripper.command(&Command::Homing { direction: HomingDirection::Default }, bus.now);
    bus.wait(5_000);
    modbus_writes(&mut bus, modbus, Flag::empty());
    bus.write(Flag::MOVE, false);
    bus.wait(100);
    assert!(!bus.is_moving(), "the master has held MOVE since its motion");
    bus.write(Flag::empty(), false);
    bus.write(Flag::MOVE, false);
    bus.wait(100);
    assert!(bus.is_moving());
}

/// A silent Modbus master times out, but it is no longer the active master.
#[test]
fn modbus_time_out_does_not_end_the_motion_of_a_cyclic_master() {
    let config = Config { bus_timeout_ms: 50, ..Config::default() };
    let mut bus = Bus::homed(config);
    let modbus = bus.gripper.connect(PortKind::ModbusTcp).expect("a port is free");
    modbus_writes(&mut bus, modbus, Flag::empty());
    bus.write(Flag::MOVE, false);
    bus.wait(100);
    assert!(bus.is_moving());
    bus.gripper.end_images(bus.port, bus.now);
    assert_eq!(bus.gripper.fieldbus_images().0, OutputImage::ZERO);
    assert!(!bus.is_moving(), "the active master ends its motion");
}

#[test]
fn fast_stop_counts_as_long_as_any_master_asserts_it() {
    let mut bus = Bus::homed(Config::default());
    let modbus = bus.gripper.connect(PortKind::ModbusTcp).expect("a port is free");
    bus.write(Flag::FASTSTOP, false);
    modbus_writes(&mut bus, modbus, Flag::empty());
    modbus_writes(&mut bus, modbus, Flag::STOP_ACK);
    assert!(bus.gripper.state().flags.contains(SystemFlags::FAST_STOP), "the cyclic master asserts it");
    modbus_writes(&mut bus, modbus, Flag::FASTSTOP);
    bus.write(Flag::empty(), false);
    bus.write(Flag::STOP_ACK, false);
    assert!(bus.gripper.state().flags.contains(SystemFlags::FAST_STOP), "the Modbus master asserts it");
    modbus_writes(&mut bus, modbus, Flag::empty());
    bus.write(Flag::empty(), false);
    bus.write(Flag::STOP_ACK, false);
    assert!(!bus.gripper.state().flags.contains(SystemFlags::FAST_STOP));
}
