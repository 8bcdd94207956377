//! The table of `wsg telemetry` settings, used to check the file and to generate docs/tool.md.

use std::fmt;

use anyhow::{Result, anyhow, bail};

/// A line in a file, for error messages.
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

/// The kind of value that a setting expects.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    Text,
    /// A topic level: not empty, without `+`, `#` and `/`.
    Name,
    /// A whole number in this range.
    Whole(u32, u32),
    /// A number in this range.
    Number(f32, f32),
    /// `true` or `false`.
    Switch,
}

/// A setting in the table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setting {
    pub(super) section: &'static str,
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    /// Default as written in the file: `None` if the setting is required, empty if there is no default.
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

/// Sections that may occur any number of times, as `[[name]]`.
pub(super) const REPEATED: [&str; 2] = ["gripper", "bridge"];

/// All settings, in the order of the document.
pub(super) const SETTINGS: &[Setting] = &[
    setting("broker", "address", Kind::Text, None, "`mqtt://HOST[:1883]`, or `mqtts://HOST[:8883]` for TLS"),
    setting("broker", "user", Kind::Text, Some(""), "user name"),
    setting("broker", "password_file", Kind::Text, Some(""), "file whose first line is the password"),
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
        "CA certificates (PEM) for the broker's certificate instead of the system's",
    ),
    setting(
        "broker",
        "certificate_file",
        Kind::Text,
        Some(""),
        "client certificate (PEM), for brokers that require one",
    ),
    setting("broker", "key_file", Kind::Text, Some(""), "private key (PEM) of the client certificate"),
    setting(
        "broker",
        "client_id",
        Kind::Text,
        Some(""),
        "MQTT client identifier; none: `wsg-GROUP-NODE`. Programs with the same identifier disconnect each other",
    ),
    setting(
        "broker",
        "keep_alive_s",
        Kind::Whole(1, 600),
        Some("10"),
        "time without a response after which the broker counts as lost, in s",
    ),
    setting(
        "broker",
        "reconnect_s",
        Kind::Number(0.1, 600.0),
        Some("2"),
        "delay before reconnecting to the broker, in s",
    ),
    setting("node", "group", Kind::Name, None, "Sparkplug group ID, such as the plant's name"),
    setting("node", "name", Kind::Name, None, "Sparkplug edge node ID, unique in the group"),
    setting(
        "node",
        "state_file",
        Kind::Text,
        None,
        "file that keeps `bdSeq` across restarts, created in an existing folder",
    ),
    setting(
        "node",
        "store",
        Kind::Whole(1, 10_000_000),
        Some("100000"),
        "samples kept in memory while the broker is unavailable",
    ),
    setting(
        "node",
        "command_age_ms",
        Kind::Whole(100, 60_000),
        Some("2000"),
        "maximum deviation of a command's timestamp from this computer's clock, in ms",
    ),
    setting(
        "data",
        "period_ms",
        Kind::Whole(10, 60_000),
        Some("100"),
        "minimum interval between two samples of a device, in ms",
    ),
    setting(
        "data",
        "width_deadband",
        Kind::Number(0.0, 1_000.0),
        Some("0.05"),
        "minimum change to be sent, in mm",
    ),
    setting(
        "data",
        "speed_deadband",
        Kind::Number(0.0, 1_000.0),
        Some("1"),
        "minimum change to be sent, in mm/s",
    ),
    setting(
        "data",
        "force_deadband",
        Kind::Number(0.0, 1_000.0),
        Some("0.5"),
        "minimum change to be sent, in N",
    ),
    setting("gripper", "name", Kind::Name, None, "Sparkplug device ID, unique in this file"),
    setting(
        "gripper",
        "address",
        Kind::Text,
        None,
        "`tcp://HOST[:1000]`, `udp://HOST[:1500][?local=1501]` (port of the replies), or `serial:DEVICE` (115 200 bit/s, 8N1)",
    ),
    setting(
        "gripper",
        "allow_commands",
        Kind::Switch,
        Some("false"),
        "lets hosts command this gripper and move its fingers",
    ),
    setting("bridge", "name", Kind::Name, None, "Sparkplug device ID, unique in this file"),
    setting(
        "bridge",
        "device",
        Kind::Text,
        None,
        "the bridge's service port, such as `/dev/ttyACM0`, or `tcp://HOST[:502][?unit=1]` of a gateway",
    ),
];

impl Setting {
    /// Finds a setting by section and name.
    pub(super) fn named(section: &str, name: &str) -> Option<&'static Self> {
        SETTINGS.iter().find(|setting| setting.section == section && setting.name == name)
    }

    /// Checks a value against the kind of the setting.
    ///
    /// # Errors
    /// The value is invalid. The message states the line, the value and the expected one.
    pub(super) fn check(&self, text: &str, place: &Place) -> Result<()> {
        let wrong = |expected: &str| {
            Err(anyhow!("{place}: {}.{} = {text:?}; expected {expected}", self.section, self.name))
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

/// Returns an error for an unknown setting, which lists the known ones.
pub(super) fn unknown(section: &str, name: &str, place: &Place) -> Result<()> {
    let names: Vec<&str> =
        SETTINGS.iter().filter(|setting| setting.section == section).map(|setting| setting.name).collect();
    bail!("{place}: [{section}] has no setting {name:?}; expected one of {}", names.join(", "))
}
