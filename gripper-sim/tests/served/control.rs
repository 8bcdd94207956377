//! The control interface and the line faults that it sets. Every wait is bounded by a socket time-out.

use crate::common::{go_to, grip, parse};
use crate::rig::{
    BOUND, Client, HOMING, Logged, any_port, await_some, await_true, connect, frame, http, recv_datagram,
    serve, udp_socket,
};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};
use wsg_protocol::{Command, FrameEncoder, LoopData, Status};
use wsg_sim::server::{Lines, ServerThread, UdpLine};
use wsg_sim::{Config, Finger, MAX_FRAME_LEN};

/// Sends a request and returns the status and the JSON of the answer.
pub(crate) fn request(control: impl ToSocketAddrs, method: &str, path: &str, body: &str) -> (u16, Value) {
    let len = body.len();
    let (status, _, body) = http(
        control,
        &format!("{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len}\r\n\r\n{body}"),
    );
    (status, serde_json::from_str(&body).expect("every answer is JSON"))
}

/// The data of the Loop that a client sends over a line without faults.
const MARK: &[u8] = b"the line is whole again";

pub(crate) struct ControlRig {
    pub(crate) server: ServerThread,
    pub(crate) client: Client<TcpStream>,
}

impl ControlRig {
    pub(crate) fn new(config: Config) -> Self {
        Self::with_seed(config, 0)
    }

    fn with_seed(config: Config, seed: u64) -> Self {
        let lines = Lines { tcp: any_port(), control: any_port(), seed, ..Lines::default() };
        Self::of(serve(config, lines))
    }

    fn of(server: ServerThread) -> Self {
        Self { client: Client::of(&server), server }
    }

    pub(crate) fn homed() -> Self {
        let mut rig = Self::new(Config { time_scale: 20.0, ..Config::default() });
        assert_eq!(rig.client.run(HOMING), Status::Success);
        rig
    }

    fn control(&self) -> TcpStream {
        connect(self.server.control_address().unwrap())
    }

    pub(crate) fn http(&self, request: &str) -> (u16, String, String) {
        http(self.server.control_address().unwrap(), request)
    }

    pub(crate) fn request(&self, method: &str, path: &str, body: &str) -> (u16, Value) {
        request(self.server.control_address().unwrap(), method, path, body)
    }

    /// Returns the status of an answer that may have no end.
    fn request_status(&self, path: &str) -> u16 {
        let mut stream = self.control();
        stream.write_all(format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").as_bytes()).unwrap();
        let mut head = String::new();
        BufReader::new(stream).read_line(&mut head).expect("an answer in time");
        head.split(' ').nth(1).unwrap().parse().unwrap()
    }

    /// Sends a request that must succeed and returns the state.
    pub(crate) fn post(&self, path: &str, body: &Value) -> Value {
        let (status, state) = self.request("POST", path, &body.to_string());
        assert_eq!(status, 200, "{path} {body}: {state}");
        state
    }

    pub(crate) fn state(&self) -> Value {
        let (status, state) = self.request("GET", "/state", "");
        assert_eq!(status, 200);
        state
    }

    /// Waits until this number of frames of a direction has passed the line or was dropped on it.
    fn await_frames(&self, direction: &str, count: u64) {
        await_true(direction, || self.state()["line_counts"][direction]["frames"] == json!(count));
    }

    fn flags(&self) -> Vec<String> {
        serde_json::from_value(self.state()["system_state"].clone()).unwrap()
    }

    fn recv(&mut self) -> Vec<u8> {
        let mut buffer = [0; 2 * MAX_FRAME_LEN];
        let len = uninterrupted::read(&self.client.0, &mut buffer).expect("an answer in time");
        buffer[..len].to_vec()
    }

    /// Clears all line faults and returns all bytes up to the answer to a Loop.
    fn bytes_until_mended(&mut self) -> Vec<u8> {
        self.post("/line", &json!({}));
        self.client.send(Command::Loop { data: LoopData::new(MARK).unwrap() });
        let mut bytes = Vec::new();
        while !bytes.windows(MARK.len()).any(|window| window == MARK) {
            bytes.extend_from_slice(&self.recv());
        }
        bytes
    }
}

#[test]
fn state_shows_how_the_gripper_stands() {
    let mut rig = ControlRig::homed();
    assert_eq!(rig.client.run(go_to(42.0)), Status::Success);
    let state = rig.state();
    assert_eq!(state["model"], "wsg50-110");
    assert_eq!((&state["width_mm"], &state["reported_width_mm"]), (&json!(42.0), &json!(42.0)));
    assert_eq!(state["gripper_state"], "IDLE");
    assert_eq!(state["system_state"], json!(["REFERENCED", "TARGET_POS_REACHED"]));
    assert_eq!(state["force_limit_n"], json!(40.0));
    assert_eq!((&state["part"], &state["faults"]), (&Value::Null, &json!([])));
    let name = format!("tcp {}", rig.client.0.local_addr().unwrap());
    assert_eq!(state["clients"][0]["name"], json!(name));
}

#[test]
fn part_is_put_in_and_gripped_and_lost_when_it_is_taken_away() {
    let mut rig = ControlRig::homed();
    let state = rig.post("/part", &json!({ "width_mm": 20, "stiffness_n_per_mm": 50 }));
    assert_eq!(state["part"], json!({ "width_mm": 20.0, "stiffness_n_per_mm": 50.0 }));
    let hollow = json!({ "width_mm": 80.0, "stiffness_n_per_mm": 100.0, "inner_width_mm": 60.0 });
    assert_eq!(rig.post("/part", &json!({ "width_mm": 80, "inner_width_mm": 60 }))["part"], hollow);
    rig.post("/part", &json!({ "width_mm": 20, "stiffness_n_per_mm": 50 }));
    assert_eq!(rig.client.run(grip(20.0)), Status::Success);
    let state = rig.state();
    // 40 N squeeze the part by 0.8 mm.
    assert_eq!((&state["gripper_state"], &state["width_mm"]), (&json!("HOLDING"), &json!(19.2)));
    let state = rig.post("/part", &Value::Null);
    assert_eq!((&state["part"], &state["gripper_state"]), (&Value::Null, &json!("PART LOST")));
    assert_eq!(state["gripping_statistics"], json!({ "total": 1, "no_part": 0, "part_lost": 1 }));
}

#[test]
fn each_fault_begins_and_ends() {
    let fingers = [Finger::Fmf, Finger::Dsa];
    let rig = ControlRig::new(Config { fingers, ..Config::default() });
    for (fault, flags) in [
        (json!({ "fault": "over_temperature" }), &["TEMP_WARNING", "TEMP_FAULT"][..]),
        (json!({ "fault": "supply_out_of_range" }), &["POWER_FAULT"]),
        (json!({ "fault": "motor_current" }), &["CURR_FAULT"]),
        (json!({ "fault": "finger_short_circuit", "finger": 1 }), &["FINGER_FAULT"]),
        (json!({ "fault": "finger_communication", "finger": 2 }), &["FINGER_FAULT"]),
    ] {
        let switched = |on: bool| {
            let mut body = fault.clone();
            body["on"] = json!(on);
            rig.post("/fault", &body)
        };
        assert_eq!(switched(true)["faults"], json!([fault]));
        let shown = rig.flags();
        assert!(flags.iter().all(|flag| shown.iter().any(|shown| shown == flag)), "{fault}: {shown:?}");
        assert_eq!(switched(false)["faults"], json!([]));
        let shown = rig.flags();
        assert!(!flags.iter().any(|flag| shown.iter().any(|shown| shown == flag)), "{fault}: {shown:?}");
    }
}

#[test]
fn jammed_axis_blocks_a_motion_until_it_is_free_again() {
    let mut rig = ControlRig::homed();
    rig.post("/fault", &json!({ "fault": "axis_blocked", "on": true }));
    assert_eq!(rig.client.run(go_to(42.0)), Status::AxisBlocked);
    rig.post("/fault", &json!({ "fault": "axis_blocked", "on": false }));
    assert_eq!(rig.client.ask(Command::Stop), Status::Success);
    assert_eq!(rig.client.run(go_to(42.0)), Status::Success);
}

#[test]
fn wrong_requests_are_refused_in_a_sentence_and_change_nothing() {
    let rig = ControlRig::new(Config { fingers: [Finger::Generic, Finger::None], ..Config::default() });
    let long = format!("{{\"drop\":0.{}}}", "0".repeat(5_000));
    for (method, path, body, status, wrong, expected) in [
        ("POST", "/part", "", 400, "EOF", "width_mm"),
        ("POST", "/part", "{}", 400, "missing field `width_mm`", "20.0"),
        ("POST", "/part", r#"{"width_mm":"wide"}"#, 400, "\"wide\"", "20.0"),
        ("POST", "/part", r#"{"width_mm":-3}"#, 400, "-3 mm", "above 0"),
        ("POST", "/part", r#"{"width_mm":1e39}"#, 400, "inf mm", "above 0"),
        ("POST", "/part", r#"{"width_mm":3,"stiffness_n_per_mm":0}"#, 400, "0 N/mm", "above 0"),
        ("POST", "/part", r#"{"width_mm":3,"inner_width_mm":3}"#, 400, "a hole of 3 mm", "inner_width_mm"),
        ("POST", "/part", r#"{"width_mm":3,"length_mm":3}"#, 400, "length_mm", "stiffness_n_per_mm"),
        ("POST", "/part", "null null", 400, "trailing", "or null"),
        ("POST", "/fault", r#"{"fault":"hiccup","on":true}"#, 400, "hiccup", "motor_current"),
        ("POST", "/fault", r#"{"fault":"motor_current"}"#, 400, "missing field `on`", "\"on\":true"),
        (
            "POST",
            "/fault",
            r#"{"fault":"motor_current","finger":1,"on":true}"#,
            400,
            "does not concern a finger",
            "without",
        ),
        (
            "POST",
            "/fault",
            r#"{"fault":"finger_short_circuit","on":true}"#,
            400,
            "requires a finger",
            "\"finger\":2",
        ),
        ("POST", "/fault", r#"{"fault":"finger_short_circuit","finger":3,"on":true}"#, 400, "3", "1 or 2"),
        (
            "POST",
            "/fault",
            r#"{"fault":"finger_short_circuit","finger":2,"on":true}"#,
            409,
            "none",
            "generic",
        ),
        ("POST", "/fault", r#"{"fault":"finger_communication","finger":1,"on":true}"#, 409, "generic", "fmf"),
        ("POST", "/line", r#"{"drop":1.5}"#, 400, "drop is 1.5", "from 0 to 1"),
        ("POST", "/line", r#"{"corrupt":-0.1}"#, 400, "corrupt is -0.1", "from 0 to 1"),
        ("POST", "/line", r#"{"delay":0.5}"#, 400, "delay lacks delay_ms", "delay_ms"),
        ("POST", "/line", r#"{"delay_ms":60001}"#, 400, "60001", "60000"),
        ("POST", "/line", r#"{"drop":1,"direction":"up"}"#, 400, "up", "requests"),
        ("POST", "/line", "null", 400, "null", "drop"),
        ("POST", "/line", &long, 413, "too long", "4096"),
        ("GET", "/part", "", 405, "GET", "POST"),
        ("DELETE", "/state", "", 405, "DELETE", "GET"),
        ("GET", "/nowhere", "", 404, "\"/nowhere\"", "GET /state"),
        ("POST", "/command", r#"{"command":"dance"}"#, 400, "dance", "fast_stop"),
        ("POST", "/command", r#"{"command":"move"}"#, 400, "missing or invalid", "width_mm"),
        ("POST", "/command", r#"{"command":"stop","width_mm":5}"#, 400, "missing or invalid", "width_mm"),
        ("POST", "/command", r#"{"command":"move","width_mm":1e39}"#, 400, "missing or invalid", "width_mm"),
        ("POST", "/command", r#"{"command":"move","width_mm":5}"#, 409, "E_NOT_INITIALIZED", "refuses"),
    ] {
        let (got, answer) = rig.request(method, path, body);
        let error = answer["error"].as_str().unwrap_or_else(|| panic!("{method} {path} {body}: {answer}"));
        assert_eq!(got, status, "{method} {path} {body}: {error}");
        assert!(error.contains(wrong) && error.contains(expected) && !error.contains('\n'), "{error}");
    }
    let state = rig.state();
    assert_eq!((&state["part"], &state["faults"]), (&Value::Null, &json!([])));
    assert_eq!((&state["line"]["drop"], &state["line"]["corrupt"]), (&json!(0.0), &json!(0.0)));
}

#[test]
fn refused_method_says_which_one_is_allowed() {
    let (status, head, _) =
        ControlRig::new(Config::default()).http("GET /part HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert_eq!(status, 405);
    assert!(head.to_lowercase().contains("\r\nallow: post"), "{head}");
}

#[test]
fn other_web_pages_are_refused_and_the_own_one_is_not() {
    let rig = ControlRig::new(Config::default());
    let host = rig.server.control_address().unwrap().to_string();
    let status = |method: &str, path: &str, origin: &str| {
        let body = r#"{"fault":"motor_current","on":false}"#;
        let (status, _, body) = rig.http(&format!(
            "{method} {path} HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        ));
        // The error names the header, its value and the expected one.
        let expected = format!("expected \\\"http://{host}\\\"");
        let names_it =
            body.contains("the header Origin is") && body.contains(origin) && body.contains(&expected);
        assert!(status == 200 || names_it, "{status} {body}");
        status
    };
    for origin in [
        "http://example.com",
        "null",
        "http://localhost",
        "http://localhost:1",
        &format!("https://{host}"),
        &format!("http://{host}.example.com"),
    ] {
        for (method, path) in [("POST", "/fault"), ("POST", "/command"), ("GET", "/events"), ("GET", "/")] {
            assert_eq!(status(method, path, origin), 403, "{origin} {path}");
        }
    }
    // The own page names the state that it saw.
    let fault = format!("/fault?as_of={}", rig.state()["as_of"].as_str().unwrap());
    assert_eq!(status("POST", &fault, &format!("http://{host}")), 200);
    assert!(rig.flags().is_empty());
}

/// The events of a page in order.
struct Watching(BufReader<TcpStream>);

impl Watching {
    /// Opens a page and waits for the start of its answer.
    fn new(rig: &ControlRig) -> Self {
        let mut stream = rig.control();
        stream.write_all(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        let mut watching = Self(BufReader::new(stream));
        assert_eq!(watching.line(), "HTTP/1.1 200 OK");
        watching
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.0.read_line(&mut line).expect("a line in time");
        assert!(!line.is_empty(), "the stream ended");
        line.trim_end().to_owned()
    }

    fn next(&mut self) -> (String, Value) {
        loop {
            if let Some(kind) = self.line().strip_prefix("event: ") {
                let data = self.line();
                let json = data.strip_prefix("data: ").expect("data after the kind");
                return (kind.to_owned(), serde_json::from_str(json).expect("JSON"));
            }
        }
    }

    /// Skips events until `is_it` returns `true`.
    fn until(&mut self, is_it: impl Fn(&str, &Value) -> bool) -> Value {
        await_some("an event", || {
            let (kind, data) = self.next();
            is_it(&kind, &data).then_some(data)
        })
    }
}

#[test]
fn page_has_a_policy_and_its_script_has_the_nonce_of_the_policy() {
    let (status, head, body) =
        ControlRig::new(Config::default()).http("GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert_eq!(status, 200);
    let policy = head.lines().find_map(|line| line.strip_prefix("content-security-policy: ")).unwrap();
    assert!(
        policy.starts_with("default-src 'none'; ") && policy.contains("frame-ancestors 'none'"),
        "{policy}"
    );
    let nonce = policy.split_once("script-src 'nonce-").unwrap().1.split_once('\'').unwrap().0;
    assert!(body.contains(&format!("<script nonce=\"{nonce}\">")), "{body}");
    assert!(
        head.contains("cache-control: no-store") && head.contains("x-content-type-options: nosniff"),
        "{head}"
    );
}

#[test]
fn all_pages_show_commands_and_the_part_of_one_page() {
    let rig = ControlRig::new(Config { time_scale: 5.0, ..Config::default() });
    let mut pages = [(); 2].map(|()| Watching::new(&rig));
    for page in &mut pages {
        let (kind, hello) = page.next();
        assert_eq!((kind.as_str(), &hello["limits"]["stroke_mm"]), ("hello", &json!(110.0)));
        assert_eq!(hello["names"]["system"][12], "FAST_STOP");
    }
    rig.post("/command", &json!({"command":"home"}));
    for page in &mut pages {
        // On the way, and at the target.
        page.until(|_, data| data["state"]["speed_mm_per_s"].as_f64().is_some_and(|speed| speed > 0.0));
        let done = page.until(|_, data| data["state"]["system_state"][0] == "REFERENCED");
        assert_eq!(done["state"]["width_mm"], 110.0);
    }
    rig.post("/part", &json!({"width_mm":20}));
    rig.post("/command", &json!({"command":"grip","width_mm":20,"speed_mm_per_s":200,"force_n":30}));
    for page in &mut pages {
        let held = page.until(|_, data| data["state"]["gripper_state"] == "HOLDING");
        assert_eq!(
            (&held["state"]["force_n"], &held["state"]["fieldbus"]["input"][0]),
            (&json!(30.0), &json!(1 << 4))
        );
        assert_eq!(held["state"]["part_is_between"], true);
    }
    rig.post("/part", &Value::Null);
    rig.post("/command", &json!({"command":"fast_stop"}));
    for page in &mut pages {
        page.until(|_, data| data["state"]["gripping_statistics"]["part_lost"] == 1);
        page.until(|_, data| data["state"]["system_state"].to_string().contains("FAST_STOP"));
    }
    let (status, refused) = rig.request("POST", "/command", r#"{"command":"release","width_mm":50}"#);
    assert!(status == 409 && refused["error"].as_str().unwrap().contains("E_ACCESS_DENIED"), "{refused}");
    rig.post("/command", &json!({"command":"acknowledge"}));
    assert_eq!(rig.state()["gripper_state"], "IDLE");
}

#[test]
fn page_shows_decoded_frames_of_clients_without_a_log_file() {
    let mut rig = ControlRig::new(Config::default());
    let mut page = Watching::new(&rig);
    page.until(|kind, _| kind == "state");
    assert_eq!(rig.client.ask(Command::GetForceLimit), Status::Success);
    let shown = |text: &str| {
        let text = text.to_owned();
        move |kind: &str, data: &Value| kind == "log" && data["lines"].to_string().contains(&text)
    };
    let lines = page.until(shown("33h Get Force Limit E_SUCCESS 40.0 N"));
    assert_eq!(lines["lost"], 0);
}

#[test]
fn maximum_number_of_pages_does_not_block_requests() {
    let rig = ControlRig::new(Config::default());
    let mut pages: Vec<Watching> = (0..64).map(|_| Watching::new(&rig)).collect();
    let (status, answer) = rig.request("GET", "/events", "");
    assert!(status == 503 && answer["error"].as_str().unwrap().contains("64 pages"), "{answer}");
    // More requests than are served at a time. No page has to close for any of them.
    for _ in 0..100 {
        rig.state();
    }
    for page in &mut pages {
        page.until(|kind, _| kind == "state");
    }
    // Longer than the time limit of a request.
    let start = Instant::now();
    let page = &mut pages[0];
    while start.elapsed() < Duration::from_secs(6) {
        page.until(|kind, _| kind == "state");
    }
    drop(pages);
    // The place of a closed page is available again once the system reports its end.
    await_true("a place for a page", || rig.request_status("/events") == 200);
}

#[test]
fn requests_for_another_host_are_refused() {
    let control_hosts = vec!["bench".to_owned()];
    let lines = Lines { tcp: any_port(), control: any_port(), control_hosts, ..Lines::default() };
    let rig = ControlRig::of(serve(Config::default(), lines));
    let address = rig.server.control_address().unwrap().to_string();
    let state = |host: &str| rig.http(&format!("GET /state HTTP/1.1\r\n{host}\r\n"));
    for host in ["localhost", &address, "BENCH:80"] {
        assert_eq!(state(&format!("Host: {host}\r\n")).0, 200, "{host}");
    }
    // A page of that name, which now resolves to this server: to the browser this is the page's own server.
    let (status, _, body) = state("Host: rebound.example\r\n");
    assert_eq!(status, 421);
    let expected = r#"{"error":"the header Host is \"rebound.example\"; expected localhost, 127.0.0.1 or a name of --control-host"}"#;
    assert_eq!(body.trim_end(), expected);
    let post = "POST /fault HTTP/1.1\r\nHost: rebound.example:8080\r\nContent-Length: 35\r\n\r\n\
                {\"fault\":\"motor_current\",\"on\":true}";
    assert_eq!(rig.http(post).0, 421);
    assert!(rig.flags().is_empty());
    let (status, _, body) = state("");
    assert!(status == 400 && body.contains("expected exactly one Host header"), "{status} {body}");
}

#[test]
fn endless_heads_are_refused() {
    let rig = ControlRig::new(Config::default());
    let mut stream = rig.control();
    stream.write_all(b"GET /state HTTP/1.1\r\n").unwrap();
    let line = format!("X: {}\r\n", "x".repeat(1_000));
    // The server answers and closes; data in transit may then reset the connection.
    await_true("the head is not limited", || stream.write_all(line.as_bytes()).is_err());
    assert_eq!(rig.state()["model"], "wsg50-110");
}

#[test]
fn half_open_connections_do_not_delay_a_whole_request() {
    let rig = ControlRig::new(Config::default());
    let begin = Instant::now();
    loop {
        let half = b"POST /part HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4000\r\n\r\n{";
        let start = Instant::now();
        let _half_open: Vec<TcpStream> = (0..160)
            .map(|n| {
                let mut stream = rig.control();
                // The oldest connections are closed by now.
                let _ = stream.write_all(&half[..n % half.len()]);
                stream
            })
            .collect();
        assert_eq!(rig.state()["model"], "wsg50-110");
        // They are closed after 5 s each. A round that took longer on a busy machine proves nothing.
        if start.elapsed() < Duration::from_secs(4) {
            break;
        }
        assert!(begin.elapsed() < BOUND, "complete requests are delayed by partial ones");
    }
}

#[test]
fn connection_with_a_partial_request_is_closed() {
    let rig = ControlRig::new(Config::default());
    let mut silent = rig.control();
    silent.write_all(b"POST /part HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4000\r\n\r\n{").unwrap();
    let mut rest = [0; 1_000];
    match uninterrupted::read(&silent, &mut rest) {
        Ok(0) => {}
        Err(error) if error.kind() == ErrorKind::ConnectionReset => {}
        other => panic!("expected the end of the connection: {other:?}"),
    }
}

#[test]
fn damaged_answers_are_lost_and_the_next_one_is_found() {
    let whole = frame_of_force_limit().len();
    // The bytes of an answer that arrive.
    for (fault, arriving) in [("drop", 0..=0), ("corrupt", whole..=whole), ("truncate", 1..=whole - 1)] {
        let mut rig = ControlRig::new(Config::default());
        rig.post("/line", &json!({ "direction": "replies", fault: 1 }));
        for _ in 0..20 {
            rig.client.send(Command::GetForceLimit);
        }
        rig.await_frames("replies", 20);
        let mut arrived = rig.bytes_until_mended();
        let ids: Vec<u8> = parse(&arrived).into_iter().map(|(id, _)| id).collect();
        assert_eq!(ids, [0x06], "{fault}");
        arrived.truncate(arrived.len() - 10 - MARK.len());
        assert!(
            (20 * arriving.start()..=20 * arriving.end()).contains(&arrived.len()),
            "{fault}: {arrived:02X?}"
        );
    }
}

#[test]
fn slow_line_loses_no_answer_at_any_number_of_requests() {
    let mut rig = ControlRig::new(Config::default());
    rig.post("/line", &json!({ "delay_ms": 20 }));
    rig.client.0.write_all(&frame(Command::GetForceLimit).repeat(2_000)).unwrap();
    let mut arrived = vec![0; 2_000 * 14];
    rig.client.0.read_exact(&mut arrived).expect("all answers in time");
    assert_eq!(arrived, frame_of_force_limit().repeat(2_000));
    assert_eq!(rig.state()["clients"][0]["replies_lost"], json!(0));
}

#[test]
fn same_seed_hits_the_same_frames() {
    for direction in ["requests", "replies"] {
        let bytes = |seed| {
            let mut rig = ControlRig::with_seed(Config::default(), seed);
            let mut faults = json!({ "direction": direction, "drop": 0.2, "duplicate": 0.2 });
            if direction == "replies" {
                (faults["corrupt"], faults["truncate"]) = (json!(0.2), json!(0.2));
            }
            rig.post("/line", &faults);
            for n in 0..100u8 {
                rig.client.send(Command::Loop { data: LoopData::new(&[n]).unwrap() });
            }
            rig.await_frames(direction, 100);
            rig.bytes_until_mended()
        };
        let first = bytes(7);
        assert_eq!(first, bytes(7), "{direction}");
        assert_ne!(first, bytes(8), "{direction}");
    }
}

#[test]
fn datagrams_are_hit_as_well() {
    let remote = udp_socket();
    let remote_port = remote.local_addr().unwrap().port();
    let udp = any_port().map(|address| UdpLine { address, remote_port });
    let lines = Lines { tcp: any_port(), udp, control: any_port(), ..Lines::default() };
    let rig = ControlRig::of(serve(Config::default(), lines));
    rig.post("/line", &json!({ "direction": "replies", "duplicate": 1, "delay_ms": 30 }));
    let sent_at = Instant::now();
    let to = rig.server.udp_address().unwrap();
    uninterrupted::send_to(&remote, &frame(Command::GetForceLimit), to).unwrap();
    for _ in 0..2 {
        assert_eq!(recv_datagram(&remote).0, frame_of_force_limit());
    }
    assert!(sent_at.elapsed() >= Duration::from_millis(30));
}

#[test]
fn damaged_requests_are_not_executed() {
    for (fault, counted) in [("drop", "dropped"), ("truncate", "truncated"), ("corrupt", "corrupted")] {
        let mut rig = ControlRig::new(Config::default());
        rig.post("/line", &json!({ "direction": "requests", fault: 1 }));
        for _ in 0..20 {
            rig.client.send(Command::GetForceLimit);
        }
        await_true(fault, || rig.state()["line_counts"]["requests"][counted] == json!(20));
        let arrived = rig.bytes_until_mended();
        let ids: Vec<u8> = parse(&arrived).into_iter().map(|(id, _)| id).collect();
        assert_eq!(ids, [0x06], "{fault}");
        let state = rig.state();
        assert_eq!(state["line_counts"]["replies"]["frames"], json!(1), "{fault}");
        let dropped = state["clients"][0]["bytes_dropped"].as_u64().unwrap();
        assert_eq!(dropped > 0, fault != "drop", "{fault}: {state}");
    }
}

#[test]
fn duplicate_request_is_answered_twice_and_moves_once() {
    let mut rig = ControlRig::new(Config::default());
    rig.post("/line", &json!({ "direction": "requests", "duplicate": 1 }));
    rig.client.send(HOMING);
    let statuses = [rig.client.status(), rig.client.status(), rig.client.status()];
    assert_eq!(statuses, [Status::CmdPending, Status::AlreadyRunning, Status::Success]);
}

#[test]
fn delayed_requests_keep_their_order() {
    let mut rig = ControlRig::new(Config::default());
    rig.post("/line", &json!({ "direction": "requests", "delay_ms": 300 }));
    let start = Instant::now();
    rig.client.send(Command::GetForceLimit);
    rig.post("/line", &json!({}));
    rig.client.send(Command::GetAcceleration);
    let mut arrived = vec![0; 28];
    rig.client.0.read_exact(&mut arrived).expect("two answers in time");
    assert!(start.elapsed() >= Duration::from_millis(300), "{:?}", start.elapsed());
    assert_eq!(parse(&arrived).into_iter().map(|(id, _)| id).collect::<Vec<u8>>(), [0x33, 0x31]);
    // A partial request completes once the line has no faults.
    rig.post("/line", &json!({ "direction": "requests", "delay_ms": 300 }));
    let stop = frame(Command::Stop);
    rig.client.0.write_all(&stop[..4]).unwrap();
    rig.post("/line", &json!({}));
    rig.client.0.write_all(&stop[4..]).unwrap();
    assert_eq!(rig.client.status(), Status::Success);
}

#[test]
fn line_faults_affect_the_chosen_direction_or_both() {
    for (body, requests, replies) in [
        (json!({ "direction": "replies", "duplicate": 1 }), 0, 1),
        (json!({ "direction": "requests", "duplicate": 1 }), 1, 0),
        (json!({ "direction": "both", "duplicate": 1 }), 1, 2),
        (json!({ "duplicate": 1 }), 1, 2),
    ] {
        let mut rig = ControlRig::new(Config::default());
        rig.post("/line", &body);
        rig.client.send(Command::GetForceLimit);
        let mut arrived = vec![0; frame_of_force_limit().len() * (1 << (requests + replies.min(1)))];
        rig.client.0.read_exact(&mut arrived).expect("all answers in time");
        let counts = rig.state()["line_counts"].clone();
        assert_eq!(counts["requests"]["duplicated"], json!(requests), "{body}");
        assert_eq!(counts["replies"]["duplicated"], json!(replies), "{body}");
    }
}

#[test]
fn datagrams_text_and_modbus_to_the_gripper_are_hit_as_well() {
    let remote = udp_socket();
    let any = any_port();
    let lines = Lines { tcp: any, gcl: any, gcl_udp: any, modbus: any, control: any, ..Lines::default() };
    let rig = ControlRig::of(serve(Config::default(), lines));
    let mut gcl = connect(rig.server.gcl_address().unwrap());
    let mut modbus = connect(rig.server.modbus_address().unwrap());
    rig.post("/line", &json!({ "direction": "requests", "duplicate": 1 }));
    uninterrupted::send_to(&remote, b"VERBOSE?", rig.server.gcl_udp_address().unwrap()).unwrap();
    for _ in 0..2 {
        assert!(recv_datagram(&remote).0.ends_with(b"\n"));
    }
    gcl.write_all(b"DEVTYPE?\r\n").unwrap();
    let mut text = [0; 42];
    gcl.read_exact(&mut text).expect("two answers in time");
    assert_eq!(&text, &b"DEVTYPE=\"WSG 50-110\"\n".repeat(2)[..]);
    modbus.write_all(&[0, 1, 0, 0, 0, 6, 1, 3, 0, 0, 0, 1]).unwrap();
    let mut registers = [0; 22];
    modbus.read_exact(&mut registers).expect("two answers in time");
    assert_eq!(registers, *[0, 1, 0, 0, 0, 5, 1, 3, 2, 0, 0].repeat(2));
}

#[test]
fn log_shows_operator_actions_and_line_faults() {
    let lines = Lines { tcp: any_port(), control: any_port(), ..Lines::default() };
    let logged = Logged::new("control", Config::default(), &lines);
    let mut client = Client::of(&logged.served);
    let post = |path, body: Value| {
        let control = logged.served.control_address().unwrap();
        assert_eq!(request(control, "POST", path, &body.to_string()).0, 200);
    };
    post("/fault", json!({ "fault": "motor_current", "on": true }));
    post("/line", json!({ "direction": "replies", "duplicate": 1 }));
    client.send(Command::GetForceLimit);
    client.0.read_exact(&mut [0; 28]).expect("two answers in time");
    let log = logged.stop();
    let lines: Vec<&str> = log.lines().collect();
    assert_eq!(lines.len(), 5, "{log}");
    assert!(lines[0].ends_with(" s control fault MotorCurrent begins"), "{log}");
    let line = "line faults: drop 0, delay 0 by 0 ms, corrupt 0, truncate 0, duplicate 1, of replies";
    assert!(lines[1].ends_with(line), "{log}");
    assert!(lines[4].ends_with(" <- line fault: sent twice"), "{log}");
}

fn frame_of_force_limit() -> Vec<u8> {
    FrameEncoder::new(0x33, &[0, 0, 0, 0, 0x20, 0x42][..]).collect()
}
