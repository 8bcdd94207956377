//! However the program ends, the fingers stop and no FAST STOP remains.

use std::fs::File;
use std::process::{Command, Stdio};

use rustix::process::Signal;
use wsg_protocol::SystemFlags;

use crate::rig::{Program, TestRig, real};

/// A motion that takes about 20 s.
const SLOW: &str = "home\nmove 5 5\n";

#[test]
fn signals_in_mid_travel_stop_fingers_and_leave_no_fast_stop() {
    for (signal, status) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        let mut rig = TestRig::new(real());
        let address = rig.tcp();
        let mut program = Program::start(&[&address]);
        program.enter(SLOW);
        assert_eq!(program.line(), "done\n");
        rig.until_moving();
        program.signal(signal);
        let ended = program.end();
        assert_eq!((ended.status, ended.stdout.as_str()), (status, ""), "{ended:?}");
        rig.assert_stopped();
    }
}

#[test]
fn signal_stops_the_fingers_on_lines_without_an_announcement() {
    let mut rig = TestRig::new(real());
    for address in [rig.serial(), rig.gcl()] {
        assert_eq!(Program::run(&[&address, "home"]).status, 0);
        let program = Program::start(&[&address, "move", "5", "5", "--json"]);
        rig.until_moving();
        program.signal(Signal::INT);
        let ended = program.end();
        assert_eq!(ended.status, 130, "{ended:?}");
        assert!(ended.stdout.contains(r#""result":"interrupted""#), "{ended:?}");
        rig.assert_stopped();
    }
}

#[test]
fn end_of_standard_input_closes_the_connection_cleanly() {
    let mut rig = TestRig::new(real());
    let ended = Program::run_with_lines(&[&rig.tcp()], "home\ngrip 20 400\n");
    assert_eq!(ended.status, 0, "{ended:?}");
    let flags = rig.flags();
    assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
    let held = Program::run(&[&rig.tcp(), "state"]);
    assert_eq!(held.stdout, "state HOLDING\n", "the part is still held");
}

#[test]
fn broken_pipe_in_mid_travel_stops_the_fingers() {
    let mut rig = TestRig::new(real());
    assert_eq!(Program::run(&[&rig.tcp(), "home"]).status, 0);
    let mut program = Program::start(&[&rig.tcp(), "move", "5", "5", "--record", "-"]);
    while !program.error_line().contains("21h Pre-position Fingers E_CMD_PENDING") {}
    rig.until_moving();
    program.close_stderr();
    let ended = program.end();
    assert_eq!(ended.status, 1, "{ended:?}");
    rig.assert_stopped();
}

#[test]
fn full_output_device_is_an_error_and_leaves_no_fast_stop() {
    let mut rig = TestRig::new(real());
    let full = File::create("/dev/full").expect("Linux has /dev/full");
    let address = rig.tcp();
    let program =
        Program::start_with(&[&address, "status"], |command| command.stdout(full).stderr(Stdio::piped()));
    let ended = program.end();
    assert_eq!(ended.status, 1, "{ended:?}");
    assert!(ended.stderr.contains("No space left"), "{ended:?}");
    let flags = rig.flags();
    assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
}

#[test]
fn requested_fast_stop_stays_latched_until_acknowledged() {
    let mut rig = TestRig::new(real());
    assert_eq!(Program::run(&[&rig.tcp(), "fast-stop"]).status, 0);
    assert!(rig.flags().contains(SystemFlags::FAST_STOP));
    let denied = Program::run(&[&rig.tcp(), "home"]);
    assert_eq!(denied.status, 4);
    assert!(denied.stderr.contains("E_ACCESS_DENIED") && denied.stderr.contains("`ack`"), "{denied:?}");
    assert_eq!(Program::run(&[&rig.tcp(), "ack"]).status, 0);
    assert!(!rig.flags().contains(SystemFlags::FAST_STOP));
}

#[test]
fn log_shows_both_directions_until_ctrl_c() {
    let rig = TestRig::new(real());
    let file = crate::rig::Scratch::new("frames.log", "");
    let mut program = Program::start(&[&rig.tcp(), "log", "--file", file.path()]);
    let mut seen = String::new();
    for wanted in [
        "-> AA AA AA 50 00 00 DB 87  50h Get System Information\n",
        "50h Get System Information E_SUCCESS WSG 50",
        "43h Get Opening Width on change",
    ] {
        while !seen.contains(wanted) {
            seen += &program.line();
        }
    }
    program.signal(Signal::INT);
    let ended = program.end();
    assert_eq!(ended.status, 0, "{ended:?}");
    assert!(ended.stdout.contains("07h Disconnect Announcement E_SUCCESS"), "{ended:?}");
    assert_eq!(std::fs::read_to_string(file.path()).unwrap(), seen + &ended.stdout);
}

#[test]
fn log_of_gcl_shows_its_lines() {
    let rig = TestRig::new(real());
    let file = crate::rig::Scratch::new("gcl.log", "");
    assert_eq!(Program::run(&[&rig.gcl(), "info", "--record", file.path()]).status, 0);
    let decoded = Command::new(env!("CARGO_BIN_EXE_wsg")).args(["decode", file.path()]).output().unwrap();
    let decoded = String::from_utf8(decoded.stdout).unwrap();
    assert!(decoded.contains("BYE") && !decoded.contains("not understood"), "{decoded}");

    let ended = Program::run(&[&rig.gcl(), "width", "--record", "-"]);
    assert_eq!(ended.stdout, "width 0.00 mm\n");
    assert!(ended.stderr.contains(" -> POS?\n") && ended.stderr.contains(" <- POS=0"), "{ended:?}");
    assert!(ended.stderr.contains(" -> BYE()\n"), "{ended:?}");
}
