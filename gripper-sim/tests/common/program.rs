//! `wsg-sim` as a program.

use std::io::{BufRead, BufReader, Lines};
use std::process::{Child, ChildStdout, Command, Stdio};

/// A `wsg-sim` that runs. It ends with its test, however that ends.
pub(crate) struct Program {
    child: Child,
    said: Lines<BufReader<ChildStdout>>,
}

impl Program {
    pub(crate) fn start(arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_wsg-sim"))
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("it starts");
        let said = BufReader::new(child.stdout.take().expect("it is piped")).lines();
        Self { child, said }
    }

    /// The next line that it says.
    pub(crate) fn line(&mut self) -> String {
        self.said.next().expect("it says more").expect("it can be read")
    }

    /// Where it serves this: what comes behind the name in its next line.
    pub(crate) fn place_of(&mut self, name: &str) -> String {
        let line = self.line();
        let place = line.strip_prefix(name).and_then(|rest| rest.strip_prefix(' '));
        place.unwrap_or_else(|| panic!("where is {name}? {line}")).to_owned()
    }

    #[cfg(unix)]
    pub(crate) fn pid(&self) -> rustix::process::Pid {
        rustix::process::Pid::from_child(&self.child)
    }

    /// Sends it a signal, which Unix has.
    #[cfg(unix)]
    pub(crate) fn signal(&self, signal: rustix::process::Signal) {
        rustix::process::kill_process(self.pid(), signal).expect("it runs");
    }

    /// What Ctrl-C does; how it ends.
    #[cfg(unix)]
    pub(crate) fn interrupt(mut self) -> std::process::ExitStatus {
        self.signal(rustix::process::Signal::INT);
        self.child.wait().expect("it ends")
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // An error means that it has ended already, which is what is wanted.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
