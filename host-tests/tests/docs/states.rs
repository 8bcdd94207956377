//! Checks docs/states.md: the meaning of each state, flag and status code for a PLC programmer.
//!
//! The remedies are written in the document. The tests require one for each entry.

use std::fs;

use document::{hold, part, read, root, table};
use host_tests::plc_names::{gripper_flags, register_bit, statuses, system_flags};
use wsg_protocol::{CommandId, Status};

const DOCUMENT: &str = "docs/states.md";

/// Each command flag with the commands that it causes.
const SENT: [(&str, &[CommandId]); 7] = [
    ("HOMING", &[CommandId::Homing]),
    ("MOVE", &[CommandId::PrePosition]),
    ("JOG", &[CommandId::SetForceLimit, CommandId::PrePosition, CommandId::GetSoftLimits]),
    ("GRIP", &[CommandId::SetForceLimit, CommandId::GripPart]),
    ("RELEASE", &[CommandId::ReleasePart]),
    ("STOP/ACK", &[CommandId::Stop, CommandId::Acknowledge]),
    ("FASTSTOP", &[CommandId::FastStop]),
];

/// Returns the last cells of a row in a part of the document. Only the document contains these words.
fn words<const N: usize>(part_name: &str, name: &str) -> Option<[String; N]> {
    let text = part(DOCUMENT, part_name);
    let mut rows =
        text.lines().map(|row| row.trim_matches('|').split('|').map(str::trim).collect::<Vec<_>>());
    let row = rows.find(|cells| cells.contains(&name))?;
    let (_, cells) = row.split_at_checked(row.len().checked_sub(N)?)?;
    assert!(cells.last().is_some_and(|remedy| !remedy.is_empty()), "{DOCUMENT} has no remedy for {name}");
    Some(std::array::from_fn(|n| cells[n].to_owned()))
}

fn remedy(part_name: &str, name: &str) -> String {
    let [remedy] = words(part_name, name)
        .unwrap_or_else(|| panic!("{DOCUMENT} has no row for {name}: add one that ends with the remedy"));
    remedy
}

/// Returns the command flags after which the manual allows this status as an answer.
fn shown_after(status: Status) -> String {
    let gives = |id: &CommandId| {
        id.immediate_statuses().contains(&status) || id.completion_statuses().contains(&status)
    };
    let flags: Vec<&str> =
        SENT.iter().filter(|(_, ids)| ids.iter().any(gives)).map(|(flag, _)| *flag).collect();
    if flags.len() == SENT.len() {
        return "each command".to_owned();
    }
    flags.join(", ").replace("HOMING, MOVE, JOG, GRIP, RELEASE", "each motion")
}

#[test]
fn commands_that_events_name_are_those_that_the_flags_send() {
    let rows = CommandId::ALL.iter().filter_map(|id| {
        let flags: Vec<_> = SENT.iter().filter(|(_, ids)| ids.contains(id)).map(|(flag, _)| *flag).collect();
        let code = id.code();
        let row = [format!("{code} ({code:02X}h) {}", id.name()), flags.join(", ")];
        (!flags.is_empty()).then_some(row)
    });
    hold(DOCUMENT, "command-ids", &table(["command", "sent after"], rows));
}

#[test]
fn states_in_the_document_are_those_of_the_code() {
    let rows = gripper_flags().into_iter().map(|flag| {
        let remedy = remedy("gstate", &flag.name);
        [flag.bit.to_string(), format!("{:02X}h", 1 << flag.bit), flag.name, flag.meaning, remedy]
    });
    hold(DOCUMENT, "gstate", &table(["bit", "byte", "name", "meaning", "remedy"], rows));
}

#[test]
fn system_flags_in_the_document_are_those_of_the_code() {
    let rows = system_flags().into_iter().map(|flag| {
        // The system flags follow GSTATE and OF.
        let (register, mask) = register_bit(16 + flag.bit);
        assert_eq!(register, 1 + flag.bit / 16);
        let name = format!("D{} {}", flag.bit, flag.name);
        let remedy = remedy("sysstate", &name);
        [name, format!("{mask:04X}h"), format!("{:08X}h", 1u32 << flag.bit), flag.meaning, remedy]
    });
    hold(DOCUMENT, "sysstate", &table(["flag", "Modbus", "CANopen", "meaning", "remedy"], rows));
}

#[test]
fn status_codes_for_the_plc_are_those_of_the_code() {
    let code = |status: Status| format!("{} ({:02X}h)", status.code(), status.code());
    let (mut rows, mut others) = (Vec::new(), Vec::new());
    for (status, meaning) in statuses() {
        let shown_after = shown_after(status);
        let name = format!("{} {}", code(status), status.symbol());
        let Some([own, remedy]) = words("status", &name) else {
            assert_eq!(shown_after, "", "{status} needs its own row");
            others.push(format!("- {} {}: {meaning}", status.code(), status.symbol()));
            continue;
        };
        rows.push([name, meaning, shown_after, own, remedy]);
    }
    let head = ["code", "meaning", "shown after", "automatic reaction of the bridge", "remedy"];
    hold(DOCUMENT, "status", &table(head, rows));
    hold(DOCUMENT, "other-status", &others.join("\n"));
}

/// Checks that the number in brackets after an `E_NAME` in a document is the number of that status.
#[test]
fn status_codes_in_sentences_have_their_numbers() {
    let documents = fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().file_name());
    let documents = documents.map(|name| format!("docs/{}", name.to_str().unwrap()));
    let mut numbered = 0;
    for document in documents.filter(|name| name.ends_with(".md")) {
        let text = read(&document);
        // After a letter or an underscore, it is part of another name.
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
                let status = status.unwrap_or_else(|| panic!("{document}: unknown status {symbol}"));
                assert_eq!(number, status.code().to_string(), "{document}: {symbol}");
                numbered += 1;
            }
        }
    }
    assert!(numbered > 0, "no document numbers a status code");
}
