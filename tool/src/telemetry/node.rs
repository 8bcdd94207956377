//! The Sparkplug B edge node (chapter 5), without I/O: takes reports of devices and returns the messages to send.
//!
//! A connection begins with [`Node::connected`]. After that, [`Node::poll_transmit`] returns NBIRTH, the births of the devices,
//! stored samples, and new data. A sample older than its device's birth is sent as historical.

use std::{collections::VecDeque, rc::Rc};

use prost::Message as _;

use super::{
    command::{Order, Orders, Situation},
    metrics::{COMMANDS, GATEWAY, GRIPPER, Metric, NODE, OfCommand, OfNode, Value},
    payload::{self, DataType, MetricValue, Payload, PropertySet},
    report::{Report, What},
    store::{Entry, Store},
};

/// Number of aliases per device. An alias is this times the device number, counted from 1, plus the index in its table. Lower
/// aliases belong to the node.
const ALIASES: u64 = 64;
const _: () = assert!(GRIPPER.len() + COMMANDS.len() < ALIASES as usize && NODE.len() < ALIASES as usize);
const _: () = assert!(GATEWAY.len() < ALIASES as usize);

/// Shortest interval between two messages with the node's own values, in ms.
const NODE_PERIOD_MS: u64 = 1_000;

const BD_SEQ: &str = "bdSeq";
const REBIRTH: &str = "Node Control/Rebirth";

/// A message for the broker, QoS 0 and not retained.
#[derive(Debug, PartialEq)]
pub(super) struct Message {
    pub(super) topic: Rc<str>,
    pub(super) payload: Vec<u8>,
}

/// Group and name of the edge node.
#[derive(Clone, Debug)]
pub(super) struct Identity {
    group: String,
    name: String,
}

#[derive(Debug)]
pub(super) struct Node {
    identity: Identity,
    devices: Vec<Device>,
    store: Store,
    session: Option<Session>,
    own: Own,
}

#[derive(Debug)]
struct Device {
    table: &'static [Metric],
    /// Command state of a device that accepts commands. Its command metrics follow the metrics of the table.
    commanding: Option<Commanding>,
    /// Topic of its commands (DCMD).
    command: Rc<str>,
    birth: Rc<str>,
    data: Rc<str>,
    death: Rc<str>,
    is_online: bool,
    /// Latest value of each metric; empty until the device is first found.
    values: Vec<Option<Value>>,
    ranges: Vec<Option<(f32, f32)>>,
    /// Time of its birth on this connection in ms, unless a death has followed.
    born_at: Option<u64>,
}

/// The command state of a device.
#[derive(Debug)]
struct Commanding {
    orders: Orders,
    age_ms: u64,
    /// Latest timestamp of any command, accepted or refused, so that a repeated command is always refused.
    last_at: u64,
    /// Whether an accepted motion has no outcome yet.
    is_moving: bool,
    /// Number of times the device was found.
    life: u64,
}

impl Device {
    fn rows(&self) -> impl Iterator<Item = &'static Metric> + use<> {
        let commands = self.commanding.as_ref().map_or(&[][..], |_| COMMANDS);
        self.table.iter().chain(commands)
    }

    /// Makes the values unknown, so that no later birth shows them as current. The result of the last command is no value of
    /// the device and remains.
    fn forget_values(&mut self) {
        for value in self.values.iter_mut().take(self.table.len()) {
            *value = None;
        }
    }

    /// Returns the index of a row of [`COMMANDS`] in the metrics of the device.
    fn place_of(&self, row: OfCommand) -> usize {
        self.table.len() + usize::from(row)
    }
}

/// State of a connection to the broker.
#[derive(Debug)]
struct Session {
    bd_seq: u8,
    seq: u8,
    births: VecDeque<Birth>,
    /// End of the store entries that precede the connection.
    history_end: u64,
    /// Offline devices whose birth is sent only for their history.
    ghosts: Vec<u16>,
    own_sent_at: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Birth {
    Node,
    Device(u16),
}

/// The node's own values.
#[derive(Debug, Default)]
struct Own {
    late: u64,
    connections: u64,
    refused: u64,
    /// The values last sent.
    sent: Vec<Option<Value>>,
}

impl Identity {
    fn topic(&self, kind: &str) -> String {
        let Self { group, name } = self;
        format!("spBv1.0/{group}/{kind}/{name}")
    }

    /// Returns the topics on which hosts send commands.
    pub(super) fn command_topics(&self) -> [String; 2] {
        [self.topic("NCMD"), format!("{}/#", self.topic("DCMD"))]
    }

    /// Builds the NDEATH of a connection. It serves as the will, and as the last message of an orderly exit.
    pub(super) fn death(&self, bd_seq: u8, now: u64) -> Message {
        let payload = Payload { timestamp: Some(now), metrics: vec![bd_seq_metric(bd_seq, None)], seq: None };
        Message { topic: self.topic("NDEATH").into(), payload: payload.encode_to_vec() }
    }
}

impl Node {
    /// Creates an edge node with these devices and a store for `capacity` samples.
    pub(super) fn new(
        group: &str,
        name: &str,
        devices: &[(String, &'static [Metric])],
        capacity: usize,
    ) -> Self {
        let identity = Identity { group: group.to_owned(), name: name.to_owned() };
        let topic = |kind: &str, device: &str| format!("{}/{device}", identity.topic(kind)).into();
        let device = |(device, table): &(String, &'static [Metric])| Device {
            table,
            commanding: None,
            command: topic("DCMD", device),
            birth: topic("DBIRTH", device),
            data: topic("DDATA", device),
            death: topic("DDEATH", device),
            is_online: false,
            values: Vec::new(),
            ranges: Vec::new(),
            born_at: None,
        };
        let devices = devices.iter().map(device).collect();
        Self { identity, devices, store: Store::new(capacity), session: None, own: Own::default() }
    }

    /// Lets hosts command a device. Commands with a timestamp up to `now` are refused, so that a restart of the program never
    /// repeats one.
    pub(super) fn allow_commands(&mut self, device: u16, orders: Orders, age_ms: u64, now: u64) {
        if let Some(device) = self.devices.get_mut(usize::from(device)) {
            let commanding = Commanding { orders, age_ms, last_at: now, is_moving: false, life: 0 };
            device.commanding = Some(commanding);
        }
    }

    /// Returns group and name of the node.
    pub(super) const fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Processes a report of a device.
    pub(super) fn take(&mut self, report: Report) {
        let Report { device: number, at, what } = report;
        let Some(device) = self.devices.get_mut(usize::from(number)) else { return };
        let life = match what {
            What::Found { mut values, ranges } => {
                device.is_online = true;
                let result = device.place_of(OfCommand::Result);
                if let Some(commanding) = &mut device.commanding {
                    commanding.life += 1;
                    if let (Some(new), Some(old)) = (values.get_mut(result), device.values.get(result)) {
                        new.clone_from(old);
                    }
                }
                device.values = values;
                device.ranges = ranges;
                Entry::Found { device: number }
            }
            What::Changed(values) => {
                for (place, value) in &values {
                    if let Some(slot) = device.values.get_mut(usize::from(*place)) {
                        slot.clone_from(value);
                    }
                }
                self.store.push(Entry::Sample { device: number, at, values });
                return;
            }
            What::Outcome { of, text } => {
                if let Some(commanding) = &mut device.commanding {
                    commanding.is_moving &= !of.is_motion();
                }
                self.report_result(number, text, at);
                return;
            }
            What::Lost => {
                device.is_online = false;
                device.forget_values();
                Entry::Lost { device: number }
            }
        };
        if self.session.is_some() {
            self.store.push(life);
        }
    }

    /// Starts a session: the broker has accepted the connection with this `bdSeq`.
    pub(super) fn connected(&mut self, bd_seq: u8) {
        self.own.connections += 1;
        let mut with_history: Vec<u16> = self.store.devices().collect();
        with_history.sort_unstable();
        with_history.dedup();
        let is_ghost =
            |number: &u16| self.devices.get(usize::from(*number)).is_some_and(|device| !device.is_online);
        let ghosts: Vec<u16> = with_history.into_iter().filter(is_ghost).collect();
        let history_end = self.store.mark() + self.store.waiting() as u64;
        self.session =
            Some(Session { bd_seq, seq: 0, births: VecDeque::new(), history_end, ghosts, own_sent_at: 0 });
        self.rebirth();
    }

    /// Ends the session: the connection was lost.
    pub(super) fn disconnected(&mut self) {
        self.session = None;
        self.store.rewind();
    }

    /// Schedules all births, as after a new connection.
    fn rebirth(&mut self) {
        let Self { devices, session: Some(session), .. } = self else { return };
        session.births.clear();
        session.births.push_back(Birth::Node);
        for (number, device) in (0_u16..).zip(devices) {
            device.born_at = None;
            if device.is_online || session.ghosts.contains(&number) {
                session.births.push_back(Birth::Device(number));
            }
        }
    }

    /// Returns the next message to send, or `None` without a message or a connection.
    pub(super) fn poll_transmit(&mut self, now: u64) -> Option<Message> {
        let session = self.session.as_mut()?;
        if let Some(birth) = session.births.pop_front() {
            return Some(match birth {
                Birth::Node => self.node_birth(now),
                Birth::Device(number) => self.device_birth(number, now),
            });
        }
        if self.store.mark() >= session.history_end
            && let Some(ghost) = session.ghosts.pop()
            && self.devices.get(usize::from(ghost)).is_some_and(|device| !device.is_online)
        {
            return Some(self.device_death(ghost, now));
        }
        self.next_stored(now).or_else(|| self.own_data(now))
    }

    /// Returns the message for the next store entry.
    fn next_stored(&mut self, now: u64) -> Option<Message> {
        loop {
            match self.store.send()? {
                Entry::Found { device } => {
                    let device = *device;
                    return Some(self.device_birth(device, now));
                }
                Entry::Lost { device } => {
                    let device = *device;
                    return Some(self.device_death(device, now));
                }
                Entry::Sample { device: number, at, values } => {
                    let (number, at) = (*number, *at);
                    let Some(device) = self.devices.get(usize::from(number)) else { continue };
                    let is_historical = device.born_at.is_none_or(|born| at < born);
                    let metrics = values.iter().map(|(place, value)| payload::Metric {
                        alias: Some(alias(number, usize::from(*place))),
                        timestamp: Some(at),
                        datatype: device.rows().nth(usize::from(*place)).map(Metric::datatype),
                        is_historical: is_historical.then_some(true),
                        is_null: value.is_none().then_some(true),
                        value: value.as_ref().map(Value::encode),
                        ..payload::Metric::default()
                    });
                    let metrics = metrics.collect();
                    let topic = Rc::clone(&device.data);
                    self.own.late += u64::from(is_historical);
                    return Some(self.message(topic, metrics, now));
                }
            }
        }
    }

    fn node_birth(&mut self, now: u64) -> Message {
        let own = self.own_values();
        let mut metrics = Vec::new();
        if let Some(session) = &mut self.session {
            session.seq = 0;
            session.own_sent_at = now;
            metrics.push(bd_seq_metric(session.bd_seq, Some(now)));
        }
        metrics.push(payload::Metric {
            name: Some(REBIRTH.to_owned()),
            timestamp: Some(now),
            datatype: Some(DataType::Boolean as u32),
            value: Some(MetricValue::Boolean(false)),
            ..payload::Metric::default()
        });
        metrics.extend(NODE.iter().enumerate().map(|(place, metric)| {
            let value = own.get(place).and_then(Option::as_ref);
            birth_metric(metric, place as u64, value, None, now)
        }));
        self.own.sent = own;
        let topic = self.identity.topic("NBIRTH").into();
        self.message(topic, metrics, now)
    }

    fn device_birth(&mut self, number: u16, now: u64) -> Message {
        let Some(device) = self.devices.get_mut(usize::from(number)) else {
            return self.message("".into(), Vec::new(), now);
        };
        device.born_at = Some(now);
        let metrics = device.rows().enumerate().map(|(place, metric)| {
            let value = device.values.get(place).and_then(Option::as_ref);
            let range = device.ranges.get(place).copied().flatten();
            birth_metric(metric, alias(number, place), value, range, now)
        });
        let metrics = metrics.collect();
        let topic = Rc::clone(&device.birth);
        self.message(topic, metrics, now)
    }

    fn device_death(&mut self, number: u16, now: u64) -> Message {
        let Some(device) = self.devices.get_mut(usize::from(number)) else {
            return self.message("".into(), Vec::new(), now);
        };
        device.born_at = None;
        let topic = Rc::clone(&device.death);
        self.message(topic, Vec::new(), now)
    }

    /// Returns NDATA with the changed values of the node, if one is due.
    fn own_data(&mut self, now: u64) -> Option<Message> {
        let session = self.session.as_mut()?;
        if now.abs_diff(session.own_sent_at) < NODE_PERIOD_MS {
            return None;
        }
        session.own_sent_at = now;
        let own = self.own_values();
        let changed =
            NODE.iter().enumerate().filter(|(place, _)| own.get(*place) != self.own.sent.get(*place));
        let metrics: Vec<payload::Metric> = changed
            .map(|(place, metric)| payload::Metric {
                alias: Some(place as u64),
                timestamp: Some(now),
                datatype: Some(metric.datatype()),
                value: own.get(place).and_then(Option::as_ref).map(Value::encode),
                ..payload::Metric::default()
            })
            .collect();
        self.own.sent = own;
        let topic = self.identity.topic("NDATA").into();
        (!metrics.is_empty()).then(|| self.message(topic, metrics, now))
    }

    fn own_values(&self) -> Vec<Option<Value>> {
        let online = self.devices.iter().filter(|device| device.is_online).count() as u64;
        let mut values = vec![None; NODE.len()];
        for (of, number) in [
            (OfNode::Online, online),
            (OfNode::Waiting, self.store.waiting() as u64),
            (OfNode::Dropped, self.store.dropped()),
            (OfNode::Late, self.own.late),
            (OfNode::Connections, self.own.connections),
            (OfNode::Refused, self.own.refused),
        ] {
            if let Some(slot) = values.get_mut(of as usize) {
                *slot = Some(Value::Unsigned(number));
            }
        }
        values
    }

    fn message(&mut self, topic: Rc<str>, metrics: Vec<payload::Metric>, now: u64) -> Message {
        let seq = self.session.as_mut().map(|session| {
            let seq = session.seq;
            session.seq = seq.wrapping_add(1);
            u64::from(seq)
        });
        let payload = Payload { timestamp: Some(now), metrics, seq };
        Message { topic, payload: payload.encode_to_vec() }
    }

    /// Processes a command of a host: a rebirth of the node, or a command to a device that allows it. Returns its name.
    ///
    /// # Errors
    /// The command is refused. The message states why.
    pub(super) fn command(
        &mut self,
        topic: &str,
        payload: &[u8],
        is_retained: bool,
        now: u64,
    ) -> Result<String, String> {
        let outcome = match Payload::decode(payload) {
            Err(_) => Err("it is not a Sparkplug B payload".to_owned()),
            Ok(payload) if self.identity.topic("NCMD") == topic => {
                rebirth_request(&payload).map(|()| "rebirth".to_owned())
            }
            Ok(payload) => self.device_command(topic, &payload, is_retained, now),
        };
        match &outcome {
            Ok(_) if self.identity.topic("NCMD") == topic => self.rebirth(),
            Ok(_) => {}
            Err(why) => {
                self.own.refused += 1;
                let of = self.devices.iter().position(|device| *device.command == *topic);
                if let Some(number) = of.and_then(|place| u16::try_from(place).ok()) {
                    self.report_result(number, format!("refused: {why}"), now);
                }
            }
        }
        outcome
    }

    fn device_command(
        &mut self,
        topic: &str,
        payload: &Payload,
        is_retained: bool,
        now: u64,
    ) -> Result<String, String> {
        let of = (0_u16..).zip(&mut self.devices).find(|(_, device)| *device.command == *topic);
        let Some((number, device)) = of else { return Err("unknown device".to_owned()) };
        let (first, is_online) = (device.table.len(), device.is_online);
        let Some(commanding) = &mut device.commanding else {
            return Err("this device accepts no commands: allow_commands is not set".to_owned());
        };
        let situation = Situation {
            now,
            age_ms: commanding.age_ms,
            last_at: commanding.last_at,
            is_online,
            is_moving: commanding.is_moving,
            ranges: device.ranges.get(first..).unwrap_or(&[]),
            first_alias: alias(number, first),
        };
        let at = situation.time_of(payload)?;
        commanding.last_at = at;
        if is_retained {
            return Err("it is retained: the broker stored it, so it may be outdated".to_owned());
        }
        let action = situation.decide(payload)?;
        let expires_at = at.min(now) + commanding.age_ms;
        if !commanding.orders.push(Order { action, at, expires_at, life: commanding.life }) {
            return Err("too many commands are waiting".to_owned());
        }
        commanding.is_moving |= action.of().is_motion();
        Ok(action.of().title().to_owned())
    }

    /// Publishes the result of a command to a device, even if it equals the previous one.
    fn report_result(&mut self, number: u16, text: String, at: u64) {
        let Some(device) = self.devices.get_mut(usize::from(number)) else { return };
        let place = device.place_of(OfCommand::Result);
        // The slot does not exist if commands are not allowed, or before the device is first found.
        let Some(slot) = device.values.get_mut(place).filter(|_| device.commanding.is_some()) else { return };
        let value = Some(Value::Text(text));
        slot.clone_from(&value);
        if device.is_online
            && let Ok(place) = u8::try_from(place)
        {
            self.store.push(Entry::Sample { device: number, at, values: vec![(place, value)] });
        }
    }

    /// Returns the position to pass to [`confirm`](Self::confirm) once the broker has received all messages so far.
    pub(super) fn mark(&self) -> u64 {
        self.store.mark()
    }

    /// Returns whether some messages are still unconfirmed.
    pub(super) const fn is_unconfirmed(&self) -> bool {
        self.store.is_unconfirmed()
    }

    /// Confirms the messages before a position returned by [`mark`](Self::mark).
    pub(super) fn confirm(&mut self, mark: u64) {
        self.store.confirm(mark);
    }
}

fn rebirth_request(payload: &Payload) -> Result<(), String> {
    let is_rebirth = |metric: &payload::Metric| {
        metric.name.as_deref() == Some(REBIRTH) && metric.value == Some(MetricValue::Boolean(true))
    };
    match payload.metrics.iter().find(|metric| !is_rebirth(metric)) {
        None if payload.metrics.is_empty() => Err("it contains no metric".to_owned()),
        None => Ok(()),
        Some(other) => Err(format!(
            "only \"{REBIRTH}\" = true is accepted, not {:?}",
            other.name.as_deref().unwrap_or("a metric without a name")
        )),
    }
}

const fn alias(device: u16, place: usize) -> u64 {
    (device as u64 + 1) * ALIASES + place as u64
}

fn bd_seq_metric(number: u8, at: Option<u64>) -> payload::Metric {
    payload::Metric {
        name: Some(BD_SEQ.to_owned()),
        timestamp: at,
        datatype: Some(DataType::Int64 as u32),
        value: Some(MetricValue::Long(number.into())),
        ..payload::Metric::default()
    }
}

fn birth_metric(
    metric: &Metric,
    alias: u64,
    value: Option<&Value>,
    range: Option<(f32, f32)>,
    now: u64,
) -> payload::Metric {
    payload::Metric {
        name: Some(metric.name.to_owned()),
        alias: Some(alias),
        timestamp: Some(now),
        datatype: Some(metric.datatype()),
        is_null: value.is_none().then_some(true),
        properties: (!metric.unit.is_empty()).then(|| PropertySet::of_unit(metric.unit, range)),
        value: value.map(Value::encode),
        is_historical: None,
    }
}

#[cfg(test)]
mod tests;
