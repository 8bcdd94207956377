//! `wsg gateway` as a process, for tests with masters of Modbus/TCP.

use std::env::temp_dir;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process::{Child, Command, Stdio, id};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::sleep;
use std::time::Duration;

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
    /// Address of the status page, if the gateway has one.
    pub page: Option<SocketAddr>,
}

impl Gateway {
    /// Starts a gateway for the gripper on TCP at an address, with further options. It accepts masters when this returns, but may
    /// not be connected to the gripper yet.
    ///
    /// # Panics
    /// Panics when `wsg` is not built, or prints no address.
    #[must_use]
    pub fn start(gripper: SocketAddr, options: &[&str]) -> Self {
        Self::to(&format!("tcp://{gripper}"), options)
    }

    /// Starts a gateway like [`start`](Self::start), for a gripper on any line.
    ///
    /// # Panics
    /// Panics when `wsg` is not built, or prints no address.
    #[must_use]
    pub fn to(gripper: &str, options: &[&str]) -> Self {
        Self::spawn(Self::command(gripper, options), 1)
    }

    /// Returns the command that [`to`](Self::to) spawns.
    ///
    /// # Panics
    /// Panics when `wsg` is not built.
    #[must_use]
    pub fn command(gripper: &str, options: &[&str]) -> Command {
        Self::with(&[&["--gripper", gripper, "--modbus", "127.0.0.1:0"], options].concat())
    }

    /// Returns the command with these arguments.
    ///
    /// # Panics
    /// Panics when `wsg` is not built.
    #[must_use]
    pub fn with(arguments: &[&str]) -> Command {
        let mut command = Command::new(example::program("wsg"));
        command.arg("gateway").args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Starts a gateway with the text of a configuration file, for a number of grippers.
    ///
    /// # Panics
    /// Panics when the file cannot be written, `wsg` is not built, or prints fewer addresses.
    #[must_use]
    pub fn of_config(text: &str, grippers: usize) -> Self {
        static FILES: AtomicUsize = AtomicUsize::new(0);
        let number = FILES.fetch_add(1, Ordering::Relaxed);
        let file = temp_dir().join(format!("wsg-gateway-{}-{number}.toml", id()));
        fs::write(&file, text).expect("the file is writable");
        let gateway =
            Self::spawn(Self::with(&["--config", file.to_str().expect("a path in UTF-8")]), grippers);
        // The gateway reads its configuration only at the start.
        let _ = fs::remove_file(&file);
        gateway
    }

    /// Runs a command that starts a gateway for a number of grippers.
    ///
    /// # Panics
    /// Panics when `wsg` prints fewer addresses.
    #[must_use]
    pub fn spawn(mut command: Command, grippers: usize) -> Self {
        let mut process = command.spawn().expect("wsg starts");
        let lines = BufReader::new(process.stdout.take().expect("stdout is piped")).lines();
        let mut page = None;
        let ports = lines.map_while(Result::ok).filter_map(|line| {
            let url =
                line.strip_prefix("page     http://").and_then(|url| url.trim_end_matches('/').parse().ok());
            page = page.or(url);
            line.strip_prefix("modbus   ")?.split(',').next()?.parse().ok()
        });
        let ports: Vec<_> = ports.take(grippers).collect();
        assert_eq!(ports.len(), grippers, "the gateway prints an address for each gripper");
        Self { process, modbus: ports[0], ports, page }
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

/// Payload of a panic that no disturbance of the machine excuses: the fingers moved without a request.
#[derive(Debug)]
pub struct Moved(pub String);

/// Runs a test with a gateway, again if the machine paused the gateway, which then disconnects from everything, or if its messages
/// show another disturbance. Returns the messages.
pub fn unpaused<R>(
    start: impl Fn() -> R,
    gateway: impl Fn(&mut R) -> &mut Gateway,
    is_disturbed: impl Fn(&R, &str) -> bool,
    test: impl Fn(&mut R),
) -> String {
    for attempt in 1.. {
        let mut rig = start();
        let tested = catch_unwind(AssertUnwindSafe(|| test(&mut rig)));
        if tested.is_err() {
            // The gateway prints its message about the loss beside its answer.
            sleep(Duration::from_millis(100));
        }
        let messages = gateway(&mut rig).messages();
        let is_disturbed = messages.contains("paused") || is_disturbed(&rig, &messages);
        match tested {
            Ok(()) => return messages,
            Err(panic) if is_disturbed && attempt < 10 && !panic.is::<Moved>() => {
                eprintln!("attempt {attempt}, disturbed: {messages}")
            }
            Err(panic) => resume_unwind(panic),
        }
    }
    unreachable!("the last attempt returns or panics")
}
