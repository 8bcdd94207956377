//! `wsg gateway` as a process, for tests with masters of Modbus/TCP.

use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};

use crate::example;

/// A running gateway. Dropping it kills its process.
#[derive(Debug)]
pub struct Gateway {
    /// The process.
    pub process: Child,
    /// Address on which masters connect, of the first gripper.
    pub modbus: SocketAddr,
    /// The same address of each gripper.
    pub ports: Vec<SocketAddr>,
}

impl Gateway {
    /// Starts a gateway for the gripper at an address, with further options. It accepts masters when this returns, but may not be
    /// connected to the gripper yet.
    ///
    /// # Panics
    /// Panics when `wsg` is not built, or prints no address.
    #[must_use]
    pub fn start(gripper: SocketAddr, options: &[&str]) -> Self {
        let gripper = format!("tcp://{gripper}");
        let arguments = ["--gripper", &gripper, "--modbus", "127.0.0.1:0"];
        Self::of(&[&arguments, options].concat(), 1)
    }

    /// Starts a gateway with these arguments for a number of grippers.
    ///
    /// # Panics
    /// Panics when `wsg` is not built, or prints fewer addresses.
    #[must_use]
    pub fn of(arguments: &[&str], grippers: usize) -> Self {
        let mut process = Command::new(example::program("wsg"))
            .arg("gateway")
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("wsg starts");
        let lines = BufReader::new(process.stdout.take().expect("stdout is piped")).lines();
        let ports = lines
            .map_while(Result::ok)
            .filter_map(|line| line.strip_prefix("modbus   ")?.split(',').next()?.parse().ok());
        let ports: Vec<_> = ports.take(grippers).collect();
        assert_eq!(ports.len(), grippers, "the gateway prints an address for each gripper");
        Self { process, modbus: ports[0], ports }
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
