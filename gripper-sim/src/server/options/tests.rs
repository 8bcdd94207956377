//! What the options accept, and what they say to anything else.

use super::table::AT_ONCE;
use super::*;
use crate::axis::Part;
use crate::control::{Setting, words};

fn options(arguments: &[&str]) -> Result<Options> {
    Options::parse(arguments.iter().map(OsString::from).collect())
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
fn any_other_line_replaces_the_default_one() {
    let none = Lines::default;
    let address = |text: &str| text.parse::<SocketAddr>().ok();
    let can = |bus, n| Identifiers::from_base(n).map(|identifiers| CanLine { bus, identifiers });
    let can0 = || CanBus::Interface("can0".to_owned());
    let udp = address("127.0.0.1:1500").map(|address| UdpLine { address, remote_port: 1_501 });
    let (gcl, gcl_udp) = (address("127.0.0.1:1001"), address("127.0.0.1:1501"));
    for (line, lines) in [
        ("--serial unix:/run/wsg", Lines { serial: Some(SerialLine::Unix("/run/wsg".into())), ..none() }),
        ("--udp 127.0.0.1:1500", Lines { udp, ..none() }),
        ("--slcan pty --can-id 0x7FE", Lines { can: can(CanBus::Slcan(SerialLine::Pty), 0x7FE), ..none() }),
        ("--can can0", Lines { can: can(can0(), 0x120), ..none() }),
        ("--can can0 --can-id 288", Lines { can: can(can0(), 0x120), ..none() }),
        ("--can can0 --slcan pty", Lines { can: can(CanBus::Slcan(SerialLine::Pty), 0x120), ..none() }),
        ("--profibus pty", Lines { profibus: Some(SerialLine::Pty), ..none() }),
        ("--gcl 127.0.0.1:1001 --gcl-udp 127.0.0.1:1501", Lines { gcl, gcl_udp, ..none() }),
        ("--modbus 127.0.0.1:1502", Lines { modbus: address("127.0.0.1:1502"), ..none() }),
        ("--tcp localhost:0", Lines { tcp: address("127.0.0.1:0"), ..none() }),
        ("--gcl LOCALHOST:1001", Lines { gcl, ..none() }),
        (
            "--tcp [::1]:0 --control localhost:8080",
            Lines { tcp: address("[::1]:0"), control: address("127.0.0.1:8080"), ..none() },
        ),
        ("--serial UNIX:/Run/wsg", Lines { serial: Some(SerialLine::Unix("/Run/wsg".into())), ..none() }),
        ("--slcan PTY", Lines { can: can(CanBus::Slcan(SerialLine::Pty), 0x120), ..none() }),
    ] {
        assert_eq!(options_of(line).lines, lines, "{line}");
    }
}

#[test]
fn options_of_the_fieldbuses_arrive() {
    let default = Config::default;
    let bus_reaction = SilenceReaction::FastStop;
    for (line, config) in [
        ("--profibus pty --profibus-address 12", Config { profibus_address: 12, ..default() }),
        ("--profibus pty", Config { profibus_address: 7, ..default() }),
        ("--profibus pty --bus-reaction fast-stop", Config { bus_reaction, ..default() }),
        ("--modbus 127.0.0.1:1502 --modbus-swap-bytes", Config { modbus_swap_bytes: true, ..default() }),
        ("--modbus 127.0.0.1:1502", Config { modbus_swap_bytes: false, ..default() }),
        (
            "--modbus 127.0.0.1:1502 --bus-timeout 500 --bus-reaction fast-stop",
            Config { bus_timeout_ms: 500, bus_reaction, ..default() },
        ),
    ] {
        assert_eq!(options_of(line).config, config, "{line}");
    }
}

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

#[test]
fn ethernetip_replaces_the_default_line() {
    for (line, address, vendor) in [
        ("--ethernetip 10.0.0.5 --bus-reaction hold", "10.0.0.5:44818", 0),
        ("--ethernetip 10.0.0.5:7 --ethernetip-vendor 9", "10.0.0.5:7", 9),
    ] {
        let lines = options_of(line).lines;
        assert_eq!(lines.ethernetip, Some(EthernetIpLine { address: address.parse().unwrap(), vendor }));
        assert_eq!(lines.tcp, None);
    }
    for (arguments, expected) in [
        (["--ethernetip-vendor", "5"], "without --ethernetip ADDR"),
        (["--ethernetip", "0.0.0.0"], "the IP address of a network card"),
        (["--ethernetip", "239.1.1.1"], "the IP address of a network card"),
        (["--ethernetip", "::1"], "the IP address of a network card"),
    ] {
        let error = format!("{:#}", options(&arguments).unwrap_err());
        assert!(error.contains(expected) && !error.contains('\n'), "{error}");
    }
}

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
fn every_option_arrives() {
    let all = "--profile real --homing-speed 30 --part-width-tolerance 7 --clamping-travel 250 --force 33 \
               --acceleration 700 --speed 60 --release-distance 12 --release-speed 90 --model wsg32 --serial-number 7 --tag cell --tcp 127.0.0.1:0 --udp 127.0.0.1:1500 \
               --udp-remote-port 9 --udp-unanswered 0 --serial pty --part 20:50:12.5 --no-overdrive --finger1 fmf --finger2 dsa --no-checksum-check \
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
        part: Part::new(20.0, 50.0).and_then(|part| part.with_inner_width(12.5)),
        overdrive: false,
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
fn control_keeps_the_default_line_and_a_port_is_local() {
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
        (&["--part", "20:50:20"], "'20:50:20' for '--part", "the inner width below the width"),
        (&["--part", "20:50:10:1"], "'20:50:10:1' for '--part", "INNER_WIDTH_MM"),
        (&["--tcp", "1000"], "'1000' for '--tcp", "127.0.0.1:1000"),
        (&["--soft-limits", "10"], "'10' for '--soft-limits", "10:90"),
        (&["--soft-limits", "90:10"], "'90:10' for '--soft-limits", "the smaller one first"),
        (&["--time-scale", "0"], "'0' for '--time-scale", "0.01"),
        (&["--time-scale"], "--time-scale", "--help"),
        (&["--finger1", "thumb"], "'thumb' for '--finger1", "generic"),
        (&["--control", "here"], "'here' for '--control", "127.0.0.1:8080"),
        (&["--control-host", "bench"], "--control-host", "--control ADDR"),
        (&["--control", "8080", "--control-host", "bench:80"], "'bench:80' for '--control-host", "a port"),
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
        (&["--gcl-verbose"], "--gcl-verbose", "--gcl ADDR"),
        (&["--profibus", "unix:"], "'unix:' for '--profibus", "unix:PATH"),
        (&["--profibus", "pty", "--profibus-address", "126"], "'126' for '--profibus-address", "125"),
        (&["--profibus-address", "9"], "--profibus-address", "--profibus LINE"),
        (&["--force", "1000"], "--force", "force 1000 N is outside the gripper's limits, 5 to 80 N"),
        (&["--model", "wsg25", "--force", "80"], "--model wsg25", "2 to 30 N"),
        (
            &["--homing-speed", "1"],
            "--homing-speed",
            "speed 1 mm/s is outside the gripper's limits, 5 to 420 mm/s",
        ),
        (&["--acceleration", "99999"], "--acceleration", "100 to 5000 mm/s²"),
        (&["--fast"], "--fast", "--help"),
        (&["--tpc", "localhost:0"], "'--tpc'", "tip: a similar argument exists: '--tcp'; "),
        (&["--modbsu=localhost:0"], "'--modbsu'", "exists: '--modbus'; "),
        (&["--finger"], "'--finger'", "arguments exist: '--finger1', '--finger2'; "),
        (&["--model", "wsg50"], "'wsg50'", "tip: some similar values exist: 'wsg50-110', 'wsg50-210'; "),
        (&["--model", "WSG 32"], "'WSG 32'", "tip: a similar value exists: 'wsg32'; "),
        (&["--bus-reaction", "faststop", "--profibus", "pty"], "'faststop'", "exists: 'fast-stop'; "),
        (&["--tcp", "bench:0"], "'bench:0' for '--tcp", "127.0.0.1:1000"),
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
            ", line 2: clamping-travl is unknown; expected options as --help lists them; did you mean clamping-travel?",
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
    let mark = options_of_file("mark", "\u{FEFF}model = \"wsg32\"\r\nforce = 9\r\n", &[]).unwrap();
    assert_eq!((mark.config.model, mark.config.force_limit), (Model::Wsg32, Some(9.0)));
    let error = format!("{:#}", options_of_file("wide", "m\0o\0", &[]).unwrap_err());
    assert!(error.contains("cannot be read: the text is UTF-16"), "{error}");
    let error = format!("{:#}", options(&["--config", "/no/such/file"]).unwrap_err());
    assert!(error.contains("/no/such/file cannot be read"), "{error}");
}

#[test]
fn help_is_for_a_terminal() {
    let help = command().render_long_help().to_string();
    assert!(help.contains("(docs/gcl.md)") && help.contains("'pty' creates"), "{help}");
    assert!(!help.contains(['`', '#']) && !help.contains("]("), "{help}");
}

/// Checks that the document lists every option with its default and meaning.
#[test]
fn options_in_the_document_are_those_of_the_program() {
    const BEGIN: &str = "<!-- generated: options -->\n";
    const END: &str = "<!-- end -->";
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/simulator.md");
    let document = std::fs::read_to_string(path).unwrap();
    let (before, rest) = document.split_once(BEGIN).unwrap();
    let (shown, after) = rest.split_once(END).unwrap();
    let mut list = String::new();
    for arg in definition().get_arguments() {
        let name = arg.get_long().unwrap();
        let help = arg.get_help().unwrap().to_string();
        let (meaning, default) = help.trim_end_matches(']').split_once(" [default: ").unwrap_or((&help, ""));
        let default = arg.get_default_values().first().map_or(default, |value| value.to_str().unwrap());
        let value = value_name(arg).map_or(String::new(), |name| format!(" {name}"));
        list += &format!("- `--{name}{value}`: {meaning}");
        // The parser of a switch has possible values, but the switch takes none.
        let values = if value.is_empty() { vec![] } else { arg.get_possible_values() };
        if !values.is_empty() {
            let names: Vec<_> = values.iter().map(|value| format!("`{}`", value.get_name())).collect();
            list += &format!(" ({})", names.join(", "));
        }
        if !default.is_empty() {
            list += &format!(". Default: {default}");
        }
        list.push('\n');
    }
    if std::env::var_os("WSG_UPDATE_DOCS").is_some() {
        std::fs::write(path, [before, BEGIN, &list, END, after].concat()).unwrap();
    } else {
        assert_eq!(shown, list, "WSG_UPDATE_DOCS=1 cargo test -p wsg-sim --lib writes it");
    }
}

#[test]
fn every_option_is_a_grouped_setting_or_the_programs() {
    let settings = settings();
    for arg in command().get_arguments() {
        let name = arg.get_long().unwrap();
        let is_setting = settings.iter().any(|setting| setting.name == name);
        assert_eq!(is_setting, arg.get_help_heading() != Some(PROGRAM), "{name}");
    }
    for name in AT_ONCE {
        assert!(settings.iter().any(|setting| setting.name == name), "{name}");
    }
    let of = |name: &str| settings.iter().find(|setting| setting.name == name).unwrap();
    let travel = of("clamping-travel");
    assert_eq!((&travel.group[..], travel.unit.as_deref(), &travel.default[..]), (MOTION, Some("mm"), "5"));
    assert_eq!((&travel.expected[..], travel.is_at_once), ("a number from 0 to 1000", true));
    assert_eq!(of("homing-default").choices, ["out", "in"]);
    assert_eq!((&of("homing-at-start").unit, of("homing-at-start").is_at_once), (&None, false));
    assert_eq!(of("force").default, "the model's");
}

#[test]
fn settings_change_one_by_one_and_return_to_their_defaults() {
    let before =
        options_of("--tcp 127.0.0.1:0 --no-checksum-check --force 12 --control 8080 --control-host bench");
    let change = |name: &str, words: Option<&[&str]>| {
        let words = words.map(|words| words.iter().map(|&word| word.to_owned()).collect());
        before.with(&vec![(name.to_owned(), words)])
    };
    let same = change("speed", None).unwrap();
    assert_eq!((same.config, same.lines), (before.config, before.lines.clone()));
    let given = change("force", Some(&["20"])).unwrap();
    assert_eq!(given.config, Config { force_limit: Some(20.0), ..before.config });
    assert_eq!(change("force", None).unwrap().config.force_limit, None);
    assert!(change("no-checksum-check", None).unwrap().config.check_checksum);
    assert!(change("homing-at-start", Some(&[])).unwrap().config.homing_at_start);
    let hosts = change("control-host", Some(&["bench", "cell"])).unwrap();
    assert_eq!(hosts.lines.control_hosts, ["bench", "cell"]);
    for (name, word, expected) in [
        ("force", "-1", "expected a number above 0"),
        ("udp", "127.0.0.1:1501", "--udp-remote-port"),
        ("can-id", "9", "--can-id has no effect without"),
    ] {
        let error = format!("{:#}", change(name, Some(&[word])).unwrap_err());
        assert!(error.contains(expected) && !error.contains('\n'), "{error}");
    }
}

/// A page without a server has no command line: it has the table, and its own parser of the settings of the gripper.
#[test]
fn page_without_a_server_has_the_same_settings() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/src/control/settings.tsv");
    let table: String = settings().iter().map(Setting::line).collect();
    if std::env::var_os("WSG_UPDATE_DOCS").is_some() {
        std::fs::write(file, &table).unwrap();
    }
    assert_eq!(std::fs::read_to_string(file).unwrap(), table, "set WSG_UPDATE_DOCS=1 to write the table");
    let mut known = 0;
    for row in settings() {
        for word in
            ["", "1", "30", "0x20", "out", "in", "none", "fmf", "20:100:15", "10:90", "wsg32", "stop", "a\nb"]
        {
            let words = if row.unit.is_some() { vec![word.to_owned()] } else { vec![] };
            let option =
                words.first().map_or(format!("--{}", row.name), |word| format!("--{}={word}", row.name));
            let by_command_line = Options::parse(vec![option.into()]).map(|options| options.config);
            let mut config = Config::default();
            if words::set(&mut config, &row.name, &words)
                .is_some_and(|()| words::check_limits(&config).is_ok())
            {
                known += 1;
                assert_eq!(by_command_line.unwrap(), config, "{} {word:?}", row.name);
            } else if words::is_of_gripper(&row.name) {
                assert!(by_command_line.is_err(), "{} {word:?}", row.name);
            }
        }
    }
    assert!(known > 60, "{known}");
}
