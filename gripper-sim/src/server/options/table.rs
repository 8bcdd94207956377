//! The table of settings: the options of the command line without the program's own. The page and the control interface
//! are derived from it.

use super::{definition, one_line, value_name};
use crate::control::{GROUPS, Setting};
use clap::{Arg, ArgAction, Command};
use std::sync::LazyLock;

/// The settings that take effect without a restart. Most lines and the values at power-up need one.
pub(super) const AT_ONCE: [&str; 18] = [
    "gcl-verbose",
    "no-checksum-check",
    "answer-bad-checksum",
    "updates-idle",
    "no-disconnect-error",
    "bus-timeout",
    "bus-reaction",
    "homing-default",
    "homing-speed",
    "part-width-tolerance",
    "clamping-travel",
    "speed",
    "release-distance",
    "release-speed",
    "serial-number",
    "tag",
    "part",
    "time-scale",
];

/// Returns the table of settings, which is built once: it takes longer than a line may wait.
pub(in crate::server) fn settings() -> &'static [Setting] {
    static TABLE: LazyLock<Vec<Setting>> = LazyLock::new(table);
    &TABLE
}

fn table() -> Vec<Setting> {
    let command = definition();
    let mut settings: Vec<Setting> =
        command.get_arguments().filter_map(|arg| setting(&command, arg)).collect();
    settings.sort_by_key(|setting| GROUPS.iter().position(|group| *group == setting.group));
    settings
}

fn setting(command: &Command, arg: &Arg) -> Option<Setting> {
    let name = arg.get_long()?;
    let group = GROUPS.iter().find(|group| arg.get_help_heading() == Some(group))?;
    let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
    let (meaning, default) = help.trim_end_matches(']').split_once(" [default: ").unwrap_or((&help, ""));
    let given = arg.get_default_values().first().and_then(|value| value.to_str());
    let unit = value_name(arg).map(|name| match name {
        "MM" => "mm",
        "MM_S" => "mm/s",
        "MM_S2" => "mm/s²",
        "MS" => "ms",
        "SECONDS" => "s",
        "N" => "N",
        "ADDR" => "address",
        "LINE" => "line",
        "WIDTH[:STIFFNESS[:INNER]]" => "mm[:N/mm[:mm]]",
        "MINUS:PLUS" => "mm:mm",
        _ => "",
    });
    // No option accepts this value, so the parser says which values it accepts.
    let refused = unit.and_then(|_| command.clone().try_get_matches_from([format!("--{name}=\u{1}")]).err());
    let refused = refused.map(|error| one_line(error).to_string()).unwrap_or_default();
    let expected = refused.split_once(": expected ").map_or("", |(_, expected)| expected);
    let choices = arg.get_possible_values();
    Some(Setting {
        name: name.to_owned(),
        group: (*group).to_owned(),
        meaning: meaning.to_owned(),
        default: given.unwrap_or(default).to_owned(),
        unit: unit.map(str::to_owned),
        choices: choices.iter().filter(|_| unit.is_some()).map(|value| value.get_name().to_owned()).collect(),
        expected: expected.to_owned(),
        is_at_once: AT_ONCE.contains(&name),
        is_list: matches!(arg.get_action(), ArgAction::Append),
    })
}
