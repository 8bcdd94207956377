//! `wsg-sim` as a child process.

use std::io::{BufRead, BufReader, Lines};
use std::process::{Child, ChildStdout, Command, Stdio};

/// A running `wsg-sim`, which is killed on drop.
pub(crate) struct Program {
    child: Child,
    output: Lines<BufReader<ChildStdout>>,
}

impl Program {
    pub(crate) fn start(arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_wsg-sim"))
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("wsg-sim starts");
        let output = BufReader::new(child.stdout.take().expect("stdout is piped")).lines();
        Self { child, output }
    }

    /// Starts the program with TCP and the control interface, and returns the addresses of both.
    pub(crate) fn with_control(arguments: &[&str]) -> (Self, String, String) {
        let lines = ["--tcp", "127.0.0.1:0", "--control", "127.0.0.1:0"];
        let mut program = Self::start(&[&lines, arguments].concat());
        let [_, tcp, control, _] = ["model", "tcp", "control", "page"].map(|name| program.place_of(name));
        (program, tcp, control)
    }

    /// Returns the next line of standard output.
    pub(crate) fn line(&mut self) -> String {
        self.output.next().expect("another line").expect("readable output")
    }

    /// Returns the address or path in the next line, after this name.
    pub(crate) fn place_of(&mut self, name: &str) -> String {
        let line = self.line();
        let place = line.strip_prefix(name).and_then(|rest| rest.strip_prefix(' '));
        place.unwrap_or_else(|| panic!("expected `{name} PLACE`, found `{line}`")).to_owned()
    }

    #[cfg(unix)]
    pub(crate) fn pid(&self) -> rustix::process::Pid {
        rustix::process::Pid::from_child(&self.child)
    }

    /// Sends a signal to the program.
    #[cfg(unix)]
    pub(crate) fn signal(&self, signal: rustix::process::Signal) {
        rustix::process::kill_process(self.pid(), signal).expect("wsg-sim is running");
    }

    /// Interrupts the program like Ctrl-C and returns its exit status.
    #[cfg(unix)]
    pub(crate) fn interrupt(mut self) -> std::process::ExitStatus {
        self.signal(rustix::process::Signal::INT);
        self.child.wait().expect("wsg-sim ends")
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // An error means that the program has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
