//! Tests a gripper program without hardware: driver and virtual gripper in one process, on one thread, in virtual time. A
//! minute of travel takes milliseconds, and the result is reproducible.
//!
//! ```text
//! cargo run -p wsg-protocol --example virtual_time --features embedded-io
//! ```

use std::convert::Infallible;

use wsg_protocol::HomingDirection;
use wsg_protocol::driver::blocking::Gripper;
use wsg_protocol::driver::{Error, Grip, Mm, MmPerS, OnBlock};
use wsg_sim::{Config, Part, VirtualRig};

type Driver = Gripper<VirtualRig, VirtualRig>;

/// The program under test: grips a part and releases it, or reports that there is none.
fn cycle(gripper: &mut Driver) -> Result<Grip, Error<Infallible>> {
    gripper.move_to(Mm(60.0), MmPerS(200.0), OnBlock::Stop)?;
    let grip = gripper.grip(Mm(20.0), MmPerS(100.0))?;
    if grip == Grip::Held {
        gripper.release(Mm(60.0), MmPerS(200.0))?;
    }
    Ok(grip)
}

fn main() -> Result<(), Error<Infallible>> {
    let rig = VirtualRig::new(Config { part: Part::of_width(20.0), ..Config::default() });
    let mut gripper = Gripper::new(rig.line(), rig.clock());
    gripper.connect()?;
    gripper.home(HomingDirection::Default)?;
    let grip = cycle(&mut gripper)?;
    println!("{}: {grip:?}", rig.time());
    rig.set_part(None);
    let grip = cycle(&mut gripper)?;
    println!("{}: {grip:?}", rig.time());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_protocol::driver::{Finger, N, Update};
    use wsg_protocol::session::Topic;
    use wsg_protocol::{AutoUpdate, CommandId, GripperState, SoftLimits, Status, SystemFlags};
    use wsg_sim::{Fault, Tag};

    fn homed(config: Config) -> (VirtualRig, Driver) {
        let rig = VirtualRig::new(config);
        let mut gripper = Gripper::new(rig.line(), rig.clock());
        gripper.connect().unwrap();
        gripper.home(HomingDirection::Default).unwrap();
        (rig, gripper)
    }

    fn with_part() -> Config {
        Config { part: Part::of_width(20.0), ..Config::default() }
    }

    #[test]
    fn held_part_and_missing_part_are_distinguished() {
        let (rig, mut gripper) = homed(with_part());
        assert_eq!(cycle(&mut gripper), Ok(Grip::Held));
        rig.set_part(None);
        assert_eq!(cycle(&mut gripper), Ok(Grip::NoPart));
        let statistics = gripper.statistics(true).unwrap();
        assert_eq!((statistics.total, statistics.no_part), (2, 1));
        assert_eq!(gripper.statistics(false).unwrap().total, 0);
    }

    #[test]
    fn motion_before_homing_is_refused() {
        let rig = VirtualRig::new(Config::default());
        let mut gripper = Gripper::new(rig.line(), rig.clock());
        gripper.connect().unwrap();
        assert_eq!(gripper.grip(Mm(20.0), MmPerS(100.0)), Err(Error::Refused(Status::NotInitialized)));
    }

    #[test]
    fn part_in_the_way_blocks() {
        let (_rig, mut gripper) = homed(with_part());
        assert_eq!(gripper.move_to(Mm(5.0), MmPerS(100.0), OnBlock::Stop), Err(Error::Blocked));
    }

    #[test]
    fn stop_aborts_and_fast_stop_locks_until_it_is_acknowledged() {
        let (_rig, mut gripper) = homed(Config::default());
        let motion = gripper.begin_move_to(Mm(5.0), MmPerS(20.0), OnBlock::Stop).unwrap();
        assert_eq!(gripper.gripper_state(), Ok(GripperState::Positioning));
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
        assert!((gripper.width().unwrap().0 - 50.0).abs() < 0.1);
    }

    #[test]
    fn relative_moves_add_up() {
        let (_rig, mut gripper) = homed(Config::default());
        gripper.move_by(Mm(-30.0), MmPerS(200.0), OnBlock::Stop).unwrap();
        gripper.move_by(Mm(10.0), MmPerS(200.0), OnBlock::Stop).unwrap();
        assert!((gripper.width().unwrap().0 - 90.0).abs() < 0.1);
    }

    #[test]
    fn settings_read_back_as_set_and_out_of_range_ones_are_refused() {
        let (_rig, mut gripper) = homed(Config::default());
        let refusal = |set: Result<(), Error<Infallible>>| set.unwrap_err().to_string();
        gripper.set_force_limit(N(30.0)).unwrap();
        let refused = refusal(gripper.set_force_limit(N(100.0)));
        assert_eq!(refused, "force 100 N is outside the gripper's limits, 5 to 80 N");
        assert_eq!(gripper.force_limit(), Ok(N(30.0)));

        gripper.set_overdrive(true).unwrap();
        gripper.set_force_limit(N(120.0)).unwrap();
        let refused = refusal(gripper.set_force_limit(N(121.0)));
        assert_eq!(refused, "force 121 N is outside the gripper's limits, 5 to 120 N");
        gripper.set_overdrive(false).unwrap();
        assert_eq!(gripper.force_limit(), Ok(N(80.0)), "the gripper reduces it to the nominal force");
        assert!(gripper.set_force_limit(N(100.0)).is_err(), "the driver knows the new mode");

        let acceleration = gripper.acceleration();
        for (value, refused) in [
            (1.0, "acceleration 1 mm/s² is outside the gripper's limits, 100 to 5000 mm/s²"),
            (99_999.0, "acceleration 99999 mm/s² is outside the gripper's limits, 100 to 5000 mm/s²"),
        ] {
            assert_eq!(refusal(gripper.set_acceleration(value)), refused);
        }
        assert_eq!(gripper.acceleration(), acceleration);
        gripper.set_acceleration(250.0).unwrap();
        assert_eq!(gripper.acceleration(), Ok(250.0));

        for (minus, plus) in [(-5.0, 90.0), (10.0, 111.0), (90.0, 10.0)] {
            assert!(matches!(
                gripper.set_soft_limits(SoftLimits { minus, plus }),
                Err(Error::OutOfLimits(_))
            ));
        }
        assert_eq!(gripper.soft_limits(), Ok(None));
        let range = SoftLimits { minus: 10.0, plus: 90.0 };
        gripper.set_soft_limits(range).unwrap();
        assert_eq!(gripper.soft_limits(), Ok(Some(range)));
        let grip = gripper.grip_with_force(Mm(5.0), MmPerS(100.0), N(50.0));
        assert_eq!(grip, Err(Error::Refused(Status::RangeError)), "the gripper checks soft limits");
        assert_eq!(gripper.force_limit(), Ok(N(80.0)), "a refused grip changes nothing");
        gripper.clear_soft_limits().unwrap();
        assert_eq!(gripper.soft_limits(), Ok(None));
    }

    #[test]
    fn raw_command_is_not_checked_against_the_limits() {
        let (_rig, mut gripper) = homed(Config::default());
        let force = 500.0_f32.to_le_bytes();
        assert_eq!(gripper.raw(CommandId::SetForceLimit.code(), &force, &mut []), Ok(&[][..]));
        assert_eq!(gripper.force_limit(), Ok(N(80.0)), "corrected by the gripper");
    }

    #[test]
    fn device_reports_identity_and_settings() {
        let config = Config { tag: Tag::new("left hand").unwrap(), serial_number: 77, ..Config::default() };
        let (_rig, mut gripper) = homed(config);
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
    fn updates_arrive_while_the_fingers_travel() {
        let (_rig, mut gripper) = homed(Config::default());
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
    fn device_fault_sets_its_flag() {
        let (rig, mut gripper) = homed(Config::default());
        rig.set_fault(Fault::SupplyOutOfRange, true);
        assert!(gripper.system_state().unwrap().contains(SystemFlags::POWER_FAULT));
    }
}
