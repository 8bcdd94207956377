//! The command line.

use anyhow::{Context, Result, anyhow, bail};
use lexopt::{Arg, Parser, ValueExt};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;
use wsg_protocol::can::Identifiers;
use wsg_sim::server::{CanBus, CanLine, Lines, SerialLine, UdpLine};
use wsg_sim::{Config, Direction, Finger, Model, Part, SilenceReaction, Tag};

/// What `--help` shows.
pub(crate) const USAGE: &str = "\
A virtual gripper of the WSG series.

Usage: wsg-sim [OPTION]...

Lines (without any: --tcp 127.0.0.1:1000, or 11000 where port 1000 needs rights that you lack)
  --tcp ADDR               listen for TCP on ADDR, such as 127.0.0.1:1000
  --udp ADDR               listen for UDP on ADDR, such as 127.0.0.1:1500
  --udp-remote-port PORT   answer UDP requests to this port (default 1501)
  --serial LINE            pty: open a pseudo terminal and say its path;
                           unix:PATH: listen on a Unix socket;
                           PATH: use this terminal device at 115200 8N1
  --can IFACE              CAN by this interface of Linux SocketCAN, such as can0
  --slcan LINE             CAN over a serial line (SLCAN), with LINE as for --serial; a pseudo terminal or socket
                           is an adapter for whoever opens it, behind a device an adapter is expected
  --can-id N               listen to CAN identifier N and send on N + 1, 0 to 0x7FE (default 0x120)
  --gcl ADDR               listen for the text protocol (GCL) over TCP on ADDR, such as 127.0.0.1:1001
  --gcl-udp ADDR           listen for the text protocol over UDP on ADDR, and answer to the port that asked
  --modbus ADDR            listen for Modbus/TCP on ADDR, such as 127.0.0.1:1502 (port 502 on the real gripper)
  --modbus-swap-bytes      low byte first in the numbers of the Modbus registers
  --bus-timeout MS         how long a Modbus master that has written may be silent (default 0: for ever)
  --bus-reaction WHAT      what is done then: hold, stop (default) or fast-stop; a jog ends in any case
  --profibus LINE          PROFIBUS DP slave, with LINE as for --serial; docs/WSGB5555.gsd describes it to a master
  --profibus-address N     the slave's address, 0 to 125 (default 7)
  --no-checksum-check      take frames whatever their checksum, whose two bytes must be there
  --answer-bad-checksum    answer E_CHECKSUM_ERROR to a wrong checksum (otherwise: silence)
  --updates-idle SECONDS   end the automatic updates of a client by UDP, serial line or CAN that has sent nothing
                           for so long (default 0: never)
  --no-disconnect-error    no FAST STOP when a TCP connection ends unannounced

Gripper
  --model MODEL            wsg50-110 (default), wsg50-210, wsg32, wsg25 or wsg70
  --serial-number N        serial number (default 1)
  --tag TEXT               device tag, up to 64 ASCII characters
  --finger1 KIND           none (default), generic, fmf or dsa
  --finger2 KIND           none (default), generic, fmf or dsa
  --homing-default DIR     out (default) or in
  --part WIDTH[:STIFFNESS] a part of this width in mm (and stiffness in N/mm) between the fingers, or none (default)
  --time-scale X           the fingers travel X times as fast, 0.01 to 1000
  --script FILE            run this Lua script on the gripper; docs/scripts.md lists what it can call

  --control ADDR           watch the gripper and make things go wrong, by HTTP with JSON on ADDR, such as
                           127.0.0.1:8080; a PORT alone is one of this machine
  --control-host HOST      a name of this machine that requests to --control may be for, beside localhost and its
                           address; may be given again
  --seed N                 which frames the line faults hit that --control lets loose (default 0)
  --log FILE               write each frame to FILE, or to standard output if FILE is -
  --help                   show this
  --version                show the version
";

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

/// Reads the command line.
pub(crate) fn parse(mut parser: Parser) -> Result<Request> {
    let mut config = Config::default();
    let mut lines = Lines::default();
    let mut log = None;
    let mut udp_address: Option<SocketAddr> = None;
    let mut udp_remote_port = None;
    let (mut can_bus, mut can_id) = (None, None);
    let (mut profibus_address, mut bus_reaction) = (None, None);
    while let Some(argument) = parser.next()? {
        let Arg::Long(name) = argument else {
            return Err(anyhow!(argument.unexpected()).context("expected options as --help lists them"));
        };
        let name = name.to_owned();
        let [finger1, finger2] = &mut config.fingers;
        match name.as_str() {
            "help" => return Ok(Request::Help),
            "version" => return Ok(Request::Version),
            "tcp" => lines.tcp = Some(value(&mut parser, &name, ADDRESS, parsed)?),
            "udp" => udp_address = Some(value(&mut parser, &name, ADDRESS, parsed)?),
            "udp-remote-port" => {
                udp_remote_port = Some(value(&mut parser, &name, "a port from 1 to 65535", port)?);
            }
            "serial" => {
                lines.serial = Some(value(&mut parser, &name, "pty, unix:PATH or a device's path", serial)?);
            }
            "can" => can_bus = Some(value(&mut parser, &name, "an interface, such as can0", interface)?),
            "slcan" => {
                let expected = "pty, unix:PATH or a device's path";
                can_bus = Some(value(&mut parser, &name, expected, |text| serial(text).map(CanBus::Slcan))?);
            }
            "can-id" => {
                can_id = Some(value(&mut parser, &name, "an identifier from 0 to 0x7FE", identifiers)?);
            }
            "gcl" => lines.gcl = Some(value(&mut parser, &name, ADDRESS, parsed)?),
            "gcl-udp" => lines.gcl_udp = Some(value(&mut parser, &name, ADDRESS, parsed)?),
            "modbus" => lines.modbus = Some(value(&mut parser, &name, ADDRESS, parsed)?),
            "modbus-swap-bytes" => config.modbus_swap_bytes = true,
            "bus-timeout" => {
                config.bus_timeout_ms = value(&mut parser, &name, "a number from 0 to 65535", parsed)?;
            }
            "bus-reaction" => {
                bus_reaction = Some(value(&mut parser, &name, "hold, stop or fast-stop", reaction)?);
            }
            "profibus" => {
                lines.profibus =
                    Some(value(&mut parser, &name, "pty, unix:PATH or a device's path", serial)?);
            }
            "profibus-address" => {
                profibus_address = Some(value(&mut parser, &name, "an address from 0 to 125", station)?);
            }
            "no-checksum-check" => config.check_checksum = false,
            "updates-idle" => {
                config.updates_idle_s = value(&mut parser, &name, "a number from 0 to 65535", parsed)?;
            }
            "answer-bad-checksum" => config.answer_bad_checksum = true,
            "no-disconnect-error" => config.disconnect_error = false,
            "model" => config.model = value(&mut parser, &name, MODELS, Model::from_name)?,
            "serial-number" => {
                config.serial_number = value(&mut parser, &name, "a number from 0 to 4294967295", parsed)?;
            }
            "tag" => {
                config.tag = value(&mut parser, &name, "up to 64 printable ASCII characters", |text| {
                    Tag::new(text).ok()
                })?;
            }
            "finger1" => *finger1 = value(&mut parser, &name, FINGERS, Finger::from_name)?,
            "finger2" => *finger2 = value(&mut parser, &name, FINGERS, Finger::from_name)?,
            "homing-default" => {
                config.homing_default = value(&mut parser, &name, "out or in", direction)?;
            }
            "part" => {
                config.part = value(
                    &mut parser,
                    &name,
                    "none, or WIDTH_MM[:STIFFNESS_N_PER_MM] with numbers above 0",
                    part,
                )?;
            }
            "time-scale" => {
                config.time_scale = value(&mut parser, &name, "a number from 0.01 to 1000", time_scale)?;
            }
            #[cfg(feature = "script")]
            "script" => {
                lines.script = Some(value(&mut parser, &name, "a file", |text| Some(text.into()))?);
            }
            "control-host" => lines.control_hosts.push(value(&mut parser, &name, HOST, host)?),
            "control" => lines.control = Some(value(&mut parser, &name, CONTROL, control)?),
            "seed" => {
                lines.seed = value(&mut parser, &name, "a number from 0 to 18446744073709551615", parsed)?;
            }
            "log" => {
                log = Some(value(&mut parser, &name, "a file, or -", |text| {
                    Some(if text == "-" { LogTo::Stdout } else { LogTo::File(text.into()) })
                })?);
            }
            _ => bail!("--{name} is unknown; expected options as --help lists them"),
        }
    }
    lines.udp = match (udp_address, udp_remote_port) {
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
    lines.can = match (can_bus, can_id) {
        (Some(bus), id) => Some(CanLine { bus, identifiers: id.unwrap_or(Identifiers::DEFAULT) }),
        (None, Some(_)) => bail!("--can-id is of no use without --can IFACE or --slcan LINE"),
        (None, None) => None,
    };
    if config.modbus_swap_bytes && lines.modbus.is_none() {
        bail!("--modbus-swap-bytes is of no use without --modbus ADDR");
    }
    if config.bus_timeout_ms > 0 && lines.modbus.is_none() {
        bail!("--bus-timeout is of no use without --modbus ADDR");
    }
    if let Some(reaction) = bus_reaction {
        if config.bus_timeout_ms == 0 {
            bail!("--bus-reaction is of no use without --bus-timeout MS");
        }
        config.bus_reaction = reaction;
    }
    if let Some(address) = profibus_address {
        if lines.profibus.is_none() {
            bail!("--profibus-address is of no use without --profibus LINE");
        }
        config.profibus_address = address;
    }
    if !lines.control_hosts.is_empty() && lines.control.is_none() {
        bail!("--control-host is of no use without --control ADDR");
    }
    let Lines { tcp, udp, serial, can, gcl, gcl_udp, modbus, profibus, .. } = &lines;
    let has_address = [tcp, gcl, gcl_udp, modbus].into_iter().any(Option::is_some);
    let has_line = serial.is_some() || profibus.is_some();
    let is_default_line = !has_address && !has_line && udp.is_none() && can.is_none();
    if is_default_line {
        lines.tcp = Some(DEFAULT_TCP);
    }
    Ok(Request::Serve(Box::new(Options { config, lines, is_default_line, log })))
}

const ADDRESS: &str = "an address with a port, such as 127.0.0.1:1000";
const CONTROL: &str = "an address with a port, such as 127.0.0.1:8080, or a port";
const HOST: &str = "a name or address without a port, such as bench.example";
const MODELS: &str = "wsg50-110, wsg50-210, wsg32, wsg25 or wsg70";
const FINGERS: &str = "none, generic, fmf or dsa";

/// The value of the option, or what is wrong with it.
fn value<T>(
    parser: &mut Parser,
    name: &str,
    expected: &str,
    read: impl FnOnce(&str) -> Option<T>,
) -> Result<T> {
    let text = parser
        .value()
        .and_then(|value| value.string())
        .with_context(|| format!("--{name} expects {expected}"))?;
    read(&text).with_context(|| format!("--{name} {text:?} is wrong; expected {expected}"))
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
        let all = "--model wsg32 --serial-number 7 --tag cell --tcp 127.0.0.1:0 --udp 127.0.0.1:1500 \
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
            answer_bad_checksum: true,
            updates_idle_s: 60,
            disconnect_error: false,
            fingers: [Finger::Fmf, Finger::Dsa],
            ..Config::default()
        };
        assert_eq!(options.config, expected);
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
}
