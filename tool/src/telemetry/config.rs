//! The settings file: devices to read and broker to publish to. Every error is one line and names the line in the file.

use std::{
    collections::{BTreeMap, BTreeSet},
    env, fmt,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::{Context, Result, anyhow, bail, ensure};
use toml::de::{DeTable, DeValue};
use wsg_sim::{command_line::after_scheme, text};

use super::settings::{Place, REPEATED, SETTINGS, Setting, unknown};
use crate::bridge::client::GatewayAddress;

/// The settings, checked as far as possible without a broker.
#[derive(Debug)]
pub(super) struct Telemetry {
    pub(super) broker: Broker,
    pub(super) group: String,
    pub(super) node: String,
    pub(super) state_file: PathBuf,
    pub(super) store: usize,
    /// Maximum deviation of a command's timestamp from this computer's clock, in ms.
    pub(super) command_age_ms: u64,
    pub(super) data: Data,
    pub(super) devices: Vec<Device>,
}

#[derive(Debug)]
pub(super) struct Broker {
    /// Host name or address, and port.
    pub(super) host: String,
    /// Host name that its certificate must match, or `None` without TLS.
    pub(super) tls_name: Option<String>,
    pub(super) user: Option<String>,
    pub(super) password: Option<Secret>,
    pub(super) ca_file: Option<PathBuf>,
    pub(super) certificate: Option<(PathBuf, PathBuf)>,
    pub(super) client_id: String,
    pub(super) keep_alive: Duration,
    pub(super) reconnect: Duration,
}

/// A password, which is never printed.
pub(super) struct Secret(pub(super) String);

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("(hidden)")
    }
}

/// Sampling period and deadbands of the values.
#[derive(Clone, Copy, Debug)]
pub(super) struct Data {
    pub(super) period_ms: u16,
    pub(super) width_deadband: f32,
    pub(super) speed_deadband: f32,
    pub(super) force_deadband: f32,
}

#[derive(Debug)]
pub(super) struct Device {
    pub(super) name: String,
    pub(super) source: Source,
    pub(super) allows_commands: bool,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Source {
    Gripper(Address),
    /// Serial port that is connected to the bridge's service port, or `tcp://HOST[:502][?unit=1]` of a gateway.
    Bridge(String),
}

/// An address of a gripper.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Address {
    /// Host and port of the gripper.
    Tcp(String),
    /// Host and port of the gripper, and the local port to which it replies.
    Udp { host: String, local_port: u16 },
    /// Serial port, such as `/dev/ttyUSB0`.
    Serial(String),
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(host) => write!(f, "tcp://{host}"),
            Self::Udp { host, .. } => write!(f, "udp://{host}"),
            Self::Serial(device) => write!(f, "serial:{device}"),
        }
    }
}

/// A section of the file, with names and values checked.
struct Section {
    name: &'static str,
    place: Place,
    values: BTreeMap<&'static str, (String, Place)>,
}

impl Section {
    fn text(&self, name: &str) -> &str {
        let given = self.values.get(name).map(|(text, _)| text.as_str());
        let default = || Setting::named(self.name, name).and_then(|setting| setting.default);
        given.or_else(default).unwrap_or_default()
    }

    /// Returns an optional text, or `None` if it is empty.
    fn optional(&self, name: &str) -> Option<String> {
        Some(self.text(name)).filter(|text| !text.is_empty()).map(str::to_owned)
    }

    fn number<T: std::str::FromStr + Default>(&self, name: &str) -> T {
        self.text(name).parse().unwrap_or_default()
    }

    fn place(&self, name: &str) -> &Place {
        self.values.get(name).map_or(&self.place, |(_, place)| place)
    }

    fn wrong(&self, name: &str, what: impl fmt::Display) -> anyhow::Error {
        anyhow!("{}: {}.{name} = {:?}: {what}", self.place(name), self.name, self.text(name))
    }
}

impl Telemetry {
    /// Reads and checks the file.
    ///
    /// # Errors
    /// The file cannot be read or is invalid. Reports the first mistake.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = text::read(path).with_context(|| format!("cannot read {name}"))?;
        Self::parse(&name, &text)
    }

    /// Parses the text of a file. `name` is used in error messages.
    pub(super) fn parse(name: &str, text: &str) -> Result<Self> {
        let sections = sections(name, text)?;
        let one = |wanted: &'static str| sections.iter().find(|section| section.name == wanted);
        let empty = |name: &'static str| Section {
            name,
            place: Place { file: name.to_owned(), line: 1 },
            values: BTreeMap::new(),
        };
        let broker = one("broker").with_context(|| format!("{name}: missing section [broker]"))?;
        let node = one("node").with_context(|| format!("{name}: missing section [node]"))?;
        let no_data = empty("data");
        let data = one("data").unwrap_or(&no_data);
        let mut devices: Vec<Device> = Vec::new();
        let mut names = BTreeSet::new();
        for section in sections.iter().filter(|section| REPEATED.contains(&section.name)) {
            let device = Device {
                name: section.text("name").to_owned(),
                source: source_of(section)?,
                allows_commands: section.text("allow_commands") == "true",
            };
            if !names.insert(device.name.clone()) {
                return Err(section.wrong("name", "another device has this name"));
            }
            devices.push(device);
        }
        ensure!(!devices.is_empty(), "{name}: no [[gripper]] or [[bridge]] section");
        ensure!(devices.len() < usize::from(u16::MAX), "{name}: too many devices; the maximum is 65534");
        let (group, node_name) = (node.text("group").to_owned(), node.text("name").to_owned());
        Ok(Self {
            broker: broker_of(broker, &group, &node_name)?,
            group,
            node: node_name,
            state_file: node.text("state_file").into(),
            store: node.number("store"),
            command_age_ms: node.number("command_age_ms"),
            data: Data {
                period_ms: data.number("period_ms"),
                width_deadband: data.number("width_deadband"),
                speed_deadband: data.number("speed_deadband"),
                force_deadband: data.number("force_deadband"),
            },
            devices,
        })
    }
}

/// Parses the sections of a file and checks names and values against the table.
fn sections(file: &str, text: &str) -> Result<Vec<Section>> {
    let place_of = |at: usize| Place {
        file: file.to_owned(),
        line: 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count(),
    };
    let table = DeTable::parse(text).map_err(|error| {
        let what = error.message().lines().collect::<Vec<_>>().join(", ");
        anyhow!("{}: {what}", place_of(error.span().map_or(0, |span| span.start)))
    })?;
    let mut sections = Vec::new();
    for (key, value) in table.get_ref() {
        let place = place_of(key.span().start);
        let key: &str = key.get_ref();
        let Some(name) = SETTINGS.iter().map(|setting| setting.section).find(|name| *name == key) else {
            bail!(
                "{place}: unknown section {key:?}; expected [broker], [node], [data], [[gripper]] or [[bridge]]"
            );
        };
        let is_repeated = REPEATED.contains(&name);
        match value.get_ref() {
            DeValue::Array(items) if is_repeated => {
                for item in items.iter() {
                    let place = place_of(item.span().start);
                    let DeValue::Table(content) = item.get_ref() else {
                        bail!("{place}: expected [[{name}]] and its settings");
                    };
                    sections.push(section_of(name, place, content, &place_of)?);
                }
            }
            DeValue::Table(content) if !is_repeated => {
                sections.push(section_of(name, place, content, &place_of)?);
            }
            _ if is_repeated => bail!("{place}: expected [[{name}]], in double brackets"),
            _ => bail!("{place}: expected [{name}] and its settings"),
        }
    }
    Ok(sections)
}

fn section_of(
    name: &'static str,
    place: Place,
    content: &DeTable<'_>,
    place_of: &impl Fn(usize) -> Place,
) -> Result<Section> {
    let mut values = BTreeMap::new();
    for (key, value) in content {
        let place = place_of(key.span().start);
        let key: &str = key.get_ref();
        let Some(setting) = Setting::named(name, key) else {
            unknown(name, key, &place)?;
            continue;
        };
        let text = match value.get_ref() {
            DeValue::String(text) => text.clone().into_owned(),
            DeValue::Integer(number) => number.as_str().to_owned(),
            DeValue::Float(number) => number.as_str().to_owned(),
            DeValue::Boolean(on) => on.to_string(),
            DeValue::Datetime(_) | DeValue::Array(_) | DeValue::Table(_) => {
                bail!("{place}: {name}.{key} is a date, list or table; expected text or a number")
            }
        };
        setting.check(&text, &place)?;
        values.insert(setting.name, (text, place));
    }
    let required = SETTINGS.iter().filter(|setting| setting.section == name && setting.default.is_none());
    for setting in required {
        ensure!(
            values.get(setting.name).is_some_and(|(text, _)| !text.is_empty()),
            "{place}: {} {:?} is missing: {}",
            if REPEATED.contains(&name) { format!("[[{name}]]") } else { format!("[{name}]") },
            setting.name,
            setting.meaning
        );
    }
    Ok(Section { name, place, values })
}

fn broker_of(section: &Section, group: &str, node: &str) -> Result<Broker> {
    let address = section.text("address");
    let (rest, port, is_tls) = match (after_scheme(address, "mqtt://"), after_scheme(address, "mqtts://")) {
        (Some(rest), _) => (rest, 1883, false),
        (_, Some(rest)) => (rest, 8883, true),
        _ => return Err(section.wrong("address", "expected mqtt://HOST[:PORT] or mqtts://HOST[:PORT]")),
    };
    let (name, host) = host_and_port(rest, port)
        .ok_or_else(|| section.wrong("address", "expected a host and a port after ://"))?;
    for name in ["ca_file", "certificate_file", "key_file"] {
        if !is_tls && !section.text(name).is_empty() {
            return Err(section.wrong(name, "certificates require mqtts://"));
        }
    }
    let certificate = match (section.optional("certificate_file"), section.optional("key_file")) {
        (Some(certificate), Some(key)) => Some((certificate.into(), key.into())),
        (None, None) => None,
        (Some(_), None) => return Err(section.wrong("certificate_file", "requires key_file")),
        (None, Some(_)) => return Err(section.wrong("key_file", "requires certificate_file")),
    };
    let password = password_of(section)?;
    if password.is_some() && section.text("user").is_empty() {
        bail!("{}: a password requires a user", section.place("user"));
    }
    let seconds: f32 = section.number("reconnect_s");
    let client_id = section.optional("client_id").unwrap_or_else(|| format!("wsg-{group}-{node}"));
    Ok(Broker {
        host,
        tls_name: is_tls.then_some(name),
        user: section.optional("user"),
        password,
        ca_file: section.optional("ca_file").map(PathBuf::from),
        certificate,
        client_id,
        keep_alive: Duration::from_secs(section.number("keep_alive_s")),
        reconnect: Duration::from_secs_f32(seconds),
    })
}

fn password_of(section: &Section) -> Result<Option<Secret>> {
    let password = match (section.optional("password_file"), section.optional("password_env")) {
        (None, None) => return Ok(None),
        (Some(_), Some(_)) => return Err(section.wrong("password_env", "conflicts with password_file")),
        (Some(file), None) => text::read(file.as_ref())
            .map_err(|error| section.wrong("password_file", error))?
            .lines()
            .next()
            .unwrap_or_default()
            .to_owned(),
        (None, Some(variable)) => {
            env::var(&variable).map_err(|_| section.wrong("password_env", "environment variable not set"))?
        }
    };
    if password.is_empty() {
        let name = if section.text("password_file").is_empty() { "password_env" } else { "password_file" };
        return Err(section.wrong(name, "the password is empty"));
    }
    Ok(Some(Secret(password)))
}

fn source_of(section: &Section) -> Result<Source> {
    if section.name == "bridge" {
        let device = section.text("device");
        if after_scheme(device, "tcp://").is_some() {
            device.parse::<GatewayAddress>().map_err(|error| section.wrong("device", error))?;
        }
        return Ok(Source::Bridge(device.to_owned()));
    }
    let expected = "expected tcp://HOST[:1000], udp://HOST[:1500][?local=1501] or serial:DEVICE";
    let address = address_of(section.text("address"));
    address.map(Source::Gripper).ok_or_else(|| section.wrong("address", expected))
}

fn address_of(text: &str) -> Option<Address> {
    if let Some(rest) = after_scheme(text, "tcp://") {
        return Some(Address::Tcp(host_and_port(rest, 1000)?.1));
    }
    if let Some(rest) = after_scheme(text, "udp://") {
        let (rest, local_port) = match rest.split_once("?local=") {
            Some((rest, port)) => (rest, port.parse().ok()?),
            None => (rest, 1501),
        };
        return Some(Address::Udp { host: host_and_port(rest, 1500)?.1, local_port });
    }
    let device = after_scheme(text, "serial:")?;
    (!device.is_empty()).then(|| Address::Serial(device.to_owned()))
}

/// Splits an address into the host and the host with port. An IPv6 address must be in brackets.
fn host_and_port(text: &str, default: u16) -> Option<(String, String)> {
    let text = text.trim_end_matches('/');
    let (host, port) = match text.rsplit_once(':') {
        Some((host, port)) if !port.ends_with(']') => (host, port.parse().ok()?),
        _ => (text, default),
    };
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    let is_one = bare.is_some() || !host.contains([':', '/', '?', '@']);
    (!host.is_empty() && is_one).then(|| (bare.unwrap_or(host).to_owned(), format!("{host}:{port}")))
}

#[cfg(test)]
mod tests;
