use std::fs;

use super::*;

const BROKER: &str = "[broker]\naddress = \"mqtt://broker\"\n";
const NODE: &str = "[node]\ngroup = \"plant\"\nname = \"cell\"\nstate_file = \"state\"\n";
const GRIPPER: &str = "[[gripper]]\nname = \"left\"\naddress = \"tcp://192.168.1.20\"\n";

fn parsed(text: &str) -> Result<Telemetry> {
    Telemetry::parse("cell.toml", text)
}

#[test]
fn minimal_file_has_the_defaults_of_the_table() {
    let telemetry = parsed(&[BROKER, NODE, GRIPPER].concat()).unwrap();

    assert_eq!(
        (telemetry.broker.host.as_str(), telemetry.broker.client_id.as_str()),
        ("broker:1883", "wsg-plant-cell")
    );
    assert!(telemetry.broker.tls_name.is_none() && telemetry.broker.user.is_none());
    assert_eq!((telemetry.broker.keep_alive.as_secs(), telemetry.store), (10, 100_000));
    assert_eq!((telemetry.data.period_ms, telemetry.data.width_deadband), (100, 0.05));
    assert_eq!((telemetry.command_age_ms, telemetry.devices[0].allows_commands), (2_000, false));
    assert_eq!(telemetry.devices[0].source, Source::Gripper(Address::Tcp("192.168.1.20:1000".to_owned())));
}

#[test]
fn commands_are_allowed_only_for_the_gripper_that_enables_them() {
    let telemetry = parsed(
        &[BROKER, NODE, GRIPPER, "allow_commands = true\n", &GRIPPER.replace("left", "right")].concat(),
    );
    let allowed = telemetry.unwrap().devices.into_iter().map(|device| device.allows_commands);
    assert_eq!(allowed.collect::<Vec<_>>(), [true, false]);
}

#[test]
fn every_default_is_a_valid_value() {
    let place = Place { file: "the table".to_owned(), line: 1 };
    for setting in SETTINGS {
        if let Some(default) = setting.default {
            setting.check(default, &place).unwrap();
        }
    }
}

#[test]
fn addresses_have_the_default_port_of_their_kind() {
    for (text, expected) in [
        ("tcp://left", Some(Address::Tcp("left:1000".to_owned()))),
        ("tcp://[fe80::1]:7", Some(Address::Tcp("[fe80::1]:7".to_owned()))),
        ("udp://left", Some(Address::Udp { host: "left:1500".to_owned(), local_port: 1501 })),
        ("udp://left:7?local=8", Some(Address::Udp { host: "left:7".to_owned(), local_port: 8 })),
        ("serial:/dev/ttyUSB0", Some(Address::Serial("/dev/ttyUSB0".to_owned()))),
        ("TCP://Left", Some(Address::Tcp("Left:1000".to_owned()))),
        ("Serial:COM3", Some(Address::Serial("COM3".to_owned()))),
        ("tcp:/127.0.0.1", None),
        ("left", None),
        ("tcp://", None),
        ("tcp://left:x", None),
        ("tcp://a:b:1", None),
        ("udp://left?local=x", None),
        ("serial:", None),
        ("can:can0", None),
    ] {
        assert_eq!(address_of(text), expected, "{text}");
    }
}

#[test]
fn each_mistake_is_one_line_with_its_place_and_expected_value() {
    let in_broker = |line: &str| [BROKER, line, "\n", NODE, GRIPPER].concat();
    for (text, place, expected) in [
        (String::new(), "cell.toml", "missing section [broker]"),
        (BROKER.to_owned(), "cell.toml", "missing section [node]"),
        ([BROKER, NODE].concat(), "cell.toml", "no [[gripper]]"),
        ("[broker\n".to_owned(), "cell.toml, line 1", "unclosed table"),
        (in_broker("x = "), "cell.toml, line 3", "value"),
        (in_broker("adress = \"x\""), "cell.toml, line 3", "expected one of address, user"),
        (in_broker("keep_alive_s = 0"), "cell.toml, line 3", "a whole number from 1 to 600"),
        (in_broker("keep_alive_s = [1]"), "cell.toml, line 3", "expected text or a number"),
        (in_broker("reconnect_s = \"soon\""), "cell.toml, line 3", "a number from 0.1 to 600"),
        (in_broker("ca_file = \"ca.pem\""), "cell.toml, line 3", "require mqtts://"),
        (in_broker("password_file = \"/none\"\nuser = \"a\""), "cell.toml, line 3", "No such file"),
        (in_broker("password_env = \"WSG_NONE\"\nuser = \"a\""), "cell.toml, line 3", "variable not set"),
        (
            in_broker("password_file = \"a\"\npassword_env = \"b\""),
            "cell.toml, line 4",
            "conflicts with password_file",
        ),
        (
            in_broker("[brokers]"),
            "cell.toml, line 3",
            "expected [broker], [node], [data], [[gripper]] or [[bridge]]",
        ),
        (in_broker("[gripper]\nname = \"a\"").replace(GRIPPER, ""), "cell.toml, line 3", "double brackets"),
        (["[[broker]]\n", NODE, GRIPPER].concat(), "cell.toml, line 1", "expected [broker]"),
        (
            ["[broker]\naddress = \"tcp://x\"\n", NODE, GRIPPER].concat(),
            "cell.toml, line 2",
            "mqtts://HOST[:PORT]",
        ),
        (["[broker]\n", NODE, GRIPPER].concat(), "cell.toml, line 1", "\"address\" is missing: `mqtt://"),
        (
            [BROKER, NODE, "[[gripper]]\nname = \"a\"\n"].concat(),
            "cell.toml, line 7",
            "\"address\" is missing",
        ),
        (
            [BROKER, NODE, GRIPPER, "allow_commands = \"yes\"\n"].concat(),
            "cell.toml, line 10",
            "true or false",
        ),
        (
            [BROKER, NODE, "[[bridge]]\nname = \"a\"\ndevice = \"tcp://a:b\"\n"].concat(),
            "cell.toml, line 9",
            "invalid port `b`; expected 0 to 65535",
        ),
        (
            [BROKER, NODE, "[[bridge]]\nname = \"a\"\ndevice = \"tcp://a?unit=256\"\n"].concat(),
            "cell.toml, line 9",
            "wrong address `tcp://a?unit=256`; expected tcp://HOST[:502][?unit=1]",
        ),
        (
            [BROKER, NODE, "[[bridge]]\nname = \"a\"\ndevice = \"b\"\nallow_commands = true\n"].concat(),
            "cell.toml, line 10",
            "has no setting \"allow_commands\"",
        ),
        ([BROKER, NODE, "command_age_ms = 99\n", GRIPPER].concat(), "cell.toml, line 7", "from 100 to 60000"),
        ([BROKER, NODE, GRIPPER, GRIPPER].concat(), "cell.toml, line 11", "another device has this name"),
        (
            [BROKER, NODE, &GRIPPER.replace("left", "a/b")].concat(),
            "cell.toml, line 8",
            "a name without +, # and /",
        ),
        (
            [BROKER, NODE, &GRIPPER.replace("tcp", "http")].concat(),
            "cell.toml, line 9",
            "expected tcp://HOST[:1000], udp://HOST[:1500][?local=1501] or serial:DEVICE",
        ),
    ] {
        let error = format!("{:#}", parsed(&text).unwrap_err());
        assert!(error.starts_with(place) && error.contains(expected) && !error.contains('\n'), "{error}");
    }
}

#[test]
fn file_of_any_editor_is_read_and_its_line_numbers_stay() {
    let path = env::temp_dir().join(format!("wsg-config-{}", std::process::id()));
    let text = ["\u{FEFF}", BROKER, NODE, GRIPPER].concat().replace('\n', "\r\n");
    fs::write(&path, &text).unwrap();
    let telemetry = Telemetry::read(&path).map(|telemetry| telemetry.node);
    fs::write(&path, text.replace("group", "groop")).unwrap();
    let mistake = Telemetry::read(&path).unwrap_err().to_string();
    fs::remove_file(&path).unwrap();

    assert_eq!(telemetry.unwrap(), "cell");
    assert!(mistake.contains(", line 4: "), "{mistake}");
}

#[test]
fn scheme_of_the_broker_may_be_in_upper_case() {
    let telemetry = parsed(&[&BROKER.replace("mqtt://", "MQTTS://"), NODE, GRIPPER].concat()).unwrap();
    assert_eq!((telemetry.broker.host.as_str(), telemetry.broker.tls_name.is_some()), ("broker:8883", true));
}

#[test]
fn password_is_the_first_line_of_its_file_and_is_never_logged() {
    let path = env::temp_dir().join(format!("wsg-password-{}", std::process::id()));
    fs::write(&path, "secret word\nignored\n").unwrap();
    let text = [BROKER, &format!("user = \"cell\"\npassword_file = {path:?}\n"), NODE, GRIPPER].concat();

    let telemetry = parsed(&text).unwrap();
    fs::write(&path, "\u{FEFF}secret word\r\n").unwrap();
    let of_notepad = parsed(&text).unwrap();
    fs::write(&path, b"\xFF\xFEs\0e\0\r\0\n\0").unwrap();
    let wide = parsed(&text).unwrap_err().to_string();
    fs::write(&path, "\n").unwrap();
    let empty = parsed(&text).unwrap_err().to_string();
    fs::remove_file(&path).unwrap();

    for telemetry in [&telemetry, &of_notepad] {
        assert_eq!(telemetry.broker.password.as_ref().unwrap().0, "secret word");
    }
    assert!(wide.contains("the text is UTF-16; save it as UTF-8"), "{wide}");
    assert!(!format!("{telemetry:?}").contains("secret word"));
    assert!(empty.contains("the password is empty"), "{empty}");
}
