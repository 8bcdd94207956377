//! Network namespaces connected by virtual cables: one for a gripper, one for its controller.
//!
//! They require root, and `ip`, `tc` and `chrt` of Debian.

use std::fs::{self, File};
use std::os::fd::AsFd;
use std::process::{Command, id};
use std::sync::atomic::{AtomicU16, Ordering};
use std::thread;

use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};

use crate::masters::printed;

static NETWORKS: AtomicU16 = AtomicU16::new(0);

/// An end of the cables. The first cable, for PROFINET, connects the interfaces `eth0` of both namespaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The end of `eth0` without an address.
    Gripper,
    /// The end of `eth0` with the address 192.168.7.1/24.
    Controller,
}

const ENDS: [End; 2] = [End::Gripper, End::Controller];

/// Two connected namespaces, which are deleted on drop.
#[derive(Debug)]
pub struct Network {
    number: u16,
}

impl Network {
    /// Creates both namespaces and connects them.
    ///
    /// # Panics
    /// Panics without `ip` or without the rights that it needs.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "it creates namespaces")]
    pub fn new() -> Self {
        let network = Self { number: NETWORKS.fetch_add(1, Ordering::Relaxed) };
        for end in ENDS {
            run("ip", &format!("netns add {}", network.namespace(end)));
            network.plug(end, "lo", true);
        }
        network.add_cable("eth0", &[(End::Controller, "192.168.7.1")]);
        network
    }

    /// Connects interfaces of this name at both ends, and gives them addresses.
    ///
    /// # Panics
    /// Panics without `ip` or without the rights that it needs.
    pub fn add_cable(&self, interface: &str, addresses: &[(End, &str)]) {
        let [gripper, controller] = ENDS.map(|end| self.namespace(end));
        run(
            "ip",
            &format!("link add {interface} netns {gripper} type veth peer {interface} netns {controller}"),
        );
        for end in ENDS {
            self.plug(end, interface, true);
        }
        for (end, address) in addresses {
            run("ip", &format!("-n {} address add {address}/24 dev {interface}", self.namespace(*end)));
        }
    }

    /// Plugs a cable into an interface at this end, or pulls it out.
    ///
    /// # Panics
    /// Panics without `ip`.
    pub fn plug(&self, end: End, interface: &str, is_plugged: bool) {
        let state = if is_plugged { "up" } else { "down" };
        run("ip", &format!("-n {} link set {interface} {state}", self.namespace(end)));
    }

    /// Returns the number of this network in this program.
    #[must_use]
    pub const fn number(&self) -> u16 {
        self.number
    }

    /// Returns the name of the namespace at this end, which no other running program uses.
    #[must_use]
    pub fn namespace(&self, end: End) -> String {
        namespace(self.number, end)
    }

    /// Runs `act` in the namespace at this end. Threads and processes that it starts inherit the namespace.
    ///
    /// # Panics
    /// Panics if `act` does, or without the right to enter the namespace.
    pub fn at<T: Send>(&self, end: End, act: impl FnOnce() -> T + Send) -> T {
        let namespace = File::open(format!("/run/netns/{}", self.namespace(end)));
        let namespace = namespace.expect("a namespace has a file");
        let enter_and_act = || {
            move_into_link_name_space(namespace.as_fd(), Some(LinkNameSpaceType::Network))
                .expect("the right to enter a namespace");
            act()
        };
        thread::scope(|scope| scope.spawn(enter_and_act).join().expect("no panic"))
    }

    /// Moves the gripper's end of the cable to the namespace of this program. Returns the name of the interface.
    ///
    /// # Panics
    /// Panics without `ip`.
    #[must_use]
    pub fn take_gripper_end(&self) -> String {
        let (namespace, interface) = (self.namespace(End::Gripper), format!("wsg{}x{}", id(), self.number));
        run("ip", &format!("-n {namespace} link set eth0 netns {} name {interface}", id()));
        run("ip", &format!("link set {interface} up"));
        interface
    }

    /// Discards all frames that are sent at this end, or sends them again.
    ///
    /// # Panics
    /// Panics without `tc`.
    pub fn discard(&self, sender: End, discards: bool) {
        let namespace = self.namespace(sender);
        // A queue without room, or the default of the interface.
        let queue = if discards { "pfifo limit 0" } else { "noqueue" };
        run("tc", &format!("-n {namespace} qdisc replace dev eth0 root {queue}"));
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for end in ENDS {
            let _ = Command::new("ip").args(["netns", "delete", &self.namespace(end)]).output();
        }
    }
}

/// Returns a command for a program at the controller's end of the network with this [number](Network::number).
#[must_use]
pub fn at_controller(network: u16, program: &str) -> Command {
    let mut command = Command::new("ip");
    let namespace = namespace(network, End::Controller);
    command.args(["netns", "exec", &namespace, "chrt", "--fifo", REAL_TIME, program]);
    command
}

/// Gives real-time priority to all virtual grippers of this program. It replaces the dedicated controller of a real device.
///
/// # Panics
/// Panics if the program's threads cannot be listed.
pub fn prioritize_grippers() {
    prioritize_threads("wsg-sim");
}

/// Gives real-time priority to the threads of this program with this name.
///
/// # Panics
/// Panics if the program's threads cannot be listed.
pub fn prioritize_threads(name: &str) {
    for task in fs::read_dir("/proc/self/task").expect("a list of threads").map_while(Result::ok) {
        if fs::read_to_string(task.path().join("comm")).is_ok_and(|comm| comm.trim_end() == name) {
            prioritize(&task.file_name().to_string_lossy());
        }
    }
}

/// Gives real-time priority to a thread, or to the first one of a process.
pub fn prioritize(thread: &str) {
    let _ = Command::new("chrt").args(["--fifo", "--pid", REAL_TIME, thread]).output();
}

/// Priority of `chrt`.
const REAL_TIME: &str = "20";

fn namespace(network: u16, end: End) -> String {
    let end = if end == End::Gripper { 'g' } else { 'c' };
    format!("wsg{}x{network}{end}", id())
}

fn run(program: &str, arguments: &str) {
    let output = Command::new(program).args(arguments.split(' ')).output();
    let output = output.unwrap_or_else(|error| panic!("`{program}` of Debian's iproute2: {error}"));
    assert!(output.status.success(), "{program} {arguments}: {}", printed(&output));
}
