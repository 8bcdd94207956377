//! Checks the generated parts of docs/tool.md: commands, addresses, exit statuses and a session.

use std::fmt::Write as _;

use clap::{Command, Subcommand};

use super::action::Action;
use super::address::FORMS;
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
    let commands = Action::augment_subcommands(Command::new("gripper"));
    let mut list = "```text\n".to_owned();
    // Same order as in the help.
    for command in commands.get_subcommands() {
        let about = command.get_about().map(ToString::to_string).unwrap_or_default().replace('`', "");
        let _ = writeln!(list, "{:<35}{about}", usage(command));
    }
    hold(DOCUMENT, "commands", &(list + "```"));
}

#[test]
fn addresses_match_the_help() {
    hold(DOCUMENT, "addresses", &format!("```text\n{FORMS}\n```"));
}

#[test]
fn exit_statuses_match_the_help() {
    let rows: String =
        EXIT_STATUSES.iter().map(|(status, meaning)| format!("{status:>3}  {meaning}\n")).collect();
    hold(DOCUMENT, "statuses", &format!("```text\n{rows}```"));
}

#[test]
fn session_matches_the_golden_transcript() {
    let golden = read("tool/tests/gripper/golden/words.txt");
    let mut session = "```text\n".to_owned();
    for run in golden.split("> ").skip(1) {
        let (command, answer) = run.split_once('\n').expect("every command has an answer");
        if ["move 50 100", "home", "grip 20 100 --force 40"].contains(&command) {
            let answer = answer.replace("! ", "");
            let _ = write!(session, "$ wsg gripper tcp://192.168.1.20 {command}\n{answer}");
            if command == "grip 20 100 --force 40" {
                break;
            }
        }
    }
    hold(DOCUMENT, "session", &(session + "```"));
}
