//! What a user may write wrong: said in words that tell what was expected, before anything is sent.

use crate::bench::{Bench, Program, Scratch, quick};
use wsg_sim::{Config, Finger};

/// Nobody is there: what gets as far as to connect ends with 6.
const NOBODY: &str = "tcp://127.0.0.1:1";

fn assert_refused(arguments: &[&str], status: i32, expected: &str) {
    let ended = Program::run(arguments);
    assert_eq!(ended.status, status, "{arguments:?}: {ended:?}");
    assert!(ended.stderr.contains(expected), "{arguments:?}: {}", ended.stderr);
    assert_eq!(ended.stdout, "", "{arguments:?}");
}

#[test]
fn wrong_command_line_is_told_with_what_was_expected() {
    for (arguments, expected) in [
        (&["192.168.1.20", "info"][..], "tcp://HOST"),
        (&["serial:/dev/ttyS9?rate=fast", "info"], "bits a second"),
        (&[NOBODY, "dance"], "unrecognized subcommand 'dance'"),
        (&[NOBODY, "gripp", "20"], "'grip'"),
        (&[NOBODY, "grip", "20"], "<SPEED>"),
        (&[NOBODY, "grip", "20", "fast"], "expected a number, in mm/s"),
        (&[NOBODY, "grip", "nan", "50"], "expected a number, in mm"),
        (&[NOBODY, "grip", "20", "50", "--force"], "--force"),
        (&[NOBODY, "soft-limits", "10"], "<TO>"),
        (&[NOBODY, "finger-info", "3"], "fingers 1 and 2"),
        (&[NOBODY, "overdrive", "maybe"], "on, off"),
        (&[NOBODY, "raw", "1B0"], "two digits in hex"),
        (&[NOBODY, "loop", "0x1"], "pairs of digits in hex"),
        (&[NOBODY, "pause", "-1"], "unexpected argument"),
    ] {
        assert_refused(arguments, 2, expected);
    }
}

#[test]
fn line_that_cannot_be_opened_is_no_connection() {
    assert_refused(&[NOBODY, "info"], 6, "no connection: tcp://127.0.0.1:1: ");
    assert_refused(&["serial:/dev/no-such-port", "info"], 6, "serial:/dev/no-such-port: No such file");
}

#[test]
fn mistakes_of_a_script_are_told_with_their_lines_before_anything_is_sent() {
    let script = Scratch::new("mistakes.wsg", "home # first\n# a comment\n\ngrip 20\ntag 'x\nmove 1 2 3\n");
    let ended = Program::run(&[NOBODY, "script", script.path()]);
    assert_eq!(ended.status, 2, "{ended:?}");
    for (line, expected) in [(4, "<SPEED>"), (5, "quotation mark"), (6, "unexpected argument '3'")] {
        let place = format!("{}:{line}: ", script.path());
        let told = ended.stderr.lines().find(|told| told.contains(&place)).unwrap_or_default();
        assert!(told.contains(expected), "line {line}: {}", ended.stderr);
    }
}

#[test]
fn files_that_cannot_be_read_or_written_are_named() {
    assert_refused(&[NOBODY, "script", "/no/such/file"], 1, "/no/such/file: No such file");
    assert_refused(&[NOBODY, "info", "--record", "/no/such/file"], 1, "/no/such/file cannot be written");
}

#[test]
fn script_ends_at_the_first_line_that_fails_and_names_it() {
    let bench = Bench::new(quick());
    let script = Scratch::new("fails.wsg", "home\nmove 90 400\n\ngrip 50 400\nwidth\n");
    let ended = Program::run(&[&bench.tcp(), "script", script.path()]);
    let place = format!("wsg: {}:4: grip: no part\n", script.path());
    assert_eq!((ended.status, ended.stdout.as_str(), ended.stderr), (3, "done\ndone\n", place));

    let ended = Program::run_with_lines(
        &[&bench.tcp(), "script", "-", "--json"],
        "soft-limits 10 90\n\nmove 5 10\nwidth\n",
    );
    assert_eq!(ended.status, 4, "{ended:?}");
    let lines: Vec<serde_json::Value> =
        ended.stdout.lines().map(|line| serde_json::from_str(line).expect("it is JSON")).collect();
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert_eq!((&lines[1]["line"], &lines[1]["status"]), (&3.into(), &"E_RANGE_ERROR".into()));
}

/// Command set, 3.6.3.
#[test]
fn supply_that_is_not_switched_names_where_to_look() {
    let bench = Bench::new(Config { fingers: [Finger::Fmf, Finger::None], ..quick() });
    let ended = Program::run(&[&bench.tcp(), "finger-power", "1", "off"]);
    assert_eq!(ended.status, 4, "{ended:?}");
    assert!(
        ended.stderr.contains("refused: E_CMD_FAILED; ") && ended.stderr.contains("`finger-info`"),
        "{ended:?}"
    );
    assert!(!ended.stderr.contains("part"), "{ended:?}");
}

#[test]
fn wrong_line_of_standard_input_is_told_and_the_next_one_is_carried_out() {
    let bench = Bench::new(quick());
    let ended = Program::run_with_lines(&[&bench.tcp()], "dance\n'\nhelp grip\nstate\n");
    assert!(ended.stdout.ends_with("state IDLE\n") && ended.stdout.contains("--force"), "{ended:?}");
    assert!(ended.stderr.starts_with("wsg: dance: unrecognized subcommand"), "{ended:?}");
    assert_eq!((ended.status, ended.stderr.lines().count()), (0, 2), "{ended:?}");
}
