//! Settings that change while the gripper runs, their file, and the restart.

use crate::common::program::Program;
use crate::common::{go_to, grip};
use crate::control::request;
use crate::rig::{Client, File, await_true, connect};
use serde_json::{Value, json};
use std::io::Write;
use std::net::TcpStream;
use wsg_protocol::{Command, HomingDirection, Status};

/// The program with a configuration file.
struct SettingsRig {
    program: Program,
    tcp: String,
    control: String,
    file: File,
    client: Client<TcpStream>,
}

impl SettingsRig {
    fn new(name: &str, text: &str) -> Self {
        let file = File::new(&format!("{name}.toml"), text);
        let (program, tcp, control) = Program::with_control(&["--config", file.0.to_str().unwrap()]);
        let client = Client(connect(&tcp));
        Self { program, tcp, control, file, client }
    }

    fn request(&self, method: &str, path: &str, body: &str) -> (u16, Value) {
        request(&self.control, method, path, body)
    }

    /// Changes settings, which must succeed.
    fn set(&self, changes: &Value) -> Value {
        let (status, answer) = self.request("POST", "/settings", &changes.to_string());
        assert_eq!(status, 200, "{answer}");
        answer
    }

    /// Changes settings, which must fail, and returns the error.
    fn refused(&self, changes: &Value) -> (u16, String) {
        let (status, answer) = self.request("POST", "/settings", &changes.to_string());
        (status, answer["error"].as_str().expect("an error").to_owned())
    }

    fn setting(&self, name: &str) -> Value {
        let (_, answer) = self.request("GET", "/settings", "");
        let settings = answer["settings"].as_array().unwrap();
        settings.iter().find(|setting| setting["name"] == name).unwrap().clone()
    }

    fn state(&self) -> Value {
        self.request("GET", "/state", "").1
    }

    fn flags(&self) -> Vec<String> {
        serde_json::from_value(self.state()["system_state"].clone()).unwrap()
    }

    fn home(&mut self) {
        assert_eq!(self.client.run(Command::Homing { direction: HomingDirection::Default }), Status::Success);
    }
}

/// "Set Device Tag" (51h) stores the tag, as the command set describes it (3.5.2).
#[test]
fn tag_of_a_client_outlasts_a_restart_and_is_saved() {
    let mut rig = SettingsRig::new("tag", "tag = \"first\"\n");
    for tag in ["cell 7", "--odd: \\ \"quoted\"", ""] {
        let sent = wsg_protocol::DeviceTag::new(tag).unwrap();
        assert_eq!(rig.client.ask(Command::SetDeviceTag { tag: sent }), Status::Success);
        let expected = if tag.is_empty() { Status::NotAvailable } else { Status::Success };
        assert_eq!(rig.client.ask(Command::GetDeviceTag), expected);
        let setting = rig.setting("tag");
        assert_eq!(setting["value"].as_str().unwrap_or_default(), tag, "{setting}");
        assert_eq!(setting["pending"], json!(false), "{setting}");

        assert_eq!(rig.request("POST", "/restart", "").0, 200);
        for name in ["model", "tcp", "control", "page"] {
            rig.program.place_of(name);
        }
        rig.client = Client(connect(&rig.tcp));
        assert_eq!(rig.client.ask(Command::GetDeviceTag), expected, "{tag} after the restart");
    }
    assert_eq!(rig.file.text().trim(), "", "no tag is saved");
    let sent = wsg_protocol::DeviceTag::new("kept").unwrap();
    assert_eq!(rig.client.ask(Command::SetDeviceTag { tag: sent }), Status::Success);
    assert_eq!(rig.setting("tag")["value"], json!("kept"));
    assert_eq!(rig.file.text().trim(), "tag = \"kept\"");
}

#[test]
fn settings_change_at_once_and_reference_and_latched_state_stay() {
    let mut rig = SettingsRig::new("at_once", "time-scale = 20\npart = \"20\"\n");
    rig.home();
    // A part of 20 mm is 15 mm too early for a nominal width of 5 mm.
    assert_eq!(rig.client.run(grip(5.0)), Status::CmdFailed);
    rig.set(&json!({"part-width-tolerance": 20, "clamping-travel": "7.5"}));
    assert_eq!(rig.client.run(go_to(60.0)), Status::Success);
    assert_eq!(rig.client.run(grip(5.0)), Status::Success);
    assert!(rig.flags().contains(&"REFERENCED".to_owned()));

    assert_eq!(rig.client.ask(Command::FastStop), Status::Success);
    rig.set(&json!({"no-disconnect-error": true, "homing-default": "in", "part": "none"}));
    assert!(rig.flags().contains(&"FAST_STOP".to_owned()), "{:?}", rig.flags());
    assert_eq!(rig.client.ask(Command::ACKNOWLEDGE), Status::Success);
    // The end of the connection is no error any more.
    rig.client = Client(connect(&rig.tcp));
    rig.home();
    assert!(!rig.flags().contains(&"FAST_STOP".to_owned()));
    assert_eq!(rig.state()["width_mm"], json!(0.0), "homed inwards");
    let setting = rig.setting("clamping-travel");
    assert_eq!(
        [&setting["value"], &setting["default"], &setting["unit"], &setting["effect"], &setting["group"]],
        ["7.5", "5", "mm", "at once", "Motion configuration"]
    );
}

#[test]
fn checksum_evaluation_changes_for_a_connected_client() {
    let mut rig = SettingsRig::new("checksum", "");
    let stop = [0xAA, 0xAA, 0xAA, 0x22, 0, 0, 0, 0];
    rig.set(&json!({"answer-bad-checksum": true}));
    rig.client.0.write_all(&stop).unwrap();
    assert_eq!(rig.client.status(), Status::ChecksumError);
    rig.set(&json!({"no-checksum-check": true}));
    rig.client.0.write_all(&stop).unwrap();
    assert_eq!(rig.client.status(), Status::Success);
    rig.set(&json!({"no-checksum-check": null}));
    rig.client.0.write_all(&stop).unwrap();
    assert_eq!(rig.client.status(), Status::ChecksumError);
}

#[test]
fn only_motion_settings_are_refused_while_fingers_move() {
    let mut rig = SettingsRig::new("moving", "");
    assert_eq!(rig.client.ask(Command::Homing { direction: HomingDirection::Default }), Status::CmdPending);
    let (status, error) = rig.refused(&json!({"clamping-travel": 9, "tag": "x"}));
    assert_eq!((status, error.contains("the fingers move")), (409, true), "{error}");
    assert_eq!(
        [rig.setting("clamping-travel")["value"].clone(), rig.setting("tag")["value"].clone()],
        [json!(null), json!(null)]
    );
    rig.set(&json!({"tag": "x"}));
    assert_eq!(rig.file.text(), "tag = \"x\"\n");
}

#[test]
fn wrong_settings_are_refused_in_a_sentence_and_change_nothing() {
    let rig = SettingsRig::new("wrong", "# A cell\n");
    for (changes, expected) in [
        (json!({"clamping-travl": 5}), "\"clamping-travl\" is unknown"),
        (json!({"log": "/tmp/x"}), "\"log\" is unknown"),
        (json!({"script": "/tmp/x"}), "\"script\" is unknown"),
        (json!({"clamping-travel": -1}), "expected a number from 0 to 1000"),
        (json!({"clamping-travel": true}), "expected a number, a text or null"),
        (json!({"no-checksum-check": 1}), "expected true or false"),
        (json!({"control-host": "bench"}), "expected a list of texts"),
        (json!({"can-id": 9}), "--can-id has no effect without"),
        (json!({"tag": "x", "force": 0}), "expected a number above 0"),
        (json!({"tag": "\n"}), "expected up to 64 printable ASCII characters"),
    ] {
        let (status, error) = rig.refused(&changes);
        assert!(
            status == 400 && error.contains(expected) && !error.contains('\n'),
            "{changes}: {status} {error}"
        );
    }
    assert_eq!(rig.file.text(), "# A cell\n");
    assert_eq!(rig.setting("tag")["value"], json!(null));
}

#[test]
fn restart_settings_are_pending_and_survive_the_program() {
    let mut rig = SettingsRig::new("restart", "# A cell\nmodel = \"wsg32\"\nhoming-at-start = false\n");
    rig.home();
    let answer = rig.set(&json!({"model": "wsg25", "homing-at-start": true, "modbus": "127.0.0.1:0"}));
    assert_eq!(answer["restart_pending"], json!(true));
    assert_eq!((&rig.state()["model"], &rig.setting("model")["pending"]), (&json!("wsg32"), &json!(true)));
    assert!(rig.flags().contains(&"REFERENCED".to_owned()));
    let (status, _) = rig.request("POST", "/restart", "");
    assert_eq!(status, 200);
    // The program announces its lines again: the same addresses, and the new line.
    assert_eq!(rig.program.line(), "model wsg25");
    assert_eq!(rig.program.place_of("tcp"), rig.tcp);
    let modbus = rig.program.place_of("modbus");
    assert_eq!(rig.program.place_of("control"), rig.control);
    connect(&modbus);
    assert_eq!(rig.setting("model")["pending"], json!(false));
    await_true("it must home at the start", || rig.flags().contains(&"REFERENCED".to_owned()));
    let (_, log) = rig.request("GET", "/log", "");
    let texts: Vec<&str> =
        log["entries"].as_array().unwrap().iter().map(|entry| entry["text"].as_str().unwrap()).collect();
    for text in ["started as wsg32", "setting model: wsg32 -> wsg25", "restart", "started as wsg25"] {
        assert!(texts.contains(&text), "{text}: {texts:?}");
    }
    assert!(
        !texts.iter().any(|text| text.contains("FAST STOP")),
        "a restart is no lost connection: {texts:?}"
    );

    let text = rig.file.text();
    assert_eq!(text, "# A cell\nmodel = \"wsg25\"\nhoming-at-start = true\nmodbus = \"127.0.0.1:0\"\n");
    let file = File::new("second.toml", &text);
    let mut program = Program::start(&["--config", file.0.to_str().unwrap(), "--tcp", "127.0.0.1:0"]);
    assert_eq!(program.line(), "model wsg25");
}

#[test]
fn failed_restart_returns_to_the_earlier_settings() {
    let mut rig = SettingsRig::new("bad_restart", "");
    rig.set(&json!({"model": "wsg25", "udp": "203.0.113.9:1500"}));
    assert_eq!(rig.request("POST", "/restart", "").0, 200);
    assert_eq!(rig.program.line(), "model wsg50-110");
    assert_eq!(rig.program.place_of("tcp"), rig.tcp);
    assert_eq!(rig.program.place_of("control"), rig.control);
    let (_, log) = rig.request("GET", "/log", "");
    assert!(
        log.to_string().contains("the restart failed, and the earlier settings count: UDP cannot listen"),
        "{log}"
    );
}
