//! Checks the tables of the Wireshark dissector against the crate.

use std::fmt::Write;

use document::hold;
use wsg_protocol::gcl::CommandName;
use wsg_protocol::{
    DeviceType, FingerFlags, FingerType, GripperState, HomingDirection, PrePositionFlags, Status, SystemFlags,
};

use super::commands::rows;

const DISSECTOR: &str = "tool/wireshark/wsg.lua";

/// `local NAME = { [number] = "text", ... }`
fn names(name: &str, rows: impl Iterator<Item = (u32, String)>) -> String {
    let rows: String = rows.map(|(number, text)| format!("  [{number}] = \"{text}\",\n")).collect();
    format!("local {name} = {{\n{rows}}}\n")
}

/// `local NAME = { { bit, "NAME" }, ... }`
fn flags(name: &str, flags: impl Iterator<Item = (&'static str, u32)>) -> String {
    let rows = flags.map(|(name, bits)| format!("  {{ {}, \"{name}\" }},\n", bits.trailing_zeros()));
    format!("local {name} = {{\n{}}}\n", rows.collect::<String>())
}

/// Returns the name of a reply's value: the title of the command without its verb.
fn value_name(title: &str) -> String {
    title.strip_prefix("Get ").unwrap_or(title).to_lowercase().replace([' ', '-'], "_")
}

fn value(name: &str, kind: &str, unit: &str) -> String {
    format!("{{ \"{name}\", \"{}\", \"{unit}\" }}", kind.trim_end_matches("<'a>"))
}

#[test]
fn tables_of_the_dissector_are_those_of_the_code() {
    let mut text = "]]\nlocal COMMANDS = {\n".to_owned();
    for row in rows() {
        let id = row.id;
        let request: Vec<_> = row.request.iter().map(|(name, kind, unit)| value(name, kind, unit)).collect();
        let reply: Vec<_> =
            row.reply.iter().map(|(kind, unit)| value(&value_name(id.name()), kind, unit)).collect();
        writeln!(
            text,
            "  [0x{:02X}] = {{ name = \"{}\", request = {{ {} }}, reply = {{ {} }} }},",
            id.code(),
            id.name(),
            request.join(", "),
            reply.join(", ")
        )
        .unwrap();
    }
    text += "}\n";
    text += &names("STATUS", Status::ALL.iter().map(|it| (it.code().into(), it.symbol().to_owned())));
    text += &names("GRIPPER_STATES", GripperState::ALL.iter().map(|it| (it.code().into(), it.to_string())));
    text +=
        &names("HOMING_DIRECTIONS", HomingDirection::ALL.iter().map(|it| (it.code().into(), it.to_string())));
    let devices = (0..=u8::MAX).map(DeviceType::from_code);
    let devices = devices.filter(|it| !matches!(it, DeviceType::Unknown(_)));
    text += &names("DEVICE_TYPES", devices.map(|it| (it.code().into(), it.to_string())));
    let fingers = (0..=u8::MAX).map(FingerType::from_code);
    let fingers = fingers.filter(|it| !matches!(it, FingerType::Unknown(_)));
    text += &names("FINGER_TYPES", fingers.map(|it| (it.code().into(), it.to_string())));
    text += &flags("SYSTEM_FLAGS", SystemFlags::all().iter_names().map(|(name, it)| (name, it.bits())));
    text +=
        &flags("FINGER_FLAGS", FingerFlags::all().iter_names().map(|(name, it)| (name, it.bits().into())));
    text += &flags(
        "PRE_POSITION_FLAGS",
        PrePositionFlags::all().iter_names().map(|(name, it)| (name, it.bits().into())),
    );
    let gcl = CommandName::ALL.iter().map(|name| {
        let kind = format!("{:?}", name.kind()).to_lowercase();
        format!("  {} = \"{kind}\",\n", name.text())
    });
    text += &format!("local GCL_COMMANDS = {{\n{}}}\n", gcl.collect::<String>());
    text += "--[[";
    hold(DISSECTOR, "tables", &text);
}
