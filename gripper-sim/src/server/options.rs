//! The options: the command line, the configuration file, `--help` and the list of `docs/simulator.md` share them.

mod file;
mod table;

pub(in crate::server) use file::{save, toml_value};
pub(in crate::server) use table::settings;

use super::lines::{CanBus, CanLine, Lines, Profile, SerialLine, UdpLine};
use crate::axis::Direction;
use crate::command_line::{self, LOOPBACK, address, after_scheme};
use crate::config::{Config, Tag};
use crate::control::words::{
    MaybePart, check_limits, length, parsed, part, positive, soft_limits, time_scale,
};
use crate::control::{COMMAND, Changes, DEVICE, FIELDBUS, Given, MOTION, NETWORK};
use crate::finger::Finger;
use crate::model::Model;
use crate::options_file::{self, value_name};
use anyhow::{Context, Result, bail, ensure};
use bus_profinet::{IpParameters, Maintenance, StationName, Stored};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Command, CommandFactory, FromArgMatches, Parser};
use fieldbus_host::ethernetip::EthernetIpLine;
use fieldbus_host::profinet::ProfinetLine;
use std::ffi::OsString;
use std::net::{IpAddr, SocketAddr, SocketAddrV4};
use std::path::PathBuf;
use wsg_fieldbus::SilenceReaction;
use wsg_protocol::SoftLimits;
use wsg_protocol::can::Identifiers;

/// The default TCP address if no line is given: the gripper's own port, on this machine only.
const DEFAULT_TCP: SocketAddr = SocketAddr::new(LOOPBACK, 1_000);
const DEFAULT_UDP_REMOTE_PORT: u16 = 1_501;

/// Where the options are listed, for messages.
const HELP: &str = "--help";

/// Heading of the options that are no settings of the gripper: the page does not show them.
const PROGRAM: &str = "Program";

/// All options, in the form that the server takes.
#[derive(Clone, Debug)]
pub struct Options {
    /// The settings of the gripper.
    pub config: Config,
    /// The lines to serve.
    pub lines: Lines,
    /// Whether no line is given, so that the gripper's own is served.
    pub is_default_line: bool,
    /// The log file; `-` means standard output.
    pub log: Option<PathBuf>,
    /// The configuration file, in which changed settings are saved.
    pub(in crate::server) file: Option<PathBuf>,
    /// What the command line and the file give.
    pub(in crate::server) given: Given,
}

const ADDRESS: &str = "an address with a port, such as 127.0.0.1:1000";
const LINE: &str = "pty, unix:PATH or a device such as /dev/ttyUSB0 or COM3";
const U16: &str = "a number from 0 to 65535";
const LENGTH: &str = "a number from 0 to 1000";
const POSITIVE: &str = "a number above 0";

/// A virtual gripper of the WSG series.
#[derive(Debug, Parser)]
#[command(version, no_binary_name = true, args_override_self = true, next_line_help = true)]
struct Arguments {
    /// Reads options from a TOML file, `name = value` with the names of these options; the command line takes precedence
    #[arg(long, help_heading = PROGRAM, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Listens for TCP [default: 127.0.0.1:1000 (or 11000 without the privileges for port 1000), if no other line is given]
    #[arg(long, help_heading = COMMAND, value_name = "ADDR", value_parser = expected(ADDRESS, address))]
    tcp: Option<SocketAddr>,
    /// Listens for UDP; grippers in the field use port 1500
    #[arg(long, help_heading = COMMAND, value_name = "ADDR", value_parser = expected(ADDRESS, address))]
    udp: Option<SocketAddr>,
    /// Sends answers to this port of the latest client, regardless of its source port; not the port of `--udp` [default: 1501]
    #[arg(long, help_heading = COMMAND, value_name = "PORT")]
    #[arg(value_parser = expected("a port from 1 to 65535", |text| parsed(text).filter(|port: &u16| *port > 0)))]
    udp_remote_port: Option<u16>,
    /// Listens for the text protocol over TCP, beside the binary one or alone ([gcl.md](gcl.md))
    #[arg(long, help_heading = COMMAND, value_name = "ADDR", value_parser = expected(ADDRESS, address))]
    gcl: Option<SocketAddr>,
    /// Listens for the text protocol over UDP; answers go to the source port of the request
    #[arg(long, help_heading = COMMAND, value_name = "ADDR", value_parser = expected(ADDRESS, address))]
    gcl_udp: Option<SocketAddr>,
    /// Begins each new connection of the text protocol in verbose mode, with a description of each error (GCL, 2.1.1)
    #[arg(long, help_heading = COMMAND)]
    gcl_verbose: bool,
    /// Ends the automatic updates of a UDP client on another machine after this many datagrams without one from the client; 0:
    /// never [default: 1000]
    #[arg(long, help_heading = COMMAND, value_name = "NUMBER", value_parser = expected("a number of datagrams, or 0", parsed::<u32>))]
    udp_unanswered: Option<u32>,
    /// Opens a serial line: `pty` creates a pseudo terminal and prints its path, `unix:PATH` listens on a Unix socket as
    /// emulators provide it for a UART, any other path is a terminal device or a port such as COM3, set to 115200 8N1
    #[arg(long, help_heading = COMMAND, value_name = "LINE", value_parser = expected(LINE, serial))]
    serial: Option<SerialLine>,
    /// Opens CAN on an interface of Linux SocketCAN
    #[arg(long, help_heading = COMMAND, value_name = "IFACE", value_parser = expected("an interface, such as can0", not_empty))]
    can: Option<String>,
    /// Opens CAN by SLCAN: with `pty` and `unix:PATH` the gripper is on the bus of the adapter that a host opens there; a
    /// terminal device or a port leads to an adapter, 500 kbit/s
    #[arg(long, help_heading = COMMAND, value_name = "LINE", overrides_with = "can", value_parser = expected(LINE, serial))]
    slcan: Option<SerialLine>,
    /// Listens to this identifier and sends on the next [default: 0x120]
    #[arg(long, help_heading = COMMAND, value_name = "NUMBER", value_parser = expected("an identifier from 0 to 0x7FE", identifiers))]
    can_id: Option<Identifiers>,
    /// Listens for Modbus/TCP; port 502 on the real gripper
    #[arg(long, help_heading = FIELDBUS, value_name = "ADDR", value_parser = expected(ADDRESS, address))]
    modbus: Option<SocketAddr>,
    /// Sends numbers in the registers low byte first; flags are unaffected
    #[arg(long, help_heading = FIELDBUS)]
    modbus_swap_bytes: bool,
    /// Sets the time-out of a Modbus master that has written; 0: none
    #[arg(long, help_heading = FIELDBUS, value_name = "MS", default_value = "0", value_parser = expected(U16, parsed::<u16>))]
    bus_timeout: u16,
    /// Reaction to that time-out, and to the loss of the master on PROFIBUS, PROFINET or EtherNet/IP; a jog ends in any case [default: stop]
    #[arg(long, help_heading = FIELDBUS, value_name = "WHAT", value_parser = one_of(vec![
        ("hold", SilenceReaction::Hold),
        ("stop", SilenceReaction::Stop),
        ("fast-stop", SilenceReaction::FastStop),
    ]))]
    bus_reaction: Option<SilenceReaction>,
    /// Opens a PROFIBUS DP slave on a serial line, as for `--serial`
    #[arg(long, help_heading = FIELDBUS, value_name = "LINE", value_parser = expected(LINE, serial))]
    profibus: Option<SerialLine>,
    /// Address on PROFIBUS, 0 to 125 [default: 7]
    #[arg(long, help_heading = FIELDBUS, value_name = "NUMBER")]
    #[arg(value_parser = expected("an address from 0 to 125", |text| parsed(text).filter(|n: &u8| *n <= 125)))]
    profibus_address: Option<u8>,
    #[command(flatten)]
    profinet: Profinet,
    /// Opens an EtherNet/IP adapter: TCP and UDP port 44818 or the given one, and UDP port 2222 ([EtherNet/IP](#ethernetip))
    #[arg(long, help_heading = FIELDBUS, value_name = "ADDR", value_parser = expected(
        "the IP address of a network card, such as 192.168.0.5, perhaps with a port",
        EthernetIpLine::address_of_text,
    ))]
    ethernetip: Option<SocketAddrV4>,
    /// Vendor number on EtherNet/IP, which a PLC's key and the EDS file must equal [default: 0]
    #[arg(long, help_heading = FIELDBUS, value_name = "NUMBER", value_parser = expected(U16, parsed::<u16>))]
    ethernetip_vendor: Option<u16>,
    /// Accepts frames with any checksum; the two bytes must be present
    #[arg(long, help_heading = COMMAND)]
    no_checksum_check: bool,
    /// Answers E_CHECKSUM_ERROR to a wrong checksum instead of ignoring the frame
    #[arg(long, help_heading = COMMAND)]
    answer_bad_checksum: bool,
    /// Ends the automatic updates of a client by UDP, serial line or CAN after this silence; 0: never
    #[arg(long, help_heading = COMMAND, value_name = "SECONDS", default_value = "0", value_parser = expected(U16, parsed::<u16>))]
    updates_idle: u16,
    /// Suppresses the FAST STOP after a TCP connection that ends unannounced
    #[arg(long, help_heading = COMMAND)]
    no_disconnect_error: bool,
    /// Latency of the command interface: none, or that of real grippers by field reports
    #[arg(long, help_heading = COMMAND, value_name = "PROFILE", default_value = "instant")]
    #[arg(value_parser = one_of(vec![("instant", Profile::Instant), ("real", Profile::Real)]))]
    profile: Profile,
    /// Model; [models.md](models.md) has the figures
    #[arg(long, help_heading = DEVICE, value_name = "MODEL", default_value = "wsg50-110")]
    #[arg(value_parser = one_of(Model::ALL.iter().map(|model| (model.name(), *model)).collect()))]
    model: Model,
    /// Simulates a gripper without overdrive mode (command set, 3.3.8)
    #[arg(long, help_heading = DEVICE)]
    no_overdrive: bool,
    /// Serial number in the answer to Get System Information
    #[arg(long, help_heading = DEVICE, value_name = "NUMBER", default_value = "1")]
    #[arg(value_parser = expected("a number from 0 to 4294967295", parsed::<u32>))]
    serial_number: u32,
    /// Text of the answer to Get Device Tag, up to 64 ASCII characters [default: none]
    #[arg(long, help_heading = DEVICE, value_name = "TEXT")]
    #[arg(value_parser = expected("up to 64 printable ASCII characters", |text| Tag::new(text).ok()))]
    tag: Option<Tag>,
    /// Kind of finger 1
    #[arg(long, help_heading = DEVICE, value_name = "KIND", default_value = "none", value_parser = finger())]
    finger1: Finger,
    /// Kind of finger 2
    #[arg(long, help_heading = DEVICE, value_name = "KIND", default_value = "none", value_parser = finger())]
    finger2: Finger,
    /// Direction of homing if the request does not specify one
    #[arg(long, help_heading = MOTION, value_name = "DIR", default_value = "out")]
    #[arg(value_parser = one_of(vec![("out", Direction::Plus), ("in", Direction::Minus)]))]
    homing_default: Direction,
    /// Homes after power-up without a command, in the direction of `--homing-default`
    #[arg(long, help_heading = MOTION)]
    homing_at_start: bool,
    /// Soft limits after power-up in mm, such as `10:90`; Set Soft Limits and Clear Soft Limits change them for the
    /// session [default: none]
    #[arg(long, help_heading = MOTION, value_name = "MINUS:PLUS", value_parser = expected(
        "two widths in mm from 0 to 1000, the smaller one first, such as 10:90",
        soft_limits,
    ))]
    soft_limits: Option<SoftLimits>,
    /// Speed of homing, within the model's limits [default: the model's]
    #[arg(long, help_heading = MOTION, value_name = "MM_S", value_parser = expected(POSITIVE, positive))]
    homing_speed: Option<f32>,
    /// Distance before the nominal width of a grip within which a part is accepted; a part met earlier is the wrong one
    #[arg(long, help_heading = MOTION, value_name = "MM", default_value = "5", value_parser = expected(LENGTH, length))]
    part_width_tolerance: f32,
    /// Distance beyond the nominal width in which a grip builds up its force; with the stroke or more, any part is
    /// accepted, so a grip at 0 mm holds it
    #[arg(long, help_heading = MOTION, value_name = "MM", default_value = "5", value_parser = expected(LENGTH, length))]
    clamping_travel: f32,
    /// Force limit after power-up, within the model's limits [default: the model's]
    #[arg(long, help_heading = MOTION, value_name = "N", value_parser = expected(POSITIVE, positive))]
    force: Option<f32>,
    /// Acceleration after power-up, within the model's limits [default: the model's]
    #[arg(long, help_heading = MOTION, value_name = "MM_S2", value_parser = expected(POSITIVE, positive))]
    acceleration: Option<f32>,
    /// Speed of MOVE and GRIP of the text protocol, and of the page, if none is given
    #[arg(long, help_heading = MOTION, value_name = "MM_S", default_value = "100", value_parser = expected(POSITIVE, positive))]
    speed: f32,
    /// Distance of RELEASE of the text protocol if none is given
    #[arg(long, help_heading = MOTION, value_name = "MM", default_value = "10", value_parser = expected(LENGTH, length))]
    release_distance: f32,
    /// Speed of RELEASE of the text protocol if none is given [default: the model's maximum]
    #[arg(long, help_heading = MOTION, value_name = "MM_S", value_parser = expected(POSITIVE, positive))]
    release_speed: Option<f32>,
    /// Part between the fingers, in mm and N/mm, or `none`. With the width of its hole in mm, it can be gripped from inside
    #[arg(long, help_heading = DEVICE, value_name = "WIDTH[:STIFFNESS[:INNER]]", default_value = "none")]
    #[arg(value_parser = expected(
        "none, or WIDTH_MM[:STIFFNESS_N_PER_MM[:INNER_WIDTH_MM]] with numbers above 0, the inner width below the width",
        part,
    ))]
    part: MaybePart,
    /// Factor on the speed of the fingers, 0.01 to 1000; periods and time-outs are unaffected
    #[arg(long, help_heading = DEVICE, value_name = "X", default_value = "1")]
    #[arg(value_parser = expected("a number from 0.01 to 1000", time_scale))]
    time_scale: f32,
    /// Runs a Lua script on the gripper ([Lua scripts](#lua-scripts))
    #[arg(long, help_heading = PROGRAM, value_name = "FILE")]
    script: Option<PathBuf>,
    /// Lists, edits and runs the scripts of this folder on the page ([Scripts on the page](#scripts-on-the-page))
    #[arg(long, help_heading = PROGRAM, value_name = "FOLDER")]
    scripts: Option<PathBuf>,
    /// Serves the page and the control interface; a port without an address listens on this machine only
    #[arg(long, help_heading = NETWORK, value_name = "ADDR")]
    #[arg(value_parser = expected("an address with a port, such as 127.0.0.1:8080, or a port", control))]
    control: Option<SocketAddr>,
    /// Accepts this host name in requests to `--control`, beside `localhost` and the machine's address; may be repeated, in a
    /// file as a list
    #[arg(long, help_heading = NETWORK, value_name = "HOST")]
    #[arg(value_parser = expected("a name or address without a port, such as bench.example", host))]
    control_host: Vec<String>,
    /// Selects the frames that line faults hit
    #[arg(long, help_heading = PROGRAM, value_name = "NUMBER", default_value = "0")]
    #[arg(value_parser = expected("a number from 0 to 18446744073709551615", parsed::<u64>))]
    seed: u64,
    /// Logs each frame with time, line, direction, bytes and meaning, at once; `-` is standard output. The gripper does not
    /// wait for a slow reader of the log: it omits lines and logs how many
    #[arg(long, help_heading = PROGRAM, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Appends the system log to a file: starts, connections, FAST STOPs with their source, faults, settings and scripts
    #[arg(long, help_heading = PROGRAM, value_name = "FILE")]
    system_log: Option<PathBuf>,
}

/// The options for PROFINET.
#[derive(Debug, clap::Args)]
struct Profinet {
    /// Opens a PROFINET IO device on a network interface, Linux only ([PROFINET](#profinet))
    #[arg(long, help_heading = FIELDBUS, value_name = "IFACE", value_parser = expected("a network interface, such as eth0", not_empty))]
    profinet: Option<String>,
    /// Station name; a name set by a controller is saved in the file of `--config` [default: none: a controller assigns it]
    #[arg(long = ProfinetLine::STATION, help_heading = FIELDBUS, value_name = "NAME")]
    #[arg(value_parser = expected("a name of a to z, 0 to 9, hyphens and dots", StationName::new))]
    station: Option<StationName>,
    /// IP address, which must not be the interface's; saved likewise [default: none: a controller assigns it]
    #[arg(long = ProfinetLine::IP, help_heading = NETWORK, value_name = "IP/BITS[,ROUTER]", value_parser = expected(
        "an address such as 192.168.0.5/24, with a router 192.168.0.5/24,192.168.0.1",
        ProfinetLine::ip_of_text,
    ))]
    ip: Option<IpParameters>,
    /// Function of the station, in its records (I&M 1); saved likewise
    #[arg(long = ProfinetLine::MAINTENANCE[0], help_heading = FIELDBUS, value_name = "TEXT")]
    #[arg(value_parser = expected("up to 32 letters of Latin-1", ProfinetLine::maintenance_of_text::<32>))]
    function: Option<[u8; 32]>,
    /// Location (I&M 1); saved likewise
    #[arg(long = ProfinetLine::MAINTENANCE[1], help_heading = FIELDBUS, value_name = "TEXT")]
    #[arg(value_parser = expected("up to 22 letters of Latin-1", ProfinetLine::maintenance_of_text::<22>))]
    location: Option<[u8; 22]>,
    /// Date of installation (I&M 2); saved likewise
    #[arg(long = ProfinetLine::MAINTENANCE[2], help_heading = FIELDBUS, value_name = "TEXT", value_parser = expected(
        "up to 16 letters of Latin-1, such as \"2026-11-23 16:00\"",
        ProfinetLine::maintenance_of_text::<16>,
    ))]
    date: Option<[u8; 16]>,
    /// Any description (I&M 3); saved likewise
    #[arg(long = ProfinetLine::MAINTENANCE[3], help_heading = FIELDBUS, value_name = "TEXT")]
    #[arg(value_parser = expected("up to 54 letters of Latin-1", ProfinetLine::maintenance_of_text::<54>))]
    descriptor: Option<[u8; 54]>,
}

/// Returns the command line definition for clap, with help for a terminal.
#[must_use]
pub fn command() -> Command {
    command_line::without_markdown(definition())
}

/// Returns the definition with help in Markdown. Values may begin with a hyphen, such as the plant designation `-K1`.
fn definition() -> Command {
    Arguments::command().mut_args(|arg| {
        let has_value = value_name(&arg).is_some();
        arg.allow_hyphen_values(has_value)
    })
}

/// Parses words of the command line.
fn matches_of(words: impl IntoIterator<Item: Into<OsString> + Clone>) -> Result<ArgMatches> {
    definition().try_get_matches_from(words).map_err(one_line)
}

impl Options {
    /// Parses the command line, without the program's name, and the configuration file that it names. Help and version
    /// end the program.
    ///
    /// # Errors
    /// Returns one line that names the option and the expected values.
    pub fn parse(arguments: Vec<OsString>) -> Result<Self> {
        let mut matches = command().try_get_matches_from(&arguments).map_err(one_line)?;
        let file = matches.get_one::<PathBuf>("config").cloned();
        if let Some(path) = &file {
            let arguments = [file::words_of_file(path)?, arguments].concat();
            matches = matches_of(arguments)?;
        }
        Self::of(&matches, file)
    }

    /// Returns the same options with these settings changed: new words, or `None` for the default.
    ///
    /// # Errors
    /// Returns one line that names the setting and the expected values.
    pub(in crate::server) fn with(&self, changes: &Changes) -> Result<Self> {
        let given = self.given.with(changes);
        let words = given.iter().flat_map(|(name, words)| {
            let values: Vec<String> = words.iter().map(|word| format!("--{name}={word}")).collect();
            if values.is_empty() { vec![format!("--{name}")] } else { values }
        });
        Self::of(&matches_of(words)?, self.file.clone())
    }

    fn of(matches: &ArgMatches, file: Option<PathBuf>) -> Result<Self> {
        let given = definition().get_arguments().filter_map(|arg| given_words(matches, arg)).collect();
        Arguments::from_arg_matches(matches)?.options(file, Given::default().with(&given))
    }
}

/// Returns the name of an option and its words, if it is given.
fn given_words(matches: &ArgMatches, arg: &Arg) -> Option<(String, Option<Vec<String>>)> {
    let (id, name) = (arg.get_id().as_str(), arg.get_long()?);
    if matches.value_source(id) != Some(ValueSource::CommandLine) || name == "config" {
        return None;
    }
    let words = matches.get_raw(id).into_iter().flatten().map(|word| word.to_string_lossy().into_owned());
    Some((name.to_owned(), Some(if value_name(arg).is_some() { words.collect() } else { vec![] })))
}

/// Reduces clap's message to one line without the usage. Help and version are not errors: they end the program.
fn one_line(error: clap::Error) -> anyhow::Error {
    if !error.use_stderr() {
        error.exit();
    }
    options_file::one_line(error, &definition(), HELP)
}

/// Rejects an option that has no effect without another.
fn check(option: &str, is_given: bool, has_effect: bool, others: &str) -> Result<()> {
    ensure!(has_effect || !is_given, "--{option} has no effect without {others}");
    Ok(())
}

impl Arguments {
    /// Rejects options that have no effect without another.
    fn check_effects(&self) -> Result<()> {
        let has_can = self.can.is_some() || self.slcan.is_some();
        let has_profibus = self.profibus.is_some();
        let has_ethernetip = self.ethernetip.is_some();
        let has_watch =
            self.bus_timeout > 0 || has_profibus || self.profinet.profinet.is_some() || has_ethernetip;
        check("udp-remote-port", self.udp_remote_port.is_some(), self.udp.is_some(), "--udp ADDR")?;
        let has_udp = self.udp.is_some() || self.gcl_udp.is_some();
        check("udp-unanswered", self.udp_unanswered.is_some(), has_udp, "--udp ADDR or --gcl-udp ADDR")?;
        let has_gcl = self.gcl.is_some() || self.gcl_udp.is_some();
        check("gcl-verbose", self.gcl_verbose, has_gcl, "--gcl ADDR or --gcl-udp ADDR")?;
        check("can-id", self.can_id.is_some(), has_can, "--can IFACE or --slcan LINE")?;
        check("modbus-swap-bytes", self.modbus_swap_bytes, self.modbus.is_some(), "--modbus ADDR")?;
        check("bus-timeout", self.bus_timeout > 0, self.modbus.is_some(), "--modbus ADDR")?;
        let watched = "--bus-timeout MS, --profibus LINE, --profinet IFACE or --ethernetip ADDR";
        check("bus-reaction", self.bus_reaction.is_some(), has_watch, watched)?;
        check("ethernetip-vendor", self.ethernetip_vendor.is_some(), has_ethernetip, "--ethernetip ADDR")?;
        check("profibus-address", self.profibus_address.is_some(), has_profibus, "--profibus LINE")?;
        check("control-host", !self.control_host.is_empty(), self.control.is_some(), "--control ADDR")
    }

    /// Combines related options and checks them against each other.
    fn options(self, file: Option<PathBuf>, given: Given) -> Result<Options> {
        self.check_effects()?;
        let can_bus = self.can.map(CanBus::Interface).or(self.slcan.map(CanBus::Slcan));
        let profinet = self.profinet.line(file.clone())?;
        let remote_port = self.udp_remote_port.unwrap_or(DEFAULT_UDP_REMOTE_PORT);
        if let Some(address) = self.udp.filter(|address| address.port() == remote_port) {
            bail!(
                "--udp {address} uses the port of the answers; expected another port, or --udp-remote-port"
            );
        }
        let ethernetip = self.ethernetip.map(|address| {
            let vendor = self.ethernetip_vendor.unwrap_or(EthernetIpLine::VENDOR);
            EthernetIpLine { address, vendor }
        });
        let addresses =
            [self.tcp, self.udp, self.gcl, self.gcl_udp, self.modbus, self.ethernetip.map(Into::into)];
        let has_bus =
            self.serial.is_some() || can_bus.is_some() || self.profibus.is_some() || profinet.is_some();
        let is_default_line = !has_bus && addresses.iter().all(Option::is_none);
        let default = Config::default();
        let config = Config {
            model: self.model,
            overdrive: !self.no_overdrive,
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
            gcl_verbose: self.gcl_verbose,
            modbus_swap_bytes: self.modbus_swap_bytes,
            bus_timeout_ms: self.bus_timeout,
            bus_reaction: self.bus_reaction.unwrap_or(default.bus_reaction),
            profibus_address: self.profibus_address.unwrap_or(default.profibus_address),
            updates_idle_s: self.updates_idle,
            ..default
        };
        check_limits(&config).map_err(anyhow::Error::msg)?;
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
            profinet,
            ethernetip,
            control: self.control,
            control_hosts: self.control_host,
            script: self.script,
            scripts: self.scripts,
            profile: self.profile,
            seed: self.seed,
        };
        Ok(Options { config, lines, is_default_line, log: self.log, file, given })
    }
}

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

fn not_empty(text: &str) -> Option<String> {
    (!text.is_empty()).then(|| text.to_owned())
}

/// Parses the address of the control interface. A port without an address listens on this machine only.
fn control(text: &str) -> Option<SocketAddr> {
    address(text).or_else(|| Some(SocketAddr::new(LOOPBACK, parsed(text)?)))
}

fn host(text: &str) -> Option<String> {
    let is_address = parsed::<IpAddr>(text).is_some();
    not_empty(text).filter(|text| !text.contains(['/', '[']) && (is_address || !text.contains(':')))
}

fn serial(text: &str) -> Option<SerialLine> {
    match after_scheme(text, "unix:") {
        Some("") => None,
        Some(path) => Some(SerialLine::Unix(path.into())),
        None if text.eq_ignore_ascii_case("pty") => Some(SerialLine::Pty),
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

#[cfg(test)]
mod tests;
