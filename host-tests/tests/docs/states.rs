//! docs/states.md: what each state, flag and status code means to somebody with a PLC, and what to do about it.

use std::fs;

use host_tests::document::{hold, read, root, table};
use host_tests::plc_names::{gripper_flags, register_bit, statuses, system_flags};
use wsg_protocol::{CommandId, Status};

const DOCUMENT: &str = "docs/states.md";

/// Each command flag and the commands that it sends.
const SENT: [(&str, &[CommandId]); 7] = [
    ("HOMING", &[CommandId::Homing]),
    ("MOVE", &[CommandId::PrePosition]),
    ("JOG", &[CommandId::SetForceLimit, CommandId::PrePosition, CommandId::GetSoftLimits]),
    ("GRIP", &[CommandId::SetForceLimit, CommandId::GripPart]),
    ("RELEASE", &[CommandId::ReleasePart]),
    ("STOP/ACK", &[CommandId::Stop, CommandId::Acknowledge]),
    ("FASTSTOP", &[CommandId::FastStop]),
];

/// What a PLC does in a state.
fn in_state(name: &str) -> &'static str {
    match name {
        "IDLE" => "give the next command; with FAST_STOP in SYSSTATE acknowledge first",
        "GRIPPING" | "RELEASING" | "POSITIONING" => "wait; leave WIDTH, SPEED and FORCELIMIT as they are",
        "NO_PART" => {
            "a result, not an error: RELEASE, then try again or report the missing part; MOVE is refused"
        }
        "PART_LOST" => {
            "stop the machine's motion, RELEASE, look for the part; a higher FORCELIMIT may help; MOVE is refused"
        }
        "HOLDING" => "go on with the part; RELEASE is the way to open, MOVE is refused",
        "ERROR" => {
            "look at the status code, remove the reason, then a rising edge of STOP/ACK; MOVE is refused before"
        }
        name => panic!("nothing is said about {name}"),
    }
}

/// What a PLC does about a flag of SYSSTATE.
fn about_flag(name: &str) -> &'static str {
    match name {
        "REFERENCED" => "if it is 0: HOMING; before that every other motion ends in status 3",
        "MOVING" => "while it is 1 leave WIDTH, SPEED and FORCELIMIT as they are: a change is a FAST STOP",
        "BLOCKED_MINUS" | "BLOCKED_PLUS" => {
            "nothing while a part is held; otherwise look what is in the way of the fingers"
        }
        "SOFT_LIMIT_MINUS" | "SOFT_LIMIT_PLUS" => {
            "move away from it; the limits are set in the gripper's web interface"
        }
        "AXIS_STOPPED" => "nothing: the next motion clears it",
        "TARGET_POS_REACHED" => "do not wait for it; wait for GSTATE and the status",
        "OVERDRIVE_MODE" | "FORCECNTL_MODE" => "nothing; it is set in the gripper",
        "FAST_STOP" => {
            "remove the reason, set FASTSTOP to 0 and `FAST_STOP_OK` high, then a rising edge of STOP/ACK"
        }
        "TEMP_WARNING" => "fewer or slower motions, less force, better cooling",
        "TEMP_FAULT" => "let the gripper cool down, then a rising edge of STOP/ACK",
        "POWER_FAULT" => "measure the gripper's supply at its plug, while it moves",
        "CURR_FAULT" => {
            "let the motor cool down; look for a jam; less SPEED and FORCELIMIT; then a rising edge of STOP/ACK"
        }
        "FINGER_FAULT" => "look at plug and cable of the fingers; the gripper's web interface says which one",
        "CMD_FAILURE" => "look at the status code",
        "SCRIPT_RUNNING" => "nothing; a script runs on the gripper",
        "SCRIPT_FAILURE" => "look at the script in the gripper's web interface; the bridge uses none",
        name => panic!("nothing is said about {name}"),
    }
}

/// When the bridge shows a status by itself, and what a PLC does about a status; `None` for one that the bridge's commands do
/// not give.
fn about_status(status: Status) -> Option<(&'static str, &'static str)> {
    Some(match status {
        Status::Success => ("", "nothing"),
        Status::CmdPending => ("from the edge on", "wait; the result replaces it"),
        Status::NotInitialized => ("", "HOMING first; look why REFERENCED was lost (supply, restart)"),
        Status::AlreadyRunning => {
            ("the edge came while the fingers moved", "wait for the end of the motion, then a new edge")
        }
        Status::Timeout => (
            "the gripper did not answer, or the motion took too long: its outcome is not known",
            "look at GSTATE and at the fingers; STOP/ACK, then begin the step again",
        ),
        Status::AccessDenied => (
            "FAST STOP is not acknowledged; or a fault locks the gripper; or MOVE while a part is held; or STOP/ACK before the gripper confirmed the FAST STOP",
            "look at SYSSTATE; acknowledge by a new edge of STOP/ACK; RELEASE instead of MOVE",
        ),
        Status::CmdFailed => {
            ("", "after GRIP: no part, GSTATE says NO_PART; otherwise STOP/ACK, then begin the step again")
        }
        Status::CmdAborted => (
            "STOP/ACK or FASTSTOP withdrew the command; or the bridge was restarted while the fingers moved",
            "nothing if you stopped it; otherwise see `RESET_CAUSE` and who stopped it (`COMMANDER`)",
        ),
        Status::InconsistentData => (
            "the stored settings cannot be used, and nothing moves: `SETTINGS_FROM` says why",
            "set the bridge up again and `SAVE`, or `DEFAULTS`",
        ),
        Status::IoError => (
            "no connection to the gripper",
            "supply, cable and interface setting of the gripper; `GRIPPER_LINK` and `LINE_CHECKSUM` tell more",
        ),
        Status::NotAvailable => ("", "the soft limits were cleared while a jog ran into them: give it again"),
        Status::RangeError => (
            "",
            "JOG: the fingers are at the soft limit in its direction, or beyond it; others: WIDTH is outside the stroke or the soft limits of this gripper",
        ),
        Status::AxisBlocked => ("", "look what is in the way of the fingers; STOP/ACK, then HOMING"),
        Status::InvalidParameter => {
            ("the command could not be built from the registers", "check WIDTH, SPEED and FORCELIMIT")
        }
        Status::InsufficientResources => {
            ("too many commands at once", "a new edge after the end of the last command")
        }
        Status::CmdFormatError | Status::NoParamExpected => (
            "",
            "gripper and bridge do not understand each other: check the gripper's firmware (4.0.0 is what the bridge was written for)",
        ),
        _ => return None,
    })
}

/// The command flags after which the manual lets the gripper answer with this status.
fn shown_after(status: Status) -> String {
    let gives = |id: &CommandId| {
        id.immediate_statuses().contains(&status) || id.completion_statuses().contains(&status)
    };
    let flags: Vec<&str> =
        SENT.iter().filter(|(_, ids)| ids.iter().any(gives)).map(|(flag, _)| *flag).collect();
    if flags.len() == SENT.len() { "each command".to_owned() } else { flags.join(", ") }
}

#[test]
fn commands_that_events_name_are_those_that_the_flags_send() {
    let rows = CommandId::ALL.iter().filter_map(|id| {
        let flags: Vec<_> = SENT.iter().filter(|(_, ids)| ids.contains(id)).map(|(flag, _)| *flag).collect();
        let code = id.code();
        let row = [format!("{code} ({code:02X}h)"), id.name().to_owned(), flags.join(", ")];
        (!flags.is_empty()).then_some(row)
    });
    hold(DOCUMENT, "command-ids", &table(["id", "command", "sent after"], rows));
}

#[test]
fn states_in_the_document_are_those_of_the_code() {
    let rows = gripper_flags().into_iter().map(|flag| {
        let (_, mask) = register_bit(flag.bit);
        [
            flag.bit.to_string(),
            format!("{:02X}h", 1 << flag.bit),
            format!("{mask:04X}h"),
            in_state(&flag.name).to_owned(),
            flag.name,
            flag.meaning,
        ]
    });
    let rows = rows.map(|[bit, byte, word, remedy, name, meaning]| [bit, byte, word, name, meaning, remedy]);
    hold(DOCUMENT, "gstate", &table(["bit", "byte", "register 0", "name", "meaning", "what to do"], rows));
}

#[test]
fn system_flags_in_the_document_are_those_of_the_code() {
    let rows = system_flags().into_iter().map(|flag| {
        // Behind GSTATE and OF.
        let (register, mask) = register_bit(16 + flag.bit);
        let remedy = about_flag(&flag.name).to_owned();
        [
            format!("D{}", flag.bit),
            flag.name,
            format!("{register} ({}): {mask:04X}h", 30_001 + register),
            format!("{:08X}h", 1u32 << flag.bit),
            flag.meaning,
            remedy,
        ]
    });
    let head = ["bit", "name", "Modbus: input register, mask", "CANopen", "meaning", "what to do"];
    hold(DOCUMENT, "sysstate", &table(head, rows));
}

#[test]
fn status_codes_for_the_plc_are_those_of_the_code() {
    let (known, others): (Vec<_>, Vec<_>) =
        statuses().into_iter().partition(|(status, _)| about_status(*status).is_some());
    let code = |status: Status| format!("{} ({:02X}h)", status.code(), status.code());
    let rows = known.into_iter().map(|(status, meaning)| {
        let (own, remedy) = about_status(status).unwrap();
        [
            code(status),
            status.symbol().to_owned(),
            meaning,
            shown_after(status),
            own.to_owned(),
            remedy.to_owned(),
        ]
    });
    let head = ["code", "name", "meaning", "shown after", "the bridge by itself", "what to do"];
    hold(DOCUMENT, "status", &table(head, rows));
    for (status, _) in &others {
        assert_eq!(shown_after(*status), "", "{status} needs words of its own");
    }
    let rows =
        others.into_iter().map(|(status, meaning)| [code(status), status.symbol().to_owned(), meaning]);
    hold(DOCUMENT, "other-status", &table(["code", "name", "meaning"], rows));
}

/// A number in brackets behind the `E_NAME` of a document is the number of that status.
#[test]
fn status_codes_in_sentences_have_their_numbers() {
    let documents = fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().file_name());
    let documents = documents.map(|name| format!("docs/{}", name.to_str().unwrap()));
    let mut numbered = 0;
    for document in documents.filter(|name| name.ends_with(".md")) {
        let text = read(&document);
        // Behind a letter it is part of another name.
        let is_alone = |at: &usize| !text[..*at].ends_with(|c: char| c.is_ascii_alphanumeric() || c == '_');
        for (at, _) in text.match_indices("E_").filter(|(at, _)| is_alone(at)) {
            let rest = &text[at..];
            let end = rest.find(|c: char| !(c.is_ascii_uppercase() || c == '_')).unwrap_or(rest.len());
            let (symbol, behind) = rest.split_at(end);
            let behind = behind.strip_prefix("](states.md#status-codes)").unwrap_or(behind);
            let digits = behind.strip_prefix(" (").unwrap_or_default().chars();
            let number: String = digits.take_while(char::is_ascii_digit).collect();
            if !number.is_empty() {
                let status = Status::ALL.iter().find(|status| status.symbol() == symbol);
                let status = status.unwrap_or_else(|| panic!("{document}: there is no {symbol}"));
                assert_eq!(number, status.code().to_string(), "{document}: {symbol}");
                numbered += 1;
            }
        }
    }
    assert!(numbered > 0, "no document numbers a status code");
}
