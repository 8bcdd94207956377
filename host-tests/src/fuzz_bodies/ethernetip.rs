//! The EtherNet/IP adapter with TCP connections of two stations: requests and packets, intact and damaged, and a model of
//! the open connections.

use std::net::{Ipv4Addr, SocketAddrV4};

use bus_ethernetip::{Cause, Client, Event, MAX_FRAME_LEN, Network, Profile, Receiver, State, Transmit};
use wsg_fieldbus::ethernetip::{self, Device};
use wsg_fieldbus::{InputImage, OutputImage};

use super::input::Input;

/// A vendor, so that keys can be wrong.
const PROFILE: Profile = Profile { vendor_id: 1, min_interval_us: 1_000, ..ethernetip::PROFILE };

const NETWORK: Network = Network {
    address: Ipv4Addr::new(10, 0, 0, 9),
    mask: Ipv4Addr::new(255, 0, 0, 0),
    gateway: Ipv4Addr::UNSPECIFIED,
    mac: [2, 0, 0, 0, 0, 9],
    speed: 100,
};
/// The adapter's group: host 9 of its network.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 192, 2, 0);
const STATIONS: [Ipv4Addr; 2] = [Ipv4Addr::new(10, 0, 0, 1), Ipv4Addr::new(10, 0, 0, 2)];
/// Number of TCP connections in the model: the even ones are of the first station.
const CLIENTS: usize = 4;
/// TCP connection that receives noise; not in the model.
const NOISY: Client = Client { number: 0, address: STATIONS[0] };
const INACTIVITY_US: u64 = 120_000_000;
/// Maximum number of datagrams at a time: one for each connection with cyclic data, and the delayed answers.
const MAX_AT_ONCE: usize = 8 + 4;
const MANAGER: [u8; 5] = [2, 0x20, 6, 0x24, 1];

/// Explicit messages: reads, writes to assemblies, and a reset.
const MESSAGES: [&[u8]; 8] = [
    &[0x0E, 3, 0x20, 1, 0x24, 1, 0x30, 5],
    &[0x01, 2, 0x20, 0xF5, 0x24, 1],
    &[0x0E, 3, 0x20, 4, 0x24, 150, 0x30, 3],
    &[0x10, 3, 0x20, 4, 0x24, 150, 0x30, 3, 1, 1, 1, 1, 1, 1, 1, 1],
    &[0x10, 3, 0x20, 4, 0x24, 152, 0x30, 3, 1],
    &[0x52, 2, 0x20, 6, 0x24, 1, 10, 14, 8, 0, 0x0E, 3, 0x20, 1, 0x24, 1, 0x30, 7, 1, 0, 1, 0],
    &[0x0E, 8, 0x34, 4, 1, 0, 0x2B, 0, 1, 0, 1, 1, 0x20, 1, 0x24, 1, 0x30, 1],
    &[0x05, 2, 0x20, 1, 0x24, 1],
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Owner,
    InputOnly,
    ListenOnly,
    Explicit,
}

/// An open connection.
struct Link {
    kind: Kind,
    client: Client,
    triad: [u8; 8],
    /// Identifiers of packets to the adapter and to the originator.
    ids: [[u8; 4]; 2],
    /// Length of the data in packets to the adapter.
    size: u16,
    timeout_us: u64,
    until: u64,
    sequence: Option<u32>,
    count: Option<[u8; 2]>,
    /// Whether its packets to the originator are for a group.
    is_multicast: bool,
    interval_us: u64,
    /// Time of the next packet to the originator.
    due: u64,
}

/// A TCP connection, its session, and the time of its last frame.
#[derive(Clone, Copy)]
struct Tcp {
    client: Client,
    session: Option<[u8; 4]>,
    received: u64,
}

struct World {
    device: Device,
    receiver: Receiver,
    now: u64,
    tcp: [Tcp; CLIENTS],
    links: Vec<Link>,
    state: State,
    outputs: [u8; OutputImage::LEN],
    /// Events that the model expects, except `Reset` and `Close`.
    expected: Vec<Event>,
    packets_dropped: u32,
    /// Number of delayed answers that may be sent.
    answers: usize,
}

/// Each op is a byte with parameter bytes.
pub fn ethernetip(data: &[u8]) {
    let mut input = Input::new(data);
    let mut world = World::new();
    while !input.is_empty() {
        world.happen(&mut input);
        world.settle();
    }
}

impl World {
    fn new() -> Self {
        let tcp = std::array::from_fn(|at| Tcp {
            client: Client { number: 1 + at as u32, address: STATIONS[at % 2] },
            session: None,
            received: 0,
        });
        Self {
            device: Device::new(PROFILE, NETWORK, 1),
            receiver: Receiver::new(),
            now: 0,
            tcp,
            links: vec![],
            state: State::Unowned,
            outputs: [0; OutputImage::LEN],
            expected: vec![],
            packets_dropped: 0,
            answers: 0,
        }
    }

    fn happen(&mut self, input: &mut Input<'_>) {
        match input.byte() % 12 {
            0 => {
                let unit = input.pick(&[1_000, 10_000, 1_000_000]);
                self.now += unit * u64::from(input.byte());
                self.expire();
            }
            1 => self.register(who(input)),
            2 => {
                // The next connection of the same station has another number.
                let tcp = &mut self.tcp[who(input)];
                self.device.closed(tcp.client.number);
                self.links.retain(|link| link.kind != Kind::Explicit || link.client != tcp.client);
                tcp.client.number += CLIENTS as u32;
                tcp.session = None;
            }
            3 => {
                let (who, whose) = (who(input), who(input));
                let Some(session) = self.tcp[whose].session else { return };
                let answer = self.frame(who, 0x66, session, &[]);
                assert_eq!(answer.is_none(), who == whose, "a session of another connection");
            }
            4 | 5 => self.open(input),
            6 => self.close(input),
            7 | 8 => self.packet(input),
            9 => self.message(input),
            10 => {
                let command = input.pick(&[0x63, 0x63, 0x04, 0x64, 0x65, 0x6F, 0x00]);
                let (is_broadcast, data) = (input.byte().is_multiple_of(2), input.fewer_than(8));
                let (from, mut answer) = (SocketAddrV4::new(STATIONS[0], 50_000), [0; MAX_FRAME_LEN]);
                let datagram = frame(command, [0; 4], data);
                let sent = self.device.receive_datagram(self.now, from, is_broadcast, &datagram, &mut answer);
                assert!(sent.is_none_or(|sent| sent.len() < 100), "amplification");
                self.answers += usize::from(is_broadcast && command == 0x63 && sent.is_none());
            }
            _ => {
                let (is_stream, noise) = (input.byte().is_multiple_of(2), input.fewer_than(64));
                if !is_stream {
                    return self.receive(STATIONS[0], noise);
                }
                let (taken, whole) = self.receiver.push_slice(noise);
                assert!(taken == noise.len() || whole.is_some(), "bytes that are never taken");
                if let Some(whole) = whole {
                    let mut answer = [0; MAX_FRAME_LEN];
                    self.device.request(self.now, NOISY, whole, &mut (), &mut answer);
                }
            }
        }
    }

    /// Sends a frame over a TCP connection. Returns the answer.
    fn frame(&mut self, who: usize, command: u16, session: [u8; 4], data: &[u8]) -> Option<Vec<u8>> {
        let (frame, mut answer) = (frame(command, session, data), [0; MAX_FRAME_LEN]);
        self.tcp[who].received = self.now;
        let client = self.tcp[who].client;
        self.device.request(self.now, client, &frame, &mut (), &mut answer).map(<[u8]>::to_vec)
    }

    fn register(&mut self, who: usize) {
        let answer = self.frame(who, 0x65, [0; 4], &[1, 0, 0, 0]).expect("an answer");
        assert_eq!(answer[8] == 0, self.tcp[who].session.is_none(), "one session for a TCP connection");
        if answer[8] == 0 {
            let session = answer[4..8].try_into().expect("four");
            assert!(self.tcp.iter().all(|tcp| tcp.session != Some(session)), "a session twice");
            self.tcp[who].session = Some(session);
        }
    }

    /// Sends an unconnected message over a TCP connection. Returns the answer, if the session is its own.
    fn unconnected(&mut self, who: usize, whose: usize, message: &[u8]) -> Option<Vec<u8>> {
        let session = self.tcp[whose].session?;
        let len = (message.len() as u16).to_le_bytes();
        let data = [&[0; 6][..], &[2, 0, 0, 0, 0, 0, 0xB2, 0], &len, message].concat();
        let answer = self.frame(who, 0x6F, session, &data).expect("an answer");
        assert_eq!(answer[8] == 0x64, who != whose, "a session of another connection");
        (answer[8] == 0).then(|| answer[40..].to_vec())
    }

    fn open(&mut self, input: &mut Input<'_>) {
        let who = who(input);
        let whose = if input.byte() < 0xF0 { who } else { (who + 1) % CLIENTS };
        let kind = input.pick(&[Kind::Owner, Kind::InputOnly, Kind::ListenOnly, Kind::Explicit]);
        let (serial, how) = (input.byte() % 32, input.byte());
        let intervals = [20_000_u32, 1_000, 500_000, 10_000_000];
        let [to, from] = [how % 4, how / 4 % 4].map(|at| intervals[usize::from(at)].to_le_bytes());
        let (size, transport, path) = match kind {
            Kind::Owner => (14, 0x01, &[0x20, 4, 0x24, 151, 0x2C, 150, 0x2C, 100][..]),
            Kind::InputOnly => (2, 0x01, &[0x20, 4, 0x24, 151, 0x2C, 152, 0x2C, 100][..]),
            Kind::ListenOnly => (2, 0x01, &[0x20, 4, 0x24, 151, 0x2C, 153, 0x2C, 100][..]),
            Kind::Explicit => (200, 0xA3, &[0x20, 2, 0x24, 1][..]),
        };
        let input_size = if kind == Kind::Explicit { 200 } else { 14 };
        let input_kind = if how >= 0x80 && kind != Kind::Explicit { 0x28 } else { 0x48 };
        let mut message = [
            &[0x54][..],
            &MANAGER,
            &[10, 240, 0, 0, 0, 0, serial, 0xAB, 0, 0, serial, 0, 1, 0, 1, 0, 0, 0, how / 16 % 8, 0, 0, 0],
            &to,
            &[size, 0x48],
            &from,
            &[input_size, input_kind, transport, path.len() as u8 / 2],
            path,
        ]
        .concat();
        let is_damaged = input.damage(&mut message);
        let Some(answer) = self.unconnected(who, whose, &message) else { return };
        let is_open = answer[..4] == [0xD4, 0, 0, 0];
        if is_damaged && !is_open {
            return;
        }
        // The fields that a damaged message has.
        let kind = match (message[40] & 0xF, message.get(47)) {
            (3, _) => Kind::Explicit,
            (_, Some(150)) => Kind::Owner,
            (_, Some(152)) => Kind::InputOnly,
            _ => Kind::ListenOnly,
        };
        let triad: [u8; 8] = message[16..24].try_into().expect("eight");
        let number = |at| u32::from_le_bytes(std::array::from_fn(|byte| message[at + byte]));
        let interval_us = number(34).into();
        let is_multicast = message[39] & 0x60 == 0x20;
        let shared = self.links.iter().find(|link| is_multicast && link.is_multicast);
        let is_other = shared.is_some_and(|link| link.interval_us != interval_us);
        let refusal = self.refusal(kind, triad).or(is_other.then_some(0x0112));
        if let Some(refusal) = refusal {
            assert_eq!(answer[..6], [&[0xD4, 0, 1, 1][..], &refusal.to_le_bytes()].concat(), "{kind:?}");
            return;
        }
        assert!(is_open, "{kind:?}: {answer:02X?}");
        let timeout_us = u64::from(number(28)) * (4 << message[24]);
        let ids = [4, 8].map(|at| std::array::from_fn(|byte| answer[at + byte]));
        assert!(self.links.iter().all(|link| link.ids[0] != ids[0]), "an identifier twice");
        assert!(shared.is_none_or(|link| link.ids[1] == ids[1]), "two productions for a group");
        self.links.push(Link {
            kind,
            client: self.tcp[who].client,
            triad,
            ids,
            size: u16::from_le_bytes([message[32], message[33] & 1]),
            timeout_us,
            until: self.now + timeout_us.max(10_000_000),
            sequence: None,
            count: None,
            is_multicast,
            interval_us,
            due: shared.map_or(self.now, |link| link.due),
        });
        if kind == Kind::Owner {
            self.state = State::Waiting;
            self.expected.push(Event::Connected);
        }
    }

    /// Returns the extended status of a request for a connection.
    fn refusal(&self, kind: Kind, triad: [u8; 8]) -> Option<u16> {
        let count = |kinds: &[Kind]| self.links.iter().filter(|link| kinds.contains(&link.kind)).count();
        let (owners, inputs) = (count(&[Kind::Owner]), count(&[Kind::InputOnly]));
        match kind {
            _ if self.links.iter().any(|link| link.triad == triad) => Some(0x0100),
            Kind::Owner => (owners > 0).then_some(0x0106),
            Kind::ListenOnly if owners + inputs == 0 => Some(0x0119),
            Kind::InputOnly | Kind::ListenOnly => {
                (inputs + count(&[Kind::ListenOnly]) >= 7).then_some(0x0113)
            }
            Kind::Explicit => (count(&[Kind::Explicit]) >= 8).then_some(0x0113),
        }
    }

    fn close(&mut self, input: &mut Input<'_>) {
        let (who, serial) = (who(input), input.byte() % 32);
        let mut message = [&[0x4E][..], &MANAGER, &[10, 240, serial, 0, 1, 0, 1, 0, 0, 0, 0, 0]].concat();
        let is_damaged = input.damage(&mut message);
        let Some(answer) = self.unconnected(who, who, &message) else { return };
        if is_damaged && answer[..3] != [0xCE, 0, 0] {
            return;
        }
        let address = self.tcp[who].client.address;
        let status = match self.links.iter().position(|link| link.triad == message[8..16]) {
            None => 0x01,
            Some(at) if self.links[at].client.address != address => 0x0F,
            Some(at) => {
                self.end(at, Cause::Closed);
                0
            }
        };
        assert_eq!(answer[2], status, "Forward_Close");
    }

    /// Sends a packet of a connection.
    fn packet(&mut self, input: &mut Input<'_>) {
        let (at, how) = (usize::from(input.byte()), input.byte());
        let outputs: [u8; OutputImage::LEN] = input.array();
        if self.links.is_empty() {
            return;
        }
        let link = &self.links[at % self.links.len()];
        let step = [1, 1, 2, 0, u32::MAX, 0x7FFF_FFFF, 0x8000_0000, 5][usize::from(how % 8)];
        let sequence = link.sequence.unwrap_or(outputs[0].into()).wrapping_add(step);
        let count = u16::from_le_bytes(link.count.unwrap_or_default()).wrapping_add(u16::from(how < 0xC0));
        let header = u32::from(how & 0x18 != 0x18);
        let mut data = [&count.to_le_bytes()[..], &header.to_le_bytes(), &outputs].concat();
        data.truncate(link.size.into());
        let len = (data.len() as u16).to_le_bytes();
        let address = [&[2, 0, 2, 0x80, 8, 0], &link.ids[0][..], &sequence.to_le_bytes()].concat();
        let mut packet = [&address, &[0xB1, 0][..], &len, &data].concat();
        let from = if how & 0x60 == 0x60 { STATIONS[0] } else { link.client.address };
        input.damage(&mut packet);
        self.receive(from, &packet);
    }

    /// Receives a packet, and decides independently what it does.
    fn receive(&mut self, from: Ipv4Addr, packet: &[u8]) {
        self.device.receive_packet(self.now, from, packet);
        let is_of = |link: &&mut Link| {
            let [low, high] = link.size.to_le_bytes();
            link.kind != Kind::Explicit
                && link.client.address == from
                && packet.len() == 18 + usize::from(link.size)
                && packet[..10] == [&[2, 0, 2, 0x80, 8, 0], &link.ids[0][..]].concat()
                && packet[14..18] == [0xB1, 0, low, high]
                && link.sequence.is_none_or(|last| sequence(packet).wrapping_sub(last) as i32 > 0)
        };
        let Some(link) = self.links.iter_mut().find(is_of) else {
            self.packets_dropped += 1;
            return;
        };
        link.sequence = Some(sequence(packet));
        link.until = self.now + link.timeout_us;
        if link.kind != Kind::Owner {
            return;
        }
        let is_new = link.count.replace([packet[18], packet[19]]) != Some([packet[18], packet[19]]);
        let was_running = self.state == State::Run;
        if packet[20] & 1 == 0 {
            self.expected.extend(was_running.then_some(Event::Idle));
            (self.state, self.outputs) = (State::Idle, [0; OutputImage::LEN]);
        } else if is_new || !was_running {
            self.expected.push(Event::Outputs);
            (self.state, self.outputs) = (State::Run, packet[24..].try_into().expect("the outputs"));
        }
    }

    /// Sends an explicit message, unconnected or in a connection.
    fn message(&mut self, input: &mut Input<'_>) {
        let (who, at, count) = (who(input), usize::from(input.byte()), input.byte());
        let mut message = input.pick(&MESSAGES).to_vec();
        input.damage(&mut message);
        let Some(session) = self.tcp[who].session else { return };
        let explicit = self.links.iter_mut().filter(|link| link.kind == Kind::Explicit);
        let mut explicit: Vec<&mut Link> = explicit.collect();
        let at = at % (explicit.len() + 1);
        let Some(link) = explicit.get_mut(at).filter(|_| !message.is_empty()) else {
            self.unconnected(who, who, &message);
            return;
        };
        let (ids, is_own) = (link.ids, link.client == self.tcp[who].client);
        if is_own {
            link.until = self.now + link.timeout_us;
        }
        let len = (message.len() as u16 + 2).to_le_bytes();
        let data =
            [&[0; 6][..], &[2, 0, 0xA1, 0, 4, 0], &ids[0], &[0xB1, 0], &len, &[count, 0], &message].concat();
        // An incomplete message has no answer.
        let answer = self.frame(who, 0x70, session, &data);
        assert!(is_own || answer.is_none(), "a connection of another client");
        if let Some(answer) = answer {
            assert_eq!(answer[36..40], ids[1]);
            assert_eq!(answer[44..46], [count, 0]);
        }
    }

    /// Ends a connection, and with the last one of another kind those that only listen.
    fn end(&mut self, at: usize, cause: Cause) {
        let ended = self.links.remove(at);
        if ended.kind == Kind::Owner {
            (self.state, self.outputs) = (State::Unowned, [0; OutputImage::LEN]);
            self.expected.push(Event::Left(cause));
        }
        if !self.links.iter().any(|link| matches!(link.kind, Kind::Owner | Kind::InputOnly)) {
            self.links.retain(|link| link.kind == Kind::Explicit);
        }
    }

    fn expire(&mut self) {
        while let Some(at) = self.links.iter().position(|link| link.until <= self.now) {
            self.end(at, Cause::Silence);
        }
    }

    /// Compares all events, the state and the datagrams with the model.
    fn settle(&mut self) {
        let mut events = vec![];
        while let Some(event) = self.device.poll(self.now) {
            match event {
                Event::Reset(_) => assert_eq!(self.state, State::Unowned, "a reset while owned"),
                Event::Close(number) => {
                    let is_it = |tcp: &&mut Tcp| tcp.client.number == number;
                    if let Some(tcp) = self.tcp.iter_mut().find(is_it) {
                        assert!(tcp.session.take().is_some(), "a session ends twice");
                        self.links.retain(|link| link.kind != Kind::Explicit || link.client != tcp.client);
                    }
                }
                _ => events.push(event),
            }
            assert!(events.len() <= 3, "the number of events is not bounded");
        }
        assert_eq!(events, std::mem::take(&mut self.expected));
        assert_eq!((self.device.state(), *self.device.outputs()), (self.state, self.outputs));
        assert_eq!(self.device.counters().packets_dropped, self.packets_dropped);
        let is_stale = |tcp: &Tcp| tcp.session.is_some() && tcp.received + INACTIVITY_US <= self.now;
        assert!(!self.tcp.iter().any(is_stale), "a session without frames");
        let mut buffer = [0; MAX_FRAME_LEN];
        for _ in 0..MAX_AT_ONCE {
            match self.device.poll_transmit(self.now, &mut buffer) {
                Some(Transmit::Io(len, to)) => {
                    let is_due = |link: &&mut Link| {
                        let ip = if link.is_multicast { GROUP } else { link.client.address };
                        (link.ids[1], ip, 2_222) == ([6, 7, 8, 9].map(|at| buffer[at]), *to.ip(), to.port())
                            && link.kind != Kind::Explicit
                            && link.due <= self.now
                    };
                    let link = self.links.iter_mut().find(is_due).expect("a connection for the packet");
                    link.due += ((self.now - link.due) / link.interval_us + 1) * link.interval_us;
                    let due = link.due;
                    let group = self.links.iter_mut().filter(|link| link.is_multicast && *to.ip() == GROUP);
                    group.for_each(|link| link.due = due);
                    assert_eq!(len, 18 + 2 + InputImage::LEN);
                }
                Some(Transmit::Answer(len, _)) => {
                    self.answers = self.answers.checked_sub(1).expect("a request for the answer");
                    assert!(len < 100, "amplification");
                }
                None => {
                    let is_due = |link: &Link| link.kind != Kind::Explicit && link.due <= self.now;
                    assert!(!self.links.iter().any(is_due), "a packet that is not sent");
                    assert!(self.device.poll_timeout(self.now) > self.now, "an overdue action");
                    return;
                }
            }
        }
        panic!("the number of datagrams is not bounded");
    }
}

fn who(input: &mut Input<'_>) -> usize {
    usize::from(input.byte()) % CLIENTS
}

fn sequence(packet: &[u8]) -> u32 {
    u32::from_le_bytes([10, 11, 12, 13].map(|at| packet[at]))
}

fn frame(command: u16, session: [u8; 4], data: &[u8]) -> Vec<u8> {
    let len = data.len() as u16;
    [&command.to_le_bytes()[..], &len.to_le_bytes(), &session, &[0; 16], data].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The seeds' ops achieve their purpose.
    #[test]
    fn ops_of_this_body_open_each_kind_and_set_outputs() {
        let mut world = World::new();
        for op in [&[1, 0][..], &[4, 0, 0, 3, 4, 0, 0], &[4, 0, 0, 1, 2, 0x80, 0], &[4, 0, 0, 2, 3, 0x80, 0]]
        {
            world.happen(&mut Input::new(op));
        }
        for op in [&[4, 0, 0, 0, 1, 0, 0][..], &[7, 3, 0, 1, 2, 3, 4, 5, 6, 7, 8, 0]] {
            world.happen(&mut Input::new(op));
            world.settle();
        }
        assert_eq!((world.links.len(), world.state), (4, State::Run));
        assert_eq!(world.device.outputs(), &[1, 2, 3, 4, 5, 6, 7, 8]);
    }
}
