//! Invalid input is rejected with a message that states the expectation, before anything is sent.

use crate::rig::{Program, Scratch, TestRig, quick};
use wsg_sim::{Config, Finger};

/// An address with no listener: a program that gets as far as connecting exits with 6.
const CLOSED_PORT: &str = "tcp://127.0.0.1:1";

fn assert_refused(arguments: &[&str], status: i32, expected: &str) {
    let ended = Program::run(arguments);
    assert_eq!(ended.status, status, "{arguments:?}: {ended:?}");
    assert!(ended.stderr.contains(expected), "{arguments:?}: {}", ended.stderr);
    assert_eq!(ended.stdout, "", "{arguments:?}");
}

#[test]
fn invalid_command_line_is_rejected_with_the_expected_value() {
    for (arguments, expected) in [
        (&["192.168.1.20", "info"][..], "tcp://HOST"),
        (&["serial:/dev/ttyS9?rate=fast", "info"], "a rate in bit/s"),
        (&[CLOSED_PORT, "dance"], "unrecognized subcommand 'dance'"),
        (&[CLOSED_PORT, "gripp", "20"], "'grip'"),
        (&[CLOSED_PORT, "gripp", "20"], "\nUsage: wsg gripper [OPTIONS] <ADDRESS> [COMMAND]\n"),
        (&[CLOSED_PORT, "wacth"], "a similar subcommand exists: 'watch'"),
        (&[CLOSED_PORT, "grip", "20", "50", "--froce", "40"], "'--force'"),
        (&["tcp:/127.0.0.1", "info"], "wrong address `tcp:/127.0.0.1`; expected tcp://HOST[:PORT]"),
        (&[CLOSED_PORT, "grip", "20"], "<SPEED>"),
        (&[CLOSED_PORT, "grip", "20", "fast"], "expected a number in mm/s"),
        (&[CLOSED_PORT, "grip", "nan", "50"], "expected a number in mm"),
        (&[CLOSED_PORT, "grip", "20", "50", "--force"], "--force"),
        (&[CLOSED_PORT, "soft-limits", "10"], "<TO>"),
        (&[CLOSED_PORT, "finger-info", "3"], "finger 1 or 2"),
        (&[CLOSED_PORT, "overdrive", "maybe"], "on, off"),
        (&[CLOSED_PORT, "raw", "1B0"], "an id from 0 to 255"),
        (&[CLOSED_PORT, "loop", "0x100"], "0x00 to 0xFF"),
        (&[CLOSED_PORT, "pause", "-1"], "expected 0 to 86400 s"),
        (&[CLOSED_PORT, "move-by", "-5N", "50"], "the unit is N; expected a number in mm"),
    ] {
        assert_refused(arguments, 2, expected);
    }
}

#[test]
fn value_outside_the_limits_and_refused_grip_leave_the_settings() {
    let rig = TestRig::new(quick());
    let address = rig.tcp();
    let settings = || {
        let lines = "force-limit\nacceleration\nsoft-limits\nwidth\n";
        Program::run_with_lines(&[&address], lines).stdout
    };
    assert_eq!(Program::run(&[&address, "home"]).status, 0);
    let before = settings();
    for (line, expected) in [
        ("grip 20 50 --force 500", "force 500 N is outside the gripper's limits, 5 to 80 N; `overdrive on`"),
        ("grip 20 50 --force=-1", "force -1 N is outside"),
        ("grip 20mm 50mm/s --force -1N", "force -1 N is outside"),
        ("grip 20 5000 --force 30", "speed 5000 mm/s is outside"),
        ("grip -5 50 --force 30", "width -5 mm is outside"),
        ("move -1 100", "width -1 mm is outside the gripper's limits, 0 to 110 mm"),
        ("move-by -500mm 50", "offset -500 mm is outside"),
        ("release 111 50", "width 111 mm is outside"),
        ("force-limit 81N", "force 81 N is outside"),
        ("acceleration 99999", "acceleration 99999 mm/s² is outside the gripper's limits, 100 to 5000 mm/s²"),
        ("soft-limits -5 90", "width -5 mm is outside the gripper's limits, 0 to 110 mm"),
    ] {
        let words: Vec<&str> = std::iter::once(&*address).chain(line.split(' ')).collect();
        assert_refused(&words, 2, expected);
        let script = Program::run_with_lines(&[&address, "script", "-"], line);
        assert_eq!(script.status, 2, "{line}: {script:?}");
        assert!(script.stderr.contains(expected), "{line}: {script:?}");
        assert_eq!(settings(), before, "{line}");
    }

    let lines = "soft-limits 30 110\ngrip 20 50 --force 30\nsoft-limits --clear\n";
    let ended = Program::run_with_lines(&[&address], lines);
    assert!(ended.stderr.contains("refused: E_RANGE_ERROR"), "{ended:?}");
    assert_eq!(settings(), before);
}

#[test]
fn line_that_cannot_be_opened_is_no_connection() {
    assert_refused(&[CLOSED_PORT, "info"], 6, "no connection: tcp://127.0.0.1:1: ");
    assert_refused(&["serial:/dev/no-such-port", "info"], 6, "serial:/dev/no-such-port: No such file");
}

#[test]
fn script_errors_are_reported_by_line_before_anything_is_sent() {
    let script = Scratch::new("mistakes.wsg", "home # first\n# a comment\n\ngrip 20\ntag 'x\nmove 1 2 3\n");
    let ended = Program::run(&[CLOSED_PORT, "script", script.path()]);
    assert_eq!(ended.status, 2, "{ended:?}");
    for (line, expected) in [(4, "<SPEED>"), (5, "quotation mark"), (6, "unexpected argument '3'")] {
        let place = format!("{}:{line}: ", script.path());
        let reported = ended.stderr.lines().find(|reported| reported.contains(&place)).unwrap_or_default();
        assert!(reported.contains(expected), "line {line}: {}", ended.stderr);
    }
}

/// Writes a script in bytes and returns its file.
fn script_of_bytes(name: &str, bytes: &[u8]) -> Scratch {
    let script = Scratch::new(name, "");
    std::fs::write(script.path(), bytes).unwrap();
    script
}

#[test]
fn scripts_and_standard_input_of_any_editor_run() {
    let rig = TestRig::new(quick());
    let text = "\u{FEFF}#!/usr/bin/env wsg\r\nhome\r\n\r\nwidth\r\n";
    let script = Scratch::new("notepad.wsg", text);
    for ended in [
        Program::run(&[&rig.tcp(), "script", script.path()]),
        Program::run_with_lines(&[&rig.tcp(), "script", "-"], text),
        Program::run_with_lines(&[&rig.tcp()], text),
    ] {
        assert_eq!((ended.status, ended.stdout.as_str()), (0, "done\nwidth 110.00 mm\n"), "{ended:?}");
    }
    let utf_16: Vec<u8> = "home\r\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let script = script_of_bytes("utf-16.wsg", &[&[0xFF, 0xFE][..], &utf_16].concat());
    let expected = format!("{}: the text is UTF-16; save it as UTF-8", script.path());
    assert_refused(&[CLOSED_PORT, "script", script.path()], 1, &expected);
    let mut program = Program::start(&[&rig.tcp()]);
    program.enter_bytes(&utf_16);
    let ended = program.end();
    assert!(ended.stderr.contains("standard input: the text is UTF-16; save it as UTF-8"), "{ended:?}");
    let latin = script_of_bytes("latin.wsg", b"home\ntag \xE4\n");
    assert_refused(&[CLOSED_PORT, "script", latin.path()], 1, "line 2 is not UTF-8; save the text as UTF-8");
}

#[test]
fn text_of_a_script_cannot_command_the_terminal_or_forge_a_line() {
    let script = Scratch::new("forged.wsg", "home\nd\u{1b}[2Jance\nmove '5\u{85}wsg: 6' 5\n");
    let ended = Program::run(&[CLOSED_PORT, "script", script.path()]);
    assert!(ended.stderr.contains(r"5\u{85}wsg") && !ended.stderr.contains('\u{1b}'), "{ended:?}");
    assert_refused(
        &[CLOSED_PORT, "script", "/no/such\nwsg: done\u{1b}[1m"],
        1,
        r"/no/such\nwsg: done\u{1b}[1m: ",
    );
    assert_refused(&["serial:/dev/no\u{1b}[2J", "info"], 6, r"serial:/dev/no\u{1b}[2J: ");
    let rig = TestRig::new(quick());
    let ended = Program::run_with_lines(&[&rig.tcp()], "\u{1b}[2J\nstate\n");
    assert!(ended.stderr.starts_with(r"wsg: \u{1b}[2J: ") && !ended.stderr.contains('\u{1b}'), "{ended:?}");
}

#[test]
fn files_that_cannot_be_read_or_written_are_named() {
    assert_refused(&[CLOSED_PORT, "script", "/no/such/file"], 1, "/no/such/file: No such file");
    assert_refused(&[CLOSED_PORT, "info", "--record", "/no/such/file"], 1, "cannot write /no/such/file");
}

#[test]
fn script_ends_at_the_first_line_that_fails_and_names_it() {
    let rig = TestRig::new(quick());
    let script = Scratch::new("fails.wsg", "home\nmove 90 400\n\ngrip 50 400\nwidth\n");
    let ended = Program::run(&[&rig.tcp(), "script", script.path()]);
    let place = format!("wsg: {}:4: grip: no part\n", script.path());
    assert_eq!((ended.status, ended.stdout.as_str(), ended.stderr), (3, "done\ndone\n", place));

    let ended = Program::run_with_lines(
        &[&rig.tcp(), "script", "-", "--json"],
        "soft-limits 10 90\n\nmove 5 10\nwidth\n",
    );
    assert_eq!(ended.status, 4, "{ended:?}");
    let lines: Vec<serde_json::Value> =
        ended.stdout.lines().map(|line| serde_json::from_str(line).expect("each line is JSON")).collect();
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert_eq!((&lines[1]["line"], &lines[1]["status"]), (&3.into(), &"E_RANGE_ERROR".into()));
}

/// Command set manual, 3.6.3: the supply of this finger cannot be switched.
#[test]
fn refused_finger_power_names_the_commands_that_explain_it() {
    let rig = TestRig::new(Config { fingers: [Finger::Fmf, Finger::None], ..quick() });
    let ended = Program::run(&[&rig.tcp(), "finger-power", "1", "off"]);
    assert_eq!(ended.status, 4, "{ended:?}");
    assert!(
        ended.stderr.contains("refused: E_CMD_FAILED; ") && ended.stderr.contains("`finger-info`"),
        "{ended:?}"
    );
    assert!(!ended.stderr.contains("part"), "{ended:?}");
}

#[test]
fn invalid_input_line_is_reported_and_the_next_one_is_executed() {
    let rig = TestRig::new(quick());
    let ended = Program::run_with_lines(&[&rig.tcp()], "dance\n'\nhelp grip\nstate\n");
    assert!(ended.stdout.ends_with("state IDLE\n") && ended.stdout.contains("--force"), "{ended:?}");
    assert!(ended.stderr.starts_with("wsg: dance: unrecognized subcommand"), "{ended:?}");
    assert_eq!((ended.status, ended.stderr.lines().count()), (0, 2), "{ended:?}");
}
