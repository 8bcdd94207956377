//! The gripper in real time, shared by the tasks of its lines and the thread of its script.

mod client;
mod scripts;
mod settings;

pub(super) use crate::control::BusLine;
pub(super) use client::ClientHandle;
pub(super) use scripts::Run;
pub(super) use settings::{Changes, Refused, Running};

use super::lines::Profile;
use super::log::Log;
use super::options::Options;
use super::system_log::{Severity, SystemLog};
use crate::axis::Part;
use crate::config::Config;
use crate::control::{Bench, Gripper, Latency, Report};
use crate::faults::Fault;
use crate::port::{PortId, PortKind};
use crate::time::Time;
use anyhow::Result;
use fieldbus_host::Activity;
use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;
use tokio::time::{Duration, Instant, sleep_until};

/// Latency of a real gripper's command interface. Field reports: three requests in turn are answered 15 times a second.
/// The split between the two figures is assumed.
const REAL_LATENCY: Latency = Latency { delay_ms: 22, gap_ms: 5 };

/// The gripper, its clock, and the clients that wait for frames.
#[derive(Debug)]
pub(super) struct Hub {
    shared: Mutex<Shared>,
    started: Instant,
    /// Signals that the gripper's next wake may have changed.
    rescheduled: Notify,
    /// The options, if there are any; a server of another program has none.
    running: Option<Mutex<Running>>,
    /// Signals that a restart is requested.
    restart: Notify,
    system_log: SystemLog,
    /// Signals that a request for the script may have arrived, or that the gripper was switched off.
    script_waits: Condvar,
    /// Held by a call of the script, and by its stop: no call takes effect after the stop.
    script_gate: Mutex<()>,
}

/// The state protected by the lock. The servers run in one thread and rarely contend for it; a script runs in another thread.
#[derive(Debug)]
struct Shared {
    bench: Bench,
    /// What the tasks of the connected clients wait for.
    waits: BTreeMap<u64, Arc<Waits>>,
}

#[derive(Debug)]
struct Waits {
    id: PortId,
    frames: Notify,
    activity: Activity,
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
        // A new hasher is seeded from the system's random numbers.
        let run = RandomState::new().hash_one(0);
        let latency = if profile == Profile::Real { REAL_LATENCY } else { Latency::NONE };
        let bench = Bench::new(config, run, latency, seed, log, system_log.clone());
        Self {
            shared: Mutex::new(Shared { bench, waits: BTreeMap::new() }),
            started: Instant::now(),
            rescheduled: Notify::new(),
            running: options.map(|options| Mutex::new(Running::new(options))),
            restart: Notify::new(),
            system_log,
            script_waits: Condvar::new(),
            script_gate: Mutex::new(()),
        }
    }

    /// Returns a hub without log and options.
    #[cfg(test)]
    pub(super) fn of_test() -> Arc<Self> {
        let (config, log) = (Config::default(), SystemLog::new(String::new, None));
        Arc::new(Self::new(config, Profile::Instant, 0, None, log, None))
    }

    /// Powers the gripper off: ends the script at its next call and writes the rest of the log.
    pub(super) fn switch_off(&self) {
        self.set_off();
        let log = self.lock().bench.take_log();
        drop(log);
    }

    /// Ends the script at its next call. The log stays open.
    pub(super) fn set_off(&self) {
        self.lock().bench.is_off = true;
        self.script_waits.notify_all();
    }

    /// Returns what a restart takes over: the options and the logs. `None` without options.
    pub(super) fn end(&self) -> Option<(Running, Option<Log>, SystemLog)> {
        let running = lock(self.running.as_ref()?).clone();
        let log = self.lock().bench.take_log();
        Some((running, log, self.system_log.clone()))
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        lock(&self.shared)
    }

    /// Advances the gripper whenever an event is due.
    pub(super) async fn keep_time(self: Arc<Self>) -> Result<()> {
        loop {
            let wake = self.lock().bench.next_wake();
            tokio::select! {
                () = self.reached_if(wake) => {}
                () = self.rescheduled.notified() => {}
            }
            self.look(|_| ());
        }
    }

    /// Connects a client. Returns `None` if all places are taken and no client can be displaced.
    pub(super) fn connect(self: &Arc<Self>, kind: PortKind, peer: &str) -> Option<ClientHandle> {
        let client = self.at_bench(|bench, now| bench.connect(kind, peer, now))?;
        let waits = Waits { id: client.id, frames: Notify::new(), activity: Activity::default() };
        let waits = Arc::new(waits);
        self.lock().waits.insert(client.number, Arc::clone(&waits));
        Some(ClientHandle::new(Arc::clone(self), waits, client))
    }

    /// Returns the settings of the gripper.
    pub(super) fn config(&self) -> Config {
        *self.lock().bench.config()
    }

    pub(super) fn report(&self) -> Report {
        self.in_bench(Bench::report)
    }

    /// Sets the data of a bus. They replace earlier data of the same bus.
    pub(super) fn set_bus(&self, line: BusLine) {
        self.lock().bench.set_bus(line);
    }

    pub(super) fn set_part(&self, part: Option<Part>) {
        self.at_bench(|bench, now| bench.set_part(part, now));
    }

    pub(super) fn set_fault(&self, fault: Fault, on: bool) {
        self.at_bench(|bench, now| bench.set_fault(fault, on, now));
    }

    /// Calls `act` with the gripper. Use this if it may change the gripper's next wake-up.
    pub(super) fn act<T>(&self, act: impl FnOnce(&mut Gripper, Time) -> T) -> T {
        self.at_bench(|bench, now| bench.act(now, act))
    }

    /// Calls `act` with the gripper. It must not change the gripper's next wake-up.
    pub(super) fn look<T>(&self, look: impl FnOnce(&mut Gripper) -> T) -> T {
        self.in_bench(|bench, now| bench.look(now, look))
    }

    /// Writes an entry to the system log.
    pub(super) fn report_event(&self, severity: Severity, source: &str, text: &str) {
        self.system_log.write(self.now(), severity, source, text);
    }

    pub(super) fn note_of(&self, line: &str, what: std::fmt::Arguments<'_>) {
        self.lock().bench.note_of(self.now(), line, what);
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

    /// Calls `act` with the gripper and its clients. Use this if it may change the gripper's next wake-up.
    pub(super) fn at_bench<T>(&self, act: impl FnOnce(&mut Bench, Time) -> T) -> T {
        let result = self.in_bench(act);
        self.rescheduled.notify_one();
        result
    }

    /// Calls `act` with the gripper and its clients at the current time, and wakes the affected clients.
    fn in_bench<T>(&self, act: impl FnOnce(&mut Bench, Time) -> T) -> T {
        let mut shared = self.lock();
        let Shared { bench, waits } = &mut *shared;
        // Read under the lock, so that the gripper's time never runs backwards.
        let now = self.now();
        let result = act(bench, now);
        waits.retain(|number, client| {
            let is_connected = bench.is_connected(*number);
            if !is_connected {
                // Another client has its place.
                client.activity.displace();
            } else if bench.gripper().has_frame(client.id) {
                client.frames.notify_one();
            }
            is_connected
        });
        result
    }
}

/// Ignores a poisoned lock: a panic in another thread leaves the gripper usable.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::MAX_CLIENTS;
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
