//! Firefox for the tests that use only what every browser offers. WebDriver BiDi controls it over a WebSocket.

use std::cell::{Cell, RefCell};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::{io, thread};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

use crate::BOUND;

/// The shell outlives Firefox to delete its profile. It ends when its input closes, thus with the tests in any case. The
/// setting lets windows without a desktop have the focus, as keys need it.
const START: &str = r#"
trap '' INT
profile=$(mktemp -d)
echo 'user_pref("focusmanager.testmode", true);' >"$profile/user.js"
HOME=$profile firefox-esr --headless --no-remote --profile "$profile" --remote-debugging-port 0 </dev/null 2>&1 &
exec >&-
read -r _
kill $!
wait
rm -rf "$profile"
"#;

/// What Firefox prints before its address.
const LISTENING: &str = "WebDriver BiDi listening on ";

thread_local! {
    static IS_USED: Cell<bool> = const { Cell::new(false) };
    static FIREFOX: RefCell<Option<Firefox>> = const { RefCell::new(None) };
}

/// Opens the windows of this thread in Firefox from now on. It starts with the first one.
pub fn use_firefox() {
    IS_USED.set(true);
}

/// Returns whether this thread opens its windows in Firefox.
pub(crate) fn is_used() -> bool {
    IS_USED.get()
}

/// Calls the Firefox of this thread.
pub(crate) fn with<R>(use_it: impl FnOnce(&mut Firefox) -> R) -> R {
    FIREFOX.with_borrow_mut(|firefox| use_it(firefox.get_or_insert_with(Firefox::start)))
}

pub(crate) struct Firefox {
    socket: WebSocket<TcpStream>,
    /// Number of the last request.
    last_id: u64,
    /// Events of all windows.
    events: Vec<Value>,
    shell: Child,
}

impl Firefox {
    fn start() -> Self {
        let mut start = Command::new("sh");
        start.args(["-c", START]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut shell = start.spawn().expect("a shell");
        let mut output = BufReader::new(shell.stdout.take().expect("stdout is piped"));
        let mut printed = String::new();
        let address = loop {
            let from = printed.len();
            assert!(output.read_line(&mut printed).is_ok_and(|len| len > 0), "Firefox ended: {printed}");
            if let Some(address) = printed[from..].trim_end().strip_prefix(LISTENING) {
                break address.to_owned();
            }
        };
        // Firefox would wait for a reader of its messages.
        thread::spawn(move || io::copy(&mut output, &mut io::sink()));
        let stream = TcpStream::connect(address.trim_start_matches("ws://")).expect("Firefox listens");
        stream.set_read_timeout(Some(BOUND)).expect("a duration");
        let (socket, _) = tungstenite::client(format!("{address}/session"), stream).expect("a WebSocket");
        let mut firefox = Self { socket, last_id: 0, events: Vec::new(), shell };
        firefox.call("session.new", json!({ "capabilities": {} }));
        firefox.call("session.subscribe", json!({ "events": ["log.entryAdded"] }));
        firefox
    }

    /// Sends a request and returns its result.
    pub(crate) fn call(&mut self, method: &str, params: Value) -> Value {
        self.last_id += 1;
        let request = json!({ "id": self.last_id, "method": method, "params": params }).to_string();
        self.socket.send(Message::text(request)).expect("Firefox runs");
        loop {
            let message = self
                .socket
                .read()
                .unwrap_or_else(|error| panic!("Firefox does not answer {method}: {error}"));
            let Message::Text(text) = message else { continue };
            let mut message: Value = serde_json::from_str(&text).expect("Firefox sends JSON");
            if message["type"] == "event" {
                self.events.push(message);
            } else if message["id"] == self.last_id {
                assert_eq!(message["type"], "success", "{method}: {message}");
                return message["result"].take();
            }
        }
    }

    /// Opens an empty window and returns its identifier.
    pub(crate) fn open(&mut self) -> Value {
        let context = self.call("browsingContext.create", json!({ "type": "window" }))["context"].take();
        self.call("browsingContext.activate", json!({ "context": context }));
        context
    }

    /// Evaluates an expression in a window.
    pub(crate) fn eval(&mut self, context: &Value, expression: &str) -> Value {
        let target = json!({ "context": context });
        let how = json!({ "expression": expression, "target": target, "awaitPromise": true });
        let answer = self.call("script.evaluate", how);
        assert_eq!(answer["type"], "success", "{expression}: {}", answer["exceptionDetails"]["text"]);
        plain(&answer["result"])
    }

    /// Does the actions of a mouse or a keyboard in a window.
    pub(crate) fn perform(&mut self, context: &Value, kind: &str, actions: &[Value]) {
        let source = json!({ "type": kind, "id": kind, "actions": actions });
        self.call("input.performActions", json!({ "context": context, "actions": [source] }));
    }

    /// Returns the messages in the console of a window, errors included.
    pub(crate) fn console(&self, context: &Value) -> Vec<Value> {
        let messages = self.events.iter().map(|event| &event["params"]);
        messages.filter(|message| message["source"]["context"] == *context).cloned().collect()
    }
}

impl Drop for Firefox {
    fn drop(&mut self) {
        drop(self.shell.stdin.take());
        // Waits until the shell has deleted the profile.
        let _ = self.shell.wait();
    }
}

/// Returns the actions that press and release a key.
pub(crate) fn press(key: &str) -> [Value; 2] {
    ["keyDown", "keyUp"].map(|kind| json!({ "type": kind, "value": key }))
}

/// Returns the JSON value of a value with types, as Firefox sends it.
fn plain(typed: &Value) -> Value {
    let value = &typed["value"];
    match (typed["type"].as_str(), value) {
        (Some("array"), Value::Array(values)) => values.iter().map(plain).collect(),
        (Some("object"), Value::Array(pairs)) => pairs
            .iter()
            .filter_map(|pair| Some((pair[0].as_str()?.to_owned(), plain(&pair[1]))))
            .collect::<serde_json::Map<_, _>>()
            .into(),
        _ => value.clone(),
    }
}
