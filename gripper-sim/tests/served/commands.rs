//! Commands through the control interface: their limits, their age, and the WebSocket of a page.

use crate::common::go_to;
use crate::control::{ControlRig, request};
use crate::rig::{HOMING, await_some, await_true, connect};
use serde_json::{Value, json};
use std::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{self, Message, WebSocket};
use wsg_protocol::{Command, Status};
use wsg_sim::Config;

/// The events and answers of a page.
struct Page(WebSocket<TcpStream>);

impl Page {
    fn open(rig: &ControlRig, origin: Option<&str>) -> tungstenite::Result<Self> {
        let address = rig.server.control_address().unwrap();
        let mut request = format!("ws://{address}/events").into_client_request()?;
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", origin.parse().unwrap());
        }
        let opened = tungstenite::client(request, connect(address));
        opened.map(|(socket, _)| Self(socket)).map_err(|error| match error {
            tungstenite::HandshakeError::Failure(error) => error,
            interrupted => panic!("{interrupted}"),
        })
    }

    /// Opens a page of this server.
    fn of(rig: &ControlRig) -> Self {
        let origin = format!("http://{}", rig.server.control_address().unwrap());
        Self::open(rig, Some(&origin)).unwrap()
    }

    /// Returns the data of the next event of this kind.
    fn next(&mut self, kind: &str) -> Value {
        await_some(kind, || {
            let message = self.0.read().expect("an event in time");
            let text = message.to_text().unwrap();
            let (first, data) = text.trim_end().split_once("\ndata: ").expect("an event");
            (first == format!("event: {kind}")).then(|| serde_json::from_str(data).expect("JSON"))
        })
    }

    fn send(&mut self, text: &str) {
        self.0.send(Message::text(text)).unwrap();
    }

    /// Sends a command and returns the status and the body of its answer.
    fn ask(&mut self, as_of: &Value, body: Value) -> (Value, Value) {
        self.send(&json!({ "id": 7, "as_of": as_of, "body": body }).to_string());
        let answer = self.next("answer");
        assert_eq!(answer["id"], 7);
        (answer["status"].clone(), answer["body"].clone())
    }
}

/// Returns the state of another start of the gripper, which no request of this one may name.
fn state_of_another_start() -> String {
    ControlRig::new(Config::default()).state()["as_of"].as_str().unwrap().to_owned()
}

#[test]
fn number_outside_the_limits_is_refused_before_anything_is_sent() {
    let mut rig = ControlRig::homed();
    for (number, expected, bodies) in [
        ("width", "0 to 110 mm", [r#""width_mm":-0.1"#, r#""width_mm":110.1"#]),
        (
            "speed",
            "5 to 420 mm/s",
            [r#""width_mm":50,"speed_mm_per_s":4.9"#, r#""width_mm":50,"speed_mm_per_s":421"#],
        ),
    ] {
        for command in ["move", "grip", "release"] {
            for body in bodies {
                let body = format!(r#"{{"command":"{command}",{body}}}"#);
                let (status, answer) = rig.request("POST", "/command", &body);
                let error = answer["error"].as_str().unwrap();
                assert_eq!(status, 400, "{body}: {error}");
                assert!(
                    error.starts_with(number) && error.ends_with(&format!("limits, {expected}")),
                    "{error}"
                );
            }
        }
    }
    let grip = |force: f32| json!({"command":"grip","width_mm":50,"force_n":force}).to_string();
    for force in [500.0, -1.0, 4.9, 80.1] {
        let (status, answer) = rig.request("POST", "/command", &grip(force));
        assert_eq!(status, 400, "{force}: {answer}");
        assert!(answer["error"].as_str().unwrap().ends_with("limits, 5 to 80 N"), "{answer}");
    }
    let state = rig.state();
    assert_eq!(
        (&state["width_mm"], &state["force_limit_n"], &state["gripper_state"]),
        (&json!(110.0), &json!(40.0), &json!("IDLE"))
    );

    // Overdrive raises the greatest force.
    assert_eq!(rig.client.ask(Command::OverdriveMode { enabled: true }), Status::Success);
    assert_eq!(rig.request("POST", "/command", &grip(120.1)).0, 400);
    let (status, state) = rig.request("POST", "/command", &grip(120.0));
    assert_eq!((status, &state["force_limit_n"]), (200, &json!(120.0)));
}

#[test]
fn refused_grip_leaves_the_force_limit_as_it_was() {
    let mut rig = ControlRig::new(Config { time_scale: 20.0, ..Config::default() });
    let grip = r#"{"command":"grip","width_mm":50,"force_n":70}"#;
    let refused = |rig: &ControlRig, status: &str| {
        let (code, answer) = rig.request("POST", "/command", grip);
        assert_eq!(code, 409, "{answer}");
        assert!(answer["error"].as_str().unwrap().ends_with(status), "{answer}");
        let state = rig.state();
        assert_eq!(state["force_limit_n"], json!(40.0), "{status}");
        assert!(state["system_state"].to_string().contains("CMD_FAILURE"), "{state}");
    };
    refused(&rig, "E_NOT_INITIALIZED");
    assert_eq!(rig.client.run(HOMING), Status::Success);
    let limits = wsg_protocol::SoftLimits { minus: 60.0, plus: 110.0 };
    assert_eq!(rig.client.ask(Command::SetSoftLimits { limits }), Status::Success);
    refused(&rig, "E_RANGE_ERROR");
    rig.post("/command", &json!({"command":"fast_stop"}));
    refused(&rig, "E_ACCESS_DENIED");
}

/// Each request that changes something, and one for the same path that does not, or that stops.
const CHANGES: [(&str, &str, Option<&str>); 8] = [
    ("/command", r#"{"command":"home"}"#, Some(r#"{"command":"fast_stop"}"#)),
    ("/command", r#"{"command":"acknowledge"}"#, Some(r#"{"command":"stop"}"#)),
    ("/part", r#"{"width_mm":20}"#, None),
    ("/fault", r#"{"fault":"motor_current","on":true}"#, None),
    ("/line", r#"{"drop":1}"#, None),
    (
        "/frame",
        r#"{"command":"Homing","payload":"0","send":true}"#,
        Some(r#"{"command":"0x23","send":true}"#),
    ),
    (
        "/frame",
        r#"{"command":"0x20","payload":"0","send":true}"#,
        Some(r#"{"command":"Homing","payload":"0"}"#),
    ),
    ("/scripts", r#"{"action":"run","name":"x.lua"}"#, Some(r#"{"action":"stop"}"#)),
];

#[test]
fn request_with_an_old_state_is_refused_except_stops() {
    let rig = ControlRig::new(Config::default());
    let old = state_of_another_start();
    for (path, change, other) in CHANGES {
        let (status, answer) = rig.request("POST", &format!("{path}?as_of={old}"), change);
        assert_eq!(status, 412, "{path} {change}: {answer}");
        assert!(answer["error"].as_str().unwrap().contains("before its last start"), "{answer}");
        if let Some(other) = other {
            let (status, answer) = rig.request("POST", &format!("{path}?as_of={old}"), other);
            assert_eq!(status, 200, "{path} {other}: {answer}");
        }
    }
    for (path, change) in [("/settings", r#"{"tag":"x"}"#), ("/restart", "{}")] {
        assert_eq!(rig.request("POST", &format!("{path}?as_of={old}"), change).0, 412, "{path}");
    }
    let state = rig.state();
    assert_eq!(
        (&state["part"], &state["faults"], &state["line"]["drop"]),
        (&Value::Null, &json!([]), &json!(0.0))
    );
    assert_eq!(
        state["system_state"],
        json!(["AXIS_STOPPED", "FAST_STOP"]),
        "the stops were executed, and the acknowledgement was not"
    );
}

#[test]
fn latest_state_is_accepted_and_a_misspelt_query_refused() {
    let rig = ControlRig::new(Config::default());
    let as_of = rig.state()["as_of"].as_str().unwrap().to_owned();
    let part = |query: &str| rig.request("POST", &format!("/part{query}"), r#"{"width_mm":20}"#);
    for query in ["?as_off=1", "?seen=1", "?", "?as_of", &format!("?AS_OF={as_of}")] {
        let (status, answer) = part(query);
        assert_eq!(status, 400, "{query}: {answer}");
        assert!(answer["error"].as_str().unwrap().contains("expected as_of="), "{answer}");
    }
    assert_eq!(rig.state()["part"], Value::Null);
    let as_of = rig.state()["as_of"].as_str().unwrap().to_owned();
    assert_eq!(part(&format!("?as_of={as_of}")).0, 200);
}

#[test]
fn page_and_proxy_must_name_a_state_except_for_stops() {
    let rig = ControlRig::homed();
    let host = rig.server.control_address().unwrap().to_string();
    let post = |header: &str, query: &str, body: &str| {
        let (status, _, body) = rig.http(&format!(
            "POST /command{query} HTTP/1.1\r\nHost: {host}\r\n{header}\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        ));
        (status, body)
    };
    for header in [
        format!("Origin: http://{host}"),
        "X-Forwarded-For: 192.0.2.7".to_owned(),
        "Via: 1.1 proxy".to_owned(),
    ] {
        let (status, error) = post(&header, "", r#"{"command":"home"}"#);
        assert!(status == 428 && error.contains("as_of"), "{header}: {error}");
        assert_eq!(post(&header, "", r#"{"command":"stop"}"#).0, 200, "{header}");
        let as_of = rig.state()["as_of"].as_str().unwrap().to_owned();
        assert_eq!(post(&header, &format!("?as_of={as_of}"), r#"{"command":"stop"}"#).0, 200, "{header}");
    }
}

#[test]
fn page_commands_over_its_websocket_and_sees_what_they_do() {
    let rig = ControlRig::new(Config { time_scale: 20.0, ..Config::default() });
    let mut page = Page::of(&rig);
    assert_eq!(page.next("hello")["limits"]["stroke_mm"], json!(110.0));
    let seen = page.next("state");
    assert!(seen["time_s"].is_number() && seen["state"]["as_of"].is_null(), "{seen}");

    let (status, state) = page.ask(&seen["as_of"], json!({"command":"home"}));
    assert_eq!(status, 200, "{state}");
    while page.next("state")["state"]["system_state"][0] != "REFERENCED" {}

    // A Stop names no state, and the answer to it is the state from which the next command is sent.
    let (status, state) = page.ask(&Value::Null, json!({"command":"stop"}));
    assert_eq!(status, 200);
    let (status, refused) = page.ask(&seen["as_of"], json!({"command":"move","width_mm":50}));
    assert_eq!(status, 412, "{refused}");
    let (status, state) = page.ask(&state["as_of"], json!({"command":"move","width_mm":50}));
    assert_eq!(status, 200, "{state}");
    let (status, refused) = page.ask(&Value::Null, json!({"command":"move","width_mm":60}));
    assert_eq!(status, 428, "{refused}");
    let (status, refused) = page.ask(&state["as_of"], json!({"command":"move","width_mm":200}));
    assert!(status == 400 && refused["error"].as_str().unwrap().contains("0 to 110"), "{refused}");
    for wrong in ["", "{}", "null", r#"{"id":1,"body":{"command":"dance"}}"#] {
        page.send(wrong);
        let answer = page.next("answer");
        assert!(answer["status"] == 400 && answer["id"].is_null(), "{answer}");
    }
    let (status, state) = page.ask(&Value::Null, json!({"command":"fast_stop"}));
    assert_eq!(status, 200);
    assert!(state["system_state"].to_string().contains("FAST_STOP"), "{state}");
}

/// The acknowledgement of one page must not end a FAST STOP that its operator has not seen.
#[test]
fn page_command_from_before_the_latest_stop_is_refused() {
    let mut rig = ControlRig::homed();
    let mut page = Page::of(&rig);
    let before = page.next("state");
    for fast_stop in [
        &mut |rig: &mut ControlRig| drop(rig.post("/command", &json!({"command":"fast_stop"}))),
        // A client sends it, and the page acknowledges an earlier one.
        &mut (|rig: &mut ControlRig| assert_eq!(rig.client.ask(Command::FastStop), Status::Success))
            as &mut dyn FnMut(&mut ControlRig),
    ] {
        fast_stop(&mut rig);
        let (status, refused) = page.ask(&before["as_of"], json!({"command":"acknowledge"}));
        assert!(
            status == 412 && refused["error"].as_str().unwrap().contains("not seen the latest stop"),
            "{refused}"
        );
        while !page.next("state")["state"]["system_state"].to_string().contains("FAST_STOP") {}
        let (status, state) = page.ask(&rig.state()["as_of"], json!({"command":"acknowledge"}));
        assert_eq!(status, 200, "{state}");
    }
    assert_eq!(rig.client.run(go_to(50.0)), Status::Success);
}

/// A page sends a stop on two ways. The second one must not undo what an operator does meanwhile.
#[test]
fn command_with_the_key_of_an_earlier_one_is_not_executed_again() {
    let rig = ControlRig::homed();
    let mut page = Page::of(&rig);
    let fast_stop = json!({"command":"fast_stop","key":9_007_199_254_740_991u64});
    assert_eq!(page.ask(&Value::Null, fast_stop.clone()).0, 200);
    let state = rig.post("/command", &json!({"command":"acknowledge","key":1}));
    assert_eq!(state["gripper_state"], "IDLE");
    assert_eq!(rig.post("/command", &fast_stop)["gripper_state"], "IDLE");
    // A refused one is not kept.
    let grip = json!({"command":"grip","width_mm":50,"key":2});
    rig.post("/command", &json!({"command":"fast_stop","key":3}));
    assert_eq!(rig.request("POST", "/command", &grip.to_string()).0, 409);
    rig.post("/command", &json!({"command":"acknowledge","key":4}));
    assert_eq!(rig.post("/command", &grip)["gripper_state"], "GRIPPING");
}

#[test]
fn fast_stop_of_a_page_that_reads_nothing_is_executed() {
    let rig = ControlRig::homed();
    let mut page = Page::of(&rig);
    // Far more answers than the server keeps for a page.
    for _ in 0..10_000 {
        page.send(r#"{"id":1,"body":{"command":"stop"}}"#);
    }
    page.send(r#"{"id":2,"body":{"command":"fast_stop"}}"#);
    await_true("the FAST STOP", || rig.state()["system_state"].to_string().contains("FAST_STOP"));
}

#[test]
fn foreign_websocket_and_overlong_message_are_rejected() {
    let rig = ControlRig::new(Config::default());
    for origin in ["http://example.com", "null"] {
        match Page::open(&rig, Some(origin)).err() {
            Some(tungstenite::Error::Http(answer)) => assert_eq!(answer.status(), 403, "{origin}"),
            other => panic!("{origin}: {other:?}"),
        }
    }
    let mut page = Page::of(&rig);
    page.send(&format!("{:4096}", ""));
    assert_eq!(page.next("answer")["status"], 400);
    page.send(&format!("{:4097}", ""));
    await_true("the server reads a message that is too long", || page.0.read().is_err());
    let state = request(rig.server.control_address().unwrap(), "GET", "/state", "");
    assert_eq!(state.0, 200);
}

/// A client that has given up, for example after a time-out, no longer expects its command.
#[cfg(unix)]
#[test]
fn request_of_a_closed_connection_is_discarded() {
    use crate::common::program::Program;
    use rustix::process::Signal;
    use std::io::Write;

    let (program, _, control) = Program::with_control(&["--time-scale", "0.01"]);
    let post = |body: &str| {
        let len = body.len();
        let mut stream = connect(&control);
        stream
            .write_all(
                format!("POST /command HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len}\r\n\r\n{body}")
                    .as_bytes(),
            )
            .unwrap();
        stream
    };
    for _ in 0..20 {
        program.signal(Signal::STOP);
        drop(post(r#"{"command":"home"}"#));
        program.signal(Signal::CONT);
    }
    // Later connections are served later.
    let state = request(&control, "GET", "/state", "").1;
    assert_eq!(
        (&state["speed_mm_per_s"], &state["system_state"]),
        (&json!(0.0), &json!([])),
        "the fingers rest"
    );

    program.signal(Signal::STOP);
    drop(post(r#"{"command":"fast_stop"}"#));
    program.signal(Signal::CONT);
    await_true("a stop is executed", || {
        request(&control, "GET", "/state", "").1["system_state"] == json!(["FAST_STOP"])
    });
}
