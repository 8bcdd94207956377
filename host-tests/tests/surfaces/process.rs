//! `wsg`, its gateway, and the Python package, as their users start them.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use host_tests::example::{self, Process};
use host_tests::gateway::Gateway;

use crate::fieldbus;
use crate::station::BOUND;
use crate::surface::{Outcome, SPEED, Separately, Surface, Verb};

/// One `wsg gripper` for each request, as from several terminals.
pub(crate) fn wsg(address: SocketAddr) -> Box<dyn Surface> {
    wsg_with(address, false)
}

/// The same, with each motion in a script of one line.
pub(crate) fn wsg_script(address: SocketAddr) -> Box<dyn Surface> {
    wsg_with(address, true)
}

fn wsg_with(address: SocketAddr, has_scripts: bool) -> Box<dyn Surface> {
    let program = example::program("wsg");
    Box::new(Separately(move |verb| {
        let (is_motion, command) = match verb {
            Verb::Home => (true, "home positive".to_owned()),
            Verb::Move(width) => (true, format!("move {width} {SPEED}")),
            Verb::Grip(width, force) => (true, format!("grip {width} {SPEED} --force={force}")),
            Verb::FastStop => (false, "fast-stop".to_owned()),
            Verb::Acknowledge => (false, "ack".to_owned()),
            Verb::Read => (false, "width".to_owned()),
        };
        let is_script = has_scripts && is_motion;
        let mut wsg = Command::new(&program);
        wsg.args(["gripper", &format!("tcp://{address}")]);
        wsg.args(if is_script { "script -" } else { &command }.split(' '));
        wsg.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut running = wsg.spawn().expect("wsg starts");
        let mut lines = running.stdin.take().expect("it is piped");
        if is_script {
            writeln!(lines, "{command}").expect("wsg reads its script");
        }
        drop(lines);
        let output = running.wait_with_output().expect("wsg runs");
        let [printed, why] =
            [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
        if output.status.success() { Ok(printed) } else { Err(format!("{printed}{why}")) }
    }))
}

/// The masters of a gateway, and what they need.
pub(crate) struct Masters<T>(pub(crate) Box<dyn Surface>, pub(crate) T);

/// Starts `wsg gateway`, and commands it over Modbus/TCP.
pub(crate) fn gateway(address: SocketAddr) -> Box<dyn Surface> {
    let gateway = Gateway::start(address, &[]);
    Masters(fieldbus::modbus(gateway.modbus), gateway).connected()
}

impl<T: 'static> Masters<T> {
    /// Waits until the gateway is connected to its gripper.
    pub(crate) fn connected(mut self) -> Box<dyn Surface> {
        let start = Instant::now();
        while !matches!(self.begin(Verb::Read).recv_timeout(BOUND), Ok(Ok(_))) {
            assert!(start.elapsed() < BOUND, "the gateway connects");
            thread::sleep(Duration::from_millis(5));
        }
        Box::new(self)
    }
}

impl<T> Surface for Masters<T> {
    fn begin(&mut self, verb: Verb) -> Receiver<Outcome> {
        self.0.begin(verb)
    }
}

/// Outcomes that the program still owes, by the number of their request.
type Open = Arc<Mutex<HashMap<usize, Sender<Outcome>>>>;

/// A program that executes numbered requests from its standard input, each in a thread.
pub(crate) struct Program {
    _process: Process,
    requests: ChildStdin,
    number: usize,
    open: Open,
}

impl Program {
    pub(crate) fn start(program: &mut Command) -> Self {
        let child = program.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut process = Process(child.expect("the program starts"));
        let mut lines = BufReader::new(process.0.stdout.take().expect("stdout is piped")).lines();
        assert_eq!(
            lines.next().and_then(Result::ok).as_deref(),
            Some("ready"),
            "{:?} connects",
            program.get_program()
        );
        let open = Open::default();
        let answers = Arc::clone(&open);
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let (number, outcome) = line.split_once(' ').expect("a number and an outcome");
                let outcome = match outcome.split_once(' ').expect("a word and a text") {
                    ("ok", text) => Ok(text.to_owned()),
                    (_, text) => Err(text.to_owned()),
                };
                let number = number.parse().expect("a number");
                let sender =
                    answers.lock().expect("no panic").remove(&number).expect("one outcome for a request");
                // The test may have ended.
                let _ = sender.send(outcome);
            }
        });
        let requests = process.0.stdin.take().expect("stdin is piped");
        Self { _process: process, requests, number: 0, open }
    }

    pub(crate) fn request(&mut self, request: &str) -> Receiver<Outcome> {
        let (sender, outcome) = channel();
        self.number += 1;
        self.open.lock().expect("no panic").insert(self.number, sender);
        writeln!(self.requests, "{} {request}", self.number).expect("the program reads");
        outcome
    }
}

/// A program of a user of the Python package.
struct Python(Program);

/// Starts `surface.py` with a class of the package: `Gripper`, `AsyncGripper`, `StreamingGripper` or `WSGController`.
pub(crate) fn python(address: SocketAddr, class: &str) -> Box<dyn Surface> {
    let python = std::env::var_os("WSG_PYTHON")
        .expect("WSG_PYTHON must name a Python with the package; run `cargo xtask test`");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/surfaces/surface.py");
    let mut program = Command::new(python);
    program
        .arg(script)
        .args([class, &address.ip().to_string(), &address.port().to_string()])
        .env("PYTHONDONTWRITEBYTECODE", "1");
    Box::new(Python(Program::start(&mut program)))
}

impl Surface for Python {
    fn begin(&mut self, verb: Verb) -> Receiver<Outcome> {
        self.0.request(&match verb {
            Verb::Home => "home".to_owned(),
            Verb::Move(width) => format!("move {width} {SPEED}"),
            Verb::Grip(width, force) => format!("grip {width} {SPEED} {force}"),
            Verb::FastStop => "fast_stop".to_owned(),
            Verb::Acknowledge => "acknowledge".to_owned(),
            Verb::Read => "read".to_owned(),
        })
    }
}
