//! The status page.

use std::io::Write;
use std::net::TcpStream;

use browser::Tab;

use super::*;

const ON_PAGE: [&str; 2] = ["--page", "127.0.0.1:0"];

/// What the page shows while it has current values, and while it has none.
const IS_CURRENT: &str = "document.querySelector('#state').textContent === 'connected to the gateway'
    && getComputedStyle(document.querySelector('main')).opacity === '1'
    && document.querySelector('h2').textContent.startsWith('127.0.0.1:')";
const IS_LOST: &str = "document.querySelector('#state').textContent === 'no connection to the gateway'
    && /^values from \\d+ s ago$/.test(document.querySelector('#age').textContent)
    && getComputedStyle(document.querySelector('main')).opacity < 0.5
    && document.querySelector('h2').textContent.startsWith('not current: 127.0.0.1:')";

/// Records the highest age of values that the page shows as current, and the longest time for which Chromium does not run.
const WATCH: &str = "
    window.oldest = 0; window.stall = 0;
    let last = performance.now();
    setInterval(() => {
        const now = performance.now();
        window.stall = Math.max(window.stall, now - last);
        last = now;
        if (!document.body.classList.contains('stale')) window.oldest = Math.max(window.oldest, msSince(asked));
    }, 10); 0";

impl Rig {
    fn page(&self) -> SocketAddr {
        self.gateway.page.expect("the gateway has a page")
    }
}

/// Returns head and body of the answer to a request.
fn http(page: SocketAddr, request: &str) -> (String, String) {
    let mut stream = TcpStream::connect(page).unwrap();
    stream.set_read_timeout(Some(BOUND)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").expect("an answer with a head");
    (head.to_owned(), body.to_owned())
}

/// Returns values. There are none while the gateway notices a pause of the machine.
fn get(page: SocketAddr, path: &str) -> String {
    let mut values = String::new();
    until(path, || {
        let (head, body) = http(page, &format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n"));
        values = body;
        head.starts_with("HTTP/1.1 200 ")
    });
    values
}

#[test]
fn page_has_the_values_of_status_and_accepts_no_command() {
    unpaused_on(Rig::of_two, |rig| {
        let page = rig.page();
        let _master = rig.homed();
        let gateways = [1, 2].map(|unit| format!("{}?unit={unit}", rig.gateway.modbus));
        let status = |options: &[&str]| {
            let words = [&["gateway", "status", &gateways[0], &gateways[1]], options].concat();
            String::from_utf8(wsg(&words, b"").stdout).unwrap()
        };
        // Only the program is a master, and counted.
        let without_masters = |mut objects: Vec<Value>| {
            for object in &mut objects {
                let reports = object["reports"].as_object_mut().expect("the gateway answers");
                reports.retain(|name, _| !name.starts_with("MASTER"));
            }
            objects
        };
        // Ages and counters differ for a moment.
        until("both have the same JSON", || {
            let printed =
                status(&["--json"]).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
            let shown = serde_json::from_str(&get(page, "/status.json")).unwrap();
            without_masters(printed) == without_masters(shown)
        });
        until("both have the same text", || {
            let lines = |text: &str| {
                let lines = text.lines().filter(|line| !line.starts_with("masters "));
                lines.map(str::to_owned).collect::<Vec<_>>()
            };
            lines(&status(&[])) == lines(&get(page, "/status.txt").replace("right, ", ""))
        });
        until("the page counts one master", || {
            get(page, "/status.txt").matches("masters    connected 1, ").count() == 2
        });
        for (request, status, expected) in [
            ("POST /status.json HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0", 405, "allow: GET"),
            ("HEAD / HTTP/1.1\r\nHost: localhost", 405, "allow: GET"),
            ("GET / HTTP/1.1\r\nHost: rebound.example", 421, "expected localhost, 127.0.0.1\""),
            ("GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example", 403, "Origin"),
            ("GET /state HTTP/1.1\r\nHost: localhost", 404, "GET /status.json, GET /status.txt, GET /\""),
            ("GET / HTTP/1.1\r\nHost: localhost", 200, "content-security-policy: default-src 'none';"),
        ] {
            let (head, body) = http(page, &format!("{request}\r\n\r\n"));
            assert!(head.starts_with(&format!("HTTP/1.1 {status} ")), "{request}: {head}");
            assert!(head.contains(expected) || body.contains(expected), "{request}: {head}\n{body}");
        }
    });
}

#[test]
fn page_does_not_hide_the_silence_of_the_plc() {
    unpaused_on(
        || Rig::with(&ON_PAGE),
        |rig| {
            let _master = rig.moving_with(2_000);
            until("the page shows the end of the PLC", || {
                let text = get(rig.page(), "/status.txt");
                text.contains("\nPLC        none writes\n") && text.contains(", time-outs 1\n")
            });
            until("the fingers rest", || !rig.has(SystemFlags::MOVING));
            assert!(rig.gripper().state().width > 12.0, "{:?}", rig.gripper().state());
        },
    );
}

#[test]
fn stalled_readers_of_the_page_delay_no_master_and_are_disconnected() {
    unpaused_on(
        || Rig::with(&ON_PAGE),
        |rig| {
            let mut master = rig.connect();
            let request = "GET /status.json HTTP/1.1\r\nHost: localhost\r\n\r\n";
            let stalled = (0..100).map(|number| {
                let mut reader = TcpStream::connect(rig.page()).unwrap();
                reader.write_all(&request.as_bytes()[..[0, 30, request.len()][number % 3]]).unwrap();
                reader
            });
            let stalled: Vec<_> = stalled.collect();
            let times = (0..200).map(|_| {
                let start = Instant::now();
                master.report(BUS_TIMEOUTS);
                start.elapsed()
            });
            let mut times: Vec<_> = times.collect();
            times.sort();
            assert!(times[100] < Duration::from_millis(20), "{times:?}");
            get(rig.page(), "/status.json");
            for mut reader in stalled {
                reader.set_read_timeout(Some(BOUND)).unwrap();
                let end = reader.read_to_end(&mut Vec::new()).map_err(|error| error.kind());
                assert!(matches!(end, Ok(_) | Err(io::ErrorKind::ConnectionReset)), "{end:?}");
            }
        },
    );
}

#[test]
fn page_shows_why_a_gateway_is_not_healthy() {
    let gateway = Gateway::to("tcp://127.0.0.1:1", &ON_PAGE);
    let page = gateway.page.unwrap();
    let shown: Value = serde_json::from_str(&get(page, "/status.json")).unwrap();
    let reason = "no gripper: never answered";
    assert_eq!(
        (&shown[0]["health"], &shown[0]["reason"]),
        (&"not healthy".into(), &reason.into()),
        "{shown}"
    );
    let text = get(page, "/status.txt");
    let heading = format!("gateway    {} is not healthy: {reason}\n", gateway.modbus);
    assert!(text.starts_with(&heading) && !text.contains("fingers"), "{text}");
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn old_values_are_not_shown_as_current_in_chromium() {
    let rig = Rig::with(&ON_PAGE);
    let _master = rig.homed();
    let mut tab = Tab::open(&format!("http://{}/", rig.page()));
    tab.look(390, 844, "light");
    tab.until(IS_CURRENT);
    tab.until("[...document.querySelectorAll('th')].some(it => it.textContent === 'fingers' && / mm, /.test(it.nextSibling.textContent))");
    assert_eq!(tab.eval("document.documentElement.scrollWidth <= 390"), true, "it fits a telephone");
    assert_eq!(tab.events_of("Log.entryAdded"), [Value::Null; 0], "the policy allows all of the page");
    tab.eval(WATCH);
    rig.signal(Signal::STOP);
    tab.until(IS_LOST);
    rig.signal(Signal::CONT);
    tab.until(IS_CURRENT);
    rig.signal(Signal::KILL);
    tab.until(IS_LOST);
    let [oldest, stall] = ["oldest", "stall"].map(|name| tab.eval(name).as_f64().unwrap());
    assert!(
        oldest > 500.0 && oldest - stall < 3_000.0,
        "shown after {oldest} ms, with a stall of {stall} ms"
    );
}
