//! The page of the station in Chromium and Firefox, from the folder that `cargo xtask web` builds.

mod sessions;

use browser::{MAX_DRAWING_MS, PROBLEMS, Tab};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;
use wsg_web::station::call;

/// Window sizes and colour schemes that the page supports.
const LOOKS: [(u32, u32, &str); 4] =
    [(1280, 800, "light"), (1280, 800, "dark"), (390, 844, "light"), (390, 844, "dark")];

/// Time for which a page is hidden.
const HIDDEN: Duration = Duration::from_secs(3);

/// Longest step of the page at speed 1, in seconds.
const LONGEST_S: f64 = 0.25;

/// Longest step in a request, in microseconds.
const STEP_US: u64 = 2_000_000;

/// Calls the module with each request, and returns a hash (FNV-1a) of each answer.
const HASHES: &str = "async requests => {
    globalThis.wsg ??= (await WebAssembly.instantiate(await (await fetch('wsg.wasm')).arrayBuffer(), {})).instance.exports;
    return requests.map(request => {
        const bytes = new TextEncoder().encode(request), to = wsg.wsg_reserve(bytes.length);
        new Uint8Array(wsg.memory.buffer, to, bytes.length).set(bytes);
        const length = wsg.wsg_station(), from = wsg.wsg_answer();
        let hash = 0x811C9DC5;
        for (const byte of new Uint8Array(wsg.memory.buffer, from, length)) hash = Math.imul(hash ^ byte, 0x01000193);
        return hash >>> 0;
    });
}";

/// Pages of a site share a process, so one test after the other has it.
static TURN: Mutex<()> = Mutex::new(());

/// The files that `cargo xtask web` builds.
struct Site {
    address: String,
    _turn: MutexGuard<'static, ()>,
}

impl Site {
    fn open() -> Self {
        let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("../web");
        assert!(folder.join("wsg.wasm").exists(), "{} is missing: run `cargo xtask web`", folder.display());
        Self { address: browser::serve(&folder).unwrap(), _turn }
    }

    /// Returns the address of a file.
    fn address(&self, file: &str) -> String {
        format!("{}/{file}", self.address)
    }
}

fn hash(text: &str) -> u32 {
    text.bytes().fold(0x811C_9DC5, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

/// Every answer is equal, with all frames, levels, and widths to the last digit.
#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn sessions_give_the_same_frames_natively_and_on_the_static_page_in_chromium() {
    let site = Site::open();
    let mut tab = Tab::open(&site.address("station.html"));
    let mut frames = 0;
    for number in 0..sessions::COUNT {
        let session = sessions::session(number);
        let (mut requests, mut answers, mut next) = (Vec::new(), Vec::new(), 0);
        let mut ask = |body: Value| {
            let mut body = body;
            body["first_frame"] = json!(next);
            let request = json!({ "station": body }).to_string();
            let answer = call(&request);
            let count = serde_json::from_str::<Value>(&answer).unwrap()["frame_count"].as_u64().unwrap();
            (next, frames) = (count, frames + count - if count < next { 0 } else { next });
            requests.push(request);
            answers.push(answer);
        };
        ask(json!({ "link": "" }));
        let mut now_us = 0;
        let ends = session.actions.iter().map(|(at_us, action)| (*at_us, vec![action.to_string()]));
        for (at_us, actions) in ends.chain([(session.end_us, vec![])]) {
            while now_us < at_us {
                let step_us = (at_us - now_us).min(STEP_US);
                ask(json!({ "step_us": step_us }));
                now_us += step_us;
            }
            ask(json!({ "actions": actions, "share": true }));
        }
        let hashes = tab.eval(&format!("({HASHES})({})", json!(requests)));
        for (at, answer) in answers.iter().enumerate() {
            assert_eq!(hashes[at], hash(answer), "session {number}, {}: {answer}", requests[at]);
        }
    }
    assert!(frames > 50_000, "only {frames} frames");
}

fn lamp(name: &str) -> String {
    format!("[...document.querySelectorAll('#outputs .on')].some(item => item.textContent === '{name} 1')")
}

fn step(number: u8) -> String {
    format!("document.getElementById('h-tour').textContent.startsWith('Tour, step {number} ')")
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn tour_of_the_static_page_is_clicked_through_in_chromium() {
    tour(pictures);
}

#[test]
#[ignore = "needs Firefox: `cargo xtask test` installs it"]
fn tour_of_the_static_page_is_clicked_through_in_firefox() {
    browser::use_firefox();
    tour(|_| ());
}

/// Clicks through the tour, and shows the held part.
fn tour(show: impl Fn(&mut Tab)) {
    let site = Site::open();
    let mut tab = Tab::open(&site.address("station.html"));
    tab.until(&step(1));
    tab.until("document.getElementById('cause').textContent.includes('FAST_STOP_OK')");
    check(&mut tab, "at the start");
    tab.click("#FAST_STOP_OK");
    tab.until("document.getElementById('FAST_STOP_OK').ariaChecked === 'true'");
    tab.click("#pulse_STOP_ACK");
    tab.until(&step(2));
    tab.click("#pulse_HOME");
    tab.until(&step(3));
    tab.click("#pulse_GRIP");
    tab.until(&step(4));
    tab.until("document.querySelector('#drawing').textContent.includes('40.0 N')");
    show(&mut tab);
    tab.click("#part_out");
    tab.until(&step(5));
    tab.until(&lamp("PART_FAULT"));
    tab.click("#cut");
    tab.until("document.getElementById('cut').ariaChecked === 'true'");
    tab.press("Escape");
    tab.until(
        "[...document.querySelectorAll('#frames .lost')].some(row => row.textContent.includes('FAST STOP'))",
    );
    tab.until("document.getElementById('input').textContent.includes('exception 0Bh')");
    check(&mut tab, "with a cut line");
    tab.click("#cut");
    tab.until(&step(6));
    tab.click("#FAST_STOP_OK");
    tab.until("document.getElementById('FAST_STOP_OK').ariaChecked === 'true'");
    tab.click("#pulse_STOP_ACK");
    tab.until(&lamp("READY"));
    tab.fill("#parameters label:first-child input", "60");
    tab.press("Enter");
    tab.click("#flag_RELEASE");
    tab.until("document.getElementById('h-tour').textContent === 'Tour: complete'");
    tab.click("#leave");
    tab.until("document.getElementById('tour').hidden");

    // The link of the session shows the same state, paused.
    tab.click("#run");
    tab.until("document.getElementById('run').textContent === 'Run'");
    tab.click("#share");
    let link = tab.until("location.hash");
    let shown = "JSON.stringify(['state', 'time', 'input', 'frames'].map(id => document.getElementById(id).textContent))";
    let before = tab.eval(shown);
    tab.click("#queries");
    let rows = tab.eval("document.getElementById('frames').children.length").as_u64().unwrap();
    assert_eq!(rows, 100, "the table is bounded");
    let mut other = Tab::open(&site.address(&format!("station.html{}", link.as_str().unwrap())));
    other.until("document.getElementById('message').textContent.startsWith('This is the session')");
    // Frames of the whole session remain in the first table, and the last 300 in the second.
    let [before, after] = [before, other.eval(shown)]
        .map(|text| serde_json::from_str::<Vec<String>>(text.as_str().unwrap()).unwrap());
    assert_eq!(before[..3], after[..3]);
    assert!(before[3].ends_with(&after[3]), "{before:?} {after:?}");
    let problems = other.events_of("Log.entryAdded");
    assert!(problems.is_empty(), "{problems:?}");
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn static_page_is_paused_stepped_and_hidden_and_shows_refusals_in_chromium() {
    let site = Site::open();
    let mut tab = Tab::open(&site.address("station.html#0w20~nonsense"));
    tab.until("document.getElementById('message').textContent.includes('the link is damaged')");
    tab.click("#restart");
    tab.until("document.getElementById('run').textContent === 'Pause'");
    tab.click("#run");
    tab.until("document.getElementById('run').textContent === 'Run'");
    let time = "Number(document.getElementById('time').textContent.split(' ')[0])";
    let before = tab.eval(time).as_f64().unwrap();
    for passed in [0.001, 0.002] {
        tab.click("#single");
        tab.until(&format!("Math.abs({time} - {before} - {passed}) < 1e-6"));
    }
    tab.click("#run");
    tab.until(&format!("{time} > 0.1"));
    tab.call("Emulation.setFocusEmulationEnabled", &json!({ "enabled": false }));
    let window = tab.call("Browser.getWindowForTarget", &json!({}))["windowId"].clone();
    let set = |tab: &mut Tab, state| {
        let bounds = json!({ "windowId": window, "bounds": { "windowState": state } });
        tab.call("Browser.setWindowBounds", &bounds);
    };
    set(&mut tab, "minimized");
    let before = tab.until(&format!("document.hidden && {time}")).as_f64().unwrap();
    thread::sleep(HIDDEN);
    // A step that began before ends.
    let hidden = tab.eval(time).as_f64().unwrap();
    assert!(hidden - before <= LONGEST_S, "{before} s to {hidden} s");
    set(&mut tab, "normal");
    let after = tab.until(&format!("{time} > {hidden} && {time}")).as_f64().unwrap();
    assert!(after - hidden < HIDDEN.as_secs_f64(), "{hidden} s to {after} s");
    tab.eval("document.querySelector('details').open = true");
    tab.fill("#s102", "2");
    tab.press("Enter");
    tab.until("document.getElementById('message').textContent === ''");
    tab.eval("(() => { const field = document.getElementById('s102'); field.max = 9; field.value = 3; field.dispatchEvent(new Event('change')); })()");
    tab.until(
        "document.getElementById('message').textContent.includes('refused setting 102 with exception 3')",
    );
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn keyboard_reaches_everything_on_the_static_page_and_all_has_a_name_in_chromium() {
    let site = Site::open();
    let mut tab = Tab::open(&site.address("station.html"));
    tab.until(&step(1));
    tab.eval("[...document.querySelectorAll('details')].forEach(details => { details.open = true; })");
    // A station that is paused can be stepped.
    tab.click("#run");
    tab.until("document.getElementById('run').textContent === 'Run'");
    tab.assert_all_have_names("station");
    tab.assert_tab_reaches_all("station");
    tab.click("#run");
    tab.eval("document.getElementById('FAST_STOP_OK').focus()");
    tab.press("Enter");
    tab.until("document.getElementById('FAST_STOP_OK').ariaChecked === 'true'");
    for request in tab.events_of("Network.requestWillBeSent") {
        let url = request["request"]["url"].as_str().unwrap();
        assert!(url.starts_with(&site.address("")), "{url}");
    }
    for method in
        ["Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded", "Audits.issueAdded"]
    {
        assert_eq!(tab.events_of(method), [Value::Null; 0], "{method}");
    }
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn motion_and_rest_of_the_static_page_take_little_of_the_processor_in_chromium() {
    let site = Site::open();
    let mut tab = Tab::open(&site.address("station.html"));
    tab.until("document.getElementById('cause').textContent.includes('FAST_STOP_OK')");
    tab.look(390, 844, "light");
    let wait = "new Promise(done => setTimeout(done, 3000))";
    // The first seconds draw the page.
    tab.eval(wait);
    tab.count_drawings();
    let (_, before) = tab.drawings();
    tab.eval(wait);
    let idle = (tab.drawings().1 - before) / 3.0;
    tab.click("#FAST_STOP_OK");
    tab.until("document.getElementById('FAST_STOP_OK').ariaChecked === 'true'");
    tab.click("#pulse_STOP_ACK");
    tab.until(&step(2));
    tab.click("#pulse_HOME");
    tab.until("document.getElementById('state').textContent === 'Gripper: POSITIONING'");
    let (first, before) = tab.drawings();
    tab.until(&step(3));
    let (last, after) = tab.drawings();
    let drawing_ms = 1_000.0 * (after - before) / (last - first);
    println!("{:.1} % idle, {drawing_ms:.2} ms for each of {} drawings", 100.0 * idle, last - first);
    assert!(last - first >= 20.0 && drawing_ms <= MAX_DRAWING_MS && idle <= 0.03, "{idle}, {drawing_ms} ms");
}

/// Checks the layout in all sizes and schemes.
fn check(tab: &mut Tab, when: &str) {
    for (width, height, scheme) in LOOKS.into_iter().chain([(320, 800, "light"), (810, 800, "light")]) {
        tab.look(width, height, scheme);
        tab.eval("scrollTo(0, 0)");
        assert_eq!(tab.eval(PROBLEMS), json!([]), "{width} {scheme} {when}");
    }
    tab.look(1280, 800, "light");
}

/// Compares the pictures of the documents; `WSG_UPDATE_DOCS=1` takes them again.
fn pictures(tab: &mut Tab) {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    for (width, height, scheme) in LOOKS {
        let file = docs.join(format!("station-{width}x{height}-{scheme}.png"));
        if std::env::var_os("WSG_UPDATE_DOCS").is_some() {
            tab.look(width, height, scheme);
            tab.eval("document.activeElement.blur(); scrollTo(0, 0)");
            tab.call("Emulation.setScrollbarsHidden", &json!({"hidden": true}));
            std::fs::write(&file, tab.picture()).unwrap();
        }
        let png = std::fs::read(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let size = [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().unwrap()));
        assert_eq!(size, [width, height], "{}", file.display());
    }
    tab.look(1280, 800, "light");
}
