//! `wsg gateway` as a process, for tests with masters of Modbus/TCP.

use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process::{Child, Command, Stdio};

use crate::example;

/// A running gateway. Dropping it kills its process.
#[derive(Debug)]
pub struct Gateway {
    /// The process.
    pub process: Child,
    /// Address on which masters connect.
    pub modbus: SocketAddr,
}

impl Gateway {
    /// Starts a gateway for the gripper at an address, with further options. It accepts masters when this returns, but may not be
    /// connected to the gripper yet.
    ///
    /// # Panics
    /// Panics when `wsg` is not built, or prints no address.
    #[must_use]
    pub fn start(gripper: SocketAddr, options: &[&str]) -> Self {
        let mut process = Command::new(example::program("wsg"))
            .args(["gateway", "--gripper", &format!("tcp://{gripper}"), "--modbus", "127.0.0.1:0"])
            .args(options)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("wsg starts");
        let lines = BufReader::new(process.stdout.take().expect("stdout is piped")).lines();
        let modbus =
            lines.map_while(Result::ok).find_map(|line| line.strip_prefix("modbus   ")?.parse().ok());
        Self { process, modbus: modbus.expect("the gateway prints its address") }
    }

    /// Kills the process, and returns its messages. Call this once.
    ///
    /// # Panics
    /// Panics when called again.
    pub fn messages(&mut self) -> String {
        self.kill();
        let mut messages = String::new();
        let stderr = self.process.stderr.take();
        stderr.expect("stderr is piped").read_to_string(&mut messages).expect("the messages are text");
        messages
    }

    fn kill(&mut self) {
        // An error means that it has already ended.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Drop for Gateway {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Runs a test with a gateway, again if the machine paused the gateway, which then disconnects from everything.
pub fn unpaused<R>(start: impl Fn() -> R, gateway: impl Fn(&mut R) -> &mut Gateway, test: impl Fn(&mut R)) {
    for attempt in 1.. {
        let mut rig = start();
        let tested = catch_unwind(AssertUnwindSafe(|| test(&mut rig)));
        let is_paused = gateway(&mut rig).messages().contains("paused");
        match tested {
            Ok(()) => return,
            Err(_) if is_paused && attempt < 10 => {}
            Err(panic) => resume_unwind(panic),
        }
    }
}
