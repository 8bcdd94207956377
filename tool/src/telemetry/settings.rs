//! The settings of `wsg telemetry`: one table, from which the file is checked and the document derives.

use std::fmt;

use anyhow::{Result, anyhow, bail};

/// A line of a file.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) file: String,
    pub(super) line: usize,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, line {}", self.file, self.line)
    }
}

/// What a setting takes.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    Text,
    /// A part of a topic: no `+`, `#` or `/`, not empty.
    Name,
    /// A whole number in this range.
    Whole(u32, u32),
    /// A number in this range.
    Number(f32, f32),
    /// true or false.
    Switch,
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setting {
    pub(super) section: &'static str,
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    /// As the file has it; `None`: it must be given; empty: there is none.
    pub(super) default: Option<&'static str>,
    pub(super) meaning: &'static str,
}

const fn setting(
    section: &'static str,
    name: &'static str,
    kind: Kind,
    default: Option<&'static str>,
    meaning: &'static str,
) -> Setting {
    Setting { section, name, kind, default, meaning }
}

/// Sections that may be there any number of times, as `[[name]]`.
pub(super) const REPEATED: [&str; 2] = ["gripper", "bridge"];

/// Every setting.
pub(super) const SETTINGS: &[Setting] = &[
    setting("broker", "address", Kind::Text, None, "`mqtt://HOST[:1883]`, or `mqtts://HOST[:8883]` for TLS"),
    setting("broker", "user", Kind::Text, Some(""), "user name; none: the broker is not told one"),
    setting("broker", "password_file", Kind::Text, Some(""), "file with the password; its first line counts"),
    setting(
        "broker",
        "password_env",
        Kind::Text,
        Some(""),
        "environment variable with the password, instead of a file",
    ),
    setting(
        "broker",
        "ca_file",
        Kind::Text,
        Some(""),
        "certificates (PEM) that the broker's must be signed by; none: those that the system trusts",
    ),
    setting(
        "broker",
        "certificate_file",
        Kind::Text,
        Some(""),
        "certificate (PEM) that this program shows, where the broker asks for one",
    ),
    setting("broker", "key_file", Kind::Text, Some(""), "its private key (PEM)"),
    setting(
        "broker",
        "client_id",
        Kind::Text,
        Some(""),
        "MQTT's name of this program; none: `wsg-GROUP-NODE`. Two programs with one name throw each other out",
    ),
    setting(
        "broker",
        "keep_alive_s",
        Kind::Whole(1, 600),
        Some("10"),
        "after how many seconds of silence a broker counts as lost, in s",
    ),
    setting(
        "broker",
        "reconnect_s",
        Kind::Number(0.1, 600.0),
        Some("2"),
        "how long after a connection was lost or refused the next one is tried, in s",
    ),
    setting("node", "group", Kind::Name, None, "Sparkplug's group, such as the plant's or the line's name"),
    setting("node", "name", Kind::Name, None, "Sparkplug's name of this edge node; its own in the group"),
    setting(
        "node",
        "state_file",
        Kind::Text,
        None,
        "file that keeps `bdSeq` over restarts; it is made. Its folder must be there",
    ),
    setting(
        "node",
        "store",
        Kind::Whole(1, 10_000_000),
        Some("100000"),
        "samples that are kept in memory while the broker is away; the oldest give way",
    ),
    setting(
        "node",
        "command_age_ms",
        Kind::Whole(100, 60_000),
        Some("2000"),
        "how far the time in a command may be from this computer's, in ms; others are refused",
    ),
    setting(
        "data",
        "period_ms",
        Kind::Whole(10, 60_000),
        Some("100"),
        "the least time between two samples of a device, in ms; changes of its state are told at once",
    ),
    setting(
        "data",
        "width_deadband",
        Kind::Number(0.0, 1_000.0),
        Some("0.05"),
        "how much the width must change before it is told, in mm",
    ),
    setting(
        "data",
        "speed_deadband",
        Kind::Number(0.0, 1_000.0),
        Some("1"),
        "how much the speed must change before it is told, in mm/s",
    ),
    setting(
        "data",
        "force_deadband",
        Kind::Number(0.0, 1_000.0),
        Some("0.5"),
        "how much the force must change before it is told, in N",
    ),
    setting("gripper", "name", Kind::Name, None, "Sparkplug's name of the device; its own in this file"),
    setting(
        "gripper",
        "address",
        Kind::Text,
        None,
        "`tcp://HOST[:1000]`, `udp://HOST[:1500]` (answers come to port 1501; another: `udp://HOST:1500?local=1502`), or `serial:DEVICE` (115 200 bit/s, 8N1)",
    ),
    setting(
        "gripper",
        "allow_commands",
        Kind::Switch,
        Some("false"),
        "whether hosts may command this gripper, and so move its fingers",
    ),
    setting("bridge", "name", Kind::Name, None, "Sparkplug's name of the device; its own in this file"),
    setting(
        "bridge",
        "device",
        Kind::Text,
        None,
        "the serial port of the bridge's service port, such as `/dev/ttyACM0`",
    ),
];

impl Setting {
    /// Finds a setting by its names.
    pub(super) fn named(section: &str, name: &str) -> Option<&'static Self> {
        SETTINGS.iter().find(|setting| setting.section == section && setting.name == name)
    }

    /// Checks a value.
    ///
    /// # Errors
    /// What was given and what is expected, with the place in the file.
    pub(super) fn check(&self, text: &str, place: &Place) -> Result<()> {
        let wrong = |expected: &str| {
            Err(anyhow!("{place}: {}.{} = {text:?}: expected {expected}", self.section, self.name))
        };
        match self.kind {
            Kind::Text => Ok(()),
            Kind::Name if text.is_empty() || text.contains(['+', '#', '/']) => {
                wrong("a name without +, # and /")
            }
            Kind::Name => Ok(()),
            Kind::Whole(low, high) => match text.parse() {
                Ok(number) if (low..=high).contains(&number) => Ok(()),
                _ => wrong(&format!("a whole number from {low} to {high}")),
            },
            Kind::Number(low, high) => match text.parse() {
                Ok(number) if (low..=high).contains(&number) => Ok(()),
                _ => wrong(&format!("a number from {low} to {high}")),
            },
            Kind::Switch if matches!(text, "true" | "false") => Ok(()),
            Kind::Switch => wrong("true or false"),
        }
    }
}

/// Refuses a name that no setting has, naming those that there are.
pub(super) fn unknown(section: &str, name: &str, place: &Place) -> Result<()> {
    let names: Vec<&str> =
        SETTINGS.iter().filter(|setting| setting.section == section).map(|setting| setting.name).collect();
    bail!("{place}: [{section}] has no setting {name:?}: expected one of {}", names.join(", "))
}
