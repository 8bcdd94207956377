//! The options: the command line, the configuration file, `--help` and the table of `docs/simulator.md` share them.

use anyhow::{Context, Result, anyhow, bail, ensure};
#[cfg(feature = "profinet")]
use bus_profinet::{IpParameters, Maintenance, StationName, Stored};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, ArgAction, Command, CommandFactory, FromArgMatches, Parser};
use std::ffi::OsString;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use toml::de::{DeTable, DeValue};
use wsg_protocol::SoftLimits;
use wsg_protocol::can::Identifiers;
#[cfg(feature = "profinet")]
use wsg_sim::server::ProfinetLine;
use wsg_sim::server::{CanBus, CanLine, Lines, Profile, SerialLine, UdpLine};
use wsg_sim::{Config, Direction, Finger, Model, Part, SilenceReaction, Tag};

const LOOPBACK: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
/// The default TCP address if no line is given: the gripper's own port, on this machine only.
const DEFAULT_TCP: SocketAddr = SocketAddr::new(LOOPBACK, 1_000);
const DEFAULT_UDP_REMOTE_PORT: u16 = 1_501;

/// All options, in the form that the server takes.
#[derive(Debug)]
pub(crate) struct Options {
    pub(crate) config: Config,
    pub(crate) lines: Lines,
    /// Whether no line is given, so that the gripper's own is served.
    pub(crate) is_default_line: bool,
    /// The log file; `-` means standard output.
    pub(crate) log: Option<PathBuf>,
}

const ADDRESS: &str = "an address with a port, such as 127.0.0.1:1000";
const LINE: &str = "pty, unix:PATH or a device such as /dev/ttyUSB0 or COM3";
const U16: &str = "a number from 0 to 65535";
const LENGTH: &str = "a number from 0 to 1000";
const POSITIVE: &str = "a number above 0";

/// The part between the fingers, for an option that always has a value.
type MaybePart = Option<Part>;

/// A virtual gripper of the WSG series.
#[derive(Debug, Parser)]
#[command(version, no_binary_name = true, args_override_self = true, next_line_help = true)]
struct Arguments {
    /// Reads options from a TOML file, `name = value` with the names of this table; the command line takes precedence
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Listens for TCP [default: 127.0.0.1:1000 (or 11000, see above), if no other line is given]
    #[arg(long, value_name = "ADDR", value_parser = expected(ADDRESS, parsed::<SocketAddr>))]
    tcp: Option<SocketAddr>,
    /// Listens for UDP; grippers in the field use port 1500
    #[arg(long, value_name = "ADDR", value_parser = expected(ADDRESS, parsed::<SocketAddr>))]
    udp: Option<SocketAddr>,
    /// Sends answers to this port of the latest client, whatever its source port; not the port of `--udp` [default: 1501]
    #[arg(long, value_name = "PORT")]
    #[arg(value_parser = expected("a port from 1 to 65535", |text| parsed(text).filter(|port: &u16| *port > 0)))]
    udp_remote_port: Option<u16>,
    /// Listens for the text protocol over TCP, beside the binary one or alone ([gcl.md](gcl.md))
    #[arg(long, value_name = "ADDR", value_parser = expected(ADDRESS, parsed::<SocketAddr>))]
    gcl: Option<SocketAddr>,
    /// Listens for the text protocol over UDP; answers go to the source port of the request
    #[arg(long, value_name = "ADDR", value_parser = expected(ADDRESS, parsed::<SocketAddr>))]
    gcl_udp: Option<SocketAddr>,
    /// Ends the automatic updates of a UDP client on another machine after this many datagrams without one from the client; 0:
    /// never [default: 1000]
    #[arg(long, value_name = "N", value_parser = expected("a number of datagrams; 0: any number", parsed::<u32>))]
    udp_unanswered: Option<u32>,
    /// Opens a serial line: `pty` creates a pseudo terminal and prints its path, `unix:PATH` listens on a Unix socket as
    /// emulators provide it for a UART, any other path is a terminal device or a port such as COM3, set to 115200 8N1
    #[arg(long, value_name = "LINE", value_parser = expected(LINE, serial))]
    serial: Option<SerialLine>,
    /// Opens CAN on an interface of Linux SocketCAN
    #[arg(long, value_name = "IFACE", value_parser = expected("an interface, such as can0", not_empty))]
    can: Option<String>,
    /// Opens CAN by SLCAN: with `pty` and `unix:PATH` the gripper is on the bus of the adapter that a host opens there; a
    /// terminal device or a port leads to an adapter, 500 kbit/s
    #[arg(long, value_name = "LINE", overrides_with = "can", value_parser = expected(LINE, serial))]
    slcan: Option<SerialLine>,
    /// Listens to this identifier and sends on the next [default: 0x120]
    #[arg(long, value_name = "N", value_parser = expected("an identifier from 0 to 0x7FE", identifiers))]
    can_id: Option<Identifiers>,
    /// Listens for Modbus/TCP; port 502 on the real gripper
    #[arg(long, value_name = "ADDR", value_parser = expected(ADDRESS, parsed::<SocketAddr>))]
    modbus: Option<SocketAddr>,
    /// Sends numbers in the registers low byte first; flags are unaffected
    #[arg(long)]
    modbus_swap_bytes: bool,
    /// Sets the time-out of a Modbus master that has written; 0: none
    #[arg(long, value_name = "MS", default_value = "0", value_parser = expected(U16, parsed::<u16>))]
    bus_timeout: u16,
    /// Reaction to that time-out, and to the loss of the PROFIBUS or PROFINET master; a jog ends in any case [default: stop]
    #[arg(long, value_name = "WHAT", value_parser = one_of(vec![
        ("hold", SilenceReaction::Hold),
        ("stop", SilenceReaction::Stop),
        ("fast-stop", SilenceReaction::FastStop),
    ]))]
    bus_reaction: Option<SilenceReaction>,
    /// Opens a PROFIBUS DP slave on a serial line, as for `--serial`
    #[arg(long, value_name = "LINE", value_parser = expected(LINE, serial))]
    profibus: Option<SerialLine>,
    /// Address on PROFIBUS, 0 to 125 [default: 7]
    #[arg(long, value_name = "N")]
    #[arg(value_parser = expected("an address from 0 to 125", |text| parsed(text).filter(|n: &u8| *n <= 125)))]
    profibus_address: Option<u8>,
    #[cfg(feature = "profinet")]
    #[command(flatten)]
    profinet: Profinet,
    /// Accepts frames with any checksum; the two bytes must be present
    #[arg(long)]
    no_checksum_check: bool,
    /// Answers E_CHECKSUM_ERROR to a wrong checksum instead of ignoring the frame
    #[arg(long)]
    answer_bad_checksum: bool,
    /// Ends the automatic updates of a client by UDP, serial line or CAN after this silence; 0: never
    #[arg(long, value_name = "SECONDS", default_value = "0", value_parser = expected(U16, parsed::<u16>))]
    updates_idle: u16,
    /// Suppresses the FAST STOP after a TCP connection that ends unannounced
    #[arg(long)]
    no_disconnect_error: bool,
    /// Latency of the command interface: none, or that of real grippers by field reports
    #[arg(long, value_name = "PROFILE", default_value = "instant")]
    #[arg(value_parser = one_of(vec![("instant", Profile::Instant), ("real", Profile::Real)]))]
    profile: Profile,
    /// Model; [models.md](models.md) has the figures
    #[arg(long, value_name = "MODEL", default_value = "wsg50-110")]
    #[arg(value_parser = one_of(Model::ALL.iter().map(|model| (model.name(), *model)).collect()))]
    model: Model,
    /// Serial number in the answer to Get System Information
    #[arg(long, value_name = "N", default_value = "1")]
    #[arg(value_parser = expected("a number from 0 to 4294967295", parsed::<u32>))]
    serial_number: u32,
    /// Text of the answer to Get Device Tag, up to 64 ASCII characters [default: none]
    #[arg(long, value_name = "TEXT")]
    #[arg(value_parser = expected("up to 64 printable ASCII characters", |text| Tag::new(text).ok()))]
    tag: Option<Tag>,
    /// Kind of finger 1
    #[arg(long, value_name = "KIND", default_value = "none", value_parser = finger())]
    finger1: Finger,
    /// Kind of finger 2
    #[arg(long, value_name = "KIND", default_value = "none", value_parser = finger())]
    finger2: Finger,
    /// Direction of homing if the request does not specify one
    #[arg(long, value_name = "DIR", default_value = "out")]
    #[arg(value_parser = one_of(vec![("out", Direction::Plus), ("in", Direction::Minus)]))]
    homing_default: Direction,
    /// Homes after power-up without a command, in the direction of `--homing-default`
    #[arg(long)]
    homing_at_start: bool,
    /// Soft limits after power-up in mm, such as `10:90`; Set Soft Limits and Clear Soft Limits change them for the
    /// session [default: none]
    #[arg(long, value_name = "MINUS:PLUS", value_parser = expected(
        "two widths in mm from 0 to 1000, the smaller one first, such as 10:90",
        soft_limits,
    ))]
    soft_limits: Option<SoftLimits>,
    /// Speed of homing, within the model's limits [default: the model's]
    #[arg(long, value_name = "MM_S", value_parser = expected(POSITIVE, positive))]
    homing_speed: Option<f32>,
    /// Distance before the nominal width of a grip within which a part is accepted; a part met earlier is the wrong one
    #[arg(long, value_name = "MM", default_value = "5", value_parser = expected(LENGTH, length))]
    part_width_tolerance: f32,
    /// Distance beyond the nominal width in which a grip builds up its force; with the stroke or more, any part is
    /// accepted, so a grip at 0 mm holds it
    #[arg(long, value_name = "MM", default_value = "5", value_parser = expected(LENGTH, length))]
    clamping_travel: f32,
    /// Force limit after power-up, within the model's limits [default: the model's]
    #[arg(long, value_name = "N", value_parser = expected(POSITIVE, positive))]
    force: Option<f32>,
    /// Acceleration after power-up, within the model's limits [default: the model's]
    #[arg(long, value_name = "MM_S2", value_parser = expected(POSITIVE, positive))]
    acceleration: Option<f32>,
    /// Speed of MOVE and GRIP of the text protocol, and of the page, if none is given
    #[arg(long, value_name = "MM_S", default_value = "100", value_parser = expected(POSITIVE, positive))]
    speed: f32,
    /// Distance of RELEASE of the text protocol if none is given
    #[arg(long, value_name = "MM", default_value = "10", value_parser = expected(LENGTH, length))]
    release_distance: f32,
    /// Speed of RELEASE of the text protocol if none is given [default: the model's maximum]
    #[arg(long, value_name = "MM_S", value_parser = expected(POSITIVE, positive))]
    release_speed: Option<f32>,
    /// Part between the fingers, in mm and N/mm, or `none`
    #[arg(long, value_name = "WIDTH[:STIFFNESS]", default_value = "none")]
    #[arg(value_parser = expected("none, or WIDTH_MM[:STIFFNESS_N_PER_MM] with numbers above 0", part))]
    part: MaybePart,
    /// Factor on the speed of the fingers, 0.01 to 1000; periods and time-outs are unaffected
    #[arg(long, value_name = "X", default_value = "1")]
    #[arg(value_parser = expected("a number from 0.01 to 1000", time_scale))]
    time_scale: f32,
    /// Runs a Lua script on the gripper ([scripts.md](scripts.md))
    #[cfg(feature = "script")]
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// Serves the page and the control interface; a port without an address listens on this machine only
    #[arg(long, value_name = "ADDR")]
    #[arg(value_parser = expected("an address with a port, such as 127.0.0.1:8080, or a port", control))]
    control: Option<SocketAddr>,
    /// Accepts this host name in requests to `--control`, beside `localhost` and the machine's address; may be repeated, in a
    /// file as a list
    #[arg(long, value_name = "HOST")]
    #[arg(value_parser = expected("a name or address without a port, such as bench.example", host))]
    control_host: Vec<String>,
    /// Selects the frames that line faults hit
    #[arg(long, value_name = "N", default_value = "0")]
    #[arg(value_parser = expected("a number from 0 to 18446744073709551615", parsed::<u64>))]
    seed: u64,
    /// Logs each frame with time, line, direction, bytes and meaning, at once; `-` is standard output. The gripper does not
    /// wait for a slow reader of the log: it omits lines and logs how many
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Appends the system log to a file: starts, connections, FAST STOPs with their source, faults, settings and scripts
    #[arg(long, value_name = "FILE")]
    system_log: Option<PathBuf>,
}

/// The options for PROFINET.
#[cfg(feature = "profinet")]
#[derive(Debug, clap::Args)]
struct Profinet {
    /// Opens a PROFINET IO device on a network interface, Linux only ([profinet.md](profinet.md))
    #[arg(long, value_name = "IFACE", value_parser = expected("a network interface, such as eth0", not_empty))]
    profinet: Option<String>,
    /// Station name; a name set by a controller is saved in the file of `--config` [default: none: a controller assigns it]
    #[arg(long = ProfinetLine::STATION, value_name = "NAME")]
    #[arg(value_parser = expected("a name of a to z, 0 to 9, hyphens and dots", StationName::new))]
    station: Option<StationName>,
    /// IP address, which must not be the interface's; saved likewise [default: none: a controller assigns it]
    #[arg(long = ProfinetLine::IP, value_name = "IP/BITS[,ROUTER]", value_parser = expected(
        "an address such as 192.168.0.5/24, with a router 192.168.0.5/24,192.168.0.1",
        ProfinetLine::ip_of_text,
    ))]
    ip: Option<IpParameters>,
    /// Function of the station, in its records (I&M 1); saved likewise
    #[arg(long = ProfinetLine::MAINTENANCE[0], value_name = "TEXT")]
    #[arg(value_parser = expected("up to 32 letters of Latin-1", ProfinetLine::maintenance_of_text::<32>))]
    function: Option<[u8; 32]>,
    /// Location (I&M 1); saved likewise
    #[arg(long = ProfinetLine::MAINTENANCE[1], value_name = "TEXT")]
    #[arg(value_parser = expected("up to 22 letters of Latin-1", ProfinetLine::maintenance_of_text::<22>))]
    location: Option<[u8; 22]>,
    /// Date of installation (I&M 2); saved likewise
    #[arg(long = ProfinetLine::MAINTENANCE[2], value_name = "TEXT", value_parser = expected(
        "up to 16 letters of Latin-1, such as \"2026-11-23 16:00\"",
        ProfinetLine::maintenance_of_text::<16>,
    ))]
    date: Option<[u8; 16]>,
    /// Any description (I&M 3); saved likewise
    #[arg(long = ProfinetLine::MAINTENANCE[3], value_name = "TEXT")]
    #[arg(value_parser = expected("up to 54 letters of Latin-1", ProfinetLine::maintenance_of_text::<54>))]
    descriptor: Option<[u8; 54]>,
}

/// Returns the name of an option's value; a switch has none.
fn value_name(arg: &Arg) -> Option<&str> {
    arg.get_value_names().filter(|_| arg.get_action().takes_values()).map(|names| names[0].as_str())
}

/// Returns the command line definition for clap. Values may begin with a hyphen, such as the plant designation `-K1`.
fn command() -> Command {
    Arguments::command().mut_args(|arg| {
        let has_value = value_name(&arg).is_some();
        arg.allow_hyphen_values(has_value)
    })
}

/// Parses the command line, without the program's name, and the configuration file that it names. Help and version end
/// the program.
pub(crate) fn parse(arguments: Vec<OsString>) -> Result<Options> {
    let mut matches = command().try_get_matches_from(&arguments).map_err(one_line)?;
    if let Some(path) = matches.get_one::<PathBuf>("config") {
        let arguments = [words_of_file(path)?, arguments].concat();
        matches = command().try_get_matches_from(arguments).map_err(one_line)?;
    }
    Arguments::from_arg_matches(&matches)?.options()
}

/// Reduces clap's message to one line without the usage. Help and version are not errors: they end the program.
fn one_line(error: clap::Error) -> anyhow::Error {
    if !error.use_stderr() {
        error.exit();
    }
    let text = error.to_string();
    let lines = text.lines().take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"));
    let lines: Vec<_> = lines.map(str::trim).filter(|line| !line.is_empty()).collect();
    let hint = match error.kind() {
        ErrorKind::InvalidValue | ErrorKind::UnknownArgument => "; expected options as --help lists them",
        _ => "",
    };
    anyhow!("{}{hint}", lines.join("; ").trim_start_matches("error: "))
}

/// Converts the options of a file to command line words. Each is checked, so that an error names its line.
fn words_of_file(path: &Path) -> Result<Vec<OsString>> {
    let name = path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("--config {name} cannot be read"))?;
    let line_of = |at: usize| 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
    let table = DeTable::parse(&text).map_err(|error| {
        let line = line_of(error.span().map_or(0, |span| span.start));
        let what = error.message().lines().collect::<Vec<_>>().join(", ");
        anyhow!("{name}, line {line}: {what}; expected TOML")
    })?;
    let command = command();
    let mut words = Vec::new();
    for (key, value) in table.get_ref() {
        let place = format!("{name}, line {}", line_of(key.span().start));
        let key: &str = key.get_ref();
        let Some(arg) = command.get_arguments().find(|arg| arg.get_long() == Some(key)) else {
            bail!("{place}: {key} is unknown; expected options as --help lists them");
        };
        ensure!(key != "config", "{place}: {key} is only valid on the command line");
        for word in words_of(arg, key, value.get_ref()).with_context(|| {
            let expected = value_name(arg).unwrap_or("true or false");
            format!("{place}: {key} has the wrong type; expected {expected}, as a text unless it is a number")
        })? {
            let checked = command.clone().try_get_matches_from([&word]);
            checked.map_err(one_line).with_context(|| place.clone())?;
            words.push(word);
        }
    }
    Ok(words)
}

/// Returns the words for an option of a file; `None` if its value has the wrong type.
fn words_of(arg: &Arg, key: &str, value: &DeValue<'_>) -> Option<Vec<OsString>> {
    let is_switch = value_name(arg).is_none();
    let text = match value {
        DeValue::Boolean(true) if is_switch => return Some(vec![format!("--{key}").into()]),
        DeValue::Boolean(false) if is_switch => return Some(vec![]),
        _ if is_switch => return None,
        DeValue::Array(items) if matches!(arg.get_action(), ArgAction::Append) => {
            let words: Option<Vec<_>> = items.iter().map(|item| words_of(arg, key, item.get_ref())).collect();
            return Some(words?.concat());
        }
        DeValue::String(text) => text.clone().into_owned(),
        DeValue::Integer(number) => i128::from_str_radix(number.as_str(), number.radix()).ok()?.to_string(),
        DeValue::Float(number) => number.as_str().to_owned(),
        DeValue::Boolean(_) | DeValue::Datetime(_) | DeValue::Array(_) | DeValue::Table(_) => return None,
    };
    Some(vec![format!("--{key}={text}").into()])
}

/// Rejects an option that has no effect without another.
fn check(option: &str, is_given: bool, has_effect: bool, others: &str) -> Result<()> {
    ensure!(has_effect || !is_given, "--{option} has no effect without {others}");
    Ok(())
}

impl Arguments {
    /// Combines related options and checks them against each other.
    fn options(self) -> Result<Options> {
        #[cfg(feature = "profinet")]
        let profinet = self.profinet.line(self.config)?;
        #[cfg(feature = "profinet")]
        let has_profinet = profinet.is_some();
        #[cfg(not(feature = "profinet"))]
        let has_profinet = false;
        let can_bus = self.can.map(CanBus::Interface).or(self.slcan.map(CanBus::Slcan));
        let has_profibus = self.profibus.is_some();
        let has_watch = self.bus_timeout > 0 || has_profibus || has_profinet;
        check("udp-remote-port", self.udp_remote_port.is_some(), self.udp.is_some(), "--udp ADDR")?;
        let has_udp = self.udp.is_some() || self.gcl_udp.is_some();
        check("udp-unanswered", self.udp_unanswered.is_some(), has_udp, "--udp ADDR or --gcl-udp ADDR")?;
        check("can-id", self.can_id.is_some(), can_bus.is_some(), "--can IFACE or --slcan LINE")?;
        check("modbus-swap-bytes", self.modbus_swap_bytes, self.modbus.is_some(), "--modbus ADDR")?;
        check("bus-timeout", self.bus_timeout > 0, self.modbus.is_some(), "--modbus ADDR")?;
        let watched = "--bus-timeout MS, --profibus LINE or --profinet IFACE";
        check("bus-reaction", self.bus_reaction.is_some(), has_watch, watched)?;
        check("profibus-address", self.profibus_address.is_some(), has_profibus, "--profibus LINE")?;
        check("control-host", !self.control_host.is_empty(), self.control.is_some(), "--control ADDR")?;
        let remote_port = self.udp_remote_port.unwrap_or(DEFAULT_UDP_REMOTE_PORT);
        if let Some(address) = self.udp.filter(|address| address.port() == remote_port) {
            bail!(
                "--udp {address} uses the port of the answers; expected another port, or --udp-remote-port"
            );
        }
        let addresses = [self.tcp, self.udp, self.gcl, self.gcl_udp, self.modbus];
        let has_bus = self.serial.is_some() || can_bus.is_some() || has_profibus || has_profinet;
        let is_default_line = !has_bus && addresses.iter().all(Option::is_none);
        let default = Config::default();
        let config = Config {
            model: self.model,
            serial_number: self.serial_number,
            tag: self.tag.unwrap_or(default.tag),
            homing_default: self.homing_default,
            homing_at_start: self.homing_at_start,
            soft_limits: self.soft_limits,
            part: self.part,
            time_scale: self.time_scale,
            check_checksum: !self.no_checksum_check,
            answer_bad_checksum: self.answer_bad_checksum,
            disconnect_error: !self.no_disconnect_error,
            fingers: [self.finger1, self.finger2],
            clamping_travel: self.clamping_travel,
            part_width_tolerance: self.part_width_tolerance,
            force_limit: self.force,
            acceleration: self.acceleration,
            homing_speed: self.homing_speed,
            speed: self.speed,
            release_distance: self.release_distance,
            release_speed: self.release_speed,
            modbus_swap_bytes: self.modbus_swap_bytes,
            bus_timeout_ms: self.bus_timeout,
            bus_reaction: self.bus_reaction.unwrap_or(default.bus_reaction),
            profibus_address: self.profibus_address.unwrap_or(default.profibus_address),
            updates_idle_s: self.updates_idle,
            ..default
        };
        let identifiers = self.can_id.unwrap_or(Identifiers::DEFAULT);
        let lines = Lines {
            tcp: if is_default_line { Some(DEFAULT_TCP) } else { self.tcp },
            udp: self.udp.map(|address| UdpLine { address, remote_port }),
            serial: self.serial,
            system_log: self.system_log,
            can: can_bus.map(|bus| CanLine { bus, identifiers }),
            gcl: self.gcl,
            gcl_udp: self.gcl_udp,
            udp_unanswered: self.udp_unanswered,
            modbus: self.modbus,
            profibus: self.profibus,
            #[cfg(feature = "profinet")]
            profinet,
            control: self.control,
            control_hosts: self.control_host,
            #[cfg(feature = "script")]
            script: self.script,
            profile: self.profile,
            seed: self.seed,
        };
        Ok(Options { config, lines, is_default_line, log: self.log })
    }
}

#[cfg(feature = "profinet")]
impl Profinet {
    /// Returns the line on the interface, and the file in which its data is saved.
    fn line(self, keep: Option<PathBuf>) -> Result<Option<ProfinetLine>> {
        let none = Stored::NONE;
        let maintenance = Maintenance {
            function: self.function.unwrap_or(none.maintenance.function),
            location: self.location.unwrap_or(none.maintenance.location),
            date: self.date.unwrap_or(none.maintenance.date),
            descriptor: self.descriptor.unwrap_or(none.maintenance.descriptor),
        };
        let stored =
            Stored { name: self.station.unwrap_or(none.name), ip: self.ip.unwrap_or(none.ip), maintenance };
        for (option, text) in ProfinetLine::kept(&stored) {
            check(option, !text.is_empty(), self.profinet.is_some(), "--profinet IFACE")?;
        }
        Ok(self.profinet.map(|interface| ProfinetLine { interface, stored, keep }))
    }
}

/// Returns a parser whose errors name the expected values.
fn expected<T: Clone + Send + Sync + 'static>(
    what: &'static str,
    take: fn(&str) -> Option<T>,
) -> impl TypedValueParser<Value = T> {
    move |text: &str| take(text).ok_or_else(|| format!("expected {what}"))
}

/// Returns a parser of names.
fn one_of<T: Copy + Send + Sync + 'static>(
    values: Vec<(&'static str, T)>,
) -> impl TypedValueParser<Value = T> {
    let names = PossibleValuesParser::new(values.iter().map(|(name, _)| *name));
    names.try_map(move |text| {
        values.iter().find_map(|(name, value)| (*name == text).then_some(*value)).context("unknown")
    })
}

fn finger() -> impl TypedValueParser<Value = Finger> {
    one_of(Finger::ALL.iter().map(|finger| (finger.name(), *finger)).collect())
}

fn parsed<T: FromStr>(text: &str) -> Option<T> {
    text.parse().ok()
}

fn not_empty(text: &str) -> Option<String> {
    (!text.is_empty()).then(|| text.to_owned())
}

/// Parses the address of the control interface. A port without an address listens on this machine only.
fn control(text: &str) -> Option<SocketAddr> {
    parsed(text).or_else(|| Some(SocketAddr::new(LOOPBACK, parsed(text)?)))
}

fn host(text: &str) -> Option<String> {
    let is_address = parsed::<IpAddr>(text).is_some();
    not_empty(text).filter(|text| !text.contains(['/', '[']) && (is_address || !text.contains(':')))
}

fn serial(text: &str) -> Option<SerialLine> {
    match text.strip_prefix("unix:") {
        Some("") => None,
        Some(path) => Some(SerialLine::Unix(path.into())),
        None if text == "pty" => Some(SerialLine::Pty),
        None => not_empty(text).map(|path| SerialLine::Device(path.into())),
    }
}

/// Parses N in decimal or, after 0x, in hexadecimal.
fn identifiers(text: &str) -> Option<Identifiers> {
    let n = match text.strip_prefix("0x") {
        Some(digits) => u16::from_str_radix(digits, 16).ok()?,
        None => parsed(text)?,
    };
    Identifiers::from_base(n)
}

/// Parses a part; `none` is a valid value.
fn part(text: &str) -> Option<MaybePart> {
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

/// Parses a finite number above 0.
fn positive(text: &str) -> Option<f32> {
    parsed(text).filter(|value: &f32| value.is_finite() && *value > 0.0)
}

/// Parses a length in mm.
fn length(text: &str) -> Option<f32> {
    parsed(text).filter(|value| (0.0..=1_000.0).contains(value))
}

/// Parses soft limits in mm.
fn soft_limits(text: &str) -> Option<SoftLimits> {
    let (minus, plus) = text.split_once(':')?;
    let limits = SoftLimits { minus: length(minus)?, plus: length(plus)? };
    (limits.minus <= limits.plus).then_some(limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(arguments: &[&str]) -> Result<Options> {
        parse(arguments.iter().map(OsString::from).collect())
    }

    fn options_of(line: &str) -> Options {
        options(&line.split_whitespace().collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn without_any_line_tcp_is_served_on_this_machine() {
        let options = options(&[]).unwrap();
        assert_eq!(options.config, Config::default());
        assert_eq!(options.lines, Lines { tcp: "127.0.0.1:1000".parse().ok(), ..Lines::default() });
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
        let last = options_of("--can can0 --slcan pty").lines.can.unwrap();
        assert_eq!(last.bus, CanBus::Slcan(SerialLine::Pty));
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
        let given = options_of("--profinet eth0 --station wsg-1 --profinet-ip 10.0.0.5/8,10.0.0.1");
        let line = given.lines.profinet.unwrap();
        assert_eq!(line.stored.name.as_str(), "wsg-1");
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
                   --udp-remote-port 9 --udp-unanswered 0 --serial pty --part 20:50 --finger1 fmf --finger2 dsa --no-checksum-check \
                   --answer-bad-checksum --updates-idle 60 --no-disconnect-error --homing-default in --homing-at-start --soft-limits 7.5:60 --time-scale 2.5 --log - --seed 9 \
                   --control 127.0.0.1:8080";
        let options = options_of(all);
        let expected = Config {
            model: Model::Wsg32,
            serial_number: 7,
            tag: Tag::new("cell").unwrap(),
            homing_default: Direction::Minus,
            homing_at_start: true,
            soft_limits: Some(SoftLimits { minus: 7.5, plus: 60.0 }),
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
        assert_eq!(options.log, Some("-".into()));
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
    fn errors_of_options_name_the_value_and_the_expected_ones() {
        for (arguments, wrong, expected) in [
            (&["--model", "wsg99"][..], "'wsg99' for '--model", "wsg50-110"),
            (&["--part", "-3"], "'-3' for '--part", "WIDTH_MM"),
            (&["--part", "20:"], "'20:' for '--part", "STIFFNESS"),
            (&["--tcp", "1000"], "'1000' for '--tcp", "127.0.0.1:1000"),
            (&["--soft-limits", "10"], "'10' for '--soft-limits", "10:90"),
            (&["--soft-limits", "90:10"], "'90:10' for '--soft-limits", "the smaller one first"),
            (&["--time-scale", "0"], "'0' for '--time-scale", "0.01"),
            (&["--time-scale"], "--time-scale", "--help"),
            (&["--finger1", "thumb"], "'thumb' for '--finger1", "generic"),
            (&["--control", "here"], "'here' for '--control", "127.0.0.1:8080"),
            (&["--control-host", "bench"], "--control-host", "--control ADDR"),
            (
                &["--control", "8080", "--control-host", "bench:80"],
                "'bench:80' for '--control-host",
                "a port",
            ),
            (&["--control", "8080", "--control-host", "http://bench/"], "http://bench/", "bench.example"),
            (&["--seed", "-1"], "'-1' for '--seed", "number"),
            (&["--udp-remote-port", "9"], "--udp-remote-port", "--udp"),
            (&["--udp", "127.0.0.1:9", "--udp-remote-port", "9"], "--udp 127.0.0.1:9", "--udp-remote-port"),
            (&["--udp", "127.0.0.1:1501"], "--udp 127.0.0.1:1501", "--udp-remote-port"),
            (&["--can-id", "9"], "--can-id", "--slcan"),
            (&["--slcan", "pty", "--can-id", "0x7FF"], "'0x7FF' for '--can-id", "0x7FE"),
            (&["--slcan", "pty", "--can-id", "x"], "'x' for '--can-id", "0x7FE"),
            (&["--slcan", "unix:"], "'unix:' for '--slcan", "unix:PATH"),
            (&["--can", ""], "'' for '--can", "can0"),
            (&["--modbus", "502"], "'502' for '--modbus", "127.0.0.1:1000"),
            (&["--modbus-swap-bytes"], "--modbus-swap-bytes", "--modbus ADDR"),
            (&["--profibus", "unix:"], "'unix:' for '--profibus", "unix:PATH"),
            (&["--profibus", "pty", "--profibus-address", "126"], "'126' for '--profibus-address", "125"),
            (&["--profibus-address", "9"], "--profibus-address", "--profibus LINE"),
            (&["--fast"], "--fast", "--help"),
            (&["stray"], "stray", "--help"),
        ] {
            let error = format!("{:#}", options(arguments).unwrap_err());
            assert!(error.contains(wrong) && error.contains(expected) && !error.contains('\n'), "{error}");
        }
    }

    /// Parses the options of a file with this text, and others of the command line.
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
            homing-at-start = true
            soft-limits = "10:90"
            control = 8080
            control-host = ["bench"]
        "#;
        let options = options_of_file(
            "all",
            text,
            &["--model", "wsg25", "--can", "can0", "--tag", "-K1", "--control-host", "cell.example"],
        )
        .unwrap();
        let expected = Config {
            model: Model::Wsg25,
            check_checksum: false,
            clamping_travel: 250.0,
            force_limit: Some(12.5),
            tag: Tag::new("-K1").unwrap(),
            homing_at_start: true,
            soft_limits: Some(SoftLimits { minus: 10.0, plus: 90.0 }),
            part: Part::new(20.0, 50.0),
            ..Config::default()
        };
        assert_eq!(options.config, expected);
        let lines = options.lines;
        assert_eq!(lines.tcp, "127.0.0.1:11000".parse().ok());
        assert_eq!(lines.control, "127.0.0.1:8080".parse().ok());
        let bus = CanBus::Interface("can0".to_owned());
        assert_eq!(lines.can, Identifiers::from_base(0x140).map(|identifiers| CanLine { bus, identifiers }));
        assert_eq!(lines.control_hosts, ["bench", "cell.example"]);
    }

    #[test]
    fn errors_in_a_file_are_one_line_with_their_position() {
        for (text, expected) in [
            (
                "\nclamping-travl = 5",
                ", line 2: clamping-travl is unknown; expected options as --help lists them",
            ),
            (
                "clamping-travel = -1",
                ", line 1: invalid value '-1' for '--clamping-travel <MM>': expected a number",
            ),
            ("force = nan", "'nan' for '--force <N>': expected a number above 0"),
            ("no-checksum-check = 1", "no-checksum-check has the wrong type; expected true or false"),
            ("force = true", "force has the wrong type"),
            ("tcp = [\"127.0.0.1:1\"]", "tcp has the wrong type"),
            ("[tcp]\n", "tcp has the wrong type"),
            ("config = \"other\"", "config is only valid on the command line"),
            ("model = \"wsg32\"\nmodel = \"wsg25\"", ", line 2: "),
            ("model wsg32", "expected TOML"),
            ("can-id = 1", "--can-id has no effect without"),
        ] {
            let error = format!("{:#}", options_of_file("wrong", text, &[]).unwrap_err());
            assert!(error.contains(expected) && error.lines().count() == 1, "{text:?}: {error}");
        }
        let error = format!("{:#}", options(&["--config", "/no/such/file"]).unwrap_err());
        assert!(error.contains("/no/such/file cannot be read"), "{error}");
    }

    /// Checks that the document lists every option with its default and meaning.
    #[test]
    fn options_in_the_document_are_those_of_the_program() {
        const BEGIN: &str = "<!-- generated: options -->\n";
        const END: &str = "<!-- end -->";
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/simulator.md");
        let document = std::fs::read_to_string(path).unwrap();
        let (before, rest) = document.split_once(BEGIN).unwrap();
        let (shown, behind) = rest.split_once(END).unwrap();
        let mut table = "| option | default | meaning |\n|---|---|---|\n".to_owned();
        for arg in command().get_arguments() {
            let name = arg.get_long().unwrap();
            let help = arg.get_help().unwrap().to_string();
            let (value, default) =
                value_name(arg).map_or((String::new(), "off"), |name| (format!(" {name}"), ""));
            let (meaning, default) =
                help.trim_end_matches(']').split_once(" [default: ").unwrap_or((&help, default));
            let default = arg.get_default_values().first().map_or(default, |value| value.to_str().unwrap());
            let values = arg.get_possible_values();
            let names: Vec<_> = values.iter().map(|value| format!("`{}`", value.get_name())).collect();
            let names = if names.is_empty() { String::new() } else { format!(" ({})", names.join(", ")) };
            table += &format!("| `--{name}{value}` | {default} | {meaning}{names} |\n");
        }
        let table = table.replace("|  |", "| |");
        if std::env::var_os("WSG_UPDATE_DOCS").is_some() {
            std::fs::write(path, [before, BEGIN, &table, END, behind].concat()).unwrap();
        } else {
            assert_eq!(shown, table, "WSG_UPDATE_DOCS=1 cargo test -p wsg-sim --bins writes it");
        }
    }
}
