//! The reference in docs/tool.md, generated from the tables of settings and metrics.

use std::fmt::Write;

use super::{
    metrics::{BRIDGE, COMMANDS, GATEWAY, GRIPPER, Metric, NODE},
    settings::{Kind, SETTINGS},
};

/// Precedes the first table of metrics.
const METRICS: &str = "Numbers with a unit are of type Float, all others UInt64. \
                       Counters start at 0 with the program, counters of a bridge with the bridge.\n\n";

/// Returns all tables in Markdown.
pub(super) fn text() -> String {
    let mut text = String::new();
    // Writing to a string never fails.
    let _ = write(&mut text);
    text
}

fn write(text: &mut String) -> std::fmt::Result {
    writeln!(text, "#### Settings\n\n| setting, default | meaning |\n|---|---|")?;
    for setting in SETTINGS {
        let name = format!("{}.{}", setting.section, setting.name);
        let name = match setting.default {
            None => format!("`{name}`, required"),
            Some("") => format!("`{name}`"),
            Some(default) => format!("`{name} = {default}`"),
        };
        let range = match setting.kind {
            Kind::Text => String::new(),
            Kind::Switch => "; `true` or `false`".to_owned(),
            Kind::Name => "; without `+`, `#` and `/`".to_owned(),
            Kind::Whole(low, high) => format!("; {low} to {high}"),
            Kind::Number(low, high) => format!("; {low} to {high}"),
        };
        writeln!(text, "| {name} | {}{range} |", setting.meaning)?;
    }
    // The metrics that a bridge shares with a gripper are described once.
    let (shared, own): (Vec<Metric>, Vec<Metric>) =
        BRIDGE.iter().copied().partition(|metric| GRIPPER.contains(metric));
    let names: Vec<String> = shared.iter().map(|metric| format!("`{}`", metric.name)).collect();
    let names = names.join(", ");
    let shared =
        format!("As for a gripper: {names}. They and `Status` are null while no gripper responds.\n\n");
    for (title, introduction, metrics) in [
        ("Metrics of the edge node", METRICS, NODE),
        ("Metrics of a gripper", "", GRIPPER),
        ("Additional metrics of a gripper with `allow_commands`", "", COMMANDS),
        ("Metrics of a bridge", &shared[..], &own[..]),
        ("Additional metrics of a gateway", "", &GATEWAY[BRIDGE.len()..]),
    ] {
        writeln!(text, "\n#### {title}\n\n{introduction}| metric | meaning |\n|---|---|")?;
        for Metric { name, unit, meaning, .. } in metrics {
            let comma = if unit.is_empty() { "" } else { ", " };
            writeln!(text, "| `{name}`{comma}{unit} | {meaning} |")?;
        }
    }
    Ok(())
}
