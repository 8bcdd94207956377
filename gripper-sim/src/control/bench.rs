//! The gripper with its clients, logs and injected faults, in the time of its caller.

mod client;
mod editor;

pub(crate) use client::Client;
pub(crate) use editor::{FRAME_EXPECTED, FrameBody};

use super::executed::Executed;
use super::faulty_line::{Latency, LineCountsByDirection, LineFaults};
use super::history::History;
use super::json::members;
use super::latest_script::LatestScript;
use super::log::{Log, Watched};
use super::system_log::{Severity, SystemLog};
use crate::axis::Part;
use crate::config::Config;
use crate::faults::Fault;
use crate::fieldbus::Exchange;
use crate::gripper::{State, VirtualGripper};
use crate::journal::{Cause, JournalEvent};
use crate::port::{PortCounters, PortId, PortKind, Protocol};
use crate::time::{Time, earlier};
use editor::Editor;
use std::sync::Arc;
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::{Command, Number, Status, SystemFlags};

/// The maximum number of simultaneous clients.
#[cfg(not(target_family = "wasm"))]
pub(crate) const MAX_CLIENTS: usize = 128;
/// In a browser, the command editor is the only client, and the page of the station has the same type of gripper.
#[cfg(target_family = "wasm")]
pub(crate) const MAX_CLIENTS: usize = 1;

/// Source of entries of the system log: the page or a program at the control interface.
pub(crate) const PAGE: &str = "page";
/// Source of entries of the system log: a script on the gripper.
pub(crate) const SCRIPT: &str = "script";

/// The gripper of a bench.
pub(crate) type Gripper = VirtualGripper<MAX_CLIENTS>;

/// The gripper, its clients, and what observers and operators know of it.
#[derive(Debug)]
pub(crate) struct Bench {
    gripper: Box<Gripper>,
    /// A number that no earlier or later start of this or another gripper has.
    run: u64,
    pub(crate) is_off: bool,
    pub(crate) script: LatestScript,
    /// The clients in order of connection.
    clients: Vec<Connected>,
    connections: u64,
    log: Option<Log>,
    system_log: SystemLog,
    buses: Vec<BusLine>,
    line_faults: LineFaults,
    line_counts: LineCountsByDirection,
    /// The latency of the command interface.
    latency: Latency,
    seed: u64,
    faults: Vec<Fault>,
    /// The latest FAST STOP, or Stop of an operator.
    stopped_at: Time,
    settings_revision: u64,
    editor: Editor,
    pub(crate) history: History,
    pub(crate) executed: Executed,
}

#[derive(Debug)]
struct Connected {
    /// Its number in the order of connection.
    number: u64,
    id: PortId,
    kind: PortKind,
    /// Kind of line and peer, as shown in the log.
    name: Arc<str>,
    /// When it last sent something.
    received_at: Time,
}

/// A bus that carries the register interface.
#[derive(Clone, Debug, Default)]
pub(crate) struct BusLine {
    /// The bus: Modbus/TCP, PROFIBUS, PROFINET or EtherNet/IP.
    pub(crate) bus: &'static str,
    /// Where it is served: an address, a line or an interface.
    pub(crate) line: String,
    /// The gripper's address on the bus: station address or IP address.
    pub(crate) address: String,
    /// The bit rate of the line, or empty for a line that has none, such as TCP or a pseudo terminal.
    pub(crate) rate: String,
    /// The station name, if the bus has one.
    pub(crate) name: String,
}
members!(BusLine: bus, line, address, rate, name);

/// The state of gripper and lines, for observers.
#[derive(Debug)]
pub(crate) struct Report {
    pub(crate) now: Time,
    pub(crate) state: State,
    pub(crate) images: (OutputImage, InputImage),
    pub(crate) buses: Vec<BusLine>,
    pub(crate) exchange: Exchange,
    /// The master that wrote last, by name.
    pub(crate) master: Option<Arc<str>>,
    pub(crate) profibus_master: Option<u8>,
    /// The faults that have been injected.
    pub(crate) faults: Vec<Fault>,
    pub(crate) line_faults: LineFaults,
    pub(crate) line_counts: LineCountsByDirection,
    pub(crate) clients: Vec<(Arc<str>, PortCounters)>,
}

impl Bench {
    pub(crate) fn new(
        config: Config,
        run: u64,
        latency: Latency,
        seed: u64,
        log: Option<Log>,
        system_log: SystemLog,
    ) -> Self {
        Self {
            gripper: Box::new(VirtualGripper::with_ports(config)),
            run,
            is_off: false,
            script: LatestScript::default(),
            clients: Vec::new(),
            connections: 0,
            log,
            system_log,
            buses: Vec::new(),
            line_faults: LineFaults::default(),
            line_counts: LineCountsByDirection::default(),
            latency,
            seed,
            faults: Vec::new(),
            stopped_at: Time::ZERO,
            settings_revision: 0,
            editor: Editor::default(),
            history: History::default(),
            executed: Executed::default(),
        }
    }

    /// Takes the log, which the gripper no longer writes.
    pub(crate) fn take_log(&mut self) -> Option<Log> {
        self.log.take()
    }

    /// Returns when the gripper, or a frame on the line of the editor, needs the next call.
    pub(crate) fn next_wake(&self) -> Option<Time> {
        earlier(self.gripper.next_wake(), self.editor.next_arrival())
    }

    /// Connects a client. Returns `None` if all places are taken and no client can be displaced.
    pub(crate) fn connect(&mut self, kind: PortKind, peer: &str, now: Time) -> Option<Client> {
        let connect = |bench: &mut Self| {
            bench.act(now, |gripper, now| {
                gripper.advance(now);
                gripper.connect(kind)
            })
        };
        let id = connect(self).or_else(|| {
            self.displace(now)?;
            connect(self)
        })?;
        let name: Arc<str> = format!("{kind} {peer}").into();
        let number = self.connections;
        self.connections = number.wrapping_add(1);
        if let Some(log) = &mut self.log {
            log.connect(id, kind, Arc::clone(&name), self.gripper.config());
        }
        self.clients.push(Connected { number, id, kind, name: Arc::clone(&name), received_at: now });
        self.report_event(now, Severity::Info, &name, "connected");
        let has_latency = matches!(kind.protocol(), Protocol::Binary | Protocol::Text);
        let latency = if has_latency { self.latency } else { Latency::NONE };
        Some(Client::new(id, kind, number, name, self.seed, latency))
    }

    /// Disconnects the Modbus/TCP client that has been idle longest to free its place. Clients of other protocols stay,
    /// because the end of their connection may cause a FAST STOP.
    fn displace(&mut self, now: Time) -> Option<()> {
        let masters = self.clients.iter().filter(|client| client.kind == PortKind::ModbusTcp);
        let idle_longest = masters.min_by_key(|client| client.received_at)?;
        let (number, name) = (idle_longest.number, Arc::clone(&idle_longest.name));
        self.note_of(now, &name, format_args!("gives way to another client: idle longest"));
        self.disconnect(number, now);
        Some(())
    }

    /// Disconnects a client; does nothing if it is already disconnected.
    pub(crate) fn disconnect(&mut self, number: u64, now: Time) {
        let Some(client) = self.clients.iter().find(|client| client.number == number) else { return };
        let (id, name) = (client.id, Arc::clone(&client.name));
        let is_missed = self.gripper.is_missed(id);
        self.act(now, |gripper, now| gripper.disconnect(id, now));
        if let Some(log) = &mut self.log {
            log.disconnect(id);
        }
        self.clients.retain(|client| client.number != number);
        if !self.is_off {
            let (severity, how) = if is_missed {
                (Severity::Warning, "the connection ended without a Disconnect Announcement")
            } else {
                (Severity::Info, "disconnected")
            };
            self.report_event(now, severity, &name, how);
        }
    }

    pub(crate) fn is_connected(&self, number: u64) -> bool {
        self.clients.iter().any(|client| client.number == number)
    }

    /// Notes that a client has sent something.
    pub(crate) fn note_received(&mut self, number: u64, now: Time) {
        if let Some(client) = self.clients.iter_mut().find(|client| client.number == number) {
            client.received_at = now;
        }
    }

    /// Returns this client and its interface, or, after its end, the first client of the binary protocol and its interface.
    pub(crate) fn script_client(&self, id: Option<PortId>) -> Option<(PortId, String)> {
        let mut clients = self.clients.iter();
        let client = clients.clone().find(|client| Some(client.id) == id);
        let client = client.or_else(|| clients.find(|client| client.kind.is_binary()));
        client.map(|client| (client.id, client.kind.to_string()))
    }

    pub(crate) fn gripper(&self) -> &Gripper {
        &self.gripper
    }

    pub(crate) fn gripper_mut(&mut self) -> &mut Gripper {
        &mut self.gripper
    }

    /// Returns the settings of the gripper.
    pub(crate) fn config(&self) -> &Config {
        self.gripper.config()
    }

    /// Changes the settings of the gripper. Returns false while a motion runs whose settings would change.
    pub(crate) fn reconfigure(&mut self, config: &Config, now: Time) -> bool {
        if self.act(now, |gripper, now| gripper.reconfigure(config, now)) != Status::Success {
            return false;
        }
        if let Some(log) = &mut self.log {
            log.reconfigure(self.gripper.config());
        }
        self.settings_revision += 1;
        true
    }

    /// Returns a number that changes with the settings.
    pub(crate) fn settings_revision(&self) -> u64 {
        self.settings_revision
    }

    pub(crate) fn report(&mut self, now: Time) -> Report {
        let (now, state) = self.look(now, |gripper| (gripper.now(), gripper.state()));
        let Self { gripper, clients, faults, line_faults, line_counts, buses, .. } = self;
        let counters = |client: &Connected| Some((Arc::clone(&client.name), gripper.counters(client.id)?));
        let exchange = gripper.exchange();
        let is_master = |client: &&Connected| Some(client.id) == exchange.master;
        let master = clients.iter().find(is_master).map(|client| Arc::clone(&client.name));
        Report {
            now,
            state,
            images: gripper.fieldbus_images(),
            buses: buses.clone(),
            exchange,
            master,
            profibus_master: gripper.profibus_master(),
            faults: faults.clone(),
            line_faults: *line_faults,
            line_counts: *line_counts,
            clients: clients.iter().filter_map(counters).collect(),
        }
    }

    /// Adds a sample to the history.
    pub(crate) fn record(&mut self, now: Time) {
        let (now, state) = self.look(now, |gripper| (gripper.now(), gripper.state()));
        self.history.record(now, &state);
    }

    /// Sets the data of a bus. They replace earlier data of the same bus.
    pub(crate) fn set_bus(&mut self, line: BusLine) {
        self.buses.retain(|known| known.bus != line.bus);
        self.buses.push(line);
    }

    pub(crate) fn set_part(&mut self, part: Option<Part>, now: Time) {
        match part {
            Some(part) => self.note(
                now,
                format_args!("part {} mm, {} N/mm", Number(part.width()), Number(part.stiffness())),
            ),
            None => self.note(now, format_args!("no part")),
        }
        self.act(now, |gripper, now| gripper.set_part(part, now));
    }

    pub(crate) fn set_fault(&mut self, fault: Fault, on: bool, now: Time) {
        self.note(now, format_args!("fault {fault:?} {}", if on { "begins" } else { "ends" }));
        self.faults.retain(|other| *other != fault);
        if on {
            self.faults.push(fault);
        }
        let text = format!("fault {fault:?} {}", if on { "injected" } else { "removed" });
        self.report_event(now, Severity::Info, PAGE, &text);
        self.act(now, |gripper, now| gripper.set_fault(fault, on, now));
    }

    /// Executes a command of an operator, with a force limit of its own if it has one, and returns its first status.
    pub(crate) fn command(&mut self, force: Option<f32>, command: &Command<'_>, now: Time) -> Status {
        let status = self.act_by(PAGE, now, |gripper, now| match force {
            Some(force) => gripper.command_with_force(force, command, now),
            None => gripper.command(command, now),
        });
        if matches!(command, Command::Stop | Command::FastStop) {
            self.stopped_at = now;
        }
        match force {
            Some(force) => {
                self.note(now, format_args!("{command}, force limit {} N: {status}", Number(force)))
            }
            None => self.note(now, format_args!("{command}: {status}")),
        }
        status
    }

    /// Returns the number of this start of the gripper.
    pub(crate) const fn run(&self) -> u64 {
        self.run
    }

    /// Returns when the gripper was last stopped by a FAST STOP, or by a Stop of an operator.
    pub(crate) const fn stopped_at(&self) -> Time {
        self.stopped_at
    }

    /// Starts or stops keeping log lines for pages.
    pub(crate) fn watch_log(&mut self, on: bool) {
        if let Some(log) = &mut self.log {
            log.watch(on);
        }
    }

    /// Takes the log lines that pages have not received yet.
    pub(crate) fn take_watched(&mut self) -> Watched {
        self.log.as_mut().map(Log::take_watched).unwrap_or_default()
    }

    /// Sets the faults of every line from the next frame on.
    pub(crate) fn set_line_faults(&mut self, faults: LineFaults, now: Time) {
        self.note(now, format_args!("line faults: {faults}"));
        self.line_faults = faults;
    }

    /// Returns the system log.
    pub(crate) const fn system_log(&self) -> &SystemLog {
        &self.system_log
    }

    /// Writes an entry to the system log.
    pub(crate) fn report_event(&self, now: Time, severity: Severity, source: &str, text: &str) {
        self.system_log.write(now, severity, source, text);
    }

    fn note(&mut self, now: Time, what: std::fmt::Arguments<'_>) {
        self.note_of(now, "control", what);
    }

    pub(crate) fn note_of(&mut self, now: Time, line: &str, what: std::fmt::Arguments<'_>) {
        if let Some(log) = &mut self.log {
            log.note(now, line, what);
        }
    }

    /// Calls `look` with the gripper as it is now.
    pub(crate) fn look<T>(&mut self, now: Time, look: impl FnOnce(&mut Gripper) -> T) -> T {
        self.act(now, |gripper, now| {
            gripper.advance(now);
            look(gripper)
        })
    }

    /// Calls `act` with the gripper.
    pub(crate) fn act<T>(&mut self, now: Time, act: impl FnOnce(&mut Gripper, Time) -> T) -> T {
        self.act_by(SCRIPT, now, act)
    }

    /// The same, with the source that the system log names for commands without a client.
    fn act_by<T>(&mut self, operator: &str, now: Time, act: impl FnOnce(&mut Gripper, Time) -> T) -> T {
        let result = act(&mut self.gripper, now);
        self.follow(operator, now);
        result
    }

    /// Logs what a call of the gripper has changed, and passes on its frames to the editor.
    fn follow(&mut self, operator: &str, now: Time) {
        if let Some(log) = &mut self.log {
            log.expire(now);
        }
        while let Some(event) = self.gripper.take_journal_event().filter(|_| !self.is_off) {
            if event.flag == SystemFlags::FAST_STOP && event.is_set {
                self.stopped_at = now;
            }
            self.report_change(&event, operator);
        }
        if self.editor.is_connected() {
            // Taken out, so that it does not receive the events that it causes here.
            let mut editor = std::mem::take(&mut self.editor);
            editor.receive(self, now);
            self.editor = editor;
        }
    }

    /// Writes a change of the system state to the system log.
    fn report_change(&self, event: &JournalEvent, operator: &str) {
        let name = |id: PortId| {
            let client = self.clients.iter().find(|client| client.id == id);
            client.map_or_else(|| "a client that has left".to_owned(), |client| client.name.to_string())
        };
        let (source, reason) = match event.cause {
            Cause::Fault => ("gripper".to_owned(), " by a fault"),
            Cause::SoftLimit => ("gripper".to_owned(), " by fingers beyond a soft limit"),
            Cause::Client(id) => (name(id), " by command"),
            Cause::Disconnected(id) => (name(id), " by a lost connection"),
            Cause::Fieldbus(master) => {
                (master.map_or_else(|| "fieldbus".to_owned(), name), " by the register interface")
            }
            Cause::Operator => (operator.to_owned(), " by command"),
        };
        let name = event.flag.iter_names().next().map_or("", |(name, _)| name);
        let (severity, text) = match (event.flag, event.is_set) {
            (SystemFlags::FAST_STOP, true) if matches!(event.cause, Cause::Client(_) | Cause::Operator) => {
                (Severity::Warning, format!("FAST STOP{reason}"))
            }
            (SystemFlags::FAST_STOP, true) => (Severity::Error, format!("FAST STOP{reason}")),
            (SystemFlags::FAST_STOP, false) => (Severity::Info, format!("FAST STOP acknowledged{reason}")),
            (SystemFlags::OVERDRIVE_MODE, is_set) => {
                (Severity::Info, format!("overdrive mode {}", if is_set { "entered" } else { "left" }))
            }
            (SystemFlags::TEMP_WARNING, true) => (Severity::Warning, format!("{name} set")),
            (_, true) => (Severity::Error, format!("{name} set")),
            (_, false) => (Severity::Info, format!("{name} cleared")),
        };
        let is_about_device = !matches!(event.flag, SystemFlags::FAST_STOP | SystemFlags::OVERDRIVE_MODE);
        let source = if is_about_device { "gripper" } else { &source };
        self.system_log.write(event.at, severity, source, &text);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns a bench without a log, with this number of its start.
    pub(in crate::control) fn bench(run: u64) -> Bench {
        let system_log = SystemLog::new(String::new, None);
        Bench::new(Config::default(), run, Latency::NONE, 0, None, system_log)
    }
}
