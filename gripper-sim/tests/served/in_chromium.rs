//! The page in Chromium, which `cargo xtask test` installs. The tests click, type and inspect like a user.
//!
//! Most of them run with `wsg-sim`, and again with the page without a server, which `cargo xtask web` builds.

mod functions;
mod look;
mod static_page;
mod windows;

use crate::common::program::Program;
use crate::rig::connect;
use browser::Tab;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::cell::Cell;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::thread;

/// Distance of the fingers on the screen, in mm of the drawing.
const OPENING: &str = "(() => {
    const [left, right] = [...document.querySelectorAll('#drawing .finger')].map(finger => finger.getBoundingClientRect());
    return (right.left - left.right) / document.getElementById('drawing').getScreenCTM().a;
})()";

/// The pages of the page, by their links.
const PAGES: [&str; 7] = ["operate", "settings", "fieldbus", "editor", "scripts", "logs", "diagnosis"];

const STATE: &str = "document.getElementById('state').textContent";

static TURNS: RwLock<()> = RwLock::new(());

/// The turn of a test, which it holds as long as its gripper.
enum Turn {
    Shared(#[expect(dead_code, reason = "held")] RwLockReadGuard<'static, ()>),
    Alone(#[expect(dead_code, reason = "held")] RwLockWriteGuard<'static, ()>),
}

thread_local! {
    /// Whether the tests of this thread open the page without a server.
    static IN_BROWSER: Cell<bool> = const { Cell::new(false) };
}

/// A gripper with its page: a program, or in the browser.
struct Gripper {
    _turn: Turn,
    program: Option<Program>,
    tcp: String,
    modbus: String,
    /// The origin of the page.
    page: String,
    /// The options of a gripper in the browser, each with a value.
    options: Vec<String>,
}

impl Gripper {
    fn new(options: &[&str]) -> Self {
        Self::on("127.0.0.1:0", options)
    }

    fn on(control: &str, options: &[&str]) -> Self {
        let turn = TURNS.read().unwrap_or_else(PoisonError::into_inner);
        Self::start(Turn::Shared(turn), control, options)
    }

    /// Starts a gripper for a test that uses all of the machine, and therefore runs alone.
    fn alone(options: &[&str]) -> Self {
        let turn = TURNS.write().unwrap_or_else(PoisonError::into_inner);
        Self::start(Turn::Alone(turn), "127.0.0.1:0", options)
    }

    fn start(_turn: Turn, control: &str, options: &[&str]) -> Self {
        let [tcp, modbus] = [String::new(), String::new()];
        if IN_BROWSER.get() {
            let options = [&["--part", "20"], options].concat().into_iter().map(str::to_owned).collect();
            return Self { _turn, program: None, tcp, modbus, page: static_page::address(), options };
        }
        let lines = ["--tcp", "127.0.0.1:0", "--modbus", "127.0.0.1:0", "--control", control, "--part", "20"];
        let mut program = Program::start(&[&lines, options].concat());
        let [_, tcp, modbus, _, page] =
            ["model", "tcp", "modbus", "control", "page"].map(|name| program.place_of(name));
        let page = page.trim_end_matches('/').to_owned();
        Self { _turn, program: Some(program), tcp, modbus, page, options: vec![] }
    }

    fn open(&self) -> Tab {
        if self.program.is_none() {
            return static_page::open(&self.page, &self.options);
        }
        let mut tab = Tab::open(&self.page);
        tab.until("document.getElementById('values').childElementCount > 0");
        tab
    }

    /// Sends a signal to the program.
    fn signal(&self, signal: Signal) {
        self.program.as_ref().expect("a program").signal(signal);
    }

    /// Sends Acknowledge (24h) from a client, which stays connected.
    fn acknowledge(&self) -> TcpStream {
        let mut client = connect(&self.tcp);
        client.write_all(&[0xAA, 0xAA, 0xAA, 0x24, 0x03, 0x00, 0x61, 0x63, 0x6B, 0xDC, 0xB9]).unwrap();
        client.read_exact(&mut [0; 10]).expect("an answer in time");
        client
    }

    /// Connects a client, which the page shows; in the browser, that is the command editor.
    fn connect_client(&self, tab: &mut Tab) -> Option<TcpStream> {
        let client = self.program.as_ref().map(|_| self.acknowledge());
        if client.is_none() {
            tab.click("#send");
        }
        tab.until("document.getElementById('clients').childElementCount > 0");
        client
    }
}

fn flag_is_on(flag: &str) -> String {
    format!("[...document.querySelectorAll('#flags .on')].some(item => item.textContent === '{flag} 1')")
}

/// Homes by a click, which is refused while a busy machine withholds the states from the page.
fn home(tab: &mut Tab) {
    let end = format!(
        "{} && {STATE} === 'IDLE' ? 'homed' : document.querySelector('#results .bad:last-child') && 'refused'",
        flag_is_on("REFERENCED")
    );
    for _ in 0..20 {
        tab.eval("document.getElementById('results').replaceChildren(); 0");
        if tab.until(&format!("isFresh() && (/POSITIONING/.test({STATE}) ? 'moving' : 'idle')")) == "idle" {
            tab.click("#home");
        }
        // A click without an answer in time may have been executed.
        if tab.until(&end) == "homed" {
            return;
        }
        tab.eval("say('message', ''); 0");
    }
    panic!("the machine is never quiet");
}

fn grip(tab: &mut Tab) {
    tab.fill("#width", "20");
    tab.fill("#force", "30");
    tab.click("#grip");
    tab.until(&format!("{STATE} === 'HOLDING'"));
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn drawing_follows_fingers_that_home_and_grip_by_clicks() {
    let gripper = Gripper::new(&["--homing-speed", "20"]);
    let mut tab = gripper.open();
    let before = tab.eval(OPENING).as_f64().unwrap();
    tab.eval(&format!(
        "window.drawn = []; new MutationObserver(() => drawn.push({OPENING}))
           .observe(document.getElementById('drawing'), {{ attributes: true, subtree: true }}); 0"
    ));

    home(&mut tab);

    let drawn: Vec<f64> = serde_json::from_value(tab.eval("drawn")).unwrap();
    let between = drawn.iter().filter(|opening| (before + 1.0..109.0).contains(*opening)).count();
    assert!(between >= 2, "{before} mm, {drawn:?}");
    let opening = tab.eval(OPENING).as_f64().unwrap();
    assert!((opening - 110.0).abs() < 0.5, "{opening} mm");

    grip(&mut tab);

    // To scale: a part of 20 mm, slightly squeezed, fills the opening.
    let opening = tab.eval(OPENING).as_f64().unwrap();
    assert!((19.0..20.1).contains(&opening), "{opening} mm");
    tab.until(
        "(() => { const [part, finger] = ['.part', '.finger'].map(kind => document.querySelector('#drawing ' + kind));
           return Math.abs(part.getBoundingClientRect().left - finger.getBoundingClientRect().right) < 1
             && getComputedStyle(part).visibility === 'visible'; })()",
    );
    tab.until("document.querySelector('#drawing').textContent.includes('30.0 N')");

    tab.click("#part_out");
    tab.until(&format!("{STATE} === 'PART LOST'"));
    tab.until("getComputedStyle(document.querySelector('#drawing .part')).visibility === 'hidden'");
    tab.click("#part_in");
    tab.until("getComputedStyle(document.querySelector('#drawing .part')).visibility === 'visible'");
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn hollow_part_is_drawn_around_fingers_that_grip_inside() {
    let gripper = Gripper::new(&["--time-scale", "20"]);
    let mut tab = gripper.open();
    home(&mut tab);
    tab.click("#part_out");
    tab.fill("#width", "40");
    tab.click("#move");
    tab.until(&format!("Math.abs({OPENING} - 40) < 0.5 && {STATE} === 'IDLE'"));
    // The outer width of the part, and where it is: beside and in its hole.
    let part = "(() => { const part = document.querySelector('#drawing .part'), middle = part.getBBox().x + part.getBBox().width / 2;
       const is = x => part.isPointInFill(new DOMPoint(middle + x, 25)) && getComputedStyle(part).visibility === 'visible';
       return [Math.round(part.getBBox().width), is(-31), is(-29), is(0), is(29), is(31)]; })()";
    tab.fill("#part", "80");
    tab.fill("#inner", "90");
    tab.click("#part_in");
    tab.until("document.getElementById('message').textContent.includes('a hole of 90 mm')");
    assert_eq!(tab.eval(part)[1], false);

    tab.fill("#inner", "60");
    tab.click("#part_in");

    tab.until(&format!("{part}[1]"));
    assert_eq!(tab.eval(part), json!([80, true, false, false, false, true]));
    // To scale: the outer sides of the fingers fill the hole, slightly widened.
    tab.fill("#width", "60");
    tab.fill("#force", "30");
    tab.click("#grip");
    tab.until(&format!("{STATE} === 'HOLDING'"));
    let fingers = "(() => { const [left, right] = [...document.querySelectorAll('#drawing .finger')].map(finger => finger.getBoundingClientRect());
       return (right.right - left.left) / document.getElementById('drawing').getScreenCTM().a; })()";
    let width = tab.eval(fingers).as_f64().unwrap();
    assert!((60.1..60.5).contains(&width), "{width} mm");
    assert_eq!(tab.eval(part), json!([80, true, false, false, false, true]));
    tab.until(
        "document.getElementById('drawing-title').textContent.includes('a part of 80 mm, inner width 60 mm')",
    );

    tab.click("#part_out");
    tab.until(&format!("{STATE} === 'PART LOST'"));
    tab.fill("#part", "30");
    tab.fill("#inner", "");
    tab.click("#part_in");
    tab.until(&format!("{part}[3]"));
}

/// `host-tests/tests/surfaces` has widths and forces outside the limits.
#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn invalid_number_or_speed_field_sends_nothing() {
    let gripper = Gripper::new(&["--time-scale", "20"]);
    let mut tab = gripper.open();
    home(&mut tab);

    for (field, wrong, right) in [("#width", "", "60"), ("#speed", "421", "100")] {
        tab.fill(field, wrong);
        tab.click("#move");
        tab.fill(field, right);
    }
    tab.click("#move");

    tab.until(&format!("Math.abs({OPENING} - 60) < 0.5 && {STATE} === 'IDLE'"));
    // A click that a busy machine refused was repeated.
    let moves = tab.commands("move");
    let right = json!({"command": "move", "width_mm": 60, "speed_mm_per_s": 100});
    assert!(!moves.is_empty() && moves.iter().all(|sent| *sent == right), "{moves:?}");
}

/// Returns an expression for whether an element has the FAST STOP colour.
fn is_red(selector: &str, property: &str) -> String {
    format!(
        "(([red, green, blue]) => red > 150 && green < 80 && blue < 80)
           (getComputedStyle(document.querySelector('{selector}'))['{property}'].match(/\\d+/g).map(Number))"
    )
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn fast_stop_is_red_on_every_page_until_acknowledged() {
    let gripper = Gripper::new(&["--time-scale", "20"]);
    let [mut light, mut dark] = [gripper.open(), gripper.open()];
    dark.look(1280, 800, "dark");
    let red = [is_red("#state", "backgroundColor"), is_red("#drawing .finger", "fill")].join(" && ");
    for tab in [&mut light, &mut dark] {
        assert_eq!(tab.eval(&red), false);
    }

    light.click("#fast_stop");

    for tab in [&mut light, &mut dark] {
        tab.until(&red);
        assert_eq!(tab.eval(STATE), "FAST STOP, ERROR");
        assert_eq!(tab.eval(&flag_is_on("FAST_STOP")), true);
    }

    dark.click("#acknowledge");

    // The window that has sent the command repeats it after a refusal for its age.
    for tab in [&mut dark, &mut light] {
        tab.until(&format!("!({red}) && {STATE} === 'IDLE'"));
    }
}

/// Presses Tab until the element with this id has the focus.
fn tab_to(tab: &mut Tab, id: &str) {
    for _ in 0..120 {
        tab.press("Tab");
        if tab.eval("document.activeElement.id") == id {
            return;
        }
    }
    panic!("Tab does not reach {id}");
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn keyboard_alone_reaches_and_operates_everything() {
    let gripper = Gripper::new(&["--time-scale", "20"]);
    let mut tab = gripper.open();
    for page in PAGES.into_iter().rev() {
        tab.show(page);
        tab.assert_tab_reaches_all(page);
    }

    tab_to(&mut tab, "home");
    tab.press("Enter");
    tab.until(&format!("{} && {STATE} === 'IDLE'", flag_is_on("REFERENCED")));
    tab_to(&mut tab, "width");
    tab.type_text("70");
    tab_to(&mut tab, "move");
    tab.press("Enter");
    tab.until(&format!("Math.abs({OPENING} - 70) < 0.5"));
    tab.press("Escape");
    tab.until(&flag_is_on("FAST_STOP"));
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn every_control_has_a_name_for_a_screen_reader() {
    let gripper = Gripper::new(&[]);
    let mut tab = gripper.open();
    for page in PAGES {
        tab.show(page);
        tab.assert_all_have_names(page);
    }
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn page_asks_its_own_server_alone_and_the_console_stays_empty() {
    let gripper = Gripper::new(&["--time-scale", "20"]);
    let mut tab = gripper.open();
    home(&mut tab);
    grip(&mut tab);
    for selector in [
        "#release",
        "#stop",
        "#part_out",
        "#part_in",
        "#line",
        "#mend",
        "#clear",
        "#pause",
        "#send",
        "#apply",
        "#undo",
    ] {
        tab.click(selector);
    }
    for fault in ["axis_blocked", "supply_out_of_range", "over_temperature", "motor_current"] {
        tab.click(&format!("[name={fault}]"));
        tab.until(&format!("document.querySelector('[name={fault}]').checked"));
    }
    tab.until(&flag_is_on("FAST_STOP"));
    let requests = tab.events_of("Network.requestWillBeSent");
    // The least are a page, its style, its script and a worker.
    assert!(requests.len() >= 4, "{requests:?}");
    for request in &requests {
        let url = request["request"]["url"].as_str().unwrap();
        assert!(url.starts_with(&format!("{}/", gripper.page)), "{url}");
    }
    let socket = format!("{}/events", gripper.page.replacen("http", "ws", 1));
    for opened in tab.events_of("Network.webSocketCreated") {
        assert_eq!(opened["url"], json!(socket));
    }
    let noted = |tab: &mut Tab, method: &str| {
        let mut noted = tab.events_of(method);
        // On a busy machine, the server refuses clicks for their age, which the page shows and the browser notes.
        let is_of_age = |text: &str| text.contains("a status of 412 ");
        noted.retain(|event| !event["entry"]["text"].as_str().is_some_and(is_of_age));
        noted
    };
    for method in
        ["Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded", "Audits.issueAdded"]
    {
        assert_eq!(noted(&mut tab, method), Vec::<Value>::new(), "{method}");
    }
    // Cross-check: a violation must be detected.
    tab.eval("document.body.append(Object.assign(new Image(), { src: 'http://127.0.0.1:9/x.png' })); 0");
    tab.until("document.images[0].complete");
    assert!(["Audits.issueAdded", "Log.entryAdded"].iter().any(|method| !noted(&mut tab, method).is_empty()));
}

/// Serves an empty page of another origin while the tests run.
fn foreign_page() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/", listener.local_addr().unwrap());
    thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            // A browser that disconnects is not a failure.
            let _ = uninterrupted::read(&stream, &mut [0; 4_096]);
            let _ = stream.write_all(
                b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 2\r\nConnection: close\r\n\r\nhi",
            );
        }
    });
    url
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn page_of_another_origin_can_neither_command_nor_watch() {
    let gripper = Gripper::new(&["--time-scale", "20"]);
    let mut own = gripper.open();
    let mut foreign = Tab::open(&foreign_page());
    foreign.until("document.body.textContent === 'hi'");
    let page = &gripper.page;

    // Without permission to read the answer, a browser still sends the request.
    foreign.eval(&format!(
        "fetch('{page}/command', {{ method: 'POST', mode: 'no-cors', body: '{{\"command\":\"fast_stop\"}}' }}).then(() => 0)"
    ));
    let watched = foreign.eval(&format!(
        "new Promise(done => {{ const events = new EventSource('{page}/events');
           events.addEventListener('hello', () => done('watches')); events.onerror = () => done(events.readyState); }})"
    ));
    // Browsers do not apply the same-origin policy to WebSockets.
    let connected = foreign.eval(&format!(
        "new Promise(done => {{ const socket = new WebSocket('{}/events');
           socket.onopen = () => done('connected'); socket.onerror = () => done(socket.readyState); }})",
        page.replacen("http", "ws", 1)
    ));

    assert_eq!((watched, connected), (json!(2), json!(3)), "closed");
    let answers = foreign.events_of("Network.responseReceivedExtraInfo");
    assert_eq!(answers.iter().filter(|answer| answer["statusCode"] == 403).count(), 2, "{answers:?}");
    // After the requests of the foreign page.
    home(&mut own);
    assert_eq!(own.eval(&flag_is_on("FAST_STOP")), false);
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn plot_shows_width_speed_and_force_and_continues() {
    let gripper = Gripper::new(&["--time-scale", "2"]);
    let mut tab = gripper.open();
    home(&mut tab);
    grip(&mut tab);
    // The points of each curve: horizontal and vertical position as fractions of the axes of its strip.
    let curve = |kind: &str| {
        format!(
            "(() => {{ const strip = document.querySelector('#plot [data-strip={kind}]'), axes = strip.querySelector('.axis').getBBox();
               const points = strip.querySelector('polyline').getAttribute('points').trim().split(' ');
               return points.map(point => point.split(',').map(Number))
                 .map(([x, y]) => [(x - axes.x) / axes.width, 1 - (y - axes.y) / axes.height]); }})()"
        )
    };
    // The plot is drawn with a delay.
    tab.until(&format!("Math.abs({}.at(-1)[1] - 30 / 120) < 0.01", curve("f")));
    let mut read = |kind: &str| -> Vec<[f64; 2]> { serde_json::from_value(tab.eval(&curve(kind))).unwrap() };
    let [width, speed, force] = ["w", "s", "f"].map(&mut read);
    for points in [&width, &speed, &force] {
        assert!(points.iter().flatten().all(|share| (-0.01..=1.01).contains(share)), "{points:?}");
        assert!(points.is_sorted_by(|one, next| one[0] <= next[0] + 0.001), "{points:?}");
        assert!(
            (points.last().unwrap()[0] - 1.0).abs() < 0.01,
            "the curve must end at the present: {points:?}"
        );
    }
    let highest = |points: &[[f64; 2]]| points.iter().map(|point| point[1]).fold(0.0, f64::max);
    assert!((highest(&width) - 1.0).abs() < 0.01 && (width.last().unwrap()[1] - 20.0 / 110.0).abs() < 0.01);
    assert!(speed.iter().any(|point| point[1] > 0.52), "outward: {speed:?}");
    assert!(speed.iter().any(|point| point[1] < 0.48), "inward: {speed:?}");
    assert!((speed.last().unwrap()[1] - 0.5).abs() < 0.01, "{speed:?}");
    assert!(force[0][1] < 0.01, "{force:?}");
    // Time advances even if nothing happens.
    let first = width[0][0];
    tab.until(&format!("{}[0][0] < {first} - 0.01", curve("w")));
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn fieldbus_monitor_shows_every_bit_of_both_images() {
    let gripper = Gripper::new(&["--time-scale", "20"]);
    let mut tab = gripper.open();
    let names = |list: &str| {
        format!("[...document.querySelectorAll('#{list} li')].map(item => item.firstChild.data)")
    };
    let command = ["MOVE", "GRIP", "RELEASE", "HOMING", "STOP_ACK", "FASTSTOP", "JOG_PLUS", "JOG_MINUS"];
    assert_eq!(tab.eval(&names("command_flags")), json!(command));
    let states = ["IDLE", "GRIPPING", "NO_PART", "PART_LOST", "HOLDING", "RELEASING", "POSITIONING", "ERROR"];
    assert_eq!(tab.eval(&names("gripper_flags")), json!(states));
    assert_eq!(tab.eval(&names("system_flags")), tab.eval(&names("flags")));
    // The lit entries of a list as the hex byte with these bits, and whether the page shows that byte.
    let byte = |list: &str, byte: u32| {
        format!(
            "[...document.querySelectorAll('#{list} .on')].map(item => Number(item.title.match(/\\d+/)[0]) - {})
               .filter(bit => bit >= 0 && bit < 8).reduce((sum, bit) => sum + 2 ** bit, 0)
               .toString(16).toUpperCase().padStart(2, '0')",
            8 * byte
        )
    };
    let bytes = |image: &str| format!("document.getElementById('{image}').textContent.split(' ')");
    let mut master = connect(&gripper.modbus);
    // Write Multiple Registers (FC 16) with the output image: 22 mm, 50 mm/s, 40 N.
    let mut write = |flags: u8| {
        let image = [flags, 0xA5, 0x08, 0x98, 0x13, 0x88, 0x0F, 0xA0];
        master.write_all(&[&[0, 1, 0, 0, 0, 15, 1, 16, 0, 0, 0, 4, 8], &image[..]].concat()).unwrap();
        master.read_exact(&mut [0; 12]).expect("an answer in time");
        image.map(|byte| format!("{byte:02X}")).join(" ")
    };
    let output = write(0);
    tab.until(&format!("document.getElementById('output').textContent === '{output}'"));

    let output = write(1 << 3);

    tab.until(&format!("document.getElementById('output').textContent === '{output}'"));
    assert_eq!(tab.eval(&byte("command_flags", 0)), "08");
    tab.until(&format!("{} === '01' && {}[0] === '01'", byte("gripper_flags", 0), bytes("input")));
    tab.until(&flag_is_on("REFERENCED"));
    // Flags of the second and third byte as well.
    for fault in ["motor_current", "over_temperature"] {
        tab.click(&format!("[name={fault}]"));
    }
    tab.until(&format!("{} && {}", flag_is_on("CURR_FAULT"), flag_is_on("TEMP_FAULT")));
    for at in 0..4 {
        let shown = [byte("system_flags", at), byte("flags", at), format!("{}[{}]", bytes("input"), 2 + at)];
        let shown = tab.eval(&format!("[{}]", shown.join(", ")));
        assert!(shown[0] == shown[1] && shown[1] == shown[2], "byte {at} of SYSSTATE: {shown}");
    }
    let values = "Object.fromEntries([...document.querySelectorAll('main[data-page=fieldbus] tbody:not(#buses) tr')]
        .map(row => [row.parentElement.id + ' ' + row.children[0].textContent, row.children[1].textContent]))";
    let values = tab.eval(values);
    for (name, value) in [
        ("output_registers IF (1)", "IF1 IF3 IF6 IF8"),
        ("output_registers CMDFLAGS (0)", "HOMING"),
        ("output_registers WIDTH (2..3)", "22.00 mm"),
        ("output_registers SPEED (4..5)", "50.00 mm/s"),
        ("output_registers FORCELIMIT (6..7)", "40.00 N"),
        ("input_registers WIDTH (6..7)", "110.00 mm"),
        ("input_registers STATUS (10..11)", "0 E_SUCCESS"),
    ] {
        assert_eq!(values[name], value, "{name}");
    }
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn frames_are_filtered_and_paused() {
    let gripper = Gripper::new(&[]);
    let mut tab = gripper.open();
    let log = "document.getElementById('log').textContent";
    let client = gripper.acknowledge();
    let place = client.local_addr().unwrap();
    tab.until(&format!("document.getElementById('clients').textContent.includes('tcp {place}')"));
    let rows = "[...document.querySelectorAll('#log li')]";
    for arrow in ["->", "<-"] {
        tab.until(&format!(
            "{rows}.some(row => row.querySelector('.what').textContent.startsWith('{arrow} 24h Acknowledge FAST STOP')
               && row.querySelector('.bytes').textContent.startsWith('AA AA AA 24'))"
        ));
    }

    tab.fill("#filter", "ACKNOWLEDGE FAST STOP E_");
    assert_eq!(tab.eval(&format!("{rows}.length")), 1, "{}", tab.eval(log));
    tab.fill("#filter", "no line has this");
    assert_eq!(tab.eval(log), "");
    tab.fill("#filter", "");

    tab.click("#pause");
    let before = tab.eval(log);
    let other = gripper.acknowledge();
    // Without the pause, the page would show it by now: it shows a later frame.
    let mut witness = gripper.open();
    witness.click("#part_out");
    // The witness repeats its click after a refusal for its age.
    for tab in [&mut witness, &mut tab] {
        tab.until("getComputedStyle(document.querySelector('#drawing .part')).visibility === 'hidden'");
    }
    assert_eq!(tab.eval(log), before);
    tab.click("#pause");
    let other = other.local_addr().unwrap();
    assert_eq!(tab.eval(&format!("{log}.includes('tcp {other}')")), true);

    tab.click("#clear");
    assert_eq!(tab.eval(log), "");
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn page_reports_a_lost_gripper_and_continues_when_it_returns() {
    // No other server gets ports on this address, so this port will be free again.
    let gripper = Gripper::on("127.0.0.2:0", &["--time-scale", "20"]);
    let mut tab = gripper.open();
    home(&mut tab);
    let address = gripper.page.trim_start_matches("http://").to_owned();

    drop(gripper);

    tab.until(&format!("{STATE} === 'no connection'"));
    tab.click("#stop");
    tab.until("document.getElementById('message').textContent === 'the gripper does not answer'");

    let gripper = Gripper::on(&address, &["--time-scale", "20"]);
    tab.until(&format!("{STATE} === 'IDLE' && !{}", flag_is_on("REFERENCED")));
    home(&mut tab);
    assert_eq!(tab.eval("document.getElementById('message').textContent"), "");

    // A stopped process sends nothing, but its connection stays open.
    gripper.signal(Signal::STOP);
    tab.until(&format!("{STATE} === 'no connection'"));
    gripper.signal(Signal::CONT);
    tab.until(&format!("{STATE} === 'IDLE'"));
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn excess_page_connects_when_another_is_closed() {
    let gripper = Gripper::new(&[]);
    let address = gripper.page.trim_start_matches("http://");
    let watch = |_| {
        let mut stream = connect(address);
        stream.write_all(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        // Wait for the answers, so that later requests do not displace the pages.
        stream.read_exact(&mut [0; 15]).expect("an answer in time");
        stream
    };
    let others: Vec<TcpStream> = (0..64).map(watch).collect();
    let mut tab = Tab::open(&gripper.page);
    tab.until(&format!("document.readyState === 'complete' && {STATE} === 'no connection'"));
    // Rejected, not just delayed.
    tab.until("document.getElementById('refusal').textContent.includes('64 pages are open already')");

    drop(others);

    tab.until(&format!("{STATE} === 'IDLE'"));
}
