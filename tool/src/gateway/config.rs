//! The grippers of a gateway, and the file that lists several. Every error is one line and names the line in the file.

use std::net::SocketAddr;
use std::path::{self, Path, PathBuf};

use anyhow::{Context, Error, Result, bail, ensure};
use bus_profinet::Stored;
use clap::builder::NonEmptyStringValueParser;
use clap::{Args, Command, FromArgMatches, value_parser};
use fieldbus_host::ethernetip::EthernetIpLine;
use fieldbus_host::profinet::ProfinetLine;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::Record;
use wsg_sim::options_file::{OptionsFile, one_line};

use super::Options;
use crate::bridge::{names, settings_file};
use crate::gripper::Address;
use crate::listen_address;

/// Where the keys of the file are described, for messages.
const PAGE: &str = "docs/gateway.md";

/// Settings that have an effect on a gateway, in addition to the recipes. The others belong to wires and buses of a board.
const SETTINGS: [&str; 5] = ["BUS_TIMEOUT", "BUS_REACTION", "SWAP_BYTES", "HALF_FRAME", "BUS_RECIPE"];

/// A gripper, and how PLCs reach it.
#[derive(Clone, Debug)]
pub(super) struct GripperConfig {
    pub(super) name: Option<String>,
    pub(super) gripper: Address,
    pub(super) modbus: Option<SocketAddr>,
    pub(super) profinet: Option<ProfinetLine>,
    pub(super) ethernetip: Option<EthernetIpLine>,
    /// Unit of the gripper on a port that several share. Without it, the port has one gripper, which answers every unit.
    pub(super) unit: Option<u8>,
    pub(super) settings: Option<PathBuf>,
    /// Settings of the file, which apply until others are stored.
    pub(super) delivered: Option<Record>,
    /// Begins each message about the gripper; empty if there is one gripper only.
    pub(super) label: String,
}

/// Keys of a gripper in the file: the options, and the keys for several grippers.
#[derive(Args)]
struct Keys {
    #[command(flatten)]
    options: Options,
    #[arg(long, value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    name: Option<String>,
    #[arg(long, value_name = "NUMBER", value_parser = value_parser!(u8).range(1..=247))]
    unit: Option<u8>,
}

impl GripperConfig {
    /// Returns a gripper without a PLC.
    #[cfg(test)]
    pub(super) fn of(address: &str) -> Self {
        Self {
            name: None,
            gripper: address.parse().unwrap(),
            modbus: None,
            profinet: None,
            ethernetip: None,
            unit: None,
            settings: None,
            delivered: None,
            label: String::new(),
        }
    }

    /// Returns the gripper of a command line, or of the options in a file.
    pub(super) fn new(options: &Options) -> Result<Self> {
        let gripper = options.gripper.clone();
        ensure!(
            options.modbus.is_some() || options.profinet.is_some() || options.ethernetip.is_some(),
            "modbus, profinet or ethernetip is missing: an address such as 192.168.1.10:502, or a network interface such as eth0"
        );
        Ok(Self {
            name: None,
            gripper: gripper.context("gripper is missing: an address such as tcp://192.168.1.20")?,
            modbus: options.modbus,
            profinet: options.profinet.clone().map(|interface| {
                let keep = options.settings.as_deref().map(station_file);
                ProfinetLine { interface, stored: Stored::NONE, keep }
            }),
            ethernetip: options.ethernetip.map(|address| {
                let vendor = options.ethernetip_vendor.unwrap_or(EthernetIpLine::VENDOR);
                EthernetIpLine { address, vendor }
            }),
            unit: None,
            settings: options.settings.clone(),
            delivered: None,
            label: String::new(),
        })
    }

    /// Returns whether masters reach both grippers on one port.
    pub(super) fn shares_port(&self, other: &Self) -> bool {
        self.modbus.is_some() && self.modbus == other.modbus && self.unit.is_some() && other.unit.is_some()
    }

    /// Checks that the grippers share no name, address, settings file, network interface, or port without units.
    fn check_apart(&self, other: &Self) -> Result<()> {
        let file = |it: &Self| it.settings.as_deref().and_then(|file| path::absolute(file).ok());
        let adapter = |it: &Self| it.ethernetip.map(|line| *line.address.ip());
        let answers = |it: &Self| match it.gripper {
            Address::Udp { answer_port: port @ 1.., .. } => Some(port),
            _ => None,
        };
        let interface = |it: &Self| it.profinet.as_ref().map(|line| line.interface.clone());
        if let Some(name) = self.name.as_ref().filter(|name| other.name.as_ref() == Some(*name)) {
            bail!("another gripper has the name {name}");
        } else if self.gripper == other.gripper {
            bail!("another gripper has the address {}", self.gripper);
        } else if let Some(port) = answers(self).filter(|it| answers(other) == Some(*it)) {
            bail!("another gripper answers to UDP port {port}; expected ?answer= with another port");
        } else if let Some(file) = file(self).filter(|it| file(other).as_ref() == Some(it)) {
            bail!("another gripper stores its settings in {}", file.display());
        } else if let Some(interface) = interface(self).filter(|it| interface(other).as_ref() == Some(it)) {
            bail!("another gripper is on the network interface {interface}");
        } else if let Some(ip) = adapter(self).filter(|it| adapter(other).as_ref() == Some(it)) {
            // Cyclic data has the same port for all.
            bail!("another gripper has the address {ip} on EtherNet/IP");
        }
        let (Some(address), Some(other_address)) = (self.modbus, other.modbus) else { return Ok(()) };
        let is_everywhere = address.ip().is_unspecified() || other_address.ip().is_unspecified();
        let overlaps = address.port() == other_address.port()
            && address.port() != 0
            && (address.ip() == other_address.ip() || is_everywhere);
        if self.shares_port(other) {
            let unit = self.unit.unwrap_or_default();
            ensure!(self.unit != other.unit, "another gripper has the unit {unit} on {address}");
        } else if overlaps {
            bail!("{address} is another gripper's; to share it, both need this address and a unit each");
        }
        Ok(())
    }
}

/// Returns the file for the PROFINET station of a bridge with this settings file.
fn station_file(settings: &Path) -> PathBuf {
    let mut file = settings.to_owned().into_os_string();
    file.push(".profinet");
    file.into()
}

/// Reads and checks a file. Returns its grippers, and the address of the status page.
///
/// # Errors
/// The file cannot be read or is invalid. Reports the first mistake.
pub(super) fn read(path: &Path) -> Result<(Vec<GripperConfig>, Option<SocketAddr>)> {
    let file = OptionsFile::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let document = file.table()?;
    let (mut grippers, mut page) = (Vec::<GripperConfig>::new(), None);
    for (key, value) in document.get_ref() {
        let place = file.place(key.span().start);
        let key: &str = key.get_ref();
        if key == "page" {
            let address = listen_address(value.get_ref().as_str().unwrap_or_default());
            page = Some(address.map_err(Error::msg).with_context(|| format!("{place}: page"))?);
            continue;
        }
        ensure!(
            key == "gripper",
            "{place}: unknown key `{key}`; all keys except page belong below [[gripper]]"
        );
        let DeValue::Array(items) = value.get_ref() else {
            bail!("{place}: expected [[gripper]], in double brackets")
        };
        for item in items.iter() {
            let place = file.place(item.span().start);
            let DeValue::Table(table) = item.get_ref() else {
                bail!("{place}: expected [[gripper]] and its keys")
            };
            let gripper = gripper_of(&file, table, &place)?;
            for other in &grippers {
                gripper.check_apart(other).with_context(|| place.clone())?;
            }
            grippers.push(gripper);
        }
    }
    ensure!(!grippers.is_empty(), "{}: no gripper; expected [[gripper]]", path.display());
    if grippers.len() > 1 {
        for gripper in &mut grippers {
            gripper.label = gripper.name.clone().unwrap_or_else(|| gripper.gripper.to_string()) + ": ";
        }
    }
    Ok((grippers, page))
}

fn gripper_of(file: &OptionsFile, table: &DeTable<'_>, place: &str) -> Result<GripperConfig> {
    let mut table = table.clone();
    let delivered = table.remove("delivered");
    let command = Keys::augment_args(Command::new("gripper").no_binary_name(true));
    let words = file.words(&table, &command, PAGE)?;
    let keys = command.clone().try_get_matches_from(words).and_then(|keys| Keys::from_arg_matches(&keys));
    let keys = keys.map_err(|error| one_line(error, &command, PAGE)).with_context(|| place.to_owned())?;
    let gripper = GripperConfig::new(&keys.options).with_context(|| place.to_owned())?;
    let delivered = delivered.map(|value| delivered_of(file, &value)).transpose()?;
    Ok(GripperConfig { name: keys.name, unit: keys.unit, delivered, ..gripper })
}

/// Returns the settings that a board would be built with.
fn delivered_of(file: &OptionsFile, value: &Spanned<DeValue<'_>>) -> Result<Record> {
    let DeValue::Table(table) = value.get_ref() else {
        bail!("{}: expected [gripper.delivered] and its settings", file.place(value.span().start))
    };
    for key in table.keys() {
        let is_of_board = |name: &str| !SETTINGS.contains(&name) && !name.starts_with("RECIPE");
        if let Some((_, setting)) = names::setting(key.get_ref()).ok().filter(|(_, it)| is_of_board(it.name))
        {
            bail!(
                "{}: {} has no effect on a gateway; expected {} or a setting of a recipe",
                file.place(key.span().start),
                setting.name,
                SETTINGS.join(", ")
            );
        }
    }
    settings_file::applied(table, &Config::DEFAULT.record(), &|at| file.place(at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use wsg_bridge_fw::registers;

    const LEFT: &str = "[[gripper]]\nname = \"left\"\ngripper = \"tcp://left\"\nmodbus = \"10.0.0.1:502\"\n";
    const RIGHT: &str = "[[gripper]]\ngripper = \"tcp://right\"\nmodbus = \"10.0.0.1:503\"\n";

    fn parsed(text: &str) -> Result<Vec<GripperConfig>> {
        Ok(read_text(text)?.0)
    }

    fn read_text(text: &str) -> Result<(Vec<GripperConfig>, Option<SocketAddr>)> {
        let file = std::env::temp_dir().join(format!(
            "wsg-gateway-{}-{:?}.toml",
            std::process::id(),
            std::thread::current().id()
        ));
        fs::write(&file, text).unwrap();
        let read = read(&file);
        fs::remove_file(&file).unwrap();
        read
    }

    #[test]
    fn keys_are_those_of_the_command_line_and_more_for_several_grippers() {
        let text = format!(
            "\u{FEFF}{}unit = 2\r\nsettings = \"left.flash\"\n[gripper.delivered]\nbus_timeout = \"2000 ms\"\n\
             RECIPE3_WIDTH = 1234\n{}",
            LEFT.replace("left\"\n", "left\"\r\n"),
            RIGHT.replace("503", "502").replace("[[gripper]]", "[[gripper]]\nunit = \"247\""),
        );
        let grippers = parsed(&text).unwrap();
        let [left, right] = &grippers[..] else { panic!("{grippers:?}") };
        assert_eq!(
            [&left.gripper, &right.gripper].map(Address::to_string),
            ["tcp://left:1000", "tcp://right:1000"]
        );
        assert_eq!((&left.label[..], &right.label[..]), ("left: ", "tcp://right:1000: "));
        assert_eq!((left.modbus, left.unit), ("10.0.0.1:502".parse().ok(), Some(2)));
        assert!(left.shares_port(right) && left.settings == Some("left.flash".into()));
        let mut delivered = Config::DEFAULT.record();
        delivered[names::place("BUS_TIMEOUT")] = 2_000;
        delivered[names::place("RECIPE3_WIDTH")] = 12_34;
        assert_eq!((left.delivered, right.delivered), (Some(delivered), None));
        assert_eq!(parsed(LEFT).unwrap()[0].label, "", "one gripper needs no name in messages");
        let page = |text: &str| read_text(text).unwrap().1;
        assert_eq!(page(&format!("page = \"10.0.0.1:80\"\n{LEFT}")), "10.0.0.1:80".parse().ok());
        assert_eq!(page(LEFT), None, "no port is open by default");
    }

    #[test]
    fn free_ports_are_apart() {
        let (left, right) = (LEFT.replace("502", "0"), RIGHT.replace("503", "0"));
        let grippers = parsed(&(left + &right)).unwrap();
        assert!(!grippers[0].shares_port(&grippers[1]));
    }

    #[test]
    fn each_mistake_is_one_line_with_its_place() {
        let of_left = |line: &str| format!("{LEFT}{line}\n");
        let two = |from: &str, to: &str| [LEFT, &RIGHT.replace(from, to)].concat();
        for (text, place, expected) in [
            (String::new(), ": ", "no gripper; expected [[gripper]]"),
            ("gripper = []".to_owned(), ": ", "no gripper"),
            (LEFT.replace("[[gripper]]", "[gripper]"), ", line 1: ", "in double brackets"),
            ("gripper = [5]".to_owned(), ", line 1: ", "expected [[gripper]] and its keys"),
            (
                format!("name = 1\n{LEFT}"),
                ", line 1: ",
                "unknown key `name`; all keys except page belong below [[gripper]]",
            ),
            (format!("page = 8080\n{LEFT}"), ", line 1: ", "page: expected an address with a port"),
            (of_left("page = \"localhost:0\""), ", line 5: ", "page is unknown"),
            (of_left("x = "), ", line 5: ", "expected TOML"),
            (of_left("name = \"x\""), ", line 5: ", "duplicate key"),
            (
                of_left("setting = \"x\""),
                ", line 5: ",
                "setting is unknown; expected options as docs/gateway.md lists them; did you mean settings?",
            ),
            (of_left("config = \"x\""), ", line 5: ", "config is unknown"),
            (of_left("unit = 0"), ", line 5: ", "'0' for '--unit <NUMBER>': 0 is not in 1..=247"),
            (of_left("unit = true"), ", line 5: ", "unit has the wrong type; expected NUMBER"),
            (LEFT.replace("\"left\"", "\"\""), ", line 2: ", "--name"),
            (LEFT.replace("tcp:", "gcl:"), ", line 3: ", "GCL"),
            (LEFT.replace(":502", ""), ", line 4: ", "expected an address with a port"),
            (LEFT.replace("gripper =", "# "), ", line 1: ", "gripper is missing: an address such as tcp://"),
            (
                LEFT.replace("modbus", "# "),
                ", line 1: ",
                "modbus, profinet or ethernetip is missing: an address such as 192.",
            ),
            (
                two("gripper =", "name = \"left\"\ngripper ="),
                ", line 5: ",
                "another gripper has the name left",
            ),
            (two("right", "left:1000"), ", line 5: ", "another gripper has the address tcp://left:1000"),
            (
                LEFT.replace("tcp", "udp") + &RIGHT.replace("tcp", "udp"),
                ", line 5: ",
                "another gripper answers to UDP port 1501; expected ?answer= with another port",
            ),
            (two("503", "502"), ", line 5: ", "10.0.0.1:502 is another gripper's; to share it, both need"),
            (two("10.0.0.1:503", "0.0.0.0:502"), ", line 5: ", "0.0.0.0:502 is another gripper's"),
            (two("503\"", "502\"\nunit = 1"), ", line 5: ", "10.0.0.1:502 is another gripper's"),
            (
                of_left("unit = 7") + &RIGHT.replace("503\"", "502\"\nunit = 7"),
                ", line 6: ",
                "another gripper has the unit 7 on 10.0.0.1:502",
            ),
            (
                of_left("settings = \"x\"") + RIGHT + "settings = \"./x\"",
                ", line 6: ",
                "another gripper stores its settings in ",
            ),
            (
                of_left("profinet = \"eth0\"") + RIGHT + "profinet = \"eth0\"",
                ", line 6: ",
                "another gripper is on the network interface eth0",
            ),
            (
                of_left("ethernetip = \"10.0.0.1\"") + RIGHT + "ethernetip = \"10.0.0.1:5000\"",
                ", line 6: ",
                "another gripper has the address 10.0.0.1 on EtherNet/IP",
            ),
            (of_left("ethernetip = \"0.0.0.0\""), ", line 5: ", "expected the IP address of a network card"),
            (of_left("ethernetip-vendor = 5"), ", line 1: ", "--ethernetip"),
            (of_left("delivered = 5"), ", line 5: ", "expected [gripper.delivered]"),
            (
                of_left("[gripper.delivered]\nBUS_TIME_OUT = 5"),
                ", line 6: ",
                "unknown setting `BUS_TIME_OUT`; did you mean BUS_TIMEOUT?",
            ),
            (
                of_left("delivered.BUS_REACTION = 3"),
                ", line 5: ",
                "3 is out of range: BUS_REACTION takes 0 to 2: ",
            ),
            (
                of_left("delivered.RECIPE0_WIDTH = \"400 mm\""),
                ", line 5: ",
                "400 mm is out of range: RECIPE0_WIDTH takes 0.00 mm to 327.67 mm",
            ),
            (
                of_left("delivered.plc_bus = 1"),
                ", line 5: ",
                "PLC_BUS has no effect on a gateway; expected BUS_TIMEOUT, BUS_REACTION, SWAP_BYTES, HALF_FRAME, \
                 BUS_RECIPE or a setting of a recipe",
            ),
        ] {
            let error = format!("{:#}", parsed(&text).expect_err(&text));
            assert!(
                error.contains(&format!(".toml{place}"))
                    && error.contains(expected)
                    && error.lines().count() == 1,
                "{text}{error}"
            );
        }
    }

    /// A new setting needs a decision.
    #[test]
    fn settings_of_a_board_are_these() {
        let names = registers::SETTINGS.iter().map(|setting| setting.name);
        let refused = names.filter(|name| {
            parsed(&format!("{LEFT}delivered.{name} = \"x\""))
                .is_err_and(|error| format!("{error:#}").contains("has no effect on a gateway"))
        });
        assert_eq!(
            refused.collect::<Vec<_>>(),
            [
                "UNIT",
                "BUS_CHAR_TIMEOUT",
                "BROADCAST",
                "DEBOUNCE",
                "MIN_BUSY",
                "PLC_BUS",
                "GRIPPER_LINE",
                "MODBUS_RATE",
                "MODBUS_FORMAT",
                "CAN_RATE",
                "CAN_ID",
                "CAN_NODE",
                "CAN_MASTER",
                "PROFIBUS_ADDRESS",
                "PROFIBUS_RATE",
            ]
        );
    }
}
