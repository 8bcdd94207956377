//! The system log: what it records, and where it is read (command set, 3.2.4 and 3.3.8).

use crate::common::program::Program;
use crate::control::ControlRig;
use crate::rig::{Client, await_some, await_true};
use serde_json::{Value, json};
use wsg_protocol::types::AckKey;
use wsg_protocol::{Command, Status};
use wsg_sim::Config;

/// Returns severity, source and text of each entry.
fn entries(rig: &ControlRig) -> Vec<[String; 3]> {
    let (status, log) = rig.request("GET", "/log", "");
    assert_eq!(status, 200);
    let text = |entry: &Value, key: &str| entry[key].as_str().unwrap().to_owned();
    let entries = log["entries"].as_array().unwrap().iter();
    entries.map(|entry| ["severity", "source", "text"].map(|key| text(entry, key))).collect()
}

/// Waits for an entry and returns its severity and source.
fn until(rig: &ControlRig, text: &str) -> [String; 2] {
    await_some(text, || {
        let [severity, source, _] = entries(rig).into_iter().find(|entry| entry[2] == text)?;
        Some([severity, source])
    })
}

#[test]
fn lost_connection_leaves_a_line_and_its_fast_stop_another() {
    let mut rig = ControlRig::new(Config::default());
    assert_eq!(until(&rig, "started as wsg50-110"), ["info", "gripper"]);
    assert_eq!(rig.client.ask(Command::Stop), Status::Success);
    let name = format!("tcp {}", rig.client.0.local_addr().unwrap());
    assert_eq!(until(&rig, "connected"), ["info", &name]);

    rig.client = Client::of(&rig.server);

    assert_eq!(until(&rig, "FAST STOP by a lost connection"), ["error", &name]);
    let lost = "the connection ended without a Disconnect Announcement";
    assert_eq!(until(&rig, lost), ["warning", &name]);
    rig.post("/command", &json!({"command": "acknowledge"}));
    assert_eq!(until(&rig, "FAST STOP acknowledged by command"), ["info", "page"]);
}

#[test]
fn announced_end_of_a_connection_is_no_warning() {
    let mut rig = ControlRig::new(Config::default());
    assert_eq!(rig.client.ask(Command::DisconnectAnnouncement), Status::Success);
    let name = format!("tcp {}", rig.client.0.local_addr().unwrap());
    rig.client = Client::of(&rig.server);
    assert_eq!(until(&rig, "disconnected"), ["info", &name]);
    assert!(entries(&rig).iter().all(|[severity, ..]| severity == "info"));
}

#[test]
fn fast_stop_and_overdrive_name_the_client_that_sent_them() {
    let mut rig = ControlRig::new(Config::default());
    let name = format!("tcp {}", rig.client.0.local_addr().unwrap());
    for command in [
        Command::FastStop,
        Command::Acknowledge { key: AckKey },
        Command::OverdriveMode { enabled: true },
        Command::OverdriveMode { enabled: false },
    ] {
        assert_eq!(rig.client.ask(command), Status::Success);
    }
    rig.post("/command", &json!({"command": "fast_stop"}));
    let all = entries(&rig);
    let of_client: Vec<_> = all.iter().filter(|[_, source, _]| *source == name).collect();
    let texts: Vec<&str> = of_client.iter().map(|[.., text]| &text[..]).collect();
    let expected = [
        "connected",
        "FAST STOP by command",
        "FAST STOP acknowledged by command",
        "overdrive mode entered",
        "overdrive mode left",
    ];
    assert_eq!(texts, expected);
    assert_eq!(all.last().unwrap(), &["warning", "page", "FAST STOP by command"]);
}

#[test]
fn faults_are_errors_and_stop_the_gripper_by_name() {
    let rig = ControlRig::new(Config::default());
    rig.post("/fault", &json!({"fault": "motor_current", "on": true}));
    rig.post("/fault", &json!({"fault": "motor_current", "on": false}));
    let all = entries(&rig);
    let from = all.iter().position(|entry| entry[2] == "fault MotorCurrent injected").unwrap();
    let expected = [
        ["info", "page", "fault MotorCurrent injected"],
        ["error", "gripper", "CURR_FAULT set"],
        ["error", "gripper", "FAST STOP by a fault"],
        ["info", "page", "fault MotorCurrent removed"],
        ["info", "gripper", "CURR_FAULT cleared"],
    ];
    let mut found: Vec<_> = all[from..].to_vec();
    // Flags of one moment have no order.
    found[1..3].sort_by(|one, next| one[2].cmp(&next[2]));
    assert_eq!(found, expected.map(|entry| entry.map(str::to_owned)));
}

#[test]
fn log_is_a_file_on_request_and_by_option() {
    let path = std::env::temp_dir().join(format!("wsg-sim-system-{}.log", std::process::id()));
    let arguments = ["--tcp", "127.0.0.1:0", "--system-log", path.to_str().unwrap()];
    for count in 1..=2 {
        let mut program = Program::start(&arguments);
        assert_eq!(program.line(), "model wsg50-110");
        let starts = || {
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            text.lines().filter(|line| line.ends_with("info    gripper: started as wsg50-110")).count()
        };
        await_true("each start must append a line", || starts() >= count);
    }
    std::fs::remove_file(&path).unwrap();

    let rig = ControlRig::new(Config::default());
    let (status, head, body) = rig.http("GET /log.txt HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert_eq!(status, 200);
    assert!(head.to_lowercase().contains("content-disposition: attachment"), "{head}");
    assert!(body.lines().next().unwrap().ends_with("info    gripper: started as wsg50-110"), "{body}");
}
