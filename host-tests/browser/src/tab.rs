//! A window of a browser, and Chromium.

use crate::{BOUND, firefox};
use base64::{Engine, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{LazyLock, Mutex};
use std::{iter, thread};

/// One browser for all tests, with separate windows per test. One process takes two thirds of the time of several.
static BROWSER: LazyLock<Browser> = LazyLock::new(Browser::start);

/// Chromium reads from descriptor 3 and writes to 4; its other output concerns the missing desktop. The shell outlives
/// it to delete its profile. The sandbox is off, because root and containers cannot use it and only pages of these
/// tests are shown.
const START: &str = r#"
trap '' INT
profile=$(mktemp -d)
chromium --headless --no-sandbox --disable-gpu --disable-background-networking --no-first-run --process-per-site --remote-debugging-pipe \
  --user-data-dir="$profile" 3<&0 4>&1 </dev/null >/dev/null 2>&1
rm -rf "$profile"
"#;

struct Browser {
    requests: Mutex<ChildStdin>,
    ids: AtomicU64,
    /// Receivers of messages by session; messages of the browser itself have none.
    readers: Mutex<HashMap<String, Sender<Value>>>,
    own: Mutex<Receiver<Value>>,
}

impl Browser {
    fn start() -> Self {
        let mut shell = Command::new("sh")
            .args(["-c", START])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("a shell");
        let requests = Mutex::new(shell.stdin.take().expect("stdin is piped"));
        let answers = shell.stdout.take().expect("stdout is piped");
        thread::spawn(move || {
            distribute(answers);
            // Waits until the shell has deleted the profile.
            let _ = shell.wait();
        });
        let (sender, own) = channel();
        let readers = HashMap::from([(String::new(), sender)]);
        Self { requests, ids: AtomicU64::new(1), readers: Mutex::new(readers), own: Mutex::new(own) }
    }

    /// Sends a request and returns its number.
    fn send(&self, session: &str, method: &str, params: &Value) -> u64 {
        let id = self.ids.fetch_add(1, Ordering::Relaxed);
        let mut request = json!({"id": id, "method": method, "params": params});
        if !session.is_empty() {
            request["sessionId"] = json!(session);
        }
        let mut bytes = request.to_string().into_bytes();
        bytes.push(0);
        let sent = self.requests.lock().unwrap().write_all(&bytes);
        sent.expect("Chromium runs: `cargo xtask test` installs it");
        id
    }

    /// Sends a request to the browser itself and returns its result.
    fn call(&self, method: &str, params: &Value) -> Value {
        let own = self.own.lock().unwrap();
        let id = self.send("", method, params);
        result(method, id, &own, |_| {})
    }
}

/// Passes each message to its receiver until the pipe closes.
fn distribute(answers: ChildStdout) {
    let mut answers = BufReader::new(answers);
    let mut message = Vec::new();
    while answers.read_until(0, &mut message).is_ok_and(|len| len > 0) {
        message.pop();
        let value: Value = serde_json::from_slice(&message).expect("Chromium sends JSON");
        let session = value["sessionId"].as_str().unwrap_or_default();
        if let Some(reader) = BROWSER.readers.lock().unwrap().get(session) {
            // A finished test no longer receives.
            let _ = reader.send(value);
        }
        message.clear();
    }
    BROWSER.readers.lock().unwrap().clear();
}

/// Returns the result of the request with this number; passes messages before it to `pass`.
fn result(method: &str, id: u64, messages: &Receiver<Value>, mut pass: impl FnMut(Value)) -> Value {
    loop {
        let mut message = messages
            .recv_timeout(BOUND)
            .unwrap_or_else(|error| panic!("Chromium does not answer {method}: {error}"));
        if message["id"] == id {
            assert!(message["error"].is_null(), "{method}: {}", message["error"]);
            return message["result"].take();
        }
        pass(message);
    }
}

/// An expression whose value is the list of layout defects of a page: elements that overflow, are cut off, overlap, or are hard to read.
pub const PROBLEMS: &str = r#"(() => {
    const problems = [], root = document.documentElement;
    if (root.scrollWidth > root.clientWidth) problems.push("the page is wider than the window");
    const name = element => element.tagName + " " + (element.id || element.textContent.trim().slice(0, 40));
    const shown = [...document.querySelectorAll("header, section, h1, h2, p, li, dt, dd, th, td, button, input, select, summary, a, label, svg, text, ol, span")]
        .filter(element => element.checkVisibility() && !element.closest(".hidden, datalist") && !element.closest("ol[tabindex], [role=region]")?.contains(element.parentElement))
        .map(element => ({ element, box: element.getBoundingClientRect() }))
        .filter(({ box }) => box.width > 0 && box.height > 0);
    for (const { element, box } of shown) {
        const around = element.parentElement.closest("svg, section, header, body").getBoundingClientRect();
        // In Firefox, the box of a text is higher than its letters.
        const slack = element instanceof SVGTextElement && navigator.userAgent.includes("Firefox") ? 3 : 1;
        if (box.left < around.left - slack || box.right > around.right + slack || box.top < around.top - slack || box.bottom > around.bottom + slack)
            problems.push(name(element) + " sticks out");
        if (!element.matches("ol[tabindex], input, select") && element instanceof HTMLElement && element.scrollWidth > element.clientWidth + 1 && element.clientWidth > 0)
            problems.push(name(element) + " is cut off");
    }
    shown.forEach(({ element: one, box: a }, at) => {
        for (const { element: other, box: b } of shown.slice(at + 1)) {
            const overlap = Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
            if (overlap && !one.contains(other) && !other.contains(one)) problems.push(name(one) + " and " + name(other) + " overlap");
        }
    });
    const light = colour => {
        const [red, green, blue] = colour.match(/[\d.]+/g).map(part => part / 255).map(part => part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4);
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
    };
    for (const { element } of shown) {
        const hasText = element.value || [...element.childNodes].some(child => child.nodeType === 3 && child.data.trim());
        if (!hasText) continue;
        let painted = element;
        while (/, 0\)$|transparent/.test(getComputedStyle(painted).backgroundColor)) painted = painted.parentElement;
        const style = getComputedStyle(element);
        const lights = [light(element instanceof SVGElement ? style.fill : style.color), light(getComputedStyle(painted).backgroundColor)].sort();
        const contrast = (Math.max(...lights) + 0.05) / (Math.min(...lights) + 0.05);
        if (contrast < 4.5) problems.push(name(element) + " has a contrast of " + contrast.toFixed(1));
    }
    return problems;
})()"#;

/// A window used by one test only.
pub struct Tab {
    window: Window,
    last: Option<Input>,
}

/// A window of a browser.
enum Window {
    Chromium(Session),
    /// With its identifier.
    Firefox(Value),
}

/// A window of Chromium.
struct Session {
    id: String,
    target: Value,
    messages: Receiver<Value>,
    /// Unsolicited events, such as requests and console messages.
    events: Vec<Value>,
}

/// The last click or key, which is repeated if the server refuses it for its age, or does not answer in time.
enum Input {
    /// On the element that this selector finds.
    Click(String),
    Key(String),
}

/// What [`Tab::until`] finds instead of its expression if the page of `wsg-sim` shows that the server refused the input for its age,
/// or did not answer it in time.
const REFUSED: &str = "refused for age";

/// Longest time of the page's thread for a drawing, in ms: a telephone that is four times as slow as this computer then draws 60 frames
/// a second.
pub const MAX_DRAWING_MS: f64 = 4.1;

/// Maximum number of repetitions of an input.
const REPETITIONS: usize = 30;

/// The error of a request while the network interfaces change.
const CHANGED: &str = "net::ERR_NETWORK_CHANGED";

impl Session {
    fn open() -> Self {
        let window = json!({"url": "about:blank", "newWindow": true});
        let target = BROWSER.call("Target.createTarget", &window);
        let target = target["targetId"].clone();
        let attached = BROWSER.call("Target.attachToTarget", &json!({"targetId": target, "flatten": true}));
        let session = attached["sessionId"].as_str().expect("a session").to_owned();
        let (sender, messages) = channel();
        BROWSER.readers.lock().unwrap().insert(session.clone(), sender);
        let mut session = Self { id: session, target, messages, events: Vec::new() };
        for domain in ["Page", "Runtime", "Network", "Log", "Audits"] {
            session.call(&format!("{domain}.enable"), &json!({}));
        }
        // Emulates the focus, so that the browser does not throttle the page and delivers keys.
        session.call("Emulation.setFocusEmulationEnabled", &json!({"enabled": true}));
        session
    }

    fn call(&mut self, method: &str, params: &Value) -> Value {
        let id = BROWSER.send(&self.id, method, params);
        result(method, id, &self.messages, |event| self.events.push(event))
    }
}

impl Tab {
    /// Opens an empty window in Firefox if this thread uses it, else in Chromium.
    fn new() -> Self {
        let window = if firefox::is_used() {
            Window::Firefox(firefox::with(firefox::Firefox::open))
        } else {
            Window::Chromium(Session::open())
        };
        let mut tab = Self { window, last: None };
        tab.look(1280, 800, "light");
        tab
    }

    /// Opens a window with this URL.
    pub fn open(url: &str) -> Self {
        let mut tab = Self::new();
        if let Window::Firefox(context) = &tab.window {
            let page = json!({ "context": context, "url": url, "wait": "complete" });
            firefox::with(|firefox| firefox.call("browsingContext.navigate", page));
            return tab;
        }
        // The tests in network namespaces add and remove interfaces meanwhile, which ends every request.
        let mut shown = json!({"errorText": CHANGED});
        for _ in 0..20 {
            if shown["errorText"] == CHANGED {
                shown = tab.call("Page.navigate", &json!({"url": url}));
            }
        }
        assert!(shown["errorText"].is_null(), "{url}: {shown}");
        tab
    }

    /// Sets the size in pixels and the colour scheme of the system, which stays the same in Firefox.
    pub fn look(&mut self, width: u32, height: u32, scheme: &str) {
        if let Window::Firefox(context) = &self.window {
            let size = json!({ "context": context, "viewport": { "width": width, "height": height } });
            firefox::with(|firefox| firefox.call("browsingContext.setViewport", size));
            self.until(&format!("innerWidth === {width}"));
            return;
        }
        let size = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.call("Emulation.setDeviceMetricsOverride", &size);
        let scheme = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        self.call("Emulation.setEmulatedMedia", &scheme);
        // The answers precede the new layout, which a busy machine delays.
        self.until(&format!("innerWidth === {width}"));
    }

    /// Sends a request of the DevTools protocol, which Chromium alone has, and returns its result.
    pub fn call(&mut self, method: &str, params: &Value) -> Value {
        match &mut self.window {
            Window::Chromium(session) => session.call(method, params),
            Window::Firefox(_) => panic!("Firefox has no {method}"),
        }
    }

    /// Evaluates an expression on the page once it has loaded.
    pub fn eval(&mut self, expression: &str) -> Value {
        if let Window::Firefox(context) = &self.window {
            return firefox::with(|firefox| firefox.eval(context, expression));
        }
        let how = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let mut answer = self.call("Runtime.evaluate", &how);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].take()
    }

    /// Evaluates an expression repeatedly until it is not null, and returns its value. On a busy machine, states and answers reach
    /// the page late, and the server refuses the input before it: it is repeated, as a user does.
    #[track_caller]
    pub fn until(&mut self, expression: &str) -> Value {
        let bound_ms = BOUND.as_millis() / 2;
        let mut found = Value::Null;
        for _ in 0..REPETITIONS {
            let may_repeat = self.last.is_some();
            found = self.eval(&format!(
                "new Promise(done => {{
                   const end = performance.now() + {bound_ms};
                   const look = () => {{
                     let found; try {{ found = ({expression}); }} catch {{ }}
                     const refusal = {may_repeat} && [...document.querySelectorAll('[id$=message]')]
                       .find(message => /^the sender saw a state|will not execute this later$/.test(message.textContent));
                     if (found) done(found);
                     else if (refusal) {{ refusal.textContent = ''; done('{REFUSED}'); }}
                     else if (performance.now() > end) done(null);
                     else setTimeout(look, 30);
                   }};
                   look();
                 }})"
            ));
            if found != REFUSED {
                break;
            }
            match self.last.take() {
                Some(Input::Click(selector)) => self.click(&selector),
                Some(Input::Key(key)) => self.press(&key),
                None => {}
            }
        }
        assert!(
            !found.is_null() && found != REFUSED,
            "time-out waiting for: {expression}\n{}",
            self.eval("document.body.innerText")
        );
        found
    }

    /// Does the same as [`click`](Self::click), and does not repeat it.
    pub fn click_once(&mut self, selector: &str) {
        self.click(selector);
        self.last = None;
    }

    /// Clicks the centre of the element that a selector finds, on the page that shows it.
    pub fn click(&mut self, selector: &str) {
        let page = self.until(&format!(
            "(() => {{ const page = document.querySelector({selector:?}).closest('main');
               return page && page.hidden ? page.dataset.page : 'shown'; }})()"
        ));
        if page != "shown" {
            self.show(page.as_str().unwrap());
        }
        let middle = self.until(&format!(
            "(() => {{ const found = document.querySelector({selector:?}); found.scrollIntoView({{ block: 'center' }});
               const {{ x, y, width, height }} = found.getBoundingClientRect(); return [x + width / 2, y + height / 2]; }})()"
        ));
        self.click_at(&middle);
        self.last = Some(Input::Click(selector.to_owned()));
    }

    /// Shows one of the pages by its link. A click that misses is repeated, as a user does: the link may move between the look at
    /// its place and the click.
    pub fn show(&mut self, page: &str) {
        let is_shown = format!(
            "new Promise(done => {{
               const end = performance.now() + 2000;
               const look = () => {{
                 const shown = !document.querySelector('main[data-page={page}]').hidden;
                 if (shown || performance.now() > end) done(shown); else setTimeout(look, 30);
               }};
               look();
             }})"
        );
        let shown = (0..5).any(|_| {
            self.click(&format!("nav a[href='#{page}']"));
            self.eval(&is_shown) == true
        });
        assert!(shown, "the link does not show {page}\n{}", self.eval("document.body.innerText"));
    }

    /// Presses a key that types no text except, for Enter, a line break.
    pub fn press(&mut self, key: &str) {
        // The code of the DevTools protocol, and the character of WebDriver.
        let (code, character) = match key {
            "Tab" => (9, "\u{E004}"),
            "Enter" => (13, "\u{E006}"),
            "Escape" => (27, "\u{E00C}"),
            "ArrowLeft" => (37, "\u{E012}"),
            _ => panic!("no key code is known for {key}"),
        };
        self.last = Some(Input::Key(key.to_owned()));
        if let Window::Firefox(context) = &self.window {
            firefox::with(|firefox| firefox.perform(context, "key", &firefox::press(character)));
            return;
        }
        let text = if key == "Enter" { "\r" } else { "" };
        for kind in ["keyDown", "keyUp"] {
            let press =
                json!({"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code, "text": text});
            self.call("Input.dispatchKeyEvent", &press);
        }
    }

    /// Asserts that Tab leads to every control in sight, and that each shows the focus.
    pub fn assert_tab_reaches_all(&mut self, page: &str) {
        let mark =
            "document.activeElement.dataset.reached = getComputedStyle(document.activeElement).outlineWidth";
        let all = "[...document.querySelectorAll('button, input, select, textarea, a, summary, [tabindex]')].filter(control => control.checkVisibility())";
        self.eval("document.activeElement.blur(); scrollTo(0, 0)");
        let count = self.eval(&format!("{all}.length")).as_u64().expect("a number");
        assert!(count >= 8, "{page}: {count}");
        for _ in 0..count + 1 {
            self.press("Tab");
            assert_ne!(self.eval(mark), "0px", "{page}: {}", self.eval("document.activeElement.outerHTML"));
        }
        let missed =
            format!("{all}.filter(control => !control.dataset.reached).map(control => control.outerHTML)");
        assert_eq!(self.eval(&missed), json!([]), "{page}: Tab must reach each element");
    }

    /// Asserts that every control, picture and list in sight has a name of its own for a screen reader.
    pub fn assert_all_have_names(&mut self, page: &str) {
        const WITH_NAME: [&str; 12] = [
            "button",
            "switch",
            "spinbutton",
            "searchbox",
            "textbox",
            "checkbox",
            "combobox",
            "listbox",
            "log",
            "image",
            "img",
            "list",
        ];
        self.call("Accessibility.enable", &json!({}));
        let controls = self.eval(
            "[...document.querySelectorAll('button, input, select, textarea, svg, ul, ol')].filter(control => control.checkVisibility()).length",
        );
        let tree = self.call("Accessibility.getFullAXTree", &json!({}));
        let mut names = Vec::new();
        for node in tree["nodes"].as_array().expect("nodes") {
            let role = node["role"]["value"].as_str().unwrap_or_default();
            if node["ignored"] == false && WITH_NAME.contains(&role) {
                let name = node["name"]["value"].as_str().unwrap_or_default();
                assert!(!name.trim().is_empty(), "{page}: {node}");
                names.push(format!("{role} {name}"));
            }
        }
        assert_eq!(json!(names.len()), controls, "{page}: {names:#?}");
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count, "{page}: duplicate names: {names:#?}");
    }

    /// Replaces the text of the focused field.
    pub fn type_text(&mut self, text: &str) {
        self.eval("document.activeElement.select()");
        if let Window::Firefox(context) = &self.window {
            let keys = text.chars().map(|key| if key == '\n' { '\u{E006}' } else { key });
            // Delete removes the old text if there is no new one.
            let keys = iter::once('\u{E017}').chain(keys);
            let actions: Vec<_> = keys.flat_map(|key| firefox::press(&key.to_string())).collect();
            firefox::with(|firefox| firefox.perform(context, "key", &actions));
            return;
        }
        self.call("Input.insertText", &json!({"text": text}));
    }

    /// Clicks the field that a selector finds, and replaces its text. A click that misses is repeated, as in [`show`](Self::show).
    pub fn fill(&mut self, field: &str, text: &str) {
        let is_focused = format!("document.activeElement === document.querySelector({field:?})");
        let focused = (0..5).any(|_| {
            self.click(field);
            self.eval(&is_focused) == true
        });
        assert!(focused, "{field} does not get the focus");
        self.type_text(text);
    }

    /// Returns the events of the DevTools protocol with this name received so far. Firefox has `Log.entryAdded` alone.
    pub fn events_of(&mut self, method: &str) -> Vec<Value> {
        // The answer arrives after all earlier events.
        self.eval("0");
        let session = match &self.window {
            Window::Chromium(session) => session,
            Window::Firefox(context) if method == "Log.entryAdded" => {
                return firefox::with(|firefox| firefox.console(context));
            }
            Window::Firefox(_) => panic!("Firefox has no {method}"),
        };
        let events = session.events.iter().filter(|event| event["method"] == method);
        events.map(|event| event["params"].clone()).collect()
    }

    /// Returns the commands of this name that the page of `wsg-sim` has sent so far.
    pub fn commands(&mut self, name: &str) -> Vec<Value> {
        let frames = self.events_of("Network.webSocketFrameSent");
        let sent = frames.iter().filter_map(|frame| frame["response"]["payloadData"].as_str());
        let bodies = sent.filter_map(|text| {
            let mut body = serde_json::from_str::<Value>(text).ok()?["body"].take();
            body.as_object_mut()?.remove("key");
            Some(body)
        });
        bodies.filter(|body| body["command"] == name).collect()
    }

    /// Returns a picture of the window as a PNG file.
    pub fn picture(&mut self) -> Vec<u8> {
        let shot = match &self.window {
            Window::Firefox(context) => {
                let shown = json!({ "context": context });
                firefox::with(|firefox| firefox.call("browsingContext.captureScreenshot", shown))
            }
            Window::Chromium(_) => self.call("Page.captureScreenshot", &json!({"format": "png"})),
        };
        STANDARD.decode(shot["data"].as_str().expect("a picture")).expect("base64")
    }

    /// Starts counting how often the page draws moving fingers.
    pub fn count_drawings(&mut self) {
        self.call("Performance.enable", &json!({ "timeDomain": "threadTicks" }));
        self.eval(
            "window.drawn = 0;
             new MutationObserver(() => drawn++).observe(document.querySelector('#drawing .finger'), { attributes: true }); 0",
        );
    }

    /// Returns the number of drawings, and the time of the page's thread in the processor, in seconds, which does not depend on what
    /// else a computer does.
    pub fn drawings(&mut self) -> (f64, f64) {
        let metrics = self.call("Performance.getMetrics", &json!({}));
        let mut metrics = metrics["metrics"].as_array().expect("metrics").iter();
        let time =
            metrics.find(|metric| metric["name"] == "TaskDuration").and_then(|it| it["value"].as_f64());
        (self.eval("drawn").as_f64().expect("a number"), time.expect("a time"))
    }

    /// Presses and releases the mouse at this place. Returns once the browser has passed both on.
    pub fn click_at(&mut self, place: &Value) {
        if let Window::Firefox(context) = &self.window {
            let [x, y] = [&place[0], &place[1]].map(|place| place.as_f64().expect("a number").round());
            let to = json!({ "type": "pointerMove", "x": x as i32, "y": y as i32 });
            let click = ["pointerDown", "pointerUp"].map(|kind| json!({ "type": kind, "button": 0 }));
            let [down, up] = click;
            firefox::with(|firefox| firefox.perform(context, "pointer", &[to, down, up]));
            return;
        }
        for kind in ["mousePressed", "mouseReleased"] {
            let click =
                json!({"type": kind, "x": place[0], "y": place[1], "button": "left", "clickCount": 1});
            self.call("Input.dispatchMouseEvent", &click);
        }
    }
}

/// Returns the processor time in s that all pages, and what draws them, have used.
pub fn cpu_time() -> f64 {
    let info = BROWSER.call("SystemInfo.getProcessInfo", &json!({}));
    let processes = info["processInfo"].as_array().expect("processes").iter();
    processes
        .filter(|process| process["type"] != "browser")
        .filter_map(|process| process["cpuTime"].as_f64())
        .sum()
}

impl Drop for Tab {
    fn drop(&mut self) {
        let session = match &self.window {
            Window::Chromium(session) => session,
            Window::Firefox(context) => {
                if !thread::panicking() {
                    firefox::with(|firefox| {
                        firefox.call("browsingContext.close", json!({ "context": context }))
                    });
                }
                return;
            }
        };
        BROWSER.readers.lock().unwrap_or_else(|error| error.into_inner()).remove(&session.id);
        if !thread::panicking() {
            BROWSER.call("Target.closeTarget", &json!({"targetId": session.target}));
        }
    }
}
