//! Golden transcripts of every command as text and JSON. `WSG_UPDATE_DOCS=1` rewrites them.

use std::fmt::Write as _;
use std::path::Path;

use crate::rig::{Program, TestRig, quick};

/// The commands of the transcript.
const COMMANDS: &str = "\
move 50 100
home
home positive
move 50mm 100mm/s
move-by -5mm 50
width
grip 20 100 --force 40
force
state
flags
release 60 200
grip 50 200
release 60 200
grip 20 100 --force 400
force-limit 30N
force-limit
acceleration
acceleration 9000
soft-limits
soft-limits 10 90
move 5 50
soft-limits --clear
overdrive on
overdrive off
tare
part-width-tolerance 2
clamping-travel
speed
statistics
statistics --reset
info
limits
tag
tag 'left arm'
finger-info 1
finger-flags 2
finger-power 1 on
finger-data 1
loop 1 0x02 0xFF
raw 0x33
raw 0xB0 1
raw grip-part 0
stop
fast-stop
move 50 100
ack
pause 0.01
grip 20
disconnect
";

/// Sent after each command. The start of its answer marks the end of the command's answer.
const END: &str = "temperature";

/// Runs the commands over one connection and returns each with its answer. `!` marks standard error.
fn transcript(address: &str, options: &[&str]) -> String {
    let mut text = String::new();
    let mut program = Program::start(&[&[address], options].concat());
    let is_end = |line: &str| line.starts_with("temperature ") || line.contains(r#""command":"temperature""#);
    for command in COMMANDS.lines().filter(|command| *command != "disconnect") {
        program.enter(&format!("{command}\n{END}\n"));
        let _ = writeln!(text, "> {command}");
        let answer: String =
            std::iter::repeat_with(|| program.line()).take_while(|line| !is_end(line)).collect();
        if answer.is_empty() {
            let _ = write!(text, "! {}", program.error_line());
        }
        text += &answer;
    }
    program.enter("disconnect\n");
    let _ = write!(text, "> disconnect\n{}", program.line());
    assert_eq!(program.end().status, 0);
    text
}

fn assert_golden(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/gripper/golden").join(name);
    if std::env::var_os("WSG_UPDATE_DOCS").is_some() {
        std::fs::write(&path, text).expect("the golden file is writable");
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_default();
    for (number, (actual, expected)) in (1..).zip(text.lines().zip(golden.lines())) {
        assert_eq!(actual, expected, "{name}:{number}");
    }
    assert_eq!(text.lines().count(), golden.lines().count(), "{name}");
}

#[test]
fn text_output_matches_the_golden_transcript() {
    assert_golden("words.txt", &transcript(&TestRig::new(quick()).tcp(), &[]));
}

#[test]
fn json_output_matches_the_golden_transcript() {
    assert_golden("json.txt", &transcript(&TestRig::new(quick()).tcp(), &["--json"]));
}

#[test]
fn gcl_output_matches_the_golden_transcript() {
    assert_golden("gcl.txt", &transcript(&TestRig::new(quick()).gcl(), &[]));
}
