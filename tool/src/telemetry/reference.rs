//! The reference in docs/telemetry.md, generated from the tables of settings and metrics.

use std::fmt::Write;

use super::{
    metrics::{BRIDGE, COMMANDS, GRIPPER, Metric, NODE},
    settings::{Kind, REPEATED, SETTINGS},
};

/// Returns all tables in Markdown.
pub(super) fn text() -> String {
    let mut text = String::new();
    // Writing to a string never fails.
    let _ = write(&mut text);
    text
}

fn write(text: &mut String) -> std::fmt::Result {
    writeln!(text, "### Settings\n\n| setting | default | meaning |\n|---|---|---|")?;
    for setting in SETTINGS {
        let section = if REPEATED.contains(&setting.section) {
            format!("[[{}]]", setting.section)
        } else {
            format!("[{}]", setting.section)
        };
        let default = match setting.default {
            None => "required".to_owned(),
            Some("") => "none".to_owned(),
            Some(default) => format!("`{default}`"),
        };
        let range = match setting.kind {
            Kind::Text => String::new(),
            Kind::Switch => "; `true` or `false`".to_owned(),
            Kind::Name => "; without `+`, `#` and `/`".to_owned(),
            Kind::Whole(low, high) => format!("; {low} to {high}"),
            Kind::Number(low, high) => format!("; {low} to {high}"),
        };
        writeln!(text, "| `{section}` `{}` | {default} | {}{range} |", setting.name, setting.meaning)?;
    }
    for (title, table) in [
        ("Metrics of the edge node", NODE),
        ("Metrics of a gripper", GRIPPER),
        ("Additional metrics of a gripper with `allow_commands`", COMMANDS),
        ("Metrics of a bridge", BRIDGE),
    ] {
        writeln!(text, "\n### {title}\n\n| metric | type | unit | meaning |\n|---|---|---|---|")?;
        for Metric { name, datatype, unit, meaning } in table {
            writeln!(text, "| `{name}` | {datatype:?} | {unit} | {meaning} |")?;
        }
    }
    Ok(())
}
