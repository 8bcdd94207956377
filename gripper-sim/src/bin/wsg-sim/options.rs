//! The options: one table for the command line, the configuration file, `--help` and `docs/simulator.md`.

use anyhow::{Context, Result, anyhow, bail};
#[cfg(feature = "profinet")]
use bus_profinet::{StationName, Stored};
use lexopt::{Arg, Parser, ValueExt};
use std::fmt::Write as _;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use toml::de::{DeTable, DeValue};
use wsg_protocol::can::Identifiers;
#[cfg(feature = "profinet")]
use wsg_sim::server::ProfinetLine;
use wsg_sim::server::{CanBus, CanLine, Lines, Profile, SerialLine, UdpLine};
use wsg_sim::{Config, Direction, Finger, Model, Part, SilenceReaction, Tag};

const LOOPBACK: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
/// The TCP address when no line is asked for: the gripper's own port, on this machine only.
const DEFAULT_TCP: SocketAddr = SocketAddr::new(LOOPBACK, 1_000);
const DEFAULT_UDP_REMOTE_PORT: u16 = 1_501;

/// What the command line asks for.
#[derive(Debug)]
pub(crate) enum Request {
    Serve(Box<Options>),
    Help,
    Version,
}

/// Everything that `wsg-sim` is told.
#[derive(Debug)]
pub(crate) struct Options {
    pub(crate) config: Config,
    pub(crate) lines: Lines,
    /// No line was asked for: the gripper's own is served.
    pub(crate) is_default_line: bool,
    pub(crate) log: Option<LogTo>,
}

/// Where the log goes.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum LogTo {
    Stdout,
    File(PathBuf),
}

/// What was asked for so far.
#[derive(Debug, Default)]
struct Draft {
    config: Config,
    lines: Lines,
    log: Option<LogTo>,
    udp_address: Option<SocketAddr>,
    udp_remote_port: Option<u16>,
    can_bus: Option<CanBus>,
    can_id: Option<Identifiers>,
    profibus_address: Option<u8>,
    #[cfg(feature = "profinet")]
    profinet: Option<String>,
    /// What is given of it, and the option that began it.
    #[cfg(feature = "profinet")]
    stored: Option<(&'static str, Stored)>,
    /// The file that options came from.
    #[cfg(feature = "profinet")]
    file: Option<PathBuf>,
    bus_reaction: Option<SilenceReaction>,
}

/// One option.
struct Setting {
    /// Behind two hyphens on the command line, by itself in the file.
    name: &'static str,
    /// What its value is called; empty: a switch, which has none.
    value: &'static str,
    /// What counts without it.
    default: &'static str,
    /// What it does, for `--help` and the document.
    meaning: &'static str,
    /// What its value may be.
    expected: &'static str,
    /// Takes a value; `None` if it is wrong.
    take: fn(&mut Draft, &str) -> Option<()>,
}

const fn setting(
    name: &'static str,
    value: &'static str,
    default: &'static str,
    expected: &'static str,
    take: fn(&mut Draft, &str) -> Option<()>,
    meaning: &'static str,
) -> Setting {
    Setting { name, value, default, meaning, expected, take }
}

/// Takes no value in a file, and may be given again.
const CONFIG: &str = "config";
const CONTROL_HOST: &str = "control-host";

const ADDRESS: &str = "an address with a port, such as 127.0.0.1:1000";
const LINE: &str = "pty, unix:PATH or a device such as /dev/ttyUSB0 or COM3";
const FINGERS: &str = "none, generic, fmf or dsa";
const U16: &str = "a number from 0 to 65535";
const LENGTH: &str = "a number from 0 to 1000";
const POSITIVE: &str = "a number above 0";
const SWITCH: &str = "true or false";
#[cfg(feature = "profinet")]
const MAINTENANCE: [&str; 4] = ProfinetLine::MAINTENANCE;

/// Every option, in the order in which they are shown.
const SETTINGS: &[Setting] = &[
    setting(
        CONFIG,
        "FILE",
        "",
        "a file",
        |_, _| None,
        "options from a TOML file, `name = value` with the names of this table; the command line counts more",
    ),
    setting(
        "tcp",
        "ADDR",
        "127.0.0.1:1000 (or 11000, see above), if no other line is asked for",
        ADDRESS,
        |draft, text| {
            draft.lines.tcp = Some(parsed(text)?);
            Some(())
        },
        "listen for TCP",
    ),
    setting(
        "udp",
        "ADDR",
        "",
        ADDRESS,
        |draft, text| {
            draft.udp_address = Some(parsed(text)?);
            Some(())
        },
        "listen for UDP; 1500 is the port in the field",
    ),
    setting(
        "udp-remote-port",
        "PORT",
        "1501",
        "a port from 1 to 65535",
        |draft, text| {
            draft.udp_remote_port = Some(port(text)?);
            Some(())
        },
        "answers go to this port of whoever asked last, whatever port that was; not that of `--udp`",
    ),
    setting(
        "gcl",
        "ADDR",
        "",
        ADDRESS,
        |draft, text| {
            draft.lines.gcl = Some(parsed(text)?);
            Some(())
        },
        "listen for the text protocol over TCP, beside the binary one or alone ([gcl.md](gcl.md))",
    ),
    setting(
        "gcl-udp",
        "ADDR",
        "",
        ADDRESS,
        |draft, text| {
            draft.lines.gcl_udp = Some(parsed(text)?);
            Some(())
        },
        "listen for the text protocol over UDP; answers go to the port that asked",
    ),
    setting(
        "serial",
        "LINE",
        "",
        LINE,
        |draft, text| {
            draft.lines.serial = Some(serial(text)?);
            Some(())
        },
        "a serial line: `pty` opens a pseudo terminal and says its path, `unix:PATH` listens on a Unix socket as \
         emulators have it for a UART, any other path is a terminal device or a port such as COM3, set to 115200 8N1",
    ),
    setting(
        "can",
        "IFACE",
        "",
        "an interface, such as can0",
        |draft, text| {
            draft.can_bus = Some(interface(text)?);
            Some(())
        },
        "CAN by an interface of Linux SocketCAN",
    ),
    setting(
        "slcan",
        "LINE",
        "",
        LINE,
        |draft, text| {
            draft.can_bus = Some(CanBus::Slcan(serial(text)?));
            Some(())
        },
        "CAN by SLCAN: with `pty` and `unix:PATH` the gripper is on the bus of the adapter that a host opens there, \
         behind a terminal device or a port an adapter is expected, 500 kbit/s",
    ),
    setting(
        "can-id",
        "N",
        "0x120",
        "an identifier from 0 to 0x7FE",
        |draft, text| {
            draft.can_id = Some(identifiers(text)?);
            Some(())
        },
        "listen to this identifier, send on the next",
    ),
    setting(
        "modbus",
        "ADDR",
        "",
        ADDRESS,
        |draft, text| {
            draft.lines.modbus = Some(parsed(text)?);
            Some(())
        },
        "listen for Modbus/TCP; port 502 on the real gripper",
    ),
    setting(
        "modbus-swap-bytes",
        "",
        "off",
        SWITCH,
        |draft, _| {
            draft.config.modbus_swap_bytes = true;
            Some(())
        },
        "low byte first in the numbers of the registers; flags stay",
    ),
    setting(
        "bus-timeout",
        "MS",
        "0: for ever",
        U16,
        |draft, text| {
            draft.config.bus_timeout_ms = parsed(text)?;
            Some(())
        },
        "how long a Modbus master that has written may be silent",
    ),
    setting(
        "bus-reaction",
        "WHAT",
        "`stop`",
        "hold, stop or fast-stop",
        |draft, text| {
            draft.bus_reaction = Some(reaction(text)?);
            Some(())
        },
        "what is done then, and when the master of PROFIBUS or PROFINET has left: also `hold`, `fast-stop`; a jog ends in any case",
    ),
    setting(
        "profibus",
        "LINE",
        "",
        LINE,
        |draft, text| {
            draft.lines.profibus = Some(serial(text)?);
            Some(())
        },
        "a PROFIBUS DP slave on a serial line, as for `--serial`",
    ),
    setting(
        "profibus-address",
        "N",
        "7",
        "an address from 0 to 125",
        |draft, text| {
            draft.profibus_address = Some(station(text)?);
            Some(())
        },
        "its address, 0 to 125",
    ),
    #[cfg(feature = "profinet")]
    setting(
        "profinet",
        "IFACE",
        "",
        "a network interface, such as eth0",
        |draft, text| {
            draft.profinet = Some((!text.is_empty()).then(|| text.to_owned())?);
            Some(())
        },
        "a PROFINET IO device on a network interface, Linux only ([profinet.md](profinet.md))",
    ),
    #[cfg(feature = "profinet")]
    setting(
        ProfinetLine::STATION,
        "NAME",
        "none: a controller gives it",
        "a name of a to z, 0 to 9, hyphens and dots",
        |draft, text| {
            draft.stored(ProfinetLine::STATION).name = StationName::new(text)?;
            Some(())
        },
        "its name; kept in the file of `--config` when a controller sets another",
    ),
    #[cfg(feature = "profinet")]
    setting(
        ProfinetLine::IP,
        "IP/BITS[,ROUTER]",
        "none: a controller gives it",
        "an address such as 192.168.0.5/24, with a router 192.168.0.5/24,192.168.0.1",
        |draft, text| {
            draft.stored(ProfinetLine::IP).ip = ProfinetLine::ip_of_text(text)?;
            Some(())
        },
        "its IP address, which must not be the interface's; kept likewise",
    ),
    #[cfg(feature = "profinet")]
    setting(
        MAINTENANCE[0],
        "TEXT",
        "",
        "up to 32 letters of Latin-1",
        |draft, text| {
            let field = ProfinetLine::maintenance_of_text(text)?;
            draft.stored(MAINTENANCE[0]).maintenance.function = field;
            Some(())
        },
        "what it is there for, in its records (I&M 1); kept likewise",
    ),
    #[cfg(feature = "profinet")]
    setting(
        MAINTENANCE[1],
        "TEXT",
        "",
        "up to 22 letters of Latin-1",
        |draft, text| {
            let field = ProfinetLine::maintenance_of_text(text)?;
            draft.stored(MAINTENANCE[1]).maintenance.location = field;
            Some(())
        },
        "where it is (I&M 1); kept likewise",
    ),
    #[cfg(feature = "profinet")]
    setting(
        MAINTENANCE[2],
        "TEXT",
        "",
        "up to 16 letters of Latin-1, such as \"2026-11-23 16:00\"",
        |draft, text| {
            let field = ProfinetLine::maintenance_of_text(text)?;
            draft.stored(MAINTENANCE[2]).maintenance.date = field;
            Some(())
        },
        "when it was installed (I&M 2); kept likewise",
    ),
    #[cfg(feature = "profinet")]
    setting(
        MAINTENANCE[3],
        "TEXT",
        "",
        "up to 54 letters of Latin-1",
        |draft, text| {
            let field = ProfinetLine::maintenance_of_text(text)?;
            draft.stored(MAINTENANCE[3]).maintenance.descriptor = field;
            Some(())
        },
        "anything about it (I&M 3); kept likewise",
    ),
    setting(
        "no-checksum-check",
        "",
        "off",
        SWITCH,
        |draft, _| {
            draft.config.check_checksum = false;
            Some(())
        },
        "take frames whatever the two bytes of their checksum are; they must be there",
    ),
    setting(
        "answer-bad-checksum",
        "",
        "off",
        SWITCH,
        |draft, _| {
            draft.config.answer_bad_checksum = true;
            Some(())
        },
        "answer E_CHECKSUM_ERROR to a wrong checksum; otherwise there is silence",
    ),
    setting(
        "updates-idle",
        "SECONDS",
        "0: never",
        U16,
        |draft, text| {
            draft.config.updates_idle_s = parsed(text)?;
            Some(())
        },
        "end the automatic updates of a client by UDP, serial line or CAN that has sent nothing for so long",
    ),
    setting(
        "no-disconnect-error",
        "",
        "off",
        SWITCH,
        |draft, _| {
            draft.config.disconnect_error = false;
            Some(())
        },
        "no FAST STOP when a TCP connection ends unannounced",
    ),
    setting(
        "profile",
        "PROFILE",
        "`instant`",
        "instant or real",
        |draft, text| {
            draft.lines.profile = profile(text)?;
            Some(())
        },
        "how soon the command interface answers: at once, or as late as real grippers do by field reports",
    ),
    setting(
        "model",
        "MODEL",
        "`wsg50-110`",
        "wsg50-110, wsg50-210, wsg32, wsg25 or wsg70",
        |draft, text| {
            draft.config.model = Model::from_name(text)?;
            Some(())
        },
        "also `wsg50-210`, `wsg32`, `wsg25`, `wsg70`; figures in [models.md](models.md)",
    ),
    setting(
        "serial-number",
        "N",
        "1",
        "a number from 0 to 4294967295",
        |draft, text| {
            draft.config.serial_number = parsed(text)?;
            Some(())
        },
        "what Get System Information answers",
    ),
    setting(
        "tag",
        "TEXT",
        "none",
        "up to 64 printable ASCII characters",
        |draft, text| {
            draft.config.tag = Tag::new(text).ok()?;
            Some(())
        },
        "what Get Device Tag answers, up to 64 ASCII characters",
    ),
    setting(
        "finger1",
        "KIND",
        "`none`",
        FINGERS,
        |draft, text| {
            draft.config.fingers[0] = Finger::from_name(text)?;
            Some(())
        },
        "also `generic`, `fmf`, `dsa`",
    ),
    setting(
        "finger2",
        "KIND",
        "`none`",
        FINGERS,
        |draft, text| {
            draft.config.fingers[1] = Finger::from_name(text)?;
            Some(())
        },
        "also `generic`, `fmf`, `dsa`",
    ),
    setting(
        "homing-default",
        "DIR",
        "`out`",
        "out or in",
        |draft, text| {
            draft.config.homing_default = direction(text)?;
            Some(())
        },
        "also `in`",
    ),
    setting(
        "homing-speed",
        "MM_S",
        "the model's",
        POSITIVE,
        |draft, text| {
            draft.config.homing_speed = Some(positive(text)?);
            Some(())
        },
        "speed of homing, within the model's limits",
    ),
    setting(
        "part-width-tolerance",
        "MM",
        "5",
        LENGTH,
        |draft, text| {
            draft.config.part_width_tolerance = length(text)?;
            Some(())
        },
        "how much before the nominal width of a grip a part may be met; one met earlier is the wrong one",
    ),
    setting(
        "clamping-travel",
        "MM",
        "5",
        LENGTH,
        |draft, text| {
            draft.config.clamping_travel = length(text)?;
            Some(())
        },
        "how far a grip goes on to build up its force; with the stroke or more any part is the right one, so that a grip \
         at 0 mm holds it",
    ),
    setting(
        "force",
        "N",
        "the model's",
        POSITIVE,
        |draft, text| {
            draft.config.force_limit = Some(positive(text)?);
            Some(())
        },
        "force limit after switching on, within the model's limits",
    ),
    setting(
        "acceleration",
        "MM_S2",
        "the model's",
        POSITIVE,
        |draft, text| {
            draft.config.acceleration = Some(positive(text)?);
            Some(())
        },
        "acceleration after switching on, within the model's limits",
    ),
    setting(
        "speed",
        "MM_S",
        "100",
        POSITIVE,
        |draft, text| {
            draft.config.speed = positive(text)?;
            Some(())
        },
        "speed of MOVE and GRIP of the text protocol, and of the page, where none is given",
    ),
    setting(
        "release-distance",
        "MM",
        "10",
        LENGTH,
        |draft, text| {
            draft.config.release_distance = length(text)?;
            Some(())
        },
        "distance of RELEASE of the text protocol where none is given",
    ),
    setting(
        "release-speed",
        "MM_S",
        "the model's greatest",
        POSITIVE,
        |draft, text| {
            draft.config.release_speed = Some(positive(text)?);
            Some(())
        },
        "speed of RELEASE of the text protocol where none is given",
    ),
    setting(
        "part",
        "WIDTH[:STIFFNESS]",
        "`none`",
        "none, or WIDTH_MM[:STIFFNESS_N_PER_MM] with numbers above 0",
        |draft, text| {
            draft.config.part = part(text)?;
            Some(())
        },
        "what lies between the fingers, in mm and N/mm",
    ),
    setting(
        "time-scale",
        "X",
        "1",
        "a number from 0.01 to 1000",
        |draft, text| {
            draft.config.time_scale = time_scale(text)?;
            Some(())
        },
        "the fingers travel X times as fast, 0.01 to 1000; periods and time-outs stay",
    ),
    #[cfg(feature = "script")]
    setting(
        "script",
        "FILE",
        "",
        "a file",
        |draft, text| {
            draft.lines.script = Some(text.into());
            Some(())
        },
        "a Lua script that runs on the gripper ([scripts.md](scripts.md))",
    ),
    setting(
        "control",
        "ADDR",
        "",
        "an address with a port, such as 127.0.0.1:8080, or a port",
        |draft, text| {
            draft.lines.control = Some(control(text)?);
            Some(())
        },
        "the page and the control interface; a port alone is one of this machine",
    ),
    setting(
        CONTROL_HOST,
        "HOST",
        "",
        "a name or address without a port, such as bench.example",
        |draft, text| {
            draft.lines.control_hosts.push(host(text)?);
            Some(())
        },
        "a name of this machine that requests to `--control` may be for, beside `localhost` and its address; may be \
         given again, in a file as a list",
    ),
    setting(
        "seed",
        "N",
        "0",
        "a number from 0 to 18446744073709551615",
        |draft, text| {
            draft.lines.seed = parsed(text)?;
            Some(())
        },
        "which frames line faults hit",
    ),
    setting(
        "log",
        "FILE",
        "",
        "a file, or -",
        |draft, text| {
            draft.log = Some(if text == "-" { LogTo::Stdout } else { LogTo::File(text.into()) });
            Some(())
        },
        "each frame with time, line, direction, bytes and meaning, at once; `-` is standard output. The gripper does \
         not wait for whoever takes the log slowly: lines are left out then, and how many is said",
    ),
];

fn named(name: &str) -> Result<&'static Setting> {
    let found = SETTINGS.iter().find(|setting| setting.name == name);
    found.with_context(|| format!("{name} is unknown; expected options as --help lists them"))
}

impl Setting {
    /// `--tcp ADDR`
    fn usage(&self) -> String {
        format!("--{} {}", self.name, self.value).trim_end().to_owned()
    }

    /// `shown`: how the value was given.
    fn take(&self, draft: &mut Draft, text: &str, shown: &str) -> Result<()> {
        (self.take)(draft, text).with_context(|| format!("{shown} is wrong; expected {}", self.expected))
    }
}

/// What `--help` shows.
pub(crate) fn usage() -> String {
    let mut usage = "A virtual gripper of the WSG series.\n\nUsage: wsg-sim [OPTION]...\n\n".to_owned();
    for setting in SETTINGS {
        let default = match setting.default {
            "" => String::new(),
            default => format!(" (default: {default})"),
        };
        // Writing to a string does not fail.
        let _ = writeln!(usage, "  {}\n        {}{default}", setting.usage(), setting.meaning);
    }
    usage + "  --help\n        show this\n  --version\n        show the version\n"
}

/// Reads the command line, and the file that it names.
pub(crate) fn parse(mut parser: Parser) -> Result<Request> {
    let mut given: Vec<(&Setting, String)> = Vec::new();
    let mut file = None;
    while let Some(argument) = parser.next()? {
        let Arg::Long(name) = argument else {
            return Err(anyhow!(argument.unexpected()).context("expected options as --help lists them"));
        };
        let name = name.to_owned();
        match name.as_str() {
            "help" => return Ok(Request::Help),
            "version" => return Ok(Request::Version),
            _ => {}
        }
        let setting = named(&name).with_context(|| format!("--{name}")).map_err(flat)?;
        if setting.value.is_empty() {
            given.push((setting, String::new()));
            continue;
        }
        let text = parser.value().and_then(|value| value.string());
        let text = text.with_context(|| format!("--{name} expects {}", setting.expected))?;
        if setting.name == CONFIG {
            file = Some(PathBuf::from(text));
        } else {
            given.push((setting, text));
        }
    }
    let mut draft = Draft::default();
    if let Some(path) = file {
        take_file(&mut draft, &path)?;
        #[cfg(feature = "profinet")]
        {
            draft.file = Some(path);
        }
    }
    for (setting, text) in given {
        setting.take(&mut draft, &text, &format!("--{} {text:?}", setting.name))?;
    }
    draft.finish()
}

/// Takes the options of a file.
fn take_file(draft: &mut Draft, path: &Path) -> Result<()> {
    let name = path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("--config {name} cannot be read"))?;
    let line_of = |at: usize| 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
    let table = DeTable::parse(&text).map_err(|error| {
        let line = line_of(error.span().map_or(0, |span| span.start));
        let what = error.message().lines().collect::<Vec<_>>().join(", ");
        anyhow!("{name}, line {line}: {what}; expected TOML")
    })?;
    for (key, value) in table.get_ref() {
        let place = format!("{name}, line {}", line_of(key.span().start));
        let key: &str = key.get_ref();
        let setting = named(key).with_context(|| place.clone()).map_err(flat)?;
        if setting.name == CONFIG {
            bail!("{place}: {key} is for the command line alone");
        }
        for text in texts(setting, value.get_ref()).with_context(|| {
            let expected = setting.expected;
            format!("{place}: {key} is of another kind; expected {expected}, a text where it is no number")
        })? {
            setting.take(draft, &text, &format!("{place}: {key} = {text:?}"))?;
        }
    }
    Ok(())
}

/// The values of an option in a file, as the command line would have them.
fn texts(setting: &Setting, value: &DeValue<'_>) -> Option<Vec<String>> {
    let text = match value {
        DeValue::Boolean(on) if setting.value.is_empty() => {
            return Some(if *on { vec![String::new()] } else { vec![] });
        }
        _ if setting.value.is_empty() => return None,
        DeValue::Array(items) if setting.name == CONTROL_HOST => {
            let texts: Option<Vec<_>> = items.iter().map(|item| texts(setting, item.get_ref())).collect();
            return Some(texts?.concat());
        }
        DeValue::String(text) => text.clone().into_owned(),
        DeValue::Integer(number) => i128::from_str_radix(number.as_str(), number.radix()).ok()?.to_string(),
        DeValue::Float(number) => number.as_str().to_owned(),
        DeValue::Boolean(_) | DeValue::Datetime(_) | DeValue::Array(_) | DeValue::Table(_) => return None,
    };
    Some(vec![text])
}

/// An error and its context in one sentence, the other way round than a chain.
fn flat(error: anyhow::Error) -> anyhow::Error {
    let parts: Vec<String> = error.chain().map(ToString::to_string).collect();
    anyhow!(parts.join(": "))
}

impl Draft {
    /// What is given of a PROFINET station, for the option of this name to change.
    #[cfg(feature = "profinet")]
    fn stored(&mut self, name: &'static str) -> &mut Stored {
        &mut self.stored.get_or_insert((name, Stored::NONE)).1
    }

    /// Puts together what belongs together.
    fn finish(self) -> Result<Request> {
        let Self { mut config, mut lines, log, .. } = self;
        lines.udp = match (self.udp_address, self.udp_remote_port) {
            (Some(address), port) => {
                let remote_port = port.unwrap_or(DEFAULT_UDP_REMOTE_PORT);
                if remote_port == address.port() {
                    bail!(
                        "--udp {address} listens on the port that answers go to; \
                         expected another there, or in --udp-remote-port"
                    );
                }
                Some(UdpLine { address, remote_port })
            }
            (None, Some(_)) => bail!("--udp-remote-port is of no use without --udp ADDR"),
            (None, None) => None,
        };
        lines.can = match (self.can_bus, self.can_id) {
            (Some(bus), id) => Some(CanLine { bus, identifiers: id.unwrap_or(Identifiers::DEFAULT) }),
            (None, Some(_)) => bail!("--can-id is of no use without --can IFACE or --slcan LINE"),
            (None, None) => None,
        };
        #[cfg(feature = "profinet")]
        {
            if let (None, Some((name, _))) = (&self.profinet, &self.stored) {
                bail!("--{name} is of no use without --profinet IFACE");
            }
            let stored = self.stored.map_or(Stored::NONE, |(_, stored)| stored);
            let line = |interface| ProfinetLine { interface, stored, keep: self.file };
            lines.profinet = self.profinet.map(line);
        }
        #[cfg(feature = "profinet")]
        let has_profinet = lines.profinet.is_some();
        #[cfg(not(feature = "profinet"))]
        let has_profinet = false;
        for (is_given, is_of_use, what) in [
            (
                config.modbus_swap_bytes,
                lines.modbus.is_some(),
                "--modbus-swap-bytes is of no use without --modbus ADDR",
            ),
            (
                config.bus_timeout_ms > 0,
                lines.modbus.is_some(),
                "--bus-timeout is of no use without --modbus ADDR",
            ),
            (
                self.bus_reaction.is_some(),
                config.bus_timeout_ms > 0 || lines.profibus.is_some() || has_profinet,
                "--bus-reaction is of no use without --bus-timeout MS, --profibus LINE or --profinet IFACE",
            ),
            (
                self.profibus_address.is_some(),
                lines.profibus.is_some(),
                "--profibus-address is of no use without --profibus LINE",
            ),
            (
                !lines.control_hosts.is_empty(),
                lines.control.is_some(),
                "--control-host is of no use without --control ADDR",
            ),
        ] {
            if is_given && !is_of_use {
                bail!(what);
            }
        }
        config.bus_reaction = self.bus_reaction.unwrap_or(config.bus_reaction);
        config.profibus_address = self.profibus_address.unwrap_or(config.profibus_address);
        let Lines { tcp, udp, serial, can, gcl, gcl_udp, modbus, profibus, .. } = &lines;
        let has_address = [tcp, gcl, gcl_udp, modbus].into_iter().any(Option::is_some);
        let has_line = serial.is_some() || profibus.is_some() || has_profinet;
        let is_default_line = !has_address && !has_line && udp.is_none() && can.is_none();
        if is_default_line {
            lines.tcp = Some(DEFAULT_TCP);
        }
        Ok(Request::Serve(Box::new(Options { config, lines, is_default_line, log })))
    }
}

fn parsed<T: FromStr>(text: &str) -> Option<T> {
    text.parse().ok()
}

fn port(text: &str) -> Option<u16> {
    parsed(text).filter(|port| *port != 0)
}

fn station(text: &str) -> Option<u8> {
    parsed(text).filter(|address| *address <= 125)
}

/// Where the control interface listens; a port alone never leads beyond this machine.
fn control(text: &str) -> Option<SocketAddr> {
    parsed(text).or_else(|| Some(SocketAddr::new(LOOPBACK, parsed(text)?)))
}

fn host(text: &str) -> Option<String> {
    (!text.is_empty()
        && !text.contains(['/', '['])
        && (parsed::<IpAddr>(text).is_some() || !text.contains(':')))
    .then(|| text.to_owned())
}

fn serial(text: &str) -> Option<SerialLine> {
    match text.strip_prefix("unix:") {
        Some("") => None,
        Some(path) => Some(SerialLine::Unix(path.into())),
        None if text == "pty" => Some(SerialLine::Pty),
        None if text.is_empty() => None,
        None => Some(SerialLine::Device(text.into())),
    }
}

fn interface(text: &str) -> Option<CanBus> {
    (!text.is_empty()).then(|| CanBus::Interface(text.to_owned()))
}

/// N, in decimal or, behind 0x, in hexadecimal.
fn identifiers(text: &str) -> Option<Identifiers> {
    let n = match text.strip_prefix("0x") {
        Some(digits) => u16::from_str_radix(digits, 16).ok()?,
        None => parsed(text)?,
    };
    Identifiers::from_base(n)
}

fn direction(text: &str) -> Option<Direction> {
    match text {
        "out" => Some(Direction::Plus),
        "in" => Some(Direction::Minus),
        _ => None,
    }
}

fn reaction(text: &str) -> Option<SilenceReaction> {
    match text {
        "hold" => Some(SilenceReaction::Hold),
        "stop" => Some(SilenceReaction::Stop),
        "fast-stop" => Some(SilenceReaction::FastStop),
        _ => None,
    }
}

/// `none` is a part that is read well: no part.
fn part(text: &str) -> Option<Option<Part>> {
    if text == "none" {
        return Some(None);
    }
    let part = match text.split_once(':') {
        Some((width, stiffness)) => Part::new(parsed(width)?, parsed(stiffness)?),
        None => Part::of_width(parsed(text)?),
    };
    part.map(Some)
}

fn time_scale(text: &str) -> Option<f32> {
    parsed(text).filter(|scale| (Config::MIN_TIME_SCALE..=Config::MAX_TIME_SCALE).contains(scale))
}

/// A number above 0 that is no infinity.
fn positive(text: &str) -> Option<f32> {
    parsed(text).filter(|value: &f32| value.is_finite() && *value > 0.0)
}

/// A length in mm.
fn length(text: &str) -> Option<f32> {
    parsed(text).filter(|value| (0.0..=1_000.0).contains(value))
}

fn profile(text: &str) -> Option<Profile> {
    match text {
        "instant" => Some(Profile::Instant),
        "real" => Some(Profile::Real),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(arguments: &[&str]) -> Result<Options> {
        match parse(Parser::from_args(arguments))? {
            Request::Serve(options) => Ok(*options),
            request => bail!("{request:?}"),
        }
    }

    fn options_of(line: &str) -> Options {
        options(&line.split_whitespace().collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn without_any_line_tcp_is_served_on_this_machine() {
        let lines = options(&[]).unwrap().lines;
        assert_eq!(lines, Lines { tcp: Some("127.0.0.1:1000".parse().unwrap()), ..Lines::default() });
    }

    #[test]
    fn another_line_replaces_the_default_one() {
        let lines = options(&["--serial", "unix:/run/wsg"]).unwrap().lines;
        assert_eq!(lines, Lines { serial: Some(SerialLine::Unix("/run/wsg".into())), ..Lines::default() });
        let lines = options(&["--udp", "127.0.0.1:1500"]).unwrap().lines;
        assert_eq!((lines.tcp, lines.udp.unwrap().remote_port), (None, 1_501));
    }

    #[test]
    fn can_replaces_the_default_line() {
        let lines = options_of("--slcan pty --can-id 0x7FE").lines;
        let identifiers = Identifiers::from_base(0x7FE).unwrap();
        let bus = CanBus::Slcan(SerialLine::Pty);
        assert_eq!(lines, Lines { can: Some(CanLine { bus, identifiers }), ..Lines::default() });
        let can = options_of("--can can0").lines.can.unwrap();
        assert_eq!(can.bus, CanBus::Interface("can0".to_owned()));
        assert_eq!(can.identifiers.controller().transmit.as_raw(), 0x120);
        assert_eq!(options_of("--can can0 --can-id 288").lines.can, Some(can));
    }

    #[test]
    fn profibus_replaces_the_default_line() {
        let options = options_of("--profibus pty --profibus-address 12");
        assert_eq!(options.lines, Lines { profibus: Some(SerialLine::Pty), ..Lines::default() });
        assert_eq!(options.config.profibus_address, 12);
        assert_eq!(options_of("--profibus pty").config.profibus_address, 7);
        let given = options_of("--profibus pty --bus-reaction fast-stop");
        assert_eq!(given.config.bus_reaction, SilenceReaction::FastStop);
    }

    #[cfg(feature = "profinet")]
    #[test]
    fn profinet_replaces_the_default_line() {
        let given = options_of("--profinet eth0 --bus-reaction hold");
        let line = given.lines.profinet.unwrap();
        assert_eq!((given.lines.tcp, given.config.bus_reaction), (None, SilenceReaction::Hold));
        assert_eq!((line.interface.as_str(), line.stored, line.keep), ("eth0", Stored::NONE, None));
        let line =
            options_of("--profinet eth0 --station wsg-1 --profinet-ip 10.0.0.5/8,10.0.0.1").lines.profinet;
        let line = line.unwrap();
        assert_eq!(
            (line.stored.name.as_str(), line.stored.ip.mask, line.stored.ip.gateway),
            ("wsg-1", [255, 0, 0, 0], [10, 0, 0, 1])
        );
        assert_eq!(ProfinetLine::ip_text(&line.stored.ip), "10.0.0.5/8,10.0.0.1");
        for (arguments, expected) in [
            (&["--station", "wsg-1"][..], "--profinet IFACE"),
            (&["--profinet-ip", "10.0.0.5/8"], "--profinet IFACE"),
            (&["--im-date", "2026"], "--profinet IFACE"),
            (&["--profinet", "eth0", "--im-location", "a place with a long name"], "up to 22"),
            (&["--profinet", "eth0", "--station", "WSG"], "hyphens"),
            (&["--profinet", "eth0", "--profinet-ip", "10.0.0.5"], "192.168.0.5/24"),
            (&["--profinet", "eth0", "--profinet-ip", "10.0.0.5/31"], "192.168.0.5/24"),
            (&["--profinet", "eth0", "--profinet-ip", "10.0.0.255/24"], "192.168.0.5/24"),
            (&["--profinet", "eth0", "--profinet-ip", "10.0.0.5/8,x"], "192.168.0.5/24"),
            (&["--profinet", ""], "eth0"),
        ] {
            let error = format!("{:#}", options(arguments).unwrap_err());
            assert!(error.contains(expected) && !error.contains('\n'), "{error}");
        }
    }

    #[cfg(feature = "profinet")]
    #[test]
    fn what_a_file_has_of_a_station_is_kept_there() {
        let text = "profinet = \"eth0\"\nstation = \"wsg-1\"\nprofinet-ip = \"10.0.0.5/8\"\nim-function = \"gr\u{FC}n\"\n\
                    im-location = \"+B\"\nim-date = \"2026-11-23 16:00\"\nim-descriptor = \"\\\"x\\\"\"\n";
        let line = options_of_file("profinet", text, &[]).unwrap().lines.profinet.unwrap();
        let kept = ProfinetLine::kept(&line.stored).map(|(_, text)| text);
        assert_eq!(kept, ["wsg-1", "10.0.0.5/8", "gr\u{FC}n", "+B", "2026-11-23 16:00", "\"x\""]);
        assert!(line.keep.unwrap().to_str().unwrap().ends_with("profinet.toml"));
    }

    #[test]
    fn text_protocol_replaces_the_default_line() {
        let lines = options_of("--gcl 127.0.0.1:1001 --gcl-udp 127.0.0.1:1501").lines;
        assert_eq!((lines.tcp, lines.udp), (None, None));
        assert_eq!(lines.gcl, "127.0.0.1:1001".parse().ok());
        assert_eq!(lines.gcl_udp, "127.0.0.1:1501".parse().ok());
    }

    #[test]
    fn modbus_replaces_the_default_line() {
        let options = options_of("--modbus 127.0.0.1:1502 --modbus-swap-bytes");
        assert_eq!((options.lines.tcp, options.lines.modbus), (None, "127.0.0.1:1502".parse().ok()));
        assert!(options.config.modbus_swap_bytes);
        assert!(!options_of("--modbus 127.0.0.1:1502").config.modbus_swap_bytes);
        let config = options_of("--modbus 127.0.0.1:1502 --bus-timeout 500 --bus-reaction fast-stop").config;
        assert_eq!((config.bus_timeout_ms, config.bus_reaction), (500, SilenceReaction::FastStop));
    }

    #[test]
    fn every_option_arrives() {
        let all = "--profile real --homing-speed 30 --part-width-tolerance 7 --clamping-travel 250 --force 33 \
                   --acceleration 700 --speed 60 --release-distance 12 --release-speed 90 --model wsg32 --serial-number 7 --tag cell --tcp 127.0.0.1:0 --udp 127.0.0.1:1500 \
                   --udp-remote-port 9 --serial pty --part 20:50 --finger1 fmf --finger2 dsa --no-checksum-check \
                   --answer-bad-checksum --updates-idle 60 --no-disconnect-error --homing-default in --time-scale 2.5 --log - --seed 9 \
                   --control 127.0.0.1:8080";
        let options = options_of(all);
        let expected = Config {
            model: Model::Wsg32,
            serial_number: 7,
            tag: Tag::new("cell").unwrap(),
            homing_default: Direction::Minus,
            part: Part::new(20.0, 50.0),
            time_scale: 2.5,
            check_checksum: false,
            homing_speed: Some(30.0),
            part_width_tolerance: 7.0,
            clamping_travel: 250.0,
            force_limit: Some(33.0),
            acceleration: Some(700.0),
            speed: 60.0,
            release_distance: 12.0,
            release_speed: Some(90.0),
            answer_bad_checksum: true,
            updates_idle_s: 60,
            disconnect_error: false,
            fingers: [Finger::Fmf, Finger::Dsa],
            ..Config::default()
        };
        assert_eq!(options.config, expected);
        assert_eq!(options.lines.profile, Profile::Real);
        assert_eq!(options.lines.serial, Some(SerialLine::Pty));
        assert_eq!(options.lines.udp.unwrap().remote_port, 9);
        assert_eq!(options.log, Some(LogTo::Stdout));
        assert_eq!((options.lines.seed, options.lines.control), (9, "127.0.0.1:8080".parse().ok()));
    }

    #[test]
    fn control_alone_leaves_the_default_line_and_its_port_alone_stays_on_this_machine() {
        let lines = options_of("--control 8080").lines;
        assert_eq!((lines.tcp, lines.control), (Some(DEFAULT_TCP), "127.0.0.1:8080".parse().ok()));
        let lines = options_of("--control 0.0.0.0:8080 --control-host bench --control-host fe80::1").lines;
        assert_eq!(lines.control, "0.0.0.0:8080".parse().ok());
        assert_eq!(lines.control_hosts, ["bench", "fe80::1"]);
    }

    #[test]
    fn the_last_part_counts() {
        assert_eq!(options_of("--part 20 --part none").config.part, None);
        assert_eq!(options_of("--part none --part 20").config.part, Part::of_width(20.0));
    }

    #[test]
    fn wrong_options_say_what_was_wrong_and_what_was_expected() {
        for (arguments, wrong, expected) in [
            (&["--model", "wsg99"][..], "--model \"wsg99\"", "wsg50-110"),
            (&["--part", "-3"], "--part \"-3\"", "WIDTH_MM"),
            (&["--part", "20:"], "--part \"20:\"", "STIFFNESS"),
            (&["--tcp", "1000"], "--tcp \"1000\"", "127.0.0.1:1000"),
            (&["--time-scale", "0"], "--time-scale \"0\"", "0.01"),
            (&["--time-scale"], "--time-scale", "0.01"),
            (&["--finger1", "thumb"], "--finger1 \"thumb\"", "generic"),
            (&["--control", "here"], "--control \"here\"", "127.0.0.1:8080"),
            (&["--control-host", "bench"], "--control-host", "--control ADDR"),
            (
                &["--control", "8080", "--control-host", "bench:80"],
                "--control-host \"bench:80\"",
                "without a port",
            ),
            (&["--control", "8080", "--control-host", "http://bench/"], "http://bench/", "bench.example"),
            (&["--seed", "-1"], "--seed \"-1\"", "number"),
            (&["--udp-remote-port", "9"], "--udp-remote-port", "--udp"),
            (&["--udp", "127.0.0.1:9", "--udp-remote-port", "9"], "--udp 127.0.0.1:9", "--udp-remote-port"),
            (&["--udp", "127.0.0.1:1501"], "--udp 127.0.0.1:1501", "--udp-remote-port"),
            (&["--can-id", "9"], "--can-id", "--slcan"),
            (&["--slcan", "pty", "--can-id", "0x7FF"], "--can-id \"0x7FF\"", "0x7FE"),
            (&["--slcan", "pty", "--can-id", "x"], "--can-id \"x\"", "0x7FE"),
            (&["--slcan", "unix:"], "--slcan \"unix:\"", "unix:PATH"),
            (&["--can", ""], "--can \"\"", "can0"),
            (&["--modbus", "502"], "--modbus \"502\"", "127.0.0.1:1000"),
            (&["--modbus-swap-bytes"], "--modbus-swap-bytes", "--modbus ADDR"),
            (&["--profibus", "unix:"], "--profibus \"unix:\"", "unix:PATH"),
            (&["--profibus", "pty", "--profibus-address", "126"], "--profibus-address \"126\"", "125"),
            (&["--profibus-address", "9"], "--profibus-address", "--profibus LINE"),
            (&["--fast"], "--fast", "--help"),
            (&["stray"], "stray", "--help"),
        ] {
            let error = format!("{:#}", options(arguments).unwrap_err());
            assert!(error.contains(wrong) && error.contains(expected) && !error.contains('\n'), "{error}");
        }
    }

    /// The options of a file with this text, and others of the command line.
    fn options_of_file(name: &str, text: &str, arguments: &[&str]) -> Result<Options> {
        let path = std::env::temp_dir().join(format!("wsg-sim-{}-{name}.toml", std::process::id()));
        std::fs::write(&path, text).unwrap();
        let options = options(&[&["--config", path.to_str().unwrap()], arguments].concat());
        std::fs::remove_file(&path).unwrap();
        options
    }

    #[test]
    fn file_has_the_options_of_the_command_line_which_counts_more() {
        let text = r#"
            # A cell
            model = "wsg32"
            tcp = "127.0.0.1:11000"
            slcan = "pty"
            can-id = 0x140
            no-checksum-check = true
            answer-bad-checksum = false
            clamping-travel = 250
            force = 12.5
            part = "20:50"
            control = 8080
            control-host = ["bench", "cell.example"]
        "#;
        let options = options_of_file("all", text, &["--model", "wsg25", "--force", "9"]).unwrap();
        let expected = Config {
            model: Model::Wsg25,
            check_checksum: false,
            clamping_travel: 250.0,
            force_limit: Some(9.0),
            part: Part::new(20.0, 50.0),
            ..Config::default()
        };
        assert_eq!(options.config, expected);
        let lines = options.lines;
        assert_eq!(
            (lines.tcp, lines.control),
            ("127.0.0.1:11000".parse().ok(), "127.0.0.1:8080".parse().ok())
        );
        assert_eq!(lines.can.unwrap().identifiers, Identifiers::from_base(0x140).unwrap());
        assert_eq!(lines.control_hosts, ["bench", "cell.example"]);
    }

    #[test]
    fn what_is_wrong_in_a_file_is_one_line_with_its_place() {
        for (text, expected) in [
            (
                "\nclamping-travl = 5",
                ", line 2: clamping-travl is unknown; expected options as --help lists them",
            ),
            (
                "clamping-travel = -1",
                ", line 1: clamping-travel = \"-1\" is wrong; expected a number from 0 to 1000",
            ),
            ("force = nan", "is wrong; expected a number above 0"),
            ("no-checksum-check = 1", "no-checksum-check is of another kind; expected true or false"),
            ("force = true", "force is of another kind"),
            ("tcp = [\"127.0.0.1:1\"]", "tcp is of another kind"),
            ("[tcp]\n", "tcp is of another kind"),
            ("config = \"other\"", "config is for the command line alone"),
            ("model = \"wsg32\"\nmodel = \"wsg25\"", ", line 2: "),
            ("model wsg32", "expected TOML"),
            ("can-id = 1", "--can-id is of no use without"),
        ] {
            let error = format!("{:#}", options_of_file("wrong", text, &[]).unwrap_err());
            assert!(error.contains(expected) && error.lines().count() == 1, "{text:?}: {error}");
        }
        let error = format!("{:#}", options(&["--config", "/no/such/file"]).unwrap_err());
        assert!(error.contains("/no/such/file cannot be read"), "{error}");
    }

    /// Every option with its default and its meaning, as the document has it.
    #[test]
    fn options_in_the_document_are_those_of_the_table() {
        const BEGIN: &str = "<!-- generated: options -->\n";
        const END: &str = "<!-- end -->";
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/simulator.md");
        let document = std::fs::read_to_string(path).unwrap();
        let (before, rest) = document.split_once(BEGIN).unwrap();
        let (shown, behind) = rest.split_once(END).unwrap();
        let mut table = "| option | default | meaning |\n|---|---|---|\n".to_owned();
        for setting in SETTINGS {
            table += &format!("| `{}` | {} | {} |\n", setting.usage(), setting.default, setting.meaning);
        }
        let table = table.replace("|  |", "| |");
        if std::env::var_os("WSG_UPDATE_DOCS").is_some() {
            std::fs::write(path, [before, BEGIN, &table, END, behind].concat()).unwrap();
        } else {
            assert_eq!(shown, table, "WSG_UPDATE_DOCS=1 cargo test -p wsg-sim --bins writes it");
        }
    }
}
