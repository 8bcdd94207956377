//! Runs the same commands over every kind of line.

use crate::rig::{Program, TestRig, quick};
use wsg_protocol::SystemFlags;

const LINES: &str = "home\ngrip 20 200 --force 40\nstate\nrelease 60 200\nwidth\n";
const ANSWERS: &str =
    "done\na part is held: width 19.60 mm, force 40.0 N\nstate HOLDING\ndone\nwidth 60.00 mm\n";

fn assert_grips(rig: &mut TestRig, address: &str) {
    let ended = Program::run_with_lines(&[address], LINES);
    assert_eq!((ended.status, ended.stdout.as_str(), ended.stderr.as_str()), (0, ANSWERS, ""), "{address}");
    assert!(!rig.flags().contains(SystemFlags::FAST_STOP), "{address}");
}

#[test]
fn commands_are_carried_out_over_tcp_serial_and_can() {
    let mut rig = TestRig::new(quick());
    for address in [rig.tcp(), rig.serial(), rig.slcan()] {
        assert_grips(&mut rig, &address);
    }
}

#[test]
fn commands_are_carried_out_over_gcl() {
    let mut rig = TestRig::new(quick());
    for address in [rig.gcl(), rig.gcl_udp()] {
        assert_grips(&mut rig, &address);
    }
}

#[test]
fn gcl_limits_are_the_stroke_and_those_stated_in_the_address() {
    let rig = TestRig::new(quick());
    for address in [rig.gcl(), rig.gcl_udp()] {
        for (limits, command, refused) in [
            ("", "move 110.5 100", Some("width 110.5 mm is outside the gripper's limits, 0 to 110 mm")),
            ("", "force-limit 500", None),
            ("?force=5..60", "force-limit 60", None),
            (
                "?force=5..60",
                "force-limit 60.5",
                Some("force 60.5 N is outside the gripper's limits, 5 to 60 N"),
            ),
            (
                "?speed=5..300",
                "move 50 301",
                Some("speed 301 mm/s is outside the gripper's limits, 5 to 300 mm/s"),
            ),
            ("?speed=5..300", "force-limit 500", None),
        ] {
            let address = format!("{address}{limits}");
            let ended = Program::run_with_lines(&[&address], &format!("home\n{command}\n"));
            match refused {
                Some(refused) => {
                    assert!(ended.stderr.contains(refused), "{address} {command}: {}", ended.stderr)
                }
                None => assert_eq!((ended.status, &*ended.stderr), (0, ""), "{address} {command}"),
            }
        }
    }
}
