//! Test fixtures: broker, host with an independent Sparkplug decoder, grippers, and the program under test.

use std::{
    env,
    ffi::OsStr,
    fmt::Write as _,
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command as Process, Stdio},
    sync::{
        Arc, Condvar, Mutex,
        atomic::{AtomicU32, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

pub(crate) use host_tests::socket::free_port;
use serde_json::Value;
use wsg_protocol::{Command, Event, FrameEncoder, FrameParser, Reply, Status};
use wsg_sim::{
    Config,
    server::{Lines, ServerThread},
};

/// Time-out for every wait, even on a busy machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// Returns whether to run slow tests, as `cargo xtask ci` does.
pub(crate) fn is_whole() -> bool {
    env::var_os("WSG_WHOLE").is_some()
}

/// A temporary folder, deleted when dropped.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = env::temp_dir().join(format!("wsg-telemetry-test-{}-{number}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, text).unwrap();
        path
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A program that is killed when dropped.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Polls `look` until it returns a value. Panics after the time-out.
pub(crate) fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "time-out waiting for {what}");
        thread::park_timeout(Duration::from_millis(5));
    }
}

pub(crate) struct Broker {
    pub(crate) port: u16,
    settings: PathBuf,
    running: Option<Running>,
}

impl Broker {
    /// Starts a broker that accepts anonymous clients.
    pub(crate) fn start(folder: &Folder) -> Self {
        Self::with_settings(folder, "allow_anonymous true\n")
    }

    pub(crate) fn with_settings(folder: &Folder, settings: &str) -> Self {
        let port = free_port();
        let settings = format!("listener {port} 127.0.0.1\nmax_queued_messages 0\nuser root\n{settings}");
        let mut broker = Self { port, settings: folder.write("mosquitto.conf", &settings), running: None };
        broker.restart();
        broker
    }

    pub(crate) fn restart(&mut self) {
        self.kill();
        let mut mosquitto = Process::new("mosquitto");
        mosquitto.arg("-c").arg(&self.settings).stdout(Stdio::null()).stderr(Stdio::null());
        self.running = Some(Running(mosquitto.spawn().unwrap()));
        wait_for("the broker", || TcpStream::connect(("127.0.0.1", self.port)).ok());
    }

    /// Kills the broker, as a power cut would.
    pub(crate) fn kill(&mut self) {
        self.running = None;
    }

    /// Publishes a payload with QoS 1 and additional arguments of `mosquitto_pub`.
    pub(crate) fn publish(&self, topic: &str, payload: &[u8], arguments: &[&str]) {
        let mut client = Process::new("mosquitto_pub");
        client.args(["-p", &self.port.to_string(), "-q", "1", "-t", topic, "-s"]).args(arguments);
        let mut client = client.stdin(Stdio::piped()).spawn().unwrap();
        client.stdin.take().unwrap().write_all(payload).unwrap();
        assert!(client.wait().unwrap().success());
    }
}

fn node(argument: Option<&str>) -> Process {
    let packages =
        env::var_os("WSG_MODBUS_NODE").expect("WSG_MODBUS_NODE is not set; run `cargo xtask test`");
    let mut node = Process::new("node");
    node.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/telemetry/peers.js"));
    node.args(argument).env("NODE_PATH", packages);
    node
}

/// Encodes a Sparkplug B payload with an independent implementation.
pub(crate) fn encoded(payload: &Value) -> Vec<u8> {
    let output = node(Some(&payload.to_string())).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let hex = String::from_utf8(output.stdout).unwrap();
    let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
    (0..hex.len()).step_by(2).map(byte).collect()
}

/// A host that records and decodes all messages of the broker.
pub(crate) struct Host {
    _clients: [Running; 2],
    messages: Arc<(Mutex<Vec<Value>>, Condvar)>,
}

impl Host {
    /// Subscribes to all topics and records messages from now on.
    pub(crate) fn watch(broker: &Broker) -> Self {
        Self::watch_with(broker, &[])
    }

    pub(crate) fn watch_with(broker: &Broker, arguments: &[&str]) -> Self {
        // The retained message is received once all topics are subscribed to.
        broker.publish("ready", b"yes", &[&["-r"], arguments].concat());
        let mut client = Process::new("mosquitto_sub");
        client.args(["-p", &broker.port.to_string(), "-F", "%t %x", "-t", "spBv1.0/#", "-t", "ready"]);
        let mut client = client.args(arguments).stdout(Stdio::piped()).spawn().unwrap();
        let lines = client.stdout.take().unwrap();
        let mut decoder = node(None).stdin(lines).stdout(Stdio::piped()).spawn().unwrap();
        let messages = Arc::new((Mutex::new(Vec::new()), Condvar::new()));
        collect(decoder.stdout.take().unwrap(), Arc::clone(&messages));
        let host = Self { _clients: [Running(client), Running(decoder)], messages };
        host.wait("the subscription", |messages| messages.iter().any(|message| message["topic"] == "ready"));
        host.messages.0.lock().unwrap().clear();
        host
    }

    /// Waits until the messages so far meet a condition, and returns them.
    pub(crate) fn wait(&self, what: &str, mut is_there: impl FnMut(&[Value]) -> bool) -> Vec<Value> {
        let (messages, changed) = &*self.messages;
        let found = messages.lock().unwrap();
        let (found, waited) = changed.wait_timeout_while(found, PATIENCE, |found| !is_there(found)).unwrap();
        let found = found.clone();
        let text = found.iter().fold(String::new(), |mut text, message| {
            let _ = writeln!(text, "{message}");
            text
        });
        assert!(!waited.timed_out(), "time-out waiting for {what}; received:\n{text}");
        found
    }

    /// Waits for a message of a kind and device, and returns the latest one.
    pub(crate) fn wait_for(&self, kind: &str, device: &str) -> Value {
        let is_it = |message: &Value| is_of(message, kind, device);
        let messages = self.wait(&format!("{kind} {device}"), |messages| messages.iter().any(is_it));
        messages.into_iter().rfind(is_it).unwrap()
    }

    /// Discards the messages so far.
    pub(crate) fn clear(&self) {
        self.messages.0.lock().unwrap().clear();
    }
}

fn collect(lines: ChildStdout, messages: Arc<(Mutex<Vec<Value>>, Condvar)>) {
    thread::spawn(move || {
        for line in BufReader::new(lines).lines() {
            let message = serde_json::from_str(&line.unwrap()).unwrap();
            messages.0.lock().unwrap().push(message);
            messages.1.notify_all();
        }
    });
}

/// Returns whether a message is of a kind and device, or of the node if `device` is empty.
pub(crate) fn is_of(message: &Value, kind: &str, device: &str) -> bool {
    let topic = format!("spBv1.0/plant/{kind}/cell");
    let wanted = if device.is_empty() { topic } else { format!("{topic}/{device}") };
    message["topic"] == wanted
}

/// Returns a metric of a birth by name.
pub(crate) fn metric<'a>(birth: &'a Value, name: &str) -> &'a Value {
    let metrics = birth["metrics"].as_array().unwrap();
    metrics.iter().find(|metric| metric["name"] == name).unwrap_or_else(|| panic!("{name} in {birth}"))
}

/// A running `wsg telemetry` with its standard error.
pub(crate) struct Telemetry {
    running: Running,
    printed: Arc<Mutex<String>>,
}

impl Telemetry {
    /// Starts the program. `broker` and `devices` are sections of its settings.
    pub(crate) fn start(folder: &Folder, broker: &str, devices: &str) -> Self {
        let state = folder.path("state");
        let settings = format!(
            "[broker]\nreconnect_s = 0.1\n{broker}\n[node]\ngroup = \"plant\"\nname = \"cell\"\nstate_file = {state:?}\n{devices}"
        );
        Self::run([folder.write("telemetry.toml", &settings)], &[])
    }

    pub(crate) fn at(folder: &Folder, port: u16, devices: &str) -> Self {
        Self::start(folder, &format!("address = \"mqtt://127.0.0.1:{port}\""), devices)
    }

    pub(crate) fn run(
        arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
        variables: &[(&str, &str)],
    ) -> Self {
        let mut wsg = Process::new(env!("CARGO_BIN_EXE_wsg"));
        wsg.arg("telemetry").args(arguments).envs(variables.iter().copied());
        let mut wsg = wsg.stderr(Stdio::piped()).spawn().unwrap();
        let printed = Arc::new(Mutex::new(String::new()));
        let (lines, text) = (BufReader::new(wsg.stderr.take().unwrap()), Arc::clone(&printed));
        thread::spawn(move || {
            for line in lines.lines() {
                let line = line.unwrap();
                eprintln!("{line}");
                let mut text = text.lock().unwrap();
                text.push_str(&line);
                text.push('\n');
            }
        });
        Self { running: Running(wsg), printed }
    }

    /// Waits until standard error contains a text.
    pub(crate) fn wait_until_it_says(&self, text: &str) {
        wait_for(text, || self.printed().contains(text).then_some(()));
    }

    pub(crate) fn id(&self) -> u32 {
        self.running.0.id()
    }

    pub(crate) fn printed(&self) -> String {
        self.printed.lock().unwrap().clone()
    }

    /// Sends SIGTERM and waits for the program to exit.
    pub(crate) fn end(mut self) {
        let id = self.running.0.id().to_string();
        assert!(Process::new("kill").args(["-TERM", &id]).status().unwrap().success());
        let status = wait_for("the program to exit", || self.running.0.try_wait().unwrap());
        assert!(status.success(), "{status}: {}", self.printed());
    }
}

/// A fast virtual gripper on TCP.
pub(crate) struct Gripper {
    server: Option<ServerThread>,
    pub(crate) address: SocketAddr,
}

impl Gripper {
    pub(crate) fn start() -> Self {
        let mut gripper = Self { server: None, address: SocketAddr::from(([127, 0, 0, 1], free_port())) };
        gripper.switch_on();
        gripper
    }

    pub(crate) fn switch_on(&mut self) {
        let lines = Lines { tcp: Some(self.address), ..Lines::default() };
        let config = Config { time_scale: 20.0, serial_number: 4711, ..Config::default() };
        self.server = Some(ServerThread::start(config, &lines, None).unwrap());
    }

    pub(crate) fn switch_off(&mut self) {
        self.server.take().unwrap().stop().unwrap();
    }

    /// Returns the settings section of this gripper.
    pub(crate) fn section(&self, name: &str) -> String {
        format!("[[gripper]]\nname = {name:?}\naddress = \"tcp://{}\"\n", self.address)
    }

    pub(crate) fn controller(&self) -> Controller {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        Controller { stream, parser: FrameParser::new() }
    }
}

/// A client that commands the gripper directly.
pub(crate) struct Controller {
    stream: TcpStream,
    parser: FrameParser<64>,
}

impl Controller {
    /// Sends a command and returns its final status.
    pub(crate) fn command(&mut self, command: Command<'_>) -> Status {
        self.ask(command, |reply| (reply.status() != Status::CmdPending).then(|| reply.status()))
    }

    /// Sends a command and returns what `look` finds in its replies.
    pub(crate) fn ask<T>(&mut self, command: Command<'_>, look: impl Fn(&Reply<'_>) -> Option<T>) -> T {
        let id = command.id();
        let bytes: Vec<u8> = FrameEncoder::new(id.code(), command).collect();
        self.stream.write_all(&bytes).unwrap();
        loop {
            let mut byte = [0];
            self.stream.read_exact(&mut byte).unwrap();
            if let Some(Event::Frame(frame)) = self.parser.push(byte[0])
                && let Some(found) = look(&Reply::decode(&frame).unwrap())
            {
                return found;
            }
        }
    }
}

impl Drop for Controller {
    fn drop(&mut self) {
        if !thread::panicking() {
            self.command(Command::DisconnectAnnouncement);
        }
    }
}

/// A TCP proxy to a broker that a test opens and closes, so that a host can connect first.
pub(crate) struct Way {
    pub(crate) port: u16,
    open: Arc<Mutex<Option<u16>>>,
}

impl Way {
    /// Creates a closed proxy, which drops incoming connections.
    pub(crate) fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let open = Arc::new(Mutex::new(None));
        let target = Arc::clone(&open);
        thread::spawn(move || {
            for client in listener.incoming() {
                let client = client.unwrap();
                let Some(port) = *target.lock().unwrap() else { continue };
                let Ok(broker) = TcpStream::connect(("127.0.0.1", port)) else { continue };
                for (mut from, mut to) in
                    [(client.try_clone().unwrap(), broker.try_clone().unwrap()), (broker, client)]
                {
                    thread::spawn(move || {
                        let _ = std::io::copy(&mut from, &mut to);
                        let _ = to.shutdown(std::net::Shutdown::Both);
                    });
                }
            }
        });
        Self { port, open }
    }

    pub(crate) fn open_to(&self, port: u16) {
        *self.open.lock().unwrap() = Some(port);
    }

    pub(crate) fn close(&self) {
        *self.open.lock().unwrap() = None;
    }
}
