//! The virtual gripper on PROFIBUS, with a master that others wrote.

use host_tests::masters::{self, said};
use wsg_sim::server::{Lines, SerialLine, ServerThread};
use wsg_sim::{Config, Part};

#[test]
#[ignore = "needs pyprofibus: run `cargo xtask test`"]
fn pyprofibus_runs_a_grip_cycle_on_the_virtual_gripper() {
    let config = Config { time_scale: 10.0, part: Part::of_width(20.0), ..Config::default() };
    let lines = Lines { profibus: Some(SerialLine::Pty), ..Lines::default() };
    let server = ServerThread::start(config, &lines, None).unwrap();
    let output =
        masters::python(include_str!("pyprofibus.py"), &[server.profibus_path().unwrap().to_str().unwrap()]);
    assert!(output.status.success(), "{}", said(&output));
}
