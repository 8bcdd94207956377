//! The gripper in real time, shared by the tasks of its lines and the thread of its script.

use super::faulty_line::{Fate, FaultyLine, LineCounts, LineFaults, Pace, Passage};
use super::lines::Profile;
use super::log::{Log, Watched};
use super::request_line::RequestLine;
use crate::axis::Part;
use crate::config::Config;
use crate::faults::Fault;
use crate::gripper::{State, VirtualGripper};
use crate::port::{FrameBuffer, PortCounters, PortId, PortKind, Protocol};
#[cfg(feature = "script")]
use crate::script::ScriptRequest;
use crate::time::Time;
use anyhow::Result;
use std::cell::RefCell;
use std::collections::BTreeMap;
#[cfg(feature = "script")]
use std::sync::Condvar;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;
use tokio::time::{Duration, Instant, sleep_until};
use wsg_fieldbus::{InputImage, OutputImage};
#[cfg(all(feature = "profinet", target_os = "linux"))]
use wsg_protocol::SystemFlags;
use wsg_protocol::{Command, Status};

/// The maximum number of simultaneous clients of a server.
const MAX_CLIENTS: usize = 128;
/// Idle time-out of a Modbus/TCP connection. A master that loses power does not close its connection.
const IDLE_LIMIT: Duration = Duration::from_secs(300);

/// Latency of a real gripper's command interface. Field reports: three requests in turn are answered 15 times a second.
/// The split between the two figures is assumed.
const REAL_PACE: Pace = Pace { delay_ms: 22, gap_ms: 5 };

/// The gripper, its clock, and the clients that wait for frames.
#[derive(Debug)]
pub(super) struct Hub {
    shared: Mutex<Shared>,
    started: Instant,
    /// Signals that the gripper's next wake may have changed.
    rescheduled: Notify,
    config: Config,
    profile: Profile,
    seed: u64,
    /// Signals that a request for the script may have arrived, or that the gripper was switched off.
    #[cfg(feature = "script")]
    script_waits: Condvar,
}

/// The state protected by the lock. The servers run in one thread and rarely contend for it; a script runs in another thread.
#[derive(Debug)]
struct Shared {
    gripper: Box<VirtualGripper<MAX_CLIENTS>>,
    is_off: bool,
    /// The clients in order of connection.
    clients: BTreeMap<u64, Arc<Connected>>,
    connections: u64,
    log: Option<Log>,
    line_faults: LineFaults,
    request_counts: LineCounts,
    reply_counts: LineCounts,
    faults: Vec<Fault>,
}

#[derive(Debug)]
struct Connected {
    id: PortId,
    number: u64,
    kind: PortKind,
    /// Kind of line and peer, as shown in the log.
    name: Arc<str>,
    frames: Notify,
    heard_at: Mutex<Instant>,
    /// Signals that another client has taken the place of this one.
    displaced: Notify,
}

/// The state of gripper and lines, for observers.
#[derive(Debug)]
pub(super) struct Report {
    pub(super) now: Time,
    pub(super) state: State,
    pub(super) images: (OutputImage, InputImage),
    /// The faults that have been injected.
    pub(super) faults: Vec<Fault>,
    pub(super) line_faults: LineFaults,
    pub(super) request_counts: LineCounts,
    pub(super) reply_counts: LineCounts,
    pub(super) clients: Vec<(Arc<str>, PortCounters)>,
}

impl Hub {
    pub(super) fn new(config: Config, profile: Profile, seed: u64, log: Option<Log>) -> Self {
        Self {
            shared: Mutex::new(Shared {
                gripper: Box::new(VirtualGripper::with_ports(config)),
                is_off: false,
                clients: BTreeMap::new(),
                connections: 0,
                log,
                line_faults: LineFaults::default(),
                request_counts: LineCounts::default(),
                reply_counts: LineCounts::default(),
                faults: Vec::new(),
            }),
            started: Instant::now(),
            rescheduled: Notify::new(),
            config,
            profile,
            seed,
            #[cfg(feature = "script")]
            script_waits: Condvar::new(),
        }
    }

    /// Powers the gripper off: ends the script at its next call and writes the rest of the log.
    pub(super) fn switch_off(&self) {
        let mut shared = self.lock();
        shared.is_off = true;
        let log = shared.log.take();
        drop(shared);
        #[cfg(feature = "script")]
        self.script_waits.notify_all();
        drop(log);
    }

    #[cfg(feature = "script")]
    pub(super) fn is_off(&self) -> bool {
        self.lock().is_off
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        lock(&self.shared)
    }

    /// Advances the gripper whenever an event is due.
    pub(super) async fn keep_time(self: Arc<Self>) -> Result<()> {
        loop {
            let wake = self.lock().gripper.next_wake();
            let due = async {
                match wake {
                    Some(at) => self.reached(at).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                () = due => {}
                () = self.rescheduled.notified() => {}
            }
            self.with_gripper(|gripper, now| gripper.advance(now));
        }
    }

    /// Connects a client. Returns `None` if all places are taken and no client can be displaced.
    pub(super) fn connect(self: &Arc<Self>, kind: PortKind, peer: &str) -> Option<Client> {
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
        if let Some(log) = &mut shared.log {
            log.connect(id, kind, Arc::clone(&name), &self.config);
        }
        let connected = Arc::new(Connected {
            id,
            number,
            kind,
            name,
            frames: Notify::new(),
            heard_at: Mutex::new(Instant::now()),
            displaced: Notify::new(),
        });
        shared.clients.insert(number, Arc::clone(&connected));
        drop(shared);
        let is_paced =
            self.profile == Profile::Real && matches!(kind.protocol(), Protocol::Binary | Protocol::Text);
        let pace = if is_paced { REAL_PACE } else { Pace::NONE };
        let line = RefCell::new(FaultyLine::new(self.seed, number).paced(pace));
        let requests = RefCell::new(RequestLine::new(kind, self.seed, number));
        Some(Client { hub: Arc::clone(self), connected, line, requests })
    }

    /// Disconnects the Modbus/TCP client that has been idle longest to free its place. Clients of other protocols stay,
    /// because the end of their connection may cause a FAST STOP.
    fn displace(&self) -> Option<()> {
        let shared = self.lock();
        let masters = shared.clients.values().filter(|client| client.kind == PortKind::ModbusTcp);
        let idle_longest = Arc::clone(masters.min_by_key(|client| *lock(&client.heard_at))?);
        drop(shared);
        self.note_of(&idle_longest.name, format_args!("gives way to another client: idle longest"));
        self.disconnect(&idle_longest);
        idle_longest.displaced.notify_one();
        Some(())
    }

    /// Disconnects a client; does nothing if it is already disconnected.
    fn disconnect(&self, client: &Connected) {
        let mut shared = self.lock();
        shared.clients.remove(&client.number);
        if let Some(log) = &mut shared.log {
            log.disconnect(client.id);
        }
        drop(shared);
        self.act(|gripper, now| gripper.disconnect(client.id, now));
    }

    /// Returns the settings of the gripper.
    pub(super) const fn config(&self) -> &Config {
        &self.config
    }

    pub(super) fn report(&self) -> Report {
        let (now, state) = self.look(|gripper| (gripper.now(), gripper.state()));
        let shared = self.lock();
        let Shared { gripper, clients, faults, line_faults, request_counts, reply_counts, .. } = &*shared;
        let counters =
            |client: &Arc<Connected>| Some((Arc::clone(&client.name), gripper.counters(client.id)?));
        Report {
            now,
            state,
            images: gripper.fieldbus_images(),
            faults: faults.clone(),
            line_faults: *line_faults,
            request_counts: *request_counts,
            reply_counts: *reply_counts,
            clients: clients.values().filter_map(counters).collect(),
        }
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
        self.act(|gripper, now| gripper.set_fault(fault, on, now));
    }

    /// Executes a command of an operator and returns its first status.
    pub(super) fn command(&self, command: &Command<'_>) -> Status {
        let status = self.act(|gripper, now| gripper.command(command, now));
        self.note(format_args!("{command}: {status}"));
        status
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

    /// Returns the current inputs and the system state.
    #[cfg(all(feature = "profinet", target_os = "linux"))]
    pub(super) fn shown(&self) -> (InputImage, SystemFlags) {
        self.look(|gripper| (gripper.fieldbus_images().1, gripper.state().flags))
    }

    /// Calls `act` with the gripper. It must not change the gripper's next wake-up.
    pub(super) fn look<T>(&self, look: impl FnOnce(&mut VirtualGripper<MAX_CLIENTS>) -> T) -> T {
        self.with_gripper(|gripper, now| {
            gripper.advance(now);
            look(gripper)
        })
    }

    /// Blocks until there is a request for the script; `None` once the gripper is powered off.
    #[cfg(feature = "script")]
    pub(super) fn script_request(&self) -> Option<ScriptRequest> {
        let mut shared = self.lock();
        loop {
            if shared.is_off {
                return None;
            }
            if let Some(request) = shared.gripper.take_script_request() {
                return Some(request);
            }
            shared = self.script_waits.wait(shared).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Blocks for `duration`, or until the gripper is powered off.
    #[cfg(feature = "script")]
    pub(super) fn script_sleeps(&self, duration: Duration) {
        let is_on = |shared: &mut Shared| !shared.is_off;
        // Neither the guard nor the time-out flag is needed.
        drop(self.script_waits.wait_timeout_while(self.lock(), duration, is_on));
    }

    /// Returns the interface of the client, or, after its end, of the first client of the binary protocol.
    #[cfg(feature = "script")]
    pub(super) fn interface(&self, id: Option<PortId>) -> Option<String> {
        let shared = self.lock();
        let mut clients = shared.clients.values();
        let client = clients.clone().find(|client| Some(client.id) == id);
        let client = client.or_else(|| clients.find(|client| client.kind.is_binary()));
        client.map(|client| client.kind.to_string())
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

    /// Calls `act` with the gripper at the current time and wakes the affected clients.
    fn with_gripper<T>(&self, act: impl FnOnce(&mut VirtualGripper<MAX_CLIENTS>, Time) -> T) -> T {
        let mut shared = self.lock();
        let Shared { gripper, clients, log, .. } = &mut *shared;
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
        result
    }
}

/// Ignores a poisoned lock: a panic in another thread leaves the gripper usable.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A client of the gripper; dropping it disconnects the client.
#[derive(Debug)]
pub(super) struct Client {
    hub: Arc<Hub>,
    connected: Arc<Connected>,
    line: RefCell<FaultyLine>,
    requests: RefCell<RequestLine>,
}

impl Client {
    pub(super) fn receive(&self, bytes: &[u8]) {
        let Self { hub, requests, connected, .. } = self;
        *lock(&connected.heard_at) = Instant::now();
        let mut shared = hub.lock();
        let now = hub.now();
        let Shared { log, line_faults, request_counts, .. } = &mut *shared;
        if let Some(log) = log {
            log.received(connected.id, now, bytes);
        }
        let faults = line_faults.of_requests();
        let mut requests = requests.borrow_mut();
        if faults.are_none() && requests.is_empty() {
            drop(shared);
            return self.hear(bytes);
        }
        requests.take(&faults, now, bytes, |fate| {
            request_counts.count(fate);
            if !fate.is_harmless()
                && let Some(log) = log
            {
                log.note(now, &connected.name, format_args!("-> line fault: {fate}"));
            }
        });
    }

    /// Takes an output image written by the master.
    #[cfg(all(feature = "profinet", target_os = "linux"))]
    pub(super) fn write_image(&self, image: &OutputImage, is_first: bool) {
        *lock(&self.connected.heard_at) = Instant::now();
        self.hub.act(|gripper, now| gripper.write_image(self.connected.id, now, image, is_first));
    }

    /// Reports that the master that writes images has stopped or is silent.
    #[cfg(all(feature = "profinet", target_os = "linux"))]
    pub(super) fn end_images(&self) {
        self.hub.act(|gripper, now| gripper.end_images(self.connected.id, now));
    }

    /// Ends the subscriptions, because another sender uses the line now.
    pub(super) fn end_updates(&self) {
        self.hub.with_gripper(|gripper, now| gripper.end_updates(self.connected.id, now));
    }

    /// Ready when a request may reach the gripper over a faulty line.
    pub(super) async fn request_waits(&self) {
        let arrival = self.requests.borrow().next_arrival();
        match arrival {
            Some(at) => self.hub.reached(at).await,
            None => std::future::pending().await,
        }
    }

    /// Passes the next request that arrives over a faulty line to the gripper.
    pub(super) fn arrive(&self) {
        let arrived = self.requests.borrow_mut().arrive(self.hub.now());
        if let Some(bytes) = arrived {
            self.hear(&bytes);
        }
    }

    fn hear(&self, bytes: &[u8]) {
        self.hub.act(|gripper, now| gripper.receive(self.connected.id, now, bytes));
        #[cfg(feature = "script")]
        self.hub.script_waits.notify_all();
    }

    /// Returns whether the connection is over: synchronization is lost, and all frames for the client are sent.
    pub(super) fn is_over(&self) -> bool {
        let shared = self.hub.lock();
        shared.gripper.is_lost(self.connected.id)
            && !shared.gripper.has_frame(self.connected.id)
            && self.line.borrow().next_arrival().is_none()
    }

    /// Ready when a Modbus/TCP connection must be closed, because it is idle for too long or its place is needed. Never
    /// ready for other protocols.
    pub(super) async fn dismissed(&self) {
        let Connected { kind, name, heard_at, displaced, .. } = &*self.connected;
        if *kind != PortKind::ModbusTcp {
            return std::future::pending().await;
        }
        let heard_at = *lock(heard_at);
        tokio::select! {
            () = displaced.notified() => {}
            () = sleep_until(heard_at + IDLE_LIMIT) => {
                self.hub.note_of(name, format_args!("closed: idle for {} s", IDLE_LIMIT.as_secs()));
            }
        }
    }

    /// Returns whether there is room for answers: a slow line holds a bounded number of frames.
    pub(super) fn has_room(&self) -> bool {
        self.line.borrow().has_room()
    }

    /// Returns whether there is room for answers and requests.
    pub(super) fn takes_more(&self) -> bool {
        self.has_room() && self.requests.borrow().has_room()
    }

    /// Returns the next frame that arrives at this client.
    pub(super) fn transmit<'a>(&self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let len = self.next_frame(buffer)?;
        buffer.get(..len)
    }

    /// Ready when there may be a frame.
    pub(super) async fn frame_waits(&self) {
        let arrival = self.line.borrow().next_arrival();
        let arrived = async {
            match arrival {
                Some(at) => self.hub.reached(at).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = arrived => {}
            () = self.connected.frames.notified() => {}
        }
    }

    fn next_frame(&self, buffer: &mut FrameBuffer) -> Option<usize> {
        let Self { hub, line, .. } = self;
        let mut line = line.borrow_mut();
        while line.has_room() {
            let mut shared = hub.lock();
            let Shared { gripper, log, line_faults, reply_counts, .. } = &mut *shared;
            let Some(frame) = gripper.transmit(self.connected.id, buffer) else { break };
            let now = hub.now();
            let passage = line.pass(&line_faults.of_replies(), now, frame);
            let fate = match passage {
                Passage::Through => Fate::default(),
                Passage::Held(fate) => fate,
            };
            reply_counts.count(&fate);
            if let Some(log) = log {
                log.sent(now, self.connected.id, &self.connected.name, frame);
                if !fate.is_harmless() {
                    log.note(now, &self.connected.name, format_args!("<- line fault: {fate}"));
                }
            }
            if passage == Passage::Through {
                return Some(frame.len());
            }
        }
        let arrived = line.arrive(hub.now())?;
        let place = buffer.get_mut(..arrived.len())?;
        place.copy_from_slice(&arrived);
        Some(place.len())
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.hub.disconnect(&self.connected);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::advance;

    fn hub() -> Arc<Hub> {
        Arc::new(Hub::new(Config::default(), Profile::Instant, 0, None))
    }

    async fn is_dismissed(client: &Client) -> bool {
        tokio::select! {
            biased;
            () = client.dismissed() => true,
            () = std::future::ready(()) => false,
        }
    }

    #[tokio::test(start_paused = true)]
    async fn modbus_client_idle_longest_gives_way_when_all_places_are_taken() {
        let hub = hub();
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
        let hub = hub();
        let clients: Vec<_> =
            (0..MAX_CLIENTS).map(|_| hub.connect(PortKind::Tcp, "a client").unwrap()).collect();
        assert!(hub.connect(PortKind::ModbusTcp, "a newcomer").is_none());
        assert_eq!(hub.report().clients.len(), clients.len());
    }

    #[tokio::test(start_paused = true)]
    async fn modbus_client_is_dismissed_after_its_idle_time_and_others_are_not() {
        let hub = hub();
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
