//! The gripper in real time, shared by the tasks of its lines and the thread of its script.

mod client;
mod scripts;
mod settings;

pub(super) use client::ClientHandle;
pub(super) use scripts::{OutputLine, Run, ScriptReport};
pub(super) use settings::{Changes, Refused, Running, SettingState};

use super::faulty_line::{FaultyLine, Latency, LineCountsByDirection, LineFaults};
use super::lines::Profile;
use super::log::{Log, Watched};
use super::options::Options;
use super::request_line::RequestLine;
use super::system_log::{Severity, SystemLog};
use crate::axis::Part;
use crate::config::Config;
use crate::faults::Fault;
use crate::fieldbus::Exchange;
use crate::gripper::{State, VirtualGripper};
use crate::journal::{Cause, JournalEvent};
use crate::port::{PortCounters, PortId, PortKind, Protocol};
use crate::time::Time;
use anyhow::Result;
use fieldbus_host::Activity;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;
use tokio::time::{Duration, Instant, sleep_until};
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::{Command, Status, SystemFlags};

/// The maximum number of simultaneous clients of a server.
const MAX_CLIENTS: usize = 128;

/// Latency of a real gripper's command interface. Field reports: three requests in turn are answered 15 times a second.
/// The split between the two figures is assumed.
const REAL_LATENCY: Latency = Latency { delay_ms: 22, gap_ms: 5 };

/// Source of entries of the system log: the page or a program at the control interface.
pub(super) const PAGE: &str = "page";
/// Source of entries of the system log: a script on the gripper.
pub(super) const SCRIPT: &str = "script";

/// The gripper, its clock, and the clients that wait for frames.
#[derive(Debug)]
pub(super) struct Hub {
    shared: Mutex<Shared>,
    /// A number that no earlier or later start of this or another gripper has.
    run: u64,
    started: Instant,
    /// Signals that the gripper's next wake may have changed.
    rescheduled: Notify,
    /// The options, if there are any; a server of another program has none.
    running: Option<Mutex<Running>>,
    settings_revision: AtomicU64,
    /// Signals that a restart is requested.
    restart: Notify,
    buses: Mutex<Vec<BusLine>>,
    profile: Profile,
    seed: u64,
    system_log: SystemLog,
    /// Signals that a request for the script may have arrived, or that the gripper was switched off.
    script_waits: Condvar,
    /// Held by a call of the script, and by its stop: no call takes effect after the stop.
    script_gate: Mutex<()>,
}

/// The state protected by the lock. The servers run in one thread and rarely contend for it; a script runs in another thread.
#[derive(Debug)]
struct Shared {
    gripper: Box<VirtualGripper<MAX_CLIENTS>>,
    is_off: bool,
    script: scripts::LatestScript,
    /// The clients in order of connection.
    clients: BTreeMap<u64, Arc<Connected>>,
    connections: u64,
    log: Option<Log>,
    line_faults: LineFaults,
    line_counts: LineCountsByDirection,
    faults: Vec<Fault>,
    /// The latest FAST STOP, or Stop of an operator.
    stopped_at: Time,
}

#[derive(Debug)]
struct Connected {
    id: PortId,
    number: u64,
    kind: PortKind,
    /// Kind of line and peer, as shown in the log.
    name: Arc<str>,
    frames: Notify,
    activity: Activity,
}

/// A bus that carries the register interface.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub(super) struct BusLine {
    /// The bus: Modbus/TCP, PROFIBUS, PROFINET or EtherNet/IP.
    pub(super) bus: &'static str,
    /// Where it is served: an address, a line or an interface.
    pub(super) line: String,
    /// The gripper's address on the bus: station address or IP address.
    pub(super) address: String,
    /// The bit rate of the line, or empty for a line that has none, such as TCP or a pseudo terminal.
    pub(super) rate: String,
    /// The station name, if the bus has one.
    pub(super) name: String,
}

/// The state of gripper and lines, for observers.
#[derive(Debug)]
pub(super) struct Report {
    pub(super) now: Time,
    pub(super) state: State,
    pub(super) images: (OutputImage, InputImage),
    pub(super) buses: Vec<BusLine>,
    pub(super) exchange: Exchange,
    /// The master that wrote last, by name.
    pub(super) master: Option<Arc<str>>,
    pub(super) profibus_master: Option<u8>,
    /// The faults that have been injected.
    pub(super) faults: Vec<Fault>,
    pub(super) line_faults: LineFaults,
    pub(super) line_counts: LineCountsByDirection,
    pub(super) clients: Vec<(Arc<str>, PortCounters)>,
}

impl Hub {
    pub(super) fn new(
        config: Config,
        profile: Profile,
        seed: u64,
        log: Option<Log>,
        system_log: SystemLog,
        options: Option<&Options>,
    ) -> Self {
        Self {
            shared: Mutex::new(Shared {
                gripper: Box::new(VirtualGripper::with_ports(config)),
                is_off: false,
                script: scripts::LatestScript::default(),
                clients: BTreeMap::new(),
                connections: 0,
                log,
                line_faults: LineFaults::default(),
                line_counts: LineCountsByDirection::default(),
                faults: Vec::new(),
                stopped_at: Time::ZERO,
            }),
            // A new hasher is seeded from the system's random numbers.
            run: RandomState::new().hash_one(0),
            started: Instant::now(),
            rescheduled: Notify::new(),
            running: options.map(|options| Mutex::new(Running::new(options))),
            settings_revision: AtomicU64::new(0),
            restart: Notify::new(),
            buses: Mutex::default(),
            profile,
            seed,
            system_log,
            script_waits: Condvar::new(),
            script_gate: Mutex::new(()),
        }
    }

    /// Returns a hub without log and options.
    #[cfg(test)]
    pub(super) fn of_test() -> Arc<Self> {
        let (config, log) = (Config::default(), SystemLog::default());
        Arc::new(Self::new(config, Profile::Instant, 0, None, log, None))
    }

    /// Powers the gripper off: ends the script at its next call and writes the rest of the log.
    pub(super) fn switch_off(&self) {
        self.set_off();
        let log = self.lock().log.take();
        drop(log);
    }

    /// Ends the script at its next call. The log stays open.
    pub(super) fn set_off(&self) {
        self.lock().is_off = true;
        self.script_waits.notify_all();
    }

    /// Returns what a restart takes over: the options and the logs. `None` without options.
    pub(super) fn end(&self) -> Option<(Running, Option<Log>, SystemLog)> {
        let running = lock(self.running.as_ref()?).clone();
        let log = self.lock().log.take();
        Some((running, log, self.system_log.clone()))
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        lock(&self.shared)
    }

    /// Advances the gripper whenever an event is due.
    pub(super) async fn keep_time(self: Arc<Self>) -> Result<()> {
        loop {
            let wake = self.lock().gripper.next_wake();
            tokio::select! {
                () = self.reached_if(wake) => {}
                () = self.rescheduled.notified() => {}
            }
            self.with_gripper(|gripper, now| gripper.advance(now));
        }
    }

    /// Connects a client. Returns `None` if all places are taken and no client can be displaced.
    pub(super) fn connect(self: &Arc<Self>, kind: PortKind, peer: &str) -> Option<ClientHandle> {
        let connect = || {
            self.with_gripper(|gripper, now| {
                gripper.advance(now);
                gripper.connect(kind)
            })
        };
        let id = connect().or_else(|| {
            self.displace()?;
            connect()
        })?;
        let name: Arc<str> = format!("{kind} {peer}").into();
        let mut shared = self.lock();
        let number = shared.connections;
        shared.connections = number.wrapping_add(1);
        let shared_now = &mut *shared;
        if let Some(log) = &mut shared_now.log {
            log.connect(id, kind, Arc::clone(&name), shared_now.gripper.config());
        }
        let connected = Arc::new(Connected {
            id,
            number,
            kind,
            name,
            frames: Notify::new(),
            activity: Activity::default(),
        });
        shared.clients.insert(number, Arc::clone(&connected));
        drop(shared);
        self.report_event(Severity::Info, &connected.name, "connected");
        let has_latency =
            self.profile == Profile::Real && matches!(kind.protocol(), Protocol::Binary | Protocol::Text);
        let latency = if has_latency { REAL_LATENCY } else { Latency::NONE };
        let line = RefCell::new(FaultyLine::new(self.seed, number).with_latency(latency));
        let requests = RefCell::new(RequestLine::new(kind, self.seed, number));
        Some(ClientHandle::new(Arc::clone(self), connected, line, requests))
    }

    /// Disconnects the Modbus/TCP client that has been idle longest to free its place. Clients of other protocols stay,
    /// because the end of their connection may cause a FAST STOP.
    fn displace(&self) -> Option<()> {
        let shared = self.lock();
        let masters = shared.clients.values().filter(|client| client.kind == PortKind::ModbusTcp);
        let idle_longest = Arc::clone(masters.min_by_key(|client| client.activity.received_at())?);
        drop(shared);
        self.note_of(&idle_longest.name, format_args!("gives way to another client: idle longest"));
        self.disconnect(&idle_longest);
        idle_longest.activity.displace();
        Some(())
    }

    /// Disconnects a client; does nothing if it is already disconnected.
    fn disconnect(&self, client: &Connected) {
        let is_missed = self.lock().gripper.is_missed(client.id);
        self.act(|gripper, now| gripper.disconnect(client.id, now));
        let mut shared = self.lock();
        if let Some(log) = &mut shared.log {
            log.disconnect(client.id);
        }
        let is_first = shared.clients.remove(&client.number).is_some();
        let is_off = shared.is_off;
        drop(shared);
        if is_first && !is_off {
            let (severity, how) = if is_missed {
                (Severity::Warning, "the connection ended without a Disconnect Announcement")
            } else {
                (Severity::Info, "disconnected")
            };
            self.report_event(severity, &client.name, how);
        }
    }

    /// Returns the settings of the gripper.
    pub(super) fn config(&self) -> Config {
        *self.lock().gripper.config()
    }

    pub(super) fn report(&self) -> Report {
        let (now, state) = self.look(|gripper| (gripper.now(), gripper.state()));
        let shared = self.lock();
        let Shared { gripper, clients, faults, line_faults, line_counts, .. } = &*shared;
        let counters =
            |client: &Arc<Connected>| Some((Arc::clone(&client.name), gripper.counters(client.id)?));
        let exchange = gripper.exchange();
        let is_master = |client: &&Arc<Connected>| Some(client.id) == exchange.master;
        let master = clients.values().find(is_master).map(|client| Arc::clone(&client.name));
        Report {
            now,
            state,
            images: gripper.fieldbus_images(),
            buses: lock(&self.buses).clone(),
            exchange,
            master,
            profibus_master: gripper.profibus_master(),
            faults: faults.clone(),
            line_faults: *line_faults,
            line_counts: *line_counts,
            clients: clients.values().filter_map(counters).collect(),
        }
    }

    /// Sets the data of a bus. They replace earlier data of the same bus.
    pub(super) fn set_bus(&self, line: BusLine) {
        let mut buses = lock(&self.buses);
        buses.retain(|known| known.bus != line.bus);
        buses.push(line);
    }

    pub(super) fn set_part(&self, part: Option<Part>) {
        match part {
            Some(part) => self.note(format_args!("part {} mm, {} N/mm", part.width(), part.stiffness())),
            None => self.note(format_args!("no part")),
        }
        self.act(|gripper, now| gripper.set_part(part, now));
    }

    pub(super) fn set_fault(&self, fault: Fault, on: bool) {
        self.note(format_args!("fault {fault:?} {}", if on { "begins" } else { "ends" }));
        let mut shared = self.lock();
        shared.faults.retain(|other| *other != fault);
        if on {
            shared.faults.push(fault);
        }
        drop(shared);
        let text = format!("fault {fault:?} {}", if on { "injected" } else { "removed" });
        self.report_event(Severity::Info, PAGE, &text);
        self.act(|gripper, now| gripper.set_fault(fault, on, now));
    }

    /// Executes a command of an operator, with a force limit of its own if it has one, and returns its first status.
    pub(super) fn command(&self, force: Option<f32>, command: &Command<'_>) -> Status {
        let status = self.with_gripper_by(PAGE, |gripper, now| match force {
            Some(force) => gripper.command_with_force(force, command, now),
            None => gripper.command(command, now),
        });
        if matches!(command, Command::Stop | Command::FastStop) {
            self.lock().stopped_at = self.now();
        }
        self.rescheduled.notify_one();
        match force {
            Some(force) => self.note(format_args!("{command}, force limit {force} N: {status}")),
            None => self.note(format_args!("{command}: {status}")),
        }
        status
    }

    /// Returns the number of this start of the gripper.
    pub(super) const fn run(&self) -> u64 {
        self.run
    }

    /// Returns when the gripper was last stopped by a FAST STOP, or by a Stop of an operator.
    pub(super) fn stopped_at(&self) -> Time {
        self.lock().stopped_at
    }

    /// Starts or stops keeping log lines for pages.
    pub(super) fn watch_log(&self, on: bool) {
        if let Some(log) = &mut self.lock().log {
            log.watch(on);
        }
    }

    /// Takes the log lines that pages have not received yet.
    pub(super) fn take_watched(&self) -> Watched {
        self.lock().log.as_mut().map(Log::take_watched).unwrap_or_default()
    }

    /// Sets the faults of every line from the next frame on.
    pub(super) fn set_line_faults(&self, faults: LineFaults) {
        self.note(format_args!("line faults: {faults}"));
        self.lock().line_faults = faults;
    }

    /// Calls `act` with the gripper. Use this if it may change the gripper's next wake-up.
    pub(super) fn act<T>(&self, act: impl FnOnce(&mut VirtualGripper<MAX_CLIENTS>, Time) -> T) -> T {
        let result = self.with_gripper(act);
        self.rescheduled.notify_one();
        result
    }

    /// Calls `act` with the gripper. It must not change the gripper's next wake-up.
    pub(super) fn look<T>(&self, look: impl FnOnce(&mut VirtualGripper<MAX_CLIENTS>) -> T) -> T {
        self.with_gripper(|gripper, now| {
            gripper.advance(now);
            look(gripper)
        })
    }

    /// Returns the system log.
    pub(super) const fn system_log(&self) -> &SystemLog {
        &self.system_log
    }

    /// Writes an entry to the system log.
    pub(super) fn report_event(&self, severity: Severity, source: &str, text: &str) {
        self.system_log.write(self.now(), severity, source, text);
    }

    fn note(&self, what: std::fmt::Arguments<'_>) {
        self.note_of("control", what);
    }

    pub(super) fn note_of(&self, line: &str, what: std::fmt::Arguments<'_>) {
        if let Some(log) = &mut self.lock().log {
            log.note(self.now(), line, what);
        }
    }

    pub(super) fn now(&self) -> Time {
        Time::from_micros(u64::try_from(self.started.elapsed().as_micros()).unwrap_or(u64::MAX))
    }

    pub(super) async fn reached(&self, at: Time) {
        sleep_until(self.started + Duration::from_micros(at.as_micros())).await;
    }

    /// Ready at this time; never without one.
    async fn reached_if(&self, at: Option<Time>) {
        match at {
            Some(at) => self.reached(at).await,
            None => std::future::pending().await,
        }
    }

    /// Calls `act` with the gripper at the current time and wakes the affected clients.
    fn with_gripper<T>(&self, act: impl FnOnce(&mut VirtualGripper<MAX_CLIENTS>, Time) -> T) -> T {
        self.with_gripper_by(SCRIPT, act)
    }

    /// The same, with the source that the system log names for commands without a client.
    fn with_gripper_by<T>(
        &self,
        operator: &str,
        act: impl FnOnce(&mut VirtualGripper<MAX_CLIENTS>, Time) -> T,
    ) -> T {
        let mut shared = self.lock();
        let Shared { gripper, clients, log, is_off, stopped_at, .. } = &mut *shared;
        // Read under the lock, so that the gripper's time never runs backwards.
        let now = self.now();
        let result = act(gripper, now);
        for client in clients.values() {
            if gripper.has_frame(client.id) {
                client.frames.notify_one();
            }
        }
        if let Some(log) = log {
            log.expire(now);
        }
        while let Some(event) = gripper.take_journal_event().filter(|_| !*is_off) {
            if event.flag == SystemFlags::FAST_STOP && event.is_set {
                *stopped_at = now;
            }
            self.report_change(&event, operator, clients);
        }
        result
    }

    /// Writes a change of the system state to the system log.
    fn report_change(&self, event: &JournalEvent, operator: &str, clients: &BTreeMap<u64, Arc<Connected>>) {
        let name = |id: PortId| {
            let client = clients.values().find(|client| client.id == id);
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

/// Ignores a poisoned lock: a panic in another thread leaves the gripper usable.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fieldbus_host::{Client, IDLE_LIMIT};
    use tokio::time::advance;

    async fn is_dismissed(client: &ClientHandle) -> bool {
        tokio::select! {
            biased;
            () = client.dismissed() => true,
            () = std::future::ready(()) => false,
        }
    }

    #[tokio::test(start_paused = true)]
    async fn longest_idle_modbus_client_is_displaced_by_a_new_one() {
        let hub = Hub::of_test();
        let mut masters = vec![];
        for _ in 0..MAX_CLIENTS {
            advance(Duration::from_millis(1)).await;
            masters.push(hub.connect(PortKind::ModbusTcp, "a master").unwrap());
        }
        advance(Duration::from_millis(1)).await;
        // A partial request counts as activity.
        masters[0].receive(&[0]);

        let newcomers =
            [PortKind::ModbusTcp, PortKind::Tcp].map(|kind| hub.connect(kind, "a newcomer").unwrap());

        for (n, master) in masters.iter().enumerate() {
            assert_eq!(is_dismissed(master).await, (1..3).contains(&n), "{n}");
        }
        assert!(!is_dismissed(&newcomers[0]).await);
        assert_eq!(hub.report().clients.len(), MAX_CLIENTS);
        // Closing a displaced connection changes nothing.
        drop(masters.remove(1));
        assert_eq!(hub.report().clients.len(), MAX_CLIENTS);
    }

    #[tokio::test]
    async fn clients_of_other_protocols_do_not_give_way() {
        let hub = Hub::of_test();
        let clients: Vec<_> =
            (0..MAX_CLIENTS).map(|_| hub.connect(PortKind::Tcp, "a client").unwrap()).collect();
        assert!(hub.connect(PortKind::ModbusTcp, "a newcomer").is_none());
        assert_eq!(hub.report().clients.len(), clients.len());
    }

    #[tokio::test(start_paused = true)]
    async fn only_modbus_clients_are_dismissed_when_idle() {
        let hub = Hub::of_test();
        let (master, client) =
            (hub.connect(PortKind::ModbusTcp, "").unwrap(), hub.connect(PortKind::GclTcp, "").unwrap());
        let moment = Duration::from_millis(1);
        advance(IDLE_LIMIT - moment).await;
        assert!(!is_dismissed(&master).await);
        master.receive(&[0]);
        advance(IDLE_LIMIT - moment).await;
        assert!(!is_dismissed(&master).await, "it counts from the last byte");
        advance(moment).await;
        assert!(is_dismissed(&master).await);
        assert!(!is_dismissed(&client).await);
    }
}
