//! Checks the generated parts of docs/tool.md: commands, addresses, exit statuses, `doctor` checks and a session.

use std::fmt::Write as _;

use clap::{Command, Subcommand};

use super::action::{Action, Named};
use super::address::FORMS;
use super::doctor::Check;
use super::trouble::EXIT_STATUSES;
use document::{hold, read};

const DOCUMENT: &str = "docs/tool.md";

/// Formats a command's usage: `grip WIDTH SPEED [--force FORCE]`.
fn usage(command: &Command) -> String {
    let mut usage = command.get_name().to_owned();
    for argument in command.get_positionals() {
        let name = argument.get_id().as_str().to_uppercase();
        let many =
            if argument.get_num_args().is_some_and(|range| range.max_values() > 1) { "..." } else { "" };
        let open =
            if argument.is_required_set() { format!(" {name}{many}") } else { format!(" [{name}{many}]") };
        usage += &open;
    }
    for argument in command.get_opts() {
        let name = argument.get_id().as_str();
        let value = if argument.get_action().takes_values() {
            format!(" {}", name.to_uppercase())
        } else {
            String::new()
        };
        let _ = write!(usage, " [--{name}{value}]");
    }
    usage
}

#[test]
fn commands_match_the_command_table() {
    let commands = Named::augment_subcommands(Command::new("gripper"));
    let mut table = "| command | what it does (section of the command set manual) |\n|---|---|\n".to_owned();
    // Same order as in the help.
    for command in Action::augment_subcommands(Command::new("gripper")).get_subcommands() {
        let command =
            commands.find_subcommand(command.get_name()).expect("both tables have the same commands");
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        let _ = writeln!(table, "| `{}` | {about} |", usage(command));
    }
    hold(DOCUMENT, "commands", &table);
}

#[test]
fn addresses_match_the_help() {
    hold(DOCUMENT, "addresses", &format!("```text\n{FORMS}\n```"));
}

#[test]
fn exit_statuses_match_the_help() {
    let rows: String =
        EXIT_STATUSES.iter().map(|(status, meaning)| format!("| {status} | {meaning} |\n")).collect();
    hold(DOCUMENT, "statuses", &format!("| status | meaning |\n|---|---|\n{rows}"));
}

#[test]
fn doctor_checks_match_the_table() {
    let rows: String =
        Check::ALL.iter().map(|check| format!("| {} | {} |\n", check.name(), check.remedy())).collect();
    hold(DOCUMENT, "checks", &format!("| check | what to change |\n|---|---|\n{rows}"));
}

#[test]
fn session_matches_the_golden_transcript() {
    let golden = read("tool/tests/gripper/golden/words.txt");
    let mut session = "```text\n".to_owned();
    for run in golden.split("> ").skip(1) {
        let (command, answer) = run.split_once('\n').expect("every command has an answer");
        if ["move 50 100", "home", "grip 20 100 --force 40", "flags", "release 60 200", "grip 50 200"]
            .contains(&command)
        {
            let answer = answer.replace("! ", "");
            let _ = write!(session, "$ wsg gripper tcp://192.168.1.20 {command}\n{answer}");
            if command == "grip 50 200" {
                break;
            }
        }
    }
    hold(DOCUMENT, "session", &(session + "```"));
}
